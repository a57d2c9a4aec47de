//! ε-greedy exploration: how ε falls, and for how many steps a random action is repeated.

use crate::rng::Rng;
use crate::tensors::{TensorError, Tensors};

/// The schedule of ε, the probability of a random action, in steps or episodes from the start of the run, whatever the budget.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(tag = "schedule", rename_all = "snake_case", deny_unknown_fields)]
pub enum Exploration {
    /// After every episode ε × `decay`, as long as ε > `final` (the tutorial's rule).
    PerEpisode {
        initial: f64,
        /// ε is no longer multiplied once it is at or below this.
        #[serde(rename = "final")]
        final_: f64,
        decay: f64,
        #[serde(default = "once")]
        repeat: u32,
    },
    /// From `initial` to `final` in a straight line over `steps` environment steps, then `final` (Mnih et al. 2015).
    Linear {
        initial: f64,
        #[serde(rename = "final")]
        final_: f64,
        steps: u64,
        #[serde(default = "once")]
        repeat: u32,
    },
}

fn once() -> u32 {
    1
}

impl Exploration {
    pub(crate) fn after_step(&self, epsilon: f64, env_steps: u64) -> f64 {
        match *self {
            Self::PerEpisode { .. } => epsilon,
            Self::Linear { final_, steps, .. } if env_steps >= steps => final_,
            Self::Linear { initial, final_, steps, .. } => {
                initial + (final_ - initial) * (env_steps as f64 / steps as f64)
            }
        }
    }

    pub(crate) fn after_episode(&self, epsilon: f64) -> f64 {
        match *self {
            Self::PerEpisode { final_, decay, .. } if epsilon > final_ => epsilon * decay,
            Self::PerEpisode { .. } | Self::Linear { .. } => epsilon,
        }
    }
}

/// εz-greedy exploration (Dabney, Ostrovski and Barreto 2021, "Temporally-extended ε-greedy exploration"): with probability ε
/// a random action is drawn and taken for n steps, P(n) ∝ n⁻². With `repeat` 1 it is plain ε-greedy.
#[derive(Clone, Debug)]
pub struct EpsilonGreedy {
    schedule: Exploration,
    /// Probability that a step begins to explore.
    pub epsilon: f64,
    /// Draws whether to explore, the action and its duration.
    pub(crate) rng: Rng,
    /// The random action that is taken, and for how many more steps.
    held: (usize, u64),
}

impl EpsilonGreedy {
    pub fn new(schedule: Exploration, rng: Rng) -> Self {
        let (Exploration::PerEpisode { initial, .. } | Exploration::Linear { initial, .. }) = schedule;
        Self { schedule, epsilon: initial, rng, held: (0, 0) }
    }

    /// A random action, or none if the greedy action is to be taken.
    pub(crate) fn explore(&mut self, num_actions: usize) -> Option<usize> {
        if self.held.1 > 0 {
            self.held.1 -= 1;
            return Some(self.held.0);
        }
        if self.rng.unit() > self.epsilon {
            return None;
        }
        let action = self.rng.below(num_actions as u64) as usize;
        let (Exploration::PerEpisode { repeat, .. } | Exploration::Linear { repeat, .. }) = self.schedule;
        if repeat > 1 {
            self.held = (action, zeta(&mut self.rng, repeat) - 1);
        }
        Some(action)
    }

    pub(crate) fn after_step(&mut self, env_steps: u64) {
        self.epsilon = self.schedule.after_step(self.epsilon, env_steps);
    }

    /// Follows the schedule after an episode, with which the repetition of an action ends too.
    pub(crate) fn after_episode(&mut self) {
        self.epsilon = self.schedule.after_episode(self.epsilon);
        self.held.1 = 0;
    }

    pub fn save(&self, tensors: &mut Tensors) {
        tensors.put("epsilon", &[1], &[self.epsilon]);
        tensors.put_rng("explore_rng", &self.rng);
        if self.held.1 > 0 {
            tensors.put("held_action", &[2], &[self.held.0 as u64, self.held.1]);
        }
    }

    /// The inverse of [`Self::save`].
    pub fn load(&mut self, tensors: &Tensors, num_actions: usize) -> Result<(), TensorError> {
        self.epsilon = tensors.get_one("epsilon")?;
        self.rng = tensors.get_rng("explore_rng")?;
        self.held = (0, 0);
        if tensors.shape("held_action").is_ok() {
            let held: Vec<u64> = tensors.get("held_action", &[2])?;
            if held[0] >= num_actions as u64 {
                return Err(TensorError::Inconsistent("held action"));
            }
            self.held = (held[0] as usize, held[1]);
        }
        Ok(())
    }
}

/// A number n with P(n) ∝ n⁻²; one above `max` counts as `max`.
fn zeta(rng: &mut Rng, max: u32) -> u64 {
    // ζ(2) = Σ n⁻² = π² / 6.
    let mut left = rng.unit() * (std::f64::consts::PI * std::f64::consts::PI / 6.0);
    for n in 1..u64::from(max) {
        left -= 1.0 / (n * n) as f64;
        if left < 0.0 {
            return n;
        }
    }
    u64::from(max)
}

#[cfg(test)]
#[path = "../../tests/unit/agent_exploration.rs"]
mod tests;
