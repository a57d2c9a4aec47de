//! A multilayer perceptron: dense layers, ReLU between them, linear output.

use nalgebra::DMatrix;

use super::kernels::scratch_len;
use super::{Kernels, NetworkConfig};
use crate::rng::Rng;

#[derive(Clone, Debug, PartialEq)]
pub struct Mlp<T> {
    sizes: Vec<usize>,
    /// Where each layer begins in the parameters, and where the last one ends.
    starts: Vec<usize>,
    parameters: Vec<T>,
}

/// The outputs of every layer for one batch, the input first, each (batch, features); and, after a backward
/// pass, the loss's gradient by them.
#[derive(Clone, Debug)]
pub struct Activations<T> {
    layers: Vec<DMatrix<T>>,
    gradients: Vec<DMatrix<T>>,
    scratch: Vec<T>,
}

impl<T: Kernels> Activations<T> {
    pub fn new(sizes: &[usize], batch: usize) -> Self {
        let layers: Vec<_> = sizes.iter().map(|&size| DMatrix::from_element(batch, size, T::ZERO)).collect();
        let widest = sizes.iter().copied().max().unwrap_or(0);
        Self { gradients: layers.clone(), layers, scratch: vec![T::ZERO; scratch_len(batch, widest)] }
    }

    pub fn input_mut(&mut self) -> &mut DMatrix<T> {
        &mut self.layers[0]
    }

    pub(crate) fn set_input(&mut self, input: &DMatrix<T>) {
        self.layers[0].as_mut_slice().copy_from_slice(input.as_slice());
    }

    /// Copies observations into the first rows of the network's input.
    pub(crate) fn set_rows<'a>(&mut self, rows: impl Iterator<Item = &'a [T]>) {
        let batch = self.layers[0].nrows();
        let input = self.layers[0].as_mut_slice();
        for (sample, row) in rows.enumerate() {
            for (value, &feature) in input[sample..].iter_mut().step_by(batch).zip(row) {
                *value = feature;
            }
        }
    }

    /// The network's output, (batch, out).
    pub fn output(&self) -> &DMatrix<T> {
        &self.layers[self.layers.len() - 1]
    }

    pub(crate) fn hidden(&self) -> &[DMatrix<T>] {
        &self.layers[1..self.layers.len() - 1]
    }

    /// The output, and the loss's gradient by it, to be filled in before [`Mlp::backward`].
    pub fn output_and_gradient_mut(&mut self) -> (&DMatrix<T>, &mut DMatrix<T>) {
        let last = self.layers.len() - 1;
        (&self.layers[last], &mut self.gradients[last])
    }
}

impl Mlp<f32> {
    pub fn new(config: &NetworkConfig, observation_size: usize, num_actions: usize, rng: &mut Rng) -> Self {
        let mut mlp = Self::zeros(config.sizes(observation_size, num_actions));
        for layer in 0..mlp.num_layers() {
            let (inputs, outputs) = (mlp.sizes[layer], mlp.sizes[layer + 1]);
            let (weight, bias) = mlp.layer_mut(layer).split_at_mut(inputs * outputs);
            config.init.fill(weight, bias, rng);
        }
        mlp
    }
}

impl<T: Kernels> Mlp<T> {
    /// A network of these layer sizes (at least input and output) with all parameters 0.
    pub fn zeros(sizes: Vec<usize>) -> Self {
        let mut starts = vec![0];
        for (layer, pair) in sizes.windows(2).enumerate() {
            starts.push(starts[layer] + (pair[0] + 1) * pair[1]);
        }
        Self { parameters: vec![T::ZERO; starts[starts.len() - 1]], sizes, starts }
    }

    pub fn sizes(&self) -> &[usize] {
        &self.sizes
    }

    pub fn num_layers(&self) -> usize {
        self.sizes.len() - 1
    }

    /// All parameters, layer by layer, each layer's weight (in, out) before its bias (out).
    pub fn parameters(&self) -> &[T] {
        &self.parameters
    }

    pub fn parameters_mut(&mut self) -> &mut [T] {
        &mut self.parameters
    }

    /// Makes this network a copy of `other`, which has the same sizes.
    pub fn copy_from(&mut self, other: &Self) {
        self.parameters.copy_from_slice(&other.parameters);
    }

    /// Moves the share `tau` of the way to `other`, which has the same sizes: θ⁻ ← θ⁻ + τ (θ − θ⁻).
    pub(crate) fn move_towards(&mut self, other: &Self, tau: T) {
        T::soft_update(tau, &other.parameters, &mut self.parameters);
    }

    /// A layer's weight (in, out) and, behind it, its bias (out).
    pub fn layer(&self, layer: usize) -> &[T] {
        &self.parameters[self.range(layer)]
    }

    pub fn layer_mut(&mut self, layer: usize) -> &mut [T] {
        let range = self.range(layer);
        &mut self.parameters[range]
    }

    fn range(&self, layer: usize) -> std::ops::Range<usize> {
        self.starts[layer]..self.starts[layer + 1]
    }

    /// x₁ = ReLU(W₁ x₀ + b₁), …, xₗ = Wₗ xₗ₋₁ + bₗ, from the input that is in `activations`.
    pub fn forward(&self, activations: &mut Activations<T>) {
        for layer in 0..self.num_layers() {
            let (before, after) = activations.layers.split_at_mut(layer + 1);
            let relu = layer + 1 < self.num_layers();
            T::affine(&before[layer], self.layer(layer), relu, &mut activations.scratch, &mut after[0]);
        }
    }

    /// The gradient of the loss by every parameter, from the gradient by the output that is in `activations`
    /// (Rumelhart, Hinton and Williams 1986). With δₗ the gradient by layer l's output before its ReLU:
    ///
    /// ```text
    /// ∂L/∂Wₗ = δₗ xₗ₋₁ᵀ      ∂L/∂bₗ = Σ_batch δₗ      δₗ₋₁ = (Wₗᵀ δₗ) where xₗ₋₁ > 0, else 0
    /// ```
    pub fn backward(&self, activations: &mut Activations<T>, gradient: &mut Mlp<T>) {
        let Activations { layers, gradients, scratch } = activations;
        for layer in (0..self.num_layers()).rev() {
            let (before, after) = gradients.split_at_mut(layer + 1);
            T::layer_gradient(&after[0], &layers[layer], scratch, gradient.layer_mut(layer));
            if layer > 0 {
                T::input_gradient(&after[0], self.layer(layer), &layers[layer], scratch, &mut before[layer]);
            }
        }
    }
}
