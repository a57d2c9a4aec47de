//! The command line: `runs`, and the newest run, which commands take where no path is given.

use std::fs::{self, File};
use std::time::{Duration, SystemTime};

use predicates::prelude::*;
use serde_json::{Value, json};

use crate::cli::{DIVERGING, Sandbox, refusals, sets, stdout_json};
use crate::report::evaluation;

refusals! {
    refuses_to_list_a_missing_directory: [], ["runs"] => ["runs does not exist", "train the first one"];
    refuses_to_list_a_file: [("f", b"")], ["runs", "f"] => ["f is not a directory"];
    refuses_a_newest_run_where_none_has_a_policy:
        [("runs/a/config.json", b"{}"), ("runs/a/metrics.jsonl", b"")], ["eval"] => ["no run below runs has a policy"];
}

/// A run whose files were written so many seconds after the start of an hour.
fn train_at(sandbox: &Sandbox, run: &str, seconds: u64, arguments: &[&str]) {
    sandbox.train(&[&["--quiet", "--out", run], arguments].concat()).success();
    set_time(sandbox, run, seconds);
}

fn set_time(sandbox: &Sandbox, run: &str, seconds: u64) {
    let time = SystemTime::UNIX_EPOCH + Duration::from_secs(1_700_000_000 + seconds);
    for directory in [sandbox.path(run), sandbox.path(run).join("checkpoints")] {
        for entry in fs::read_dir(directory).unwrap() {
            let path = entry.unwrap().path();
            if path.is_file() {
                File::options().append(true).open(path).unwrap().set_modified(time).unwrap();
            }
        }
    }
}

fn table(sandbox: &Sandbox, arguments: &[&str]) -> Vec<Vec<String>> {
    let assert = sandbox.run(&[&["runs"], arguments].concat()).success();
    let text = String::from_utf8(assert.get_output().stdout.clone()).unwrap();
    assert!(text.lines().all(|line| line.chars().count() <= 80), "{text}");
    // Below a run are the keys that differ.
    let rows =
        text.lines().take_while(|line| *line != "Names in full:").filter(|line| !line.starts_with("    "));
    rows.map(|line| line.split_whitespace().map(String::from).collect()).collect()
}

#[test]
fn runs_are_listed_with_the_newest_first() {
    let sandbox = Sandbox::new();
    train_at(&sandbox, "runs/old", 1, &["--seed", "7"]);
    train_at(&sandbox, "runs/deep/er/new", 2, &["--set", "gamma=0.5"]);
    let rows = table(&sandbox, &[]);
    assert_eq!(rows[0][2..], ["run", "config", "seed", "steps", "best", "final", "state"]);
    let names: Vec<&str> = rows[1..].iter().map(|row| row[2].as_str()).collect();
    assert_eq!(names, ["deep/er/new", "old"]);
    assert_eq!(rows[2][..2], ["2023-11-14", "22:13"]);
    sandbox.run(&["runs"]).success().stdout(predicate::str::contains("gamma=0.5"));

    let list = stdout_json(&sandbox.run(&["runs", "--json"]).success().stderr(""));
    let old = &list["runs"][1];
    let summary = sandbox.json("runs/old/summary.json");
    assert_eq!((&old["path"], &old["state"], &old["seed"]), (&json!("runs/old"), &json!("ended"), &json!(7)));
    assert_eq!((&old["env_steps"], &old["best"]), (&json!(200), &summary["best_evaluation"]));
    assert_eq!(old["final"], summary["final_evaluation"]);
    assert_eq!(old["written"], "2023-11-14T22:13:21Z");
    assert_eq!(list["runs"][0]["changed"]["gamma"], 0.5);
}

#[test]
fn a_run_knows_the_config_that_it_was_started_with_and_that_it_has_failed() {
    let sandbox = Sandbox::new();
    sandbox.write("mine.json", "{\"seed\": 3}");
    train_at(&sandbox, "runs/a", 3, &["--config", "mine.json"]);
    train_at(&sandbox, "runs/b", 2, &[]);
    fs::remove_file(sandbox.path("runs/b/run.json")).unwrap();
    let diverging = [&["train", "--quiet", "--out", "runs/c"], &sets(DIVERGING)[..]].concat();
    sandbox.run(&diverging).code(1);
    set_time(&sandbox, "runs/c", 1);
    let list = stdout_json(&sandbox.run(&["runs", "--json"]).success());
    let of =
        |key: &str| list["runs"].as_array().unwrap().iter().map(|run| run[key].clone()).collect::<Vec<_>>();
    assert_eq!(of("config"), [json!("mine"), Value::Null, json!("cartpole")]);
    assert_eq!(of("state"), ["ended", "ended", "failed"]);
    let rows = table(&sandbox, &[]);
    assert_eq!((&rows[1][3], &rows[2][3]), (&"mine".into(), &"?".into()));
}

#[test]
fn the_best_evaluation_is_the_latest_of_equals() {
    let sandbox = Sandbox::with_run();
    let event = |step: u64, mean: f64| format!("{}\n", evaluation(step, mean, mean > 5.0));
    sandbox.write("run/metrics.jsonl", event(1, 20.0) + &event(2, 20.0) + &event(3, 5.0));
    let list = stdout_json(&sandbox.run(&["runs", ".", "--json"]).success());
    assert_eq!(list["runs"][0]["best"], json!({"env_steps": 2, "mean": 20.0}));
}

#[test]
fn a_time_that_no_calendar_has_is_none() {
    let sandbox = Sandbox::new();
    sandbox.train(&["--quiet", "--out", "runs/a"]).success();
    for time in [
        SystemTime::UNIX_EPOCH - Duration::from_secs(9),
        SystemTime::UNIX_EPOCH + Duration::from_secs(1 << 38),
    ] {
        for file in [
            "config.json",
            "metrics.jsonl",
            "summary.json",
            "checkpoints/best.safetensors",
            "checkpoints/last.safetensors",
        ] {
            let file = File::options().append(true).open(sandbox.path(&format!("runs/a/{file}"))).unwrap();
            // Some file systems have no such time.
            let _ = file.set_modified(time);
        }
        sandbox.run(&["runs"]).success();
    }
}

#[test]
fn a_run_is_running_stopped_ended_or_damaged() {
    let sandbox = Sandbox::new();
    for run in ["ended", "stopped", "running", "damaged"] {
        sandbox.train(&["--quiet", "--out", &format!("runs/{run}")]).success();
    }
    for run in ["stopped", "running"] {
        let metrics = format!("runs/{run}/metrics.jsonl");
        let text = sandbox.read(&metrics);
        let whole = text.lines().filter(|line| !line.contains("\"end\"")).map(|line| format!("{line}\n"));
        // A killed run leaves half a line.
        sandbox.write(&metrics, whole.collect::<String>() + "{\"event\":\"epis");
    }
    sandbox.write("runs/damaged/metrics.jsonl", "no event\n");
    let held = File::open(sandbox.path("runs/running/metrics.jsonl")).unwrap();
    held.lock().unwrap();
    let before = sandbox.files();
    let list = stdout_json(&sandbox.run(&["runs", "--json"]).success());
    assert!(before == sandbox.files());
    for run in list["runs"].as_array().unwrap() {
        assert_eq!(run["path"], format!("runs/{}", run["state"].as_str().unwrap()));
    }
    let said = predicate::str::contains("damaged: ").and(predicate::str::contains("line 1"));
    sandbox.run(&["runs"]).success().stderr(said);
    for checkpoint in ["last", "previous"] {
        fs::remove_file(sandbox.path(&format!("runs/ended/checkpoints/{checkpoint}.safetensors"))).unwrap();
    }
    let said = predicate::str::contains("damaged: runs/ended/checkpoints");
    sandbox.run(&["runs"]).success().stderr(said);
}

#[test]
#[cfg(unix)]
fn hostile_directories_are_listed_in_a_moment_and_in_80_columns() {
    use std::os::unix::fs::symlink;
    let sandbox = Sandbox::new();
    let long = format!("runs/{}", "very-".repeat(30));
    train_at(&sandbox, &long, 9, &["--seed", "18446744073709551615"]);
    for run in ["runs/\u{1b}[31mred\u{202e}", "runs/huge"] {
        sandbox.write(&format!("{run}/config.json"), "{}");
        sandbox.write(&format!("{run}/metrics.jsonl"), "");
    }
    File::create(sandbox.path("runs/huge/metrics.jsonl")).unwrap().set_len(1 << 40).unwrap();
    symlink(".", sandbox.path("runs/loop")).unwrap();
    symlink("../..", sandbox.path("runs/huge/up")).unwrap();
    let rows = table(&sandbox, &[]);
    assert_eq!(rows.len(), 1 + 3, "{rows:?}");
    assert!(rows.iter().any(|row| row[2].contains('…') && row[4].contains('…')), "{rows:?}");
    let assert = sandbox.run(&["runs"]).success();
    let printed = [&assert.get_output().stdout[..], &assert.get_output().stderr].concat();
    let printed = String::from_utf8(printed).unwrap();
    assert!(!printed.contains('\u{1b}') && !printed.contains('\u{202e}'), "{printed}");
    let deep = "runs/".to_owned() + &"d/".repeat(40) + "run/config.json";
    sandbox.write(&deep, "{}");
    assert_eq!(table(&sandbox, &[]).len(), 1 + 3);
}

#[test]
#[cfg(unix)]
fn a_directory_that_cannot_be_read_is_named() {
    use std::os::unix::fs::PermissionsExt;
    let sandbox = Sandbox::new();
    sandbox.write("runs/closed/x", "");
    let closed = sandbox.path("runs/closed");
    fs::set_permissions(&closed, fs::Permissions::from_mode(0o000)).unwrap();
    let is_root = fs::read_dir(&closed).is_ok();
    let assert = sandbox.run(&["runs"]).success();
    let said = String::from_utf8(assert.get_output().stderr.clone()).unwrap();
    fs::set_permissions(&closed, fs::Permissions::from_mode(0o755)).unwrap();
    assert!(is_root || said.contains("runs/closed cannot be searched"), "{said}");
}

#[test]
fn commands_without_a_path_take_the_newest_run_that_has_a_policy() {
    let sandbox = Sandbox::new();
    train_at(&sandbox, "runs/a", 1, &["--seed", "1"]);
    train_at(&sandbox, "runs/b", 2, &["--seed", "2"]);
    train_at(&sandbox, "runs/c", 2, &["--seed", "3"]);
    train_at(&sandbox, "runs/without", 3, &["--seed", "4"]);
    fs::remove_dir_all(sandbox.path("runs/without/checkpoints")).unwrap();
    let note = "note: no path is given, so this is the newest run: runs/c\n";
    let played =
        |assert: &assert_cmd::assert::Assert| -> Value { stdout_json(assert)["policy"]["file"].clone() };
    let json = sandbox.run(&["eval", "--episodes", "1", "--json"]).success().stderr("");
    assert_eq!(played(&json), "runs/c/checkpoints/best.safetensors", "of equally new ones the last by name");
    sandbox.run(&["eval", "--episodes", "1"]).success().stderr(note);
    sandbox.run(&["eval", "--episodes", "1", "--quiet"]).success().stdout("").stderr("");
    sandbox.run(&["inspect"]).success().stderr(note);
    sandbox.run(&["render", "-o", "x.svg", "--steps", "1"]).success().stderr(note);
    sandbox.run(&["render", "-o", "x.svg", "--steps", "1", "--quiet"]).success().stderr("");
    set_time(&sandbox, "runs/a", 4);
    let json = sandbox.run(&["eval", "--episodes", "1", "--json"]).success();
    assert_eq!(played(&json), "runs/a/checkpoints/best.safetensors");
}
