//! How a run begins, and how it is resumed.

use std::io;
use std::path::Path;

use serde_json::{Value, json};

use super::names::{LAST, PREVIOUS};
use super::{
    Checkpoint, CheckpointError, CheckpointProblem, Header, Recorder, RunDir, RunError, bad, checkpoint_of,
    config_of_checkpoint, unwritable,
};
use crate::agent::Exploration;
use crate::config::{Config, EnvironmentConfig, difference};
use crate::nn::LearningRate;
use crate::text::shown;
use crate::trainer::{Budget, EndReason, Observer, ResumeError, TrainError, Trainer};

pub(crate) struct Started {
    pub(crate) dir: RunDir,
    pub config: Config,
    pub(crate) trainer: Trainer,
    pub(crate) recorder: Recorder,
    /// Notes for the user; nothing has failed.
    pub(crate) notes: Vec<String>,
}

pub(crate) enum Resumed {
    Run(Box<Started>),
    Ended(Box<EndedRun>),
}

/// A run that has ended, so that there is nothing to resume.
pub(crate) struct EndedRun {
    pub(crate) dir: RunDir,
    /// Its config with the given settings.
    pub config: Config,
    /// Why there is nothing to train, for the user.
    pub(crate) why: String,
    /// Whether the given settings change the run.
    pub(crate) is_extended: bool,
    /// Settings with which it would train further.
    pub(crate) sets: Vec<String>,
    /// Whether these settings extend this run; otherwise they need a new run.
    pub(crate) can_resume: bool,
}

/// Makes a new run in a directory. `name` is what its config is called, and `init` the policy that it starts with: a run's directory or a file.
///
/// # Errors
/// When the directory cannot be used, or the policy does not fit; nothing of the run stays then.
pub(crate) fn start(
    path: &Path, force: bool, name: &str, config: &Config, init: Option<&Path>,
) -> Result<Started, RunError> {
    let mut trainer = config.make_trainer()?;
    let init = init.map(|path| start_from(&checkpoint_of(path)?, &mut trainer)).transpose()?;
    let (dir, metrics) = RunDir::create(path, force, name, config, init.as_ref())?;
    let mut recorder = Recorder { dir: dir.clone(), config: config.clone(), metrics };
    // From now on a run without a checkpoint is one that has lost it, however early the process is killed.
    save(&mut trainer, &mut recorder)?;
    Ok(Started { dir, config: config.clone(), trainer, recorder, notes: Vec::new() })
}

pub(crate) fn start_again(
    path: &Path, config: &Config, init: Option<&Checkpoint>,
) -> Result<(RunDir, Recorder), RunError> {
    let (dir, metrics) = RunDir::create(path, false, "", config, init)?;
    Ok((dir.clone(), Recorder { dir, config: config.clone(), metrics }))
}

fn save(trainer: &mut Trainer, recorder: &mut dyn Observer) -> Result<(), RunError> {
    trainer.save_last(recorder).map_err(|error: TrainError| RunError::Failed(error.to_string()))
}

/// Gives a run before its first step the weights of a policy; returns the copy that the run keeps to be resumed and verified.
fn start_from(path: &Path, trainer: &mut Trainer) -> Result<Checkpoint, RunError> {
    let policy = Checkpoint::read(path)?.policy(trainer.spec());
    let policy = policy.map_err(|problem| CheckpointError { path: path.to_owned(), problem })?;
    let own = trainer.agent().policy();
    let (found, wanted) = (policy.shape(), own.shape());
    if found != wanted {
        let how = policy.network().filter(|_| own.network().is_some()).map_or(String::new(), |network| {
            let sizes = network.sizes();
            let hidden: Vec<String> = sizes[1..sizes.len() - 1].iter().map(usize::to_string).collect();
            format!(": --set 'network.hidden=[{}]'", hidden.join(","))
        });
        return Err(RunError::BadInput(format!(
            "checkpoint {}: its policy has {found}, and that of the run {wanted}; start from a policy of that shape, or \
             train one of this shape{how}",
            shown(path)
        )));
    }
    let mut copy = Checkpoint::default();
    policy.save("", &mut copy.tensors);
    if trainer.agent_mut().start_from(&policy) {
        Ok(copy)
    } else {
        let why = if policy.network().is_some() {
            "its weights become infinite under the run's `observation_divisors`; give the run divisors nearer to 1"
        } else {
            "its table has other edges than that of the run; give the run its `table.bins`"
        };
        Err(RunError::BadInput(format!("checkpoint {}: {why}", shown(path))))
    }
}

/// The run of a directory before its first step, and the weights that it starts with where they are not drawn.
pub(crate) fn first_step(run: &RunDir, config: &Config) -> Result<(Trainer, Option<Checkpoint>), RunError> {
    let mut trainer = config.make_trainer()?;
    let init = run.init().exists().then(|| start_from(&run.init(), &mut trainer)).transpose()?;
    Ok((trainer, init))
}

/// Takes a run back to its latest good checkpoint and cuts off what came since. `sets` may change its budget, its schedules
/// and `stop_when_lasting_steps` to null. `permit` allows its program, or says why not. Bad input changes nothing.
pub fn resume(
    path: &Path, sets: &[String], permit: impl FnOnce(&mut EnvironmentConfig) -> Result<(), String>,
) -> Result<Resumed, RunError> {
    let (dir, recorded) = RunDir::open(path)?;
    let mut metrics = dir.take()?;
    let mut config = with_other_budget(&recorded, sets, path)?;
    permit(&mut config.environment).map_err(RunError::BadInput)?;
    config.check_memory(1).map_err(RunError::BadInput)?;
    let mut notes = Vec::new();
    let (mut trainer, falls_back) = latest(&dir, &config, &mut notes)?;
    let steps = trainer.progress().env_steps;
    let branches = trainer.progress().branched_at_step == Some(steps);
    let has_ended = trainer.end_reason().filter(|_| trainer.is_past_budget() || dir.summary().is_file());
    if let Some(reason) = has_ended {
        let is_extended = branches || trainer.is_past_budget() || config != recorded;
        let (can_resume, sets) = (reason != EndReason::Solved, what_extends(&trainer, reason, sets));
        let why = why_ended(&trainer, reason);
        return Ok(Resumed::Ended(Box::new(EndedRun { dir, config, why, is_extended, sets, can_resume })));
    }
    let events = trainer.progress().events;
    let failed = |error: io::Error| unwritable(path, error, "");
    if !metrics.cut(events).map_err(failed)? {
        let problem = format!(
            "has a metrics.jsonl with fewer lines than the {events} that the run had written before its checkpoint; \
             restore the file, or train again"
        );
        return Err(bad(path, problem));
    }
    take_back(&dir, &trainer, falls_back).map_err(failed)?;
    if config != recorded {
        dir.write_json(&dir.config(), &config).map_err(failed)?;
    }
    let mut recorder = Recorder { dir: dir.clone(), config: config.clone(), metrics };
    if branches {
        notes.push(format!(
            "from step {steps} on the run follows another schedule. It is now a branch of its own: no single config \
             repeats it, so `verify` refuses it"
        ));
    }
    save(&mut trainer, &mut recorder)?;
    notes.extend(schedules_that_have_ended(&config, steps, config.budget != recorded.budget));
    Ok(Resumed::Run(Box::new(Started { dir, config, trainer, recorder, notes })))
}

fn why_ended(trainer: &Trainer, reason: EndReason) -> String {
    let (steps, episodes) = (trainer.progress().env_steps, trainer.progress().episodes);
    match reason {
        EndReason::Solved => format!("the run solved its task after {steps} steps and ended there"),
        EndReason::Lasting => format!("the run ended after {steps} steps with a policy that lasts"),
        _ if trainer.is_past_budget() => format!(
            "the run is already past the budget {}: it is at step {steps} and in episode {episodes}",
            json!(trainer.config().budget)
        ),
        _ => format!("the run has ended after {steps} steps and {episodes} episodes"),
    }
}

/// The given settings, with what else a run that has ended needs to train on. Its budget stays in steps, or in episodes.
fn what_extends(trainer: &Trainer, reason: EndReason, given: &[String]) -> Vec<String> {
    let progress = trainer.progress();
    let (unit, done, budget) = match trainer.config().budget {
        Budget::Steps(steps) => ("steps", progress.env_steps, steps),
        Budget::Episodes(episodes) => ("episodes", progress.episodes, episodes),
    };
    let is_used_up = done >= budget;
    let is_kept = |set: &&String| !(is_used_up && set.starts_with("budget"));
    let mut sets: Vec<String> = given.iter().filter(is_kept).cloned().collect();
    sets.extend(is_used_up.then(|| format!("budget.{unit}={}", done.saturating_mul(2))));
    match reason {
        EndReason::Solved => sets.push("stop_when_solved=false".into()),
        EndReason::Lasting => sets.push("stop_when_lasting_steps=null".into()),
        _ => {}
    }
    sets
}

/// What a resumed run may change besides its budget.
fn schedules(config: &Config) -> (LearningRate, Exploration) {
    (config.agent.learning_rate(), config.agent.exploration())
}

/// What the user should know of schedules that end before the run does; of ε only where the run is longer than planned.
fn schedules_that_have_ended(config: &Config, env_steps: u64, is_extended: bool) -> Vec<String> {
    let end = if let Budget::Steps(steps) = config.budget { steps } else { env_steps };
    let mut notes = Vec::new();
    let (LearningRate { learning_rate, schedule }, exploration) = schedules(config);
    if let Some(schedule) = schedule
        && (schedule.steps <= env_steps || schedule.steps < end)
    {
        let rate = schedule.final_learning_rate;
        let effect = if rate > 0.0 { "" } else { ", with which the agent learns nothing" };
        notes.push(format!(
            "the schedule of the learning rate ends at step {}: from there on the rate is {rate}{effect}. To stretch it, \
             add --set optimizer.schedule.steps={end}; --set optimizer.schedule=null keeps the rate at {learning_rate}",
            schedule.steps
        ));
    }
    if let Exploration::Linear { final_, steps, .. } = exploration
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

/// The run's config with what `--set` changes, which may be when it ends and its schedules alone.
fn with_other_budget(recorded: &Config, sets: &[String], path: &Path) -> Result<Config, RunError> {
    let config = Config::from_layers(Some(("the run's config", &json!(recorded).to_string())), sets)?;
    let (before, now) = (recorded.stop_when_lasting_steps, config.stop_when_lasting_steps);
    let other_end = (now.is_some() && now != before)
        .then(|| format!("its `stop_when_lasting_steps` is {}, and {} is given", json!(before), json!(now)));
    match other_run(recorded, &config).or(other_end) {
        None => Ok(config),
        Some(difference) => {
            let problem = format!(
                "holds a run with other settings: {difference}. A resumed run can change only its budget, its schedules \
                 (optimizer.schedule, optimizer.learning_rate, a linear exploration) and stop_when_lasting_steps to null; \
                 to train with other settings, start a new run without --resume"
            );
            Err(bad(path, problem))
        }
    }
}

/// The difference that makes two configs different runs. The end and the schedules do not: a resumed run may change them.
fn other_run(recorded: &Config, given: &Config) -> Option<String> {
    let is_linear = |config: &Config| matches!(config.agent.exploration(), Exploration::Linear { .. });
    let comparable = |config: &Config| {
        let mut value = config_of_checkpoint(config);
        value["optimizer"]["schedule"] = Value::Null;
        value["optimizer"]["learning_rate"] = Value::Null;
        if is_linear(recorded) && is_linear(given) {
            value["exploration"] = Value::Null;
        }
        value
    };
    difference("", &comparable(recorded), &comparable(given))
}

/// The run at its latest good checkpoint, and whether that is the previous one; at its start if it never had one.
fn latest(run: &RunDir, config: &Config, notes: &mut Vec<String>) -> Result<(Trainer, bool), RunError> {
    let last = match load(&run.last(), config) {
        Ok(trainer) => return Ok((trainer, false)),
        Err(error) => error,
    };
    match load(&run.previous(), config) {
        _ if !can_be_replaced(&last.problem) => Err(last.into()),
        Ok(trainer) => {
            let steps = trainer.progress().env_steps;
            notes.push(format!("{last}; resuming from {} at step {steps} instead", run.previous().display()));
            Ok((trainer, true))
        }
        Err(previous) if is_missing(&last.problem) && is_missing(&previous.problem) => {
            let has_metrics = run.metrics().metadata().is_ok_and(|file| file.len() > 0);
            let (has_best, has_summary) = (run.best().exists(), run.summary().exists());
            let parts = [("metrics", has_metrics), ("best", has_best), ("summary", has_summary)];
            if let Some((found, _)) = parts.iter().find(|(_, is_there)| *is_there) {
                let problem = format!(
                    "cannot be resumed: its checkpoints {LAST} and {PREVIOUS} are missing, though the run has begun \
                     ({found} found). Put one of them back into {}, or train again: --config {} --out another directory",
                    run.checkpoints().display(),
                    run.config().display()
                );
                return Err(bad(run.path(), problem));
            }
            notes.push("the run has no checkpoint yet, so it starts again at step 0".into());
            Ok((first_step(run, config)?.0, false))
        }
        Err(previous) => Err(RunError::BadInput(format!(
            "{last}; {previous}; train again with --config {} and another --out",
            run.config().display()
        ))),
    }
}

/// The run that a checkpoint was taken of, with another budget and other schedules if the config has others. With other
/// schedules it is a branch from here on. The checkpoint says which schedules it was trained with: the run's config may already
/// be that of a process that was killed before it could write a checkpoint of the branch.
pub fn load(path: &Path, config: &Config) -> Result<Trainer, CheckpointError> {
    let load = || {
        let checkpoint = Checkpoint::read_unnamed(path)?;
        let header: Header = checkpoint.header()?;
        let progress = header.progress.ok_or(CheckpointProblem::NotResumable)?;
        if let Some(difference) = other_run(config, &header.config) {
            return Err(CheckpointProblem::OtherRun(difference));
        }
        config.check_memory(1).map_err(CheckpointProblem::Memory)?;
        let trainer = config.make_trainer().map_err(ResumeError::from)?;
        let mut trainer = trainer.resume(progress, &checkpoint.tensors)?;
        if trainer.progress().env_steps > 0 && schedules(config) != schedules(&header.config) {
            trainer.branch();
        }
        Ok(trainer)
    };
    load().map_err(|problem| CheckpointError { path: path.to_owned(), problem })
}

fn is_missing(problem: &CheckpointProblem) -> bool {
    matches!(problem, CheckpointProblem::Unreadable(error) if error.kind() == io::ErrorKind::NotFound)
}

/// Whether the previous checkpoint may be used: not if the last is intact, and only this program cannot read it now.
fn can_be_replaced(problem: &CheckpointProblem) -> bool {
    let readable = matches!(
        problem,
        CheckpointProblem::Unreadable(_)
            | CheckpointProblem::Memory(_)
            | CheckpointProblem::WrongVersion(_)
            | CheckpointProblem::OtherRun(_)
            | CheckpointProblem::Resume(ResumeError::Environment(_) | ResumeError::NotDeterministic)
    );
    !readable || is_missing(problem)
}

/// Removes what the run has written after its checkpoint, the metrics apart.
fn take_back(run: &RunDir, trainer: &Trainer, falls_back: bool) -> io::Result<()> {
    run.set_failed(None)?;
    let directory = run.directory()?;
    directory.create_dir(&run.checkpoints())?;
    directory.remove_unfinished(run.path())?;
    directory.remove_unfinished(&run.checkpoints())?;
    if falls_back {
        directory.rename(&run.previous(), &run.last())?;
    }
    let no_best = trainer.best_policy().is_none().then(|| run.best());
    [run.summary()].iter().chain(&no_best).try_for_each(|path| directory.remove_if_there(path))
}
