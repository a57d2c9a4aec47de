//! Files of any content: a message and exit code 2, or what the file says. No panic, no hang.

use std::fs;
use std::path::{Path, PathBuf};

use assert_cmd::assert::Assert;
use cartpole_dqn::check::{Update, check};
use cartpole_dqn::config::Config;
use cartpole_dqn::explain::explain;
use cartpole_dqn::report::Report;
use cartpole_dqn::run::{Checkpoint, Header, seal};
use cartpole_dqn::trainer::{Budget, Event};
use predicates::prelude::PredicateBooleanExt as _;
use proptest::collection::vec;
use proptest::prelude::*;
use proptest::sample::{Index, select};

use crate::cli::{Sandbox, TINY, sets};
use crate::study::trial_file;

/// What is done to a file.
#[derive(Clone, Debug)]
enum Mutation {
    FlipBit(Index, u8),
    Truncate(Index),
    Insert(Index, Vec<u8>),
    Remove(Index, usize),
    /// A number of the text, the nth, becomes another value.
    Number(Index, &'static [u8]),
    /// A part of the file once more.
    Double(Index, usize),
}

const VALUES: [&[u8]; 17] = [
    b"NaN",
    b"-NaN",
    b"Infinity",
    b"-Infinity",
    b"1e999",
    b"-1e999",
    b"-0",
    b"-0.0",
    b"-1",
    b"0.5",
    b"null",
    b"[]",
    b"{}",
    b"\"x\"",
    b"18446744073709551615",
    b"18446744073709551616",
    b"340282366920938463463374607431768211456",
];

fn mutation() -> impl Strategy<Value = Mutation> {
    let index = any::<Index>;
    let insertion = prop_oneof![
        vec(any::<u8>(), 1..20),
        (1_usize..3000).prop_map(|depth| b"[".repeat(depth)),
        (1_usize..3000).prop_map(|depth| b"{\"a\":".repeat(depth)),
        select(&VALUES[..]).prop_map(<[u8]>::to_vec),
        Just(vec![0xff, 0xfe, 0xc0, 0x80]),
    ];
    prop_oneof![
        3 => (index(), 0_u8..8).prop_map(|(place, bit)| Mutation::FlipBit(place, bit)),
        1 => index().prop_map(Mutation::Truncate),
        2 => (index(), insertion).prop_map(|(place, bytes)| Mutation::Insert(place, bytes)),
        1 => (index(), 1_usize..30).prop_map(|(place, count)| Mutation::Remove(place, count)),
        4 => (index(), select(&VALUES[..])).prop_map(|(number, value)| Mutation::Number(number, value)),
        1 => (index(), 1_usize..200).prop_map(|(place, count)| Mutation::Double(place, count)),
    ]
}

impl Mutation {
    fn apply(&self, bytes: &mut Vec<u8>) {
        if bytes.is_empty() {
            return;
        }
        match self {
            Self::FlipBit(place, bit) => *place.get_mut(bytes) ^= 1 << bit,
            Self::Truncate(place) => bytes.truncate(place.index(bytes.len())),
            Self::Insert(place, inserted) => {
                let place = place.index(bytes.len());
                bytes.splice(place..place, inserted.iter().copied());
            }
            Self::Remove(place, count) => {
                let place = place.index(bytes.len());
                bytes.drain(place..bytes.len().min(place + count));
            }
            Self::Number(number, value) => {
                let is_number = |byte: &u8| byte.is_ascii_digit() || b".-+e".contains(byte);
                let starts: Vec<usize> = (1..bytes.len())
                    .filter(|&i| bytes[i].is_ascii_digit() && b":,[ ".contains(&bytes[i - 1]))
                    .collect();
                if !starts.is_empty() {
                    let start = *number.get(&starts);
                    let length = bytes[start..].iter().take_while(|byte| is_number(byte)).count();
                    bytes.splice(start..start + length, value.iter().copied());
                }
            }
            Self::Double(place, count) => {
                let place = place.index(bytes.len());
                let part = bytes[place..bytes.len().min(place + count)].to_vec();
                bytes.splice(place..place, part);
            }
        }
    }
}

fn mutated(valid: &[u8], mutations: &[Mutation]) -> Vec<u8> {
    let mut bytes = valid.to_vec();
    mutations.iter().for_each(|mutation| mutation.apply(&mut bytes));
    bytes
}

/// A file of safetensors whose JSON header has been mutated: its length is put right again, and its SHA-256.
fn with_mutated_header(valid: &[u8], mutations: &[Mutation]) -> Vec<u8> {
    let end = 8 + usize::try_from(u64::from_le_bytes(valid[..8].try_into().unwrap())).unwrap();
    let header = mutated(&valid[8..end], mutations);
    let mut bytes = [&(header.len() as u64).to_le_bytes()[..], &header, &valid[end..]].concat();
    seal(&mut bytes);
    bytes
}

/// Does with a checkpoint what the program does.
fn load(bytes: &[u8]) {
    let Ok(checkpoint) = Checkpoint::from_bytes(bytes) else { return };
    let _ = checkpoint.tensors.network(4, 2);
    let Ok(Header { mut config, progress: Some(progress), .. }) = checkpoint.header() else { return };
    let takes_long =
        config.evaluation.episodes > 100 || config.agent.as_dqn().is_some_and(|dqn| dqn.learn.updates > 100);
    if takes_long || config.check_memory(1).is_err() {
        return;
    }
    config.budget = Budget::Steps(progress.env_steps.saturating_add(10));
    let Ok(mut trainer) = config.make_trainer().unwrap().resume(progress, &checkpoint.tensors) else {
        return;
    };
    for _ in 0..10 {
        if trainer.step(&mut Vec::<Event>::new()).is_err() {
            return;
        }
    }
}

fn data(directory: &str) -> Vec<PathBuf> {
    let directory = Path::new(env!("CARGO_MANIFEST_DIR")).join(directory);
    let mut files: Vec<PathBuf> =
        fs::read_dir(directory).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    assert!(!files.is_empty());
    files
}

/// `CARTPOLE_DQN_MUTATIONS` times the usual number of files.
fn cases(usual: u32) -> ProptestConfig {
    let factor = std::env::var("CARTPOLE_DQN_MUTATIONS").map_or(1, |factor| factor.parse().unwrap());
    ProptestConfig { cases: usual * factor, failure_persistence: None, ..ProptestConfig::default() }
}

#[test]
fn a_mutated_config_is_a_config_or_refused() {
    let files: Vec<Vec<u8>> =
        data("tests/data/corpus/config").iter().map(|path| fs::read(path).unwrap()).collect();
    proptest!(cases(3000), |(file in select(files), mutations in vec(mutation(), 0..4), set in ".{0,30}")| {
        let text = String::from_utf8_lossy(&mutated(&file, &mutations)).into_owned();
        if let Ok(config) = Config::from_layers(Some(("file", &text)), &[]) {
            let written = serde_json::to_string(&config).unwrap();
            assert_eq!(Config::from_layers(Some(("written", &written)), &[]).unwrap(), config);
        }
        let _ = Config::from_layers(None, &[set]);
    });
}

#[test]
fn a_mutated_checkpoint_is_a_run_or_refused() {
    let files: Vec<Vec<u8>> =
        data("tests/data/checkpoints").iter().map(|path| fs::read(path).unwrap()).collect();
    proptest!(cases(1500), |(file in select(files), mutations in vec(mutation(), 1..4))| {
        load(&mutated(&file, &mutations));
        load(&with_mutated_header(&file, &mutations));
    });
}

#[test]
fn a_mutated_update_is_judged_or_refused() {
    let set: Vec<String> = TINY.iter().map(ToString::to_string).collect();
    let update = explain(&super::plain(&set), 60).unwrap();
    let valid = update.tensors().to_safetensors(Some(update.settings().metadata())).unwrap();
    assert!(check(&Update::from_bytes(&valid).unwrap()).equal);
    proptest!(cases(300), |(mutations in vec(mutation(), 1..4))| {
        for bytes in [mutated(&valid, &mutations), with_mutated_header(&valid, &mutations)] {
            if let Ok(update) = Update::from_bytes(&bytes) {
                let verdict = check(&update);
                serde_json::to_string(&verdict).unwrap();
            }
        }
    });
}

#[test]
fn what_fuzzing_has_kept_is_read_or_refused() {
    for path in data("tests/data/corpus/update") {
        let _ = Update::from_bytes(&fs::read(path).unwrap()).map(|update| check(&update));
    }
    for path in data("tests/data/corpus/checkpoint") {
        let mut bytes = fs::read(path).unwrap();
        load(&bytes);
        seal(&mut bytes);
        load(&bytes);
    }
    for path in data("tests/data/corpus/config") {
        let text = String::from_utf8_lossy(&fs::read(path).unwrap()).into_owned();
        let _ = Config::from_layers(Some(("file", &text)), &[]);
    }
}

#[test]
fn a_header_that_promises_more_than_there_is_is_refused_before_it_is_read() {
    for promised in [1 << 60, u64::MAX, 1 << 32, 100_000_001, 3] {
        let mut bytes = u64::to_le_bytes(promised).to_vec();
        bytes.extend(b"{}");
        assert!(Checkpoint::from_bytes(&bytes).is_err());
    }
    let tensor = br#"{"0.weight":{"dtype":"F32","shape":[1152921504606846976,4],"data_offsets":[0,16]}}"#;
    let bytes = [&(tensor.len() as u64).to_le_bytes()[..], tensor, &[0; 16]].concat();
    assert!(Checkpoint::from_bytes(&bytes).is_err());
}

/// The files of a run and of a study, each mutated on its own.
#[test]
fn a_mutated_directory_is_reported_or_refused() {
    let sandbox = Sandbox::with_run();
    let study = [&["study", "--quiet", "--seeds", "0..2", "--out", "study"], &sets(TINY)[..]].concat();
    sandbox.run(&study).success();
    let trials = trial_file(&sandbox, "study");
    let files = ["run/config.json", "run/metrics.jsonl", "study/study.json", &trials];
    let valid = files.map(|file| fs::read(sandbox.path(file)).unwrap());
    proptest!(cases(300), |(i in 0..files.len(), mutations in vec(mutation(), 1..4))| {
        sandbox.write(files[i], mutated(&valid[i], &mutations));
        let _ = Report::of(&sandbox.path("run"));
        let _ = Report::of(&sandbox.path("study"));
        sandbox.write(files[i], &valid[i]);
    });
}

/// Runs a command that may do its work or refuse it.
#[track_caller]
fn decides(assert: &Assert) {
    let output = assert.get_output();
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(matches!(output.status.code(), Some(0..=2)), "{:?} {message}", output.status);
    assert!(!message.contains("panicked"), "{message}");
}

/// The program itself, on mutated runs and studies.
#[test]
fn commands_on_mutated_directories_work_or_refuse() {
    let sandbox = Sandbox::with_run();
    let study = [&["study", "--quiet", "--seeds", "0..2", "--out", "study"], &sets(TINY)[..]].concat();
    sandbox.run(&study).success();
    let trials = trial_file(&sandbox, "study");
    let files = [
        "run/config.json",
        "run/metrics.jsonl",
        "run/summary.json",
        "run/checkpoints/last.safetensors",
        "run/checkpoints/best.safetensors",
        "study/study.json",
        &trials,
    ];
    let valid = files.map(|file| fs::read(sandbox.path(file)).unwrap());
    proptest!(cases(30), |(i in 0..files.len(), mutations in vec(mutation(), 1..4))| {
        sandbox.write(files[i], mutated(&valid[i], &mutations));
        decides(&sandbox.run(&["verify", "run", "--quiet"]));
        decides(&sandbox.run(&["eval", "--checkpoint", "run", "--episodes", "1"]));
        decides(&sandbox.run(&["report", "run", "--json"]));
        decides(&sandbox.run(&["report", "study", "--json"]));
        decides(&sandbox.run(&["study", "study", "--status"]));
        decides(&sandbox.run(&["train", "--quiet", "--resume", "run", "--set", "budget.steps=201"]));
        decides(&sandbox.run(&study));
        for (file, valid) in files.iter().zip(&valid) {
            sandbox.write(file, valid);
        }
    });
}

#[test]
fn directories_links_and_devices_in_place_of_files_are_refused() {
    for file in ["config.json", "metrics.jsonl", "summary.json", "checkpoints/last.safetensors"] {
        for kind in ["directory", "loop", "device"] {
            let sandbox = Sandbox::with_run();
            let path = sandbox.path("run").join(file);
            fs::remove_file(&path).unwrap();
            match kind {
                "directory" => fs::create_dir(&path).unwrap(),
                "loop" => std::os::unix::fs::symlink(&path, &path).unwrap(),
                _ => std::os::unix::fs::symlink("/dev/zero", &path).unwrap(),
            }
            for arguments in [&["train", "--resume", "run"][..], &["verify", "run"]] {
                sandbox
                    .run(arguments)
                    .code(2)
                    .stdout("")
                    .stderr(predicates::prelude::predicate::str::contains("panicked").not());
            }
            decides(&sandbox.run(&["report", "run", "--json"]));
        }
    }
}

#[test]
fn a_config_that_asks_for_too_much_memory_is_refused() {
    Sandbox::new().refuses(
        &[
            "train",
            "--set",
            "network.hidden=[4096,4096]",
            "--set",
            "replay.batch_size=65536",
            "--set",
            "budget.steps=100000",
            "--set",
            "replay.capacity=100000000",
        ],
        &["`network.hidden`", "`replay.batch_size` 65536", "GiB of memory; at most 8"],
    );
}
