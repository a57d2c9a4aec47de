//! The baseline: every action with the same probability.

use super::Actor;
use crate::rng::Rng;

#[derive(Clone, Debug)]
pub(crate) struct Random {
    num_actions: usize,
    rng: Rng,
}

impl Random {
    /// Uniform over `num_actions` actions.
    pub fn new(num_actions: usize, rng: Rng) -> Self {
        Self { num_actions, rng }
    }
}

impl Actor for Random {
    fn act(&mut self, _observation: &[f32]) -> usize {
        self.rng.below(self.num_actions as u64) as usize
    }

    fn q_values(&self) -> Vec<f32> {
        Vec::new()
    }
}
