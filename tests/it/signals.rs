//! Ctrl-C and its kin.

use std::process::{Child, Command, Output, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use crate::cli::{Sandbox, TINY, sets};
use crate::resume::assert_same_runs;

/// `train` in the background, its first episode over.
fn start(sandbox: &Sandbox, arguments: &[&str]) -> Child {
    let child = Command::new(assert_cmd::cargo::cargo_bin!("cartpole-dqn"))
        .current_dir(sandbox.path("."))
        .args([&["train", "--out", "run"], &sets(TINY)[..], arguments].concat())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    wait_until(|| sandbox.path("run/metrics.jsonl").metadata().is_ok_and(|file| file.len() > 0));
    child
}

fn wait_until(holds: impl Fn() -> bool) {
    let start = Instant::now();
    while !holds() {
        assert!(start.elapsed() < Duration::from_secs(60));
        sleep(Duration::from_millis(5));
    }
}

/// A shell has `kill`; a machine need not have it as a program.
pub(crate) fn kill(child: &Child, signal: &str) {
    let line = format!("kill {signal} {}", child.id());
    assert!(Command::new("sh").args(["-c", &line]).status().unwrap().success());
}

/// What the process leaves, whose work would take hours if no signal ended it.
fn end(mut child: Child) -> Output {
    let start = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if start.elapsed() > Duration::from_secs(60) {
            child.kill().unwrap();
            panic!("the signal has not ended the process");
        }
        sleep(Duration::from_millis(5));
    }
    child.wait_with_output().unwrap()
}

#[test]
fn a_signal_stops_a_run_with_a_checkpoint_and_its_own_exit_code() {
    for (signal, exit_code) in [("-INT", 130), ("-TERM", 143), ("-HUP", 143)] {
        let sandbox = Sandbox::new();
        let child = start(&sandbox, &["--set", "budget.steps=1000000000"]);
        kill(&child, signal);
        let output = end(child);
        let message = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(exit_code), "{message}");
        assert!(output.stdout.is_empty());
        assert!(message.contains("stopped after step ") && !message.contains("error"), "{message}");
        assert!(!sandbox.path("run/summary.json").exists());
        assert!(!sandbox.read("run/metrics.jsonl").contains("\"end\""));
        assert!(message.contains(" train --resume run\n"), "{message}");
        let steps = message.split("stopped after step ").nth(1).and_then(|text| text.split(';').next());
        let budget = format!("budget.steps={}", steps.unwrap().parse::<u64>().unwrap() + 60);
        sandbox.run(&["train", "--quiet", "--resume", "run", "--set", &budget]).success();
        sandbox.train(&["--quiet", "--out", "whole", "--set", &budget]).success();
        assert_same_runs(&sandbox, "whole", "run");
    }
}

#[test]
fn json_says_how_far_a_stopped_run_came() {
    let sandbox = Sandbox::new();
    let child = start(&sandbox, &["--json", "--set", "budget.steps=1000000000"]);
    kill(&child, "-TERM");
    let output = end(child);
    assert_eq!(output.status.code(), Some(143));
    let record: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(record["end_reason"], "interrupted");
}

/// The step in question takes hours.
#[test]
fn a_second_signal_ends_a_run_at_once() {
    let sandbox = Sandbox::new();
    let child = start(&sandbox, &["--set", "learn.updates=4294967295"]);
    kill(&child, "-INT");
    sleep(Duration::from_millis(300));
    kill(&child, "-TERM");
    assert_eq!(end(child).status.code(), Some(143));
}

#[test]
#[cfg(target_os = "linux")]
fn a_run_under_nohup_outlives_its_terminal() {
    let sandbox = Sandbox::new();
    let program = assert_cmd::cargo::cargo_bin!("cartpole-dqn");
    let mut child = Command::new("nohup")
        .current_dir(sandbox.path("."))
        .arg(program)
        .args([&["train", "--out", "run"], &sets(TINY)[..], &["--set", "budget.steps=1000000000"]].concat())
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    wait_until(|| sandbox.path("run/metrics.jsonl").metadata().is_ok_and(|file| file.len() > 0));
    kill(&child, "-HUP");
    sleep(Duration::from_millis(200));
    assert_eq!(child.try_wait().unwrap(), None);
    kill(&child, "-TERM");
    assert_eq!(child.wait().unwrap().code(), Some(143));
}

#[test]
fn a_signal_leaves_no_temporary_file_of_a_trace() {
    let sandbox = Sandbox::with_run();
    for (signal, exit_code) in [("-INT", 130), ("-TERM", 143), ("-HUP", 143)] {
        let before: Vec<_> = sandbox.files().into_keys().collect();
        let child = Command::new(assert_cmd::cargo::cargo_bin!("cartpole-dqn"))
            .current_dir(sandbox.path("."))
            .args(["eval", "--policy", "random", "--episodes", "10000000", "--trace", "trace.jsonl"])
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        wait_until(|| {
            let files = std::fs::read_dir(sandbox.path(".")).unwrap().flatten();
            files.map(|file| file.path()).any(|path| path.extension().is_some_and(|end| end == "tmp"))
        });
        kill(&child, signal);
        assert_eq!(end(child).status.code(), Some(exit_code));
        assert_eq!(before, sandbox.files().into_keys().collect::<Vec<_>>());
    }
}
