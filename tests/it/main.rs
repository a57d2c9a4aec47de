//! Integration tests: one binary.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod arrows;
mod check;
mod check_cases;
mod cli;
mod cli_config;
mod cli_eval;
mod cli_runs;
mod cli_show;
#[cfg(unix)]
mod cli_tasks;
mod cli_tensorboard;
mod cli_train;
mod config;
#[cfg(target_os = "linux")]
mod disturbed;
mod documents;
#[cfg(unix)]
mod foreign;
mod golden_physics;
mod golden_tasks;
mod golden_update;
#[cfg(unix)]
mod hostile;
#[cfg(unix)]
mod hostile_programs;
mod kernels;
#[cfg(unix)]
mod links;
mod mirror;
#[cfg(unix)]
mod program;
#[cfg(unix)]
mod q_table;
mod replay;
mod report;
mod report_html;
#[cfg(unix)]
mod resume;
#[cfg(unix)]
mod run_dir;
#[cfg(unix)]
mod shards;
mod shipped_configs;
#[cfg(unix)]
mod signals;
mod simd;
mod study;
mod tasks;
mod trace;
mod training;

use std::io::Write;
use std::path::{Path, PathBuf};

/// Plain DQN with changes: one step, a hard target, none of the default's additions.
fn plain(sets: &[String]) -> cartpole_dqn::config::Config {
    let file = ("plain_dqn.json", include_str!("../data/plain_dqn.json"));
    cartpole_dqn::config::Config::from_layers(Some(file), sets).unwrap()
}

/// A recording: from `CARTPOLE_DQN_GOLDEN` where it is set, else from tests/data.
fn golden(name: &str) -> serde_json::Value {
    recording(&std::env::var_os("CARTPOLE_DQN_GOLDEN").map_or_else(own_recordings, PathBuf::from), name)
}

fn own_recordings() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/data")
}

/// Says that a test, or a part of one, was left out. The test harness hides what `eprintln` prints.
fn skipped(what: &str) {
    let _ = writeln!(std::io::stderr(), "SKIPPED: {what}");
}

fn recording(directory: &Path, name: &str) -> serde_json::Value {
    let path = directory.join(name);
    let text = std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    serde_json::from_str(&text).unwrap()
}

/// The members of an array of a recording, which has some: nothing is compared with an empty one.
fn members(value: &serde_json::Value) -> &[serde_json::Value] {
    let members = value.as_array().unwrap();
    assert!(!members.is_empty(), "the recording has an empty list");
    members
}

/// The numbers of an array of any depth, in order.
fn numbers(value: &serde_json::Value) -> Vec<f64> {
    match value {
        serde_json::Value::Array(values) => values.iter().flat_map(numbers).collect(),
        value => vec![value.as_f64().unwrap()],
    }
}
