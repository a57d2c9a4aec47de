//! What somebody else wrote: tasks that are none, wherever they are read, and commands that would forge a message.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::time::Duration;

use cartpole_dqn::config::Config;
use cartpole_dqn::env::Spec;
use cartpole_dqn::env::program::Programs;
use cartpole_dqn::run::{Header, RunDir};
use cartpole_dqn::study::Study;
use cartpole_dqn::text::{shell_line, steers};
use proptest::prelude::*;
use serde_json::{Value, json};

use crate::cli::{Sandbox, TINY, sets};

fn task() -> Value {
    json!({
        "id": "Walk", "observation_size": 2, "num_actions": 2, "max_steps": 30, "solved_return": -5.0,
        "return_range": [-30.0, 0.0], "steps_per_second": 50.0, "actions": ["left", "right"], "observations": ["x", "v"],
        "mirror": {"observation": [[0, -1.0], [1, -1.0]], "actions": [1, 0]},
    })
}

/// What is changed in a task, and what is said of it.
fn hostile() -> Vec<(&'static str, Value, &'static str)> {
    let names = |count: usize| vec!["n"; count];
    vec![
        ("observation_size", json!(0), "the size of an observation"),
        ("observation_size", json!(3), "each number of an observation must have a name"),
        ("observation_size", json!(1_000_000_000), "the size of an observation"),
        ("num_actions", json!(0), "the number of actions"),
        ("num_actions", json!(257), "the number of actions"),
        ("max_steps", json!(0), "`max_steps`"),
        ("max_steps", json!(4_000_000_000_u32), "`max_steps`"),
        ("solved_return", json!(1e300), "`solved_return`"),
        ("solved_return", json!(0.5), "`solved_return` must be in `return_range`"),
        ("solved_return", json!(-31), "`solved_return` must be in `return_range`"),
        ("return_range", json!([0.0, 5e-324]), "`return_range`"),
        ("return_range", json!([-1e308, 1e308]), "`return_range`"),
        ("return_range", json!([0.0, -30.0]), "`return_range`"),
        ("return_range", json!([-5.0, -5.0]), "`return_range`"),
        ("return_range", json!([1e16, 1e16 + 2.0]), "`return_range`"),
        ("return_range", json!([null, 0.0]), "null"),
        ("steps_per_second", json!(0.0), "`steps_per_second`"),
        ("steps_per_second", json!(1e300), "`steps_per_second`"),
        ("id", json!(""), "1 to 100 characters"),
        ("id", json!("a\nb"), "no control characters"),
        ("id", json!("a\u{202e}b"), "hidden"),
        ("id", json!("a\u{200b}b"), "hidden"),
        ("id", json!("n".repeat(1_000_000)), "1 to 100 characters"),
        ("actions", json!(["left"]), "each action must have a name"),
        ("actions", json!(["left", "\u{1b}[2J"]), "no control characters"),
        ("actions", json!(names(300)), "each action must have a name"),
        ("observations", json!(["x", ""]), "1 to 100 characters"),
        ("mirror", json!({"observation": [[7, 1.0], [0, 1.0]], "actions": [0, 1]}), "`mirror`"),
        ("mirror", json!({"observation": [[0, 2.0], [1, 1.0]], "actions": [0, 1]}), "`mirror`"),
    ]
}

/// What reads a task: the name of the reader, and its error.
fn readers(directory: &Path, study: &Value, task: &Value) -> Vec<(&'static str, Option<String>)> {
    let environment = json!({"command": ["sh", "walk.sh"], "task": task});
    let config =
        json!({"environment": environment, "observation_divisors": null, "replay": {"mirror": false}});
    let header = json!({"env_steps": 1, "evaluation": null, "config": config});
    let (run, study_directory) = (directory.join("run"), directory.join("study"));
    fs::create_dir_all(&run).unwrap();
    fs::create_dir_all(&study_directory).unwrap();
    fs::write(run.join("config.json"), config.to_string()).unwrap();
    fs::write(run.join("metrics.jsonl"), "").unwrap();
    let mut study = study.clone();
    study["configs"][0]["config"]["environment"] =
        json!({"command": ["sh", "walk.sh"], "processes": 1, "timeout_seconds": 60, "task": task});
    study["configs"][0]["task"] = task.clone();
    fs::write(study_directory.join("study.json"), study.to_string()).unwrap();
    let mut hello = json!({"protocol": 1});
    for (name, key) in [
        ("name", "id"),
        ("observation_size", "observation_size"),
        ("actions", "num_actions"),
        ("max_steps", "max_steps"),
        ("solved_return", "solved_return"),
        ("return_range", "return_range"),
        ("steps_per_second", "steps_per_second"),
        ("action_names", "actions"),
        ("observation_names", "observations"),
        ("mirror", "mirror"),
    ] {
        hello[name] = task[key].clone();
    }
    fs::write(directory.join("hello.json"), hello.to_string() + "\n").unwrap();
    let answer = format!("read -r _; cat '{}'; read -r _", directory.join("hello.json").display());
    let command = vec!["sh".to_owned(), "-c".into(), answer];
    let programs = Arc::new(Programs::new(command, 1, Duration::from_secs(60), None, |_, _| false));
    let text = |error: &dyn std::fmt::Display| error.to_string();
    vec![
        ("a task alone", serde_json::from_value::<Spec>(task.clone()).err().map(|error| text(&error))),
        ("a program", programs.make().err().map(|error| text(&error))),
        (
            "a config",
            Config::from_layers(Some(("c", &config.to_string())), &[]).err().map(|error| text(&error)),
        ),
        ("a checkpoint", serde_json::from_value::<Header>(header).err().map(|error| text(&error))),
        ("a run", RunDir::open(&run).err().map(|error| text(&error))),
        ("a study", Study::read(&study_directory).err().map(|error| text(&error))),
    ]
}

#[test]
fn no_reader_takes_a_task_that_another_refuses() {
    let sandbox = Sandbox::new();
    let study = [&["study", "--quiet", "--seeds", "0..1", "--out", "s"][..], &sets(TINY)].concat();
    sandbox.run(&study).success();
    let study = sandbox.json("s/study.json");
    let directory = sandbox.path(".");
    assert!(readers(&directory, &study, &task()).iter().all(|(_, error)| error.is_none()));
    for (key, value, expected) in hostile() {
        let mut task = task();
        task[key] = value;
        for (reader, error) in readers(&directory, &study, &task) {
            let error = error.unwrap_or_else(|| panic!("{reader} takes a task with {key} {}", task[key]));
            assert!(error.contains(expected), "{reader}, {key}: {expected:?} is not in: {error}");
            assert!(error.len() < 2000 && !error.chars().any(steers), "{reader}, {key}: {error}");
        }
    }
}

#[test]
fn a_study_whose_task_is_not_that_of_its_environment_is_refused() {
    let sandbox = Sandbox::new();
    let study = [&["study", "--quiet", "--seeds", "0..1", "--out", "s"][..], &sets(TINY)].concat();
    sandbox.run(&study).success();
    sandbox.run(&["report", "s"]).success();
    let good = sandbox.json("s/study.json");
    // The message is one line, whatever stands in the file.
    let mut study = good.clone();
    study["configs"][0]["config"]["loss"] = json!("mse\nnote: all is well");
    sandbox.write("s/study.json", study.to_string());
    let refused = sandbox.run(&["report", "s"]).code(2);
    assert_eq!(String::from_utf8_lossy(&refused.get_output().stderr).lines().count(), 1);
    for (key, value) in
        [("solved_return", json!(1.0)), ("return_range", json!([0.0, 1000.0])), ("id", json!("Other"))]
    {
        let mut study = good.clone();
        study["configs"][0]["task"][key] = value;
        sandbox.write("s/study.json", study.to_string());
        sandbox.refuses(
            &["report", "s"],
            &["study.json", "the task of `cartpole` is not that of its environment"],
        );
    }
}

/// Words of every kind of character that a shell or a terminal could misread; no program has an argument with a NUL.
fn word() -> impl Strategy<Value = String> {
    let odd = "'\"\\$`!*?[]{}()<>|&;#~=%^- \t\n\r\u{1b}\u{7f}\u{85}\u{a0}\u{300}\u{200b}\u{202e}\u{2028}\u{feff}é漢🎈";
    let odd: Vec<char> = odd.chars().collect();
    let character = prop_oneof![
        3 => proptest::sample::select(odd),
        1 => any::<char>().prop_filter("no NUL", |&c| c != '\0'),
        1 => proptest::char::range('a', 'z'),
    ];
    proptest::collection::vec(character, 0..8).prop_map(String::from_iter)
}

/// What a shell makes of a line that ends with the arguments of a program: the words that the program gets.
fn words_of(shell: &str, directory: &Path, line: &str) -> Vec<String> {
    let output = Command::new(shell).args(["-c", line]).current_dir(directory).output().unwrap();
    assert!(output.status.success(), "{line}: {}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).unwrap();
    text.split_terminator('\0').map(String::from).collect()
}

#[test]
fn a_command_that_is_printed_is_one_line_that_a_shell_reads_as_the_command() {
    let directory = tempfile::tempdir().unwrap();
    let has_bash = Command::new("bash").arg("--version").output().is_ok();
    if !has_bash {
        crate::skipped("there is no bash, so commands with control characters are not pasted into one");
    }
    let program = |name: &str| {
        let path = directory.path().join(name);
        fs::write(&path, "#!/bin/sh\nprintf '%s\\0' \"$0\" \"$@\"\n").unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
    };
    let is_name = |name: &String| !name.contains('/');
    let command = (word().prop_filter("a name", is_name), proptest::collection::vec(word(), 0..6));
    proptest!(ProptestConfig::with_cases(64), |((name, arguments) in command)| {
        program(&format!("p{name}"));
        let command: Vec<String> = std::iter::once(format!("./p{name}")).chain(arguments).collect();
        let line = shell_line(&command);
        prop_assert!(!line.chars().any(steers), "{:?}", line);
        if has_bash {
            prop_assert_eq!(&words_of("bash", directory.path(), &line), &command, "{}", line);
        }
        if !line.contains("$'") {
            prop_assert_eq!(&words_of("sh", directory.path(), &line), &command, "{}", line);
        }
    });
}

#[test]
fn the_question_before_allow_command_cannot_be_forged_and_is_whole() {
    let sandbox = Sandbox::with_run();
    let end = format!("the end {}", "of a long command ".repeat(300));
    let evil = ["sh", "-c", "true\nnote: all is well\u{1b}[1A\u{202e}", "it's", &end];
    let mut config = sandbox.json("run/config.json");
    config["environment"] = json!({"command": evil, "task": task()});
    config["observation_divisors"] = Value::Null;
    config["replay"]["mirror"] = json!(false);
    sandbox.write("run/config.json", config.to_string());
    for arguments in [&["train", "--resume", "run"][..], &["verify", "run"]] {
        let refused = sandbox.run(arguments).code(2);
        let message = String::from_utf8(refused.get_output().stderr.clone()).unwrap();
        let command = evil.map(String::from);
        let question = format!("add --allow-command: {}\n", shell_line(&command));
        assert!(message.ends_with(&question), "{message}");
        assert_eq!(message.lines().count(), 1, "{message}");
        assert!(!message.trim_end().chars().any(steers), "{message:?}");
    }
}
