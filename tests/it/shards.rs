//! `study` in many processes: shards, plans, stopping and resuming, and lines that contradict each other.

use std::process::{Child, Command, Stdio};
use std::time::Duration;

use serde_json::json;

use crate::cli::{Sandbox, TINY, sets};
use crate::study::{edit_lines, trial_file, trial_lines};

/// Processes at the same time.
const PROCESSES: usize = 16;

fn plan(sandbox: &Sandbox, out: &str, seeds: &str) {
    let study = ["study", "--plan", "--quiet", "--vary", "gamma=0.9,0.99", "--seeds", seeds, "--out", out];
    sandbox.run(&[&study[..], &sets(TINY)].concat()).success().stdout("");
}

fn report(sandbox: &Sandbox, study: &str) -> String {
    sandbox.run(&["report", study, "--out", &format!("{study}-report")]).success();
    sandbox.read(&format!("{study}-report/report.json"))
}

#[test]
fn a_plan_is_run_from_its_directory_alone() {
    let sandbox = Sandbox::new();
    plan(&sandbox, "planned", "3..9");
    assert!(!sandbox.path("planned/trials").exists());
    let counts = |done: &str, missing: &str| {
        let status = sandbox.run(&["study", "planned", "--status"]).success();
        let status = String::from_utf8(status.get_output().stdout.clone()).unwrap();
        let all: Vec<&str> = status.lines().last().unwrap().split_whitespace().collect();
        assert_eq!(all, ["all", done, missing, "0"], "{status}");
    };
    counts("0", "12");
    for shard in ["0/3", "2/3", "0/3"] {
        sandbox.run(&["study", "planned", "--quiet", "--shard", shard]).success().stdout("");
    }
    counts("8", "4");
    let printed = sandbox.run(&["study", "planned", "--shard", "1/3"]).success();
    assert!(String::from_utf8_lossy(&printed.get_output().stdout).starts_with("trials     4 of this shard"));
    counts("12", "0");
    // The plan is the study.
    plan(&sandbox, "whole", "3..9");
    sandbox.run(&["study", "whole"]).success().stdout(predicates::str::contains("trials     12\n"));
    assert_eq!(trial_lines(&sandbox, "planned"), trial_lines(&sandbox, "whole"));
    assert_eq!(report(&sandbox, "planned"), report(&sandbox, "whole"));
}

#[test]
fn a_plan_says_what_the_study_costs_and_how_clusters_run_it() {
    let sandbox = Sandbox::new();
    let planned =
        sandbox.run(&[&["study", "--plan", "--seeds", "0..1000000", "--out", "s"], &sets(TINY)[..]].concat());
    let text = String::from_utf8(planned.success().get_output().stdout.clone()).unwrap();
    for part in [
        "trials     1000000:",
        " core hours in all",
        "sbatch --array=0-",
        "hq submit --array 0-",
        "parallel.sh s ",
    ] {
        assert!(text.contains(part), "{part:?} is not in {text}");
    }
    assert_eq!(sandbox.files().len(), 2, "the directory and study.json");
}

fn spawn(sandbox: &Sandbox, shard: usize) -> Child {
    Command::new(assert_cmd::cargo::cargo_bin!("cartpole-dqn"))
        .current_dir(sandbox.path("."))
        // Two processes have the same shard.
        .args(["study", "many", "--quiet", "--jobs", "1", "--shard", &format!("{}/8", shard % 8)])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap()
}

#[test]
fn processes_that_are_killed_and_started_again_leave_the_report_of_one() {
    let sandbox = Sandbox::new();
    plan(&sandbox, "many", "0..100");
    plan(&sandbox, "one", "0..100");
    sandbox.run(&["study", "one", "--quiet"]).success();
    let mut children: Vec<Child> = (0..PROCESSES).map(|shard| spawn(&sandbox, shard)).collect();
    std::thread::sleep(Duration::from_millis(200));
    for child in children.iter_mut().step_by(3) {
        child.kill().unwrap();
    }
    for (shard, mut child) in children.into_iter().enumerate() {
        while !child.wait().unwrap().success() {
            child = spawn(&sandbox, shard);
        }
    }
    let mut lines = trial_lines(&sandbox, "many");
    // A process that is killed while it writes leaves half a line.
    lines.retain(|line| line.ends_with('}'));
    assert_eq!(lines, trial_lines(&sandbox, "one"));
    assert_eq!(report(&sandbox, "many"), report(&sandbox, "one"));
}

#[test]
fn a_trial_that_the_time_limit_interrupts_is_resumed_and_ends_as_if_it_had_not_been() {
    let sandbox = Sandbox::new();
    let plan = |out: &str| {
        let study = ["study", "--plan", "--quiet", "--seeds", "0..2", "--out", out];
        let long = [
            "budget.steps=100000",
            "replay.capacity=1000",
            "evaluation.every_steps=5000",
            "stop_when_lasting_steps=null",
        ];
        sandbox.run(&[&study[..], &sets(TINY), &sets(&long)].concat()).success();
    };
    plan("stopped");
    let limited = ["study", "stopped", "--quiet", "--jobs", "2", "--time-limit", "300ms"];
    let stopped = sandbox.run(&limited).code(143);
    let message = String::from_utf8(stopped.get_output().stderr.clone()).unwrap();
    assert!(message.contains("stopped: 0 of 2 trials are finished"), "{message}");
    assert!(sandbox.path("stopped/unfinished/0-0.safetensors").exists());
    sandbox.run(&["study", "stopped", "--quiet"]).success();
    assert!(!sandbox.path("stopped/unfinished").exists());
    plan("whole");
    sandbox.run(&["study", "whole", "--quiet"]).success();
    assert_eq!(trial_lines(&sandbox, "stopped"), trial_lines(&sandbox, "whole"));
}

#[test]
fn an_interrupted_trial_of_another_config_is_trained_from_its_start() {
    let sandbox = Sandbox::new();
    plan(&sandbox, "s", "0..2");
    plan(&sandbox, "whole", "0..2");
    sandbox.write("s/unfinished/0-0.safetensors", "not a checkpoint");
    sandbox.train(&["--out", "run"]).success();
    sandbox.write(
        "s/unfinished/0-1.safetensors",
        std::fs::read(sandbox.path("run/checkpoints/last.safetensors")).unwrap(),
    );
    sandbox.run(&["study", "s", "--quiet"]).success();
    sandbox.run(&["study", "whole", "--quiet"]).success();
    assert_eq!(trial_lines(&sandbox, "s"), trial_lines(&sandbox, "whole"));
}

#[test]
fn a_trial_that_two_processes_computed_differently_is_named_with_both() {
    let sandbox = Sandbox::new();
    plan(&sandbox, "s", "0..2");
    sandbox.run(&["study", "s", "--quiet"]).success();
    let file = trial_file(&sandbox, "s");
    // The same line again is no harm.
    sandbox.write("s/trials/zeus-1-abc.jsonl", sandbox.read(&file));
    sandbox.run(&["report", "s"]).success();
    std::fs::remove_file(sandbox.path("s/trials/zeus-1-abc.jsonl")).unwrap();
    let other = trial_lines(&sandbox, "s")[3].replace("\"updates\":", "\"updates\":1");
    sandbox.write("s/trials/zeus-1-abc.jsonl", other + "\n");
    let words = ["s/trials/zeus-1-abc.jsonl line 1", &file, "seed 1", "with other bytes", "machines"];
    sandbox.refuses(&["study", "s", "--quiet"], &words);
    sandbox.refuses(&["study", "s", "--status"], &words);
}

#[test]
fn a_study_of_another_version_is_reported_and_not_continued() {
    let sandbox = Sandbox::new();
    plan(&sandbox, "s", "0..2");
    sandbox.run(&["study", "s", "--quiet"]).success();
    edit_lines(&sandbox, "s", |lines| lines.truncate(2));
    let mut manifest = sandbox.json("s/study.json");
    manifest["version"] = json!("0.0.1");
    sandbox.write("s/study.json", manifest.to_string());
    sandbox.refuses(&["study", "s"], &["directory s", "of version 0.0.1", "other bits"]);
    sandbox.run(&["study", "s", "--status"]).success();
    sandbox.run(&["report", "s"]).success();
}

#[test]
fn a_plan_that_somebody_has_changed_is_checked_before_it_is_run() {
    let sandbox = Sandbox::new();
    plan(&sandbox, "s", "0..2");
    let manifest = sandbox.json("s/study.json");
    let refuses = |pointer: &str, value: serde_json::Value, words: &[&str]| {
        let mut changed = manifest.clone();
        *changed.pointer_mut(pointer).unwrap() = value;
        sandbox.write("s/study.json", changed.to_string());
        sandbox.refuses(&["study", "s"], &[&["directory s", "study.json"], words].concat());
    };
    refuses("/configs/1/config/gamma", json!(5), &["not allowed", "`gamma`", "from 0 to 1"]);
    refuses("/configs/1/name", manifest["configs"][0]["name"].clone(), &["two of one name"]);
    refuses("/seeds/end", json!(u64::MAX), &["at most 1000000"]);
    refuses("/seeds/start", json!(3), &["3..2", "ascending"]);
    refuses("/configs", json!([]), &["no config"]);
}

#[test]
fn trials_beyond_the_seeds_of_the_study_are_ignored_and_counted() {
    let sandbox = Sandbox::new();
    plan(&sandbox, "large", "0..4");
    sandbox.run(&["study", "large", "--quiet"]).success();
    plan(&sandbox, "small", "0..2");
    let file = trial_file(&sandbox, "large");
    sandbox.write("small/trials/large.jsonl", sandbox.read(&file));
    let status = sandbox.run(&["study", "small", "--status"]).success();
    let status =
        status.stderr(predicates::str::contains("4 trials with other seeds than those of study.json"));
    status.stdout(predicates::str::contains("all                     4        0"));
}
