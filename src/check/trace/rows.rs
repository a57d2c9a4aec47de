//! Where each row of a minibatch comes from.

use std::collections::HashMap;
use std::hash::{DefaultHasher, Hasher};

use super::file::{Rows, Trace};

/// Most steps with the same observation that are looked at.
const MAX_SAME: usize = 64;
/// Most steps of an n-step row.
const MAX_STEPS: usize = 200;

/// What a row of a minibatch is, by the steps that were recorded before its update.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Origin {
    /// From the observation of the first step to the next observation of the last one, `between` steps of the episode later.
    Steps { first: usize, last: usize, between: usize },
    /// s′ is s, which no step has done.
    Same,
    /// From an observation after which this step ended the episode, to the start of the next one.
    IntoReset { end: usize },
    /// Both were seen, but one did not follow the other.
    Never,
    /// s′ was seen, and s was not.
    UnknownObservation,
    /// s was seen, and s′ was not.
    UnknownNext,
    /// Neither was.
    Unknown,
}

/// Steps by one of their observations.
struct Index<'a> {
    rows: &'a Rows,
    /// The latest of each, and for each the one before it.
    latest: HashMap<u64, usize>,
    before: Vec<Option<usize>>,
}

impl<'a> Index<'a> {
    fn new(rows: &'a Rows, count: usize) -> Self {
        let mut index = Self { rows, latest: HashMap::new(), before: Vec::with_capacity(count) };
        for row in 0..count {
            index.before.push(index.latest.insert(hash(rows.row(row)), row));
        }
        index
    }

    /// The steps with this observation, among the first `until`, the latest first.
    fn find<'b>(&'b self, observation: &'b [f32], until: usize) -> impl Iterator<Item = usize> + 'b {
        let latest = self.latest.get(&hash(observation)).copied();
        let all = std::iter::successors(latest, |row| self.before[*row]);
        all.filter(move |row| *row < until && self.rows.row(*row) == observation).take(MAX_SAME)
    }
}

fn hash(row: &[f32]) -> u64 {
    let mut hasher = DefaultHasher::new();
    row.iter().for_each(|value| hasher.write_u32(value.to_bits()));
    hasher.finish()
}

/// The origin of each row of the minibatches; none if steps and minibatches have observations of other sizes, or too many of
/// the observations are the same.
pub(super) fn origins(trace: &Trace) -> Vec<Origin> {
    let (steps, batches) = (&trace.steps, &trace.batches);
    let count = steps.action.len();
    if count == 0 || steps.observation.width != batches.observations.width || steps.observation.width == 0 {
        return Vec::new();
    }
    let seen = Index::new(&steps.observation, count);
    if seen.latest.len() * 2 < count {
        return Vec::new();
    }
    let reached = Index::new(&steps.next_observation, count);
    let origins = batches.update.iter().enumerate().map(|(row, &update)| {
        let until = trace.updates.step.get(update).map_or(count, |step| *step);
        origin(
            trace,
            &seen,
            &reached,
            batches.observations.row(row),
            batches.next_observations.row(row),
            until,
        )
    });
    origins.collect()
}

fn origin(trace: &Trace, seen: &Index, reached: &Index, s: &[f32], next: &[f32], until: usize) -> Origin {
    let steps = &trace.steps;
    let back = |last: usize| {
        let in_episode = |row: &usize| steps.previous[*row].filter(|_| steps.reset[*row] == 0);
        let mut rows = std::iter::successors(Some(last), in_episode).take(MAX_STEPS).enumerate();
        rows.find(|(_, row)| steps.observation.row(*row) == s)
    };
    let found = |last: usize| back(last).map(|(between, first)| Origin::Steps { first, last, between });
    if let Some(origin) = reached.find(next, until).find_map(found) {
        return origin;
    }
    if s == next {
        return Origin::Same;
    }
    // The episode that begins with s′ may not have made a step yet.
    let is_start = |row: usize| steps.previous[row].filter(|_| steps.reset[row] > 0);
    let start = seen.find(next, usize::MAX).find_map(is_start).filter(|&end| end < until);
    if let Some(end) = start
        && (steps.observation.row(end) == s || steps.next_observation.row(end) == s)
    {
        return Origin::IntoReset { end };
    }
    let is_seen = seen.find(s, until).next().is_some() || reached.find(s, until).next().is_some();
    match (is_seen, reached.find(next, until).next().is_some() || start.is_some()) {
        (true, true) => Origin::Never,
        (false, true) => Origin::UnknownObservation,
        (true, false) => Origin::UnknownNext,
        (false, false) => Origin::Unknown,
    }
}
