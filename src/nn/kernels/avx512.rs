//! Vectors of f32 by AVX-512F.

use std::arch::x86_64::*;

use super::avx2::Avx2;
use super::vector::{Vector, register};

/// 16 numbers, by AVX-512F.
#[derive(Clone, Copy)]
pub(super) struct Avx512(__m512);

/// A mask whose first `lanes` of 16 lanes are set.
#[inline(always)]
fn avx512_mask(lanes: usize) -> __mmask16 {
    ((1u32 << lanes) - 1) as __mmask16
}

// SAFETY: loads and stores touch the numbers that the trait names. Masked lanes are not touched.
unsafe impl Vector for Avx512 {
    const NAME: &'static str = "avx512";
    fn is_available() -> bool {
        is_x86_feature_detected!("avx512f") && Avx2::is_available()
    }

    const LANES: usize = 16;
    const REGISTERS: usize = 31;

    #[inline(always)]
    unsafe fn load_part(source: *const f32, lanes: usize) -> Self {
        // SAFETY: the CPU has AVX-512F, and `source` is valid for `lanes` reads.
        Self(unsafe { _mm512_maskz_loadu_ps(avx512_mask(lanes), source) })
    }
    #[inline(always)]
    unsafe fn store_part(self, target: *mut f32, lanes: usize) {
        // SAFETY: `target` is valid for `lanes` writes.
        unsafe { _mm512_mask_storeu_ps(target, avx512_mask(lanes), self.0) }
    }
    register! {
        splat(value) = _mm512_set1_ps(value);
        load(source) = _mm512_loadu_ps(source);
        store(self, target) = _mm512_storeu_ps(target, self.0);
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

    const BLOCK: usize = Avx2::BLOCK;
    #[inline(always)]
    unsafe fn transpose_block(from: *const f32, from_stride: usize, to: *mut f32, to_stride: usize) {
        // SAFETY: a CPU with AVX-512F has AVX2. The caller vouches for both squares.
        unsafe { Avx2::transpose_block(from, from_stride, to, to_stride) }
    }
}
