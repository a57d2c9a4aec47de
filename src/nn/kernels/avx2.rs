//! Vectors of f32 by AVX2 and FMA.

use std::arch::x86_64::*;

use super::vector::{Vector, register};

/// 8 numbers, by AVX2 and FMA.
#[derive(Clone, Copy)]
pub(super) struct Avx2(__m256);

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
    const NAME: &'static str = "avx2";
    fn is_available() -> bool {
        is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma")
    }

    const LANES: usize = 8;
    const REGISTERS: usize = 15;

    #[inline(always)]
    unsafe fn load_part(source: *const f32, lanes: usize) -> Self {
        // SAFETY: the CPU has AVX2, and `source` is valid for `lanes` < 8 reads.
        Self(unsafe { _mm256_maskload_ps(source, avx2_mask(lanes)) })
    }
    /// Stores four numbers, then two, then one, as `lanes` is made up. Some CPUs run a masked store slowly.
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
    register! {
        splat(value) = _mm256_set1_ps(value);
        load(source) = _mm256_loadu_ps(source);
        store(self, target) = _mm256_storeu_ps(target, self.0);
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
    /// Interleaves rows in pairs, then pairs of pairs, and then joins the halves.
    #[inline(always)]
    unsafe fn transpose_block(from: *const f32, from_stride: usize, to: *mut f32, to_stride: usize) {
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
}
