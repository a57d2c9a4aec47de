//! One trial: a config trained with a seed, and what became of it.

use std::fs;
use std::io;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::NamedConfig;
use crate::agent::Policy;
use crate::config::Config;
use crate::env::{EnvironmentError, Make, Spec};
use crate::run::Checkpoint;
use crate::trainer::{
    EndReason, Evaluation, Event, Observer, Progress, SCORE_SEED, Score, TrainError, Trainer, evaluate,
};

/// Episodes that score a policy, as many as `eval` plays.
pub const SCORE_EPISODES: u64 = 100;
/// Steps that a policy must last in a study of endurance: 400 s, in which a cart that drifts has left the track.
pub const ENDURANCE_STEPS: u32 = 20_000;

/// The line of a trial. It holds no wall-clock values, so that equal trials are equal lines. Its key comes first, so that
/// readers who need no more find it fast.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Trial {
    /// Name of the config.
    pub config: String,
    /// Seed of the run.
    pub seed: u64,
    /// Why the run failed; none if it did not.
    pub error: Option<String>,
    /// What the run came to, as in `summary.json` without `wall_seconds`; none if it failed.
    pub summary: Option<Value>,
    /// Score of the policy with the best evaluation; none if the run failed before the first.
    pub best: Option<PolicyScore>,
    /// Score of the policy at the end; none if the run failed.
    #[serde(rename = "final")]
    pub final_: Option<PolicyScore>,
    /// The evaluations during training.
    pub evaluations: Vec<Evaluation>,
}

/// What a policy gets in [`SCORE_EPISODES`] episodes from [`SCORE_SEED`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PolicyScore {
    /// Environment steps of training before it.
    pub env_steps: u64,
    /// Mean return.
    pub mean: f64,
    /// Population standard deviation of the returns.
    pub std: f64,
    /// Smallest return.
    pub min: f64,
    /// Median return.
    pub median: f64,
    /// Largest return.
    pub max: f64,
    /// How many of the episodes last [`ENDURANCE_STEPS`] steps where nothing cuts them off before; none where the study
    /// does not ask.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub endured: Option<u64>,
}

impl PolicyScore {
    fn new(
        policy: &Policy,
        make: &Make,
        spec: &Spec,
        env_steps: u64,
        endurance: bool,
    ) -> Result<Self, EnvironmentError> {
        let max_steps = if endurance { ENDURANCE_STEPS.max(spec.max_steps) } else { spec.max_steps };
        let played = evaluate(policy, make, max_steps, SCORE_SEED, SCORE_EPISODES, 1.0)?;
        let returns: Vec<f64> = played.iter().map(|episode| episode.total).collect();
        let Score { mean, std, min, median, max, .. } = Score::new(&returns);
        let endured = played.iter().filter(|episode| episode.steps >= u64::from(ENDURANCE_STEPS)).count();
        let endured = endurance.then_some(endured as u64);
        Ok(Self { env_steps, mean, std, min, median, max, endured })
    }
}

/// What an interrupted trial has besides the tensors of its run: the header of its checkpoint.
#[derive(Serialize, Deserialize)]
struct Unfinished {
    /// The run's config, as JSON: another one has other tensors.
    settings: Value,
    progress: Progress,
    evaluations: Vec<Evaluation>,
}

impl Trial {
    /// Trains the config with the seed and scores what it came to. If `stop` is set before that, there is none, and the file
    /// `unfinished` keeps the run, which the next call resumes. A file that cannot be read or written costs only time.
    pub(super) fn run(
        named: &NamedConfig,
        make: Arc<Make>,
        seed: u64,
        endurance: bool,
        unfinished: Option<&Path>,
        stop: &AtomicBool,
    ) -> Option<Self> {
        let mut config = named.config.clone();
        config.seed = seed;
        let mut trial = Self {
            config: named.name.clone(),
            seed,
            error: None,
            summary: None,
            best: None,
            final_: None,
            evaluations: Vec::new(),
        };
        let resumed = unfinished.and_then(|path| resume(&config, &make, path));
        let begun = || Ok((config.make_trainer_in(Arc::clone(&make))?, Evaluations(Vec::new())));
        match resumed.map_or_else(begun, Ok).map_err(|error: EnvironmentError| error.to_string()) {
            Ok((mut trainer, mut evaluations)) => {
                let ended = trainer.run(&mut evaluations, stop);
                trial.evaluations = evaluations.0;
                if matches!(ended, Ok(EndReason::Interrupted)) {
                    let _ = unfinished.map(|path| keep(&trainer, &config, trial.evaluations, path));
                    return None;
                }
                let scored = trial.score(&trainer, &*make, ended.as_ref().ok().copied(), endurance);
                trial.error = ended.err().or(scored.err()).map(|error| error.to_string());
            }
            Err(error) => trial.error = Some(error),
        }
        Some(trial)
    }

    /// Scores the best policy of a run, and the last one and the whole of a run that did not fail.
    fn score(
        &mut self,
        trainer: &Trainer,
        make: &Make,
        end_reason: Option<EndReason>,
        endurance: bool,
    ) -> Result<(), TrainError> {
        let (progress, spec) = (trainer.progress(), trainer.spec());
        let score = |policy: &Policy, evaluation: Evaluation| {
            PolicyScore::new(policy, make, spec, evaluation.env_steps, endurance)
        };
        let best = trainer.best_policy().zip(progress.best_evaluation);
        self.best = best.map(|(policy, evaluation)| score(policy, evaluation)).transpose()?;
        let Some(reason) = end_reason else { return Ok(()) };
        self.final_ = match progress.last_evaluation {
            // One policy needs one score.
            last if last == progress.best_evaluation => self.best.clone(),
            last => last.map(|last| score(&trainer.agent().policy(), last)).transpose()?,
        };
        let mut summary = json!(trainer.summary(reason, 0.0));
        summary.as_object_mut().map(|fields| fields.shift_remove("wall_seconds"));
        self.summary = Some(summary);
        Ok(())
    }

    /// Whether the final policy solves the task.
    pub fn solved(&self, spec: &Spec) -> bool {
        self.final_.as_ref().is_some_and(|score| spec.is_solved_by(score.mean))
    }
}

/// Keeps the evaluations of a run and lets everything else go.
struct Evaluations(Vec<Evaluation>);

impl Observer for Evaluations {
    fn event(&mut self, event: &Event) -> io::Result<()> {
        if let Event::Evaluation { env_steps, mean, .. } = *event {
            self.0.push(Evaluation { env_steps, mean });
        }
        Ok(())
    }
}

/// Writes a run that was interrupted, to be resumed.
fn keep(trainer: &Trainer, config: &Config, evaluations: Vec<Evaluation>, path: &Path) -> io::Result<()> {
    let snapshot = trainer.snapshot();
    let Some(progress) = snapshot.progress else { return Ok(()) };
    let mut checkpoint = Checkpoint::new(&Unfinished { settings: json!(config), progress, evaluations })?;
    checkpoint.tensors = snapshot.tensors;
    path.parent().map_or(Ok(()), fs::create_dir_all)?;
    checkpoint.write(path)
}

/// The run that was interrupted, if its file is there and whole.
fn resume(config: &Config, make: &Arc<Make>, path: &Path) -> Option<(Trainer, Evaluations)> {
    let checkpoint = path.exists().then(|| Checkpoint::read(path).ok()).flatten()?;
    let Unfinished { settings, progress, evaluations } = checkpoint.header().ok()?;
    let trainer = config.make_trainer_in(Arc::clone(make)).ok().filter(|_| settings == json!(config))?;
    Some((trainer.resume(progress, &checkpoint.tensors).ok()?, Evaluations(evaluations)))
}
