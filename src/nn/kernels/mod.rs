//! The products of a dense layer and Adam's loop: a naive reference for every float, and for f32 a fast path
//! with the same bits. The only place with `unsafe`.
//!
//! **The order of every sum is part of the result.** Each output element has one accumulator; it starts at the
//! bias (or at 0) and takes its products by fused multiply-add, the inner index running from first to last.
//! Vector lanes lie over outputs or over the batch, never over a sum, so a path's width changes no bit.
//!
//! **ReLU** is `if x < 0 { 0 } else { x }`: −0 stays −0 and NaN stays NaN. Its gradient passes where the output is
//! above 0.
//!
//! **Adam's moments** of a unit that no longer gets a gradient decay until they are subnormal numbers, with which a CPU
//! computes a hundred times slower. So a moment whose magnitude is below 2⁻¹²⁶ becomes 0 (2⁻¹⁰²² in f64): the smallest
//! normal number, far below everything that moves a weight.

#[allow(unsafe_code, unsafe_op_in_unsafe_fn)]
pub mod fast;
pub mod reference;
#[allow(unsafe_code, unsafe_op_in_unsafe_fn)]
mod vector;

use nalgebra::DMatrix;

pub use super::adam::AdamCoefficients;
pub use fast::{Path, UnknownPath, scratch_len};

/// f32 or f64, with the kernels that compute in it. f64 runs the reference.
pub trait Float:
    nalgebra::Scalar
    + Copy
    + PartialOrd
    + std::ops::Add<Output = Self>
    + std::ops::Sub<Output = Self>
    + std::ops::Mul<Output = Self>
    + std::ops::Div<Output = Self>
    + std::ops::Neg<Output = Self>
    + std::ops::AddAssign
{
    /// 0
    const ZERO: Self;
    /// 1
    const ONE: Self;

    /// The nearest number of this type.
    fn from_f64(value: f64) -> Self;
    /// self · factor + summand, rounded once.
    fn mul_add(self, factor: Self, summand: Self) -> Self;
    /// √self
    fn sqrt(self) -> Self;
    /// |self|
    fn abs(self) -> Self;
    /// self, or 0 where |self| is below the smallest normal number; NaN stays NaN.
    fn flush(self) -> Self;
    /// self, limited to `low`…`high`.
    fn clamp(self, low: Self, high: Self) -> Self;

    /// y = W x + b, with ReLU if asked for. x is (batch, in), `layer` is W (in, out) and b (out), y (batch, out);
    /// for the scratch see [`scratch_len`].
    fn affine(x: &DMatrix<Self>, layer: &[Self], relu: bool, _scratch: &mut [Self], y: &mut DMatrix<Self>) {
        reference::affine(x, layer, relu, y);
    }

    /// dx = Wᵀ dy where x > 0, else 0. dy is (batch, out), `layer` as in [`Self::affine`], x and dx (batch, in).
    fn input_gradient(
        dy: &DMatrix<Self>,
        layer: &[Self],
        x: &DMatrix<Self>,
        _scratch: &mut [Self],
        dx: &mut DMatrix<Self>,
    ) {
        reference::input_gradient(dy, layer, x, dx);
    }

    /// dW = dy xᵀ (in, out) and db = Σ_batch dy (out), into `gradient`. dy is (batch, out), x (batch, in).
    fn layer_gradient(dy: &DMatrix<Self>, x: &DMatrix<Self>, _scratch: &mut [Self], gradient: &mut [Self]) {
        reference::layer_gradient(dy, x, gradient);
    }

    /// Adam's loop over parameters θ, gradient g and moments m, v; returns whether every θ is finite after it.
    fn adam(
        coefficients: &AdamCoefficients<Self>,
        parameters: &mut [Self],
        gradient: &[Self],
        first_moment: &mut [Self],
        second_moment: &mut [Self],
    ) -> bool {
        reference::adam(coefficients, parameters, gradient, first_moment, second_moment)
    }

    /// θ⁻ ← τ (θ − θ⁻) + θ⁻ with one fused multiply-add, for every parameter; `target` is θ⁻, `online` θ.
    fn soft_update(tau: Self, online: &[Self], target: &mut [Self]) {
        reference::soft_update(tau, online, target);
    }
}

macro_rules! float {
    ($type:ty { $($kernels:tt)* }) => {
        impl Float for $type {
            const ZERO: Self = 0.0;
            const ONE: Self = 1.0;

            #[allow(clippy::cast_possible_truncation)]
            fn from_f64(value: f64) -> Self {
                value as Self
            }
            #[inline(always)]
            fn mul_add(self, factor: Self, summand: Self) -> Self {
                self.mul_add(factor, summand)
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                self.sqrt()
            }
            fn abs(self) -> Self {
                self.abs()
            }
            #[inline(always)]
            fn flush(self) -> Self {
                if self.abs() < Self::MIN_POSITIVE { 0.0 } else { self }
            }
            fn clamp(self, low: Self, high: Self) -> Self {
                self.clamp(low, high)
            }
            $($kernels)*
        }
    };
}

float!(f64 {});
float!(f32 {
    fn affine(x: &DMatrix<f32>, layer: &[f32], relu: bool, scratch: &mut [f32], y: &mut DMatrix<f32>) {
        fast::affine(Path::current(), x, layer, relu, scratch, y);
    }
    fn input_gradient(
        dy: &DMatrix<f32>,
        layer: &[f32],
        x: &DMatrix<f32>,
        scratch: &mut [f32],
        dx: &mut DMatrix<f32>,
    ) {
        fast::input_gradient(Path::current(), dy, layer, x, scratch, dx);
    }
    fn layer_gradient(dy: &DMatrix<f32>, x: &DMatrix<f32>, scratch: &mut [f32], gradient: &mut [f32]) {
        fast::layer_gradient(Path::current(), dy, x, scratch, gradient);
    }
    fn adam(
        coefficients: &AdamCoefficients<f32>,
        parameters: &mut [f32],
        gradient: &[f32],
        first_moment: &mut [f32],
        second_moment: &mut [f32],
    ) -> bool {
        fast::adam(Path::current(), coefficients, parameters, gradient, first_moment, second_moment)
    }
    fn soft_update(tau: f32, online: &[f32], target: &mut [f32]) {
        fast::soft_update(Path::current(), tau, online, target);
    }
});
