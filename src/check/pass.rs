//! A network's passes in f64, with the rounding of every number.

use nalgebra::{DMatrix, DMatrixView};

use super::activation::LayerKinds;
use super::rounding::{Matrix, Number, square};
use crate::nn::Mlp;

/// A forward pass: what each layer got, and what it gave before its activation.
pub(super) struct Pass {
    inputs: Vec<Matrix>,
    /// (batch, units)
    pub(super) outputs: Vec<Matrix>,
    /// Q(s, ·)
    pub(super) q: Matrix,
    activations: LayerKinds,
}

/// y = W x + b for every layer, with an activation between them and one behind the last.
pub(super) fn forward(
    network: &Mlp<f64>, observations: &DMatrix<f64>, activations: LayerKinds, unit: f64,
) -> Pass {
    let batch = observations.nrows();
    let (mut all_inputs, mut all_outputs) = (Vec::new(), Vec::new());
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
        let is_last = index + 1 == network.num_layers();
        let activation = if is_last { activations.output } else { activations.hidden };
        all_inputs.push(std::mem::replace(&mut x, activation.of_all(&y, unit)));
        all_outputs.push(y);
    }
    Pass { inputs: all_inputs, outputs: all_outputs, q: x, activations }
}

/// Adds to `gradient` that by the parameters of the layers from `first` on, in their order; `dy` is that by the output.
pub(super) fn backward(
    network: &Mlp<f64>, pass: &Pass, mut dy: Matrix, unit: f64, first: usize, gradient: &mut [Number],
) {
    let growth = square(unit) * dy.value.nrows() as f64;
    let mut end = gradient.len();
    pass.activations.output.backward(&mut dy, &pass.outputs[network.num_layers() - 1], &pass.q, unit);
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
            dy = by_input(layer, &dy, unit);
            pass.activations.hidden.backward(&mut dy, &pass.outputs[index - 1], &pass.inputs[index], unit);
        }
    }
}

/// The gradient by what a layer got.
fn by_input(layer: &[f64], dy: &Matrix, unit: f64) -> Matrix {
    let growth = square(unit) * dy.value.ncols() as f64;
    let squares: Vec<f64> = layer.iter().copied().map(square).collect();
    let mut dx = Matrix {
        value: &dy.value * weights(layer, dy.value.ncols()),
        variance: &dy.spread(growth) * weights(&squares, dy.value.ncols()),
    };
    dx.variance = dx.spread(growth);
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
    product.iter().copied().chain(dy.column_iter().map(|column| column.sum())).collect()
}
