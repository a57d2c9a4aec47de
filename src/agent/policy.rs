//! Policies: what an agent has learned, in a form that can be played and saved.

use crate::nn::{Activations, Mlp};
use crate::tensors::{TensorError, Tensors, weights_sha256};

/// What an agent has learned. The set is closed, so that every place that plays or saves a policy knows all kinds.
#[derive(Clone, Debug, PartialEq)]
pub enum Policy {
    /// A Q-network for observations as the environment gives them.
    Network(Mlp<f32>),
}

impl Policy {
    /// The policy in the tensors without a prefix, whoever wrote them, for a task with these sizes.
    ///
    /// # Errors
    /// When there is none, it has another shape, or a number in it is not finite.
    pub fn from_tensors(
        tensors: &Tensors,
        observation_size: usize,
        num_actions: usize,
    ) -> Result<Self, TensorError> {
        Ok(Self::Network(tensors.network(observation_size, num_actions)?))
    }

    /// Adds the policy, each name with a prefix.
    pub fn save(&self, prefix: &str, tensors: &mut Tensors) {
        match self {
            Self::Network(network) => tensors.put_network(prefix, network),
        }
    }

    /// Replaces the policy by the one of the same shape that [`Self::save`] has added with a prefix.
    ///
    /// # Errors
    /// When a tensor is missing or of another type or shape.
    pub fn load(&mut self, prefix: &str, tensors: &Tensors) -> Result<(), TensorError> {
        match self {
            Self::Network(network) => tensors.get_network(prefix, network),
        }
    }

    /// The greedy policy for up to `batch` observations at once.
    pub fn greedy(&self, batch: usize) -> Greedy {
        match self {
            Self::Network(network) => Greedy::new(network.clone(), batch),
        }
    }

    /// The network.
    pub fn network(&self) -> &Mlp<f32> {
        match self {
            Self::Network(network) => network,
        }
    }

    /// SHA-256 in lower-case hexadecimal over its numbers, see [`weights_sha256`].
    pub fn sha256(&self) -> String {
        weights_sha256(self.network())
    }
}

/// Chooses actions, one observation at a time.
pub trait Actor {
    /// The action for an observation.
    fn act(&mut self, observation: &[f32]) -> usize;

    /// The estimated returns of all actions in the observation last acted on, in units of the environment's rewards;
    /// empty if the actor has none.
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
    pub fn forward_batch<'a>(&mut self, observations: impl Iterator<Item = &'a [f32]>) {
        let batch = self.batch();
        let input = self.activations.input_mut().as_mut_slice();
        for (sample, observation) in observations.enumerate() {
            for (value, &feature) in input[sample..].iter_mut().step_by(batch).zip(observation) {
                *value = feature;
            }
        }
        self.network.forward(&mut self.activations);
    }

    /// The action with the largest Q-value for one of the observations of the batch, the first of equals.
    pub fn action(&self, sample: usize) -> usize {
        super::argmax(self.activations.output(), sample)
    }

    /// The Q-value of an action for one of the observations of the batch, in units of the environment's rewards.
    pub fn q_value(&self, sample: usize, action: usize) -> f64 {
        f64::from(self.activations.output()[(sample, action)]) / self.reward_scale
    }
}

impl Actor for Greedy {
    fn act(&mut self, observation: &[f32]) -> usize {
        self.forward_batch(std::iter::once(observation));
        self.action(0)
    }

    fn q_values(&self) -> Vec<f32> {
        (0..self.activations.output().ncols()).map(|action| self.q_value(0, action) as f32).collect()
    }
}
