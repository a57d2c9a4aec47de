//! Vectors of f32 by NEON, which every 64-bit ARM CPU has.

use std::arch::aarch64::*;

use super::vector::{Vector, register};

/// 4 numbers, by NEON.
#[derive(Clone, Copy)]
pub(super) struct Neon(float32x4_t);

// SAFETY: every CPU of this target has NEON. Loads and stores touch the numbers that the trait names.
unsafe impl Vector for Neon {
    const NAME: &'static str = "neon";
    const LANES: usize = 4;
    const REGISTERS: usize = 31;

    register! {
        splat(value) = vdupq_n_f32(value);
        load(source) = vld1q_f32(source);
        store(self, target) = vst1q_f32(target, self.0);
        mul(self, factor) = vmulq_f32(self.0, factor.0);
        div(self, divisor) = vdivq_f32(self.0, divisor.0);
        sqrt(self) = vsqrtq_f32(self.0);
        mul_add(self, factor, summand) = vfmaq_f32(summand.0, self.0, factor.0);
        // A maximum would make 0 of −0, and of NaN another NaN.
        relu(self) = clear(self.0, vcltq_f32(self.0, vdupq_n_f32(0.0)));
        flush(self) = clear(self.0, vcaltq_f32(self.0, vdupq_n_f32(f32::MIN_POSITIVE)));
        positive_then(self, value) = {
            let positive = vcgtq_f32(self.0, vdupq_n_f32(0.0));
            vreinterpretq_f32_u32(vandq_u32(vreinterpretq_u32_f32(value.0), positive))
        };
    }

    const BLOCK: usize = 4;
    /// Interleaves rows in pairs, then pairs of pairs.
    #[inline(always)]
    unsafe fn transpose_block(from: *const f32, from_stride: usize, to: *mut f32, to_stride: usize) {
        // SAFETY: the caller vouches for 4 rows of 4 numbers in `from`, and for as many in `to`.
        unsafe {
            let [a, b, c, d]: [float32x4_t; 4] =
                std::array::from_fn(|row| vld1q_f32(from.add(row * from_stride)));
            let (ab, cd) = (vzipq_f32(a, b), vzipq_f32(c, d));
            let join = |low, high| vcombine_f32(low, high);
            let columns = [
                join(vget_low_f32(ab.0), vget_low_f32(cd.0)),
                join(vget_high_f32(ab.0), vget_high_f32(cd.0)),
                join(vget_low_f32(ab.1), vget_low_f32(cd.1)),
                join(vget_high_f32(ab.1), vget_high_f32(cd.1)),
            ];
            for (column, values) in columns.into_iter().enumerate() {
                vst1q_f32(to.add(column * to_stride), values);
            }
        }
    }
}

/// 0 where a bit mask is set, the number elsewhere.
#[inline(always)]
fn clear(numbers: float32x4_t, mask: uint32x4_t) -> float32x4_t {
    // SAFETY: every CPU of this target has NEON.
    #[allow(unused_unsafe)]
    unsafe {
        vreinterpretq_f32_u32(vbicq_u32(vreinterpretq_u32_f32(numbers), mask))
    }
}
