//! Runs that were stopped, killed, extended, damaged or repeated.

use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use predicates::prelude::*;
use serde_json::json;

use crate::cli::{DIVERGING, Sandbox, TINY, keys, sets, stdout_json};

const LAST: &str = "run/checkpoints/last.safetensors";
const PREVIOUS: &str = "run/checkpoints/previous.safetensors";
const BEST: &str = "run/checkpoints/best.safetensors";

/// Runs of the same command end in the same files, but for what says how long it took and where.
#[track_caller]
pub(crate) fn assert_same_runs(sandbox: &Sandbox, a: &str, b: &str) {
    let files = |run: &str| -> BTreeMap<PathBuf, Vec<u8>> {
        let directory = sandbox.path(run);
        let name = |path: PathBuf| Some(path.strip_prefix(&directory).ok()?.to_owned());
        sandbox.files().into_iter().filter_map(|(path, content)| Some((name(path)?, content?))).collect()
    };
    let (a_files, b_files) = (files(a), files(b));
    assert!(a_files.keys().eq(b_files.keys()), "{:?} and {:?}", a_files.keys(), b_files.keys());
    for ((name, a_content), b_content) in a_files.iter().zip(b_files.values()) {
        if name == Path::new("summary.json") {
            let summary = |run: &str| {
                let mut summary = sandbox.json(&format!("{run}/summary.json"));
                for circumstance in ["wall_seconds", "cpu_seconds"] {
                    summary.as_object_mut().unwrap().remove(circumstance).unwrap();
                }
                summary
            };
            assert_eq!(summary(a), summary(b));
        } else {
            assert!(a_content == b_content, "{} of {a} and {b} differ", name.display());
        }
    }
}

/// Every option of the algorithm that has a state, or none of its own.
const OPTIONS: [&[&str]; 6] = [
    &[],
    &["target={\"kind\":\"hard\",\"every_episodes\":2}", "replay.capacity=60"],
    &["replay.update=per_sample", "exploration={\"schedule\":\"per_episode\"}"],
    &["double=true", "n_step=4", "replay.capacity=100", "optimizer.schedule.steps=150"],
    &["target={\"kind\":\"soft\",\"tau\":0.01}", "policy_weights=target", "learn.every_steps=3"],
    &["optimizer.max_gradient_norm=0.5", "observation_divisors=[2.4,2,0.2095,2]", "reward_scale=0.01"],
];

/// [`TINY`] without what an option replaces.
fn settings<'a>(extra: &[&'a str]) -> Vec<&'a str> {
    let learn =
        |set: &&&str| !(set.starts_with("learn.every") && extra.iter().any(|e| e.starts_with("learn")));
    sets(&[&TINY.iter().filter(learn).copied().collect::<Vec<_>>()[..], extra].concat())
}

#[test]
fn a_run_with_a_larger_budget_is_the_run_that_had_it_from_the_start() {
    // On a checkpoint's step and an evaluation's, on one of them, between them in the middle of an episode.
    for (options, steps) in OPTIONS.into_iter().zip([100, 150, 137, 199, 151, 173]) {
        let sandbox = Sandbox::new();
        sandbox.write("my.json", include_str!("../data/plain_dqn.json"));
        let train = |arguments: &[&str]| {
            let plain = ["train", "--quiet", "--config", "my.json"];
            sandbox.run(&[&plain[..], &settings(options), arguments].concat()).success();
        };
        train(&["--out", "whole", "--set", "budget.steps=333"]);
        let steps = format!("budget.steps={steps}");
        train(&["--out", "parts", "--set", &steps]);
        sandbox.run(&["train", "--quiet", "--resume", "parts", "--set", "budget.steps=240"]).success();
        sandbox.run(&["train", "--quiet", "--resume", "parts", "--set", "budget.steps=333"]).success();
        assert_same_runs(&sandbox, "whole", "parts");
        sandbox.run(&["verify", "parts", "--quiet"]).success().stdout("").stderr("");
    }
}

#[test]
fn a_run_that_ended_with_a_policy_that_lasts_can_train_on() {
    let sandbox = Sandbox::new();
    let train = |arguments: &[&str]| {
        let budget =
            ["train", "--seed", "21", "--set", "budget.steps=3000", "--set", "checkpoint.every_steps=500"];
        sandbox.run(&[&budget[..], arguments].concat()).success()
    };
    train(&["--out", "whole", "--quiet", "--set", "stop_when_lasting_steps=null"]);
    let ended = "ended      the policy lasts 600 steps (stop_when_lasting_steps)";
    train(&["--out", "parts", "--set", "stop_when_lasting_steps=600"])
        .stdout(predicate::str::contains(ended));
    let steps = sandbox.json("parts/summary.json")["env_steps"].as_u64().unwrap();
    assert!(steps < 3000, "{steps}");
    sandbox.run(&["verify", "parts", "--quiet"]).success();

    let before = sandbox.files();
    let why = format!("the run ended after {steps} steps with a policy that lasts. To train on, type\n");
    let says = |command: &str| {
        predicate::str::contains(why.clone())
            .and(predicate::str::contains(format!(" train --resume parts {command}\n")))
    };
    let resume = |arguments: &[&str]| sandbox.run(&[&["train", "--resume", "parts"], arguments].concat());
    // Nothing is asked for that the run does not have.
    resume(&[]).success().stdout("").stderr(says("--set stop_when_lasting_steps=null"));
    // A budget by itself trains nothing, which no script takes for success.
    resume(&["--set", "budget.steps=9000"])
        .code(2)
        .stdout("")
        .stderr(says("--set budget.steps=9000 --set stop_when_lasting_steps=null"));
    resume(&["--set", "budget.episodes=70000"])
        .code(2)
        .stderr(says("--set budget.episodes=70000 --set stop_when_lasting_steps=null"));
    let used_up = format!("--set budget.steps={} --set stop_when_lasting_steps=null", 2 * steps);
    resume(&["--set", &format!("budget.steps={steps}")]).code(2).stderr(says(&used_up));
    assert!(before == sandbox.files());
    resume(&["--set", "stop_when_lasting_steps=700"]).code(2).stderr(predicate::str::contains("to null"));
    assert!(before == sandbox.files());

    resume(&["--quiet", "--set", "stop_when_lasting_steps=null"]).success();
    assert_same_runs(&sandbox, "whole", "parts");
    sandbox.run(&["verify", "parts", "--quiet"]).success();
}

#[test]
fn a_run_that_has_ended_is_extended_by_a_command_in_its_own_unit() {
    let sandbox = Sandbox::new();
    let tiny: Vec<&str> = TINY.iter().copied().filter(|set| !set.starts_with("budget")).collect();
    let train = [&["train", "--quiet"], &sets(&tiny)[..]].concat();
    sandbox.run(&[&train[..], &["--out", "my run", "--set", "budget.episodes=5"]].concat()).success();
    let resume = |arguments: &[&str]| sandbox.run(&[&["train", "--resume", "my run"], arguments].concat());
    let says = |words: &'static str| predicate::str::contains(words);
    resume(&[])
        .success()
        .stderr(says("type\n").and(says(" train --resume 'my run' --set budget.episodes=10\n")));
    resume(&["--set", "budget.episodes=4"])
        .code(2)
        .stderr(says("--resume 'my run' --set budget.episodes=10\n"));

    let solves = ["--stop-when-solved", "--seed", "21"];
    let long = ["train", "--quiet", "--out", "solved", "--set", "budget.steps=9000"];
    sandbox.run(&[&long[..], &solves].concat()).success();
    let command =
        " train --config solved/config.json --set budget.steps=20000 --set stop_when_solved=false\n";
    let extended = ["train", "--resume", "solved", "--set", "budget.steps=20000"];
    sandbox.run(&extended).code(2).stderr(says("solved its task").and(says(command)));
}

#[test]
fn a_budget_of_episodes_can_grow_too_and_become_one_of_steps() {
    let sandbox = Sandbox::new();
    let tiny: Vec<&str> = TINY.iter().copied().filter(|set| !set.starts_with("budget")).collect();
    let train = |arguments: &[&str]| {
        sandbox.run(&[&["train", "--quiet"], &sets(&tiny)[..], arguments].concat()).success();
    };
    train(&["--out", "whole", "--set", "budget.steps=400"]);
    train(&["--out", "parts", "--set", "budget.episodes=5"]);
    sandbox.run(&["train", "--quiet", "--resume", "parts", "--set", "budget.episodes=9"]).success();
    assert_eq!(sandbox.json("parts/summary.json")["episodes"], 9);
    sandbox.run(&["train", "--quiet", "--resume", "parts", "--set", "budget.steps=400"]).success();
    assert_same_runs(&sandbox, "whole", "parts");
}

/// Everything after the checkpoint: a line more, half a line, a better policy, a summary, half a file.
#[test]
fn what_a_killed_run_has_written_after_its_checkpoint_is_cut_off() {
    let sandbox = Sandbox::with_run();
    sandbox.train(&["--out", "whole", "--set", "budget.steps=300"]).success();
    let metrics = sandbox.read("whole/metrics.jsonl");
    sandbox.write("run/metrics.jsonl", &metrics[..metrics.len() - 20]);
    fs::copy(sandbox.path("whole/checkpoints/best.safetensors"), sandbox.path(BEST)).unwrap();
    sandbox.write("run/checkpoints/.writing-abc123.tmp", "half a checkpoint");
    sandbox.run(&["train", "--quiet", "--resume", "run", "--set", "budget.steps=300"]).success();
    assert_same_runs(&sandbox, "whole", "run");
}

#[test]
fn a_run_that_was_killed_before_its_first_checkpoint_starts_again() {
    let sandbox = Sandbox::with_run();
    sandbox.train(&["--out", "killed"]).success();
    fs::remove_dir_all(sandbox.path("killed/checkpoints")).unwrap();
    fs::remove_file(sandbox.path("killed/summary.json")).unwrap();
    sandbox.write("killed/metrics.jsonl", "");
    let noted = predicate::str::contains("note: the run has no checkpoint yet, so it starts again at step 0");
    sandbox.run(&["train", "--quiet", "--resume", "killed"]).success().stderr(noted);
    assert_same_runs(&sandbox, "run", "killed");
}

#[test]
fn a_run_that_has_lost_its_checkpoints_is_refused_and_keeps_what_it_has() {
    let resume = ["train", "--resume", "run", "--set", "budget.steps=300"];
    for kept in ["run/metrics.jsonl", BEST, "run/summary.json"] {
        let sandbox = Sandbox::with_run();
        for file in [LAST, PREVIOUS, BEST, "run/summary.json"] {
            if file != kept {
                fs::remove_file(sandbox.path(file)).unwrap();
            }
        }
        if kept != "run/metrics.jsonl" {
            sandbox.write("run/metrics.jsonl", "");
        }
        sandbox.refuses(&resume, &["last.safetensors", "previous.safetensors", "missing", "train again"]);
    }
}

#[test]
fn an_extended_run_says_which_schedules_have_ended_and_how_to_stretch_them() {
    let sandbox = Sandbox::new();
    let schedules = sets(&["optimizer.schedule.steps=200", "exploration.steps=100"]);
    sandbox.train(&[&schedules[..], &["--out", "run"]].concat()).success();
    let noted = predicate::str::contains("ends at step 200: from there on the rate is 0")
        .and(predicate::str::contains("--set optimizer.schedule.steps=300"))
        .and(predicate::str::contains("the schedule of epsilon ended at step 100"))
        .and(predicate::str::contains("--set exploration.steps=300"));
    let resume = ["train", "--quiet", "--resume", "run", "--set", "budget.steps=300"];
    sandbox.run(&resume).success().stderr(noted);
}

#[test]
fn an_extended_run_with_another_schedule_is_a_branch_and_verify_says_so() {
    let sandbox = Sandbox::new();
    sandbox.train(&["--out", "run", "--set", "optimizer.schedule.steps=200"]).success();
    let before = sandbox.json("run/summary.json");
    let schedule = sets(&["budget.steps=300", "optimizer.schedule.steps=400"]);
    let resume = [&["train", "--quiet", "--resume", "run"], &schedule[..]].concat();
    sandbox.run(&resume).success().stderr(
        predicate::str::contains("from step 200 on").and(predicate::str::contains("a branch of its own")),
    );
    let summary = sandbox.json("run/summary.json");
    assert_eq!(summary["branched_at_step"], 200);
    assert_ne!(summary["weights_sha256"], before["weights_sha256"]);
    assert_eq!(sandbox.json("run/config.json")["optimizer"]["schedule"]["steps"], 400);
    sandbox.refuses(&["verify", "run"], &["cannot be verified", "from step 200 on"]);
    // The branch goes on as any run does.
    sandbox.run(&["train", "--quiet", "--resume", "run", "--set", "budget.steps=350"]).success();
}

/// A process that was killed just after it had resumed a run with another schedule leaves the new config and the old checkpoint.
#[test]
fn a_branch_whose_process_was_killed_at_once_is_still_a_branch() {
    let sandbox = Sandbox::new();
    sandbox.train(&["--out", "run", "--set", "optimizer.schedule.steps=200"]).success();
    fs::remove_file(sandbox.path("run/summary.json")).unwrap();
    let mut config = sandbox.json("run/config.json");
    config["budget"]["steps"] = json!(300);
    config["optimizer"]["schedule"]["steps"] = json!(400);
    sandbox.write("run/config.json", config.to_string());
    sandbox.refuses(&["verify", "run"], &["cannot be verified", "from step 200 on"]);
    let noted = predicate::str::contains("a branch of its own");
    sandbox.run(&["train", "--quiet", "--resume", "run"]).success().stderr(noted);
    assert_eq!(sandbox.json("run/summary.json")["branched_at_step"], 200);
    sandbox.refuses(&["verify", "run"], &["cannot be verified", "from step 200 on"]);
}

#[test]
fn a_directory_that_a_killed_process_left_before_it_was_a_run_is_free() {
    let sandbox = Sandbox::new();
    sandbox.write("run/metrics.jsonl", "");
    sandbox.write("run/.writing-abc123.tmp", "half a config");
    fs::create_dir(sandbox.path("run/checkpoints")).unwrap();
    sandbox.train(&["--out", "run"]).success();
}

#[test]
fn a_run_that_has_ended_is_left_alone() {
    let sandbox = Sandbox::with_run();
    let before = sandbox.files();
    let noted = predicate::str::contains("note: the run has ended after 200 steps")
        .and(predicate::str::contains("--set budget.steps=400"));
    sandbox.run(&["train", "--resume", "run"]).success().stdout("").stderr(noted);
    assert!(before == sandbox.files());
}

#[test]
fn a_resumed_run_can_change_its_budget_alone() {
    let sandbox = Sandbox::with_run();
    let refuses = |arguments: &[&str], words: &[&str]| {
        sandbox.refuses(&[&["train", "--resume", "run"], arguments].concat(), words);
    };
    refuses(&["--set", "gamma=0.5"], &["directory run", "its `gamma` is 0.999, and 0.5 is given", "budget"]);
    refuses(&["--seed", "5"], &["its `seed` is 0, and 5 is given", "budget"]);
    refuses(
        &["--set", "exploration.steps=9"],
        &["has ended", "train --resume run --set exploration.steps=9 --set budget.steps=400"],
    );
    refuses(&["--set", "exploration.schedule=per_episode"], &["`exploration", "budget"]);
    refuses(
        &["--set", "budget.steps=150"],
        &["past the budget {\"steps\":150}", "at step 200", "train --resume run --set budget.steps=400"],
    );
    refuses(&["--set", "budget.steps=x"], &["`budget.steps`", "integer"]);
    sandbox.run(&["train", "--resume", "run", "--set", "gamma=0.999", "--seed", "0"]).success();
}

#[test]
fn resume_takes_no_other_run_config_or_directory() {
    let sandbox = Sandbox::with_run();
    for flag in [&["--config", "run/config.json"][..], &["--out", "b"], &["--force"]] {
        let arguments = [&["train", "--resume", "run"], flag].concat();
        sandbox.refuses(&arguments, &["--resume", flag[0], "cannot be used with"]);
    }
    sandbox.refuses(&["train", "--resume", "nowhere"], &["directory nowhere does not exist", "runs/my-run"]);
    sandbox.refuses(&["train", "--resume", LAST], &["is not a directory", "runs/my-run"]);
    sandbox.refuses(&["train", "--resume", "."], &["does not hold a run", "config.json", "No such file"]);
    sandbox.write("run/config.json", "{\"gamma\": 7}");
    sandbox.refuses(&["train", "--resume", "run"], &["run/config.json", "`gamma`", "from 0 to 1"]);
}

#[test]
fn a_config_that_was_changed_by_hand_is_refused() {
    let sandbox = Sandbox::with_run();
    let changed = sandbox.read("run/config.json").replace("\"gamma\": 0.999", "\"gamma\": 0.98");
    sandbox.write("run/config.json", changed);
    let arguments = ["train", "--resume", "run", "--set", "budget.steps=300"];
    sandbox.refuses(&arguments, &[LAST, "does not belong to the config.json", "`gamma` is 0.98, and 0.999"]);
}

#[test]
fn metrics_that_were_cut_off_are_refused() {
    let sandbox = Sandbox::with_run();
    let first = sandbox.read("run/metrics.jsonl").lines().next().unwrap().to_owned();
    sandbox.write("run/metrics.jsonl", first + "\n");
    let arguments = ["train", "--resume", "run", "--set", "budget.steps=300"];
    sandbox.refuses(&arguments, &["metrics.jsonl with fewer lines than the"]);
    fs::remove_file(sandbox.path("run/metrics.jsonl")).unwrap();
    sandbox.refuses(&arguments, &["has no metrics.jsonl"]);
}

#[test]
fn a_damaged_checkpoint_gives_way_to_the_previous_one() {
    let sandbox = Sandbox::new();
    sandbox.train(&["--out", "whole", "--set", "budget.steps=333"]).success();
    for damage in ["a flipped bit", "cut off", "gone"] {
        sandbox.train(&["--out", "run", "--set", "budget.steps=230", "--force"]).success();
        let mut bytes = fs::read(sandbox.path(LAST)).unwrap();
        match damage {
            "a flipped bit" => {
                let middle = bytes.len() / 2;
                bytes[middle] ^= 1;
                sandbox.write(LAST, bytes);
            }
            "cut off" => sandbox.write(LAST, &bytes[..bytes.len() - 1]),
            _ => fs::remove_file(sandbox.path(LAST)).unwrap(),
        }
        let resume = ["train", "--quiet", "--resume", "run", "--set", "budget.steps=333"];
        let noted = predicate::str::contains(format!("note: checkpoint {LAST}"))
            .and(predicate::str::contains(format!("resuming from {PREVIOUS} at step 200")));
        sandbox.run(&resume).success().stderr(noted);
        assert_same_runs(&sandbox, "whole", "run");
    }
}

#[test]
fn two_damaged_checkpoints_are_refused_by_name() {
    let sandbox = Sandbox::with_run();
    sandbox.write(LAST, "x");
    sandbox.write(PREVIOUS, "y");
    let resume = ["train", "--resume", "run"];
    sandbox.refuses(&resume, &[LAST, PREVIOUS, "damaged", "--config run/config.json"]);
}

#[test]
fn every_flipped_bit_of_a_checkpoint_is_noticed() {
    use cartpole_dqn::run::Checkpoint;
    let task = cartpole_dqn::env::catalogue::EnvironmentId::CartPoleV1.spec();
    let sandbox = Sandbox::with_run();
    let mut bytes = fs::read(sandbox.path(BEST)).unwrap();
    for place in 0..bytes.len() {
        for bit in 0..8 {
            bytes[place] ^= 1 << bit;
            let read = Checkpoint::from_bytes(&bytes);
            let noticed = read.is_err() || read.is_ok_and(|found| found.policy(&task).is_err());
            assert!(noticed, "bit {bit} of byte {place}");
            bytes[place] ^= 1 << bit;
        }
    }
}

#[test]
fn links_and_directories_in_a_run_are_not_written_through() {
    let arguments = ["train", "--resume", "run", "--set", "budget.steps=300"];
    for file in ["run/metrics.jsonl", LAST, BEST, PREVIOUS, "run/summary.json", "run/config.json"] {
        let sandbox = Sandbox::with_run();
        fs::rename(sandbox.path(file), sandbox.path("mine")).unwrap();
        symlink(sandbox.path("mine"), sandbox.path(file)).unwrap();
        sandbox.refuses(&arguments, &[file, "link"]);
        fs::remove_file(sandbox.path(file)).unwrap();
        fs::create_dir(sandbox.path(file)).unwrap();
        sandbox.refuses(&arguments, &["directory run"]);
    }
}

#[test]
fn two_processes_cannot_write_one_run() {
    let sandbox = Sandbox::new();
    let mut child = Command::new(assert_cmd::cargo::cargo_bin!("cartpole-dqn"))
        .current_dir(sandbox.path("."))
        .args([&["train", "--out", "run"], &sets(TINY)[..], &["--set", "budget.steps=1000000000"]].concat())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    while !sandbox.path(LAST).exists() {
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    for arguments in
        [&["train", "--resume", "run"][..], &["train", "--force", "--out", "run"], &["verify", "run"]]
    {
        sandbox.run(arguments).code(2).stderr(predicate::str::contains("in use by another process"));
    }
    // The kernel releases the lock of a process that dies.
    child.kill().unwrap();
    child.wait().unwrap();
    sandbox.run(&["verify", "run", "--quiet"]).success();
}

#[test]
fn verify_names_a_summary_that_cannot_be_one() {
    let sandbox = Sandbox::with_run();
    sandbox.write("run/summary.json", vec![b' '; 2 << 20]);
    sandbox.refuses(&["verify", "run"], &["summary.json", "larger than"]);
}

#[test]
fn verify_names_the_first_line_that_differs_and_every_other_file() {
    let sandbox = Sandbox::with_run();
    let agrees = predicate::str::contains("every byte agrees");
    sandbox.run(&["verify", "run"]).success().stdout(agrees);
    let metrics = sandbox.read("run/metrics.jsonl");
    let changed: Vec<String> = metrics
        .lines()
        .enumerate()
        .map(|(i, line)| if i == 6 { line.replace("\"env_steps\":", "\"env_steps\":1") } else { line.into() })
        .collect();
    sandbox.write("run/metrics.jsonl", changed.join("\n") + "\n");
    fs::remove_file(sandbox.path(BEST)).unwrap();
    let mut summary = sandbox.json("run/summary.json");
    summary["updates"] = json!(7);
    sandbox.write("run/summary.json", summary.to_string());
    let mut last = fs::read(sandbox.path(LAST)).unwrap();
    let middle = last.len() / 2;
    last[middle] ^= 4;
    sandbox.write(LAST, last);
    let before = sandbox.files();
    let refused = sandbox.run(&["verify", "run", "--quiet"]).code(1).stdout("");
    let message = String::from_utf8(refused.get_output().stderr.clone()).unwrap();
    for words in [
        "metrics.jsonl, first at line 7:\n  recorded {\"event\":",
        "checkpoints/best.safetensors: No such file",
        "checkpoints/last.safetensors: is damaged",
        "summary.json: its `updates` is 7",
    ] {
        assert!(message.contains(words), "{words} not in {message}");
    }
    assert!(before == sandbox.files());
}

#[test]
fn verify_takes_a_run_that_has_not_ended_up_to_its_checkpoint() {
    let sandbox = Sandbox::new();
    let diverges = ["train", "--quiet", "--out", "run", "--set", "checkpoint.every_steps=10"];
    sandbox.run(&[&diverges[..], &sets(DIVERGING)].concat()).code(1);
    let said = predicate::str::is_match("every byte agrees: .* up to its last checkpoint, at step [0-9]+0;");
    sandbox.run(&["verify", "run", "--quiet"]).success();
    sandbox.run(&["verify", "run"]).success().stdout(said.unwrap());
    fs::remove_file(sandbox.path(LAST)).unwrap();
    sandbox.refuses(&["verify", "run"], &[LAST, "No such file"]);
    sandbox.refuses(&["verify", "nowhere"], &["nowhere does not exist"]);
}

#[test]
fn the_summary_says_what_it_takes_to_repeat_the_run() {
    let sandbox = Sandbox::new();
    let summary = stdout_json(&sandbox.train(&["--out", "run", "--json"]).success());
    assert!(keys(&summary).contains(&"seed") && summary["weights_sha256"].is_string());
    assert_eq!(summary["version"], env!("CARGO_PKG_VERSION"));
    let config = cartpole_dqn::tensors::sha256([sandbox.read("run/config.json")]);
    assert_eq!(summary["config_sha256"], config);
    assert!(["scalar", "avx2", "avx512", "neon"].contains(&summary["cpu_path"].as_str().unwrap()));
    let revision = &summary["git_revision"];
    let is_revision = |text: &str| text.trim_end_matches("-dirty").chars().all(|c| c.is_ascii_hexdigit());
    assert!(revision.is_null() || revision.as_str().is_some_and(is_revision), "{revision}");
}

/// Checkpoints that were written by the program of each format version. They must load for ever.
#[test]
fn checkpoints_of_every_format_version_load() {
    use cartpole_dqn::run::{Checkpoint, FORMAT_VERSION, Header, load};
    use cartpole_dqn::trainer::Event;
    let directory = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/checkpoints");
    let mut weights = Vec::new();
    for version in 3..=FORMAT_VERSION {
        let file = |kind: &str| directory.join(format!("version{version}-{kind}.safetensors"));
        let sandbox = Sandbox::new();
        for kind in ["best", "last"] {
            let path = file(kind);
            let path = path.to_str().unwrap();
            sandbox.run(&["eval", "--checkpoint", path, "--episodes", "2"]).success();
            let said = predicate::str::contains(format!("cartpole-dqn version {version}: policy"));
            sandbox.run(&["inspect", "--checkpoint", path]).success().stdout(said);
        }
        let last = Checkpoint::read(&file("last")).unwrap();
        assert_eq!(last.version().unwrap(), Some(version));
        let config = last.header::<Header>().unwrap().config;
        let mut trainer = load(&file("last"), &config).unwrap();
        assert_eq!((trainer.progress().env_steps, trainer.progress().updates), (700, 501));
        for _ in 0..50 {
            trainer.step(&mut Vec::<Event>::new()).unwrap();
        }
        weights.push(trainer.agent().weights_sha256());
    }
    // The files are of the same run, so that every version goes on with the same bits.
    weights.dedup();
    assert_eq!(weights.len(), 1);
}

/// `train` that can write no file of more than `blocks` × 512 bytes: every write past that fails, as on a failing disk.
fn train_with_small_files(sandbox: &Sandbox, blocks: u32, arguments: &[&str]) -> assert_cmd::assert::Assert {
    let mut command = assert_cmd::Command::new("sh");
    command.current_dir(sandbox.path(".")).args([
        "-c",
        &format!("trap '' XFSZ; ulimit -f {blocks}; exec \"$0\" \"$@\""),
        assert_cmd::cargo::cargo_bin!("cartpole-dqn").to_str().unwrap(),
    ]);
    command.args(arguments).assert()
}

#[test]
fn a_write_that_fails_ends_the_run_with_its_last_good_checkpoint_and_loses_nothing() {
    for (file, settings) in [
        // Checkpoints grow with the replay memory, metrics with every episode.
        ("last.safetensors", &["budget.steps=3000", "replay.capacity=5000"][..]),
        ("an event", &["budget.steps=9000", "replay.capacity=60"]),
    ] {
        let sandbox = Sandbox::new();
        let train = [&["train", "--quiet"], &sets(TINY)[..], &sets(settings)].concat();
        sandbox.run(&[&train[..], &["--out", "whole"]].concat()).success();
        let failed = train_with_small_files(&sandbox, 40, &[&train[..], &["--out", "run"]].concat());
        let said = predicate::str::contains(file).and(predicate::str::contains("File too large"));
        let hint = predicate::str::contains("checkpoint is kept in run")
            .and(predicate::str::contains("train --resume run"));
        failed.code(1).stdout("").stderr(said.and(hint));
        assert!(!sandbox.path("run/summary.json").exists());
        sandbox.run(&["verify", "run", "--quiet"]).success();
        sandbox.run(&["train", "--quiet", "--resume", "run"]).success();
        assert_same_runs(&sandbox, "whole", "run");
    }
}
