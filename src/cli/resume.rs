//! `cartpole-dqn train --resume`

use std::fs;
use std::io;
use std::path::Path;

use serde_json::{Value, json};

use super::init::first_step;
use super::run_dir::{RunDir, bad, cannot_write};
use super::{Failure, note};
use crate::agent::Exploration;
use crate::checkpoint::{Checkpoint, CheckpointError, Problem};
use crate::config::{Config, difference};
use crate::env::{CartPole, TimeLimit};
use crate::files::remove_unfinished;
use crate::sink::JsonLines;
use crate::trainer::{Budget, EndReason, LAST, PREVIOUS, TrainError, Trainer};

pub(super) type Run = Trainer<TimeLimit<CartPole>>;

/// A run that can go on, and the folder and file that it goes on in.
pub(super) type Resumed = (RunDir, JsonLines, Run);

/// What there is to do for a run that is to be resumed.
pub(super) enum Start {
    /// To train.
    Run(Box<Resumed>),
    /// Nothing: it has ended.
    Ended(RunDir),
}

/// Takes the run in a folder back to its latest good checkpoint, with everything that it has written since then cut
/// off. Nothing is changed on bad input.
pub(super) fn resume(path: &Path, sets: &[String]) -> Result<Start, Failure> {
    let (run, recorded) = RunDir::open(path)?;
    let mut metrics = run.take()?;
    let config = with_other_budget(&recorded, sets, path)?;
    config.check_memory(1).map_err(Failure::BadInput)?;
    let (mut trainer, falls_back) = latest(&run, &recorded)?;
    let (steps, episodes) = (trainer.progress().env_steps, trainer.progress().episodes);
    if !trainer.set_budget(config.budget) {
        let budget = json!(config.budget);
        return Err(bad(
            path,
            &format!(
                "holds a run that is already past the budget {budget}: it is at step {steps} and in episode {episodes}; give \
             it a larger budget"
            ),
        ));
    }
    let branches = trainer.set_schedules(&config);
    if let (Some(reason), true) = (trainer.end_reason(), run.summary().is_file()) {
        if branches {
            let larger = format!("--set budget.steps={}", steps.saturating_mul(2));
            return Err(bad(
                path,
                &format!(
                    "holds a run that has ended; give it a larger budget with the schedule, such as {larger}"
                ),
            ));
        }
        note(&match reason {
            EndReason::Solved => format!(
                "the run solved its task after {steps} steps and ended there; there is nothing to resume"
            ),
            _ => format!(
                "the run has ended after {steps} steps and {episodes} episodes; to extend it, give it a larger budget, \
                 for example --set budget.steps={}",
                steps.saturating_mul(2)
            ),
        });
        return Ok(Start::Ended(run));
    }
    let events = trainer.progress().events;
    let unwritable = |error: io::Error| cannot_write(path, &error, "");
    if !metrics.cut(events).map_err(unwritable)? {
        return Err(bad(
            path,
            &format!(
                "has a metrics.jsonl with fewer lines than the {events} that the run had written before its checkpoint; \
             restore the file, or train again"
            ),
        ));
    }
    take_back(&run, &trainer, falls_back).map_err(unwritable)?;
    if config != recorded {
        crate::files::write_json(&run.config(), &config).map_err(unwritable)?;
    }
    rewrite(&run, &trainer).map_err(unwritable)?;
    trainer.save_best(&run.checkpoints()).map_err(|error: TrainError| Failure::Failed(error.to_string()))?;
    if branches {
        note(&format!(
            "from step {steps} on the run follows another schedule. It is now a branch of its own: no single config \
             repeats it, so `verify` refuses it"
        ));
    }
    let is_extended = config.budget != recorded.budget;
    schedules_that_have_ended(&config, steps, is_extended).iter().for_each(|text| note(text));
    Ok(Start::Run(Box::new((run, metrics, trainer))))
}

/// What the user should know of schedules that end, or have ended, before the run does. That ε stays at its last value is
/// worth a word only where the run becomes longer than it was planned.
fn schedules_that_have_ended(config: &Config, env_steps: u64, is_extended: bool) -> Vec<String> {
    let end = if let Budget::Steps(steps) = config.budget { steps } else { env_steps };
    let mut notes = Vec::new();
    if let Some(schedule) = config.optimizer.schedule
        && (schedule.steps <= env_steps || schedule.steps < end)
    {
        let rate = schedule.final_learning_rate;
        let effect = if rate > 0.0 { "" } else { ", with which the network learns nothing" };
        notes.push(format!(
            "the schedule of the learning rate ends at step {}: from there on the rate is {rate}{effect}. To stretch it, \
             add --set optimizer.schedule.steps={end}; --set optimizer.schedule=null keeps the rate at {}",
            schedule.steps,
            config.optimizer.learning_rate
        ));
    }
    if let Exploration::Linear { final_, steps, .. } = config.exploration
        && is_extended
        && steps <= env_steps
    {
        notes.push(format!(
            "the schedule of epsilon ended at step {steps}: from there on epsilon is {final_}. To stretch it, add \
             --set exploration.steps={end}"
        ));
    }
    notes
}

/// The run's config with what `--set` changes, which may be the budget and the schedules alone.
fn with_other_budget(recorded: &Config, sets: &[String], path: &Path) -> Result<Config, Failure> {
    let config = Config::from_layers(Some(("the run's config", &json!(recorded).to_string())), sets)?;
    match other_run(recorded, &config) {
        None => Ok(config),
        Some(difference) => Err(bad(
            path,
            &format!(
                "holds a run with other settings: {difference}. A resumed run can change only its budget and its schedules \
                 (optimizer.schedule, optimizer.learning_rate, a linear exploration); to train with other settings, \
                 start a new run without --resume"
            ),
        )),
    }
}

/// What makes two configs different runs: not the budget, and not the schedules, which a resumed run may change.
fn other_run(recorded: &Config, given: &Config) -> Option<String> {
    let are_linear = [recorded, given].map(|config| matches!(config.exploration, Exploration::Linear { .. }));
    let comparable = |config: &Config| {
        let mut value = json!(config);
        value["budget"] = Value::Null;
        value["optimizer"]["schedule"] = Value::Null;
        value["optimizer"]["learning_rate"] = Value::Null;
        if are_linear == [true; 2] {
            value["exploration"] = Value::Null;
        }
        value
    };
    difference("", &comparable(recorded), &comparable(given))
}

/// The run at its latest good checkpoint, and whether that is the previous one; at its start if it was killed before
/// there was one.
fn latest(run: &RunDir, config: &Config) -> Result<(Run, bool), Failure> {
    let last = match load(&run.last(), config) {
        Ok(trainer) => return Ok((trainer, false)),
        Err(error) => error,
    };
    match load(&run.previous(), config) {
        _ if !can_be_replaced(&last.problem) => Err(last.into()),
        Ok(trainer) => {
            let steps = trainer.progress().env_steps;
            note(&format!("{last}; resuming from {} at step {steps} instead", run.previous().display()));
            Ok((trainer, true))
        }
        Err(previous) if is_missing(&last.problem) && is_missing(&previous.problem) => {
            let has_metrics = run.metrics().metadata().is_ok_and(|file| file.len() > 0);
            let found = [
                ("metrics", has_metrics),
                ("best", run.best().exists()),
                ("summary", run.summary().exists()),
            ];
            if let Some((found, _)) = found.iter().find(|(_, is_there)| *is_there) {
                return Err(bad(
                    run.path(),
                    &format!(
                        "cannot be resumed: its checkpoints {LAST} and {PREVIOUS} are missing, though the run has begun \
                         ({found} found). Put one of them back into {}, or train again: --config {} --out another \
                         directory",
                        run.checkpoints().display(),
                        run.config().display()
                    ),
                ));
            }
            note("the run has no checkpoint yet, so it starts again at step 0");
            Ok((first_step(run, config.clone())?.0, false))
        }
        Err(previous) => Err(Failure::BadInput(format!(
            "{last}; {previous}; train again with --config {} and another --out",
            run.config().display()
        ))),
    }
}

pub(super) fn load(path: &Path, config: &Config) -> Result<Run, CheckpointError> {
    let checkpoint = Checkpoint::read(path)?;
    let trainer = match checkpoint.version() {
        _ => Trainer::resume(&checkpoint, config.make_environment()),
    };
    let same = trainer.and_then(|trainer| match other_run(config, trainer.config()) {
        None => Ok(trainer),
        Some(difference) => Err(Problem::OtherRun(difference)),
    });
    same.map_err(|problem| CheckpointError { path: path.to_owned(), problem })
}

fn is_missing(problem: &Problem) -> bool {
    matches!(problem, Problem::Unreadable(error) if error.kind() == io::ErrorKind::NotFound)
}

/// Whether the previous checkpoint may be used instead. Not if the last one is intact and only cannot be read by this
/// program now: the user can fix that.
fn can_be_replaced(problem: &Problem) -> bool {
    let readable = matches!(
        problem,
        Problem::Unreadable(_) | Problem::Memory(_) | Problem::WrongVersion(_) | Problem::OtherRun(_)
    );
    !readable || is_missing(problem)
}

/// Removes what the run has written after its checkpoint, the metrics apart.
fn take_back(run: &RunDir, trainer: &Run, falls_back: bool) -> io::Result<()> {
    fs::create_dir_all(run.checkpoints())?;
    remove_unfinished(run.path())?;
    remove_unfinished(&run.checkpoints())?;
    if falls_back {
        fs::rename(run.previous(), run.last())?;
    }
    let no_best = trainer.best_policy().is_none().then(|| run.best());
    for path in [run.summary()].into_iter().chain(no_best) {
        match fs::remove_file(path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
    }
    Ok(())
}

/// Gives the checkpoints the run's budget, as if it had always been that.
fn rewrite(run: &RunDir, trainer: &Run) -> io::Result<()> {
    for path in [run.last(), run.previous()] {
        if let Ok(mut checkpoint) = load(&path, trainer.config())
            && checkpoint.config() != trainer.config()
            && checkpoint.set_budget(trainer.config().budget)
        {
            checkpoint.set_schedules(trainer.config());
            checkpoint.checkpoint()?.write(&path)?;
        }
    }
    Ok(())
}
