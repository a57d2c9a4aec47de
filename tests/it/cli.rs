//! The command line: `train`, and what every command has in common. Evaluation is in cli_eval.rs.

use std::collections::BTreeMap;
use std::fmt::{self, Display, Formatter};
use std::fs;
use std::path::{Path, PathBuf};

use assert_cmd::assert::Assert;
use predicates::prelude::*;
use serde_json::{Value, json};
use tempfile::TempDir;

/// A run of 200 steps: milliseconds.
pub(crate) const TINY: &[&str] = &[
    "network.hidden=[8]",
    "replay.warmup_steps=50",
    "replay.batch_size=8",
    "budget.steps=200",
    "learn.every_steps=1",
    "learn.updates=1",
    "evaluation.every_steps=100",
    "evaluation.episodes=1",
    "checkpoint.every_steps=50",
];

/// Settings with which the weights leave the finite soon after learning starts.
pub(crate) const DIVERGING: &[&str] = &[
    "network.hidden=[8,8,8,8,8,8,8,8]",
    "loss=mse",
    "optimizer.learning_rate=1",
    "optimizer.beta1=0",
    "optimizer.beta2=0",
    "optimizer.epsilon=1e-30",
    "replay.warmup_steps=64",
    "replay.mirror=false",
    "exploration.steps=4000",
    "max_episode_steps=500",
    "budget.steps=20000",
    "learn.every_steps=1",
    "learn.updates=1",
    "gamma=1",
    "double=false",
    "n_step=1",
    "observation_divisors=null",
    "reward_scale=1",
    "optimizer.schedule=null",
    "policy_weights=online",
    "target={\"kind\":\"none\"}",
    "evaluation.episodes=1",
];

/// What is in a directory when it is printed: every path with its size in bytes.
struct Files(PathBuf);

impl Display for Files {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        fn walk(directory: &Path, root: &Path, f: &mut Formatter<'_>) -> fmt::Result {
            let entries = fs::read_dir(directory).into_iter().flatten().flatten();
            let mut paths: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
            paths.sort();
            for path in paths {
                let (name, found) = (path.strip_prefix(root).unwrap_or(&path), path.symlink_metadata());
                match found {
                    Ok(found) if found.is_dir() => write!(f, "\n  {}/", name.display())?,
                    Ok(found) => write!(f, "\n  {} ({} bytes)", name.display(), found.len())?,
                    Err(error) => write!(f, "\n  {}: {error}", name.display())?,
                }
                if path.is_dir() && !path.is_symlink() {
                    walk(&path, root, f)?;
                }
            }
            Ok(())
        }
        walk(&self.0, &self.0, f)
    }
}

/// A fresh directory in which the program runs.
pub(crate) struct Sandbox(TempDir);

impl Sandbox {
    pub(crate) fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    /// A sandbox with a finished run in `run`.
    pub(crate) fn with_run() -> Self {
        let sandbox = Self::new();
        sandbox.train(&["--out", "run"]).success();
        sandbox
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub(crate) fn write(&self, name: &str, content: impl AsRef<[u8]>) {
        fs::create_dir_all(self.path(name).parent().unwrap()).unwrap();
        fs::write(self.path(name), content).unwrap();
    }

    pub(crate) fn read(&self, name: &str) -> String {
        fs::read_to_string(self.path(name)).unwrap()
    }

    pub(crate) fn json(&self, name: &str) -> Value {
        serde_json::from_str(&self.read(name)).unwrap()
    }

    pub(crate) fn command(&self, arguments: &[&str]) -> assert_cmd::Command {
        let mut command = assert_cmd::cargo::cargo_bin_cmd!("cartpole-dqn");
        command.current_dir(self.0.path()).args(arguments);
        command
    }

    pub(crate) fn run(&self, arguments: &[&str]) -> Assert {
        self.assert(&mut self.command(arguments))
    }

    /// Runs a command. A failed expectation shows it, the sandbox with its files, the exit code, stdout and stderr.
    pub(crate) fn assert(&self, command: &mut assert_cmd::Command) -> Assert {
        let directory = self.0.path().to_owned();
        command
            .assert()
            .append_context("directory", directory.display().to_string())
            .append_context("files", Files(directory))
    }

    /// `train` with [`TINY`] settings.
    pub(crate) fn train(&self, arguments: &[&str]) -> Assert {
        self.run(&[&["train"], &sets(TINY)[..], arguments].concat())
    }

    /// Everything in it: path → content, `None` for a directory.
    pub(crate) fn files(&self) -> BTreeMap<PathBuf, Option<Vec<u8>>> {
        fn walk(directory: &Path, files: &mut BTreeMap<PathBuf, Option<Vec<u8>>>) {
            for entry in fs::read_dir(directory).unwrap() {
                let path = entry.unwrap().path();
                files.insert(path.clone(), (!path.is_dir()).then(|| fs::read(&path).unwrap()));
                if path.is_dir() {
                    walk(&path, files);
                }
            }
        }
        let mut files = BTreeMap::new();
        walk(self.0.path(), &mut files);
        files
    }

    /// Runs a command that must be refused with exit code 2, name all of `words`, print nothing on stdout and
    /// leave the sandbox as it is.
    pub(crate) fn refuses(&self, arguments: &[&str], words: &[&str]) {
        let before = self.files();
        let refused = self.run(arguments).code(2).stdout("");
        let message = String::from_utf8(refused.get_output().stderr.clone()).unwrap();
        let is_told = words.iter().all(|word| message.contains(word)) && !message.contains("panicked");
        assert!(is_told, "stderr has not all of {words:?}\n{refused}");
        let after = self.files();
        assert!(before == after, "{arguments:?}: left {:?} of {:?}", after.keys(), before.keys());
    }
}

pub(crate) fn sets<'a>(settings: &[&'a str]) -> Vec<&'a str> {
    settings.iter().flat_map(|&setting| ["--set", setting]).collect()
}

pub(crate) fn stdout_json(assert: &Assert) -> Value {
    let text = String::from_utf8(assert.get_output().stdout.clone()).unwrap();
    assert_eq!(text.lines().count(), 1, "{text}");
    serde_json::from_str(&text).unwrap()
}

pub(crate) fn keys(value: &Value) -> Vec<&str> {
    let mut keys: Vec<&str> = value.as_object().unwrap().keys().map(String::as_str).collect();
    keys.sort_unstable();
    keys
}

/// One test per command that a fresh directory with nothing but the given files must refuse.
macro_rules! refusals {
    ($($name:ident: $files:expr, $arguments:expr => $words:expr;)*) => {$(
        #[test]
        fn $name() {
            let sandbox = $crate::cli::Sandbox::new();
            let files: &[(&str, &[u8])] = &$files;
            files.iter().for_each(|(file, content)| sandbox.write(file, content));
            sandbox.refuses(&$arguments, &$words);
        }
    )*};
}
pub(crate) use refusals;

const CONFIG: [&str; 3] = ["train", "--config", "my.json"];

refusals! {
    refuses_to_do_nothing: [], [] as [&str; 0] => ["Usage", "train", "eval"];
    refuses_an_unknown_command_and_names_the_nearest: [], ["trian"] => ["'trian'", "'train'"];
    refuses_an_unknown_flag_and_names_the_nearest: [], ["train", "--confg", "x"] => ["'--confg'", "'--config'"];
    refuses_a_negative_seed: [], ["train", "--seed", "-1"] => ["--seed", "-1", "from 0 to 18446744073709551615"];
    refuses_a_seed_that_is_no_number: [], ["train", "--seed", "x"] => ["--seed", "'x'", "an integer"];

    refuses_a_directory_without_an_option: [("run/x", b"")], ["train", "run"] => ["'run'", "--resume DIR", "--out DIR"];
    refuses_standard_output_as_a_run: [], ["train", "--out", "-"] => ["--out -", "a directory is needed"];
    refuses_standard_output_as_a_study:
        [], ["study", "--seeds", "0..1", "--out", "-"] => ["--out -", "a directory is needed"];

    refuses_an_unknown_key_and_names_the_nearest:
        [("my.json", b"{\"gama\": 0.9}")], CONFIG => ["my.json", "`gama`", "`gamma`"];
    refuses_an_unknown_key_in_set: [], ["train", "--set", "gama=0.9"] => ["--set", "`gama`", "`gamma`"];
    refuses_a_set_without_a_value: [], ["train", "--set", "gamma"] => ["--set gamma", "key.path=value"];
    refuses_invalid_json_with_line_and_column:
        [("my.json", b"{\"gamma\": 0.9,\n \"loss\" \"mse\"}")], CONFIG => ["my.json", "line 2 column 9"];
    refuses_an_empty_config: [("my.json", b"")], CONFIG => ["my.json", "line 1 column 0", "JSON"];
    refuses_yaml: [("my.json", b"gamma: 0.9\n")], CONFIG => ["my.json", "line 1 column 1", "takes a JSON file"];
    refuses_a_number_beyond_floating_point:
        [("my.json", b"{\"gamma\": 1e999}")], CONFIG => ["my.json", "out of range", "line 1"];
    refuses_such_a_number_in_set: [], ["train", "--set", "gamma=1e999"] => ["`gamma`", "1e999", "from 0 to 1"];
    refuses_a_value_of_a_wrong_type:
        [("my.json", b"{\"replay\": {\"capacity\": \"big\"}}")], CONFIG
        => ["my.json", "`replay.capacity`", "\"big\"", "an integer from 1 to"];
    refuses_a_negative_learning_rate:
        [], ["train", "--set", "optimizer.learning_rate=-0.1"] => ["`optimizer.learning_rate`", "-0.1", "above 0"];
    refuses_a_gamma_above_one: [], ["train", "--set", "gamma=1.5"] => ["`gamma`", "1.5", "from 0 to 1"];
    refuses_a_layer_of_size_zero: [], ["train", "--set", "network.hidden=[24,0]"] => ["`network.hidden`", "[24,0]"];
    refuses_a_batch_larger_than_the_memory:
        [], ["train", "--set", "replay.capacity=16"] => ["`replay.batch_size` is 32", "`replay.capacity`", "16"];
    refuses_a_budget_that_ends_before_learning:
        [], ["train", "--set", "budget.steps=100"] => ["`budget.steps` is 100", "501", "`replay.warmup_steps`"];
    refuses_a_config_without_its_flag_and_names_it:
        [("my.json", b"{}")], ["train", "my.json"] => ["'my.json'", "--config FILE"];
    refuses_a_flag_that_nobody_knows_and_names_set: [], ["train", "--frobnicate", "1"] => ["'--frobnicate'", "--set KEY=VALUE"];
    refuses_a_set_with_a_space: [], ["train", "--set", "gamma", "0.9"] => ["'0.9'", "--set KEY=VALUE"];
    refuses_the_short_name_of_a_key_and_names_the_key:
        [], ["train", "--set", "optimizer.lr=0.1"] => ["`optimizer.lr`", "did you mean `optimizer.learning_rate`?"];
    refuses_an_unlike_key_and_lists_its_group:
        [], ["train", "--set", "optimizer.zzzzzz=0.1"] => ["`optimizer.zzzzzz`", "allowed: `learning_rate`, `beta1`"];
    refuses_layers_that_are_no_list: [], ["train", "--set", "network.hidden=24,24"] => ["\"24,24\"", "such as [24, 24]"];
    refuses_a_trailing_comma: [("my.json", b"{\"gamma\": 0.9,}")], CONFIG => ["my.json", "trailing comma", "line 1"];
    refuses_a_number_of_steps_in_place_of_a_budget:
        [("my.json", b"{\"budget\": 1000}")], CONFIG => ["`budget` is 1000", "`steps`, `episodes`"];
    refuses_a_missing_config: [], CONFIG => ["my.json", "No such file"];
    refuses_a_directory_as_config: [("my.json/x", b"")], CONFIG => ["my.json", "directory", "takes a JSON file"];
    refuses_an_out_that_is_a_file: [("f", b"mine")], ["train", "--out", "f"] => ["f is a file", "--out"];
    refuses_that_with_force_too: [("f", b"mine")], ["train", "--force", "--out", "f"] => ["f is a file", "--out"];
    refuses_an_out_below_a_file: [("f", b"mine")], ["train", "--out", "f/a/b"] => ["f/a/b", "--out"];
    refuses_an_out_with_something_in_it:
        [("mine/notes.txt", b"mine")], ["train", "--out", "mine"] => ["mine", "not empty", "--force"];
    does_not_force_away_what_is_no_run:
        [("mine/notes.txt", b"mine")], ["train", "--force", "--out", "mine"] => ["mine", "does not hold a run"];
    does_not_force_away_the_config_of_something_else:
        [("mine/config.json", b"{}")], ["train", "--force", "--out", "mine"] => ["mine", "does not hold a run"];
}

#[test]
fn a_failed_expectation_shows_the_command_its_directory_the_files_and_all_output() {
    let sandbox = Sandbox::new();
    sandbox.write("mine/notes.txt", "mine");
    let ended = || sandbox.run(&["config", "show", "--config", "no.json"]);
    let unmet = [
        ended().try_success(),
        ended().try_code(0),
        ended().try_stdout("something"),
        ended().try_stderr(predicate::str::is_empty()),
    ];
    let directory = sandbox.path("");
    for unmet in unmet {
        let shown = unmet.unwrap_err().to_string();
        let directory = directory.display().to_string();
        for part in [
            "\"--config\" \"no.json\"",
            directory.trim_end_matches('/'),
            "mine/notes.txt (4 bytes)",
            "code=2",
        ] {
            assert!(shown.contains(part), "{part} is not in {shown}");
        }
        assert!(shown.contains("stdout") && shown.contains("stderr") && shown.contains("takes a JSON file"));
    }
}

#[test]
fn refuses_a_checkpoint_as_config() {
    let sandbox = Sandbox::with_run();
    let checkpoint = "run/checkpoints/last.safetensors";
    sandbox.refuses(&["train", "--config", checkpoint], &[checkpoint, "takes a JSON file"]);
}

#[test]
fn does_not_force_away_a_run_with_a_foreign_file() {
    for foreign in ["run/notes.txt", "run/checkpoints/mine.safetensors", "run/directory/x"] {
        let sandbox = Sandbox::with_run();
        sandbox.write(foreign, "mine");
        let named = foreign.trim_end_matches("/x");
        sandbox.refuses(&["train", "--force", "--out", "run"], &[named, "--force replaces only runs"]);
    }
}

#[test]
fn does_not_force_away_a_run_whose_checkpoints_are_a_file() {
    let sandbox = Sandbox::with_run();
    fs::remove_dir_all(sandbox.path("run/checkpoints")).unwrap();
    sandbox.write("run/checkpoints", "mine");
    sandbox.refuses(&["train", "--force", "--out", "run"], &["run/checkpoints", "does not belong to a run"]);
}

#[test]
fn does_not_replace_a_run_without_force() {
    let sandbox = Sandbox::with_run();
    sandbox.refuses(&["train", "--out", "run"], &["run", "not empty", "--force"]);
}

#[test]
fn force_replaces_a_run_and_what_a_killed_one_left() {
    let sandbox = Sandbox::with_run();
    sandbox.write("run/checkpoints/.writing-abc123.tmp", "half a checkpoint");
    sandbox.train(&["--out", "run", "--force", "--seed", "5"]).success();
    assert_eq!(sandbox.json("run/summary.json")["seed"], 5);
    assert_eq!(fs::read_dir(sandbox.path("run/checkpoints")).unwrap().count(), 3);
}

#[test]
#[cfg(unix)]
fn force_replaces_a_run_behind_a_symbolic_link_and_keeps_the_link() {
    let sandbox = Sandbox::with_run();
    std::os::unix::fs::symlink("run", sandbox.path("link")).unwrap();
    sandbox.train(&["--out", "link", "--force", "--seed", "5"]).success();
    assert!(sandbox.path("link").is_symlink());
    assert_eq!(sandbox.json("run/summary.json")["seed"], 5);
}

#[test]
fn a_run_goes_into_an_empty_directory_and_leaves_nothing_else() {
    let sandbox = Sandbox::new();
    fs::create_dir(sandbox.path("run")).unwrap();
    sandbox.train(&["--out", "run"]).success();
    let names: Vec<PathBuf> = sandbox.files().into_keys().collect();
    let expected = [
        "",
        "/checkpoints",
        "/checkpoints/best.safetensors",
        "/checkpoints/last.safetensors",
        "/checkpoints/previous.safetensors",
        "/config.json",
        "/metrics.jsonl",
        "/run.json",
        "/summary.json",
    ];
    let expected = expected.iter().map(|name| sandbox.path(&format!("run{name}")));
    assert_eq!(names, expected.collect::<Vec<_>>());
}

#[test]
fn the_seed_flag_wins_over_set_and_config() {
    let sandbox = Sandbox::new();
    sandbox.write("my.json", "{\"seed\": 2}");
    sandbox.train(&["--config", "my.json", "--out", "a"]).success();
    sandbox.train(&["--config", "my.json", "--set", "seed=3", "--out", "b"]).success();
    sandbox.train(&["--config", "my.json", "--set", "seed=3", "--seed", "4", "--out", "c"]).success();
    let seeds = ["a", "b", "c"].map(|run| sandbox.json(&format!("{run}/config.json"))["seed"].clone());
    assert_eq!(seeds, [json!(2), json!(3), json!(4)]);
}

#[test]
fn json_prints_the_summary_alone() {
    let sandbox = Sandbox::new();
    let summary = stdout_json(&sandbox.train(&["--out", "run", "--seed", "7", "--json"]).success());
    let expected = [
        "best_evaluation",
        "config_sha256",
        "cpu_path",
        "cpu_seconds",
        "end_reason",
        "env_steps",
        "episodes",
        "evaluation_steps",
        "final_evaluation",
        "git_revision",
        "lasting_test_steps",
        "mean_return_100",
        "seed",
        "solved_at_step",
        "updates",
        "version",
        "wall_seconds",
        "weights_sha256",
    ];
    assert_eq!(keys(&summary), expected);
    assert_eq!(keys(&summary["best_evaluation"]), ["env_steps", "mean"]);
    assert_eq!((&summary["seed"], &summary["env_steps"]), (&json!(7), &json!(200)));
    assert_eq!(summary["final_evaluation"]["env_steps"], 200);
    assert_eq!(summary["solved_at_step"], Value::Null);
    assert_eq!(summary["weights_sha256"].as_str().unwrap().len(), 64);
    assert_eq!(summary, sandbox.json("run/summary.json"));
}

#[test]
fn the_price_of_a_run_is_printed_and_is_in_its_summary_and_in_reports() {
    let sandbox = Sandbox::new();
    let printed = predicate::str::contains(" to test the end; ");
    sandbox.train(&["--out", "run", "--seed", "7"]).success().stdout(printed);
    let played = sandbox.json("run/summary.json")["evaluation_steps"].as_u64().unwrap();
    assert!(played > 0);
    let price = format!(
        "price: 200 steps of training; without learning {played} steps in evaluations and 0 in tests whether"
    );
    let report = sandbox.run(&["report", "run"]).success();
    let printed = String::from_utf8(report.get_output().stdout.clone()).unwrap();
    assert!(printed.split_whitespace().collect::<Vec<_>>().join(" ").contains(&price), "{printed}");
    let study = ["study", "--quiet", "--seeds", "7..8", "--out", "study"];
    sandbox.run(&[&study[..], &sets(TINY)].concat()).success();
    let said = predicate::str::contains("What a run costs");
    sandbox.run(&["report", "study"]).success().stdout(said);
    let price = json!({"training": 200, "evaluations": played, "lasting_tests": 0});
    assert_eq!(sandbox.json("study/report.json")["configs"][0]["steps_played"], price);
}

#[test]
fn quiet_prints_nothing() {
    Sandbox::new().train(&["--out", "run", "--quiet"]).success().stdout("").stderr("");
}

#[test]
fn the_summary_names_the_command_that_evaluates_the_run() {
    let printed = predicate::str::contains(" eval run\n").and(predicate::str::contains("SHA-256"));
    Sandbox::new().train(&["--out", "run"]).success().stdout(printed);
    let printed = predicate::str::contains(" eval 'my run'\n");
    Sandbox::new().train(&["--out", "my run"]).success().stdout(printed);
}

#[test]
fn without_out_the_directory_is_named_after_config_seed_and_time() {
    let sandbox = Sandbox::new();
    sandbox.write("my.json", "{}");
    sandbox.train(&["--seed", "7"]).success();
    sandbox.train(&["--config", "my.json"]).success();
    let mut names: Vec<String> = fs::read_dir(sandbox.path("runs"))
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    for (name, prefix) in names.iter().zip(["cartpole-s7-", "my-s0-"]) {
        let time = name.strip_prefix(prefix).unwrap_or_else(|| panic!("{names:?}"));
        let shape: String = time.chars().map(|c| if c.is_ascii_digit() { '9' } else { c }).collect();
        assert_eq!(shape, "99999999T999999999Z");
    }
    assert_eq!(names.len(), 2);
}

#[test]
fn the_resolved_config_gives_the_same_run_again_byte_for_byte() {
    let sandbox = Sandbox::new();
    sandbox.train(&["--out", "a", "--seed", "3"]).success();
    sandbox.run(&["train", "--config", "a/config.json", "--out", "b"]).success();
    sandbox.train(&["--out", "other", "--seed", "4"]).success();
    let files =
        ["config.json", "metrics.jsonl", "checkpoints/best.safetensors", "checkpoints/last.safetensors"];
    for file in files {
        let [a, b, other] = ["a", "b", "other"].map(|run| fs::read(sandbox.path(run).join(file)).unwrap());
        assert!(a == b, "{file} differs");
        assert!(a != other, "{file} does not depend on the seed");
    }
    let last = sandbox.read("a/metrics.jsonl").lines().last().map(str::to_owned).unwrap();
    assert_eq!(serde_json::from_str::<Value>(&last).unwrap()["event"], "end");
}

#[test]
fn a_diverging_run_names_the_step_and_keeps_the_last_good_checkpoint() {
    let sandbox = Sandbox::new();
    let arguments =
        [&["train", "--quiet", "--out", "run", "--set", "checkpoint.every_steps=10"], &sets(DIVERGING)[..]]
            .concat();
    let message = predicate::str::is_match(
        r"^error: training diverged: at environment step \d+ .*NaN.* kept in run\n$",
    );
    sandbox.run(&arguments).code(1).stdout("").stderr(message.unwrap());
    sandbox.run(&["eval", "--checkpoint", "run", "--episodes", "1"]).success();
    assert!(!sandbox.path("run/summary.json").exists());
}

#[test]
#[cfg(unix)]
fn a_closed_stdout_or_stderr_is_no_panic_and_loses_nothing() {
    use std::process::{Command, Stdio};
    let sandbox = Sandbox::new();
    let program = assert_cmd::cargo::cargo_bin!("cartpole-dqn");
    for (out, close_stdout) in [("a", true), ("b", false)] {
        let mut child = Command::new(program)
            .current_dir(sandbox.path("."))
            .args([&["train", "--out", out], &sets(TINY)[..]].concat())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        if close_stdout {
            drop(child.stdout.take());
        } else {
            drop(child.stderr.take());
        }
        let output = child.wait_with_output().unwrap();
        assert!(!String::from_utf8_lossy(&output.stderr).contains("panicked"));
        assert!(sandbox.path(out).join("summary.json").is_file());
    }
}

#[test]
fn help_fits_80_columns() {
    let sandbox = Sandbox::new();
    for command in ["train", "eval", "inspect", "runs", "watch", "render", "study", "report", "verify"] {
        let help = sandbox.run(&[command, "--help"]).success();
        let help = String::from_utf8(help.get_output().stdout.clone()).unwrap();
        let long = help.lines().filter(|line| line.chars().count() > 80 && !line.contains("cartpole-dqn"));
        assert_eq!(long.collect::<Vec<_>>(), [""; 0], "{command}");
    }
}

#[test]
fn a_character_that_reorders_a_line_is_escaped_in_messages() {
    let sandbox = Sandbox::new();
    sandbox.refuses(&["eval", "a\u{202e}b"], &["a\\u202eb"]);
}
