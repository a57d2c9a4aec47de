//! `cartpole-dqn verify`

use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

use clap::Args;
use serde_json::{Value, json};

use super::init::first_step;
use super::resume::{Run, load};
use super::run_dir::{RunDir, bad};
use super::signals::Signals;
use super::train::Record;
use super::{Failure, print};
use crate::checkpoint::{Checkpoint, sha256};
use crate::config::{MAX_BYTES, difference};
use crate::files::{open_ordinary, read_limited, read_text_limited};
use crate::sink::{Console, ProgressCsv};
use crate::text::shown as shown_path;
use crate::trainer::{BEST, EndReason, EventSink, Header, LAST, PREVIOUS};

/// Largest checkpoint and summary that are read, in bytes.
const MAX_CHECKPOINT: u64 = 1 << 32;
const MAX_SUMMARY: u64 = 1 << 20;
/// Bytes of a line that are compared at a time, and characters that are shown.
const MAX_LINE: u64 = 1 << 20;
const SHOWN: usize = 300;

/// Train a run again and compare every byte.
///
/// Trains again with the config that is recorded in the run directory, and compares metrics, checkpoints and summary. Only
/// the training time and the machine may differ. A run that has not ended is compared up to its last checkpoint. The exit
/// code is 0 if every byte agrees, and 1 if not.
#[derive(Debug, Args)]
#[command(after_help = "Example: cartpole-dqn verify runs/my-run")]
pub(super) struct Arguments {
    /// The run directory; nothing in it is changed
    #[arg(value_name = "RUN_DIR")]
    run: PathBuf,
    /// Show no progress, and print nothing if every byte agrees
    #[arg(long)]
    quiet: bool,
}

/// How far a run is compared.
struct Extent {
    /// None: to its end.
    env_steps: Option<u64>,
    /// Lines of the metrics.
    lines: u64,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let signals = Signals::listen();
    let (run, mut config) = RunDir::open(&arguments.run)?;
    let _shared = run.share()?;
    let summary = if run.summary().exists() { Some(read_summary(&run)?) } else { None };
    let mut branched_at_step = summary.as_ref().and_then(|summary| summary["branched_at_step"].as_u64());
    let mut extent = Extent { env_steps: None, lines: u64::MAX };
    if summary.is_none() {
        let last = load(&run.last(), &config)?;
        extent = Extent { env_steps: Some(last.progress().env_steps), lines: last.progress().events };
        branched_at_step = last.progress().branched_at_step;
        config = last.config().clone();
    }
    if let Some(step) = branched_at_step {
        return Err(bad(
            run.path(),
            &format!(
                "cannot be verified: from step {step} on it follows another schedule (train --resume --set), so that no \
                 single config repeats it"
            ),
        ));
    }
    config.check_memory(1).map_err(Failure::BadInput)?;
    let folder = tempfile::tempdir().map_err(|error| {
        let place = shown_path(&std::env::temp_dir());
        let message = format!(
            "cannot verify: the run is trained again in the temporary directory {place}, which cannot be written: {error}; \
             name another one in the environment variable TMPDIR"
        );
        Failure::unwritten(message, &error)
    })?;
    let (mut trainer, init) = first_step(&run, config.clone())?;
    let (again, metrics) = RunDir::create(&folder.path().join("run"), false, &config, init.as_ref())?;
    let progress = ProgressCsv::create(&again.progress()).map_err(failed)?;
    let mut sinks: Vec<Box<dyn EventSink>> = vec![Box::new(metrics), Box::new(progress)];
    if !arguments.quiet {
        sinks.push(Box::new(Console::new(config.budget, 0)));
    }
    let reason = train(&mut trainer, &mut sinks, &again, &extent, &signals)?;
    drop(sinks);
    let mut differences = compare_files(&run, &again, &extent)?;
    if let Some(recorded) = summary {
        differences.extend(compare_summaries(recorded, &Record::new(&again, &trainer, reason, 0.0)));
    }
    report(&differences, &extent, arguments)
}

/// Trains the run again, as far as it is to be compared.
fn train(
    trainer: &mut Run,
    sink: &mut dyn EventSink,
    again: &RunDir,
    extent: &Extent,
    signals: &Signals,
) -> Result<EndReason, Failure> {
    let folder = again.checkpoints();
    let mut reason = EndReason::Interrupted;
    match extent.env_steps {
        None => reason = trainer.run(sink, Some(&folder), &signals.stop)?,
        Some(last) => {
            while trainer.progress().env_steps < last && !signals.stop.load(Ordering::Relaxed) {
                trainer.step(sink, Some(&folder))?;
            }
            trainer.save_last(sink, Some(&folder))?;
        }
    }
    if signals.stop.load(Ordering::Relaxed) {
        let message = format!("stopped after step {}, so nothing was verified", trainer.progress().env_steps);
        return Err(Failure::Interrupted(message, signals.exit_code()));
    }
    Ok(reason)
}

/// What the metrics and the checkpoints of a run and its repetition differ in.
fn compare_files(run: &RunDir, again: &RunDir, extent: &Extent) -> Result<Vec<String>, Failure> {
    let mut differences = Vec::new();
    differences.extend(compare_lines("metrics.jsonl", &run.metrics(), &again.metrics(), extent.lines)?);
    // Runs of earlier versions have none.
    if run.progress().exists() {
        let rows =
            read_text_limited(&again.progress(), MAX_CHECKPOINT).map_err(failed)?.lines().count() as u64;
        let count = if extent.env_steps.is_some() { rows } else { u64::MAX };
        differences.extend(compare_lines("progress.csv", &run.progress(), &again.progress(), count)?);
    }
    for name in [BEST, LAST, PREVIOUS] {
        let (path, repeated) = (run.checkpoints().join(name), again.checkpoints().join(name));
        if name == BEST && extent.env_steps.is_some_and(|last| step_of(&path).is_some_and(|step| step > last))
        {
            continue;
        }
        // A process that was killed as it wrote the next one leaves the last one under both names.
        let is_last =
            || read_limited(&path, MAX_CHECKPOINT).ok() == read_limited(&run.last(), MAX_CHECKPOINT).ok();
        if name == PREVIOUS && extent.env_steps.is_some() && is_last() {
            continue;
        }
        let problem = match (read_limited(&path, MAX_CHECKPOINT), repeated.exists()) {
            (Err(error), false) if error.kind() == io::ErrorKind::NotFound => continue,
            (Err(error), _) => error.to_string(),
            (Ok(_), false) => "there should be none".into(),
            (Ok(bytes), true) => match read_limited(&repeated, MAX_CHECKPOINT).map_err(failed)? {
                expected if expected == bytes => continue,
                _ => Checkpoint::from_bytes(&bytes).err().map_or("other content".into(), |e| e.to_string()),
            },
        };
        differences.push(format!("checkpoints/{name}: {problem}"));
    }
    Ok(differences)
}

/// The first of so many lines that differs.
fn compare_lines(
    name: &str,
    recorded: &Path,
    repeated: &Path,
    count: u64,
) -> Result<Option<String>, Failure> {
    let open = |path| open_ordinary(File::options().read(true), path).map(BufReader::new).map_err(failed);
    let line = |file: &mut BufReader<File>| {
        let mut line = Vec::new();
        file.take(MAX_LINE).read_until(b'\n', &mut line).map(|_| line).map_err(failed)
    };
    let (mut recorded, mut repeated) = (open(recorded)?, open(repeated)?);
    for number in 1..=count {
        match (line(&mut recorded)?, line(&mut repeated)?) {
            (a, b) if a != b => {
                let (a, b) = (shown(&a), shown(&b));
                let text = format!("{name}, first at line {number}:\n  recorded {a}\n  repeated {b}");
                return Ok(Some(text));
            }
            (a, _) if a.is_empty() => break,
            _ => {}
        }
    }
    Ok(None)
}

fn shown(line: &[u8]) -> String {
    match String::from_utf8_lossy(line).trim_end() {
        "" => "nothing".into(),
        line => line.chars().filter(|c| !c.is_control()).take(SHOWN).collect(),
    }
}

fn step_of(best: &Path) -> Option<u64> {
    Some(Checkpoint::read(best).ok()?.header::<Header>().ok()?.env_steps)
}

/// The recorded summary, if it is of the config beside it: another config may train for ever.
fn read_summary(run: &RunDir) -> Result<Value, Failure> {
    let unreadable =
        |error: io::Error| bad(run.path(), &format!("has a summary.json that cannot be read: {error}"));
    let text = read_text_limited(&run.summary(), MAX_SUMMARY).map_err(unreadable)?;
    let summary: Value = serde_json::from_str(&text).map_err(|error| unreadable(error.into()))?;
    let files = [
        ("config_sha256", run.config(), MAX_BYTES),
        // None in the summary and no file where the first weights were drawn.
        ("init_sha256", run.init(), MAX_CHECKPOINT),
    ];
    for (field, path, max_bytes) in files {
        let found = match read_limited(&path, max_bytes) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Value::Null,
            read => json!(sha256([read.map_err(failed)?])),
        };
        if summary[field] != found {
            return Err(Failure::Failed(format!(
                "{} does not agree: the SHA-256 of its {} is {found}, and summary.json says {}",
                run.path().display(),
                path.strip_prefix(run.path()).unwrap_or(&path).display(),
                summary[field]
            )));
        }
    }
    Ok(summary)
}

/// What the summaries differ in, but for the circumstances of the training.
fn compare_summaries(recorded: Value, repeated: &Record) -> Option<String> {
    let outcome = |mut summary: Value| {
        if let Some(fields) = summary.as_object_mut() {
            Record::CIRCUMSTANCES.iter().for_each(|field| drop(fields.remove(*field)));
        }
        summary
    };
    let mut repeated = json!(repeated);
    // Earlier versions did not write it.
    if let (None, Some(fields)) = (recorded.get("mean_return_100"), repeated.as_object_mut()) {
        fields.remove("mean_return_100");
    }
    let difference = difference("", &outcome(recorded), &outcome(repeated));
    difference.map(|difference| format!("summary.json: {difference}"))
}

fn report(differences: &[String], extent: &Extent, arguments: &Arguments) -> Result<(), Failure> {
    let extent = extent.env_steps.map_or_else(
        || "to its end".into(),
        |last| format!("up to its last checkpoint, at step {last}; it has not ended"),
    );
    match differences {
        [] if arguments.quiet => Ok(()),
        [] => print(&format!("every byte agrees: {} was trained again {extent}\n", arguments.run.display())),
        _ => Err(Failure::Failed(format!(
            "{} was trained again {extent}, and differs in\n{}",
            arguments.run.display(),
            differences.join("\n")
        ))),
    }
}

fn failed(error: io::Error) -> Failure {
    Failure::Failed(format!("cannot verify: {error}"))
}
