//! Every shipped config trains to the weights that it trained to when they were recorded, so that no default and no order of
//! operations changes under a config unnoticed.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use cartpole_dqn::config::Config;
use cartpole_dqn::trainer::Event;
use serde_json::Value;

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
