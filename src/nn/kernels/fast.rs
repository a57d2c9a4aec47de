//! The kernels in f32 with vectors. One source for every instruction set, chosen at run time.
//!
//! All three products of a layer are one: C = init + A B, with A read a number at a time and the lanes along the
//! rows of B and C. A tile of C stays in registers while the inner index runs.

use std::sync::OnceLock;

use nalgebra::DMatrix;

#[cfg(target_arch = "x86_64")]
use super::vector::{Avx2, Avx512};
use super::vector::{Scalar, Vector};
use crate::nn::adam::AdamCoefficients;

/// The instruction set that the kernels run on. All give the same bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Path {
    /// Any CPU.
    Scalar,
    /// x86-64 with AVX2 and FMA.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// x86-64 with AVX-512F.
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

/// `CARTPOLE_DQN_SIMD` asks for what this CPU does not have.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{} is {asked:?}; this CPU can run {}", Path::VARIABLE, Path::available().iter().map(|path| path.name()).collect::<Vec<_>>().join(", "))]
pub struct UnknownPath {
    asked: String,
}

impl Path {
    /// The environment variable that forces a path, for tests and comparisons.
    pub const VARIABLE: &str = "CARTPOLE_DQN_SIMD";

    /// What the kernels use: see [`Self::from_environment`]; the fastest if that fails.
    pub fn current() -> Self {
        static PATH: OnceLock<Path> = OnceLock::new();
        *PATH.get_or_init(|| Self::from_environment().unwrap_or(Self::available()[0]))
    }

    /// The path that [`Self::VARIABLE`] names (`scalar`, `avx2`, `avx512`), or else the fastest.
    ///
    /// # Errors
    /// When it names none that this CPU has.
    pub fn from_environment() -> Result<Self, UnknownPath> {
        let available = Self::available();
        let Some(asked) = std::env::var_os(Self::VARIABLE) else { return Ok(available[0]) };
        let asked = asked.to_string_lossy().into_owned();
        available.into_iter().find(|path| path.name() == asked).ok_or(UnknownPath { asked })
    }

    /// All that this CPU has, the fastest first.
    pub fn available() -> Vec<Self> {
        let mut paths = vec![Self::Scalar];
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            paths.push(Self::Avx2);
            if is_x86_feature_detected!("avx512f") {
                paths.push(Self::Avx512);
            }
        }
        paths.reverse();
        paths
    }

    /// Its name in [`Self::VARIABLE`].
    pub fn name(self) -> &'static str {
        match self {
            Self::Scalar => "scalar",
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => "avx2",
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => "avx512",
        }
    }
}

/// Defines a kernel from one generic body: the body compiled for every instruction set, and the choice.
macro_rules! kernel {
    ($(#[$doc:meta])* pub fn $name:ident<$vector:ident>($($argument:ident: $type:ty),* $(,)?) $(-> $result:ty)? $body:block) => {
        $(#[$doc])*
        ///
        /// # Panics
        /// When the shapes do not fit together.
                pub fn $name(path: Path, $($argument: $type),*) $(-> $result)? {
            #[inline(always)]
            unsafe fn body<$vector: Vector>($($argument: $type),*) $(-> $result)? $body

            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2,fma")]
            fn avx2($($argument: $type),*) $(-> $result)? {
                // SAFETY: this function is compiled for AVX2 and FMA.
                unsafe { body::<Avx2>($($argument),*) }
            }
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx512f,avx2,fma")]
            fn avx512($($argument: $type),*) $(-> $result)? {
                // SAFETY: this function is compiled for AVX-512F.
                unsafe { body::<Avx512>($($argument),*) }
            }
            match path {
                // SAFETY: the scalar vector needs no instruction set.
                Path::Scalar => unsafe { body::<Scalar>($($argument),*) },
                // SAFETY: a path is made only where the CPU has it.
                #[cfg(target_arch = "x86_64")]
                Path::Avx2 => unsafe { avx2($($argument),*) },
                // SAFETY: a path is made only where the CPU has it.
                #[cfg(target_arch = "x86_64")]
                Path::Avx512 => unsafe { avx512($($argument),*) },
            }
        }
    };
}

kernel! {
    /// See [`super::Float::affine`].
    pub fn affine<V>(
        x: &DMatrix<f32>,
        layer: &[f32],
        relu: bool,
        scratch: &mut [f32],
        y: &mut DMatrix<f32>,
    ) {
        let (batch, inputs, outputs) = (x.nrows(), x.ncols(), y.ncols());
        assert!(scratch.len() >= PACKED && y.nrows() == batch && layer.len() == (inputs + 1) * outputs);
        let bias = layer[inputs * outputs..].as_ptr();
        let scratch = scratch.as_mut_ptr();
        // SAFETY: the operands have the asserted sizes.
        unsafe {
            if batch == 1 {
                // One row whose lanes run over the outputs.
                let product = Product {
                    rows: 1,
                    columns: outputs,
                    inner: inputs,
                    a: x.as_slice().as_ptr(),
                    a_row: 0,
                    a_column: 1,
                    b: layer.as_ptr(),
                    b_row: outputs,
                    b_is_transposed: false,
                    sums_b: false,
                    scratch,
                    c: y.as_mut_slice().as_mut_ptr(),
                };
                product.compute::<V, 1>(RowBias { bias, relu });
            } else {
                let product = Product {
                    rows: outputs,
                    columns: batch,
                    inner: inputs,
                    a: layer.as_ptr(),
                    a_row: 1,
                    a_column: outputs,
                    b: x.as_slice().as_ptr(),
                    b_row: batch,
                    b_is_transposed: false,
                    sums_b: false,
                    scratch,
                    c: y.as_mut_slice().as_mut_ptr(),
                };
                product.compute::<V, TALLEST>(ColumnBias { bias, relu });
            }
        }
    }
}

kernel! {
    /// See [`super::Float::input_gradient`].
    pub fn input_gradient<V>(
        dy: &DMatrix<f32>,
        layer: &[f32],
        x: &DMatrix<f32>,
        scratch: &mut [f32],
        dx: &mut DMatrix<f32>,
    ) {
        let (batch, inputs, outputs) = (x.nrows(), x.ncols(), dy.ncols());
        assert!(scratch.len() >= PACKED && dx.shape() == x.shape() && dy.nrows() == batch && layer.len() == (inputs + 1) * outputs);
        let product = Product {
            rows: inputs,
            columns: batch,
            inner: outputs,
            a: layer.as_ptr(),
            a_row: outputs,
            a_column: 1,
            b: dy.as_slice().as_ptr(),
            b_row: batch,
            b_is_transposed: false,
            sums_b: false,
            scratch: scratch.as_mut_ptr(),
            c: dx.as_mut_slice().as_mut_ptr(),
        };
        // SAFETY: the operands have the asserted sizes.
        unsafe { product.compute::<V, TALLEST>(WherePositive { x: x.as_slice().as_ptr(), columns: batch }) }
    }
}

kernel! {
    /// See [`super::Float::layer_gradient`].
    pub fn layer_gradient<V>(
        dy: &DMatrix<f32>,
        x: &DMatrix<f32>,
        scratch: &mut [f32],
        gradient: &mut [f32],
    ) {
        let (batch, inputs, outputs) = (x.nrows(), x.ncols(), dy.ncols());
        assert!(dy.nrows() == batch && gradient.len() == (inputs + 1) * outputs);
        assert!(scratch.len() >= scratch_len(batch, inputs.max(outputs)));
        let (scratch, few) = scratch.split_at_mut(strip_len(batch));
        let (scratch, few) = (scratch.as_mut_ptr(), few.as_mut_ptr());
        let (x, dy) = (x.as_slice(), dy.as_slice());
        let product = Product {
            rows: inputs,
            columns: outputs,
            inner: batch,
            a: x.as_ptr(),
            a_row: batch,
            a_column: 1,
            b: dy.as_ptr(),
            b_row: batch,
            b_is_transposed: true,
            sums_b: true,
            scratch,
            c: gradient.as_mut_ptr(),
        };
        // SAFETY: the operands have the asserted sizes; the bias, the sum of B's rows, follows the weight.
        unsafe {
            if outputs > FEW || outputs >= inputs {
                product.compute::<V, TALLEST>(Plain);
            } else {
                // Few outputs would leave lanes empty: so the lanes lie over the inputs.
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
    /// See [`super::Float::adam`].
    pub fn adam<V>(
        coefficients: &AdamCoefficients<f32>,
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
        // SAFETY: every access is below `len`.
        unsafe {
            let (beta1, one_minus_beta1) = (V::splat(c.beta1), V::splat(c.one_minus_beta1));
            let (beta2, one_minus_beta2) = (V::splat(c.beta2), V::splat(c.one_minus_beta2));
            let (minus_step_size, epsilon) = (V::splat(-c.step_size), V::splat(c.epsilon));
            let second_moment_scale = V::splat(c.second_moment_scale);
            // 0 · θ is 0 exactly where θ is finite, else NaN.
            let mut zeros = V::splat(0.0);
            let mut index = 0;
            while index < len {
                let lanes = V::LANES.min(len - index);
                let g: V = load(gradient.add(index), lanes);
                let m: V = load(first_moment.add(index), lanes);
                let v: V = load(second_moment.add(index), lanes);
                let m = beta1.mul_add(m, one_minus_beta1.mul(g));
                let v = beta2.mul_add(v, one_minus_beta2.mul(g).mul(g));
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
    /// See [`super::Float::soft_update`].
    pub fn soft_update<V>(tau: f32, online: &[f32], target: &mut [f32]) {
        let len = target.len();
        assert!(online.len() == len);
        let (online, target) = (online.as_ptr(), target.as_mut_ptr());
        // SAFETY: every access is below `len`.
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
    /// `rounds` times x ← x · `factor` + `summand` on as many independent vectors as keep the units busy; returns the
    /// multiply-adds done and a sum of the vectors. The benchmarks' measure of the machine's peak.
    pub fn peak<V>(rounds: u64, factor: f32, summand: f32) -> (u64, f32) {
        const VECTORS: usize = 12;
        // SAFETY: the macro calls this where the instruction set is there.
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

/// The operands of C = start + A B: C is (rows, columns), A (rows, inner), B (inner, columns), C row-major.
#[derive(Clone, Copy)]
struct Product {
    rows: usize,
    columns: usize,
    inner: usize,
    a: *const f32,
    /// How far apart A's rows are, and its columns.
    a_row: usize,
    a_column: usize,
    b: *const f32,
    /// How far apart B's rows are, or those of its transpose if that is what is in memory.
    b_row: usize,
    b_is_transposed: bool,
    /// Whether C has one more row: the sum of B's rows.
    sums_b: bool,
    c: *mut f32,
    /// Room for a strip of B: see [`strip_len`].
    scratch: *mut f32,
}

/// Numbers that a strip of B is packed into, if it fits: half of an L1 cache.
const PACKED: usize = 16 * 256;

/// Rows of the tallest tile.
const TALLEST: usize = 12;

/// Up to so many outputs are few for the gradient of a layer.
const FEW: usize = 4;

/// Numbers of scratch that the kernels need for batches through a network whose widest layer has `widest` units.
pub const fn scratch_len(batch: usize, widest: usize) -> usize {
    strip_len(batch) + FEW * widest
}

/// Numbers in a strip of B: packed, or `batch` rows of the four widest vectors.
const fn strip_len(batch: usize) -> usize {
    if batch * 64 > PACKED { batch * 64 } else { PACKED }
}

/// The initial value of an accumulator (bias or 0), and what happens to the sum before it is stored (ReLU, mask). Only the
/// first `lanes` lanes are valid.
trait Ends: Copy {
    unsafe fn start<V: Vector>(self, row: usize, column: usize, lanes: usize) -> V;
    unsafe fn finish<V: Vector>(self, sum: V, row: usize, column: usize, lanes: usize) -> V;
}

/// From 0, stored as it is.
#[derive(Clone, Copy)]
struct Plain;

/// From one bias per row of C, stored through ReLU if asked for.
#[derive(Clone, Copy)]
struct ColumnBias {
    bias: *const f32,
    relu: bool,
}

/// From one bias per column of C, stored through ReLU if asked for.
#[derive(Clone, Copy)]
struct RowBias {
    bias: *const f32,
    relu: bool,
}

/// From 0, stored where the same element of `x` is positive, else 0.
#[derive(Clone, Copy)]
struct WherePositive {
    x: *const f32,
    columns: usize,
}

impl Ends for Plain {
    #[inline(always)]
    unsafe fn start<V: Vector>(self, _: usize, _: usize, _: usize) -> V {
        V::splat(0.0)
    }
    #[inline(always)]
    unsafe fn finish<V: Vector>(self, sum: V, _: usize, _: usize, _: usize) -> V {
        sum
    }
}

impl Ends for ColumnBias {
    #[inline(always)]
    unsafe fn start<V: Vector>(self, row: usize, _: usize, _: usize) -> V {
        V::splat(*self.bias.add(row))
    }
    #[inline(always)]
    unsafe fn finish<V: Vector>(self, sum: V, _: usize, _: usize, _: usize) -> V {
        if self.relu { sum.relu() } else { sum }
    }
}

impl Ends for RowBias {
    #[inline(always)]
    unsafe fn start<V: Vector>(self, _: usize, column: usize, lanes: usize) -> V {
        load(self.bias.add(column), lanes)
    }
    #[inline(always)]
    unsafe fn finish<V: Vector>(self, sum: V, _: usize, _: usize, _: usize) -> V {
        if self.relu { sum.relu() } else { sum }
    }
}

impl Ends for WherePositive {
    #[inline(always)]
    unsafe fn start<V: Vector>(self, _: usize, _: usize, _: usize) -> V {
        V::splat(0.0)
    }
    #[inline(always)]
    unsafe fn finish<V: Vector>(self, sum: V, row: usize, column: usize, lanes: usize) -> V {
        load::<V>(self.x.add(row * self.columns + column), lanes).positive_then(sum)
    }
}

impl Product {
    /// Computes C in tiles: strips of up to four vectors of columns, and in each strip as many rows at once as the
    /// registers hold, `TALLEST` at most.
    ///
    /// The last strip begins early enough to be full: columns that it shares with the one before are computed twice.
    /// Only where C has fewer columns than a vector lanes is a part of a vector used.
    #[inline(always)]
    unsafe fn compute<V: Vector, const TALLEST: usize>(self, ends: impl Ends) {
        if self.columns < V::LANES {
            return self.strip::<V, 1, false, TALLEST>(ends, 0);
        }
        let mut column = 0;
        while column < self.columns {
            let vectors = (self.columns - column).div_ceil(V::LANES).min(self.columns / V::LANES);
            let width = match vectors {
                1..=3 => vectors,
                _ if self.rows <= 2 => 4,
                5 => 3,
                _ => 2,
            };
            column = column.min(self.columns - width * V::LANES);
            match width {
                1 => self.strip::<V, 1, true, TALLEST>(ends, column),
                2 => self.strip::<V, 2, true, TALLEST>(ends, column),
                3 => self.strip::<V, 3, true, TALLEST>(ends, column),
                _ => self.strip::<V, 4, true, TALLEST>(ends, column),
            }
            column += width * V::LANES;
        }
    }

    /// Computes `WIDTH` vectors of columns. Without `FULL`, C is narrower than one vector and partial loads are used.
    #[inline(always)]
    unsafe fn strip<V: Vector, const WIDTH: usize, const FULL: bool, const TALLEST: usize>(
        self,
        ends: impl Ends,
        column: usize,
    ) {
        let strip = if self.b_is_transposed {
            self.transposed::<V, WIDTH, FULL>(column)
        } else {
            let strip = Self { b: self.b.add(column), ..self };
            if FULL && TALLEST > 1 { strip.packed::<V, WIDTH>() } else { strip }
        };
        let mut row = 0;
        macro_rules! tiles {
            ($($height:literal)*) => {{$(
                let fits = $height == 1 || ($height <= TALLEST && ($height + 1) * WIDTH < V::REGISTERS);
                while fits && self.rows - row >= $height {
                    strip.tile::<V, $height, WIDTH, FULL>(ends, row, column);
                    row += $height;
                }
            )*}};
        }
        match WIDTH {
            1 => tiles!(12 4 1),
            2 => tiles!(12 6 4 2 1),
            3 => tiles!(8 3 2 1),
            _ => tiles!(2 1),
        }
        if self.sums_b {
            Self { a: &1.0, a_row: 0, a_column: 0, ..strip }.tile::<V, 1, WIDTH, FULL>(ends, row, column);
        }
    }

    /// Transposes a strip of B into rows that follow each other.
    #[inline(always)]
    unsafe fn transposed<V: Vector, const WIDTH: usize, const FULL: bool>(self, column: usize) -> Self {
        let width = WIDTH * V::LANES;
        let columns = if FULL { width } else { self.columns };
        let from = self.b.add(column * self.b_row);
        transpose::<V>(from, self.b_row, columns, self.inner, self.scratch, width);
        Self { b: self.scratch, b_row: width, ..self }
    }

    /// Copies a strip of B that is used often enough to rows that follow each other, because rows a power of two
    /// apart map to the same cache sets.
    #[inline(always)]
    unsafe fn packed<V: Vector, const WIDTH: usize>(self) -> Self {
        let width = WIDTH * V::LANES;
        if self.rows < 32 || self.inner < 32 || self.inner * width > PACKED {
            return self;
        }
        for row in 0..self.inner {
            for vector in 0..WIDTH {
                let value = V::load(self.b.add(row * self.b_row + vector * V::LANES));
                value.store(self.scratch.add(row * width + vector * V::LANES));
            }
        }
        Self { b: self.scratch, b_row: width, ..self }
    }

    /// `HEIGHT` rows of a strip: the sums stay in registers.
    #[inline(always)]
    unsafe fn tile<V: Vector, const HEIGHT: usize, const WIDTH: usize, const FULL: bool>(
        self,
        ends: impl Ends,
        row: usize,
        column: usize,
    ) {
        let lanes = if FULL { V::LANES } else { self.columns };
        let mut sums = [[V::splat(0.0); WIDTH]; HEIGHT];
        for (i, sums) in sums.iter_mut().enumerate() {
            for (j, sum) in sums.iter_mut().enumerate() {
                *sum = ends.start(row + i, column + j * V::LANES, lanes);
            }
        }
        let (mut a, mut b) = (self.a.add(row * self.a_row), self.b);
        for _ in 0..self.inner {
            let mut terms = [V::splat(0.0); WIDTH];
            for (j, term) in terms.iter_mut().enumerate() {
                *term = load(b.add(j * V::LANES), lanes);
            }
            for (i, sums) in sums.iter_mut().enumerate() {
                let factor = V::splat(*a.add(i * self.a_row));
                for (sum, &term) in sums.iter_mut().zip(&terms) {
                    *sum = factor.mul_add(term, *sum);
                }
            }
            a = a.wrapping_add(self.a_column);
            b = b.wrapping_add(self.b_row);
        }
        for (i, sums) in sums.iter().enumerate() {
            for (j, &sum) in sums.iter().enumerate() {
                let (row, column) = (row + i, column + j * V::LANES);
                let value = ends.finish(sum, row, column, lanes);
                store(value, self.c.add(row * self.columns + column), lanes);
            }
        }
    }
}

/// (rows, columns) to (columns, rows), both row-major with rows as far apart as given.
#[inline(always)]
unsafe fn transpose<V: Vector>(
    from: *const f32,
    from_row: usize,
    rows: usize,
    columns: usize,
    to: *mut f32,
    to_row: usize,
) {
    let (whole_rows, whole_columns) = (rows - rows % V::BLOCK, columns - columns % V::BLOCK);
    for column in (0..whole_columns).step_by(V::BLOCK) {
        for row in (0..whole_rows).step_by(V::BLOCK) {
            let (from, to) = (from.add(row * from_row + column), to.add(column * to_row + row));
            V::transpose_block(from, from_row, to, to_row);
        }
    }
    let copy =
        |row: usize, column: usize| *to.add(column * to_row + row) = *from.add(row * from_row + column);
    for column in whole_columns..columns {
        (0..whole_rows).for_each(|row| copy(row, column));
    }
    for row in whole_rows..rows {
        (0..columns).for_each(|column| copy(row, column));
    }
}

#[inline(always)]
unsafe fn load<V: Vector>(source: *const f32, lanes: usize) -> V {
    if lanes == V::LANES { V::load(source) } else { V::load_part(source, lanes) }
}

#[inline(always)]
unsafe fn store<V: Vector>(value: V, target: *mut f32, lanes: usize) {
    if lanes == V::LANES { value.store(target) } else { value.store_part(target, lanes) }
}
