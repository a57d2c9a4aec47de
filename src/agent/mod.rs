//! Agents: they see observations and rewards, never an environment.

mod dqn;
mod exploration;
mod random;
mod replay;
pub mod td;

use nalgebra::DMatrix;

use crate::nn::{Activations, Mlp};

pub use dqn::{Dqn, DqnConfig, LearnConfig, NotFinite, TargetUpdate};
pub use exploration::Exploration;
pub use random::Random;
pub use replay::{Minibatch, Replay, ReplayConfig, ReplayContents, Transition, UpdateMode};

/// Chooses actions.
pub trait Policy {
    /// The action for one observation.
    fn act(&mut self, observation: &[f32]) -> usize;

    /// The estimated returns of all actions in the observation last acted on; empty if the policy has none.
    fn q_values(&self) -> &[f32];
}

/// The action with the largest Q-value, the first of equals.
#[derive(Clone, Debug)]
pub struct Greedy {
    network: Mlp<f32>,
    activations: Activations<f32>,
}

impl Greedy {
    /// The greedy policy of a network.
    pub fn new(network: Mlp<f32>) -> Self {
        Self { activations: Activations::new(network.sizes(), 1), network }
    }

    /// The network.
    pub fn network(&self) -> &Mlp<f32> {
        &self.network
    }
}

impl Policy for Greedy {
    fn act(&mut self, observation: &[f32]) -> usize {
        self.activations.input_mut().copy_from_slice(observation);
        self.network.forward(&mut self.activations);
        argmax(self.activations.output(), 0)
    }

    fn q_values(&self) -> &[f32] {
        self.activations.output().as_slice()
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
