//! `train`: options that people know from elsewhere, what a run says, and the files that it leaves.

use std::fs;

use predicates::prelude::*;
use serde_json::Value;

use crate::cli::{DIVERGING, Sandbox, TINY, keys, refusals, sets};

refusals! {
    names_the_key_for_steps: [], ["train", "--steps", "20000"]
        => ["`--steps` is no option of `train`", " train --set budget.steps=20000\n"];
    names_the_key_for_steps_with_an_equals_sign: [], ["train", "--steps=20000"] => [" train --set budget.steps=20000\n"];
    names_the_keys_of_all_options_in_one_line: [],
        ["train", "--lr", "1e-3", "--out", "x", "--gamma=0.9", "--batch-size", "64"]
        => [" train --set optimizer.learning_rate=1e-3 --out x --set gamma=0.9 --set replay.batch_size=64\n"];
    names_the_key_of_a_study_too: [], ["study", "--episodes", "500", "--seeds", "0..3", "--out", "s"]
        => [" study --set budget.episodes=500 --seeds 0..3 --out s\n"];
    names_the_keys_for_a_constant_epsilon: [], ["train", "--epsilon", "0.1"]
        => ["--set exploration.initial=0.1 --set exploration.final=0.1", "`--epsilon` could also be --set optimizer.epsilon=0.1"];
    names_the_key_of_an_option_of_explain: [], ["explain", "--update", "5", "--lr", "0.1"]
        => ["`--lr` is no option of `explain`", " explain --update 5 --set optimizer.learning_rate=0.1\n"];
    names_the_key_of_an_option_of_config_show: [], ["config", "show", "--memory-size", "9"]
        => ["`--memory-size` is no option of `config show`", " config show --set replay.capacity=9\n"];
    varies_several_values_of_an_option: [], ["study", "--lr", "1e-3,1e-4", "--seeds", "0..3", "--out", "s"]
        => [" study --vary optimizer.learning_rate=1e-3,1e-4 --seeds 0..3 --out s\n"];
    tells_explain_how_settings_are_given: [], ["explain", "foo"] => ["'foo'", "--set KEY=VALUE"];
    tells_config_show_how_settings_are_given: [], ["config", "show", "foo"] => ["'foo'", "--set KEY=VALUE"];
    tells_a_decay_per_episode_from_one_over_steps: [], ["train", "--epsilon-decay", "0.995", "--epsilon_decay", "8000"]
        => ["exploration.schedule=per_episode --set exploration.decay=0.995", "exploration.schedule=linear --set exploration.steps=8000"];
    makes_a_list_of_layers: [], ["train", "--hidden", "64", "64"] => ["--set 'network.hidden=[64,64]'"];
    takes_a_negative_value_along: [], ["train", "--lr", "-0.1"] => ["--set optimizer.learning_rate=-0.1"];
    asks_for_a_value_that_is_missing: [], ["train", "--lr", "--double"]
        => ["--set optimizer.learning_rate=VALUE --set double=true"];
    knows_every_key_as_an_option: [], ["train", "--replay.warmup_steps", "5", "--beta1", "0.8"]
        => ["--set replay.warmup_steps=5 --set optimizer.beta1=0.8"];
    explains_a_log_interval_that_is_no_integer: [], ["train", "--log-every", "1e3"]
        => ["--log-every", "expected an integer from 1 to"];
    explains_a_negative_number_of_jobs: [], ["study", "--jobs", "-1", "--seeds", "0..3", "--out", "s"]
        => ["--jobs", "expected an integer from 1 to 4096"];
    explains_a_number_of_episodes_with_an_exponent: [], ["eval", "--policy", "random", "--episodes", "1e3"]
        => ["--episodes", "expected an integer from 1 to 10000000"];
    shows_a_control_character_of_a_file_escaped: [], ["train", "--config", "a\u{1b}[31mb"] => ["a\\u001b[31mb"];
    shows_a_control_character_of_an_option_escaped: [], ["train", "--a\u{7}b"] => ["--a\\u0007b"];
    refuses_an_empty_standard_input: [], ["train", "--config", "-"] => ["standard input", "line 1 column 0"];
    refuses_weights_from_nowhere: [], ["train", "--init-from", "x"] => ["x", "No such file"];
    does_not_resume_with_other_weights: [], ["train", "--resume", "r", "--init-from", "x"] => ["--init-from", "--resume"];
}

/// What a word of another program means is the same behind `--`, `--set`, `--vary` and in a file.
#[test]
fn a_word_of_another_program_means_the_same_everywhere() {
    let sandbox = Sandbox::new();
    let words: [(&str, &str, &[&str]); 10] = [
        ("lr", "0.1", &["optimizer.learning_rate"]),
        ("memory_size", "500", &["replay.capacity"]),
        ("batch-size", "32", &["replay.batch_size"]),
        ("learning_rate", "0.1", &["optimizer.learning_rate"]),
        ("total-timesteps", "500", &["budget.steps"]),
        ("LR", "0.1", &["optimizer.learning_rate"]),
        ("epsilon", "0.1", &["exploration.initial", "exploration.final", "optimizer.epsilon"]),
        ("every_steps", "100", &["learn.every_steps", "target.every_steps", "evaluation.every_steps"]),
        ("epsilon_decay", "0.99", &["exploration.schedule=per_episode", "exploration.decay"]),
        ("tau", "0.01", &["target.kind=soft", "target.tau"]),
    ];
    for (word, value, keys) in words {
        let pair = format!("{word}={value}");
        let (option, file) = (format!("--{pair}"), format!("{{\"{word}\": {value}}}"));
        sandbox.write("c.json", &file);
        let unknown = [&[word, "did you mean"][..], keys].concat();
        sandbox.refuses(&["train", &option], &[&["--set"][..], keys].concat());
        for command in [&["train"][..], &["explain", "--update", "1"], &["config", "show"]] {
            sandbox.refuses(&[command, &["--set", &pair]].concat(), &[&["--set: "], &unknown[..]].concat());
            sandbox.refuses(
                &[command, &["--config", "c.json"]].concat(),
                &[&["c.json: "], &unknown[..]].concat(),
            );
        }
        let study = ["study", "--out", "s", "--seeds", "0..2"];
        sandbox.refuses(&[&study[..], &["--set", &pair]].concat(), &[&["--set: "], &unknown[..]].concat());
        let assert = sandbox.run(&[&study[..], &["--vary", &pair]].concat()).code(2);
        let said = String::from_utf8(assert.get_output().stderr.clone()).unwrap();
        assert!(said.contains("--vary: ") && !said.contains("--set"), "{said}");
        assert!(unknown.iter().all(|word| said.contains(word)), "{said}");
    }
    for (wrong, keys) in [
        ("epsilom=0.1", &["`exploration.initial`", "`optimizer.epsilon`"][..]),
        ("exploration.epsilon=0.1", &["`exploration.initial` and `exploration.final`?"]),
        ("optim.lr=0.1", &["`optimizer.learning_rate`?"]),
        ("evry_steps=9", &["`learn.every_steps`", "`evaluation.every_steps`"]),
        ("memory_sise=9", &["`replay.capacity`?"]),
    ] {
        sandbox.refuses(&["train", "--set", wrong], &[&["did you mean"], keys].concat());
    }
}

/// Every line that is given as advice is one that works, whatever the config.
#[test]
#[cfg(unix)]
fn the_line_to_type_is_accepted() {
    let configs =
        ["cartpole", "tutorial"].map(|name| format!("{}/configs/{name}.json", env!("CARGO_MANIFEST_DIR")));
    let options: &[&[&str]] = &[
        &["--steps", "20000", "--lr", "0.001", "--learning-rate", "0.001", "--gamma", "0.9"],
        &["--episodes", "200", "--discount", "0.9", "--batch-size", "64", "--buffer-size", "9999"],
        &["--epsilon", "0.1"],
        &["--epsilon-start", "0.9", "--epsilon-end", "0.01"],
        &["--epsilon-decay", "0.99", "--epsilon-min", "0.02"],
        &["--epsilon-decay", "5000", "--learning-starts", "500"],
        &["--hidden", "64,64", "--n-step", "3", "--warmup", "100", "--double=true"],
        &["--hidden", "64", "--tau", "0.01", "--double", "false"],
        &["--target-update", "500", "--max-grad-norm", "10", "--train-freq", "2", "--gradient-steps", "2"],
        &["--eval-freq", "500", "--eval-episodes", "5", "--save-freq", "1000", "--reward-scale", "0.1"],
        &["--env", "CartPole-v1", "--n_step", "2", "--LR", "0.1", "--loss", "mse"],
    ];
    for config in &configs {
        for options in options {
            let sandbox = Sandbox::new();
            let refused = sandbox.run(&[&["train", "--config", config], *options].concat()).code(2);
            let message = String::from_utf8(refused.get_output().stderr.clone()).unwrap();
            let line = message.lines().nth(1).unwrap().replacen(" train ", " config show ", 1);
            let shown = std::process::Command::new("sh").args(["-c", &line]).output().unwrap();
            assert!(shown.status.success(), "{line}\n{}", String::from_utf8_lossy(&shown.stderr));
        }
    }
}

#[test]
#[cfg(unix)]
fn no_bytes_in_an_argument_the_environment_or_the_current_directory_are_a_panic() {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;
    let sandbox = Sandbox::with_run();
    let strange = OsStr::from_bytes(b"a\xff\x1bb");
    let strange_directory = sandbox.path("x").with_file_name(strange);
    fs::create_dir(&strange_directory).unwrap();
    let lines: &[&[&str]] = &[
        &[],
        &["train"],
        &["train", "--steps"],
        &["train", "--set"],
        &["train", "--config"],
        &["train", "--resume"],
        &["train", "--init-from"],
        &["eval"],
        &["eval", "--checkpoint"],
        &["inspect"],
        &["inspect", "--checkpoint"],
        &["watch"],
        &["study", "--vary"],
        &["study", "--seeds", "0..1", "--out", "s", "--config"],
        &["report"],
        &["verify"],
        &["config", "show", "--set"],
        &["config", "show", "--config"],
        &["completions"],
    ];
    for line in lines {
        let refused = sandbox.assert(sandbox.command(line).arg(strange));
        let output = refused.get_output();
        assert!([1, 2].contains(&output.status.code().unwrap()), "{line:?}: {output:?}");
        assert!(!output.stderr.contains(&0x1b), "{line:?}: {output:?}");
    }
    for (directory, run) in [(".", "b"), (strange_directory.to_str().unwrap_or("strange"), "c")] {
        let mut command = sandbox.command(&["train"]);
        let directory =
            if directory == "strange" { strange_directory.clone() } else { sandbox.path(directory) };
        command.current_dir(&directory).args(sets(TINY)).args(["--out", run]);
        for variable in ["NO_COLOR", "CLICOLOR_FORCE", "TERM", "COLUMNS", "HOME", "TMPDIR_", "LANG"] {
            command.env(variable, strange);
        }
        command.assert().success();
    }
    sandbox
        .assert(sandbox.command(&["report"]).arg(strange_directory.join("c")).env("NO_COLOR", strange))
        .success();
    let out = ["train", "--quiet", "--out"];
    sandbox.assert(sandbox.command(&out).arg(strange_directory.join("d")).args(sets(TINY))).success();
    sandbox.assert(sandbox.command(&["verify"]).arg(strange_directory.join("d"))).success();
}

#[test]
fn a_config_is_read_from_standard_input() {
    let sandbox = Sandbox::new();
    let config = "{\"gamma\": 0.5}";
    let arguments = [&["train", "--quiet", "--config", "-"], &sets(TINY)[..]].concat();
    sandbox.assert(sandbox.command(&arguments).write_stdin(config)).success();
    let name = fs::read_dir(sandbox.path("runs")).unwrap().next().unwrap().unwrap().file_name();
    let name = name.into_string().unwrap();
    assert!(name.starts_with("stdin-s0-"), "{name}");
    assert_eq!(sandbox.json(&format!("runs/{name}/config.json"))["gamma"], 0.5);
    let shown =
        sandbox.assert(sandbox.command(&["config", "show", "--config", "-"]).write_stdin(config)).success();
    shown.stdout(predicate::str::contains("gamma=0.5\n"));
    let arguments =
        [&["study", "--quiet", "--config", "-", "--seeds", "0..1", "--out", "s"], &sets(TINY)[..]];
    sandbox.assert(sandbox.command(&arguments.concat()).write_stdin(config)).success();
    assert_eq!(sandbox.json("s/study.json")["configs"][0]["name"], "stdin");
}

#[test]
fn the_first_line_says_what_is_trained_with_which_seed_and_where() {
    let sandbox = Sandbox::new();
    let stderr = |arguments: &[&str]| {
        let output = sandbox.train(arguments).success();
        String::from_utf8(output.get_output().stderr.clone()).unwrap()
    };
    let first = "training cartpole: seed 7, budget 200 steps, in run\n";
    assert!(stderr(&["--out", "run", "--seed", "7"]).starts_with(first));
    let long = "a".repeat(90);
    let text = stderr(&["--out", &long]);
    assert!(
        text.starts_with(&format!("training cartpole: seed 0, budget 200 steps, in\n  {long}\n")),
        "{text}"
    );
    assert_eq!(stderr(&["--out", "q", "--quiet"]), "");
    assert!(!stderr(&["--out", "j", "--json"]).contains("training cartpole"));
    let resumed = sandbox.run(&["train", "--resume", "run", "--set", "budget.steps=300"]).success();
    resumed.stderr(predicate::str::starts_with("resuming at step 200: seed 7, budget 300 steps, in run\n"));
}

#[test]
fn log_every_prints_the_line_of_the_tutorial() {
    let sandbox = Sandbox::new();
    let stderr = |arguments: &[&str]| {
        let output = sandbox.train(arguments).success();
        String::from_utf8(output.get_output().stderr.clone()).unwrap()
    };
    let text = stderr(&["--out", "a", "--log-every", "3"]);
    let episodes: Vec<Value> = sandbox
        .read("a/metrics.jsonl")
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .filter(|event: &Value| event["event"] == "episode")
        .collect();
    let line = |event: &Value| {
        let number = event["episode"].as_u64().unwrap() + 1;
        let epsilon = event["epsilon"].as_f64().unwrap();
        format!("episode {number}  return {}  epsilon {epsilon:.2}", event["return"].as_f64().unwrap())
    };
    let expected: Vec<String> = episodes.iter().skip(2).step_by(3).map(line).collect();
    assert!(!expected.is_empty());
    assert_eq!(text.lines().skip(1).collect::<Vec<_>>(), expected);

    let episodes = TINY.iter().map(|set| set.replace("budget.steps=200", "budget.episodes=12"));
    let episodes: Vec<String> = episodes.flat_map(|set| ["--set".into(), set]).collect();
    let episodes: Vec<&str> = episodes.iter().map(String::as_str).collect();
    let arguments = [&["train", "--out", "b", "--log-every", "12"], &episodes[..]].concat();
    let line = predicate::str::is_match(r"(?m)^episode 12/12  return \d+  epsilon \d\.\d\d$").unwrap();
    sandbox.run(&arguments).success().stderr(line);
    sandbox.refuses(&["train", "--log-every", "0"], &["--log-every", "from 1 to"]);
    sandbox.refuses(&["train", "--log-every", "1", "--quiet"], &["--log-every", "--quiet"]);
}

#[test]
fn the_summary_names_both_policies_and_fits_80_columns() {
    let sandbox = Sandbox::new();
    let long = "a".repeat(75);
    let trained = sandbox.train(&["--out", &long]).success();
    let text = String::from_utf8(trained.get_output().stdout.clone()).unwrap();
    for line in text.lines() {
        assert!(line.chars().count() <= 80 || line.ends_with(&long), "{line}");
    }
    assert!(text.starts_with(&format!("run\n  {long}\n")), "{text}");
    let summary = sandbox.json(&format!("{long}/summary.json"));
    let mean = |field: &str| summary[field]["mean"].as_f64().unwrap();
    let best = summary["best_evaluation"]["env_steps"].as_u64().unwrap();
    assert!(text.contains(&format!(
        "\nbest       mean return {:.1} in the evaluation at step {best}: not solved\n",
        mean("best_evaluation")
    )));
    assert!(text.contains(&format!(
        "\nfinal      mean return {:.1} in the evaluation at step 200: not solved\n",
        mean("final_evaluation")
    )));
    assert!(text.contains("\nended      the whole budget of 200 steps was trained\n"));
    for command in ["eval", "watch", "report"] {
        assert!(text.contains(&format!(" {command} {long}\n")), "{text}");
    }
    let last = sandbox.read(&format!("{long}/metrics.jsonl"));
    let events: Vec<Value> = last.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let last = events.iter().rfind(|event| event["event"] == "episode").unwrap();
    assert_eq!(summary["mean_return_100"], last["mean_return_100"]);
    let episodes = summary["episodes"].as_u64().unwrap();
    let mean = summary["mean_return_100"].as_f64().unwrap();
    let line = format!("\ntraining   mean return {mean:.1} over the last {episodes} training episodes\n");
    assert!(text.contains(&line), "{text}");
}

#[test]
fn stop_when_solved_is_an_option() {
    let sandbox = Sandbox::new();
    sandbox.train(&["--out", "run", "--stop-when-solved"]).success();
    assert_eq!(sandbox.json("run/config.json")["stop_when_solved"], true);
    sandbox.train(&["--out", "other"]).success();
    let arguments = ["train", "--resume", "other", "--stop-when-solved"];
    sandbox.refuses(&arguments, &["`stop_when_solved` is false, and true is given"]);
}

/// Earlier versions wrote a `progress.csv` too.
#[test]
fn a_run_of_an_earlier_version_is_verified_resumed_and_replaced_with_its_progress_csv() {
    let sandbox = Sandbox::with_run();
    sandbox.write("run/progress.csv", "event,env_steps\n");
    sandbox.run(&["verify", "run"]).success();
    sandbox.run(&["train", "--resume", "run", "--set", "budget.steps=300"]).success();
    assert_eq!(sandbox.read("run/progress.csv"), "event,env_steps\n");
    sandbox.train(&["--out", "run", "--force"]).success();
    assert!(!sandbox.path("run/progress.csv").exists());
}

#[test]
fn a_run_starts_with_the_weights_of_a_file_whatever_the_scale_of_its_observations() {
    use cartpole_dqn::run::Checkpoint;
    let sandbox = Sandbox::with_run();
    let hardly_learns = ["--set", "optimizer.learning_rate=1e-12", "--set", "policy_weights=online"];
    let policy = |name: &str| Checkpoint::read(&sandbox.path(name)).unwrap().tensors.network(4, 2).unwrap();
    let given = policy("run/checkpoints/last.safetensors");
    for (out, scale) in [("same", "[1.2,1,0.105,1]"), ("other", "[3,0.5,7,0.01]"), ("none", "null")] {
        let scale = format!("observation_divisors={scale}");
        let from = "run/checkpoints/last.safetensors";
        let arguments = ["--out", out, "--init-from", from, "--set", &scale, "--seed", "9"];
        sandbox.train(&[&arguments[..], &hardly_learns].concat()).success();
        let trained = policy(&format!("{out}/checkpoints/last.safetensors"));
        for (a, b) in trained.parameters().iter().zip(given.parameters()) {
            assert!((a - b).abs() <= 1e-6 * b.abs().max(1e-3), "{out}: {a}, given {b}");
        }
    }
    assert!(keys(&sandbox.json("same/summary.json")).contains(&"init_sha256"));
    assert!(!keys(&sandbox.json("run/summary.json")).contains(&"init_sha256"));
}

#[test]
fn weights_of_another_shape_are_refused_with_both_shapes() {
    let sandbox = Sandbox::with_run();
    sandbox.refuses(
        &["train", "--init-from", "run", "--out", "new"],
        &["run/checkpoints/best.safetensors", "[4, 8, 2]", "[4, 24, 24, 2]", "--set 'network.hidden=[8]'"],
    );
    sandbox.write("x.safetensors", "x");
    sandbox.refuses(&["train", "--init-from", "x.safetensors", "--out", "new"], &["x.safetensors"]);
}

#[test]
#[cfg(unix)]
fn a_run_from_given_weights_is_resumed_and_verified_without_their_file() {
    use crate::resume::assert_same_runs;
    let sandbox = Sandbox::with_run();
    let train = |arguments: &[&str]| {
        sandbox.train(&[&["--init-from", "run", "--seed", "3"], arguments].concat()).success();
    };
    train(&["--out", "whole", "--set", "budget.steps=300"]);
    train(&["--out", "parts"]);
    train(&["--out", "killed", "--set", "budget.steps=300"]);
    fs::rename(sandbox.path("run"), sandbox.path("gone")).unwrap();
    sandbox.run(&["train", "--quiet", "--resume", "parts", "--set", "budget.steps=300"]).success();
    assert_same_runs(&sandbox, "whole", "parts");
    for file in ["best", "last", "previous"] {
        fs::remove_file(sandbox.path(&format!("killed/checkpoints/{file}.safetensors"))).unwrap();
    }
    fs::remove_file(sandbox.path("killed/summary.json")).unwrap();
    sandbox.write("killed/metrics.jsonl", "");
    sandbox.run(&["train", "--quiet", "--resume", "killed"]).success();
    assert_same_runs(&sandbox, "whole", "killed");
    sandbox.run(&["verify", "whole", "--quiet"]).success();
    fs::remove_file(sandbox.path("parts/checkpoints/init.safetensors")).unwrap();
    let gone = predicate::str::contains("the SHA-256 of its checkpoints/init.safetensors is null");
    sandbox.run(&["verify", "parts"]).code(1).stderr(gone);
    sandbox.train(&["--quiet", "--force", "--out", "whole"]).success();
    assert!(!sandbox.path("whole/checkpoints/init.safetensors").exists());
}

/// Learning that has not begun has no loss and says nothing of the speed that follows.
#[test]
fn the_progress_names_what_its_numbers_are() {
    let line = predicate::str::is_match(
        r"(?m)^step 100 \| return: (train \d+\.\d, )?eval \d+\.\d( \| ε \d\.\d\d)?$",
    )
    .unwrap();
    let late = ["--set", "replay.warmup_steps=150", "--out", "run"];
    Sandbox::new().train(&late).success().stderr(line);
}

#[test]
#[cfg(unix)]
fn a_signal_during_a_long_step_is_noticed_at_once_and_a_second_one_ends_it() {
    use std::io::{BufRead, BufReader};
    use std::process::{Command, Stdio};
    let sandbox = Sandbox::new();
    // A single learning step that takes hours.
    let long = ["--set", "learn.updates=4000000000", "--log-every", "1"];
    let interrupt = |child: &std::process::Child| crate::signals::kill(child, "-INT");
    // On a busy machine the first signal can come before the long step; that run just stops.
    let is_noticed = |attempt: u64| {
        let out = format!("run{attempt}");
        let mut child = Command::new(assert_cmd::cargo::cargo_bin!("cartpole-dqn"))
            .current_dir(sandbox.path("."))
            .args([&["train", "--out", &out], &sets(TINY)[..], &long].concat())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines().map(Result::unwrap);
        assert!(lines.next().unwrap().starts_with("training cartpole"));
        lines.find(|line| line.starts_with("episode 1 ")).unwrap();
        std::thread::sleep(std::time::Duration::from_millis(100 * attempt));
        interrupt(&child);
        let is_noticed = lines.any(|line| line.contains("press Ctrl-C again"));
        if is_noticed {
            interrupt(&child);
        }
        assert_eq!(child.wait().unwrap().code(), Some(130));
        is_noticed
    };
    assert!((1..=10).any(is_noticed));
}

#[test]
fn a_diverging_run_keeps_the_events_that_it_has_written() {
    let sandbox = Sandbox::new();
    sandbox.run(&[&["train", "--quiet", "--out", "run"], &sets(DIVERGING)[..]].concat()).code(1);
    assert!(sandbox.read("run/metrics.jsonl").starts_with("{\"event\":"));
}

/// A line break in a name would let it write lines of its own.
#[test]
fn shows_a_line_break_of_a_directory_or_a_file_escaped() {
    let sandbox = Sandbox::new();
    for arguments in [
        &["train", "--resume", "no\nerror: run"][..],
        &["train", "--config", "no\nerror: config"],
        &["eval", "no\nerror: policy"],
        &["study", "--seeds", "0..1", "--out", "no\nerror: directory/study.json/x"],
    ] {
        sandbox.write("no\nerror: directory", "a file");
        let output = sandbox.run(arguments).code(2);
        let message = String::from_utf8_lossy(&output.get_output().stderr).into_owned();
        assert!(message.contains("no\\nerror: ") && !message.contains("\nerror: "), "{message}");
    }
}
