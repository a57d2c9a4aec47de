//! Vectors of f32, with the few operations that the kernels need, for every instruction set. Each operation rounds as
//! the scalar operation does. So all widths give the same bits.

use super::float::{Float, mul_add_in_f64};

/// A vector of f32.
///
/// # Safety
/// A vector is made only by `splat`, `load` and `load_part`, whose callers vouch for the instruction set. So whoever
/// has a vector may compute with it, and the arithmetic is safe. `load` and `store` touch `LANES` numbers, `load_part`
/// and `store_part` touch `lanes` numbers, and `transpose_block` touches `BLOCK` rows of `BLOCK` numbers on either
/// side.
pub(super) unsafe trait Vector: Copy {
    /// How many f32 a vector holds.
    const LANES: usize;
    /// How many registers the tile of a product may take. One register of the CPU stays free, because compilers spill
    /// registers to memory without it.
    const REGISTERS: usize;

    /// `value` in every lane.
    ///
    /// # Safety
    /// The CPU has the instruction set.
    unsafe fn splat(value: f32) -> Self;
    /// Loads `LANES` numbers.
    ///
    /// # Safety
    /// The CPU has the instruction set, and `source` is valid for `LANES` reads.
    unsafe fn load(source: *const f32) -> Self;
    /// Loads `lanes` numbers, and 0 into the other lanes.
    ///
    /// # Safety
    /// The CPU has the instruction set, `lanes` is below `LANES`, and `source` is valid for `lanes` reads.
    unsafe fn load_part(source: *const f32, lanes: usize) -> Self;
    /// Stores all lanes.
    ///
    /// # Safety
    /// `target` is valid for `LANES` writes.
    unsafe fn store(self, target: *mut f32);
    /// Stores the first `lanes` lanes.
    ///
    /// # Safety
    /// `lanes` is below `LANES`, and `target` is valid for `lanes` writes.
    unsafe fn store_part(self, target: *mut f32, lanes: usize);

    fn mul(self, factor: Self) -> Self;
    fn div(self, divisor: Self) -> Self;
    fn sqrt(self) -> Self;
    /// self · factor + summand, rounded once.
    fn mul_add(self, factor: Self, summand: Self) -> Self;
    /// `if self < 0 { 0 } else { self }`
    fn relu(self) -> Self;
    /// `if |self| < 2⁻¹²⁶ { 0 } else { self }`
    fn flush(self) -> Self;
    /// `if self > 0 { value } else { 0 }`
    fn positive_then(self, value: Self) -> Self;

    /// Side of the square that [`Self::transpose_block`] transposes.
    const BLOCK: usize;
    /// Transposes a square. Its rows are `from_stride` numbers apart in `from`. The rows of the transpose are
    /// `to_stride` numbers apart in `to`.
    ///
    /// # Safety
    /// The CPU has the instruction set, `from` is valid for reads of the square, and `to` for writes of the transpose.
    unsafe fn transpose_block(from: *const f32, from_stride: usize, to: *mut f32, to_stride: usize);
}

/// 16 numbers, computed one after another, on any CPU.
#[derive(Clone, Copy)]
pub(super) struct Scalar([f32; 16]);

// SAFETY: any CPU can run this, and loads and stores touch the numbers that the trait names.
unsafe impl Vector for Scalar {
    const LANES: usize = 16;
    // In WebAssembly tiles of one row: taller ones are no faster there, and several times the code.
    const REGISTERS: usize = if cfg!(target_arch = "wasm32") { 1 } else { 7 };

    #[inline(always)]
    unsafe fn splat(value: f32) -> Self {
        Self([value; 16])
    }
    #[inline(always)]
    unsafe fn load(source: *const f32) -> Self {
        // SAFETY: `source` is valid for 16 reads, and an array of f32 is aligned as an f32 is.
        Self(unsafe { source.cast::<[f32; 16]>().read() })
    }
    #[inline(always)]
    unsafe fn load_part(source: *const f32, lanes: usize) -> Self {
        let mut values = [0.0; 16];
        // SAFETY: `source` is valid for `lanes` reads, and `lanes` is below 16.
        unsafe { source.copy_to_nonoverlapping(values.as_mut_ptr(), lanes) }
        Self(values)
    }
    #[inline(always)]
    unsafe fn store(self, target: *mut f32) {
        // SAFETY: `target` is valid for 16 writes, and an array of f32 is aligned as an f32 is.
        unsafe { target.cast::<[f32; 16]>().write(self.0) }
    }
    #[inline(always)]
    unsafe fn store_part(self, target: *mut f32, lanes: usize) {
        // SAFETY: `target` is valid for `lanes` writes, and `lanes` is below 16.
        unsafe { self.0.as_ptr().copy_to_nonoverlapping(target, lanes) }
    }
    #[inline(always)]
    fn mul(self, factor: Self) -> Self {
        Self(std::array::from_fn(|lane| self.0[lane] * factor.0[lane]))
    }
    #[inline(always)]
    fn div(self, divisor: Self) -> Self {
        Self(std::array::from_fn(|lane| self.0[lane] / divisor.0[lane]))
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(self.0.map(f32::sqrt))
    }
    #[inline(always)]
    fn mul_add(self, factor: Self, summand: Self) -> Self {
        let mul_add = if cfg!(target_arch = "wasm32") { mul_add_in_f64 } else { f32::mul_add };
        Self(std::array::from_fn(|lane| mul_add(self.0[lane], factor.0[lane], summand.0[lane])))
    }
    #[inline(always)]
    fn relu(self) -> Self {
        Self(self.0.map(|value| if value < 0.0 { 0.0 } else { value }))
    }
    #[inline(always)]
    fn flush(self) -> Self {
        Self(self.0.map(Float::flush))
    }
    #[inline(always)]
    fn positive_then(self, value: Self) -> Self {
        Self(std::array::from_fn(|lane| if self.0[lane] > 0.0 { value.0[lane] } else { 0.0 }))
    }

    const BLOCK: usize = 1;
    #[inline(always)]
    unsafe fn transpose_block(from: *const f32, _: usize, to: *mut f32, _: usize) {
        // SAFETY: a square of one number is read and written.
        unsafe { *to = *from }
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::*;

    use super::Vector;

    /// Defines the arithmetic of a vector: `name(self, arguments) = instructions;`.
    macro_rules! arithmetic {
        ($($name:ident($self:ident $(, $argument:ident)*) = $instructions:expr;)*) => {$(
            #[inline(always)]
            fn $name($self $(, $argument: Self)*) -> Self {
                // SAFETY: a vector was made, so the CPU has the instruction set.
                Self(unsafe { $instructions })
            }
        )*};
    }

    /// 8 numbers, by AVX2 and FMA.
    #[derive(Clone, Copy)]
    pub(in super::super) struct Avx2(__m256);

    /// A mask whose first `lanes` of 8 lanes are set.
    ///
    /// # Safety
    /// The CPU has AVX2, and `lanes` is at most 8.
    #[inline(always)]
    unsafe fn avx2_mask(lanes: usize) -> __m256i {
        const WINDOW: [i32; 16] = [-1, -1, -1, -1, -1, -1, -1, -1, 0, 0, 0, 0, 0, 0, 0, 0];
        // SAFETY: 8 numbers are read, and the first of them is number 8 or an earlier one of the 16.
        unsafe { _mm256_loadu_si256(WINDOW.as_ptr().add(8 - lanes).cast()) }
    }

    // SAFETY: loads and stores touch the numbers that the trait names. Masked lanes are not touched.
    unsafe impl Vector for Avx2 {
        const LANES: usize = 8;
        const REGISTERS: usize = 15;

        #[inline(always)]
        unsafe fn splat(value: f32) -> Self {
            // SAFETY: the CPU has AVX2.
            Self(unsafe { _mm256_set1_ps(value) })
        }
        #[inline(always)]
        unsafe fn load(source: *const f32) -> Self {
            // SAFETY: the CPU has AVX2, and `source` is valid for 8 reads.
            Self(unsafe { _mm256_loadu_ps(source) })
        }
        #[inline(always)]
        unsafe fn load_part(source: *const f32, lanes: usize) -> Self {
            // SAFETY: the CPU has AVX2, and `source` is valid for `lanes` < 8 reads.
            Self(unsafe { _mm256_maskload_ps(source, avx2_mask(lanes)) })
        }
        #[inline(always)]
        unsafe fn store(self, target: *mut f32) {
            // SAFETY: `target` is valid for 8 writes.
            unsafe { _mm256_storeu_ps(target, self.0) }
        }
        /// Stores four numbers, then two, then one, as `lanes` is made up. Some CPUs run a masked store as slow
        /// microcode.
        #[inline(always)]
        unsafe fn store_part(self, target: *mut f32, lanes: usize) {
            // SAFETY: `target` is valid for `lanes` writes. The stores are as long as the bits of `lanes` say.
            unsafe {
                let (mut rest, mut target) = (_mm256_castps256_ps128(self.0), target);
                if lanes & 4 != 0 {
                    _mm_storeu_ps(target, rest);
                    (rest, target) = (_mm256_extractf128_ps::<1>(self.0), target.add(4));
                }
                if lanes & 2 != 0 {
                    _mm_store_sd(target.cast(), _mm_castps_pd(rest));
                    (rest, target) = (_mm_movehl_ps(rest, rest), target.add(2));
                }
                if lanes & 1 != 0 {
                    _mm_store_ss(target, rest);
                }
            }
        }
        arithmetic! {
            mul(self, factor) = _mm256_mul_ps(self.0, factor.0);
            div(self, divisor) = _mm256_div_ps(self.0, divisor.0);
            sqrt(self) = _mm256_sqrt_ps(self.0);
            mul_add(self, factor, summand) = _mm256_fmadd_ps(self.0, factor.0, summand.0);
            // The maximum is the second operand where either operand is NaN or both are 0.
            relu(self) = _mm256_max_ps(_mm256_setzero_ps(), self.0);
            flush(self) = {
                let magnitude = _mm256_andnot_ps(_mm256_set1_ps(-0.0), self.0);
                let smallest = _mm256_set1_ps(f32::MIN_POSITIVE);
                _mm256_and_ps(_mm256_cmp_ps::<_CMP_NLT_UQ>(magnitude, smallest), self.0)
            };
            positive_then(self, value) =
                _mm256_and_ps(_mm256_cmp_ps::<_CMP_GT_OQ>(self.0, _mm256_setzero_ps()), value.0);
        }

        const BLOCK: usize = 8;
        #[inline(always)]
        unsafe fn transpose_block(from: *const f32, from_stride: usize, to: *mut f32, to_stride: usize) {
            // SAFETY: the caller vouches for AVX2 and for both squares.
            unsafe { transpose_8x8(from, from_stride, to, to_stride) }
        }
    }

    /// Interleaves rows in pairs, then pairs of pairs, and then joins the halves.
    ///
    /// # Safety
    /// As for [`Vector::transpose_block`] with a `BLOCK` of 8, on a CPU with AVX2.
    #[inline(always)]
    unsafe fn transpose_8x8(from: *const f32, from_stride: usize, to: *mut f32, to_stride: usize) {
        // SAFETY: the caller vouches for AVX2, for 8 rows of 8 numbers in `from`, and for as many in `to`.
        unsafe {
            let rows: [__m256; 8] = std::array::from_fn(|row| _mm256_loadu_ps(from.add(row * from_stride)));
            let pairs: [__m256; 8] = std::array::from_fn(|i| {
                let (a, b) = (rows[i / 2 * 2], rows[i / 2 * 2 + 1]);
                if i % 2 == 0 { _mm256_unpacklo_ps(a, b) } else { _mm256_unpackhi_ps(a, b) }
            });
            let fours: [__m256; 8] = std::array::from_fn(|i| {
                let (a, b) = (pairs[i / 4 * 4 + i % 4 / 2], pairs[i / 4 * 4 + i % 4 / 2 + 2]);
                if i % 2 == 0 {
                    _mm256_shuffle_ps::<0b01_00_01_00>(a, b)
                } else {
                    _mm256_shuffle_ps::<0b11_10_11_10>(a, b)
                }
            });
            for column in 0..8 {
                let (a, b) = (fours[column % 4], fours[column % 4 + 4]);
                let eight = if column < 4 {
                    _mm256_permute2f128_ps::<0x20>(a, b)
                } else {
                    _mm256_permute2f128_ps::<0x31>(a, b)
                };
                _mm256_storeu_ps(to.add(column * to_stride), eight);
            }
        }
    }

    /// 16 numbers, by AVX-512F.
    #[derive(Clone, Copy)]
    pub(in super::super) struct Avx512(__m512);

    /// A mask whose first `lanes` of 16 lanes are set.
    #[inline(always)]
    fn avx512_mask(lanes: usize) -> __mmask16 {
        ((1u32 << lanes) - 1) as __mmask16
    }

    // SAFETY: loads and stores touch the numbers that the trait names. Masked lanes are not touched.
    unsafe impl Vector for Avx512 {
        const LANES: usize = 16;
        const REGISTERS: usize = 31;

        #[inline(always)]
        unsafe fn splat(value: f32) -> Self {
            // SAFETY: the CPU has AVX-512F.
            Self(unsafe { _mm512_set1_ps(value) })
        }
        #[inline(always)]
        unsafe fn load(source: *const f32) -> Self {
            // SAFETY: the CPU has AVX-512F, and `source` is valid for 16 reads.
            Self(unsafe { _mm512_loadu_ps(source) })
        }
        #[inline(always)]
        unsafe fn load_part(source: *const f32, lanes: usize) -> Self {
            // SAFETY: the CPU has AVX-512F, and `source` is valid for `lanes` reads.
            Self(unsafe { _mm512_maskz_loadu_ps(avx512_mask(lanes), source) })
        }
        #[inline(always)]
        unsafe fn store(self, target: *mut f32) {
            // SAFETY: `target` is valid for 16 writes.
            unsafe { _mm512_storeu_ps(target, self.0) }
        }
        #[inline(always)]
        unsafe fn store_part(self, target: *mut f32, lanes: usize) {
            // SAFETY: `target` is valid for `lanes` writes.
            unsafe { _mm512_mask_storeu_ps(target, avx512_mask(lanes), self.0) }
        }
        arithmetic! {
            mul(self, factor) = _mm512_mul_ps(self.0, factor.0);
            div(self, divisor) = _mm512_div_ps(self.0, divisor.0);
            sqrt(self) = _mm512_sqrt_ps(self.0);
            mul_add(self, factor, summand) = _mm512_fmadd_ps(self.0, factor.0, summand.0);
            // The maximum is the second operand where either operand is NaN or both are 0.
            relu(self) = _mm512_max_ps(_mm512_setzero_ps(), self.0);
            flush(self) = {
                let (magnitude, smallest) = (_mm512_abs_ps(self.0), _mm512_set1_ps(f32::MIN_POSITIVE));
                _mm512_maskz_mov_ps(_mm512_cmp_ps_mask::<_CMP_NLT_UQ>(magnitude, smallest), self.0)
            };
            positive_then(self, value) = {
                let positive = _mm512_cmp_ps_mask::<_CMP_GT_OQ>(self.0, _mm512_setzero_ps());
                _mm512_maskz_mov_ps(positive, value.0)
            };
        }

        const BLOCK: usize = 8;
        #[inline(always)]
        unsafe fn transpose_block(from: *const f32, from_stride: usize, to: *mut f32, to_stride: usize) {
            // SAFETY: a CPU with AVX-512F has AVX2. The caller vouches for both squares.
            unsafe { transpose_8x8(from, from_stride, to, to_stride) }
        }
    }
}

#[cfg(target_arch = "x86_64")]
pub(super) use x86::{Avx2, Avx512};
