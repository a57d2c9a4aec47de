//! Policies: what an agent has learned, in a form that can be played and saved.

use nalgebra::DMatrix;

use super::QTable;
use crate::nn::{Activations, Mlp};
use crate::rng::Rng;
use crate::tensors::{TensorError, Tensors, weights_sha256};

/// What an agent has learned. The set is closed, so that every place that plays or saves a policy knows all kinds.
#[derive(Clone, Debug, PartialEq)]
pub enum Policy {
    /// A Q-network for observations as the environment gives them.
    Network(Mlp<f32>),
    Table(QTable),
}

impl Policy {
    /// The policy in the tensors without a prefix, whoever wrote them, for a task with these sizes.
    pub fn from_tensors(tensors: &Tensors, inputs: usize, outputs: usize) -> Result<Self, TensorError> {
        if QTable::is_in(tensors) {
            QTable::from_tensors(tensors, inputs, outputs).map(Self::Table)
        } else {
            tensors.network(inputs, outputs).map(Self::Network)
        }
    }

    pub fn save(&self, prefix: &str, tensors: &mut Tensors) {
        match self {
            Self::Network(network) => tensors.put_network(prefix, network),
            Self::Table(table) => table.save(prefix, tensors),
        }
    }

    /// Replaces the policy by the one of the same shape that [`Self::save`] has added with a prefix.
    pub fn load(&mut self, prefix: &str, tensors: &Tensors) -> Result<(), TensorError> {
        match self {
            Self::Network(network) => tensors.get_network(prefix, network),
            Self::Table(table) => table.load(prefix, tensors),
        }
    }

    pub fn greedy(&self, batch: usize) -> Greedy {
        let batch = match self {
            Self::Network(mlp) => BatchedQ::Network(mlp.clone(), Activations::new(mlp.sizes(), batch)),
            Self::Table(table) => BatchedQ::Table(table.clone(), DMatrix::zeros(batch, table.num_actions())),
        };
        Greedy { batch, reward_scale: 1.0 }
    }

    pub fn network(&self) -> Option<&Mlp<f32>> {
        if let Self::Network(network) = self { Some(network) } else { None }
    }

    pub(crate) fn table(&self) -> Option<&QTable> {
        if let Self::Table(table) = self { Some(table) } else { None }
    }

    /// Its kind and size, for messages.
    pub(crate) fn shape(&self) -> String {
        match self {
            Self::Network(network) => format!("layers {:?}", network.sizes()),
            Self::Table(q) => format!("a table of {:?} cells with {} actions", q.bins(), q.num_actions()),
        }
    }

    /// SHA-256 in lower-case hexadecimal over its numbers, see [`weights_sha256`] and [`QTable::sha256`].
    pub fn sha256(&self) -> String {
        match self {
            Self::Network(network) => weights_sha256(network),
            Self::Table(table) => table.sha256(),
        }
    }
}

/// Chooses actions, one observation at a time.
pub trait Actor {
    fn act(&mut self, observation: &[f32]) -> usize;

    /// Estimated returns of all actions in the last observation, in the environment's units; empty if the actor has none.
    fn q_values(&self) -> Vec<f32>;
}

/// A policy that takes the action with the largest Q-value, for a batch of observations at once.
#[derive(Clone, Debug)]
pub struct Greedy {
    batch: BatchedQ,
    reward_scale: f64,
}

/// What gives the Q-values, and the Q-values, (batch, actions).
#[derive(Clone, Debug)]
enum BatchedQ {
    Network(Mlp<f32>, Activations<f32>),
    Table(QTable, DMatrix<f32>),
}

impl Greedy {
    fn q(&self) -> &DMatrix<f32> {
        match &self.batch {
            BatchedQ::Network(_, activations) => activations.output(),
            BatchedQ::Table(_, q) => q,
        }
    }

    /// The same policy of an agent that was trained on rewards times `reward_scale`. It changes no action: only the
    /// Q-values that are shown are divided by the scale, not the weights, whose rounding could decide between two actions.
    #[must_use]
    pub(crate) fn with_reward_scale(self, reward_scale: f64) -> Self {
        Self { reward_scale, ..self }
    }

    pub(crate) fn batch(&self) -> usize {
        self.q().nrows()
    }

    pub fn forward_batch<'a>(&mut self, observations: impl Iterator<Item = &'a [f32]>) {
        match &mut self.batch {
            BatchedQ::Table(table, q) => table.forward(observations, q),
            BatchedQ::Network(network, activations) => {
                activations.set_rows(observations);
                network.forward(activations);
            }
        }
    }

    /// The action with the largest Q-value for one of the observations of the batch, the first of equals.
    pub(crate) fn action(&self, sample: usize) -> usize {
        super::argmax(self.q(), sample)
    }

    /// The Q-value of an action for one of the observations of the batch, in units of the environment's rewards.
    pub fn q_value(&self, sample: usize, action: usize) -> f64 {
        f64::from(self.q()[(sample, action)]) / self.reward_scale
    }
}

impl Actor for Greedy {
    fn act(&mut self, observation: &[f32]) -> usize {
        self.forward_batch(std::iter::once(observation));
        self.action(0)
    }

    fn q_values(&self) -> Vec<f32> {
        (0..self.q().ncols()).map(|action| self.q_value(0, action) as f32).collect()
    }
}

/// The baseline: every action with the same probability.
#[derive(Clone, Debug)]
pub(crate) struct Random {
    pub(crate) num_actions: usize,
    pub(crate) rng: Rng,
}

impl Actor for Random {
    fn act(&mut self, _observation: &[f32]) -> usize {
        self.rng.below(self.num_actions as u64) as usize
    }

    fn q_values(&self) -> Vec<f32> {
        Vec::new()
    }
}
