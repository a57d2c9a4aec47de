//! Adam (Kingma and Ba 2015, algorithm 1) with PyTorch's placement of epsilon.

use super::OptimizerConfig;
use super::kernels::{AdamCoefficients, Kernels};

/// The optimiser's state for one flat block of parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Adam<T> {
    config: OptimizerConfig,
    pub learning_rate: f64,
    pub steps: u64,
    /// m, the running mean of the gradient.
    pub first_moment: Vec<T>,
    /// v, the running mean of the gradient's square.
    pub(crate) second_moment: Vec<T>,
}

impl<T: Kernels> Adam<T> {
    pub fn new(config: OptimizerConfig, parameters: usize) -> Self {
        Self {
            learning_rate: config.learning_rate,
            config,
            steps: 0,
            first_moment: vec![T::ZERO; parameters],
            second_moment: vec![T::ZERO; parameters],
        }
    }

    /// Takes one step down `gradient`. Returns whether every parameter is still finite.
    ///
    /// ```text
    /// m ← β₁ m + (1 − β₁) g      v ← β₂ v + (1 − β₂) g²
    /// θ ← θ − α / (1 − β₁ᵗ) · m / (√v / √(1 − β₂ᵗ) + ε)
    /// ```
    pub fn step(&mut self, parameters: &mut [T], gradient: &[T]) -> bool {
        self.steps += 1;
        let OptimizerConfig { beta1, beta2, epsilon, .. } = self.config;
        let coefficients = AdamCoefficients {
            beta1: T::from_f64(beta1),
            one_minus_beta1: T::from_f64(1.0 - beta1),
            beta2: T::from_f64(beta2),
            one_minus_beta2: T::from_f64(1.0 - beta2),
            step_size: T::from_f64(self.learning_rate / (1.0 - power(beta1, self.steps))),
            second_moment_scale: T::from_f64(1.0 / (1.0 - power(beta2, self.steps)).sqrt()),
            epsilon: T::from_f64(epsilon),
        };
        T::adam(&coefficients, parameters, gradient, &mut self.first_moment, &mut self.second_moment)
    }
}

/// `base` to the power of `exponent` by repeated squaring: multiplications, which all platforms round alike, unlike `powi`.
fn power(base: f64, exponent: u64) -> f64 {
    let (mut result, mut square, mut rest) = (1.0, base, exponent);
    while rest > 0 {
        if rest & 1 == 1 {
            result *= square;
        }
        square *= square;
        rest >>= 1;
    }
    result
}

#[cfg(test)]
#[path = "../../tests/unit/nn_adam.rs"]
mod tests;
