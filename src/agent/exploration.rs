//! ε-greedy exploration: how ε falls.

use serde::{Deserialize, Serialize};

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
    },
}

impl Exploration {
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
            Self::Linear { initial, final_, steps } => {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn linear_falls_in_a_straight_line_and_stays() {
        let schedule = Exploration::Linear { initial: 1.0, final_: 0.2, steps: 4 };
        let epsilons: Vec<f64> = (0..7).map(|step| schedule.after_step(f64::NAN, step)).collect();
        assert_eq!(epsilons, [1.0, 0.8, 0.6, 0.3999999999999999, 0.2, 0.2, 0.2]);
        assert_eq!(schedule.after_episode(0.6), 0.6);
    }

    #[test]
    fn per_episode_decays_until_it_is_at_or_below_the_final_value() {
        let schedule = Exploration::PerEpisode { initial: 1.0, final_: 0.3, decay: 0.5 };
        let mut epsilon = schedule.initial_epsilon();
        let epsilons: Vec<f64> = std::iter::repeat_with(|| {
            epsilon = schedule.after_episode(schedule.after_step(epsilon, 7));
            epsilon
        })
        .take(4)
        .collect();
        assert_eq!(epsilons, [0.5, 0.25, 0.25, 0.25]);
    }
}
