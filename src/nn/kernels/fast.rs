//! The kernels of [`reference`](mod@super::reference) in f32 with vectors: one source for all instruction sets.

use nalgebra::DMatrix;

use super::instruction_set::{InstructionSet, InstructionSetKind};
use super::product::{
    Bias, PACKED, Plain, Product, TALLEST, WherePositive, load, store, strip_len, transpose,
};

/// Defines a kernel from one body that is generic in the vector: the body compiled for every instruction set, and the
/// choice between them. The body may rely on it that the CPU has the vector's instruction set.
macro_rules! kernel {
    (
        $(#[$doc:meta])*
        pub fn $name:ident<$vector:ident>($($argument:ident: $type:ty),* $(,)?) $(-> $result:ty)? $body:block
    ) => {
        $(#[$doc])*
        ///
        /// # Panics
        /// When the shapes do not fit together.
        pub fn $name(instruction_set: InstructionSet, $($argument: $type),*) $(-> $result)? {
            #[inline(always)]
            unsafe fn body<$vector: super::vector::Vector>($($argument: $type),*) $(-> $result)? $body

            instruction_sets! { dispatch! instruction_set.0, ($($argument: $type),*) [$(-> $result)?] }
        }
    };
}

/// Calls the body that was compiled for an instruction set.
macro_rules! dispatch {
    (
        [$({ $kind:ident = $vector:ty, $cfg:meta $(, $features:tt)? })*]
        $instruction_set:expr, $arguments:tt $result:tt
    ) => {
        match $instruction_set {
            $(#[cfg($cfg)] InstructionSetKind::$kind => compiled! { $vector, [$($features)?] $arguments $result },)*
        }
    };
}

/// Compiles the body for an instruction set, and calls it.
macro_rules! compiled {
    (
        $vector:ty, [$($features:tt)?] ($($argument:ident: $type:ty),*) [$(-> $result:ty)?]
    ) => {{
        /// # Safety
        /// The CPU has the instruction set.
        $(#[target_feature(enable = $features)])?
        unsafe fn compiled($($argument: $type),*) $(-> $result)? {
            // SAFETY: the caller vouches for the instruction set.
            unsafe { body::<$vector>($($argument),*) }
        }
        // SAFETY: an `InstructionSet` is made only where the CPU has it.
        unsafe { compiled($($argument),*) }
    }};
}

/// Up to so many outputs are few for the gradient of a layer. The lanes then lie over the inputs.
const FEW: usize = 4;

/// Numbers of scratch that the kernels need for a `batch` and a network whose widest layer has `widest` units.
pub const fn scratch_len(batch: usize, widest: usize) -> usize {
    strip_len(batch) + FEW * widest
}

/// Whether `layer` has the length of a weight (in, out) and a bias (out). A product that overflows fits no layer.
fn fits_layer(layer: &[f32], inputs: usize, outputs: usize) -> bool {
    inputs.checked_add(1).and_then(|rows| rows.checked_mul(outputs)) == Some(layer.len())
}

/// A layer's weight, or with the other strides its transpose, times a batch B.
#[inline(always)]
fn of_batch(
    layer: &[f32], [a_row_stride, a_column_stride]: [usize; 2], b: &DMatrix<f32>, scratch: &mut [f32],
    c: &mut DMatrix<f32>,
) -> Product {
    let (columns, rows) = c.shape();
    Product {
        rows,
        columns,
        inner: b.ncols(),
        a: layer.as_ptr(),
        a_row_stride,
        a_column_stride,
        b: b.as_slice().as_ptr(),
        b_stride: columns,
        b_is_transposed: false,
        sums_b: false,
        scratch: scratch.as_mut_ptr(),
        c: c.as_mut_slice().as_mut_ptr(),
    }
}

kernel! {
    /// See [`super::reference::affine`].
    pub fn affine<V>(x: &DMatrix<f32>, layer: &[f32], relu: bool, scratch: &mut [f32], y: &mut DMatrix<f32>) {
        let (batch, inputs, outputs) = (x.nrows(), x.ncols(), y.ncols());
        assert!(fits_layer(layer, inputs, outputs) && y.nrows() == batch && scratch.len() >= PACKED);
        let bias = layer[inputs * outputs..].as_ptr();
        let product = of_batch(layer, [1, outputs], x, scratch, y);
        // SAFETY: the CPU has the instruction set, and the operands have the asserted sizes.
        unsafe {
            if batch == 1 {
                // A batch of one would leave lanes empty. So the lanes lie over the outputs.
                let (rows, columns, a, b) = (1, outputs, product.b, product.a);
                let swapped =
                    Product { rows, columns, a, a_row_stride: 0, a_column_stride: 1, b, b_stride: outputs, ..product };
                swapped.compute::<V, 1>(Bias::<false> { bias, relu });
            } else {
                product.compute::<V, TALLEST>(Bias::<true> { bias, relu });
            }
        }
    }
}

kernel! {
    /// See [`super::reference::input_gradient`].
    pub fn input_gradient<V>(
        dy: &DMatrix<f32>, layer: &[f32], x: &DMatrix<f32>, scratch: &mut [f32], dx: &mut DMatrix<f32>,
    ) {
        let (batch, inputs, outputs) = (x.nrows(), x.ncols(), dy.ncols());
        assert!(fits_layer(layer, inputs, outputs) && dy.nrows() == batch && dx.shape() == x.shape());
        assert!(scratch.len() >= PACKED);
        let product = of_batch(layer, [outputs, 1], dy, scratch, dx);
        // SAFETY: the CPU has the instruction set, and the operands have the asserted sizes.
        unsafe { product.compute::<V, TALLEST>(WherePositive { x: x.as_slice().as_ptr(), columns: batch }) }
    }
}

kernel! {
    /// See [`super::reference::layer_gradient`].
    pub fn layer_gradient<V>(dy: &DMatrix<f32>, x: &DMatrix<f32>, scratch: &mut [f32], gradient: &mut [f32]) {
        let (batch, inputs, outputs) = (x.nrows(), x.ncols(), dy.ncols());
        assert!(fits_layer(gradient, inputs, outputs) && dy.nrows() == batch);
        assert!(scratch.len() >= scratch_len(batch, inputs.max(outputs)));
        let (scratch, few) = scratch.split_at_mut(strip_len(batch));
        let (scratch, few) = (scratch.as_mut_ptr(), few.as_mut_ptr());
        let (x, dy) = (x.as_slice(), dy.as_slice());
        let product = Product {
            rows: inputs,
            columns: outputs,
            inner: batch,
            a: x.as_ptr(),
            a_row_stride: batch,
            a_column_stride: 1,
            b: dy.as_ptr(),
            b_stride: batch,
            b_is_transposed: true,
            sums_b: true,
            scratch,
            c: gradient.as_mut_ptr(),
        };
        // SAFETY: the CPU has the instruction set, and the operands have the asserted sizes. In `gradient` the bias,
        // which is the sum of B's rows, follows the weight.
        unsafe {
            if outputs > FEW || outputs >= inputs {
                product.compute::<V, TALLEST>(Plain);
            } else {
                // Few outputs would leave lanes empty. So the lanes lie over the inputs.
                let (a, b) = (product.b, product.a);
                let swapped = Product { rows: outputs, columns: inputs, a, b, sums_b: false, c: few, ..product };
                swapped.compute::<V, TALLEST>(Plain);
                let (weight, bias) = gradient.split_at_mut(inputs * outputs);
                transpose::<V>(few, inputs, outputs, inputs, weight.as_mut_ptr(), outputs);
                for (bias, dy) in bias.iter_mut().zip(dy.chunks_exact(batch)) {
                    *bias = dy.iter().fold(0.0, |sum, dy| sum + dy);
                }
            }
        }
    }
}

kernel! {
    /// See [`super::reference::adam`].
    pub fn adam<V>(
        coefficients: &super::reference::AdamCoefficients<f32>,
        parameters: &mut [f32],
        gradient: &[f32],
        first_moment: &mut [f32],
        second_moment: &mut [f32],
    ) -> bool {
        let len = parameters.len();
        assert!(gradient.len() == len && first_moment.len() == len && second_moment.len() == len);
        let (parameters, gradient) = (parameters.as_mut_ptr(), gradient.as_ptr());
        let (first_moment, second_moment) = (first_moment.as_mut_ptr(), second_moment.as_mut_ptr());
        let c = coefficients;
        // SAFETY: the CPU has the instruction set, and every access is below `len`.
        unsafe {
            let (beta1, one_minus_beta1) = (V::splat(c.beta1), V::splat(c.one_minus_beta1));
            let (beta2, one_minus_beta2) = (V::splat(c.beta2), V::splat(c.one_minus_beta2));
            let (minus_step_size, epsilon) = (V::splat(-c.step_size), V::splat(c.epsilon));
            let second_moment_scale = V::splat(c.second_moment_scale);
            // The sum of all 0 · θ, which is 0 if every θ is finite, else NaN.
            let mut zeros = V::splat(0.0);
            let mut index = 0;
            while index < len {
                let lanes = V::LANES.min(len - index);
                let g: V = load(gradient.add(index), lanes);
                let m: V = load(first_moment.add(index), lanes);
                let v: V = load(second_moment.add(index), lanes);
                let m = beta1.mul_add(m, one_minus_beta1.mul(g)).flush();
                let v = beta2.mul_add(v, one_minus_beta2.mul(g).mul(g)).flush();
                let step = m.div(v.sqrt().mul_add(second_moment_scale, epsilon));
                let parameter = minus_step_size.mul_add(step, load(parameters.add(index), lanes));
                zeros = parameter.mul_add(V::splat(0.0), zeros);
                store(m, first_moment.add(index), lanes);
                store(v, second_moment.add(index), lanes);
                store(parameter, parameters.add(index), lanes);
                index += lanes;
            }
            let mut lanes = [0.0; 16];
            zeros.store(lanes.as_mut_ptr());
            lanes.iter().all(|&zero| zero == 0.0)
        }
    }
}

kernel! {
    /// See [`super::reference::soft_update`].
    pub fn soft_update<V>(tau: f32, online: &[f32], target: &mut [f32]) {
        let len = target.len();
        assert!(online.len() == len);
        let (online, target) = (online.as_ptr(), target.as_mut_ptr());
        // SAFETY: the CPU has the instruction set, and every access is below `len`.
        unsafe {
            let (tau, minus_one) = (V::splat(tau), V::splat(-1.0));
            let mut index = 0;
            while index < len {
                let lanes = V::LANES.min(len - index);
                let t: V = load(target.add(index), lanes);
                let difference = t.mul_add(minus_one, load(online.add(index), lanes));
                store(tau.mul_add(difference, t), target.add(index), lanes);
                index += lanes;
            }
        }
    }
}

kernel! {
    /// Computes x ← x · `factor` + `summand` `rounds` times, on as many independent vectors as keep the CPU's
    /// multipliers busy. Returns how many multiply-adds that were, and a sum of the vectors. The benchmarks measure
    /// with it the highest rate at which this CPU can compute.
    #[doc(hidden)]
    pub fn peak<V>(rounds: u64, factor: f32, summand: f32) -> (u64, f32) {
        const VECTORS: usize = 12;
        // SAFETY: the CPU has the instruction set, and no vector has more than 16 lanes.
        unsafe {
            let (factor, summand) = (V::splat(factor), V::splat(summand));
            let mut vectors: [V; VECTORS] = std::array::from_fn(|index| V::splat(index as f32));
            for _ in 0..rounds {
                for vector in &mut vectors {
                    *vector = vector.mul_add(factor, summand);
                }
            }
            let mut lanes = [0.0; 16];
            let sum = vectors.into_iter().reduce(|sum, vector| vector.mul_add(factor, sum));
            sum.unwrap_or(summand).store(lanes.as_mut_ptr());
            (rounds * (VECTORS * V::LANES) as u64, lanes.iter().sum())
        }
    }
}
