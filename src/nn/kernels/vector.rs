//! Vectors of f32: the few operations that the kernels need, for every instruction set. Each operation rounds as
//! the scalar one does, so that all widths give the same bits.

/// Lanes of f32 that are computed with at once.
///
/// # Safety
/// The methods of an instruction set may only be called where the CPU has it. Pointers must be valid for as many
/// f32 as are loaded or stored.
pub(super) unsafe trait Vector: Copy {
    /// f32 in a vector.
    const LANES: usize;
    /// Registers that a product's tile may take: one fewer than there are, or compilers spill.
    const REGISTERS: usize;

    unsafe fn splat(value: f32) -> Self;
    unsafe fn load(source: *const f32) -> Self;
    /// Loads `lanes` < `LANES` numbers, and 0 into the other lanes.
    unsafe fn load_part(source: *const f32, lanes: usize) -> Self;
    unsafe fn store(self, target: *mut f32);
    /// Stores the first `lanes` < `LANES` numbers.
    unsafe fn store_part(self, target: *mut f32, lanes: usize);
    unsafe fn mul(self, factor: Self) -> Self;
    unsafe fn div(self, divisor: Self) -> Self;
    unsafe fn sqrt(self) -> Self;
    /// self · factor + summand, rounded once.
    unsafe fn mul_add(self, factor: Self, summand: Self) -> Self;
    /// `if self < 0 { 0 } else { self }`
    unsafe fn relu(self) -> Self;
    /// `if |self| < 2⁻¹²⁶ { 0 } else { self }`
    unsafe fn flush(self) -> Self;
    /// `if self > 0 { value } else { 0 }`
    unsafe fn positive_then(self, value: Self) -> Self;

    /// Side of the square that [`Self::transpose_block`] transposes.
    const BLOCK: usize;
    /// Transposes a square; its rows are `from_row` apart in `from`, its columns become rows `to_row` apart in `to`.
    unsafe fn transpose_block(from: *const f32, from_row: usize, to: *mut f32, to_row: usize);
}

/// 16 numbers, one after another: any CPU.
#[derive(Clone, Copy)]
pub(super) struct Scalar([f32; 16]);

// SAFETY: no instruction set is needed; loads and stores touch what the trait says.
unsafe impl Vector for Scalar {
    const LANES: usize = 16;
    const REGISTERS: usize = 7;

    #[inline(always)]
    unsafe fn splat(value: f32) -> Self {
        Self([value; 16])
    }
    #[inline(always)]
    unsafe fn load(source: *const f32) -> Self {
        Self(source.cast::<[f32; 16]>().read())
    }
    #[inline(always)]
    unsafe fn load_part(source: *const f32, lanes: usize) -> Self {
        let mut values = [0.0; 16];
        source.copy_to_nonoverlapping(values.as_mut_ptr(), lanes);
        Self(values)
    }
    #[inline(always)]
    unsafe fn store(self, target: *mut f32) {
        target.cast::<[f32; 16]>().write(self.0)
    }
    #[inline(always)]
    unsafe fn store_part(self, target: *mut f32, lanes: usize) {
        self.0.as_ptr().copy_to_nonoverlapping(target, lanes)
    }
    #[inline(always)]
    unsafe fn mul(self, factor: Self) -> Self {
        Self(std::array::from_fn(|lane| self.0[lane] * factor.0[lane]))
    }
    #[inline(always)]
    unsafe fn div(self, divisor: Self) -> Self {
        Self(std::array::from_fn(|lane| self.0[lane] / divisor.0[lane]))
    }
    #[inline(always)]
    unsafe fn sqrt(self) -> Self {
        Self(self.0.map(f32::sqrt))
    }
    #[inline(always)]
    unsafe fn mul_add(self, factor: Self, summand: Self) -> Self {
        Self(std::array::from_fn(|lane| self.0[lane].mul_add(factor.0[lane], summand.0[lane])))
    }
    #[inline(always)]
    unsafe fn relu(self) -> Self {
        Self(self.0.map(|value| if value < 0.0 { 0.0 } else { value }))
    }
    #[inline(always)]
    unsafe fn flush(self) -> Self {
        Self(self.0.map(super::Float::flush))
    }
    #[inline(always)]
    unsafe fn positive_then(self, value: Self) -> Self {
        Self(std::array::from_fn(|lane| if self.0[lane] > 0.0 { value.0[lane] } else { 0.0 }))
    }

    const BLOCK: usize = 1;
    #[inline(always)]
    unsafe fn transpose_block(from: *const f32, _: usize, to: *mut f32, _: usize) {
        *to = *from;
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::*;

    use super::Vector;

    /// 8 numbers: AVX2 with FMA.
    #[derive(Clone, Copy)]
    pub(in super::super) struct Avx2(__m256);

    /// A mask of `lanes` lanes: a window on ones followed by zeros.
    #[inline(always)]
    unsafe fn avx2_mask(lanes: usize) -> __m256i {
        const WINDOW: [i32; 16] = [-1, -1, -1, -1, -1, -1, -1, -1, 0, 0, 0, 0, 0, 0, 0, 0];
        _mm256_loadu_si256(WINDOW.as_ptr().add(8 - lanes).cast())
    }

    // SAFETY: callers vouch for AVX2 and FMA and for the pointers; masked lanes are not touched.
    unsafe impl Vector for Avx2 {
        const LANES: usize = 8;
        const REGISTERS: usize = 15;

        #[inline(always)]
        unsafe fn splat(value: f32) -> Self {
            Self(_mm256_set1_ps(value))
        }
        #[inline(always)]
        unsafe fn load(source: *const f32) -> Self {
            Self(_mm256_loadu_ps(source))
        }
        #[inline(always)]
        unsafe fn load_part(source: *const f32, lanes: usize) -> Self {
            Self(_mm256_maskload_ps(source, avx2_mask(lanes)))
        }
        #[inline(always)]
        unsafe fn store(self, target: *mut f32) {
            _mm256_storeu_ps(target, self.0)
        }
        #[inline(always)]
        unsafe fn store_part(self, target: *mut f32, lanes: usize) {
            // Four, two and one: faster than a masked store where that is microcode.
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
        #[inline(always)]
        unsafe fn mul(self, factor: Self) -> Self {
            Self(_mm256_mul_ps(self.0, factor.0))
        }
        #[inline(always)]
        unsafe fn div(self, divisor: Self) -> Self {
            Self(_mm256_div_ps(self.0, divisor.0))
        }
        #[inline(always)]
        unsafe fn sqrt(self) -> Self {
            Self(_mm256_sqrt_ps(self.0))
        }
        #[inline(always)]
        unsafe fn mul_add(self, factor: Self, summand: Self) -> Self {
            Self(_mm256_fmadd_ps(self.0, factor.0, summand.0))
        }
        // The instruction gives its second operand where either is NaN or both are 0.
        #[inline(always)]
        unsafe fn relu(self) -> Self {
            Self(_mm256_max_ps(_mm256_setzero_ps(), self.0))
        }
        #[inline(always)]
        unsafe fn flush(self) -> Self {
            let magnitude = _mm256_andnot_ps(_mm256_set1_ps(-0.0), self.0);
            let smallest = _mm256_set1_ps(f32::MIN_POSITIVE);
            Self(_mm256_and_ps(_mm256_cmp_ps::<_CMP_NLT_UQ>(magnitude, smallest), self.0))
        }
        #[inline(always)]
        unsafe fn positive_then(self, value: Self) -> Self {
            Self(_mm256_and_ps(_mm256_cmp_ps::<_CMP_GT_OQ>(self.0, _mm256_setzero_ps()), value.0))
        }

        const BLOCK: usize = 8;
        #[inline(always)]
        unsafe fn transpose_block(from: *const f32, from_row: usize, to: *mut f32, to_row: usize) {
            transpose_8x8(from, from_row, to, to_row);
        }
    }

    /// Pairs, then pairs of pairs, then halves.
    #[inline(always)]
    unsafe fn transpose_8x8(from: *const f32, from_row: usize, to: *mut f32, to_row: usize) {
        let rows: [__m256; 8] = std::array::from_fn(|row| _mm256_loadu_ps(from.add(row * from_row)));
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
            _mm256_storeu_ps(to.add(column * to_row), eight);
        }
    }

    /// 16 numbers: AVX-512.
    #[derive(Clone, Copy)]
    pub(in super::super) struct Avx512(__m512);

    /// A mask of `lanes` lanes.
    #[inline(always)]
    fn avx512_mask(lanes: usize) -> __mmask16 {
        ((1u32 << lanes) - 1) as __mmask16
    }

    // SAFETY: callers vouch for AVX-512F and for the pointers; masked lanes are not touched.
    unsafe impl Vector for Avx512 {
        const LANES: usize = 16;
        const REGISTERS: usize = 31;

        #[inline(always)]
        unsafe fn splat(value: f32) -> Self {
            Self(_mm512_set1_ps(value))
        }
        #[inline(always)]
        unsafe fn load(source: *const f32) -> Self {
            Self(_mm512_loadu_ps(source))
        }
        #[inline(always)]
        unsafe fn load_part(source: *const f32, lanes: usize) -> Self {
            Self(_mm512_maskz_loadu_ps(avx512_mask(lanes), source))
        }
        #[inline(always)]
        unsafe fn store(self, target: *mut f32) {
            _mm512_storeu_ps(target, self.0)
        }
        #[inline(always)]
        unsafe fn store_part(self, target: *mut f32, lanes: usize) {
            _mm512_mask_storeu_ps(target, avx512_mask(lanes), self.0)
        }
        #[inline(always)]
        unsafe fn mul(self, factor: Self) -> Self {
            Self(_mm512_mul_ps(self.0, factor.0))
        }
        #[inline(always)]
        unsafe fn div(self, divisor: Self) -> Self {
            Self(_mm512_div_ps(self.0, divisor.0))
        }
        #[inline(always)]
        unsafe fn sqrt(self) -> Self {
            Self(_mm512_sqrt_ps(self.0))
        }
        #[inline(always)]
        unsafe fn mul_add(self, factor: Self, summand: Self) -> Self {
            Self(_mm512_fmadd_ps(self.0, factor.0, summand.0))
        }
        // The instruction gives its second operand where either is NaN or both are 0.
        #[inline(always)]
        unsafe fn relu(self) -> Self {
            Self(_mm512_max_ps(_mm512_setzero_ps(), self.0))
        }
        #[inline(always)]
        unsafe fn flush(self) -> Self {
            let (magnitude, smallest) = (_mm512_abs_ps(self.0), _mm512_set1_ps(f32::MIN_POSITIVE));
            Self(_mm512_maskz_mov_ps(_mm512_cmp_ps_mask::<_CMP_NLT_UQ>(magnitude, smallest), self.0))
        }
        #[inline(always)]
        unsafe fn positive_then(self, value: Self) -> Self {
            let positive = _mm512_cmp_ps_mask::<_CMP_GT_OQ>(self.0, _mm512_setzero_ps());
            Self(_mm512_maskz_mov_ps(positive, value.0))
        }

        const BLOCK: usize = 8;
        #[inline(always)]
        unsafe fn transpose_block(from: *const f32, from_row: usize, to: *mut f32, to_row: usize) {
            transpose_8x8(from, from_row, to, to_row);
        }
    }
}

#[cfg(target_arch = "x86_64")]
pub(super) use x86::{Avx2, Avx512};
