//! What happens around a training is no result: programs that are killed, signals to one process or to all, disks that cannot
//! be written. Nothing of it is recorded, and the same command leaves what an undisturbed one leaves.

use std::fs;
use std::os::unix::process::ExitStatusExt;
use std::process::{Child, Command, ExitStatus, Output, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use predicates::prelude::*;
use rustix::process::{Pid, Signal, kill_process};

use crate::cli::{Sandbox, TINY, sets};
use crate::program::{example, sandbox, train};
use crate::resume::assert_same_runs;
use crate::study::{trial_file, trial_lines};

/// Long enough to be hit, and with checkpoints on the way.
const LONG: [&str; 3] = ["budget.steps=3000", "evaluation.every_steps=500", "checkpoint.every_steps=300"];

fn study<'a>(out: &'a str, more: &[&'a str]) -> Vec<&'a str> {
    let study = ["study", "--config", "train.json", "--seeds", "0..3", "--jobs", "2", "--out", out];
    [&study[..], &sets(TINY), &sets(&LONG), more].concat()
}

fn spawn(sandbox: &Sandbox, arguments: &[&str]) -> Child {
    Command::new(assert_cmd::cargo::cargo_bin!("cartpole-dqn"))
        .current_dir(sandbox.path("."))
        .args(arguments)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

/// The processes of a sandbox whose command line contains a word.
fn processes(sandbox: &Sandbox, word: &str) -> Vec<Pid> {
    let directory = sandbox.path(".").canonicalize().unwrap();
    let is_own = |entry: &fs::DirEntry| {
        let command = fs::read(entry.path().join("cmdline")).unwrap_or_default();
        let command = String::from_utf8_lossy(&command).replace('\0', " ");
        fs::read_link(entry.path().join("cwd")).is_ok_and(|path| path == directory) && command.contains(word)
    };
    let entries = fs::read_dir("/proc").unwrap().flatten().filter(is_own);
    entries.filter_map(|entry| Pid::from_raw(entry.file_name().to_str()?.parse().ok()?)).collect()
}

/// Waits until so many programs run.
fn programs(sandbox: &Sandbox, count: usize) -> Vec<Pid> {
    let start = Instant::now();
    loop {
        let found = processes(sandbox, "dock");
        if found.len() >= count {
            return found;
        }
        assert!(start.elapsed() < Duration::from_secs(60));
        sleep(Duration::from_millis(2));
    }
}

/// Some of them may have ended.
fn kill_all(processes: Vec<Pid>, signal: Signal) {
    for process in processes {
        let _ = kill_process(process, signal);
    }
}

fn end(child: Child) -> (ExitStatus, String) {
    let Output { status, stderr, .. } = child.wait_with_output().unwrap();
    (status, String::from_utf8(stderr).unwrap())
}

fn report(sandbox: &Sandbox, study: &str) -> String {
    let out = format!("{study}-report");
    sandbox.run(&["report", study, "--out", &out]).success();
    sandbox.read(&format!("{out}/report.json"))
}

/// Runs a study until it is complete, and compares it with one that nobody disturbed.
fn ends_as_if_nothing_had_happened(sandbox: &Sandbox, disturbed: &[&str]) {
    sandbox.run(disturbed).success();
    sandbox.run(&study("whole", &["--quiet"])).success();
    assert_eq!(trial_lines(sandbox, "s"), trial_lines(sandbox, "whole"));
    assert_eq!(report(sandbox, "s"), report(sandbox, "whole"));
    assert!(!sandbox.path("s/unfinished").exists());
}

#[test]
fn a_study_whose_programs_are_killed_records_nothing_and_trains_the_trials_again() {
    for signal in [Signal::KILL, Signal::TERM] {
        for pause in [0, 70, 230] {
            let sandbox = sandbox(&[example()]);
            let child = spawn(&sandbox, &study("s", &["--quiet"]));
            programs(&sandbox, 2);
            sleep(Duration::from_millis(pause));
            kill_all(processes(&sandbox, "dock"), signal);
            let (status, message) = end(child);
            let recorded =
                if sandbox.path("s/trials").exists() { trial_lines(&sandbox, "s") } else { Vec::new() };
            assert!(recorded.iter().all(|line| line.contains("\"error\":null")), "{recorded:?}");
            if recorded.len() < 3 && sandbox.path("s/study.json").exists() {
                assert_eq!(status.code(), Some(1), "{message}");
                assert!(
                    message.contains("the environment ") && message.contains("same command"),
                    "{message}"
                );
                let shown = sandbox.run(&["study", "s", "--status"]).success();
                // Where a line of the text breaks depends on the length of the directory's path.
                let shown = String::from_utf8_lossy(&shown.get_output().stdout).into_owned();
                let shown = shown.split_whitespace().collect::<Vec<_>>().join(" ");
                assert!(shown.contains("ended without a result"), "{shown}");
                assert!(shown.contains("dock: it ended (signal: "), "{shown}");
                let reported = sandbox.run(&["report", "s", "--out", "report"]);
                let output = reported.get_output();
                let text = String::from_utf8([&output.stdout[..], &output.stderr].concat()).unwrap();
                assert!(text.contains("ended without a result"), "{text}");
            }
            ends_as_if_nothing_had_happened(&sandbox, &study("s", &["--quiet"]));
        }
    }
}

/// As systemd, a container or a scheduler sends it: to every process, and the programs can be first.
#[test]
fn a_signal_to_the_programs_and_then_to_the_process_stops_it_with_the_code_of_the_signal() {
    for (signal, exit_code) in [(Signal::TERM, 143), (Signal::INT, 130)] {
        for pause in [0, 150] {
            let sandbox = sandbox(&[example()]);
            let endless = ["--set", "budget.steps=100000000"];
            for arguments in
                [train(&[&["--out", "run", "--quiet"], &endless[..]].concat()), study("s", &endless)]
            {
                let child = spawn(&sandbox, &arguments);
                programs(&sandbox, 2);
                sleep(Duration::from_millis(pause));
                kill_all(processes(&sandbox, "dock"), Signal::KILL);
                sleep(Duration::from_millis(50));
                let _ = kill_process(Pid::from_child(&child), signal);
                let (status, message) = end(child);
                assert_eq!(status.code(), Some(exit_code), "{message}");
            }
            let files = sandbox.path("s/trials");
            assert!(
                !files.exists() || fs::read_dir(files).unwrap().count() == 0,
                "a line of what is no result"
            );
        }
    }
}

#[test]
fn a_run_under_a_signal_to_all_is_resumed_to_the_bytes_of_an_undisturbed_one() {
    let sandbox = sandbox(&[example()]);
    sandbox.run(&train(&[&["--out", "whole", "--quiet"], &sets(&LONG)[..]].concat())).success();
    let child = spawn(&sandbox, &train(&[&["--out", "run", "--quiet"], &sets(&LONG)[..]].concat()));
    programs(&sandbox, 2);
    let all = processes(&sandbox, "");
    kill_all(all, Signal::TERM);
    let (status, message) = end(child);
    if status.code() != Some(0) {
        assert_eq!(status.code(), Some(143), "{message}");
        sandbox.run(&["train", "--resume", "run", "--quiet", "--allow-command"]).success();
    }
    assert_same_runs(&sandbox, "whole", "run");
}

#[test]
fn a_killed_study_of_a_program_resumes_its_trials_from_their_newest_checkpoints() {
    let sandbox = sandbox(&[example()]);
    let mut child = spawn(&sandbox, &study("s", &["--quiet"]));
    let start = Instant::now();
    while !sandbox.path("s/unfinished/0-0.safetensors").exists() {
        assert!(start.elapsed() < Duration::from_secs(60));
        sleep(Duration::from_millis(1));
    }
    child.kill().unwrap();
    assert_eq!(child.wait().unwrap().signal(), Some(9));
    // As a process leaves it that is killed while it writes.
    sandbox.write("s/unfinished/.writing-abc.tmp", "half");
    ends_as_if_nothing_had_happened(&sandbox, &study("s", &["--quiet"]));
}

#[test]
fn a_signal_ends_a_command_at_once_whose_program_says_nothing() {
    let sandbox = sandbox(&["./dock"]);
    fs::copy(example(), sandbox.path("dock")).unwrap();
    sandbox.run(&study("planned", &["--plan", "--quiet"])).success();
    sandbox.run(&train(&["--out", "run", "--quiet"])).success();
    sandbox.write("dock", "#!/bin/sh\nexec sleep 600\n");
    for arguments in [
        train(&["--out", "new"]),
        study("s", &[]),
        vec!["study", "planned", "--allow-command"],
        vec!["study", "planned", "--allow-command", "--plan"],
        vec!["train", "--resume", "run", "--allow-command", "--set", "budget.steps=300"],
        vec!["eval", "run", "--allow-command"],
    ] {
        let before = sandbox.files();
        let child = spawn(&sandbox, &arguments);
        let start = Instant::now();
        while processes(&sandbox, "sleep 600").is_empty() {
            assert!(start.elapsed() < Duration::from_secs(60), "{arguments:?}");
            sleep(Duration::from_millis(2));
        }
        let start = Instant::now();
        kill_process(Pid::from_child(&child), Signal::TERM).unwrap();
        let (status, message) = end(child);
        assert_eq!(status.code(), Some(143), "{arguments:?}: {message}");
        assert!(start.elapsed() < Duration::from_secs(10), "{arguments:?}: {:?}", start.elapsed());
        assert!(sandbox.files() == before, "{arguments:?} has written something");
        kill_all(processes(&sandbox, "sleep 600"), Signal::KILL);
        while !processes(&sandbox, "sleep 600").is_empty() {
            sleep(Duration::from_millis(2));
        }
    }
}

#[test]
fn a_program_that_cannot_be_started_leaves_its_trials_to_the_next_command() {
    let sandbox = sandbox(&["./dock"]);
    fs::copy(example(), sandbox.path("dock")).unwrap();
    sandbox.run(&study("s", &["--plan", "--quiet"])).success();
    fs::rename(sandbox.path("dock"), sandbox.path("away")).unwrap();
    let resumed = ["study", "s", "--allow-command", "--quiet"];
    let failed = sandbox.run(&resumed).code(1);
    failed
        .stderr(predicate::str::contains("0 of 3 trials").and(predicate::str::contains("cannot be started")));
    let why = predicate::str::contains("3 ×: the environment ./dock: cannot be started");
    sandbox.run(&["study", "s", "--status"]).success().stdout(why.clone());
    sandbox.run(&["report", "s"]).code(2).stderr(why);
    fs::rename(sandbox.path("away"), sandbox.path("dock")).unwrap();
    ends_as_if_nothing_had_happened(&sandbox, &resumed);
}

#[test]
fn lines_of_an_earlier_version_that_record_a_circumstance_are_ignored_and_their_trials_trained() {
    let sandbox = sandbox(&[example()]);
    sandbox.run(&study("s", &["--quiet"])).success();
    let lines = trial_lines(&sandbox, "s");
    let circumstance = |seed: u64| {
        format!(
            "{{\"config\":\"train\",\"seed\":{seed},\"error\":\"the environment ./dock: it ended (signal: 15 (SIGTERM)) and did \
             not answer `step 1`\",\"summary\":null,\"best\":null,\"final\":null,\"evaluations\":[]}}\n"
        )
    };
    let before = report(&sandbox, "s");
    sandbox.write("s/trials/a-before.jsonl", circumstance(0) + &circumstance(2));
    sandbox.write("s/trials/z-after.jsonl", circumstance(1));
    assert_eq!(report(&sandbox, "s"), before);
    sandbox
        .run(&["study", "s", "--status"])
        .success()
        .stdout(predicate::str::contains("all        3        0       0"))
        .stderr(predicate::str::contains("3 lines of an earlier version"));
    fs::remove_file(sandbox.path("s/trials/z-after.jsonl")).unwrap();
    fs::remove_file(sandbox.path("s/trials/a-before.jsonl")).unwrap();
    let file = trial_file(&sandbox, "s");
    sandbox.write(&file, format!("{}\n{}", lines[0], circumstance(1)));
    sandbox.run(&study("s", &["--quiet"])).success();
    let mut found = trial_lines(&sandbox, "s");
    found.retain(|line| !line.contains("SIGTERM"));
    assert_eq!(found, lines);
    assert_eq!(report(&sandbox, "s"), before);
}

#[test]
fn what_is_left_in_a_complete_study_goes_with_the_next_command() {
    let sandbox = sandbox(&[example()]);
    sandbox.run(&study("s", &["--quiet"])).success();
    for left in ["0-0.safetensors", "0-1.txt", ".writing-abc.tmp"] {
        sandbox.write(&format!("s/unfinished/{left}"), "left by a process that was killed");
    }
    sandbox.run(&["study", "s", "--status"]).success().stdout(predicate::str::contains("last").not());
    sandbox.run(&study("s", &["--quiet"])).success();
    assert!(!sandbox.path("s/unfinished").exists());
}

#[test]
fn a_stopped_trial_that_cannot_be_kept_is_not_said_to_be_resumed() {
    let sandbox = Sandbox::new();
    let endless = ["study", "--seeds", "0..2", "--out", "s", "--set", "budget.steps=4000000000"];
    sandbox.run(&[&endless[..], &["--plan", "--quiet"]].concat()).success();
    sandbox.write("s/unfinished", "in the way");
    let stopped = sandbox.run(&["study", "s", "--jobs", "2", "--time-limit", "300ms"]).code(143);
    let message = String::from_utf8(stopped.get_output().stderr.clone()).unwrap();
    assert!(message.contains("cannot write s/unfinished/0-"), "{message}");
    assert!(message.contains("have no checkpoint") && !message.contains("resumed from"), "{message}");
}

#[test]
fn a_study_that_cannot_be_written_names_no_option_that_was_not_typed() {
    let sandbox = Sandbox::new();
    sandbox
        .run(&[&["study", "--seeds", "0..2", "--out", "s", "--plan", "--quiet"], &sets(TINY)[..]].concat());
    sandbox.write("s/trials", "a file");
    let refused = sandbox.run(&["study", "s"]).code(2);
    let message = String::from_utf8(refused.get_output().stderr.clone()).unwrap();
    assert!(message.contains("s/trials") && !message.contains("--out"), "{message}");
}
