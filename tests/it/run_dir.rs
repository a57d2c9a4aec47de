//! Commands beside a run: what is refused changes nothing.

use std::fs::{self, File};
use std::os::unix::fs::PermissionsExt as _;
use std::process::{Child, Command, Stdio};

use predicates::prelude::*;
use serde_json::Value;

use crate::cli::{DIVERGING, Sandbox, TINY, sets, stdout_json};
use crate::resume::assert_same_runs;

fn start(sandbox: &Sandbox, arguments: &[&str]) -> Child {
    Command::new(assert_cmd::cargo::cargo_bin!("cartpole-dqn"))
        .current_dir(sandbox.path("."))
        .args([&["train", "--quiet"], &sets(TINY)[..], arguments].concat())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap()
}

#[test]
fn a_refused_command_leaves_a_running_training_alone() {
    let sandbox = Sandbox::new();
    // No checkpoint but the first: nothing stands in the directory of the checkpoints that could protect it.
    let long = sets(&["budget.steps=60000", "evaluation.every_steps=50000", "checkpoint.every_steps=900000"]);
    let mut child = start(&sandbox, &[&["--out", "run"], &long[..]].concat());
    while !sandbox.path("run/metrics.jsonl").metadata().is_ok_and(|file| file.len() > 0) {
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
    for arguments in [
        &["train", "--out", "run"][..],
        &["train", "--out", "run", "--force"],
        &["train", "--resume", "run"],
        &["verify", "run"],
        &["study", "--seeds", "0..1", "--out", "run"],
    ] {
        sandbox.run(arguments).code(2);
    }
    assert!(child.wait().unwrap().success());
    sandbox.train(&[&["--quiet", "--out", "whole"], &long[..]].concat()).success();
    assert_same_runs(&sandbox, "whole", "run");
}

#[test]
fn of_two_trainings_started_together_exactly_one_wins() {
    let sandbox = Sandbox::new();
    sandbox.train(&["--quiet", "--out", "whole"]).success();
    for run in (0..8).map(|i| format!("below/{i}/run")) {
        let children = [(); 2].map(|()| start(&sandbox, &["--out", &run]));
        let mut codes = children.map(|mut child| child.wait().unwrap().code());
        codes.sort_unstable();
        assert_eq!(codes, [Some(0), Some(2)]);
        assert_same_runs(&sandbox, "whole", &run);
    }
}

#[test]
fn a_file_that_another_process_still_writes_is_not_taken_for_abandoned() {
    let sandbox = Sandbox::with_run();
    let live = "run/.writing-live00.tmp";
    sandbox.write(live, "half");
    sandbox.write("run/.writing-dead00.tmp", "half");
    let file = File::open(sandbox.path(live)).unwrap();
    file.lock().unwrap();
    sandbox.run(&["train", "--quiet", "--resume", "run", "--set", "budget.steps=300"]).success();
    assert!(sandbox.path(live).exists() && !sandbox.path("run/.writing-dead00.tmp").exists());
    sandbox.train(&["--quiet", "--out", "run", "--force"]).success();
    assert!(sandbox.path(live).exists());
    let study = [&["study", "--quiet", "--seeds", "0..1", "--out", "study"], &sets(TINY)[..]].concat();
    fs::create_dir_all(sandbox.path("study")).unwrap();
    fs::rename(sandbox.path(live), sandbox.path("study/.writing-live00.tmp")).unwrap();
    // Many processes work on a study, and where locks do not work it cannot know what is abandoned.
    drop(file);
    sandbox.run(&study).success();
    assert!(sandbox.path("study/.writing-live00.tmp").exists());
}

#[test]
fn force_is_not_offered_where_there_is_no_run() {
    let sandbox = Sandbox::new();
    sandbox.write("mine/notes.txt", "mine");
    let said = predicate::str::contains("holds no run").and(predicate::str::contains("to replace").not());
    sandbox.run(&["train", "--out", "mine"]).code(2).stderr(said);
}

#[cfg(unix)]
#[test]
fn force_does_not_follow_a_link_into_the_checkpoints_of_another_run() {
    let sandbox = Sandbox::with_run();
    sandbox.train(&["--quiet", "--out", "other"]).success();
    std::fs::remove_dir_all(sandbox.path("run/checkpoints")).unwrap();
    std::os::unix::fs::symlink("../other/checkpoints", sandbox.path("run/checkpoints")).unwrap();
    sandbox.refuses(&["train", "--out", "run", "--force"], &["run/checkpoints", "does not belong to a run"]);
}

#[test]
fn a_run_whose_directory_is_removed_does_not_say_that_something_is_kept() {
    let sandbox = Sandbox::new();
    let mut command = sandbox.command(&["train", "--quiet", "--out", "run"]);
    command.args(sets(TINY)).args(sets(&["budget.steps=1000000", "checkpoint.every_steps=5000"]));
    let run = sandbox.path("run");
    let remover = std::thread::spawn(move || {
        while !run.join("metrics.jsonl").metadata().is_ok_and(|file| file.len() > 0) {
            std::thread::sleep(std::time::Duration::from_millis(2));
        }
        while run.exists() {
            let _ = fs::remove_dir_all(&run);
        }
    });
    command.assert().code(1).stderr(
        predicate::str::contains("the directory run is gone").and(predicate::str::contains("is kept").not()),
    );
    remover.join().unwrap();
}

#[test]
fn json_says_how_a_run_ended_that_was_over_or_that_failed() {
    let sandbox = Sandbox::with_run();
    let again = stdout_json(&sandbox.run(&["train", "--json", "--resume", "run"]).success());
    assert_eq!(again, sandbox.json("run/summary.json"));
    let diverges = [&["train", "--quiet", "--json", "--out", "bad"], &sets(DIVERGING)[..]].concat();
    let failed: Value = stdout_json(&sandbox.run(&diverges).code(1));
    assert_eq!(failed["end_reason"], "failed");
    assert!(failed["error"].as_str().unwrap().contains("diverged"));
}

#[test]
fn a_resumed_run_goes_on_with_its_event_files() {
    let sandbox = Sandbox::new();
    sandbox.train(&["--quiet", "--out", "run", "--tensorboard"]).success();
    let count = || fs::read_dir(sandbox.path("run/tensorboard")).unwrap().count();
    assert_eq!(count(), 1);
    sandbox.run(&["train", "--quiet", "--resume", "run", "--set", "budget.steps=300"]).success();
    assert_eq!(count(), 2);
}

#[test]
fn a_training_that_does_not_fit_into_memory_is_refused() {
    let sandbox = Sandbox::with_run();
    let limited = |arguments: &[&str]| {
        let mut command = assert_cmd::Command::new("sh");
        command.current_dir(sandbox.path(".")).args(["-c", "ulimit -v 600000; exec \"$0\" \"$@\""]);
        command.arg(assert_cmd::cargo::cargo_bin!("cartpole-dqn")).args(arguments).assert()
    };
    for set in ["replay.capacity=50000000", "network.hidden=[4096,4096]"] {
        let before = sandbox.files();
        let said = || predicate::str::contains("not enough memory").and(predicate::str::contains("MiB"));
        limited(&["train", "--out", "big", "--set", set]).code(2).stderr(said());
        limited(&["study", "--seeds", "0..1", "--jobs", "1", "--out", "big", "--set", set])
            .code(2)
            .stderr(said());
        assert!(before == sandbox.files());
    }
    limited(&["verify", "--quiet", "run"]).success();
}

#[test]
fn files_have_the_permissions_that_the_umask_leaves() {
    let sandbox = Sandbox::new();
    for (umask, mode) in [("077", 0o600), ("022", 0o644)] {
        let mut command = assert_cmd::Command::new("sh");
        command.current_dir(sandbox.path(".")).args(["-c", &format!("umask {umask}; exec \"$0\" \"$@\"")]);
        command.arg(assert_cmd::cargo::cargo_bin!("cartpole-dqn"));
        command.args(["train", "--quiet", "--out", umask]).args(sets(TINY)).assert().success();
        for file in ["config.json", "summary.json", "checkpoints/last.safetensors"] {
            let found = sandbox.path(umask).join(file).metadata().unwrap().permissions().mode() & 0o777;
            assert_eq!(found, mode, "{file}: {found:o}");
        }
    }
}

#[test]
fn a_checkpoint_that_cannot_be_one_is_refused_before_it_is_read() {
    let sandbox = Sandbox::new();
    for (size, words) in [(5 << 30, "larger than 4294967296 bytes"), (4 << 30, "not a safetensors file")] {
        let file = File::create(sandbox.path("big")).unwrap();
        file.set_len(size).unwrap();
        // 4 GiB would not fit.
        let mut command = assert_cmd::Command::new("sh");
        command.current_dir(sandbox.path(".")).args(["-c", "ulimit -v 1000000; exec \"$0\" \"$@\""]);
        command.arg(assert_cmd::cargo::cargo_bin!("cartpole-dqn"));
        command
            .args(["eval", "--checkpoint", "big"])
            .assert()
            .code(2)
            .stderr(predicate::str::contains(words));
    }
}

#[test]
fn a_checkpoint_sealed_again_with_spaces_in_its_json_is_whole() {
    use cartpole_dqn::run::Checkpoint;
    use cartpole_dqn::tensors::sha256;
    let sandbox = Sandbox::with_run();
    let bytes = fs::read(sandbox.path("run/checkpoints/best.safetensors")).unwrap();
    let end = 8 + usize::try_from(u64::from_le_bytes(bytes[..8].try_into().unwrap())).unwrap();
    let mut header: Value = serde_json::from_slice(&bytes[8..end]).unwrap();
    let own: Value = serde_json::from_str(header["__metadata__"]["cartpole-dqn"].as_str().unwrap()).unwrap();
    let digest = own["sha256"].as_str().unwrap().to_owned();
    let pretty = serde_json::to_string_pretty(&own).unwrap().replace(&digest, &"0".repeat(64));
    header["__metadata__"]["cartpole-dqn"] = pretty.into();
    let header = header.to_string().into_bytes();
    let unsealed = [&(header.len() as u64).to_le_bytes()[..], &header, &bytes[end..]].concat();
    let place = unsealed.windows(64).position(|window| window == [b'0'; 64]).unwrap();
    let mut sealed = unsealed.clone();
    sealed[place..place + 64].copy_from_slice(sha256([&unsealed]).as_bytes());
    assert!(Checkpoint::from_bytes(&sealed).is_ok());
    let middle = sealed.len() - 9;
    sealed[middle] ^= 1;
    assert!(Checkpoint::from_bytes(&sealed).is_err());
}
