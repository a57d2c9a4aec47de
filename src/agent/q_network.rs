//! The Q-network of an agent, what an observation is divided by before it, and how both become a policy.

use crate::nn::{Activations, Mlp, NetworkConfig};

/// Q(s, ·) for observations whose coordinates were divided. The output layer is linear, with one Q-value for each action.
#[derive(Clone, Debug, PartialEq)]
pub struct QNetwork {
    pub mlp: Mlp<f32>,
    /// What each coordinate of an observation is divided by.
    pub(super) divisors: Vec<f32>,
}

impl QNetwork {
    /// A network with freshly drawn weights; without `divisors` it takes observations as they are.
    pub(super) fn new(
        config: &NetworkConfig, divisors: Option<&[f64]>, observation_size: usize, num_actions: usize,
        rng: &mut crate::rng::Rng,
    ) -> Self {
        let mlp = Mlp::new(config, observation_size, num_actions, rng);
        let ones = || vec![1.0; observation_size];
        let divisors = divisors.map_or_else(ones, |all| all.iter().map(|&divisor| divisor as f32).collect());
        Self { mlp, divisors }
    }

    pub(super) fn divide(&self, observation: &[f32], divided: &mut [f32]) {
        debug_assert_eq!(observation.len(), self.divisors.len());
        for ((divided, value), divisor) in divided.iter_mut().zip(observation).zip(&self.divisors) {
            *divided = value / divisor;
        }
    }

    /// The Q-values of divided observations, (batch, features), as the output of `activations`.
    pub(super) fn forward(&self, observations: &nalgebra::DMatrix<f32>, activations: &mut Activations<f32>) {
        activations.set_input(observations);
        self.mlp.forward(activations);
    }

    /// θ⁻ ← θ
    pub(super) fn copy_from(&mut self, other: &Self) {
        self.mlp.copy_from(&other.mlp);
    }

    /// θ⁻ ← θ⁻ + τ (θ − θ⁻)
    pub(super) fn move_towards(&mut self, other: &Self, tau: f64) {
        self.mlp.move_towards(&other.mlp, tau as f32);
    }

    /// The network for undivided observations: the divisors are folded into the first layer, W x / d = (W / d) x.
    pub(super) fn as_policy(&self) -> Mlp<f32> {
        let mut policy = self.mlp.clone();
        self.each_input(&mut policy, |weight, divisor| *weight /= divisor);
        policy
    }

    /// The inverse of [`Self::as_policy`], with the divisors of `like`. None if the shape differs or a weight is not finite.
    pub(super) fn from_policy(policy: &Mlp<f32>, like: &Self) -> Option<Self> {
        let mut network = like.clone();
        network.mlp.clone_from(policy);
        like.each_input(&mut network.mlp, |weight, divisor| *weight *= divisor);
        let is_finite = network.mlp.parameters().iter().all(|parameter| parameter.is_finite());
        (policy.sizes() == like.mlp.sizes() && is_finite).then_some(network)
    }

    /// Changes every weight of the first layer, by the divisor of the coordinate that it belongs to.
    fn each_input(&self, mlp: &mut Mlp<f32>, change: impl Fn(&mut f32, f32)) {
        let outputs = mlp.sizes()[1];
        for (weights, &divisor) in mlp.layer_mut(0).chunks_exact_mut(outputs).zip(&self.divisors) {
            weights.iter_mut().for_each(|weight| change(weight, divisor));
        }
    }
}
