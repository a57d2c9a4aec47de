//! The kernels as one would write them on paper. They define what the fast kernels must compute.

use nalgebra::DMatrix;

use super::float::Float;

/// The numbers of one Adam step, the same for every parameter.
#[derive(Clone, Copy, Debug)]
pub struct AdamCoefficients<T> {
    pub beta1: T,
    pub one_minus_beta1: T,
    pub beta2: T,
    pub one_minus_beta2: T,
    /// α / (1 − β₁ᵗ)
    pub step_size: T,
    /// 1 / √(1 − β₂ᵗ)
    pub second_moment_scale: T,
    pub epsilon: T,
}

/// y = W x + b, with ReLU if `relu`. x is (batch, in), `layer` is W (in, out), then b (out), y is (batch, out).
pub fn affine<T: Float>(x: &DMatrix<T>, layer: &[T], relu: bool, y: &mut DMatrix<T>) {
    let (inputs, outputs) = (x.ncols(), y.ncols());
    let (weight, bias) = layer.split_at(inputs * outputs);
    for output in 0..outputs {
        for sample in 0..x.nrows() {
            let mut sum = bias[output];
            for input in 0..inputs {
                sum = weight[input * outputs + output].mul_add(x[(sample, input)], sum);
            }
            y[(sample, output)] = if relu && sum < T::ZERO { T::ZERO } else { sum };
        }
    }
}

/// dx = Wᵀ dy where x > 0, else 0. dy is (batch, out), `layer` W (in, out), then b (out), x and dx (batch, in).
pub fn input_gradient<T: Float>(dy: &DMatrix<T>, layer: &[T], x: &DMatrix<T>, dx: &mut DMatrix<T>) {
    let outputs = dy.ncols();
    for input in 0..x.ncols() {
        for sample in 0..x.nrows() {
            let mut sum = T::ZERO;
            for output in 0..outputs {
                sum = layer[input * outputs + output].mul_add(dy[(sample, output)], sum);
            }
            dx[(sample, input)] = if x[(sample, input)] > T::ZERO { sum } else { T::ZERO };
        }
    }
}

/// dW = dy xᵀ (in, out), then db = Σ_batch dy (out), into `gradient`. dy is (batch, out), x is (batch, in).
pub fn layer_gradient<T: Float>(dy: &DMatrix<T>, x: &DMatrix<T>, gradient: &mut [T]) {
    let (inputs, outputs) = (x.ncols(), dy.ncols());
    let (weight, bias) = gradient.split_at_mut(inputs * outputs);
    for output in 0..outputs {
        for input in 0..inputs {
            let mut sum = T::ZERO;
            for sample in 0..x.nrows() {
                sum = x[(sample, input)].mul_add(dy[(sample, output)], sum);
            }
            weight[input * outputs + output] = sum;
        }
        let mut sum = T::ZERO;
        for sample in 0..x.nrows() {
            sum += dy[(sample, output)];
        }
        bias[output] = sum;
    }
}

/// Adam's loop over the parameters θ, gradient g and moments m and v. Returns whether every new θ is finite.
pub fn adam<T: Float>(
    coefficients: &AdamCoefficients<T>, parameters: &mut [T], gradient: &[T], first_moment: &mut [T],
    second_moment: &mut [T],
) -> bool {
    let c = *coefficients;
    let mut all_finite = true;
    let moments = first_moment.iter_mut().zip(second_moment);
    for ((parameter, &g), (m, v)) in parameters.iter_mut().zip(gradient).zip(moments) {
        *m = c.beta1.mul_add(*m, c.one_minus_beta1 * g).flush();
        *v = c.beta2.mul_add(*v, c.one_minus_beta2 * g * g).flush();
        let step = *m / v.sqrt().mul_add(c.second_moment_scale, c.epsilon);
        *parameter = (-c.step_size).mul_add(step, *parameter);
        all_finite &= *parameter * T::ZERO == T::ZERO;
    }
    all_finite
}

/// θ⁻ ← τ (θ − θ⁻) + θ⁻ with one fused multiply-add, for every parameter. `target` is θ⁻, and `online` is θ.
pub fn soft_update<T: Float>(tau: T, online: &[T], target: &mut [T]) {
    for (target, &online) in target.iter_mut().zip(online) {
        *target = tau.mul_add(online - *target, *target);
    }
}
