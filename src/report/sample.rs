//! One number per seed, in ascending order, and how samples are drawn from it again: value by value, or, where there are many
//! seeds, group by group. A bootstrap of a million seeds draws 2,000 million values for every number of a report.

use std::borrow::Cow;
use std::ops::Range;

use crate::rng::Rng;

/// Most seeds with which a bootstrap draws seed by seed; with more seeds it draws group by group.
pub(crate) const EXACT_SEEDS: usize = 10_000;
/// No group of a sample is wider than this share of the sample's range.
const WIDTHS: f64 = 1024.0;
/// Up to this many equal values are added one by one, which gives the bits of a plain sum.
const ADDED_SINGLY: usize = 64;
/// Largest mean at which a binomial number is drawn by inversion; above, it is a rounded normal number.
const INVERTED: f64 = 32.0;

/// Values in ascending order, each with its count.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sample {
    values: Vec<f64>,
    counts: Vec<usize>,
    total: usize,
}

pub fn sorted(values: impl IntoIterator<Item = f64>) -> Sample {
    let mut values: Vec<f64> = values.into_iter().collect();
    values.sort_unstable_by(f64::total_cmp);
    Sample { counts: vec![1; values.len()], total: values.len(), values }
}

impl Sample {
    pub fn len(&self) -> usize {
        self.total
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = (f64, usize)> {
        self.values.iter().copied().zip(self.counts.iter().copied())
    }

    /// The value at a place in the order, from 0.
    pub fn at(&self, place: usize) -> f64 {
        let mut end = 0;
        let is_there = |&(_, count): &(f64, usize)| {
            end += count;
            place < end
        };
        self.iter().find(is_there).map_or(f64::NAN, |(value, _)| value)
    }

    /// The mean of the values at these places.
    pub(crate) fn mean_of(&self, places: Range<usize>) -> f64 {
        let (mut end, mut sum) = (0, 0.0);
        for (value, count) in self.iter() {
            let start = end;
            end += count;
            match end.min(places.end).saturating_sub(start.max(places.start)) {
                taken if taken <= ADDED_SINGLY => (0..taken).for_each(|_| sum += value),
                taken => sum += value * taken as f64,
            }
        }
        sum / places.len() as f64
    }

    /// Above [`EXACT_SEEDS`]: neighbours in groups, in each of which every value is the mean. A group has either equal values, or
    /// few values that are close to each other. So there are at most about 4 √n + 1,024 groups.
    pub(super) fn grouped(&self) -> Cow<'_, Self> {
        if self.total <= EXACT_SEEDS {
            return Cow::Borrowed(self);
        }
        let most = self.total.isqrt() / 4;
        let range = self.values.last().zip(self.values.first()).map_or(0.0, |(last, first)| last - first);
        let mut grouped = Self { total: self.total, ..Self::default() };
        let mut rest = &self.values[..];
        while let [first, ..] = rest {
            let equal = rest.partition_point(|value| value <= first);
            let close = rest.partition_point(|value| *value <= first + range / WIDTHS);
            let (group, after) = rest.split_at(equal.max(close.min(most)));
            grouped.values.push(group.iter().sum::<f64>() / group.len() as f64);
            grouped.counts.push(group.len());
            rest = after;
        }
        Cow::Owned(grouped)
    }

    /// Draws as many values as there are, with replacement.
    pub(super) fn resample(&self, rng: &mut Rng, resampled: &mut Self) {
        resampled.values.clone_from(&self.values);
        resampled.total = self.total;
        resampled.counts.clear();
        if self.values.len() == self.total {
            resampled.counts.resize(self.total, 0);
            for _ in 0..self.total {
                resampled.counts[rng.below(self.total as u64) as usize] += 1;
            }
            return;
        }
        let (mut draws, mut left) = (self.total, self.total);
        for &count in &self.counts {
            let drawn = binomial(rng, draws, count as f64 / left as f64);
            resampled.counts.push(drawn);
            (draws, left) = (draws - drawn, left - count);
        }
    }
}

/// How many of `n` draws succeed, each with probability `p`.
fn binomial(rng: &mut Rng, n: usize, p: f64) -> usize {
    if p > 0.5 {
        return n - binomial(rng, n, 1.0 - p);
    }
    let mean = n as f64 * p;
    if mean > INVERTED {
        let number = (mean + (mean * (1.0 - p)).sqrt() * normal(rng)).round();
        return (number.max(0.0) as usize).min(n);
    }
    // P(0), and from each the next: P(k + 1) = P(k) · (n − k) / (k + 1) · p / (1 − p).
    let (mut probability, mut rest) = (libm::pow(1.0 - p, n as f64), rng.unit());
    let mut k = 0;
    while rest >= probability && k < n {
        rest -= probability;
        probability *= (n - k) as f64 / (k + 1) as f64 * (p / (1.0 - p));
        k += 1;
    }
    k
}

/// A number of the standard normal distribution, by Marsaglia's polar method.
fn normal(rng: &mut Rng) -> f64 {
    loop {
        let (x, y) = (rng.uniform(-1.0, 1.0), rng.uniform(-1.0, 1.0));
        let square = x * x + y * y;
        if square > 0.0 && square < 1.0 {
            return x * (-2.0 * libm::log(square) / square).sqrt();
        }
    }
}
