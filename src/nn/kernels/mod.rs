//! The products of a dense layer and Adam's loop. For every float there is a naive [`mod@reference`], and for f32 there
//! are [`fast`] kernels with the same bits. Only this module has `unsafe` code.
//!
//! **The order of every sum is part of the result.** Each output element has one accumulator. It starts at the bias (or
//! at 0) and takes its products by fused multiply-add, the inner index running from first to last. The lanes of a
//! vector lie over outputs or over the batch, never over a sum. So the width of a vector changes no bit.
//!
//! **ReLU** is `if x < 0 { 0 } else { x }`, so −0 stays −0 and NaN stays NaN. Its gradient passes where the output is
//! above 0.
//!
//! **Adam's moments** of a unit that gets no gradient any more would decay into subnormal numbers, with which a CPU
//! computes a hundred times slower. So a moment whose magnitude is below 2⁻¹²⁶ becomes 0 (2⁻¹⁰²² in f64). That is the
//! smallest normal number, far below everything that moves a weight.

#[macro_use]
mod instruction_set;

#[allow(unsafe_code)]
#[cfg(target_arch = "x86_64")]
mod avx2;
#[allow(unsafe_code)]
#[cfg(target_arch = "x86_64")]
mod avx512;
#[allow(unsafe_code)]
pub mod fast;
mod float;
#[allow(unsafe_code)]
#[cfg(target_arch = "aarch64")]
mod neon;
#[allow(unsafe_code)]
mod product;
pub mod reference;
#[allow(unsafe_code)]
mod scalar;
#[allow(unsafe_code)]
mod vector;
#[allow(unsafe_code)]
#[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
mod wasm;

use nalgebra::DMatrix;

pub use fast::scratch_len;
pub(crate) use float::Float;
pub use float::mul_add_in_f64;
pub use instruction_set::InstructionSet;
pub use reference::AdamCoefficients;

/// The kernels that a network of this float computes with: the reference for f64, the fast kernels for f32. A scratch
/// has [`scratch_len`] numbers for f32. For f64 it may be empty.
pub trait Kernels: Float {
    /// [`reference::affine`].
    fn affine(x: &DMatrix<Self>, layer: &[Self], relu: bool, _scratch: &mut [Self], y: &mut DMatrix<Self>) {
        reference::affine(x, layer, relu, y);
    }

    /// [`reference::input_gradient`].
    fn input_gradient(
        dy: &DMatrix<Self>,
        layer: &[Self],
        x: &DMatrix<Self>,
        _scratch: &mut [Self],
        dx: &mut DMatrix<Self>,
    ) {
        reference::input_gradient(dy, layer, x, dx);
    }

    /// [`reference::layer_gradient`].
    fn layer_gradient(dy: &DMatrix<Self>, x: &DMatrix<Self>, _scratch: &mut [Self], gradient: &mut [Self]) {
        reference::layer_gradient(dy, x, gradient);
    }

    /// [`reference::adam`].
    fn adam(
        coefficients: &AdamCoefficients<Self>,
        parameters: &mut [Self],
        gradient: &[Self],
        first_moment: &mut [Self],
        second_moment: &mut [Self],
    ) -> bool {
        reference::adam(coefficients, parameters, gradient, first_moment, second_moment)
    }

    /// [`reference::soft_update`].
    fn soft_update(tau: Self, online: &[Self], target: &mut [Self]) {
        reference::soft_update(tau, online, target);
    }
}

impl Kernels for f64 {}

impl Kernels for f32 {
    fn affine(x: &DMatrix<f32>, layer: &[f32], relu: bool, scratch: &mut [f32], y: &mut DMatrix<f32>) {
        fast::affine(InstructionSet::current(), x, layer, relu, scratch, y);
    }

    fn input_gradient(
        dy: &DMatrix<f32>,
        layer: &[f32],
        x: &DMatrix<f32>,
        scratch: &mut [f32],
        dx: &mut DMatrix<f32>,
    ) {
        fast::input_gradient(InstructionSet::current(), dy, layer, x, scratch, dx);
    }

    fn layer_gradient(dy: &DMatrix<f32>, x: &DMatrix<f32>, scratch: &mut [f32], gradient: &mut [f32]) {
        fast::layer_gradient(InstructionSet::current(), dy, x, scratch, gradient);
    }

    fn adam(
        coefficients: &AdamCoefficients<f32>,
        parameters: &mut [f32],
        gradient: &[f32],
        first_moment: &mut [f32],
        second_moment: &mut [f32],
    ) -> bool {
        let instruction_set = InstructionSet::current();
        fast::adam(instruction_set, coefficients, parameters, gradient, first_moment, second_moment)
    }

    fn soft_update(tau: f32, online: &[f32], target: &mut [f32]) {
        fast::soft_update(InstructionSet::current(), tau, online, target);
    }
}
