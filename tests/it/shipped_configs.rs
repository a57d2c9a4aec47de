//! Every shipped config trains to the weights that it trained to when they were recorded, so that no default and no order of
//! operations changes under a config unnoticed.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use cartpole_dqn::config::{Config, SHIPPED, shipped};
use cartpole_dqn::trainer::Event;
use predicates::prelude::*;
use serde_json::Value;

use crate::cli::{Sandbox, TINY, refusals, sets};

/// Every config below `configs`, under its path from there.
fn shipped_configs() -> BTreeMap<String, PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("configs");
    let mut found = BTreeMap::new();
    let mut directories = vec![root.clone()];
    while let Some(directory) = directories.pop() {
        for entry in fs::read_dir(directory).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                directories.push(path);
            } else if path.extension().is_some_and(|extension| extension == "json") {
                found
                    .insert(path.strip_prefix(&root).unwrap().display().to_string().replace('\\', "/"), path);
            }
        }
    }
    found
}

/// The weights of a config after so few steps that a debug build takes a second. A task that is a program is left out: its
/// agent trains on CartPole, as `environment.command` needs Gymnasium.
fn weights_of_a_short_run(path: &Path) -> String {
    let text = fs::read_to_string(path).unwrap();
    let file: Value = serde_json::from_str(&text).unwrap();
    let mut sets = vec!["budget.steps=1500".to_owned()];
    if file["environment"]["command"].is_array() {
        // CartPole's own divisors and end are not those of the task.
        let sets_of_task =
            ["environment=CartPole-v1", "observation_divisors=null", "stop_when_lasting_steps=null"];
        sets.extend(sets_of_task.map(String::from));
    }
    let config = Config::from_layers(Some((&path.display().to_string(), &text)), &sets).unwrap();
    let mut trainer = config.make_trainer().unwrap();
    trainer.run(&mut Vec::<Event>::new(), &AtomicBool::new(false)).unwrap();
    assert!(trainer.progress().updates > 0, "{}: nothing was learned", path.display());
    trainer.agent().weights_sha256()
}

#[test]
fn every_shipped_config_trains_to_the_recorded_weights() {
    let recorded: BTreeMap<String, BTreeMap<String, String>> =
        serde_json::from_str(include_str!("../data/config_weights.json")).unwrap();
    let recorded = recorded.into_iter().map(|(name, weights)| (name, weights["1500 steps"].clone()));
    let configs = shipped_configs();
    let found: BTreeMap<_, _> = std::thread::scope(|scope| {
        let runs = configs.iter().map(|(name, path)| (name, scope.spawn(|| weights_of_a_short_run(path))));
        let runs: Vec<_> = runs.collect();
        runs.into_iter().map(|(name, run)| (name.clone(), run.join().unwrap())).collect()
    });
    assert_eq!(found, recorded.collect());
}

#[test]
fn every_file_of_configs_is_in_the_program_under_its_name() {
    let files = shipped_configs();
    let texts = files.iter().filter_map(|(file, path)| {
        Some((file.strip_suffix(".json")?.to_owned(), fs::read_to_string(path).unwrap()))
    });
    let files: BTreeMap<_, _> = texts.filter(|(name, _)| !name.starts_with("studies/")).collect();
    let embedded: BTreeMap<_, _> =
        SHIPPED.iter().map(|config| (config.name.to_owned(), config.text.to_owned())).collect();
    assert_eq!(embedded, files);
    assert_eq!(SHIPPED.len(), files.len(), "a name comes twice");
    let page = include_str!("../../docs/configuration.md");
    let listed = Sandbox::new().run(&["config", "list"]).success();
    let listed = String::from_utf8(listed.get_output().stdout.clone()).unwrap();
    assert_eq!(listed.lines().count(), SHIPPED.len());
    for (config, line) in SHIPPED.iter().zip(listed.lines()) {
        assert!(line.split(' ').next() == Some(config.name) && line.ends_with(config.about), "{line}");
        assert!(line.chars().count() <= 80, "{line}");
        assert!(page.contains(&format!("`{}`", config.name)), "docs/configuration.md: {}", config.name);
    }
}

#[test]
fn a_config_by_its_name_trains_to_the_bytes_of_its_file() {
    let sandbox = Sandbox::new();
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/configs/tutorial.json");
    let train = |config, out| {
        let options = ["train", "--quiet", "--config", config, "--set", "budget.episodes=30", "--out", out];
        sandbox.run(&options).success();
    };
    train("tutorial", "named");
    train(file, "read");
    for name in
        ["config.json", "metrics.jsonl", "checkpoints/best.safetensors", "checkpoints/last.safetensors"]
    {
        let bytes = |run: &str| fs::read(sandbox.path(run).join(name)).unwrap();
        assert!(bytes("named") == bytes("read"), "{name} differs");
    }
    let study = |config, out| {
        let options = ["study", "--quiet", "--config", config, "--seeds", "0..1", "--out", out];
        sandbox.run(&[&options[..], &sets(TINY)].concat()).success();
    };
    study("plain", "a");
    study(concat!(env!("CARGO_MANIFEST_DIR"), "/configs/plain.json"), "b");
    assert_eq!(sandbox.read("a/study.json"), sandbox.read("b/study.json"));
    // A run without --out is called after it.
    sandbox.run(&["train", "--quiet", "--config", "smoke"]).success();
    let run = fs::read_dir(sandbox.path("runs")).unwrap().next().unwrap().unwrap().file_name();
    assert!(run.to_str().unwrap().starts_with("smoke-s1-"), "{run:?}");
}

#[test]
fn a_file_with_the_name_of_a_shipped_config_is_taken_only_with_a_path() {
    let sandbox = Sandbox::new();
    sandbox.write("tutorial", "{\"gamma\": 0.123}");
    sandbox.write("tutorial.json", "{\"gamma\": 0.456}");
    sandbox.write("mine", "{\"gamma\": 0.789}");
    for (config, gamma) in
        [("tutorial", "0.95"), ("./tutorial", "0.123"), ("tutorial.json", "0.456"), ("mine", "0.789")]
    {
        let shown = sandbox.run(&["config", "show", "--config", config]).success();
        shown.stdout(predicate::str::contains(format!("\ngamma={gamma}\n")));
    }
}

#[test]
fn a_library_gets_a_shipped_config_by_its_name() {
    let config = Config::from_layers(Some(shipped("cartpole").unwrap()), &[]).unwrap();
    assert_eq!(config, Config::default());
    let error = |name| shipped(name).unwrap_err().to_string();
    assert!(error("Cartpole-v1").ends_with("`Cartpole-v1`; did you mean `cartpole`?"));
    assert!(error("x").contains("there are cartpole, fast, plain, tutorial"));
}

const LIST: &str = "cartpole-dqn config list";

refusals! {
    refuses_a_misspelled_name_and_names_the_nearest:
        [], ["train", "--config", "tutoril"] => ["cannot read tutoril", "; did you mean `tutorial`? --config takes", LIST];
    refuses_it_in_a_study: [], ["study", "--config", "qtable", "--seeds", "0..1", "--out", "s"] => ["did you mean `q_table`?"];
    refuses_it_in_show: [], ["config", "show", "--config", "LunarLander"] => ["did you mean `lunar_lander`?"];
    refuses_it_in_explain: [], ["explain", "--config", "plian", "--update", "3"] => ["did you mean `plain`?"];
    refuses_the_path_of_a_clone_that_is_not_there:
        [], ["train", "--config", "configs/tutorial.json"] => ["cannot read configs/tutorial.json", "did you mean `tutorial`?"];
    names_a_shipped_config_as_the_origin_of_its_values:
        [], ["train", "--config", "plain", "--set", "replay.capacity=9"] => ["error: plain with --set: `replay.batch_size` is 32"];
}

/// Its program is a file of the repository.
#[cfg(unix)]
#[test]
fn a_shipped_config_whose_program_is_not_there_says_where_the_program_is() {
    let sandbox = Sandbox::new();
    let study = ["study", "--config", "lunar_lander", "--seeds", "0..1", "--out", "s"];
    for command in [&["train", "--config", "lunar_lander"][..], &study] {
        let refused = sandbox.run(command).code(1).stdout("");
        let says =
            "no adapters/gymnasium.py, which is part of the repository. Type the command in a clone, or";
        refused.stderr(predicate::str::contains(says));
        assert!(sandbox.files().is_empty(), "{command:?}");
    }
}
