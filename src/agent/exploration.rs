//! ε-greedy exploration: how ε falls, and for how many steps a random action is repeated.

use serde::{Deserialize, Serialize};

use crate::rng::Rng;
use crate::tensors::{TensorError, Tensors};

/// The schedule of ε, the probability of a random action. Every schedule counts from the start of the run, in
/// absolute steps or episodes, never relative to the budget.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "schedule", rename_all = "snake_case", deny_unknown_fields)]
pub enum Exploration {
    /// After every episode ε × `decay`, as long as ε > `final` (the tutorial's rule).
    PerEpisode {
        /// ε of the first episode.
        initial: f64,
        /// ε is no longer multiplied once it is at or below this.
        #[serde(rename = "final")]
        final_: f64,
        /// Factor per episode.
        decay: f64,
        /// See [`Exploration::repeat`].
        #[serde(default = "once")]
        repeat: u32,
    },
    /// From `initial` to `final` in a straight line over `steps` environment steps, then `final` (Mnih et al.
    /// 2015).
    Linear {
        /// ε at step 0.
        initial: f64,
        /// ε from step `steps` on.
        #[serde(rename = "final")]
        final_: f64,
        /// Environment steps from `initial` to `final`.
        steps: u64,
        /// See [`Exploration::repeat`].
        #[serde(default = "once")]
        repeat: u32,
    },
}

fn once() -> u32 {
    1
}

impl Exploration {
    /// The most steps in a row for which a random action is taken, at least 1.
    pub fn repeat(&self) -> u32 {
        match *self {
            Self::PerEpisode { repeat, .. } | Self::Linear { repeat, .. } => repeat,
        }
    }

    /// ε at the start of a run.
    pub fn initial_epsilon(&self) -> f64 {
        match *self {
            Self::PerEpisode { initial, .. } | Self::Linear { initial, .. } => initial,
        }
    }

    /// ε after `env_steps` environment steps of the run.
    pub fn after_step(&self, epsilon: f64, env_steps: u64) -> f64 {
        match *self {
            Self::PerEpisode { .. } => epsilon,
            Self::Linear { final_, steps, .. } if env_steps >= steps => final_,
            Self::Linear { initial, final_, steps, .. } => {
                initial + (final_ - initial) * (env_steps as f64 / steps as f64)
            }
        }
    }

    /// ε after an episode.
    pub fn after_episode(&self, epsilon: f64) -> f64 {
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
    pub rng: Rng,
    /// The random action that is taken, and for how many more steps.
    held: (usize, u64),
}

impl EpsilonGreedy {
    /// Exploration at the start of a run.
    pub fn new(schedule: Exploration, rng: Rng) -> Self {
        Self { schedule, epsilon: schedule.initial_epsilon(), rng, held: (0, 0) }
    }

    /// A random action, or none if the greedy action is to be taken.
    pub fn explore(&mut self, num_actions: usize) -> Option<usize> {
        if self.held.1 > 0 {
            self.held.1 -= 1;
            return Some(self.held.0);
        }
        if self.rng.unit() > self.epsilon {
            return None;
        }
        let action = self.rng.below(num_actions as u64) as usize;
        let repeat = self.schedule.repeat();
        if repeat > 1 {
            self.held = (action, zeta(&mut self.rng, repeat) - 1);
        }
        Some(action)
    }

    /// Follows the schedule after `env_steps` environment steps of the run.
    pub fn after_step(&mut self, env_steps: u64) {
        self.epsilon = self.schedule.after_step(self.epsilon, env_steps);
    }

    /// Follows the schedule after an episode, with which the repetition of an action ends too.
    pub fn after_episode(&mut self) {
        self.epsilon = self.schedule.after_episode(self.epsilon);
        self.held.1 = 0;
    }

    /// Adds what a resumed run needs.
    pub fn save(&self, tensors: &mut Tensors) {
        tensors.put("epsilon", &[1], &[self.epsilon]);
        tensors.put_rng("explore_rng", &self.rng);
        if self.held.1 > 0 {
            tensors.put("held_action", &[2], &[self.held.0 as u64, self.held.1]);
        }
    }

    /// The inverse of [`Self::save`].
    ///
    /// # Errors
    /// When a tensor is missing or cannot be of such exploration.
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
mod tests {
    use super::*;

    #[test]
    fn linear_falls_in_a_straight_line_and_stays() {
        let schedule = Exploration::Linear { initial: 1.0, final_: 0.2, steps: 4, repeat: 1 };
        let epsilons: Vec<f64> = (0..7).map(|step| schedule.after_step(f64::NAN, step)).collect();
        assert_eq!(epsilons, [1.0, 0.8, 0.6, 0.3999999999999999, 0.2, 0.2, 0.2]);
        assert_eq!(schedule.after_episode(0.6), 0.6);
    }

    #[test]
    fn per_episode_decays_until_it_is_at_or_below_the_final_value() {
        let schedule = Exploration::PerEpisode { initial: 1.0, final_: 0.3, decay: 0.5, repeat: 1 };
        let mut epsilon = schedule.initial_epsilon();
        let epsilons: Vec<f64> = std::iter::repeat_with(|| {
            epsilon = schedule.after_episode(schedule.after_step(epsilon, 7));
            epsilon
        })
        .take(4)
        .collect();
        assert_eq!(epsilons, [0.5, 0.25, 0.25, 0.25]);
    }

    #[test]
    fn a_duration_of_n_steps_has_a_probability_proportional_to_one_over_n_squared() {
        let mut rng = Rng::from_seed(0);
        let mut counts = [0; 5];
        for _ in 0..100_000 {
            counts[zeta(&mut rng, 4) as usize] += 1;
        }
        // 6/π² = 0.6079; a quarter and a ninth of it; the rest is 0.1724.
        let expected = [0, 60_793, 15_198, 6_755, 17_254];
        for (count, expected) in counts.iter().zip(expected) {
            assert!(i32::abs(count - expected) < 600, "{counts:?}");
        }
    }

    #[test]
    fn a_random_action_is_taken_again_until_its_time_or_the_episode_is_over() {
        let schedule = Exploration::PerEpisode { initial: 1.0, final_: 0.0, decay: 1.0, repeat: 50 };
        let mut exploration = EpsilonGreedy::new(schedule, Rng::from_seed(3));
        while exploration.held.1 < 2 {
            exploration.explore(4);
        }
        let (action, left) = exploration.held;
        exploration.epsilon = 0.0;
        for _ in 0..left {
            assert_eq!(exploration.explore(4), Some(action));
        }
        assert_eq!(exploration.explore(4), None);
        exploration.held = (action, 7);
        exploration.after_episode();
        assert_eq!(exploration.explore(4), None);
    }
}
