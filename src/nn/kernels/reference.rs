//! The kernels as one would write them on paper: the judge of the fast path.

use nalgebra::DMatrix;

use super::Float;
use crate::nn::adam::AdamCoefficients;

/// See [`Float::affine`].
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

/// See [`Float::input_gradient`].
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

/// See [`Float::layer_gradient`].
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

/// See [`Float::adam`].
pub fn adam<T: Float>(
    coefficients: &AdamCoefficients<T>,
    parameters: &mut [T],
    gradient: &[T],
    first_moment: &mut [T],
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

/// See [`Float::soft_update`].
pub fn soft_update<T: Float>(tau: T, online: &[T], target: &mut [T]) {
    for (target, &online) in target.iter_mut().zip(online) {
        *target = tau.mul_add(online - *target, *target);
    }
}
