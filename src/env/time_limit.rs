//! A limit on the length of an episode, outside the physics (Pardo et al. 2018, "Time limits in reinforcement
//! learning"): it truncates, it does not terminate.

use serde::{Deserialize, Serialize};

use super::{Environment, Step};
use crate::mirror::Mirror;
use crate::rng::Rng;

/// Truncates the episodes of `E` after `max_steps` steps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TimeLimit<E> {
    environment: E,
    max_steps: u32,
    elapsed_steps: u32,
}

impl<E> TimeLimit<E> {
    /// `environment` with episodes of at most `max_steps` steps.
    pub fn new(environment: E, max_steps: u32) -> Self {
        Self { environment, max_steps, elapsed_steps: 0 }
    }
}

impl<E: Environment> Environment for TimeLimit<E> {
    type Observation = E::Observation;

    const OBSERVATION_SIZE: usize = E::OBSERVATION_SIZE;
    const NUM_ACTIONS: usize = E::NUM_ACTIONS;
    const SOLVED_RETURN: f64 = E::SOLVED_RETURN;
    const MAX_RETURN: f64 = E::MAX_RETURN;

    fn mirror() -> Option<Mirror> {
        E::mirror()
    }

    fn reset(&mut self, rng: &mut Rng) -> E::Observation {
        self.elapsed_steps = 0;
        self.environment.reset(rng)
    }

    fn step(&mut self, action: usize) -> Step<E::Observation> {
        self.elapsed_steps += 1;
        let step = self.environment.step(action);
        Step { truncated: step.truncated || self.elapsed_steps >= self.max_steps, ..step }
    }

    fn state(&self) -> &[f64] {
        self.environment.state()
    }

    fn admits(&self, state: &Self) -> bool {
        state.max_steps == self.max_steps
            && state.elapsed_steps < self.max_steps
            && self.environment.admits(&state.environment)
    }
}
