//! Statistics over training seeds, as pure functions; `docs/statistics.md` has the formulas.
//!
//! After Agarwal et al. 2021, "Deep Reinforcement Learning at the Edge of the Statistical Precipice", and Patterson et al.
//! 2024, "Empirical Design in Reinforcement Learning". A [`Sample`] is one number per seed.

use std::borrow::Cow;

use crate::rng::Rng;

pub(crate) const RESAMPLES: usize = 2000;
/// Seed of the resampling, the same for every interval, so that equal studies give equal bytes.
pub(crate) const BOOTSTRAP_SEED: u64 = 0;
/// With fewer seeds there are no intervals: a bootstrap of so few is too narrow.
pub(crate) const LEAST_SEEDS: usize = 10;
/// 0.975 quantile of the standard normal distribution.
const Z: f64 = 1.959_963_984_540_054;

/// Most seeds that a bootstrap draws one by one; more it draws in groups: a million would be 2,000 million draws a number.
pub(crate) const EXACT_SEEDS: usize = 10_000;
/// No group of a sample is wider than this share of the sample's range.
const WIDTHS: f64 = 1024.0;
/// Up to this many equal values are added one by one, which gives the bits of a plain sum.
const ADDED_SINGLY: usize = 64;
/// Largest mean at which a binomial number is drawn by inversion; above, it is a rounded normal number.
const INVERTED: f64 = 32.0;

/// A number and its 95 % interval; none with fewer than [`LEAST_SEEDS`] seeds.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Estimate {
    pub value: f64,
    pub low: Option<f64>,
    pub high: Option<f64>,
}

impl Estimate {
    fn new(value: f64, interval: Option<(f64, f64)>) -> Self {
        Self { value, low: interval.map(|(low, _)| low), high: interval.map(|(_, high)| high) }
    }

    pub(super) fn interval(&self) -> Option<(f64, f64)> {
        self.low.zip(self.high)
    }

    /// A statistic of a sample with its percentile bootstrap interval, of groups above [`EXACT_SEEDS`] seeds.
    pub fn of(sample: &Sample, statistic: impl Fn(&Sample) -> f64) -> Self {
        Self::exact(&sample.grouped(), &statistic).moved_to(statistic(sample))
    }

    /// As [`Self::of`], seed by seed, however many there are.
    pub fn exact(sample: &Sample, statistic: impl Fn(&Sample) -> f64) -> Self {
        let mut resampled = Sample::default();
        let interval = bootstrap(sample.len(), |rng| {
            sample.resample(rng, &mut resampled);
            statistic(&resampled)
        });
        Self::new(statistic(sample), interval)
    }

    /// A statistic of two independent samples with its percentile bootstrap interval; as [`Self::of`].
    pub fn of_two(x: &Sample, y: &Sample, statistic: impl Fn(&Sample, &Sample) -> f64) -> Self {
        Self::exact_of_two(&x.grouped(), &y.grouped(), &statistic).moved_to(statistic(x, y))
    }

    /// As [`Self::of_two`], seed by seed, however many there are.
    pub fn exact_of_two(x: &Sample, y: &Sample, statistic: impl Fn(&Sample, &Sample) -> f64) -> Self {
        let (mut a, mut b) = (Sample::default(), Sample::default());
        let interval = bootstrap(x.len().min(y.len()), |rng| {
            x.resample(rng, &mut a);
            y.resample(rng, &mut b);
            statistic(&a, &b)
        });
        Self::new(statistic(x, y), interval)
    }

    /// The interval, moved to another value: that of a grouped sample is slightly different.
    fn moved_to(self, value: f64) -> Self {
        let by = value - self.value;
        Self { value, low: self.low.map(|low| low + by), high: self.high.map(|high| high + by) }
    }

    /// The share `count / total` with its Wilson score interval (Wilson 1927).
    pub fn share(count: usize, total: usize) -> Self {
        Self::new(count as f64 / total as f64, (total >= LEAST_SEEDS).then(|| wilson(count, total)))
    }
}

pub fn mean(sample: &Sample) -> f64 {
    sample.mean_of(0..sample.len())
}

/// The middle value, or the mean of the two in the middle.
pub fn median(sample: &Sample) -> f64 {
    let place = 0.5 * (sample.len() - 1) as f64;
    let (below, above) = (sample.at(place.floor() as usize), sample.at(place.ceil() as usize));
    below + (above - below) * (place - place.floor())
}

/// Interquartile mean: that of what is left when ⌊n/4⌋ values go at either end.
pub fn iqm(sample: &Sample) -> f64 {
    let cut = sample.len() / 4;
    sample.mean_of(cut..sample.len() - cut)
}

/// Quantile `q` in 0…1 with linear interpolation, as `numpy.percentile` has it.
fn percentile(sorted: &[f64], q: f64) -> f64 {
    let place = q * (sorted.len() - 1) as f64;
    let below = place.floor() as usize;
    let above = (below + 1).min(sorted.len() - 1);
    sorted[below] + (sorted[above] - sorted[below]) * (place - below as f64)
}

/// P(X > Y) + ½ P(X = Y) for one draw from each sample: the Mann–Whitney U of `x` over the number of pairs.
pub fn probability_of_improvement(x: &Sample, y: &Sample) -> f64 {
    let (mut smaller, mut not_larger) = (y.iter().peekable(), y.iter().peekable());
    let (mut below, mut not_above, mut twice_u) = (0, 0, 0);
    for (value, count) in x.iter() {
        while let Some((_, of_y)) = smaller.next_if(|(other, _)| *other < value) {
            below += of_y;
        }
        while let Some((_, of_y)) = not_larger.next_if(|(other, _)| *other <= value) {
            not_above += of_y;
        }
        twice_u += count * (below + not_above);
    }
    twice_u as f64 / 2.0 / (x.len() * y.len()) as f64
}

/// Share of values above `tau`: a point of the performance profile.
pub fn count_above(sample: &Sample, tau: f64) -> usize {
    sample.iter().filter(|&(value, _)| value > tau).map(|(_, count)| count).sum()
}

/// Wilson's 95 % score interval of a share.
pub fn wilson(count: usize, total: usize) -> (f64, f64) {
    let (n, p, zz) = (total as f64, count as f64 / total as f64, Z * Z);
    let centre = p + zz / (2.0 * n);
    let half = Z * (p * (1.0 - p) / n + zz / (4.0 * n * n)).sqrt();
    let scale = 1.0 + zz / n;
    (((centre - half) / scale).max(0.0), ((centre + half) / scale).min(1.0))
}

/// Quantile `q` of `total` values, of which `sample` has the finite ones in ascending order; none if the quantile is infinite.
pub fn censored_quantile(sample: &[u64], total: usize, q: f64) -> Option<u64> {
    let rank = (q * total as f64).ceil().max(1.0) as usize;
    sample.get(rank - 1).copied()
}

/// The middle 95 % of a statistic over [`RESAMPLES`] resamples; none for fewer than [`LEAST_SEEDS`] seeds.
fn bootstrap(seeds: usize, mut statistic: impl FnMut(&mut Rng) -> f64) -> Option<(f64, f64)> {
    if seeds < LEAST_SEEDS {
        return None;
    }
    let mut rng = Rng::from_seed(BOOTSTRAP_SEED);
    let mut values: Vec<f64> = (0..RESAMPLES).map(|_| statistic(&mut rng)).collect();
    values.sort_unstable_by(f64::total_cmp);
    Some((percentile(&values, 0.025), percentile(&values, 0.975)))
}

/// `value [low, high]`.
pub(super) fn shown(estimate: &Estimate, digits: usize) -> String {
    match estimate.interval() {
        Some((low, high)) => format!("{:.digits$} [{low:.digits$}, {high:.digits$}]", estimate.value),
        None => format!("{:.digits$}", estimate.value),
    }
}

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
    pub(crate) fn mean_of(&self, places: std::ops::Range<usize>) -> f64 {
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
            (0..self.total).for_each(|_| resampled.counts[rng.below(self.total as u64) as usize] += 1);
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
