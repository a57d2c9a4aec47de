//! What stands between the layers of a network, and behind the last one: ReLU and nothing, or what people have there by mistake.

use super::rounding::{Matrix, Number, SAFETY, square};

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Activation {
    Nothing,
    Relu,
    /// 0.01 y where y < 0.
    LeakyRelu,
    Elu,
    /// y Φ(y)
    Gelu,
    /// y σ(y)
    Silu,
    Tanh,
    Sigmoid,
    /// Over the actions; behind the last layer alone.
    Softmax,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LayerKinds {
    pub hidden: Activation,
    pub output: Activation,
}

impl LayerKinds {
    pub(super) const RIGHT: Self = Self { hidden: Activation::Relu, output: Activation::Nothing };
    pub(super) const COUNT: usize = 81;

    pub(super) fn index(self) -> usize {
        self.hidden as usize * 9 + self.output as usize
    }
}

impl Activation {
    pub(super) fn of_all(self, y: &Matrix, unit: f64) -> Matrix {
        if self == Self::Softmax {
            return softmax(y, unit);
        }
        let mut x = y.clone();
        for (value, variance) in x.value.iter_mut().zip(x.variance.iter_mut()) {
            let before = Number { value: *value, variance: *variance };
            let slope = self.slope(before);
            *value = self.of(before.value);
            *variance *= reach(slope);
            if !matches!(self, Self::Nothing | Self::Relu) {
                *variance += square(8.0 * unit * *value);
            }
        }
        x
    }

    /// Makes of the gradient by what it gave, `after`, the one by what it got, `before`.
    pub(super) fn backward(self, dy: &mut Matrix, before: &Matrix, after: &Matrix, unit: f64) {
        let (batch, outputs) = dy.value.shape();
        for sample in 0..batch {
            let mut mean = Number::exact(0.0);
            for output in (0..outputs).filter(|_| self == Self::Softmax) {
                let (dy, share) = (dy.get(sample, output), after.get(sample, output));
                let variance = dy.variance * square(share.value) + share.variance * square(dy.value);
                mean += Number { value: dy.value * share.value, variance };
            }
            for output in 0..outputs {
                let mut dx = dy.get(sample, output);
                let slope = match self {
                    Self::Nothing => continue,
                    Self::Softmax => {
                        let share = after.get(sample, output);
                        dx.variance +=
                            mean.variance + square(8.0 * unit) * (square(dx.value) + square(mean.value));
                        dx.value -= mean.value;
                        share
                    }
                    _ => self.slope(before.get(sample, output)),
                };
                dx.variance = dx.variance * reach(slope) + square(dx.value) * slope.variance;
                dx.value *= slope.value;
                if self != Self::Relu {
                    dx.variance += square(8.0 * unit * dx.value);
                }
                (dy.value[(sample, output)], dy.variance[(sample, output)]) = (dx.value, dx.variance);
            }
        }
    }

    fn of(self, y: f64) -> f64 {
        match self {
            Self::Nothing | Self::Softmax => y,
            Self::Relu => y.max(0.0),
            Self::LeakyRelu => y.max(0.01 * y),
            Self::Elu if y > 0.0 => y,
            Self::Elu => libm::expm1(y),
            Self::Gelu => y * normal(y),
            Self::Silu => y * sigmoid(y),
            Self::Tanh => libm::tanh(y),
            Self::Sigmoid => sigmoid(y),
        }
    }

    /// The derivative. Where y lies so near to a kink that rounding decides, it may be either.
    fn slope(self, y: Number) -> Number {
        let x = y.value;
        let value = match self {
            Self::Nothing | Self::Softmax => 1.0,
            Self::Relu => f64::from(x > 0.0),
            Self::LeakyRelu | Self::Elu if x > 0.0 => 1.0,
            Self::LeakyRelu => 0.01,
            Self::Elu => libm::exp(x),
            Self::Gelu => normal(x) + x * libm::exp(-0.5 * x * x) / (2.0 * std::f64::consts::PI).sqrt(),
            Self::Silu => sigmoid(x) * (1.0 + x * (1.0 - sigmoid(x))),
            Self::Tanh => 1.0 - square(libm::tanh(x)),
            Self::Sigmoid => sigmoid(x) * (1.0 - sigmoid(x)),
        };
        let mut slope = Number::exact(value);
        let has_kink = matches!(self, Self::Relu | Self::LeakyRelu);
        if has_kink && x.abs() < y.tolerance() {
            slope.may_be_off_by(1.0);
        } else if !has_kink && self != Self::Nothing {
            // No second derivative is above 1.1.
            slope.variance = 1.25 * y.variance;
        }
        slope
    }
}

/// What multiplies a variance: the square of the slope, or of the largest that rounding may make of it.
fn reach(slope: Number) -> f64 {
    square(slope.value).max(square(SAFETY) * slope.variance)
}

fn sigmoid(y: f64) -> f64 {
    1.0 / (1.0 + libm::exp(-y))
}

fn normal(y: f64) -> f64 {
    0.5 * (1.0 + libm::erf(y * std::f64::consts::FRAC_1_SQRT_2))
}

fn softmax(y: &Matrix, unit: f64) -> Matrix {
    let mut x = y.clone();
    for sample in 0..y.value.nrows() {
        let largest = y.value.row(sample).max();
        let mut row = x.value.row_mut(sample);
        row.apply(|value| *value = libm::exp(*value - largest));
        let sum = row.sum();
        row /= sum;
        let variance = y.variance.row(sample).max() + square(8.0 * unit * (1.0 + largest.abs()));
        x.variance.row_mut(sample).copy_from(&x.value.row(sample).map(|share| variance * square(share)));
    }
    x
}
