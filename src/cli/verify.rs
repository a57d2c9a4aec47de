//! `cartpole-dqn verify`

use std::sync::atomic::Ordering;

use super::signals::Signals;
use super::ui::{Failure, print};
use crate::run::{
    Extent, RunDir, RunRecord, compare_files, compare_summaries, first_step, load, read_summary, start_again,
};
use crate::text::shown;
use crate::trainer::{EndReason, Fanout, Observer, Trainer};

/// Train a run again and compare every byte.
///
/// Trains again with the config that is recorded in the run directory, and compares metrics, checkpoints and summary. Only
/// the training time and the machine may differ. A run that has not ended is compared up to its last checkpoint. The exit
/// code is 0 if every byte agrees, and 1 if not.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: cartpole-dqn verify runs/my-run")]
pub(super) struct VerifyArguments {
    /// The run directory; nothing in it is changed
    #[arg(value_name = "RUN_DIR")]
    run: std::path::PathBuf,
    #[command(flatten)]
    allow: super::permission::AllowCommand,
    /// Show no progress, and print nothing if every byte agrees
    #[arg(long)]
    quiet: bool,
}

pub(super) fn run(arguments: &VerifyArguments) -> Result<(), Failure> {
    let (run, mut config) = RunDir::open(&arguments.run)?;
    let place = format!("run {}", shown(run.path()));
    arguments.allow.permit(&mut config.environment, &place, false).map_err(Failure::BadInput)?;
    let _shared = run.share()?;
    let summary = if run.summary().exists() { Some(read_summary(&run)?) } else { None };
    let mut branched_at_step = summary.as_ref().and_then(|summary| summary["branched_at_step"].as_u64());
    let mut extent = Extent { env_steps: None, lines: u64::MAX };
    if summary.is_none() {
        let last = load(&run.last(), &config)?;
        extent = Extent { env_steps: Some(last.progress().env_steps), lines: last.progress().events };
        branched_at_step = last.progress().branched_at_step;
    }
    if let Some(step) = branched_at_step {
        return Err(Failure::BadInput(format!(
            "directory {} cannot be verified: from step {step} on it follows another schedule (train --resume --set), so \
             that no single config repeats it",
            shown(run.path())
        )));
    }
    config.check_memory(1).map_err(Failure::BadInput)?;
    let directory = crate::files::temporary_directory().map_err(|error| {
        let place = shown(&std::env::temp_dir());
        let message = format!(
            "cannot verify: the run is trained again in the temporary directory {place}, which cannot be written: {error}; \
             name another one in the environment variable TMPDIR"
        );
        Failure::unwritten(message, &error)
    })?;
    let (mut trainer, init) = first_step(&run, &config)?;
    let signals = Signals::listen(false);
    let (again, recorder) = start_again(&directory.path().join("run"), &config, init.as_ref())?;
    let mut observers = Fanout::default();
    observers.0.push(Box::new(recorder));
    if !arguments.quiet {
        observers.0.push(Box::new(crate::sink::Console::new(config.budget, 0)));
    }
    let reason = train(&mut trainer, &mut observers, &extent, &signals)?;
    drop(observers);
    let mut differences = compare_files(&run, &again, &extent)?;
    if let Some(recorded) = summary {
        differences.extend(compare_summaries(recorded, &RunRecord::new(&again, &trainer, reason, 0.0, None)));
    }
    report(&differences, &extent, arguments)
}

fn train(
    trainer: &mut Trainer, observer: &mut dyn Observer, extent: &Extent, signals: &Signals,
) -> Result<EndReason, Failure> {
    let mut reason = EndReason::Interrupted;
    match extent.env_steps {
        None => reason = trainer.run(observer, &signals.stop)?,
        Some(last) => {
            while trainer.progress().env_steps < last && !signals.stop.load(Ordering::Relaxed) {
                trainer.step(observer)?;
            }
            trainer.save_last(observer)?;
        }
    }
    if signals.stop.load(Ordering::Relaxed) {
        let message = format!("stopped after step {}, so nothing was verified", trainer.progress().env_steps);
        return Err(Failure::Interrupted(message, signals.exit_code()));
    }
    Ok(reason)
}

fn report(differences: &[String], extent: &Extent, arguments: &VerifyArguments) -> Result<(), Failure> {
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
