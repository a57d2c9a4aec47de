//! The counters of a run, and its summary.

use serde::{Deserialize, Serialize};

use super::{Budget, EndReason, Event, Score};

const RECENT_EPISODES: usize = 100;

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// Environment steps of the run before it.
    pub env_steps: u64,
    pub mean: f64,
}

/// The counters of a run: environment steps, complete episodes, gradient steps.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Progress {
    pub env_steps: u64,
    pub episodes: u64,
    pub updates: u64,
    /// Environment steps that evaluations played.
    #[serde(default)]
    pub evaluation_steps: u64,
    /// Environment steps that the tests of `stop_when_lasting_steps` played.
    #[serde(default)]
    pub lasting_test_steps: u64,
    /// The best evaluation so far, the latest of equals.
    pub best_evaluation: Option<Evaluation>,
    pub last_evaluation: Option<Evaluation>,
    /// Environment steps before the first evaluation that solved the task.
    pub solved_at_step: Option<u64>,
    /// Environment steps before the first evaluation whose policy lasts, where the run looks for one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) lasting_at_step: Option<u64>,
    /// Environment steps after which a resumed run was given other schedules, the latest time: no single config repeats it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) branched_at_step: Option<u64>,
    /// Events of the run so far, the lines of its `metrics.jsonl`.
    #[serde(default)]
    pub(crate) events: u64,
    episode_return: f64,
    pub(super) episode_length: u64,
    /// Sum and number of the losses in this episode.
    losses: (f64, u64),
    recent_returns: std::collections::VecDeque<f64>,
}

impl Progress {
    /// Whether these can be the counters of a run, whoever wrote them.
    pub(super) fn is_possible(&self) -> bool {
        let Self { env_steps, episodes, updates, events, episode_length, losses, .. } = *self;
        let at_most_one_a_step = [episodes, events / 4, episode_length, losses.1];
        env_steps.max(updates) < 1 << 62
            && self.evaluation_steps.max(self.lasting_test_steps) < 1 << 62
            && at_most_one_a_step.iter().all(|&count| count <= env_steps)
            && self.recent_returns.len() <= RECENT_EPISODES
    }

    /// Mean return of the last 100 training episodes, or of as many as there are; none before the first has ended.
    pub(crate) fn mean_return_100(&self) -> Option<f64> {
        let count = self.recent_returns.len();
        (count > 0).then(|| self.recent_returns.iter().sum::<f64>() / count as f64)
    }

    pub(super) fn uses_up(&self, budget: Budget) -> bool {
        match budget {
            Budget::Steps(steps) => self.env_steps >= steps,
            Budget::Episodes(episodes) => self.episodes >= episodes,
        }
    }

    pub(super) fn exceeds(&self, budget: Budget) -> bool {
        match budget {
            Budget::Steps(steps) => self.env_steps > steps,
            Budget::Episodes(episodes) => {
                self.episodes > episodes || (self.episodes == episodes && self.episode_length > 0)
            }
        }
    }

    pub(super) fn count_step(&mut self, reward: f64) {
        self.env_steps += 1;
        self.episode_length += 1;
        self.episode_return += reward;
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

    /// Counts an evaluation. The best one is the latest of equals: at the time limit the first policy with a full score is
    /// the least trained one.
    pub(super) fn count_evaluation(&mut self, score: &Score, mean_length: f64, solved: bool) -> Event {
        let Score { episodes, mean, std, min, max, .. } = *score;
        let evaluation = Evaluation { env_steps: self.env_steps, mean };
        let best = self.best_evaluation.is_none_or(|best| mean >= best.mean);
        self.last_evaluation = Some(evaluation);
        if best {
            self.best_evaluation = Some(evaluation);
        }
        if solved && self.solved_at_step.is_none() {
            self.solved_at_step = Some(self.env_steps);
        }
        let env_steps = self.env_steps;
        Event::Evaluation { env_steps, episodes, mean, std, min, max, mean_length, best, solved }
    }
}

/// The summary of a run. Its counts and evaluations are those of [`Progress`] at the end.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    pub seed: u64,
    pub env_steps: u64,
    pub episodes: u64,
    pub updates: u64,
    /// What was played without learning, to choose a policy: see [`Progress`].
    #[serde(default)]
    pub evaluation_steps: u64,
    #[serde(default)]
    pub lasting_test_steps: u64,
    pub(crate) end_reason: EndReason,
    /// The best evaluation, the latest of equals. `best.safetensors` holds its policy.
    pub best_evaluation: Option<Evaluation>,
    pub(crate) final_evaluation: Option<Evaluation>,
    pub solved_at_step: Option<u64>,
    /// SHA-256 over the online network's parameters, see `tensors::weights_sha256`.
    pub weights_sha256: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) branched_at_step: Option<u64>,
    pub(crate) wall_seconds: f64,
}
