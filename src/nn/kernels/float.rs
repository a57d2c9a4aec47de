//! The numbers that a network computes with: f32 or f64.

pub trait Float:
    nalgebra::Scalar
    + Copy
    + PartialOrd
    + std::ops::Add<Output = Self>
    + std::ops::Sub<Output = Self>
    + std::ops::Mul<Output = Self>
    + std::ops::Div<Output = Self>
    + std::ops::Neg<Output = Self>
    + std::ops::AddAssign
{
    const ZERO: Self;
    const ONE: Self;

    /// The nearest number of this type.
    fn from_f64(value: f64) -> Self;
    /// self · factor + summand, rounded once.
    fn mul_add(self, factor: Self, summand: Self) -> Self;
    fn sqrt(self) -> Self;
    fn abs(self) -> Self;
    /// 0 where |self| is below the smallest normal number, else self. NaN stays NaN.
    fn flush(self) -> Self;
    /// self, limited to `low`…`high`.
    fn clamp(self, low: Self, high: Self) -> Self;
}

/// Whether `mul_add` is an instruction of every CPU of the target. Else it calls the C library, and MinGW's rounds twice.
const HAS_FUSED: bool = cfg!(any(target_arch = "aarch64", target_feature = "fma"));

macro_rules! float {
    ($($type:ty, $fused:path;)*) => {$(
        impl Float for $type {
            const ZERO: Self = 0.0;
            const ONE: Self = 1.0;

            #[allow(clippy::cast_possible_truncation)]
            fn from_f64(value: f64) -> Self {
                value as Self
            }
            #[inline(always)]
            fn mul_add(self, factor: Self, summand: Self) -> Self {
                if HAS_FUSED { self.mul_add(factor, summand) } else { $fused(self, factor, summand) }
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                self.sqrt()
            }
            fn abs(self) -> Self {
                self.abs()
            }
            #[inline(always)]
            fn flush(self) -> Self {
                if self.abs() < Self::MIN_POSITIVE { 0.0 } else { self }
            }
            fn clamp(self, low: Self, high: Self) -> Self {
                self.clamp(low, high)
            }
        }
    )*};
}

float!(f32, libm::fmaf; f64, libm::fma;);

/// x · y + z, rounded once, by f64 alone: WebAssembly has no instruction for it, and a call of a function is slow there.
#[doc(hidden)]
#[inline(always)]
pub fn mul_add_in_f64(x: f32, y: f32, z: f32) -> f32 {
    // Exact: 24 bits times 24 bits.
    let product = f64::from(x) * f64::from(y);
    let sum = product + f64::from(z);
    // Rounding twice differs from rounding once only if the f64 is halfway between two f32: the last 29 bits are 1000…, or
    // the f32 is subnormal, and its last place is another one.
    let may_be_halfway = sum.to_bits() & 0x1FFF_FFFF == 0x1000_0000;
    let is_subnormal = sum.abs() < f64::from(f32::MIN_POSITIVE) && sum != 0.0;
    if may_be_halfway || is_subnormal { round_to_odd(product, f64::from(z), sum) as f32 } else { sum as f32 }
}

/// `sum`, the rounded product + z, or its neighbour on the other side of the exact sum if that neighbour's last bit is 1 and
/// the sum was inexact. A second rounding, to fewer bits, then rounds as one rounding would (Boldo and Melquiond 2008).
#[cold]
fn round_to_odd(product: f64, z: f64, sum: f64) -> f64 {
    // Knuth's TwoSum: what the sum lost.
    let z_part = sum - product;
    let error = (product - (sum - z_part)) + (z - z_part);
    // Not so for NaN, where the sum is infinite or NaN.
    let is_inexact = error.abs() > 0.0;
    match sum.to_bits() {
        bits if !is_inexact || bits & 1 == 1 => sum,
        bits if (error > 0.0) == (sum > 0.0) => f64::from_bits(bits + 1),
        bits => f64::from_bits(bits - 1),
    }
}
