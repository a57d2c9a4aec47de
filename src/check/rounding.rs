//! Numbers in f64 together with how far another program's rounding may move each of them.
//!
//! Rounding errors are taken as independent with mean 0: their variances add up, weighted by the square of what multiplies
//! them. A sum of n products in any order has the variance n u² (Σ (wᵢ xᵢ)² + (Σ wᵢ xᵢ)²), where u is the unit of rounding.
//! This is more than blocked sums have. Two numbers agree if they lie within [`SAFETY`] standard deviations.

use std::ops::AddAssign;

use nalgebra::DMatrix;

/// Standard deviations that count as equal.
pub(super) const SAFETY: f64 = 16.0;

/// A number with the variance of its rounding error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Number {
    pub value: f64,
    pub(crate) variance: f64,
}

impl Number {
    /// A number that was not computed.
    pub fn exact(value: f64) -> Self {
        Self { value, variance: 0.0 }
    }

    /// How far another program's number may be away.
    pub(crate) fn tolerance(&self) -> f64 {
        SAFETY * self.variance.sqrt()
    }

    /// Adds to the variance that the number may be off by `distance` altogether.
    pub(super) fn may_be_off_by(&mut self, distance: f64) {
        self.variance += square(distance / SAFETY);
    }

    /// The product with an exact factor.
    pub(super) fn scaled(self, factor: f64) -> Self {
        Self { value: self.value * factor, variance: self.variance * square(factor) }
    }
}

impl AddAssign for Number {
    fn add_assign(&mut self, other: Self) {
        self.value += other.value;
        self.variance += other.variance;
    }
}

/// A matrix of [`Number`]s, (batch, features).
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Matrix {
    pub value: DMatrix<f64>,
    pub(crate) variance: DMatrix<f64>,
}

impl Matrix {
    pub fn zeros(rows: usize, columns: usize) -> Self {
        Self { value: DMatrix::zeros(rows, columns), variance: DMatrix::zeros(rows, columns) }
    }

    pub fn get(&self, row: usize, column: usize) -> Number {
        Number { value: self.value[(row, column)], variance: self.variance[(row, column)] }
    }

    /// The variance of each number, and what a sum with it adds for rounding: `growth` times its square.
    pub(super) fn spread(&self, growth: f64) -> DMatrix<f64> {
        self.variance.zip_map(&self.value, |variance, value| variance + growth * square(value))
    }

    pub(crate) fn add(&mut self, row: usize, column: usize, number: Number) {
        self.value[(row, column)] += number.value;
        self.variance[(row, column)] += number.variance;
    }
}

pub(super) fn square(x: f64) -> f64 {
    x * x
}

pub(super) fn agrees(ours: &Number, theirs: f64) -> bool {
    (ours.value - theirs).abs() <= ours.tolerance()
}

/// With six digits at most.
pub(super) fn short(x: f64) -> String {
    let text = rounded(x, 5).to_string();
    if text.len() > 12 { format!("{x:.5e}") } else { text }
}

/// With so many digits behind the first.
pub(super) fn rounded(x: f64, digits: usize) -> f64 {
    format!("{x:.digits$e}").parse().unwrap_or(x)
}
