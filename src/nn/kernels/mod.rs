//! The products of a dense layer and Adam's loop. For every float there is a naive [`mod@reference`], and for f32 there
//! are [`fast`] kernels with the same bits. Only this module has `unsafe` code.
//!
//! **The order of every sum is part of the result.** Each output element has one accumulator. It starts at the bias (or
//! at 0) and takes its products by fused multiply-add, the inner index running from first to last. The lanes of a
//! vector lie over outputs or over the batch, never over a sum. So the width of a vector changes no bit.
//!
//! **ReLU** is `if x < 0 { 0 } else { x }`: −0 stays −0 and NaN stays NaN. Its gradient passes where the output is above 0.
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

/// Declares the kernels, each with its inputs, its scratch if it needs any, and its outputs.
macro_rules! kernels {
    ($(
        fn $name:ident($($input:ident: $type:ty),*) [$($scratch:ident)?]
            ($($output:ident: $output_type:ty),*) $(-> $result:ty)?;
    )*) => {
        /// The kernels that a network of this float computes with: the reference for f64, the fast kernels for f32. A
        /// scratch has [`scratch_len`] numbers for f32. For f64 it may be empty.
        pub trait Kernels: Float {$(
            #[doc = concat!("[`reference::", stringify!($name), "`].")]
            fn $name($($input: $type,)* $($scratch: &mut [Self],)? $($output: $output_type),*) $(-> $result)? {
                $(let _ = $scratch;)?
                reference::$name($($input,)* $($output),*)
            }
        )*}

        impl Kernels for f64 {}

        impl Kernels for f32 {$(
            fn $name($($input: $type,)* $($scratch: &mut [Self],)? $($output: $output_type),*) $(-> $result)? {
                fast::$name(InstructionSet::current(), $($input,)* $($scratch,)? $($output),*)
            }
        )*}
    };
}

kernels! {
    fn affine(x: &DMatrix<Self>, layer: &[Self], relu: bool) [scratch] (y: &mut DMatrix<Self>);
    fn input_gradient(dy: &DMatrix<Self>, layer: &[Self], x: &DMatrix<Self>) [scratch] (dx: &mut DMatrix<Self>);
    fn layer_gradient(dy: &DMatrix<Self>, x: &DMatrix<Self>) [scratch] (gradient: &mut [Self]);
    fn adam(coefficients: &AdamCoefficients<Self>, parameters: &mut [Self], gradient: &[Self]) []
        (first_moment: &mut [Self], second_moment: &mut [Self]) -> bool;
    fn soft_update(tau: Self, online: &[Self]) [] (target: &mut [Self]);
}
