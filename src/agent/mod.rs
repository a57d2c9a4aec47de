//! Agents: they see observations and rewards, never an environment.

mod dqn;
mod exploration;
mod random;
mod replay;
mod statistics;
mod target;
pub mod td;

use nalgebra::DMatrix;

use crate::nn::{Activations, Mlp};

pub use dqn::{Dqn, DqnConfig, LearnConfig, NotFinite};
pub use exploration::Exploration;
pub use random::Random;
pub use replay::{Minibatch, Replay, ReplayConfig, ReplayContents, Transition, UpdateMode};
pub use statistics::{Probes, Statistics};
pub use target::{PolicyWeights, TargetUpdate};

/// Chooses actions.
pub trait Policy {
    /// The action for one observation.
    fn act(&mut self, observation: &[f32]) -> usize;

    /// The estimated returns of all actions in the observation last acted on, in units of the environment's rewards;
    /// empty if the policy has none.
    fn q_values(&self) -> Vec<f32>;
}

/// A network's greedy policy, for a batch of observations at once.
#[derive(Clone, Debug)]
pub struct Greedy {
    network: Mlp<f32>,
    activations: Activations<f32>,
    reward_scale: f64,
}

impl Greedy {
    /// The greedy policy of a network for up to `batch` observations at once.
    pub fn new(network: Mlp<f32>, batch: usize) -> Self {
        Self { activations: Activations::new(network.sizes(), batch), network, reward_scale: 1.0 }
    }

    /// The same policy of a network that was trained on rewards times `reward_scale`. It changes no action: only the
    /// Q-values that are shown are divided by the scale, not the weights, whose rounding could decide between two actions.
    #[must_use]
    pub fn with_reward_scale(self, reward_scale: f64) -> Self {
        Self { reward_scale, ..self }
    }

    /// How many observations fit.
    pub fn batch(&self) -> usize {
        self.activations.output().nrows()
    }

    /// Computes the Q-values of these observations.
    pub fn see<'a>(&mut self, observations: impl Iterator<Item = &'a [f32]>) {
        let batch = self.batch();
        let input = self.activations.input_mut().as_mut_slice();
        for (sample, observation) in observations.enumerate() {
            for (value, &feature) in input[sample..].iter_mut().step_by(batch).zip(observation) {
                *value = feature;
            }
        }
        self.network.forward(&mut self.activations);
    }

    /// The action with the largest Q-value for one of the observations seen, the first of equals.
    pub fn action(&self, sample: usize) -> usize {
        argmax(self.activations.output(), sample)
    }

    /// The Q-value of an action for one of the observations seen, in units of the environment's rewards.
    pub fn q_value(&self, sample: usize, action: usize) -> f64 {
        f64::from(self.activations.output()[(sample, action)]) / self.reward_scale
    }
}

impl Policy for Greedy {
    fn act(&mut self, observation: &[f32]) -> usize {
        self.see(std::iter::once(observation));
        self.action(0)
    }

    fn q_values(&self) -> Vec<f32> {
        (0..self.activations.output().ncols()).map(|action| self.q_value(0, action) as f32).collect()
    }
}

/// The action with the largest of a sample's Q-values, the first of equals. `q` is (batch, actions).
pub(crate) fn argmax<T: crate::nn::Float>(q: &DMatrix<T>, sample: usize) -> usize {
    let mut best = 0;
    for action in 1..q.ncols() {
        if q[(sample, action)] > q[(sample, best)] {
            best = action;
        }
    }
    best
}
