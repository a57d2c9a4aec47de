//! Statistics over training seeds, as pure functions; `docs/statistics.md` has the formulas.
//!
//! After Agarwal et al. 2021, "Deep Reinforcement Learning at the Edge of the Statistical Precipice", and Patterson et al.
//! 2024, "Empirical Design in Reinforcement Learning". A sample is one number per seed, **sorted** (see [`sorted`]).

use serde::Serialize;

use crate::rng::Rng;

/// Bootstrap resamples per interval.
pub const RESAMPLES: usize = 2000;
/// Seed of the resampling, the same for every interval, so that equal studies give equal bytes.
pub const BOOTSTRAP_SEED: u64 = 0;
/// With fewer seeds there are no intervals: a bootstrap of so few is too narrow.
pub const LEAST_SEEDS: usize = 10;
/// 0.975 quantile of the standard normal distribution.
const Z: f64 = 1.959_963_984_540_054;

/// A number and its 95 % interval; none with fewer than [`LEAST_SEEDS`] seeds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Estimate {
    /// The number.
    pub value: f64,
    /// Lower end of the interval.
    pub low: Option<f64>,
    /// Upper end of the interval.
    pub high: Option<f64>,
}

impl Estimate {
    fn new(value: f64, interval: Option<(f64, f64)>) -> Self {
        Self { value, low: interval.map(|(low, _)| low), high: interval.map(|(_, high)| high) }
    }

    /// A statistic of a sample with its percentile bootstrap interval.
    pub fn of(sample: &[f64], statistic: impl Fn(&[f64]) -> f64) -> Self {
        let mut resampled = Vec::new();
        let interval = bootstrap(sample.len(), |rng| {
            resample(sample, rng, &mut resampled);
            statistic(&resampled)
        });
        Self::new(statistic(sample), interval)
    }

    /// A statistic of two independent samples with its percentile bootstrap interval.
    pub fn of_two(x: &[f64], y: &[f64], statistic: impl Fn(&[f64], &[f64]) -> f64) -> Self {
        let (mut a, mut b) = (Vec::new(), Vec::new());
        let interval = bootstrap(x.len().min(y.len()), |rng| {
            resample(x, rng, &mut a);
            resample(y, rng, &mut b);
            statistic(&a, &b)
        });
        Self::new(statistic(x, y), interval)
    }

    /// The share `count / total` with its Wilson score interval (Wilson 1927).
    pub fn share(count: usize, total: usize) -> Self {
        let interval = (total >= LEAST_SEEDS).then(|| wilson(count, total));
        Self::new(count as f64 / total as f64, interval)
    }
}

/// Values in ascending order.
pub fn sorted(values: impl IntoIterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.into_iter().collect();
    values.sort_by(f64::total_cmp);
    values
}

/// Arithmetic mean.
pub fn mean(sample: &[f64]) -> f64 {
    sample.iter().sum::<f64>() / sample.len() as f64
}

/// The middle value, or the mean of the two in the middle.
pub fn median(sample: &[f64]) -> f64 {
    percentile(sample, 0.5)
}

/// Interquartile mean: that of what is left when ⌊n/4⌋ values go at either end.
pub fn iqm(sample: &[f64]) -> f64 {
    let cut = sample.len() / 4;
    mean(&sample[cut..sample.len() - cut])
}

/// Quantile `q` in 0…1 with linear interpolation, as `numpy.percentile` has it.
pub fn percentile(sample: &[f64], q: f64) -> f64 {
    let place = q * (sample.len() - 1) as f64;
    let below = place.floor() as usize;
    let above = (below + 1).min(sample.len() - 1);
    sample[below] + (sample[above] - sample[below]) * (place - below as f64)
}

/// P(X > Y) + ½ P(X = Y) for one draw from each sample: the Mann–Whitney U of `x` over the number of pairs.
pub fn probability_of_improvement(x: &[f64], y: &[f64]) -> f64 {
    let (mut below, mut not_above) = (0, 0);
    let mut twice_u = 0;
    for &value in x {
        while below < y.len() && y[below] < value {
            below += 1;
        }
        while not_above < y.len() && y[not_above] <= value {
            not_above += 1;
        }
        twice_u += below + not_above;
    }
    twice_u as f64 / 2.0 / (x.len() * y.len()) as f64
}

/// Share of values above `tau`: a point of the performance profile.
pub fn count_above(sample: &[f64], tau: f64) -> usize {
    sample.len() - sample.partition_point(|&value| value <= tau)
}

/// Wilson's 95 % score interval of a share.
pub fn wilson(count: usize, total: usize) -> (f64, f64) {
    let (n, p, zz) = (total as f64, count as f64 / total as f64, Z * Z);
    let centre = p + zz / (2.0 * n);
    let half = Z * (p * (1.0 - p) / n + zz / (4.0 * n * n)).sqrt();
    let scale = 1.0 + zz / n;
    (((centre - half) / scale).max(0.0), ((centre + half) / scale).min(1.0))
}

/// The smallest value that at least the share `q` of all reaches, where `total − sample.len()` of all never do and
/// count as infinite; none if it is one of those.
pub fn censored_quantile(sample: &[u64], total: usize, q: f64) -> Option<u64> {
    let rank = (q * total as f64).ceil().max(1.0) as usize;
    sample.get(rank - 1).copied()
}

/// The middle 95 % of a statistic over [`RESAMPLES`] resamples; none for less than [`LEAST_SEEDS`] seeds.
fn bootstrap(seeds: usize, mut statistic: impl FnMut(&mut Rng) -> f64) -> Option<(f64, f64)> {
    if seeds < LEAST_SEEDS {
        return None;
    }
    let mut rng = Rng::from_seed(BOOTSTRAP_SEED);
    let values = sorted((0..RESAMPLES).map(|_| statistic(&mut rng)));
    Some((percentile(&values, 0.025), percentile(&values, 0.975)))
}

/// Draws as many values as there are, with replacement; the result is sorted because it is counted out in order.
fn resample(sample: &[f64], rng: &mut Rng, resampled: &mut Vec<f64>) {
    let mut counts = vec![0_u32; sample.len()];
    for _ in sample {
        counts[rng.below(sample.len() as u64) as usize] += 1;
    }
    resampled.clear();
    for (&value, &count) in sample.iter().zip(&counts) {
        resampled.extend((0..count).map(|_| value));
    }
}

/// `value [low, high]`.
pub(super) fn shown(estimate: &Estimate, digits: usize) -> String {
    match (estimate.low, estimate.high) {
        (Some(low), Some(high)) => format!("{:.digits$} [{low:.digits$}, {high:.digits$}]", estimate.value),
        _ => format!("{:.digits$}", estimate.value),
    }
}
