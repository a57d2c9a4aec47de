//! One trial: a config trained with a seed, and its result. A try that ends for another reason, such as a signal or a failing
//! disk, has no result: it is [`Unended`], and the next one resumes it.

use std::io;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::config::Config;
use crate::env::{Make, Spec};
use crate::files::Directory;
use crate::run::Checkpoint;
use crate::trainer::{
    CheckpointKind, DueCheckpoint, EndReason, Evaluation, Event, Observer, Progress, ResumeError, SCORE_SEED,
    Score, Snapshot, TrainError, Trainer, evaluate, lasts,
};

/// Episodes that score a policy, as many as `eval` plays.
pub(crate) const SCORE_EPISODES: u64 = 100;
/// Steps that a policy must last where the study asks: 400 s, in which a cart that drifts has left the track.
pub(crate) const LASTING_STEPS: u32 = 20_000;

/// The line of a trial, which follows from its config and seed alone: equal trials are equal lines. Readers need only a part of
/// the summary and have another type `S` for it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Trial<S = Value> {
    pub config: String,
    pub seed: u64,
    /// How the training diverged; none if it did not.
    pub(crate) error: Option<String>,
    /// What the run came to, as in `summary.json` without `wall_seconds`; none if it diverged.
    pub(crate) summary: Option<S>,
    /// Score of the policy with the best evaluation; none if the run diverged before the first.
    pub(crate) best: Option<PolicyScore>,
    /// Score of the policy at the end; none if the run diverged.
    #[serde(rename = "final")]
    pub(crate) final_: Option<PolicyScore>,
    pub evaluations: Vec<Evaluation>,
}

#[derive(Debug, Deserialize)]
pub(crate) struct TrialSummary {
    pub(crate) end_reason: Option<EndReason>,
    pub(crate) env_steps: Option<u64>,
    /// Missing where a program from before these counters trained the trial.
    pub(crate) evaluation_steps: Option<u64>,
    pub(crate) lasting_test_steps: Option<u64>,
}

/// What a policy gets in [`SCORE_EPISODES`] episodes from [`SCORE_SEED`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct PolicyScore {
    /// Environment steps of training before it.
    pub env_steps: u64,
    pub mean: f64,
    /// Population standard deviation of the returns.
    pub std: f64,
    pub min: f64,
    pub median: f64,
    pub max: f64,
    /// Whether the policy [lasts](lasts()) [`LASTING_STEPS`] steps; none where the study does not ask.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) lasts: Option<bool>,
}

/// What an interrupted trial has besides the tensors of its run: the header of its checkpoint.
#[derive(Serialize, Deserialize)]
struct TrialHeader {
    /// The run's config, as JSON: another one has other tensors.
    settings: Value,
    progress: Progress,
    evaluations: Vec<Evaluation>,
}

#[derive(Debug, thiserror::Error)]
#[error("{config}, seed {seed}: {cause}")]
pub struct Unended {
    pub config: String,
    pub seed: u64,
    pub(crate) cause: Cause,
    /// Whether the study keeps a checkpoint of it. Otherwise the next try begins at the first step.
    pub(crate) is_kept: bool,
}

#[derive(Debug, thiserror::Error)]
pub(crate) enum Cause {
    #[error("stopped by a signal or --time-limit after step {0}")]
    Stopped(u64),
    #[error(transparent)]
    Failed(#[from] TrainError),
}

impl<S> Trial<S> {
    /// Whether the line, of an earlier version, is no result: only a training that diverged follows from config and seed.
    pub(super) fn is_circumstance(&self) -> bool {
        self.error.as_ref().is_some_and(|error| !error.starts_with("training diverged: "))
    }

    /// Why this is not the line of a trial; none if it is one.
    pub(super) fn problem(&self) -> Option<&'static str> {
        if !self.evaluations.is_sorted_by(|a, b| a.env_steps < b.env_steps) {
            return Some("its evaluations are not in the order of their steps");
        }
        let has_ended = self.error.is_none();
        (has_ended != self.final_.is_some() || has_ended != self.summary.is_some())
            .then_some("a trial has either an `error`, or a `summary` and a `final` score")
    }
}

impl Trial {
    /// Trains the config with the seed and scores it. `place` has the newest checkpoint of a try that did not end, to resume it.
    pub(super) fn run(
        named: &super::NamedConfig, make: Arc<Make>, seed: u64, lasting: bool,
        place: Option<(&Directory, &Path)>, stop: &AtomicBool,
    ) -> Result<Self, Unended> {
        let config = Config { seed, ..named.config.clone() };
        let mut keeper = Keeper { config: &config, place, evaluations: Vec::new(), is_kept: false };
        let ended = Self::try_run(&named.name, make, lasting, &mut keeper, stop);
        let is_kept = keeper.is_kept;
        ended.map_err(|cause| Unended { config: named.name.clone(), seed, cause, is_kept })
    }

    fn try_run(
        name: &str, make: Arc<Make>, lasting: bool, keeper: &mut Keeper, stop: &AtomicBool,
    ) -> Result<Self, Cause> {
        let config = keeper.config;
        let mut trainer = match keeper.resume(&make)? {
            Some(trainer) => trainer,
            None => config.make_trainer_in(Arc::clone(&make)).map_err(TrainError::from)?,
        };
        let ended = match trainer.run(keeper, stop) {
            Ok(EndReason::Interrupted) => {
                keeper.keep(trainer.snapshot()).map_err(TrainError::Checkpoint)?;
                return Err(Cause::Stopped(trainer.progress().env_steps));
            }
            Ok(reason) => Ok(reason),
            Err(diverged @ TrainError::Diverged { .. }) => Err(diverged.to_string()),
            Err(error) => return Err(error.into()),
        };
        let progress = trainer.progress();
        let score = |policy: &crate::agent::Policy, Evaluation { env_steps, .. }| -> Result<_, TrainError> {
            let played = evaluate(policy, &*make, trainer.spec().max_steps, SCORE_SEED, SCORE_EPISODES, 1.0)?;
            let returns: Vec<f64> = played.iter().map(|episode| episode.total).collect();
            let Score { mean, std, min, median, max, .. } = Score::new(&returns);
            let lasts =
                lasting.then(|| lasts(policy, &*make, LASTING_STEPS)).transpose()?.map(|(lasts, _)| lasts);
            Ok(PolicyScore { env_steps, mean, std, min, median, max, lasts })
        };
        let best = trainer.best_policy().zip(progress.best_evaluation);
        let best = best.map(|(policy, evaluation)| score(policy, evaluation)).transpose()?;
        let (config, seed, evaluations) = (name.to_owned(), config.seed, keeper.evaluations.clone());
        let reason = match ended {
            Err(error) => {
                let error = Some(error);
                return Ok(Self { config, seed, error, summary: None, best, final_: None, evaluations });
            }
            Ok(reason) => reason,
        };
        let final_ = match progress.last_evaluation {
            // One policy needs one score.
            last if last == progress.best_evaluation => best.clone(),
            last => last.map(|last| score(&trainer.agent().policy(), last)).transpose()?,
        };
        let mut summary = json!(trainer.summary(reason, 0.0));
        summary.as_object_mut().map(|fields| fields.shift_remove("wall_seconds"));
        Ok(Self { config, seed, error: None, summary: Some(summary), best, final_, evaluations })
    }

    pub(crate) fn solved(&self, spec: &Spec) -> bool {
        self.final_.as_ref().is_some_and(|score| spec.is_solved_by(score.mean))
    }
}

/// Collects the evaluations of a run and keeps its newest checkpoint. A program can fail, so its trials keep every checkpoint that
/// is due. The built-in environments cannot, and their trials are short: these keep one when they are stopped.
struct Keeper<'a> {
    config: &'a Config,
    place: Option<(&'a Directory, &'a Path)>,
    evaluations: Vec<Evaluation>,
    is_kept: bool,
}

impl Observer for Keeper<'_> {
    fn event(&mut self, event: &Event) -> io::Result<()> {
        if let Event::Evaluation { env_steps, mean, .. } = *event {
            self.evaluations.push(Evaluation { env_steps, mean });
        }
        Ok(())
    }

    fn checkpoint(&mut self, checkpoint: &DueCheckpoint<'_>) -> io::Result<()> {
        let is_due = checkpoint.kind != CheckpointKind::Best && self.config.environment.command().is_some();
        if is_due { self.keep(checkpoint.snapshot()) } else { Ok(()) }
    }
}

impl Keeper<'_> {
    fn keep(&mut self, snapshot: Snapshot) -> io::Result<()> {
        let (Some((directory, path)), Some(progress)) = (self.place, snapshot.progress) else {
            return Ok(());
        };
        let (settings, evaluations) = (json!(self.config), self.evaluations.clone());
        let mut checkpoint = Checkpoint::new(&TrialHeader { settings, progress, evaluations })?;
        checkpoint.tensors = snapshot.tensors;
        let made = path.parent().map_or(Ok(false), |parent| directory.create_dir(parent));
        made.and_then(|_| checkpoint.write_in(directory, path, None)).map_err(|error| {
            io::Error::new(error.kind(), format!("cannot write {}: {error}", crate::text::shown(path)))
        })?;
        self.is_kept = true;
        Ok(())
    }

    /// The run of an earlier try, if its file is there and whole.
    fn resume(&mut self, make: &Arc<Make>) -> Result<Option<Trainer>, TrainError> {
        let Some(checkpoint) = self.place.and_then(|(_, path)| Checkpoint::read(path).ok()) else {
            return Ok(None);
        };
        let header = checkpoint.header::<TrialHeader>().ok();
        let header = header.filter(|header| header.settings == json!(self.config));
        let Some(TrialHeader { progress, evaluations, .. }) = header else { return Ok(None) };
        self.is_kept = true;
        let trainer = self.config.make_trainer_in(Arc::clone(make))?;
        match trainer.resume(progress, &checkpoint.tensors) {
            Ok(trainer) => {
                self.evaluations = evaluations;
                Ok(Some(trainer))
            }
            Err(ResumeError::Environment(error)) => Err(error.into()),
            Err(_) => {
                self.is_kept = false;
                Ok(None)
            }
        }
    }
}

#[cfg(test)]
#[path = "../../tests/unit/study_trial.rs"]
mod tests;
