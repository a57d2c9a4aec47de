//! The policy in a checkpoint, and what the checkpoint says of it.

use super::Header;
use crate::agent::Greedy;
use crate::checkpoint::{Checkpoint, Problem};
use crate::env::Environment;
use crate::nn::Mlp;

/// A policy that can be played, with the header of its file; a file of another program has none.
#[derive(Clone, Debug)]
pub struct SavedPolicy {
    /// Its weights, as they are in the file.
    pub network: Mlp<f32>,
    /// See [`Header`].
    pub header: Option<Header>,
}

impl SavedPolicy {
    /// The policy in a checkpoint, for a task.
    ///
    /// # Errors
    /// When there is none for this task, or the header is of another version or damaged.
    pub fn of<E: Environment>(checkpoint: &Checkpoint) -> Result<Self, Problem> {
        let header = match checkpoint.header() {
            Err(Problem::NoHeader) => None,
            header => Some(header?),
        };
        Ok(Self { network: checkpoint.policy(E::OBSERVATION_SIZE, E::NUM_ACTIONS)?, header })
    }

    /// What the Q-values are divided by to be in units of the environment's rewards.
    pub fn reward_scale(&self) -> f64 {
        self.header.as_ref().map_or(1.0, |header| header.config.reward_scale)
    }

    /// The greedy policy for up to `batch` observations at once. Every Q-value that a user sees comes from here, so that
    /// all of them are in units of the environment's rewards.
    pub fn greedy(&self, batch: usize) -> Greedy {
        Greedy::new(self.network.clone(), batch).with_reward_scale(self.reward_scale())
    }
}
