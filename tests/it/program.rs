//! Runs whose environment is another program: `adapters/example.c`, and programs that fail when they are told to.

use std::fs;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::sync::OnceLock;
use std::thread::sleep;
use std::time::{Duration, Instant};

use predicates::prelude::*;
use serde_json::json;

use crate::cli::{Sandbox, TINY, sets};
use crate::resume::assert_same_runs;
use crate::study::trial_lines;

/// A program in C, compiled. A machine that builds Rust has a C compiler, and need not have Python.
pub(crate) fn compiled(source: &str, name: &str) -> String {
    let directory = PathBuf::from(env!("CARGO_TARGET_TMPDIR"));
    let source = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(source);
    let (own, program) = (directory.join(format!("{name}-{}", std::process::id())), directory.join(name));
    let compiled = Command::new("cc")
        .args(["-O2", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off", "-o"])
        .args([own.as_os_str(), source.as_ref(), "-lm".as_ref()])
        .status();
    assert!(compiled.unwrap().success());
    // Another test process may be running it.
    fs::rename(own, &program).unwrap();
    program.display().to_string()
}

/// The example in C.
pub(crate) fn example() -> &'static str {
    static EXAMPLE: OnceLock<String> = OnceLock::new();
    EXAMPLE.get_or_init(|| compiled("adapters/example.c", "dock"))
}

/// Starts `tests/programs/walk.c`, which fails when a file says so.
fn walk() -> String {
    static WALK: OnceLock<String> = OnceLock::new();
    format!("exec '{}' \"$@\"\n", WALK.get_or_init(|| compiled("tests/programs/walk.c", "walk")))
}

/// A sandbox with `train.json`, whose environment is this command.
pub(crate) fn sandbox(command: &[&str]) -> Sandbox {
    let sandbox = Sandbox::new();
    sandbox.write("walk.sh", walk());
    let environment = json!({"command": command});
    let config = json!({
        "environment": environment, "observation_divisors": null, "replay": {"mirror": false},
        "optimizer": {"schedule": null},
    });
    sandbox.write("train.json", config.to_string());
    sandbox
}

const WALK: [&str; 2] = ["sh", "walk.sh"];

pub(crate) fn train<'a>(more: &[&'a str]) -> Vec<&'a str> {
    [&["train", "--config", "train.json"], &sets(TINY)[..], more].concat()
}

#[test]
fn a_program_is_trained_on_and_its_run_keeps_what_it_said_of_its_task() {
    let sandbox = sandbox(&[example()]);
    sandbox.run(&train(&["--out", "a"])).success();
    sandbox.run(&train(&["--out", "b", "--set", "environment.processes=3"])).success();
    // In how many processes the policy is evaluated changes nothing.
    assert_eq!(sandbox.read("a/metrics.jsonl"), sandbox.read("b/metrics.jsonl"));
    let weights = |run: &str| sandbox.json(&format!("{run}/summary.json"))["weights_sha256"].clone();
    assert_eq!(weights("a"), weights("b"));
    let config = sandbox.json("a/config.json");
    assert_eq!(config["environment"]["task"]["actions"], json!(["left", "nothing", "right"]));
    assert_eq!(config["environment"]["task"]["return_range"], json!([-200.0, 0.0]));
    // A config that has been recorded is one that the user can give.
    sandbox.write("again/train.json", sandbox.read("a/config.json"));
    sandbox.run(&["train", "--config", "again/train.json", "--out", "c"]).success();
    assert_same_runs(&sandbox, "a", "c");
}

#[test]
fn a_run_on_a_program_that_is_killed_and_resumed_is_the_undisturbed_run() {
    let sandbox = sandbox(&[example()]);
    let budget = ["--quiet", "--set", "budget.steps=4000", "--set", "checkpoint.every_steps=700"];
    sandbox.run(&train(&[&["--out", "whole"], &budget[..]].concat())).success();
    let mut child = Command::new(assert_cmd::cargo::cargo_bin!("cartpole-dqn"))
        .current_dir(sandbox.path("."))
        .args(train(&[&["--out", "killed"], &budget[..]].concat()))
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let previous = sandbox.path("killed/checkpoints/previous.safetensors");
    let start = Instant::now();
    while !previous.exists() {
        assert!(start.elapsed() < Duration::from_secs(60));
        sleep(Duration::from_millis(1));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    sandbox.run(&["train", "--resume", "killed", "--quiet", "--allow-command"]).success();
    assert_same_runs(&sandbox, "whole", "killed");
}

#[test]
fn a_program_that_fails_leaves_a_checkpoint_from_which_its_run_is_resumed_exactly() {
    let sandbox = sandbox(&WALK);
    sandbox.run(&train(&["--out", "whole"])).success();
    fs::remove_file(sandbox.path("first")).unwrap();
    sandbox.write("broken", "117");
    let failed = sandbox.run(&train(&["--out", "run"])).code(1);
    let message = String::from_utf8(failed.get_output().stderr.clone()).unwrap();
    for expected in [
        "[sh walk.sh] the walker stumbles",
        "error: the environment sh walk.sh: it ended (exit status: 9) and did not answer `step ",
        "train --resume run --allow-command",
    ] {
        assert!(message.contains(expected), "{expected:?} is not in: {message}");
    }
    assert_eq!(
        message.matches("the walker stumbles").count(),
        1,
        "what was shown is not repeated: {message}"
    );
    let resume = ["train", "--resume", "run", "--allow-command"];
    sandbox.write("moved", "0.5");
    sandbox.write("broken", "0");
    let before = sandbox.files();
    sandbox.run(&resume).code(2).stderr(predicate::str::contains("the environment is not deterministic"));
    assert!(sandbox.files() == before, "nothing is changed");
    fs::remove_file(sandbox.path("moved")).unwrap();
    sandbox.run(&resume).success().stderr(predicate::str::contains("resuming at step 116"));
    assert_same_runs(&sandbox, "whole", "run");
}

#[test]
fn no_file_starts_a_program_unless_the_user_allows_it() {
    let sandbox = sandbox(&WALK);
    sandbox.run(&train(&["--out", "run"])).success();
    sandbox.write("walk.sh", ": > started");
    for command in [
        &["train", "--resume", "run", "--set", "budget.steps=300"][..],
        &["eval", "run"],
        &["eval", "run/checkpoints/last.safetensors"],
        &["watch", "run"],
        &["render", "run", "-o", "run.gif"],
        &["verify", "run"],
    ] {
        sandbox.refuses(command, &["names a program as its environment", "--allow-command: sh walk.sh"]);
    }
    // These need no program.
    sandbox.run(&["inspect", "run"]).success();
    sandbox.run(&["runs", "."]).success().stdout(predicate::str::contains("run"));
    sandbox.run(&["report", "run"]).success();
    sandbox.run(&["report", "run", "--html", "page.html"]).success();
    sandbox.run(&["config", "show", "--config", "run/config.json"]).success();
    assert!(!sandbox.path("started").exists());
    sandbox.write("walk.sh", walk());
    let said = "note: checkpoint run/checkpoints/best.safetensors names this program as its environment, and --allow-command \
                starts it: sh walk.sh\n";
    sandbox.run(&["eval", "run", "--allow-command", "--episodes", "3"]).success().stderr(said);
    sandbox.run(&["verify", "run", "--allow-command", "--quiet"]).success();
    let resume = ["train", "--resume", "run", "--allow-command", "--set", "budget.steps=300"];
    sandbox.run(&resume).success();
    sandbox
        .run(&["render", "run", "-o", "run.gif", "--allow-command"])
        .code(1)
        .stderr(predicate::str::contains("the environment sh walk.sh"));
    assert!(!sandbox.path("run.gif").exists());
}

#[test]
fn a_program_with_another_task_than_that_of_its_run_is_refused() {
    let sandbox = sandbox(&WALK);
    sandbox.run(&train(&["--out", "run"])).success();
    sandbox.write("walk.sh", walk().replace("\"$@\"", "31"));
    sandbox.run(&["eval", "run", "--allow-command"]).code(1).stderr(
        predicate::str::contains("another task than before")
            .and(predicate::str::contains("\"max_steps\":31")),
    );
}

#[test]
fn a_study_of_a_program_has_the_same_bytes_with_any_number_of_jobs() {
    let sandbox = sandbox(&[example()]);
    for (out, jobs) in [("a", "1"), ("b", "3")] {
        let study = [
            "study",
            "--config",
            "train.json",
            "--seeds",
            "0..3",
            "--vary",
            "gamma=0.9,0.99",
            "--jobs",
            jobs,
        ];
        sandbox.run(&[&study[..], &["--out", out], &sets(TINY)].concat()).success();
    }
    assert_eq!(trial_lines(&sandbox, "a"), trial_lines(&sandbox, "b"));
    let refused = sandbox.run(&["study", "a"]).code(2);
    assert!(String::from_utf8_lossy(&refused.get_output().stderr).contains("--allow-command"));
    sandbox.run(&["study", "a", "--allow-command"]).success();
    assert_eq!(sandbox.json("a/study.json")["configs"][0]["task"]["id"], "Dock");
    sandbox.run(&["report", "a"]).success();
}

#[test]
fn a_config_of_a_program_is_checked_before_anything_is_written() {
    let sandbox = sandbox(&[example()]);
    let command = format!("environment.command=[{}]", json!(example()));
    for (sets, words) in [
        (
            &["environment={\"command\": []}"][..],
            &["`environment.command` is []", "a list of strings, the program first"][..],
        ),
        (&["environment={}"], &["`environment` is {}", "a program as an object with `command`"]),
        (&["environment.command=python3 x.py"], &["a list of strings"]),
        (&["environment.command=[1]"], &["a list of strings"]),
        (&["environment.processes=0"], &["`environment.processes` is 0", "from 1 to 256"]),
        (&["environment.timeout_seconds=0"], &["from 1 to 86400"]),
        (&["environment.shell=true"], &["unknown key `environment.shell`", "`command`, `processes`"]),
        (&["environment.task={\"id\": \"x\"}"], &["`environment.task`", "that a run has recorded"]),
        (&["environment=Dock"], &["`environment` is \"Dock\"", "\"CartPole-v1\"", "a program as an object"]),
        (
            &["environment=CartPole-v1", "environment.processes=2"],
            &["misplaced key `environment.processes`", "with `command`"],
        ),
        (
            &[&command, "observation_divisors=[1,1,1]"],
            &["`observation_divisors`", "each of the 2 observation coordinates"],
        ),
    ] {
        sandbox.refuses(&train(&self::sets(sets)), words);
    }
    // A name takes the place of the program, and a command that of everything that a lower layer says of one.
    sandbox.run(&train(&["--out", "a", "--set", "environment=CartPole-v1"])).success();
    assert_eq!(sandbox.json("a/config.json")["environment"], "CartPole-v1");
    let shown = sandbox.run(&[
        "config",
        "show",
        "--json",
        "--config",
        "train.json",
        "--set",
        "environment.processes=2",
    ]);
    let config: serde_json::Value = serde_json::from_slice(&shown.success().get_output().stdout).unwrap();
    assert_eq!(config["environment"], json!({"command": [example()], "processes": 2, "timeout_seconds": 60}));
    for command in ["./missing", "/"] {
        let command = format!("environment.command=[{}]", json!(command));
        let before = sandbox.files();
        sandbox
            .run(&train(&["--out", "new", "--set", &command]))
            .code(1)
            .stderr(predicate::str::contains("cannot be started"));
        assert!(sandbox.files() == before);
    }
}

/// A program that ignores the end of its standard input, and every signal that it can.
const STUBBORN: &str = r#"
trap '' TERM HUP INT
read -r _
echo '{"protocol": 1, "name": "Stubborn", "observation_size": 1, "actions": 2, "max_steps": 1000000}'
while read -r request _; do
    case $request in
        reset) echo reset 0 ;;
        *) echo step 0 0 0 0; : > stepped ;;
    esac
done
sleep 600
"#;

#[test]
fn a_program_ends_when_the_run_is_killed() {
    let sandbox = sandbox(&["sh", "-c", STUBBORN]);
    let mut child = Command::new(assert_cmd::cargo::cargo_bin!("cartpole-dqn"))
        .current_dir(sandbox.path("."))
        .args(train(&["--out", "run", "--quiet", "--set", "budget.steps=1000000000"]))
        .spawn()
        .unwrap();
    let start = Instant::now();
    while !sandbox.path("stepped").exists() {
        assert!(start.elapsed() < Duration::from_secs(60));
        sleep(Duration::from_millis(5));
    }
    let of_the_sandbox = || {
        let entries = fs::read_dir("/proc").into_iter().flatten().flatten();
        let is_there = |entry: &fs::DirEntry| {
            fs::read_link(entry.path().join("cwd"))
                .is_ok_and(|path| path == sandbox.path(".").canonicalize().unwrap())
        };
        entries.filter(is_there).count()
    };
    assert!(of_the_sandbox() >= 2, "the run, its program and the program's guard");
    child.kill().unwrap();
    child.wait().unwrap();
    let start = Instant::now();
    while of_the_sandbox() > 0 {
        assert!(start.elapsed() < Duration::from_secs(20), "{} processes are left", of_the_sandbox());
        sleep(Duration::from_millis(50));
    }
}
