//! The command line: `study`.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use assert_cmd::assert::Assert;
use serde_json::{Value, json};

use crate::cli::{DIVERGING, Sandbox, TINY, keys, refusals, sets, stdout_json};

/// A study of two variations and six seeds with [`TINY`] settings.
const STUDY: [&str; 7] = ["study", "--quiet", "--vary", "gamma=0.9,0.99", "--seeds", "3..9", "--out"];

fn study(sandbox: &Sandbox, out: &str, more: &[&str]) -> Assert {
    sandbox.run(&[&STUDY[..], &[out], &sets(TINY), more].concat())
}

/// The files below a directory of the sandbox, by their path in it.
pub(crate) fn tree(sandbox: &Sandbox, directory: &str) -> BTreeMap<PathBuf, Option<Vec<u8>>> {
    let root = sandbox.path(directory);
    let below = |path: PathBuf| Some(path.strip_prefix(&root).ok()?.to_owned());
    sandbox.files().into_iter().filter_map(|(path, content)| Some((below(path)?, content))).collect()
}

/// The only file of trials of a study, as the sandbox knows it.
pub(crate) fn trial_file(sandbox: &Sandbox, directory: &str) -> String {
    let files: Vec<PathBuf> =
        tree(sandbox, directory).into_keys().filter(|path| is_of_trials(path)).collect();
    assert_eq!(files.len(), 1, "{files:?}");
    format!("{directory}/{}", files[0].display())
}

fn is_of_trials(path: &Path) -> bool {
    path.starts_with("trials") && path.extension().is_some()
}

/// The finished trials of a study, in one order whoever has run them; copies are one.
pub(crate) fn trial_lines(sandbox: &Sandbox, directory: &str) -> Vec<String> {
    let files = files_of_trials(sandbox, directory);
    let mut lines: Vec<String> = files.iter().flat_map(|text| text.lines()).map(String::from).collect();
    lines.sort();
    lines.dedup();
    lines
}

fn files_of_trials(sandbox: &Sandbox, directory: &str) -> Vec<String> {
    let files = tree(sandbox, directory).into_iter().filter(|(path, _)| is_of_trials(path));
    files.map(|(_, content)| String::from_utf8(content.unwrap()).unwrap()).collect()
}

/// Changes the lines of the only file of trials.
pub(crate) fn edit_lines(sandbox: &Sandbox, directory: &str, edit: impl FnOnce(&mut Vec<String>)) {
    let file = trial_file(sandbox, directory);
    let mut lines: Vec<String> = sandbox.read(&file).lines().map(String::from).collect();
    edit(&mut lines);
    sandbox.write(&file, lines.into_iter().map(|line| line + "\n").collect::<String>());
}

fn trial(sandbox: &Sandbox, directory: &str, config: &str, seed: u64) -> Value {
    let trials =
        trial_lines(sandbox, directory).into_iter().map(|line| serde_json::from_str::<Value>(&line).unwrap());
    let is_it = |trial: &Value| trial["config"] == config && trial["seed"] == seed;
    trials.into_iter().find(is_it).unwrap()
}

refusals! {
    refuses_a_study_without_seeds: [], ["study", "--out", "s"] => ["--seeds"];
    refuses_a_study_without_a_directory: [], ["study", "--seeds", "0..2"] => ["--out"];
    refuses_no_seeds: [], ["study", "--out", "s", "--seeds", "2..2"] => ["'2..2'", "A < B", "0..100"];
    refuses_seeds_that_are_no_range: [], ["study", "--out", "s", "--seeds", "10"] => ["'10'", "A..B"];
    refuses_negative_seeds: [], ["study", "--out", "s", "--seeds", "-1..3"] => ["-1..3", "A..B"];
    refuses_no_jobs: [], ["study", "--out", "s", "--seeds", "0..2", "--jobs", "0"] => ["--jobs", "from 1 to 4096"];
    refuses_an_invalid_variation_before_anything_is_written:
        [], ["study", "--out", "s", "--seeds", "0..2", "--vary", "gamma=0.9,1.5"]
        => ["variation gamma=1.5", "`gamma` is 1.5", "from 0 to 1"];
    refuses_a_variation_of_an_unknown_key:
        [], ["study", "--out", "s", "--seeds", "0..2", "--vary", "gama=0.9"] => ["`gama`", "`gamma`"];
    refuses_a_variation_without_values:
        [], ["study", "--out", "s", "--seeds", "0..2", "--vary", "gamma"] => ["--vary", "KEY=V1,V2"];
    refuses_an_empty_value:
        [], ["study", "--out", "s", "--seeds", "0..2", "--vary", "gamma=0.9,"] => ["--vary", "missing"];
    refuses_a_value_that_comes_twice:
        [], ["study", "--out", "s", "--seeds", "0..2", "--vary", "gamma=0.9,0.9"] => ["--vary", "twice"];
    refuses_a_value_that_comes_twice_in_two_spellings:
        [], ["study", "--out", "s", "--seeds", "0..2", "--vary", "gamma=0.90,0.9"]
        => ["gamma=0.90 and gamma=0.9 are the same config"];
    refuses_to_set_what_is_varied:
        [], ["study", "--out", "s", "--seeds", "0..2", "--vary", "gamma=0.9,1", "--set", "gamma=0.5"]
        => ["--vary gamma overwrites --set gamma=0.5"];
    refuses_to_set_a_part_of_what_is_varied:
        [], ["study", "--out", "s", "--seeds", "0..2", "--vary", "target=[{\"kind\":\"none\"}]", "--set", "target.kind=none"]
        => ["--vary target overwrites --set target.kind"];
    refuses_a_key_that_is_varied_twice:
        [], ["study", "--out", "s", "--seeds", "0..2", "--vary", "gamma=0.9", "--vary", "gamma=1"]
        => ["--vary gamma", "twice"];
    refuses_a_list_that_is_no_json:
        [], ["study", "--out", "s", "--seeds", "0..2", "--vary", "network.hidden=[[8]"] => ["expected a JSON list"];
    refuses_objects_outside_a_list:
        [], ["study", "--out", "s", "--seeds", "0..2", "--vary", "target={\"kind\":\"none\"}"] => ["target=[{"];
    refuses_a_variation_of_the_seed:
        [], ["study", "--out", "s", "--seeds", "0..2", "--vary", "seed=1,2"] => ["--seeds"];
    refuses_a_seed_that_is_set:
        [], ["study", "--out", "s", "--seeds", "0..2", "--set", "seed=1"] => ["--set seed", "--seeds"];
    refuses_more_configs_than_anybody_means:
        [], ["study", "--out", "s", "--seeds", "0..2", "--vary", "replay.warmup_steps=1,2,3,4,5,6,7,8,9,10",
             "--vary", "target.every_steps=1,2,3,4,5,6,7,8,9,10", "--vary", "learn.updates=1,2,3,4,5,6,7,8,9,10",
             "--vary", "replay.capacity=1,2,3,4,5,6,7,8,9,10", "--vary", "gamma=0.1,0.2"] => ["more than 10000 configs"];
    refuses_two_configs_of_the_same_name:
        [("a/my.json", b"{}"), ("b/my.json", b"{\"gamma\": 0.9}")],
        ["study", "--out", "s", "--seeds", "0..2", "--config", "a/my.json", "--config", "b/my.json"]
        => ["b/my.json", "\"my\"", "rename"];
    refuses_a_missing_config_for_a_study:
        [], ["study", "--out", "s", "--seeds", "0..2", "--config", "no.json"] => ["no.json", "No such file"];
    refuses_a_directory_with_something_else:
        [("s/notes.txt", b"mine")], ["study", "--out", "s", "--seeds", "0..2"] => ["directory s", "not empty", "--out"];
    refuses_a_study_into_a_file: [("s", b"mine")], ["study", "--out", "s", "--seeds", "0..2"] => ["directory s", "--out"];
    refuses_a_shard_beyond_the_last: [], ["study", "s", "--shard", "4/4"] => ["'4/4'", "I from 0 to N − 1", "0/4"];
    refuses_a_shard_of_none: [], ["study", "s", "--shard", "0/0"] => ["'0/0'", "I/N"];
    refuses_a_shard_that_is_a_number: [], ["study", "s", "--shard", "3"] => ["'3'", "I/N"];
    refuses_to_go_on_with_what_is_no_study: [("s/notes.txt", b"mine")], ["study", "s"] => ["directory s", "no study.json"];
    refuses_to_go_on_with_a_study_and_other_seeds: [], ["study", "s", "--seeds", "0..2"] => ["--seeds", "cannot be used"];
    refuses_the_status_of_what_is_no_study: [], ["study", "s", "--status"] => ["directory s", "no study.json"];
    refuses_a_time_limit_without_a_unit:
        [], ["study", "s", "--time-limit", "5"] => ["--time-limit", "'5'"];
    refuses_a_study_of_the_first_format:
        [("s/study.json", b"{\"format_version\": 1}")], ["study", "s"] => ["directory s", "format_version 1", "reads 2"];
    refuses_a_manifest_of_something_else:
        [("s/study.json", b"[1]")], ["study", "--out", "s", "--seeds", "0..2"] => ["directory s", "does not describe a study"];
    refuses_a_manifest_that_is_no_json:
        [("s/study.json", b"x")], ["study", "--out", "s", "--seeds", "0..2"] => ["directory s", "study.json", "line 1"];
}

#[test]
fn a_study_does_not_depend_on_jobs() {
    let sandbox = Sandbox::new();
    study(&sandbox, "one", &["--jobs", "1"]).success().stdout("").stderr("");
    study(&sandbox, "two", &["--jobs", "2"]).success();
    assert_eq!(trial_lines(&sandbox, "one").len(), 12);
    assert_eq!(trial_lines(&sandbox, "one"), trial_lines(&sandbox, "two"));
    assert_eq!(sandbox.read("one/study.json"), sandbox.read("two/study.json"));
}

#[test]
#[cfg(unix)]
fn a_killed_study_goes_on_where_it_stopped() {
    let sandbox = Sandbox::new();
    let program = assert_cmd::cargo::cargo_bin!("cartpole-dqn");
    let more = ["--seeds", "0..100"];
    let arguments = |out: &'static str| {
        let study = ["study", "--quiet", "--vary", "gamma=0.9,0.99", "--jobs", "2", "--out", out];
        [&study[..], &sets(TINY), &more].concat()
    };
    let mut child = std::process::Command::new(program)
        .current_dir(sandbox.path("."))
        .args(arguments("killed"))
        .spawn()
        .unwrap();
    while files_of_trials(&sandbox, "killed").concat().lines().count() < 3 {
        assert!(child.try_wait().unwrap().is_none(), "the study ended before it could be killed");
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    let file = trial_file(&sandbox, "killed");
    let before = sandbox.read(&file);
    assert!(before.lines().count() < 200, "the study ended before it was killed");
    // As a process leaves it that is killed while it writes.
    sandbox.write(&file, before.clone() + "{\"config\":\"cartpole gam");
    sandbox.run(&arguments("killed")).success().stderr(predicates::str::contains(format!(
        "line {} of {file} is not finished and is ignored",
        before.lines().count() + 1
    )));
    sandbox.run(&arguments("whole")).success();
    let mut lines = trial_lines(&sandbox, "killed");
    lines.retain(|line| line.ends_with('}'));
    assert_eq!(lines, trial_lines(&sandbox, "whole"));
    assert!(sandbox.read(&file).starts_with(&before), "a file of another process was changed");
    let all: usize = files_of_trials(&sandbox, "killed").iter().map(|text| text.matches("}\n").count()).sum();
    assert_eq!(all, 200, "a finished trial ran again");
    for study in ["killed", "whole"] {
        sandbox.run(&["report", study]).success();
    }
    assert_eq!(sandbox.read("killed/report.json"), sandbox.read("whole/report.json"));
}

/// The trials in question take hours.
#[test]
#[cfg(unix)]
fn a_signal_ends_a_study_which_says_how_to_resume_it() {
    for (signal, exit_code) in [("-INT", 130), ("-TERM", 143)] {
        let sandbox = Sandbox::new();
        let program = assert_cmd::cargo::cargo_bin!("cartpole-dqn");
        let endless =
            ["study", "--jobs", "2", "--out", "s", "--seeds", "0..4", "--set", "budget.steps=4000000000"];
        let child = std::process::Command::new(program)
            .current_dir(sandbox.path("."))
            .args(endless)
            .stdout(std::process::Stdio::piped())
            .stderr(std::process::Stdio::piped())
            .spawn()
            .unwrap();
        while files_of_trials(&sandbox, "s").is_empty() {
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
        // The trials begin after that.
        std::thread::sleep(std::time::Duration::from_millis(300));
        crate::signals::kill(&child, signal);
        let output = child.wait_with_output().unwrap();
        let message = String::from_utf8(output.stderr).unwrap();
        assert_eq!((output.status.code(), &output.stdout[..]), (Some(exit_code), &b""[..]), "{message}");
        assert!(message.contains("stopped: 0 of 4 trials are finished and kept"), "{message}");
        let command = " study --jobs 2 --out s --seeds 0..4 --set budget.steps=4000000000\n";
        assert!(message.ends_with(command), "{message}");
        assert_eq!(files_of_trials(&sandbox, "s").len(), 0);
        let unfinished = |path: &PathBuf| path.to_string_lossy().contains(".writing-");
        assert!(!tree(&sandbox, "s").keys().any(unfinished));
        assert!(sandbox.path("s/unfinished/0-0.safetensors").exists());
    }
}

#[test]
fn a_study_grows_by_seeds_and_equals_one_that_had_them_from_the_start() {
    let sandbox = Sandbox::new();
    let run = |out: &str, seeds: &str| {
        sandbox
            .run(&[&["study", "--quiet", "--out", out, "--seeds", seeds], &sets(TINY)[..]].concat())
            .success();
    };
    run("grown", "0..2");
    run("grown", "0..4");
    run("whole", "0..4");
    assert_eq!(trial_lines(&sandbox, "grown"), trial_lines(&sandbox, "whole"));
    assert_eq!(sandbox.read("grown/study.json"), sandbox.read("whole/study.json"));
    let fewer = [&["study", "--out", "grown", "--seeds", "0..2"], &sets(TINY)[..]].concat();
    sandbox.refuses(&fewer, &["directory grown", "`seeds.end` is 4", "2 is given"]);
    let others = [&["study", "--out", "grown", "--seeds", "1..5"], &sets(TINY)[..]].concat();
    sandbox.refuses(&others, &["directory grown", "`seeds.start` is 0", "1 is given"]);
}

#[test]
fn a_changed_study_is_refused_with_the_key() {
    let sandbox = Sandbox::new();
    study(&sandbox, "s", &[]).success();
    let changed = |more: &[&'static str]| [&STUDY[..], &["s"], &sets(TINY), more].concat();
    let gamma = ["study", "--vary", "gamma=0.9,0.95", "--seeds", "3..9", "--out", "s"];
    sandbox.refuses(
        &[&gamma[..], &sets(TINY)].concat(),
        &["directory s", "`configs.1.name`", "gamma=0.99", "gamma=0.95"],
    );
    sandbox.refuses(
        &changed(&["--set", "replay.capacity=99"]),
        &["`configs.0.config.replay.capacity`", "99 is given"],
    );
    sandbox.refuses(&changed(&["--vary", "double=false,true"]), &["directory s", "2 configs", "4 are given"]);
}

#[test]
fn a_trial_that_fails_is_recorded_and_stops_nothing() {
    let sandbox = Sandbox::new();
    let diverging = [&sets(DIVERGING)[..], &["--set", "evaluation.every_steps=100"]].concat();
    let vary = ["--vary", "optimizer.learning_rate=1,0.001", "--set", "budget.steps=400", "--seeds", "0..3"];
    let varied = |set: &str| set.starts_with("budget") || set.starts_with("optimizer.learning_rate");
    let diverging: Vec<&str> = diverging.chunks(2).filter(|set| !varied(set[1])).flatten().copied().collect();
    let arguments = [&["study", "--out", "s"], &diverging[..], &vary].concat();
    let output = sandbox.run(&arguments).code(1);
    let printed = String::from_utf8(output.get_output().stdout.clone()).unwrap();
    assert!(printed.contains("trials     6") && printed.contains("failed     2"), "{printed}");
    assert!(
        printed.contains("2 of 6 trials failed") && printed.contains("2 ×: training diverged: at"),
        "{printed}"
    );
    // The same numbers as those of the report, below each other in 80 columns, the best config first.
    let table =
        |text: &str| text.lines().skip_while(|line| !line.starts_with("rank")).take(3).collect::<String>();
    let report = sandbox.run(&["report", "s", "--out", "elsewhere"]).success();
    let report = String::from_utf8(report.get_output().stdout.clone()).unwrap();
    assert_eq!(table(&printed), table(&report));
    assert!(printed.contains("\n   1  cartpole optimizer.learning_rate=0.001 "), "{printed}");
    assert!(printed.lines().all(|line| line.chars().count() <= 80), "{printed}");
    let failed = trial(&sandbox, "s", "cartpole optimizer.learning_rate=1", 2);
    assert_eq!((&failed["summary"], &failed["final"]), (&Value::Null, &Value::Null));
    assert!(failed["error"].as_str().unwrap().starts_with("training diverged: at environment step"));
    let good = trial(&sandbox, "s", "cartpole optimizer.learning_rate=0.001", 1);
    assert_eq!((&good["error"], &good["summary"]["env_steps"]), (&Value::Null, &json!(400)));
    // They are not tried again, and not counted less.
    sandbox.run(&arguments).code(1).stdout(printed);
    let quiet = [&arguments[..], &["--quiet"]].concat();
    sandbox
        .run(&quiet)
        .code(1)
        .stdout("")
        .stderr(predicates::str::contains("2 of 6 trials failed, for example"));
}

#[test]
fn a_trial_is_what_train_and_eval_give() {
    let sandbox = Sandbox::new();
    let config =
        [&sets(TINY)[..], &["--set", "budget.steps=1500", "--set", "evaluation.every_steps=250"]].concat();
    sandbox.run(&[&["study", "--seeds", "5..7", "--out", "s", "--quiet"], &config[..]].concat()).success();
    for seed in ["5", "6"] {
        let run = format!("run{seed}");
        sandbox.run(&[&["train", "--quiet", "--seed", seed, "--out", &run], &config[..]].concat()).success();
        let trial = trial(&sandbox, "s", "cartpole", seed.parse().unwrap());
        let expected = ["best", "config", "error", "evaluations", "final", "seed", "summary"];
        assert_eq!(keys(&trial), expected);
        let mut summary = sandbox.json(&format!("{run}/summary.json"));
        for circumstance in [
            "wall_seconds",
            "cpu_seconds",
            "config_sha256",
            "version",
            "git_revision",
            "cpu_path",
            "mean_return_100",
        ] {
            summary.as_object_mut().unwrap().remove(circumstance).unwrap();
        }
        assert_eq!(trial["summary"], summary);
        for (policy, steps) in [("best", "best_evaluation"), ("final", "final_evaluation")] {
            let file = format!("{run}/checkpoints/{}.safetensors", policy.replace("final", "last"));
            let mut score = stdout_json(&sandbox.run(&["eval", "--json", "--checkpoint", &file]).success());
            for key in ["policy", "episodes", "seed", "max_steps", "solved", "returns"] {
                score.as_object_mut().unwrap().remove(key);
            }
            score["env_steps"] = summary[steps]["env_steps"].clone();
            assert_eq!(trial[policy], score, "{policy}");
        }
        let evaluations: Vec<Value> = sandbox
            .read(&format!("{run}/metrics.jsonl"))
            .lines()
            .map(|line| serde_json::from_str::<Value>(line).unwrap())
            .filter(|event| event["event"] == "evaluation")
            .map(|event| json!({"env_steps": event["env_steps"], "mean": event["mean"]}))
            .collect();
        assert_eq!(trial["evaluations"], json!(evaluations));
    }
}

#[test]
fn configs_and_variations_multiply() {
    let sandbox = Sandbox::new();
    sandbox.write("a.json", "{\"seed\": 7}");
    sandbox.write("b.json", "{\"gamma\": 0.5}");
    let vary = ["--vary", "network.hidden=[[8],[4,4]]", "--vary", "loss=mse,huber", "--seeds", "0..1"];
    let tiny: Vec<&str> = TINY.iter().copied().filter(|set| !set.starts_with("network")).collect();
    let configs = ["study", "--config", "a.json", "--config", "b.json", "--quiet", "--out", "s"];
    sandbox.run(&[&configs[..], &vary, &sets(&tiny)].concat()).success();
    let manifest = sandbox.json("s/study.json");
    assert_eq!(keys(&manifest), ["configs", "format_version", "seeds", "version"]);
    assert_eq!(manifest["seeds"], json!({"start": 0, "end": 1}));
    let configs = manifest["configs"].as_array().unwrap();
    let names: Vec<&str> = configs.iter().map(|config| config["name"].as_str().unwrap()).collect();
    let of = |stem: &str| {
        ["[8] loss=mse", "[8] loss=huber", "[4,4] loss=mse", "[4,4] loss=huber"]
            .map(|values| format!("{stem} network.hidden={values}"))
    };
    assert_eq!(names, [of("a"), of("b")].concat());
    let last = &configs[7]["config"];
    assert_eq!((&last["gamma"], &last["loss"], &last["seed"]), (&json!(0.5), &json!("huber"), &json!(0)));
    assert_eq!(trial(&sandbox, "s", names[7], 0)["config"], names[7]);
}

#[test]
fn a_foreign_line_among_the_trials_is_named() {
    let sandbox = Sandbox::new();
    study(&sandbox, "s", &[]).success();
    let file = trial_file(&sandbox, "s");
    let arguments = [&STUDY[..], &["s"], &sets(TINY)].concat();
    for foreign in ["{}", "[1]", "", "{\"config\":\"other\",\"seed\":3,\"error\":null,\"x\":{}}"] {
        sandbox.write(
            "s/trials/a.jsonl",
            format!("{}{foreign}\n", sandbox.read(&file).lines().next().unwrap().to_owned() + "\n"),
        );
        for command in [&arguments[..], &["report", "s"], &["study", "s", "--status"]] {
            sandbox.refuses(command, &["s/trials/a.jsonl line 2", "remove the line"]);
        }
    }
}

/// Whatever is damaged in a line, every command says the same of it.
#[test]
fn a_damaged_line_is_a_trial_for_no_command() {
    let sandbox = Sandbox::new();
    study(&sandbox, "s", &[]).success();
    let (file, arguments) = (trial_file(&sandbox, "s"), [&STUDY[..], &["s"], &sets(TINY)].concat());
    let good = sandbox.read(&file);
    for (part, damage) in [
        ("\"evaluations\":[{", "\"evaluations\":[}{"),
        ("\"mean\":", "\"mean\":x"),
        ("\"final\":{", "\"final\":null,\"other\":{"),
        ("\"evaluations\":[", "\"evaluations\":[{\"env_steps\":999,\"mean\":1.0},"),
        ("\"summary\":{", "\"summary\":{\u{0}"),
    ] {
        assert!(good.lines().next().unwrap().contains(part), "{part}");
        sandbox.write(&file, good.replacen(part, damage, 1));
        for command in [&arguments[..], &["report", "s"], &["study", "s", "--status"]] {
            sandbox.refuses(command, &[&format!("{file} line 1"), "not a trial", "remove the line"]);
        }
    }
}

#[test]
fn a_study_says_how_many_policies_last_if_it_is_asked() {
    let sandbox = Sandbox::new();
    study(&sandbox, "plain", &[]).success();
    study(&sandbox, "long", &["--lasting"]).success();
    // The name that earlier versions had for the option.
    study(&sandbox, "long", &["--endurance"]).success();
    let trial = |study: &str| trial(&sandbox, study, "cartpole gamma=0.9", 3);
    let (plain, mut long) = (trial("plain"), trial("long"));
    assert!(plain["final"].get("lasts").is_none());
    assert_eq!(long["final"]["lasts"], json!(false), "200 steps teach nothing that lasts");
    for policy in ["best", "final"] {
        long[policy].as_object_mut().unwrap().remove("lasts");
    }
    assert_eq!(plain, long, "the scores are those of CartPole-v1");

    sandbox.run(&["report", "long"]).success().stdout(predicates::str::contains("lasts 20000 steps"));
    let report: Value = serde_json::from_slice(&fs::read(sandbox.path("long/report.json")).unwrap()).unwrap();
    assert_eq!(report["configs"][0]["lasting"]["final"], json!(0));
    sandbox.run(&["report", "plain"]).success();
    let report: Value =
        serde_json::from_slice(&fs::read(sandbox.path("plain/report.json")).unwrap()).unwrap();
    assert!(report["configs"][0].get("lasting").is_none());
    study(&sandbox, "plain", &["--lasting"]).code(2).stderr(predicates::str::contains("`endurance`"));
}
