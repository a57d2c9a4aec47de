//! A network's passes in f64 together with how far another program's rounding may move each number.
//!
//! Rounding errors are taken as independent with mean 0: their variances add up, weighted by the square of what multiplies
//! them. A sum of n products in any order has the variance n u² (Σ (wᵢ xᵢ)² + (Σ wᵢ xᵢ)²), where u is the unit of rounding.
//! This is more than blocked sums have. Two numbers agree if they lie within [`SAFETY`] standard deviations.

use std::ops::AddAssign;

use nalgebra::{DMatrix, DMatrixView};

use crate::nn::Mlp;

/// Standard deviations that count as equal.
pub(super) const SAFETY: f64 = 16.0;

/// A number with the variance of its rounding error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Number {
    /// The number in f64.
    pub value: f64,
    pub(crate) variance: f64,
}

impl Number {
    /// A number that was not computed.
    pub fn exact(value: f64) -> Self {
        Self { value, variance: 0.0 }
    }

    /// How far another program's number may be away.
    pub(crate) fn tolerance(&self) -> f64 {
        SAFETY * self.variance.sqrt()
    }

    /// Adds to the variance that the number may be off by `distance` altogether.
    pub(super) fn may_be_off_by(&mut self, distance: f64) {
        self.variance += square(distance / SAFETY);
    }

    /// The product with an exact factor.
    pub(super) fn scaled(self, factor: f64) -> Self {
        Self { value: self.value * factor, variance: self.variance * square(factor) }
    }
}

impl AddAssign for Number {
    fn add_assign(&mut self, other: Self) {
        self.value += other.value;
        self.variance += other.variance;
    }
}

/// A matrix of [`Number`]s, (batch, features).
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Matrix {
    pub value: DMatrix<f64>,
    pub(crate) variance: DMatrix<f64>,
}

impl Matrix {
    pub fn zeros(rows: usize, columns: usize) -> Self {
        Self { value: DMatrix::zeros(rows, columns), variance: DMatrix::zeros(rows, columns) }
    }

    pub fn get(&self, row: usize, column: usize) -> Number {
        Number { value: self.value[(row, column)], variance: self.variance[(row, column)] }
    }

    /// The variance of each number, and what a sum with it adds for rounding: `growth` times its square.
    fn spread(&self, growth: f64) -> DMatrix<f64> {
        self.variance.zip_map(&self.value, |variance, value| variance + growth * square(value))
    }

    pub(crate) fn add(&mut self, row: usize, column: usize, number: Number) {
        self.value[(row, column)] += number.value;
        self.variance[(row, column)] += number.variance;
    }
}

/// A forward pass: what each layer got, and what it gave before its ReLU.
pub(super) struct Pass {
    inputs: Vec<Matrix>,
    outputs: Vec<Matrix>,
}

impl Pass {
    /// Q(s, ·).
    pub(crate) fn q(&self) -> &Matrix {
        &self.outputs[self.outputs.len() - 1]
    }

    /// What a layer gave before its ReLU, (batch, units).
    pub(super) fn before_relu(&self, layer: usize) -> &DMatrix<f64> {
        &self.outputs[layer].value
    }
}

/// y = W x + b for every layer, with ReLU between them.
pub(super) fn forward(network: &Mlp<f64>, observations: &DMatrix<f64>, unit: f64) -> Pass {
    let batch = observations.nrows();
    let mut pass = Pass { inputs: Vec::new(), outputs: Vec::new() };
    let mut x = Matrix { value: observations.clone(), variance: DMatrix::zeros(batch, observations.ncols()) };
    for index in 0..network.num_layers() {
        let (inputs, outputs) = (network.sizes()[index], network.sizes()[index + 1]);
        let growth = square(unit) * (inputs + 1) as f64;
        let layer = network.layer(index);
        let mut squares: Vec<f64> = layer.iter().copied().map(square).collect();
        squares[inputs * outputs..].iter_mut().for_each(|bias| *bias *= growth);
        let x_squares = x.spread(growth);
        let mut y = Matrix::zeros(batch, outputs);
        affine(&x.value, layer, &mut y.value);
        affine(&x_squares, &squares, &mut y.variance);
        y.variance = y.spread(growth);
        pass.inputs.push(std::mem::replace(&mut x, relu(&y)));
        pass.outputs.push(y);
    }
    pass
}

fn relu(y: &Matrix) -> Matrix {
    let variance = y.variance.zip_map(&y.value, |variance, value| {
        let is_off = value < -Number { value, variance }.tolerance();
        if is_off { 0.0 } else { variance }
    });
    Matrix { value: y.value.map(|value| value.max(0.0)), variance }
}

/// Adds to `gradient`, in the order of [`Mlp::parameters`], the gradient by the parameters of the layers from `first`
/// on; `dy` is the gradient by the network's output.
pub(super) fn backward(
    network: &Mlp<f64>,
    pass: &Pass,
    mut dy: Matrix,
    unit: f64,
    first: usize,
    gradient: &mut [Number],
) {
    let batch = dy.value.nrows();
    let growth = square(unit) * batch as f64;
    let mut end = gradient.len();
    for index in (first..network.num_layers()).rev() {
        let (layer, x) = (network.layer(index), &pass.inputs[index]);
        let weights = layer.len() - dy.value.ncols();
        let value = layer_gradient(&dy.value, &x.value);
        let mut rounded = layer_gradient(&dy.value.map(square), &x.spread(growth));
        let carried = layer_gradient(&dy.variance, &x.value.map(square));
        rounded[weights..].iter_mut().for_each(|bias| *bias *= growth);
        for (position, number) in gradient[end - layer.len()..end].iter_mut().enumerate() {
            number.value += value[position];
            number.variance += rounded[position] + carried[position] + growth * square(value[position]);
        }
        end -= layer.len();
        if index > first {
            dy = before_relu(layer, &dy, &pass.outputs[index - 1], unit);
        }
    }
}

/// The gradient by a hidden layer's output `before` its ReLU. Where that lies so near to 0 that rounding decides, all
/// or nothing of the gradient may pass.
fn before_relu(layer: &[f64], dy: &Matrix, before: &Matrix, unit: f64) -> Matrix {
    let (batch, inputs) = before.value.shape();
    let growth = square(unit) * dy.value.ncols() as f64;
    let squares: Vec<f64> = layer.iter().copied().map(square).collect();
    let dy_squares = dy.spread(growth);
    let mut dx = Matrix {
        value: &dy.value * weights(layer, dy.value.ncols()),
        variance: &dy_squares * weights(&squares, dy.value.ncols()),
    };
    for sample in 0..batch {
        for input in 0..inputs {
            let at = (sample, input);
            let mut number = dx.get(sample, input);
            number.variance += growth * square(number.value);
            let output = before.get(sample, input);
            let (passes, undecided) = (output.value > 0.0, output.value.abs() < output.tolerance());
            if undecided {
                number.may_be_off_by(number.value);
            }
            dx.value[at] = if passes { number.value } else { 0.0 };
            dx.variance[at] = if passes || undecided { number.variance } else { 0.0 };
        }
    }
    dx
}

/// A layer's weights, (out, in).
fn weights(layer: &[f64], outputs: usize) -> DMatrixView<'_, f64> {
    let inputs = layer.len() / outputs - 1;
    DMatrixView::from_slice(&layer[..inputs * outputs], outputs, inputs)
}

/// y = W x + b
fn affine(x: &DMatrix<f64>, layer: &[f64], y: &mut DMatrix<f64>) {
    let outputs = y.ncols();
    let bias = &layer[layer.len() - outputs..];
    y.gemm(1.0, x, &weights(layer, outputs).transpose(), 0.0);
    y.column_iter_mut().zip(bias).for_each(|(mut column, &bias)| column.add_scalar_mut(bias));
}

/// dW = dy xᵀ, then db = Σ_batch dy.
fn layer_gradient(dy: &DMatrix<f64>, x: &DMatrix<f64>) -> Vec<f64> {
    let product = dy.transpose() * x;
    let bias = dy.column_iter().map(|column| column.sum());
    product.iter().copied().chain(bias).collect()
}

pub(super) fn square(x: f64) -> f64 {
    x * x
}

pub(super) fn agrees(ours: &Number, theirs: f64) -> bool {
    (ours.value - theirs).abs() <= ours.tolerance()
}
