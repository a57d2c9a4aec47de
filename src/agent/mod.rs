//! Agents: they see observations and rewards, never an environment.

mod dqn;
mod exploration;
mod policy;
mod q_learning;
mod q_network;
mod q_table;
mod replay;
mod statistics;
mod target;
pub mod td;

use std::any::Any;

use crate::tensors::{TensorError, Tensors};

pub(crate) use dqn::LearnConfig;
pub use dqn::{Dqn, DqnConfig};
pub(crate) use exploration::EpsilonGreedy;
pub use exploration::Exploration;
pub(crate) use policy::Random;
pub use policy::{Actor, Greedy, Policy};
pub(crate) use q_learning::TableConfig;
pub use q_learning::{Bins, QLearning, QTableConfig};
pub(crate) use q_network::QNetwork;
pub use q_table::QTable;
pub use replay::{Minibatch, Replay, ReplayContents, Transition};
pub(crate) use replay::{ReplayConfig, UpdateMode};
pub(crate) use statistics::Statistic;
pub use statistics::{NamedNumbers, Played, Probes, STATISTICS};
pub(crate) use target::PolicyWeights;
pub use target::{Period, TargetUpdate};

/// Which agent learns, and its settings. Each is a key of the config.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(tag = "agent", rename_all = "snake_case")]
pub enum AgentConfig {
    Dqn(DqnConfig),
    QTable(QTableConfig),
}

impl AgentConfig {
    /// The agent for a task of these sizes and with this mirror image, its streams spawned from `seed`.
    pub fn make(
        &self, observation_size: usize, num_actions: usize, mirror: Option<&crate::mirror::Mirror>, seed: u64,
    ) -> Box<dyn Agent> {
        match self.clone() {
            Self::Dqn(config) => Box::new(Dqn::new(config, observation_size, num_actions, mirror, seed)),
            Self::QTable(config) => Box::new(QLearning::new(config, num_actions, mirror, seed)),
        }
    }

    pub fn as_dqn(&self) -> Option<&DqnConfig> {
        if let Self::Dqn(config) = self { Some(config) } else { None }
    }

    pub fn learning_rate(&self) -> crate::nn::LearningRate {
        match self {
            Self::Dqn(config) => config.optimizer.learning_rate(),
            Self::QTable(config) => config.optimizer,
        }
    }

    pub fn exploration(&self) -> Exploration {
        match self {
            Self::Dqn(config) => config.exploration,
            Self::QTable(config) => config.exploration,
        }
    }

    /// What rewards are multiplied by before the agent learns from them.
    pub(crate) fn reward_scale(&self) -> f64 {
        self.as_dqn().map_or(1.0, |config| config.reward_scale)
    }
}

/// What learns. The trainer knows no more of it than this.
pub trait Agent: Any + Send {
    /// The action for an observation, exploration included.
    fn act(&mut self, observation: &[f32]) -> usize;

    fn observe(&mut self, transition: Transition<'_>);

    /// Learns if due after step `env_steps`, and follows the schedules of steps. Returns the mean loss if it has learned.
    fn learn_if_due(&mut self, env_steps: u64) -> Result<Option<f32>, NotFinite>;

    /// Follows the schedules that count episodes, after episode `episode`, counted from 0.
    fn end_episode(&mut self, episode: u64);

    /// What is evaluated and saved: the greedy policy, for observations as the environment gives them.
    fn policy(&self) -> Policy;

    /// Begins with this policy. False if it has another shape, or a number leaves the finite under the agent's settings.
    #[must_use]
    fn start_from(&mut self, policy: &Policy) -> bool;

    fn gamma(&self) -> f64;

    fn counters(&self) -> Counters;

    /// Numbers of [`STATISTICS`]; none before anything was observed. `played` are the episodes of the latest evaluation.
    fn statistics(&self, probes: &Probes, played: &[Played]) -> Option<NamedNumbers>;

    /// SHA-256 in lower-case hexadecimal over what has been learned.
    fn weights_sha256(&self) -> String;

    /// Adds everything that a resumed run needs.
    fn save(&self, tensors: &mut Tensors);

    /// The inverse of [`Self::save`], after `env_steps` environment steps. Schedules are the agent's, not those saved.
    fn load(&mut self, tensors: &Tensors, env_steps: u64) -> Result<(), TensorError>;
}

impl dyn Agent {
    pub fn as_dqn(&self) -> Option<&Dqn> {
        (self as &dyn Any).downcast_ref()
    }
}

/// How far learning is, for progress and metrics.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Counters {
    pub updates: u64,
    pub epsilon: f64,
    pub learning_rate: f64,
}

/// A loss, a gradient or a weight became NaN or infinite.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NotFinite {
    #[error("the loss")]
    Loss,
    /// The gradient of a minibatch. Adam's step makes a weight of it that is not finite either.
    #[error("the gradient")]
    Gradient,
    /// A weight after Adam's step.
    #[error("a weight")]
    Weight,
}

/// The action with the largest of a sample's Q-values, the first of equals. `q` is (batch, actions).
pub(crate) fn argmax<T: crate::nn::Float>(q: &nalgebra::DMatrix<T>, sample: usize) -> usize {
    let (mut best, mut largest) = (0, q[(sample, 0)]);
    for action in 1..q.ncols() {
        let value = q[(sample, action)];
        (best, largest) = if value > largest { (action, value) } else { (best, largest) };
    }
    best
}
