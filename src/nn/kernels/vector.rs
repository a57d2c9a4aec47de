//! Vectors of f32 with the few operations of the kernels. Each rounds as the scalar operation, so all widths give the same bits.

/// A vector of f32.
///
/// # Safety
/// A vector is made only by `splat`, `load` and `load_part`, whose callers vouch for the instruction set. So whoever
/// has a vector may compute with it, and the arithmetic is safe. `load` and `store` touch `LANES` numbers, `load_part`
/// and `store_part` touch `lanes` numbers, and `transpose_block` touches `BLOCK` rows of `BLOCK` numbers on either
/// side.
pub(super) unsafe trait Vector: Copy {
    const NAME: &'static str;
    /// Whether the CPU has the instruction set. Every CPU has one that does not ask.
    fn is_available() -> bool {
        true
    }

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
    /// Loads `lanes` numbers, and 0 into the other lanes. A vector that is not `LANES` f32 in memory has its own.
    ///
    /// # Safety
    /// The CPU has the instruction set, `lanes` is below `LANES`, and `source` is valid for `lanes` reads.
    #[inline(always)]
    unsafe fn load_part(source: *const f32, lanes: usize) -> Self {
        // SAFETY: the caller vouches for the instruction set and for `lanes` reads, fewer than the vector has numbers.
        unsafe {
            let mut vector = Self::splat(0.0);
            source.copy_to_nonoverlapping((&raw mut vector).cast(), lanes);
            vector
        }
    }
    /// Stores all lanes.
    ///
    /// # Safety
    /// `target` is valid for `LANES` writes.
    unsafe fn store(self, target: *mut f32);
    /// Stores the first `lanes` lanes. A vector that is not `LANES` f32 in memory has its own.
    ///
    /// # Safety
    /// `lanes` is below `LANES`, and `target` is valid for `lanes` writes.
    #[inline(always)]
    unsafe fn store_part(self, target: *mut f32, lanes: usize) {
        // SAFETY: the caller vouches for `lanes` writes, fewer than the vector has numbers.
        unsafe { (&raw const self).cast::<f32>().copy_to_nonoverlapping(target, lanes) }
    }

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
    const BLOCK: usize = 1;
    /// Transposes a square. Rows are `from_stride` numbers apart in `from`, those of the transpose `to_stride` in `to`.
    ///
    /// # Safety
    /// The CPU has the instruction set, `from` is valid for reads of the square, and `to` for writes of the transpose.
    #[inline(always)]
    unsafe fn transpose_block(from: *const f32, _from_stride: usize, to: *mut f32, _to_stride: usize) {
        // SAFETY: a square of one number is read and written.
        unsafe { *to = *from }
    }
}

/// Defines loads, stores and arithmetic of a vector that is one register: `name(self, arguments) = instructions;`.
// A target without vectors has no use for it. Instructions that every CPU of the target has are safe.
#[allow(unused_macros)]
macro_rules! register {
    (
        splat($value:ident) = $splat:expr;
        load($source:ident) = $load:expr;
        store($vector:ident, $target:ident) = $store:expr;
        $($name:ident($self:ident $(, $argument:ident)*) = $instructions:expr;)*
    ) => {
        #[inline(always)]
        #[allow(unused_unsafe)]
        unsafe fn splat($value: f32) -> Self {
            // SAFETY: the caller vouches for the instruction set.
            Self(unsafe { $splat })
        }
        #[inline(always)]
        unsafe fn load($source: *const f32) -> Self {
            // SAFETY: the caller vouches for the instruction set and for `LANES` reads.
            Self(unsafe { $load })
        }
        #[inline(always)]
        unsafe fn store($vector, $target: *mut f32) {
            // SAFETY: the caller vouches for `LANES` writes.
            unsafe { $store }
        }
        $(
            #[inline(always)]
            #[allow(unused_unsafe)]
            fn $name($self $(, $argument: Self)*) -> Self {
                // SAFETY: a vector was made, so the CPU has the instruction set.
                Self(unsafe { $instructions })
            }
        )*
    };
}
#[allow(unused_imports)]
pub(super) use register;
