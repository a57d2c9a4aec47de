//! Vectors of f32 on any CPU.

use super::float::{Float, mul_add_in_f64};

/// So many that compilers make vectors of them. In WebAssembly more numbers would only be more code, for each page to load.
const LANES: usize = if cfg!(target_arch = "wasm32") { 4 } else { 16 };

/// [`LANES`] numbers, computed one after another, on any CPU.
#[derive(Clone, Copy)]
pub(super) struct Scalar([f32; LANES]);

// SAFETY: any CPU can run this, and loads and stores touch the numbers that the trait names.
unsafe impl super::vector::Vector for Scalar {
    const NAME: &'static str = "scalar";
    const LANES: usize = LANES;
    // In WebAssembly tiles of one row: taller ones are no faster there, and several times the code.
    const REGISTERS: usize = if cfg!(target_arch = "wasm32") { 1 } else { 7 };

    #[inline(always)]
    unsafe fn splat(value: f32) -> Self {
        Self([value; LANES])
    }
    #[inline(always)]
    unsafe fn load(source: *const f32) -> Self {
        // SAFETY: `source` is valid for `LANES` reads, and an array of f32 is aligned as an f32 is.
        Self(unsafe { source.cast::<[f32; LANES]>().read() })
    }
    #[inline(always)]
    unsafe fn store(self, target: *mut f32) {
        // SAFETY: `target` is valid for `LANES` writes, and an array of f32 is aligned as an f32 is.
        unsafe { target.cast::<[f32; LANES]>().write(self.0) }
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
        let mul_add = if cfg!(target_arch = "wasm32") { mul_add_in_f64 } else { Float::mul_add };
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
}
