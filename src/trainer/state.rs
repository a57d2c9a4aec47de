//! Everything that a resumed run needs: the counters, and the way into and out of a checkpoint.

use std::collections::VecDeque;
use std::io;

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};

use super::{Budget, EndReason, Event, Score, Trainer};
use crate::agent::{Dqn, ReplayContents};
use crate::checkpoint::{Checkpoint, Problem, weights_sha256};
use crate::config::Config;
use crate::env::Environment;
use crate::nn::Mlp;
use crate::rng::Rng;

/// How many episodes the running mean return is over.
const RECENT_EPISODES: usize = 100;

/// The mean return of an evaluation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// Environment steps of the run before it.
    pub env_steps: u64,
    /// Mean return.
    pub mean: f64,
}

/// The counters of a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Progress {
    /// Environment steps.
    pub env_steps: u64,
    /// Complete episodes.
    pub episodes: u64,
    /// Gradient steps.
    pub updates: u64,
    /// The best evaluation so far, the latest of equals.
    pub best_evaluation: Option<Evaluation>,
    /// The latest evaluation.
    pub last_evaluation: Option<Evaluation>,
    /// Environment steps before the first evaluation that solved the task.
    pub solved_at_step: Option<u64>,
    /// Environment steps after which a resumed run was given other schedules, the latest time: no single config repeats
    /// it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub branched_at_step: Option<u64>,
    /// Events of the run so far, the lines of its `metrics.jsonl`.
    #[serde(default)]
    pub events: u64,
    /// Mean return of the best evaluation under the run's own time limit.
    #[serde(default)]
    pub(super) best_mean: Option<f64>,
    episode_return: f64,
    episode_length: u64,
    /// Sum and number of the losses in this episode.
    losses: (f64, u64),
    recent_returns: VecDeque<f64>,
}

impl Progress {
    /// Whether these can be the counters of a run, whoever wrote them.
    fn is_possible(&self) -> bool {
        let Self { env_steps, episodes, updates, events, episode_length, losses, .. } = *self;
        let at_most_one_a_step = [episodes, events / 4, episode_length, losses.1];
        env_steps.max(updates) < 1 << 62
            && at_most_one_a_step.iter().all(|&count| count <= env_steps)
            && self.recent_returns.len() <= RECENT_EPISODES
    }

    /// Mean return of the last 100 training episodes, or of as many as there are; none before the first has ended.
    pub fn mean_return_100(&self) -> Option<f64> {
        let count = self.recent_returns.len();
        (count > 0).then(|| self.recent_returns.iter().sum::<f64>() / count as f64)
    }

    /// Whether the run has used a budget up.
    pub(super) fn uses_up(&self, budget: Budget) -> bool {
        match budget {
            Budget::Steps(steps) => self.env_steps >= steps,
            Budget::Episodes(episodes) => self.episodes >= episodes,
        }
    }

    /// Whether the run is already past this budget.
    fn exceeds(&self, budget: Budget) -> bool {
        match budget {
            Budget::Steps(steps) => self.env_steps > steps,
            Budget::Episodes(episodes) => {
                self.episodes > episodes || (self.episodes == episodes && self.episode_length > 0)
            }
        }
    }

    pub(super) fn count_step(&mut self, reward: f32) {
        self.env_steps += 1;
        self.episode_length += 1;
        self.episode_return += f64::from(reward);
    }

    pub(super) fn count_learning(&mut self, loss: f32, updates: u64) {
        self.updates = updates;
        self.losses = (self.losses.0 + f64::from(loss), self.losses.1 + 1);
    }

    pub(super) fn end_episode(&mut self, epsilon: f64) -> Event {
        if self.recent_returns.len() == RECENT_EPISODES {
            self.recent_returns.pop_front();
        }
        self.recent_returns.push_back(self.episode_return);
        let (loss_sum, loss_count) = std::mem::take(&mut self.losses);
        let event = Event::Episode {
            env_steps: self.env_steps,
            episode: self.episodes,
            return_: std::mem::take(&mut self.episode_return),
            length: std::mem::take(&mut self.episode_length),
            mean_return_100: self.recent_returns.iter().sum::<f64>() / self.recent_returns.len() as f64,
            epsilon,
            loss: (loss_count > 0).then(|| loss_sum / loss_count as f64),
            updates: self.updates,
        };
        self.episodes += 1;
        event
    }

    pub(super) fn count_evaluation(&mut self, score: &Score, mean_under_limit: f64, threshold: f64) -> Event {
        let evaluation = Evaluation { env_steps: self.env_steps, mean: score.mean };
        // The latest of equals: at the time limit the first policy with a full score is the least trained one.
        let best = self.best_mean.is_none_or(|best| mean_under_limit >= best);
        let solved = score.mean >= threshold;
        self.last_evaluation = Some(evaluation);
        if best {
            self.best_evaluation = Some(evaluation);
            self.best_mean = Some(mean_under_limit);
        }
        if solved && self.solved_at_step.is_none() {
            self.solved_at_step = Some(self.env_steps);
        }
        Event::Evaluation {
            env_steps: self.env_steps,
            episodes: score.episodes,
            mean: score.mean,
            mean_under_limit: Some(mean_under_limit).filter(|&mean| mean != score.mean),
            std: score.std,
            min: score.min,
            max: score.max,
            best,
            solved,
        }
    }
}

/// What a checkpoint says of itself; `S` is the [`State`] of the run, in `last.safetensors` only.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Header<S = serde::de::IgnoredAny> {
    /// Environment steps of the run so far.
    pub env_steps: u64,
    /// The latest evaluation; in `best.safetensors` that of the policy itself.
    pub evaluation: Option<Evaluation>,
    /// The run's resolved config.
    #[serde(deserialize_with = "config_of_any_version")]
    pub config: Config,
    /// What a resumed run needs besides the tensors.
    #[serde(default = "Option::default", skip_serializing_if = "Option::is_none")]
    pub state: Option<S>,
}

/// A config with defaults for the keys that there were not yet when it was written.
fn config_of_any_version<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Config, D::Error> {
    let text = serde_json::Value::deserialize(deserializer)?.to_string();
    Config::from_layers(Some(("config", &text)), &[]).map_err(D::Error::custom)
}

/// What a resumed run needs besides the tensors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct State<E, O> {
    progress: Progress,
    environment: E,
    observation: O,
    environment_rng: Rng,
    explore_rng: Rng,
    replay_rng: Rng,
    epsilon: f64,
}

impl<E: Environment> Trainer<E> {
    /// The policy with the best evaluation, alone; none before the first evaluation.
    ///
    /// # Errors
    /// See [`Checkpoint::new`].
    pub fn best_checkpoint(&self) -> io::Result<Option<Checkpoint>> {
        let (Some(policy), Some(evaluation)) = (&self.best_policy, self.progress.best_evaluation) else {
            return Ok(None);
        };
        let mut checkpoint = Checkpoint::new(&Header::<()> {
            env_steps: evaluation.env_steps,
            evaluation: Some(evaluation),
            config: self.config.clone(),
            state: None,
        })?;
        checkpoint.put_network("", policy);
        Ok(Some(checkpoint))
    }

    /// Everything that [`Self::resume`] needs.
    ///
    /// # Errors
    /// See [`Checkpoint::new`].
    pub fn checkpoint(&self) -> io::Result<Checkpoint> {
        let Dqn { online, target, adam, replay, epsilon, explore_rng, replay_rng, .. } = &self.agent;
        let mut checkpoint = Checkpoint::new(&Header {
            env_steps: self.progress.env_steps,
            evaluation: self.progress.last_evaluation,
            config: self.config.clone(),
            state: Some(State {
                progress: self.progress.clone(),
                environment: self.environment.clone(),
                observation: self.observation.clone(),
                environment_rng: self.environment_rng.clone(),
                explore_rng: explore_rng.clone(),
                replay_rng: replay_rng.clone(),
                epsilon: *epsilon,
            }),
        })?;
        checkpoint.put_network("", &self.agent.policy());
        checkpoint.put_network("online.", online);
        checkpoint.put_network("target.", target);
        if let Some(policy) = &self.best_policy {
            checkpoint.put_network("best.", policy);
        }
        checkpoint.put("adam.first_moment", &[adam.first_moment.len()], &adam.first_moment);
        checkpoint.put("adam.second_moment", &[adam.second_moment.len()], &adam.second_moment);
        let size = E::OBSERVATION_SIZE;
        let contents = replay.contents();
        let (len, nexts) = (contents.actions.len(), contents.next_observations.len() / size);
        checkpoint.put("replay.observations", &[len, size], &contents.observations);
        checkpoint.put("replay.actions", &[len], &contents.actions);
        checkpoint.put("replay.rewards", &[len], &contents.rewards);
        checkpoint.put("replay.ends", &[len], &contents.ends);
        checkpoint.put("replay.next_observations", &[nexts, size], &contents.next_observations);
        Ok(checkpoint)
    }

    /// The run that [`Self::checkpoint`] was taken of, to be continued with the same bits. `environment` gives
    /// the kind of the environment; its state comes from the checkpoint.
    ///
    /// # Errors
    /// When the checkpoint does not hold the state of such a run.
    pub fn resume(checkpoint: &Checkpoint, environment: E) -> Result<Self, Problem> {
        let header: Header<State<E, E::Observation>> = checkpoint.header()?;
        let state = header.state.ok_or(Problem::NotResumable)?;
        let env_steps = state.progress.env_steps;
        if !state.progress.is_possible() || !environment.admits(&state.environment) {
            return Err(Problem::State);
        }
        header.config.check_memory(1).map_err(Problem::Memory)?;
        let mut trainer = Self::new(header.config, environment);
        trainer.saved_at = Some(env_steps);
        if checkpoint.shape("best.0.weight").is_ok() {
            let mut policy = Mlp::zeros(trainer.agent.online.sizes().to_vec());
            checkpoint.get_network("best.", &mut policy)?;
            trainer.best_policy = Some(policy);
        }
        let agent = &mut trainer.agent;
        agent.adam.learning_rate = trainer.config.optimizer.learning_rate_after(env_steps);
        checkpoint.get_network("online.", &mut agent.online)?;
        checkpoint.get_network("target.", &mut agent.target)?;
        let parameters = agent.online.parameters().len();
        agent.adam.steps = state.progress.updates;
        agent.adam.first_moment = checkpoint.get("adam.first_moment", &[parameters])?;
        agent.adam.second_moment = checkpoint.get("adam.second_moment", &[parameters])?;
        let len = checkpoint.shape("replay.actions")?.iter().product();
        let nexts = checkpoint.shape("replay.next_observations")?.first().copied().unwrap_or(0);
        let contents = ReplayContents {
            observations: checkpoint.get("replay.observations", &[len, E::OBSERVATION_SIZE])?,
            actions: checkpoint.get("replay.actions", &[len])?,
            rewards: checkpoint.get("replay.rewards", &[len])?,
            ends: checkpoint.get("replay.ends", &[len])?,
            next_observations: checkpoint.get("replay.next_observations", &[nexts, E::OBSERVATION_SIZE])?,
        };
        if !agent.replay.restore(&contents, E::NUM_ACTIONS) {
            return Err(Problem::Replay);
        }
        agent.explore_rng = state.explore_rng;
        agent.replay_rng = state.replay_rng;
        agent.epsilon = state.epsilon;
        trainer.environment = state.environment;
        trainer.observation = state.observation;
        trainer.environment_rng = state.environment_rng;
        trainer.progress = state.progress;
        Ok(trainer)
    }

    /// Gives the run another budget: every schedule counts steps from the start, so that nothing else changes. False,
    /// and no change, if a run of that budget would have ended already.
    #[must_use]
    pub fn set_budget(&mut self, budget: Budget) -> bool {
        let possible = !self.progress.exceeds(budget);
        if possible {
            self.config.budget = budget;
        }
        possible
    }
}

impl<E: Environment> Trainer<E> {
    /// Gives the run the schedules of ε and of the learning rate of another config, and that learning rate, from its
    /// next step on. True if they are other ones and the run has begun: it is then a branch.
    pub fn set_schedules(&mut self, config: &Config) -> bool {
        let old = (self.config.optimizer, self.config.exploration);
        self.config.optimizer.schedule = config.optimizer.schedule;
        self.config.optimizer.learning_rate = config.optimizer.learning_rate;
        self.config.exploration = config.exploration;
        let env_steps = self.progress.env_steps;
        if old == (self.config.optimizer, self.config.exploration) {
            return false;
        }
        self.agent.set_schedules(&self.config.dqn(), env_steps);
        self.progress.branched_at_step = (env_steps > 0).then_some(env_steps);
        env_steps > 0
    }
}

/// What a run came to.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// The run's seed.
    pub seed: u64,
    /// Environment steps.
    pub env_steps: u64,
    /// Complete training episodes.
    pub episodes: u64,
    /// Gradient steps.
    pub updates: u64,
    /// Why it ended.
    pub end_reason: EndReason,
    /// The best evaluation, the latest of equals: that of `best.safetensors`.
    pub best_evaluation: Option<Evaluation>,
    /// The evaluation at the end.
    pub final_evaluation: Option<Evaluation>,
    /// Environment steps before the first evaluation that solved the task.
    pub solved_at_step: Option<u64>,
    /// SHA-256 over the online network's parameters, see [`weights_sha256`].
    pub weights_sha256: String,
    /// Environment steps after which a resumed run was given other schedules.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub branched_at_step: Option<u64>,
    /// Duration of the training in seconds.
    pub wall_seconds: f64,
}

impl<E: Environment> Trainer<E> {
    /// What the run came to.
    pub fn summary(&self, end_reason: EndReason, wall_seconds: f64) -> Summary {
        let Progress {
            env_steps,
            episodes,
            updates,
            best_evaluation,
            last_evaluation,
            solved_at_step,
            branched_at_step,
            ..
        } = self.progress;
        Summary {
            seed: self.config.seed,
            env_steps,
            episodes,
            updates,
            end_reason,
            best_evaluation,
            final_evaluation: last_evaluation,
            solved_at_step,
            weights_sha256: weights_sha256(&self.agent.online),
            branched_at_step,
            wall_seconds,
        }
    }
}
