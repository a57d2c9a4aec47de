//! Environments: what an agent acts in. They know nothing of agents.
//!
//! The random generator is an argument of [`Environment::reset`], so that an environment is its state and
//! nothing else: training resets from its own stream, an evaluation from one generator per episode.

mod cartpole;
mod time_limit;

use serde::{Deserialize, Serialize, de::DeserializeOwned};

use crate::mirror::Mirror;
use crate::rng::Rng;

pub use cartpole::CartPole;
pub use time_limit::TimeLimit;

/// A Markov decision process with a finite set of actions, numbered from 0.
///
/// `Serialize` and `Deserialize` carry the state through a checkpoint, in the middle of an episode too.
pub trait Environment: Clone + Serialize + DeserializeOwned {
    /// The observation: `observation_size` numbers.
    type Observation: AsRef<[f32]> + Clone + std::fmt::Debug + Serialize + DeserializeOwned;

    /// Numbers in an observation.
    const OBSERVATION_SIZE: usize;
    /// Number of actions; valid actions are `0..NUM_ACTIONS`.
    const NUM_ACTIONS: usize;
    /// Mean return over 100 episodes from which the task counts as solved (Gymnasium's `reward_threshold`).
    const SOLVED_RETURN: f64;
    /// The return that no episode can exceed.
    const MAX_RETURN: f64;

    /// The mirror image of the task, if it has one.
    fn mirror() -> Option<Mirror> {
        None
    }

    /// Starts a new episode and returns its first observation.
    fn reset(&mut self, rng: &mut Rng) -> Self::Observation;

    /// Applies `action` for one time step.
    fn step(&mut self, action: usize) -> Step<Self::Observation>;

    /// The full state in f64, for traces: more precise than the observation.
    fn state(&self) -> &[f64];

    /// Whether a state that was read from a file can be one of this environment, between two of its steps.
    fn admits(&self, _state: &Self) -> bool {
        true
    }
}

/// What one time step brought.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step<O> {
    /// What the agent sees after the step.
    pub observation: O,
    /// Reward of the step.
    pub reward: f32,
    /// The task itself has ended: the value of what follows is 0.
    pub terminated: bool,
    /// The episode was cut off from outside: what follows still has a value.
    pub truncated: bool,
}

impl<O> Step<O> {
    /// Whether the episode is over, for whichever reason.
    pub fn ended(&self) -> bool {
        self.terminated || self.truncated
    }
}

/// The environments that a config can name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum EnvironmentId {
    /// Gymnasium's CartPole-v1: [`CartPole`] under a [`TimeLimit`] of 500 steps.
    #[serde(rename = "CartPole-v1")]
    CartPoleV1,
}
