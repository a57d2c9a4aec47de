//! The training loop. It drives an agent through an environment and tells a sink; it never prints.

mod evaluate;
pub mod event;
mod saved;
mod state;

use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use serde::{Deserialize, Serialize};

use crate::agent::{Dqn, NotFinite, Policy, Probes, Transition};
use crate::config::Config;
use crate::env::Environment;
use crate::nn::Mlp;
use crate::rng::{Rng, Stream};

pub use evaluate::{Frame, Played, Score, TraceStep, evaluate, evaluate_discounted, play, record};
pub use event::{EndReason, Event, EventSink};
pub use saved::SavedPolicy;
pub use state::{Evaluation, Header, Progress, State, Summary};

/// Name of the checkpoint with the best policy.
pub const BEST: &str = "best.safetensors";
/// Name of the latest checkpoint.
pub const LAST: &str = "last.safetensors";
/// Name of the periodic checkpoint before it.
pub const PREVIOUS: &str = "previous.safetensors";

/// Gymnasium seed of the first evaluation episode; the others follow. Training never resets from a seed.
pub const EVALUATION_SEED: u64 = 1_000_000;

/// When a run ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Budget {
    /// After this many environment steps, at least 1.
    Steps(u64),
    /// After this many complete episodes, at least 1.
    Episodes(u64),
}

/// The greedy evaluations during training.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EvaluationConfig {
    /// Environment steps between evaluations, at least 1. There is always one at the end.
    pub every_steps: u64,
    /// Episodes of an evaluation, 1…100,000, always the same ones.
    pub episodes: u64,
}

/// Writing [`LAST`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CheckpointConfig {
    /// Environment steps between checkpoints, at least 1. There is always one at the end.
    pub every_steps: u64,
}

/// Why a run failed.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// The numbers left the finite.
    #[error("training diverged: at environment step {env_steps} {what} became NaN or infinite")]
    Diverged {
        /// The step in which it happened.
        env_steps: u64,
        /// What is not finite.
        what: NotFinite,
    },
    /// A checkpoint cannot be written.
    #[error("cannot write {}: {source}", path.display())]
    Checkpoint {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A sink cannot take an event.
    #[error("cannot write an event at environment step {env_steps}: {source}")]
    Sink {
        /// The step of the event.
        env_steps: u64,
        /// Why.
        source: io::Error,
    },
}

/// One run: an agent in an environment.
#[derive(Clone, Debug)]
pub struct Trainer<E: Environment> {
    config: Config,
    environment: E,
    observation: E::Observation,
    environment_rng: Rng,
    agent: Dqn,
    progress: Progress,
    best_policy: Option<Mlp<f32>>,
    /// Environment steps before the latest checkpoint.
    saved_at: Option<u64>,
    probes: Probes,
}

impl<E: Environment> Trainer<E> {
    /// A run of a valid config, before its first step.
    pub fn new(config: Config, mut environment: E) -> Self {
        let mut environment_rng = Rng::spawn(config.seed, Stream::Environment);
        Self {
            observation: environment.reset(&mut environment_rng),
            agent: Dqn::new(config.dqn(), E::OBSERVATION_SIZE, E::NUM_ACTIONS, config.seed),
            progress: Progress::default(),
            best_policy: None,
            saved_at: None,
            probes: evaluate::probes(&environment),
            environment,
            environment_rng,
            config,
        }
    }

    /// Lets a run before its first step begin with the weights of a policy of the same layer sizes, in both networks.
    /// False if a weight leaves the finite under the config's observation scale.
    #[must_use]
    pub fn start_from(&mut self, policy: &Mlp<f32>) -> bool {
        self.agent.set_policy(policy)
    }

    /// Trains until the budget is used up, or the task is solved if that is to end the run. `checkpoints` is the
    /// folder for [`LAST`], [`PREVIOUS`] and [`BEST`]; it exists.
    ///
    /// When `stop` is set, the run finishes the current step, writes [`LAST`] and returns [`EndReason::Interrupted`]. It
    /// neither evaluates nor emits an event, so a resumed run repeats nothing. For the same reason the last checkpoint is
    /// written *before* the final evaluation: a run with a larger budget would not evaluate at that step.
    ///
    /// # Errors
    /// When the numbers leave the finite, or a checkpoint or an event cannot be written. The files written
    /// before stay.
    pub fn run(
        &mut self,
        sink: &mut dyn EventSink,
        checkpoints: Option<&Path>,
        stop: &AtomicBool,
    ) -> Result<EndReason, TrainError> {
        let reason = loop {
            match self.end_reason() {
                Some(reason) => break reason,
                None if stop.load(Ordering::Relaxed) => {
                    self.save_last(sink, checkpoints)?;
                    return Ok(EndReason::Interrupted);
                }
                None => self.step(sink, checkpoints)?,
            }
        };
        self.save_last(sink, checkpoints)?;
        if self.progress.last_evaluation.is_none_or(|last| last.env_steps < self.progress.env_steps) {
            self.evaluate(sink, checkpoints)?;
        }
        let Progress { env_steps, episodes, updates, .. } = self.progress;
        self.emit(sink, &Event::End { env_steps, episodes, updates, reason })?;
        Ok(reason)
    }

    /// One environment step and everything that is due after it.
    ///
    /// # Errors
    /// See [`Self::run`].
    pub fn step(&mut self, sink: &mut dyn EventSink, checkpoints: Option<&Path>) -> Result<(), TrainError> {
        let action = self.agent.act(self.observation.as_ref());
        let step = self.environment.step(action);
        self.agent.observe(Transition {
            observation: self.observation.as_ref(),
            action,
            reward: step.reward,
            next_observation: step.observation.as_ref(),
            terminated: step.terminated,
            truncated: step.truncated,
        });
        let ended = step.ended();
        self.observation = step.observation;
        self.progress.count_step(step.reward);
        let env_steps = self.progress.env_steps;

        if self.agent.learns_at(env_steps) {
            let loss = self.agent.learn().map_err(|what| TrainError::Diverged { env_steps, what })?;
            self.progress.count_learning(loss, self.agent.adam.steps);
        }
        self.agent.after_step(env_steps);
        if ended {
            self.end_episode(sink)?;
        }
        if env_steps.is_multiple_of(self.config.evaluation.every_steps) {
            self.evaluate(sink, checkpoints)?;
        }
        if env_steps.is_multiple_of(self.config.checkpoint.every_steps) {
            self.save_last(sink, checkpoints)?;
        }
        Ok(())
    }

    fn end_episode(&mut self, sink: &mut dyn EventSink) -> Result<(), TrainError> {
        self.agent.after_episode(self.progress.episodes);
        let event = self.progress.end_episode(self.agent.epsilon);
        self.observation = self.environment.reset(&mut self.environment_rng);
        self.emit(sink, &event)
    }

    /// Plays the greedy policy, and keeps it as the best if it is better than all before.
    fn evaluate(&mut self, sink: &mut dyn EventSink, checkpoints: Option<&Path>) -> Result<(), TrainError> {
        let episodes = self.config.evaluation.episodes;
        let policy = self.agent.policy();
        sink.see_policy(&policy);
        let gamma = self.config.gamma;
        let played = evaluate_discounted(&policy, &self.environment, EVALUATION_SEED, episodes, gamma);
        let score = Score::new(&played.iter().map(|episode| episode.total).collect::<Vec<_>>());
        let event = self.progress.count_evaluation(&score, E::SOLVED_RETURN);
        if let Event::Evaluation { best: true, .. } = event {
            self.best_policy = Some(policy);
            if let Some(folder) = checkpoints {
                self.save_best(folder)?;
            }
        }
        self.emit(sink, &event)?;
        if self.agent.replay.is_empty() {
            return Ok(());
        }
        let overestimated =
            |episode: &Played| episode.expected / self.config.reward_scale - episode.discounted;
        let overestimation = played.iter().map(overestimated).sum::<f64>() / played.len() as f64;
        let agent = self.agent.statistics(&self.probes);
        self.emit(sink, &Event::Statistics { env_steps: self.progress.env_steps, overestimation, agent })
    }

    /// Writes [`BEST`] into a folder, if there has been an evaluation.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn save_best(&self, folder: &Path) -> Result<(), TrainError> {
        let path = folder.join(BEST);
        let written = self.best_checkpoint().and_then(|best| best.map_or(Ok(()), |best| best.write(&path)));
        written.map_err(|source| TrainError::Checkpoint { path, source })
    }

    /// Writes [`LAST`] unless it already holds this step. The checkpoint that it replaces is kept as [`PREVIOUS`] only if
    /// it was periodic. Otherwise the files would show where the run was interrupted.
    ///
    /// # Errors
    /// When a file cannot be written, or the sink cannot make its own last.
    pub fn save_last(
        &mut self,
        sink: &mut dyn EventSink,
        checkpoints: Option<&Path>,
    ) -> Result<(), TrainError> {
        let (env_steps, period) = (self.progress.env_steps, self.config.checkpoint.every_steps);
        let Some(folder) = checkpoints.filter(|_| self.saved_at != Some(env_steps)) else { return Ok(()) };
        sink.sync().map_err(|source| TrainError::Sink { env_steps, source })?;
        let is_periodic = self.saved_at.is_some_and(|step| step > 0 && step.is_multiple_of(period));
        let kept = is_periodic.then(|| folder.join(PREVIOUS));
        let path = folder.join(LAST);
        let written = self.checkpoint().and_then(|last| last.write_keeping(&path, kept.as_deref()));
        written.map_err(|source| TrainError::Checkpoint { path, source })?;
        self.saved_at = Some(env_steps);
        Ok(())
    }

    /// Why the run is over, if it is.
    pub fn end_reason(&self) -> Option<EndReason> {
        let used_up = self.progress.uses_up(self.config.budget);
        let solved = self.config.stop_when_solved && self.progress.solved_at_step.is_some();
        if solved { Some(EndReason::Solved) } else { used_up.then_some(EndReason::Budget) }
    }

    fn emit(&mut self, sink: &mut dyn EventSink, event: &Event) -> Result<(), TrainError> {
        let env_steps = self.progress.env_steps;
        self.progress.events += 1;
        sink.emit(event).map_err(|source| TrainError::Sink { env_steps, source })
    }

    /// The run's config.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// How far the run is.
    pub fn progress(&self) -> &Progress {
        &self.progress
    }

    /// The policy with the best evaluation, the first of equals; none before the first evaluation.
    pub fn best_policy(&self) -> Option<&Mlp<f32>> {
        self.best_policy.as_ref()
    }

    /// The agent as it is now.
    pub fn agent(&self) -> &Dqn {
        &self.agent
    }
}
