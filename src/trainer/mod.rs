//! The training loop. It drives an agent through an environment and tells an observer. It never prints, and it knows no
//! paths.

mod episode;
mod evaluate;
mod event;
mod observer;
mod progress;
mod settings;

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::agent::{Agent, NotFinite, Policy, Probes, Transition};
use crate::env::{Answer, EnvironmentError, Make, Spec};
use crate::tensors::{TensorError, Tensors};
use episode::TrainingEpisode;

pub(crate) use evaluate::{Frame, Recording, play};
pub use evaluate::{LASTING_EPISODES, LASTING_EPSILON, Score, evaluate, lasts, record};
pub use event::{EndReason, Event};
pub(crate) use observer::Fanout;
pub use observer::{CheckpointKind, DueCheckpoint, Observer};
pub use progress::Evaluation;
pub(crate) use progress::{Progress, Summary};
pub use settings::Budget;
pub(crate) use settings::{CheckpointConfig, EvaluationConfig, TrainerConfig};

/// Gymnasium seed of the first evaluation episode; the others follow. Training never resets from a seed.
pub const EVALUATION_SEED: u64 = 1_000_000;
/// Gymnasium seed of the first episode that scores a policy: not those that chose the best.
pub const SCORE_SEED: u64 = 2_000_000;

#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    #[error("training diverged: at environment step {env_steps} {what} became NaN or infinite")]
    Diverged { env_steps: u64, what: NotFinite },
    /// An observer cannot keep a checkpoint; the source names the file.
    #[error(transparent)]
    Checkpoint(io::Error),
    #[error("cannot write an event at environment step {env_steps}: {source}")]
    Event { env_steps: u64, source: io::Error },
    #[error(transparent)]
    Environment(#[from] EnvironmentError),
}

#[derive(Debug, thiserror::Error)]
pub enum ResumeError {
    #[error(transparent)]
    Tensor(#[from] TensorError),
    #[error(transparent)]
    Environment(#[from] EnvironmentError),
    #[error("its counters are inconsistent")]
    Progress,
    #[error(
        "its episode, played again, does not lead to the observation in it: the environment is not deterministic, or is \
         another one than that of the run"
    )]
    NotDeterministic,
}

/// What a checkpoint holds. The checkpoint of the best policy has no progress.
#[derive(Clone, Debug)]
pub struct Snapshot {
    /// Environment steps of the run so far; for the best policy those before it.
    pub env_steps: u64,
    /// The latest evaluation; for the best policy its own.
    pub evaluation: Option<Evaluation>,
    pub progress: Option<Progress>,
    /// The policy in the tensors without a prefix, and what [`Trainer::resume`] needs.
    pub tensors: Tensors,
}

pub struct Trainer {
    config: TrainerConfig,
    spec: Spec,
    make: Arc<Make>,
    episode: TrainingEpisode,
    agent: Box<dyn Agent>,
    progress: Progress,
    best_policy: Option<Policy>,
    /// Whether an observer has saved it.
    best_is_saved: bool,
    saved_at: Option<u64>,
    probes: Option<Probes>,
}

impl Trainer {
    /// A run before its first step, with the agent that `make_agent` makes for the task.
    pub fn new(
        config: TrainerConfig, make_agent: impl FnOnce(&Spec) -> Box<dyn Agent>, make: Arc<Make>,
    ) -> Answer<Self> {
        let environment = make(config.max_episode_steps)?;
        let spec = environment.spec().clone();
        let agent = make_agent(&spec);
        Ok(Self {
            spec,
            episode: TrainingEpisode::first(environment, config.seed)?,
            config,
            make,
            agent,
            progress: Progress::default(),
            best_policy: None,
            best_is_saved: true,
            saved_at: None,
            probes: None,
        })
    }

    /// Trains until the budget is used up, or until an evaluation is good enough if that is to end the run.
    ///
    /// When `stop` is set, the run finishes the current step, offers a last checkpoint and returns
    /// [`EndReason::Interrupted`]. It neither evaluates nor emits an event, so a resumed run repeats nothing. For the same
    /// reason the last checkpoint is offered *before* the final evaluation: a run with a larger budget would not evaluate at
    /// that step.
    ///
    /// # Errors
    /// When the numbers leave the finite, the environment fails, or an observer does. What observers kept before stays.
    pub fn run(&mut self, observer: &mut dyn Observer, stop: &AtomicBool) -> Result<EndReason, TrainError> {
        let reason = loop {
            match self.end_reason() {
                Some(reason) => break reason,
                None if stop.load(Ordering::Relaxed) => {
                    self.save_last(observer)?;
                    return Ok(EndReason::Interrupted);
                }
                None => self.step(observer)?,
            }
        };
        self.save_last(observer)?;
        if self.progress.last_evaluation.is_none_or(|last| last.env_steps < self.progress.env_steps) {
            self.evaluate(observer)?;
            self.save_best(observer)?;
        }
        let Progress { env_steps, episodes, updates, .. } = self.progress;
        self.emit(observer, &Event::End { env_steps, episodes, updates, reason })?;
        Ok(reason)
    }

    /// One environment step and everything that is due after it.
    pub fn step(&mut self, observer: &mut dyn Observer) -> Result<(), TrainError> {
        let action = self.episode.action(|observation| self.agent.act(observation));
        let outcome = match self.episode.step(action) {
            Ok(outcome) => outcome,
            Err(error) => {
                self.save_last(observer)?;
                return Err(error.into());
            }
        };
        self.agent.observe(Transition {
            observation: &self.episode.observation,
            action,
            reward: outcome.reward as f32,
            next_observation: &self.episode.next_observation,
            terminated: outcome.terminated,
            truncated: outcome.truncated,
        });
        self.episode.advance();
        self.progress.count_step(outcome.reward);
        let env_steps = self.progress.env_steps;

        let learned = self.agent.learn_if_due(env_steps);
        if let Some(loss) = learned.map_err(|what| TrainError::Diverged { env_steps, what })? {
            self.progress.count_learning(loss, self.agent.counters().updates);
        }
        if outcome.ended() {
            self.end_episode(observer)?;
        }
        if env_steps.is_multiple_of(self.config.evaluation.every_steps) {
            self.evaluate(observer)?;
        }
        if env_steps.is_multiple_of(self.config.checkpoint.every_steps) {
            self.save_last(observer)?;
        }
        Ok(())
    }

    fn end_episode(&mut self, observer: &mut dyn Observer) -> Result<(), TrainError> {
        self.agent.end_episode(self.progress.episodes);
        let event = self.progress.end_episode(self.agent.counters().epsilon);
        self.episode.reset()?;
        self.emit(observer, &event)
    }

    /// Plays the greedy policy, and keeps it as the best if none before is better.
    fn evaluate(&mut self, observer: &mut dyn Observer) -> Result<(), TrainError> {
        let (episodes, gamma) = (self.config.evaluation.episodes, self.agent.gamma());
        let policy = self.agent.policy();
        observer.policy(&policy);
        let played = evaluate(&policy, &*self.make, self.spec.max_steps, EVALUATION_SEED, episodes, gamma)?;
        let score = Score::new(&played.iter().map(|episode| episode.total).collect::<Vec<_>>());
        let is_better = self.progress.best_evaluation.is_none_or(|best| score.mean > best.mean);
        let mean_length = played.iter().map(|one| one.steps as f64).sum::<f64>() / played.len() as f64;
        self.progress.evaluation_steps += played.iter().map(|one| one.steps).sum::<u64>();
        let solved = self.spec.is_solved_by(score.mean);
        if solved && self.ends_with(&policy)? {
            self.progress.lasting_at_step = Some(self.progress.env_steps);
        }
        let event = self.progress.count_evaluation(&score, mean_length, solved);
        if let Event::Evaluation { best: true, .. } = event {
            self.best_policy = Some(policy);
            self.best_is_saved = false;
            // Among equals the file may wait for the next checkpoint: the policy in it scores the same.
            if is_better {
                self.save_best(observer)?;
            }
        }
        self.emit(observer, &event)?;
        if self.probes.is_none() {
            self.probes = Some(evaluate::probes(&*self.make, self.spec.max_steps)?);
        }
        let numbers = self.probes.as_ref().and_then(|probes| self.agent.statistics(probes, &played));
        let env_steps = self.progress.env_steps;
        numbers.map_or(Ok(()), |numbers| self.emit(observer, &Event::Statistics { env_steps, numbers }))
    }

    /// Whether a policy that solves the task is to end the run: the one evaluated before it solved the task too, and this one
    /// lasts. A last evaluation at a step at which a longer run would have none does not count.
    fn ends_with(&mut self, policy: &Policy) -> Answer<bool> {
        let Progress { env_steps, last_evaluation, .. } = self.progress;
        let is_due = env_steps.is_multiple_of(self.config.evaluation.every_steps);
        let was_solved = last_evaluation.is_some_and(|last| self.spec.is_solved_by(last.mean));
        match self.config.stop_when_lasting_steps {
            Some(steps) if is_due && was_solved => {
                let (lasts, played) = lasts(policy, &*self.make, steps)?;
                self.progress.lasting_test_steps += played;
                Ok(lasts)
            }
            _ => Ok(false),
        }
    }

    /// Offers the best policy to the observer, unless the observer has it.
    pub fn save_best(&mut self, observer: &mut dyn Observer) -> Result<(), TrainError> {
        if !self.best_is_saved
            && let (Some(policy), Some(evaluation)) = (&self.best_policy, self.progress.best_evaluation)
        {
            let snapshot = || {
                let (env_steps, mut tensors) = (evaluation.env_steps, Tensors::default());
                policy.save("", &mut tensors);
                Snapshot { env_steps, evaluation: Some(evaluation), progress: None, tensors }
            };
            let checkpoint = DueCheckpoint { kind: CheckpointKind::Best, snapshot: &snapshot };
            observer.checkpoint(&checkpoint).map_err(TrainError::Checkpoint)?;
        }
        self.best_is_saved = true;
        Ok(())
    }

    /// Offers a checkpoint of the run to the observer, unless there was one at this step.
    pub(crate) fn save_last(&mut self, observer: &mut dyn Observer) -> Result<(), TrainError> {
        self.save_best(observer)?;
        let (env_steps, period) = (self.progress.env_steps, self.config.checkpoint.every_steps);
        if self.saved_at == Some(env_steps) {
            return Ok(());
        }
        let keeps_previous = self.saved_at.is_some_and(|step| step > 0 && step.is_multiple_of(period));
        let kind = CheckpointKind::Last { keeps_previous };
        let checkpoint = DueCheckpoint { kind, snapshot: &|| self.snapshot() };
        observer.checkpoint(&checkpoint).map_err(TrainError::Checkpoint)?;
        self.saved_at = Some(env_steps);
        Ok(())
    }

    /// Everything that [`Self::resume`] needs.
    pub fn snapshot(&self) -> Snapshot {
        let mut tensors = Tensors::default();
        self.agent.policy().save("", &mut tensors);
        self.agent.save(&mut tensors);
        self.episode.save(&mut tensors);
        if let Some(policy) = &self.best_policy {
            policy.save("best.", &mut tensors);
        }
        Snapshot {
            env_steps: self.progress.env_steps,
            evaluation: self.progress.last_evaluation,
            progress: Some(self.progress.clone()),
            tensors,
        }
    }

    /// Takes a run before its first step to where another one was, with the same bits from there on. Schedules and budget
    /// are those of this run.
    pub fn resume(mut self, progress: Progress, tensors: &Tensors) -> Result<Self, ResumeError> {
        if !progress.is_possible() {
            return Err(ResumeError::Progress);
        }
        self.agent.load(tensors, progress.env_steps)?;
        if self.agent.counters().updates != progress.updates {
            return Err(ResumeError::Progress);
        }
        self.episode.load(tensors, progress.episode_length)?;
        if progress.best_evaluation.is_some() {
            let mut best = self.agent.policy();
            best.load("best.", tensors)?;
            self.best_policy = Some(best);
        }
        self.best_is_saved = false;
        self.saved_at = Some(progress.env_steps);
        self.progress = progress;
        if self.config.stop_when_lasting_steps.is_none() {
            // From here on the run is one that never tested. The next checkpoint must not keep one that says otherwise.
            let played = std::mem::take(&mut self.progress.lasting_test_steps);
            if self.progress.lasting_at_step.take().is_some() || played > 0 {
                self.saved_at = None;
            }
        }
        Ok(self)
    }

    /// Records that from here on the run follows other schedules, so that no single config repeats it.
    pub(crate) fn branch(&mut self) {
        self.progress.branched_at_step = Some(self.progress.env_steps);
    }

    pub(crate) fn is_past_budget(&self) -> bool {
        self.progress.exceeds(self.config.budget)
    }

    pub fn end_reason(&self) -> Option<EndReason> {
        let TrainerConfig { budget, stop_when_solved, stop_when_lasting_steps, .. } = self.config;
        if stop_when_solved && self.progress.solved_at_step.is_some() {
            return Some(EndReason::Solved);
        }
        if stop_when_lasting_steps.is_some() && self.progress.lasting_at_step.is_some() {
            return Some(EndReason::Lasting);
        }
        self.progress.uses_up(budget).then_some(EndReason::Budget)
    }

    fn emit(&mut self, observer: &mut dyn Observer, event: &Event) -> Result<(), TrainError> {
        let env_steps = self.progress.env_steps;
        self.progress.events += 1;
        observer.event(event).map_err(|source| TrainError::Event { env_steps, source })
    }

    pub fn config(&self) -> &TrainerConfig {
        &self.config
    }

    pub fn spec(&self) -> &Spec {
        &self.spec
    }

    pub fn progress(&self) -> &Progress {
        &self.progress
    }

    /// The policy with the best evaluation, the latest of equals; none before the first evaluation.
    pub fn best_policy(&self) -> Option<&Policy> {
        self.best_policy.as_ref()
    }

    pub fn agent(&self) -> &dyn Agent {
        &*self.agent
    }

    pub(crate) fn agent_mut(&mut self) -> &mut dyn Agent {
        &mut *self.agent
    }

    pub fn summary(&self, end_reason: EndReason, wall_seconds: f64) -> Summary {
        let Progress { env_steps, episodes, updates, solved_at_step, branched_at_step, .. } = self.progress;
        let Progress { evaluation_steps, lasting_test_steps, .. } = self.progress;
        Summary {
            seed: self.config.seed,
            env_steps,
            episodes,
            updates,
            evaluation_steps,
            lasting_test_steps,
            end_reason,
            best_evaluation: self.progress.best_evaluation,
            final_evaluation: self.progress.last_evaluation,
            solved_at_step,
            weights_sha256: self.agent.weights_sha256(),
            branched_at_step,
            wall_seconds,
        }
    }
}
