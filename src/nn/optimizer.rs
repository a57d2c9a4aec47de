//! What surrounds Adam: its settings, the schedule of its step size, and the limit of the gradient's norm.

use serde::{Deserialize, Serialize};

/// Settings of the optimiser; `config::keys` has their meanings and ranges.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OptimizerConfig {
    /// Adam's step size α; with a schedule the step size of the first step.
    pub learning_rate: f64,
    pub beta1: f64,
    pub beta2: f64,
    pub epsilon: f64,
    /// See [`clip_norm`].
    pub max_gradient_norm: Option<f64>,
    pub schedule: Option<LearningRateSchedule>,
}

/// A straight line from `learning_rate` to `final_learning_rate` over the run's first `steps` steps, then constant.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LearningRateSchedule {
    pub final_learning_rate: f64,
    pub steps: u64,
}

/// A step size and how it changes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LearningRate {
    /// Step size α; with a schedule that of the first step.
    pub learning_rate: f64,
    pub schedule: Option<LearningRateSchedule>,
}

impl LearningRate {
    pub(crate) fn after(&self, env_steps: u64) -> f64 {
        match self.schedule {
            None => self.learning_rate,
            Some(schedule) if env_steps >= schedule.steps => schedule.final_learning_rate,
            Some(LearningRateSchedule { final_learning_rate, steps }) => {
                let share = env_steps as f64 / steps as f64;
                self.learning_rate + (final_learning_rate - self.learning_rate) * share
            }
        }
    }
}

impl OptimizerConfig {
    pub fn learning_rate(&self) -> LearningRate {
        let Self { learning_rate, schedule, .. } = *self;
        LearningRate { learning_rate, schedule }
    }
}

/// ‖g‖, whose squares are summed in f64 in the order of memory.
pub(crate) fn norm(values: &[f32]) -> f64 {
    values.iter().map(|&value| f64::from(value) * f64::from(value)).sum::<f64>().sqrt()
}

/// Limits the norm of the gradient (Pascanu, Mikolov and Bengio 2013, algorithm 1) as PyTorch's `clip_grad_norm_` does:
///
/// ```text
/// g ← g · min(1, max_norm / (‖g‖ + 1e-6))
/// ```
pub(crate) fn clip_norm(gradient: &mut [f32], max_norm: f64) {
    let factor = max_norm / (norm(gradient) + 1e-6);
    if factor < 1.0 {
        gradient.iter_mut().for_each(|g| *g *= factor as f32);
    }
}

#[cfg(test)]
#[path = "../../tests/unit/nn_optimizer.rs"]
mod tests;
