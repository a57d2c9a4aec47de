//! Vectors of f32 for WebAssembly, which has no fused multiply-add of its own.
//!
//! [`Simd128`] computes x · y + z in f64, where the product is exact. Rounding the sum to f64 and then to f32 differs from
//! rounding once only if the f64 is halfway between two f32. These rare lanes are computed again by
//! [`mul_add_in_f64`]. [`RelaxedSimd`] has an instruction that fuses on most CPUs, and is used only where it does.

use core::arch::wasm32::*;

use super::float::mul_add_in_f64;
use super::vector::Vector;

#[inline(always)]
fn lanes_of(vector: v128) -> [f32; 4] {
    [
        f32x4_extract_lane::<0>(vector),
        f32x4_extract_lane::<1>(vector),
        f32x4_extract_lane::<2>(vector),
        f32x4_extract_lane::<3>(vector),
    ]
}

/// Four numbers, each as an f64 that is exactly an f32: the first two and the last two. A module with [`RelaxedSimd`] has no
/// room for it: where relaxed SIMD does not fuse, such a module computes number by number.
#[cfg_attr(target_feature = "relaxed-simd", allow(dead_code))]
#[derive(Clone, Copy)]
pub(super) struct Simd128(v128, v128);

impl Simd128 {
    #[inline(always)]
    fn from_f32(values: v128) -> Self {
        let last = i64x2_shuffle::<1, 1>(values, values);
        Self(f64x2_promote_low_f32x4(values), f64x2_promote_low_f32x4(last))
    }

    #[inline(always)]
    fn to_f32(self) -> v128 {
        i64x2_shuffle::<0, 2>(f32x4_demote_f64x2_zero(self.0), f32x4_demote_f64x2_zero(self.1))
    }

    /// Rounds f64s to f32s.
    #[inline(always)]
    fn rounded(first: v128, last: v128) -> Self {
        let round = |values| f64x2_promote_low_f32x4(f32x4_demote_f64x2_zero(values));
        Self(round(first), round(last))
    }

    /// Whether a sum may be halfway between two f32: its last 29 bits are 1000…, or it is subnormal as an f32.
    #[inline(always)]
    fn any_halfway(first: v128, last: v128) -> bool {
        const HALFWAY: i32 = i32::MIN; // the last 29 bits, shifted to the left
        const SMALLEST: i32 = 0x3810_0000 << 1; // the first word of 2⁻¹²⁶ without its sign
        let (low, high) =
            (i32x4_shuffle::<0, 2, 4, 6>(first, last), i32x4_shuffle::<1, 3, 5, 7>(first, last));
        let halfway = i32x4_eq(i32x4_shl(low, 3), i32x4_splat(HALFWAY));
        // Without sign and less 1, so that 0 becomes the largest unsigned number. 2³¹ more makes unsigned order signed.
        let magnitude = i32x4_add(i32x4_shl(high, 1), i32x4_splat(i32::MIN.wrapping_sub(1)));
        let tiny = i32x4_lt(magnitude, i32x4_splat((SMALLEST - 1).wrapping_add(i32::MIN)));
        v128_any_true(v128_or(halfway, tiny))
    }

    #[cold]
    #[inline(never)]
    fn mul_add_by_lane(self, factor: Self, summand: Self) -> Self {
        let [a, b, c] = [self, factor, summand].map(|vector| lanes_of(vector.to_f32()));
        let sums: [f32; 4] = std::array::from_fn(|lane| mul_add_in_f64(a[lane], b[lane], c[lane]));
        Self::from_f32(f32x4(sums[0], sums[1], sums[2], sums[3]))
    }
}

// SAFETY: this module exists only where the whole program is compiled for `simd128`. Loads and stores touch the numbers
// that the trait names.
unsafe impl Vector for Simd128 {
    const NAME: &'static str = "simd128";
    const LANES: usize = 4;
    const REGISTERS: usize = 7;

    #[inline(always)]
    unsafe fn splat(value: f32) -> Self {
        let values = f64x2_splat(f64::from(value));
        Self(values, values)
    }
    #[inline(always)]
    unsafe fn load(source: *const f32) -> Self {
        // SAFETY: `source` is valid for 4 reads.
        Self::from_f32(unsafe { v128_load(source.cast()) })
    }
    #[inline(always)]
    unsafe fn load_part(source: *const f32, lanes: usize) -> Self {
        let mut values = [0.0; 4];
        // SAFETY: `source` is valid for `lanes` reads, and `lanes` is below 4.
        unsafe { source.copy_to_nonoverlapping(values.as_mut_ptr(), lanes) }
        Self::from_f32(f32x4(values[0], values[1], values[2], values[3]))
    }
    #[inline(always)]
    unsafe fn store(self, target: *mut f32) {
        // SAFETY: `target` is valid for 4 writes.
        unsafe { v128_store(target.cast(), self.to_f32()) }
    }
    #[inline(always)]
    unsafe fn store_part(self, target: *mut f32, lanes: usize) {
        let values = lanes_of(self.to_f32());
        // SAFETY: `target` is valid for `lanes` writes, and `lanes` is below 4.
        unsafe { values.as_ptr().copy_to_nonoverlapping(target, lanes) }
    }
    #[inline(always)]
    fn mul(self, factor: Self) -> Self {
        Self::rounded(f64x2_mul(self.0, factor.0), f64x2_mul(self.1, factor.1))
    }
    #[inline(always)]
    fn div(self, divisor: Self) -> Self {
        Self::from_f32(f32x4_div(self.to_f32(), divisor.to_f32()))
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Self::from_f32(f32x4_sqrt(self.to_f32()))
    }
    #[inline(always)]
    fn mul_add(self, factor: Self, summand: Self) -> Self {
        let first = f64x2_add(f64x2_mul(self.0, factor.0), summand.0);
        let last = f64x2_add(f64x2_mul(self.1, factor.1), summand.1);
        if Self::any_halfway(first, last) {
            return self.mul_add_by_lane(factor, summand);
        }
        Self::rounded(first, last)
    }
    #[inline(always)]
    fn relu(self) -> Self {
        let zero = f64x2_splat(0.0);
        Self(f64x2_pmax(self.0, zero), f64x2_pmax(self.1, zero))
    }
    #[inline(always)]
    fn flush(self) -> Self {
        let smallest = f64x2_splat(f64::from(f32::MIN_POSITIVE));
        let flush = |values| v128_andnot(values, f64x2_lt(f64x2_abs(values), smallest));
        Self(flush(self.0), flush(self.1))
    }
    #[inline(always)]
    fn positive_then(self, value: Self) -> Self {
        let zero = f64x2_splat(0.0);
        let then = |values, value| v128_and(f64x2_gt(values, zero), value);
        Self(then(self.0, value.0), then(self.1, value.1))
    }

    const BLOCK: usize = 4;
    /// Interleaves rows in pairs, then pairs of pairs.
    #[inline(always)]
    unsafe fn transpose_block(from: *const f32, from_stride: usize, to: *mut f32, to_stride: usize) {
        // SAFETY: the caller vouches for 4 rows of 4 numbers in `from`, and for as many in `to`.
        unsafe {
            let [a, b, c, d]: [v128; 4] =
                std::array::from_fn(|row| v128_load(from.add(row * from_stride).cast()));
            let (ab, cd) = (i32x4_shuffle::<0, 4, 1, 5>(a, b), i32x4_shuffle::<0, 4, 1, 5>(c, d));
            let (ab_high, cd_high) = (i32x4_shuffle::<2, 6, 3, 7>(a, b), i32x4_shuffle::<2, 6, 3, 7>(c, d));
            let columns = [
                i64x2_shuffle::<0, 2>(ab, cd),
                i64x2_shuffle::<1, 3>(ab, cd),
                i64x2_shuffle::<0, 2>(ab_high, cd_high),
                i64x2_shuffle::<1, 3>(ab_high, cd_high),
            ];
            for (column, values) in columns.into_iter().enumerate() {
                v128_store(to.add(column * to_stride).cast(), values);
            }
        }
    }
}

#[cfg(target_feature = "relaxed-simd")]
mod relaxed {
    use core::arch::wasm32::*;

    use super::{Simd128, Vector, lanes_of};
    use crate::nn::kernels::vector::register;

    /// Four numbers, with the multiply-add of relaxed SIMD.
    #[derive(Clone, Copy)]
    pub(in super::super) struct RelaxedSimd(v128);

    // SAFETY: this module exists only where the whole program is compiled for `simd128` and `relaxed-simd`. Loads and
    // stores touch the numbers that the trait names.
    unsafe impl Vector for RelaxedSimd {
        const NAME: &'static str = "relaxed-simd";
        /// Whether the multiply-add fuses. An engine decides that once, for all its multiply-adds.
        fn is_available() -> bool {
            let factor = f32x4_splat(std::hint::black_box(1.0 + 1.0 / 4096.0));
            let summand = f32x4_splat(std::hint::black_box(-(1.0 + 1.0 / 2048.0)));
            // The square's last bit is lost if it is rounded.
            let sums = lanes_of(f32x4_relaxed_madd(factor, factor, summand));
            sums == [1.0 / f32::from(4096_u16) / 4096.0; 4]
        }

        const LANES: usize = 4;
        const REGISTERS: usize = 15;

        register! {
            splat(value) = f32x4_splat(value);
            load(source) = v128_load(source.cast());
            store(self, target) = v128_store(target.cast(), self.0);
            mul(self, factor) = f32x4_mul(self.0, factor.0);
            div(self, divisor) = f32x4_div(self.0, divisor.0);
            sqrt(self) = f32x4_sqrt(self.0);
            mul_add(self, factor, summand) = f32x4_relaxed_madd(self.0, factor.0, summand.0);
            relu(self) = f32x4_pmax(self.0, f32x4_splat(0.0));
            flush(self) = v128_andnot(self.0, f32x4_lt(f32x4_abs(self.0), f32x4_splat(f32::MIN_POSITIVE)));
            positive_then(self, value) = v128_and(f32x4_gt(self.0, f32x4_splat(0.0)), value.0);
        }

        const BLOCK: usize = 4;
        #[inline(always)]
        unsafe fn transpose_block(from: *const f32, from_stride: usize, to: *mut f32, to_stride: usize) {
            // SAFETY: the caller vouches for both squares.
            unsafe { Simd128::transpose_block(from, from_stride, to, to_stride) }
        }
    }
}

/// What a module computes with.
#[cfg(not(target_feature = "relaxed-simd"))]
pub(super) type Wasm = Simd128;
#[cfg(target_feature = "relaxed-simd")]
pub(super) type Wasm = relaxed::RelaxedSimd;
