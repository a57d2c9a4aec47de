//! `train --tensorboard` as a file; tests/interop/tensorboard_events.py reads it with TensorBoard.

use crate::cli::Sandbox;

/// The content of the one event file in the directory of a run.
fn events(sandbox: &Sandbox, run: &str) -> Vec<u8> {
    let files: Vec<_> = std::fs::read_dir(sandbox.path(run).join("tensorboard")).unwrap().collect();
    let [Ok(file)] = &files[..] else { panic!("{files:?}") };
    assert!(file.file_name().to_string_lossy().starts_with("events.out.tfevents."));
    std::fs::read(file.path()).unwrap()
}

#[test]
fn event_files_are_extra_and_leave_all_others_as_they_are() {
    let sandbox = Sandbox::new();
    sandbox.train(&["--out", "without"]).success();
    sandbox.train(&["--out", "with", "--tensorboard"]).success();
    assert!(!sandbox.path("without/tensorboard").exists());
    for file in
        ["metrics.jsonl", "config.json", "checkpoints/best.safetensors", "checkpoints/last.safetensors"]
    {
        let read = |run: &str| std::fs::read(sandbox.path(run).join(file)).unwrap();
        assert!(read("without") == read("with"), "{file}");
    }
}

#[test]
fn an_event_file_is_a_sequence_of_whole_records() {
    let sandbox = Sandbox::new();
    sandbox.train(&["--out", "run", "--tensorboard"]).success();
    let bytes = events(&sandbox, "run");
    let (mut records, mut rest) = (Vec::new(), &bytes[..]);
    while let Some((length, tail)) = rest.split_first_chunk::<8>() {
        // A checksum of the length, the content, a checksum of the content.
        let length = u64::from_le_bytes(*length) as usize;
        records.push(&tail[4..4 + length]);
        rest = &tail[4 + length + 4..];
    }
    assert!(rest.is_empty());
    assert!(records[0].ends_with(b"\x1a\x0dbrain.Event:2"), "{:?}", records[0]);
    let lines = sandbox.read("run/metrics.jsonl").lines().count();
    assert_eq!(records.len(), lines, "the version and every event but the end");
}

#[test]
fn force_replaces_event_files_too_and_nothing_that_is_not_one() {
    let sandbox = Sandbox::new();
    sandbox.train(&["--out", "run", "--tensorboard"]).success();
    sandbox.train(&["--out", "run", "--tensorboard", "--force"]).success();
    events(&sandbox, "run");
    sandbox.train(&["--out", "run", "--force"]).success();
    assert!(!sandbox.path("run/tensorboard").exists());
    sandbox.write("run/tensorboard/notes.txt", "mine");
    sandbox.refuses(
        &["train", "--out", "run", "--force"],
        &["tensorboard/notes.txt", "does not belong to a run"],
    );
}

/// The records of every event file of a run, the files by name.
fn files(sandbox: &Sandbox, run: &str) -> Vec<Vec<Vec<u8>>> {
    let directory = std::fs::read_dir(sandbox.path(run).join("tensorboard")).unwrap();
    let mut paths: Vec<_> = directory.map(|file| file.unwrap().path()).collect();
    paths.sort();
    let records = |bytes: Vec<u8>| {
        let (mut records, mut rest) = (Vec::new(), &bytes[..]);
        while let Some((length, tail)) = rest.split_first_chunk::<8>() {
            let length = u64::from_le_bytes(*length) as usize;
            records.push(tail[4..4 + length].to_vec());
            rest = &tail[4 + length + 4..];
        }
        records
    };
    paths.iter().map(|path| records(std::fs::read(path).unwrap())).collect()
}

#[test]
fn a_run_that_begins_again_at_step_0_makes_tensorboard_forget_the_first_try() {
    let sandbox = Sandbox::new();
    sandbox.train(&["--out", "run", "--tensorboard"]).success();
    std::fs::remove_dir_all(sandbox.path("run/checkpoints")).unwrap();
    std::fs::remove_file(sandbox.path("run/summary.json")).unwrap();
    sandbox.write("run/metrics.jsonl", "");
    sandbox.run(&["train", "--quiet", "--resume", "run"]).success();
    let [first, second] = &files(&sandbox, "run")[..] else { panic!("not two files") };
    // Step 0, and `SessionLog { status = START }`.
    let start = [&[2 << 3, 0][..], &[7 << 3 | 2, 2, 1 << 3, 1]].concat();
    assert!(second[1].ends_with(&start), "{:?}", second[1]);
    assert!(first.iter().all(|record| !record.ends_with(&start[2..])), "a new run has nothing to forget");
    assert_eq!(first.len() + 1, second.len());
}
