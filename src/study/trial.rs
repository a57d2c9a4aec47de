//! One trial: a config trained with a seed, and what became of it.

use std::io;
use std::sync::atomic::AtomicBool;

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::NamedConfig;
use crate::env::{CartPole, Environment, TimeLimit};
use crate::nn::Mlp;
use crate::trainer::{EndReason, Evaluation, Event, EventSink, Score, Trainer, evaluate};

/// Gymnasium seed of the first episode that scores a policy, that of `eval`: not those that chose the best.
pub const SCORE_SEED: u64 = 2_000_000;
/// Episodes that score a policy, as many as `eval` plays.
pub const SCORE_EPISODES: u64 = 100;

/// The file of a trial. It holds no wall-clock values, so that equal trials are equal files.
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
}

impl PolicyScore {
    fn new(policy: &Mlp<f32>, env_steps: u64) -> Self {
        let returns = evaluate(policy, &CartPole::v1(), SCORE_SEED, SCORE_EPISODES);
        let Score { mean, std, min, median, max, .. } = Score::new(&returns);
        Self { env_steps, mean, std, min, median, max }
    }

    /// Whether it solves CartPole-v1.
    pub fn solves(&self) -> bool {
        self.mean >= TimeLimit::<CartPole>::SOLVED_RETURN
    }
}

impl Trial {
    /// Trains the config with the seed and scores what it came to; none if `stop` was set before that.
    pub(super) fn run(named: &NamedConfig, seed: u64, stop: &AtomicBool) -> Option<Self> {
        let mut config = named.config.clone();
        config.seed = seed;
        let mut trainer = Trainer::new(config, CartPole::v1());
        let mut evaluations = Evaluations(Vec::new());
        let ended = trainer.run(&mut evaluations, None, stop);
        if matches!(ended, Ok(EndReason::Interrupted)) {
            return None;
        }
        let Evaluations(evaluations) = evaluations;

        let progress = trainer.progress();
        let score = |policy: &Mlp<f32>, evaluation: Option<Evaluation>| {
            Some(PolicyScore::new(policy, evaluation?.env_steps))
        };
        let best = trainer.best_policy().and_then(|policy| score(policy, progress.best_evaluation));
        let final_ = match &ended {
            Err(_) => None,
            // One policy needs one score.
            Ok(_) if progress.best_evaluation == progress.last_evaluation => best.clone(),
            Ok(_) => score(&trainer.agent().policy(), progress.last_evaluation),
        };
        let summary = ended.as_ref().ok().map(|&reason| {
            let mut summary = json!(trainer.summary(reason, 0.0));
            summary.as_object_mut().map(|fields| fields.shift_remove("wall_seconds"));
            summary
        });
        let error = ended.err().map(|error| error.to_string());
        Some(Self { config: named.name.clone(), seed, error, summary, best, final_, evaluations })
    }

    /// Whether the final policy solves CartPole-v1.
    pub fn solved(&self) -> bool {
        self.final_.as_ref().is_some_and(PolicyScore::solves)
    }
}

/// Keeps the evaluations of a run and lets everything else go.
struct Evaluations(Vec<Evaluation>);

impl EventSink for Evaluations {
    fn emit(&mut self, event: &Event) -> io::Result<()> {
        if let Event::Evaluation { env_steps, mean, .. } = *event {
            self.0.push(Evaluation { env_steps, mean });
        }
        Ok(())
    }
}
