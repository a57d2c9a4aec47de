//! Where each row of a minibatch comes from.

use std::collections::HashMap;

use super::file::{Trace, Vectors};

/// Most steps with the same observation that are looked at.
const MAX_SAME: usize = 64;
/// Most steps of an n-step row.
const MAX_STEPS: usize = 200;

/// What a row of a minibatch is, by the steps that were recorded before its update.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum RowOrigin {
    /// From the observation of the first step to the next observation of the last one, `between` steps of the episode later.
    Steps { first: usize, last: usize, between: usize },
    /// s′ is s, which no step has done.
    Same,
    /// From an observation with which an episode ended, to the start of the next one.
    IntoReset,
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
struct Index {
    /// The latest of each, and for each the one before it.
    latest: HashMap<Vec<u32>, usize>,
    before: Vec<Option<usize>>,
}

impl Index {
    fn new(rows: &Vectors, count: usize) -> Self {
        let mut latest = HashMap::new();
        let before = (0..count).map(|row| latest.insert(bits(rows.row(row)), row)).collect();
        Self { latest, before }
    }

    /// The steps with this observation, among the first `until`, the latest first.
    fn find(&self, observation: &[f32], until: usize) -> impl Iterator<Item = usize> {
        let latest = self.latest.get(&bits(observation)).copied();
        std::iter::successors(latest, |row| self.before[*row]).filter(move |row| *row < until).take(MAX_SAME)
    }
}

fn bits(row: &[f32]) -> Vec<u32> {
    row.iter().map(|value| value.to_bits()).collect()
}

/// The origin of each row of the minibatches; none if the sizes of observations differ, or too many of them are the same.
pub(super) fn origins(trace: &Trace) -> Vec<RowOrigin> {
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
        let (s, next) = (batches.observations.row(row), batches.next_observations.row(row));
        origin(trace, &seen, &reached, s, next, until)
    });
    origins.collect()
}

fn origin(trace: &Trace, seen: &Index, reached: &Index, s: &[f32], next: &[f32], until: usize) -> RowOrigin {
    let steps = &trace.steps;
    let found = |last: usize| {
        let back = std::iter::successors(Some(last), |row| trace.before(*row)).take(MAX_STEPS).enumerate();
        let mut from_s = back.filter(|(_, row)| steps.observation.row(*row) == s);
        from_s.next().map(|(between, first)| RowOrigin::Steps { first, last, between })
    };
    if let Some(origin) = reached.find(next, until).find_map(found) {
        return origin;
    }
    if s == next {
        return RowOrigin::Same;
    }
    // The episode that begins with s′ may not have made a step yet.
    let end_before = |row: usize| steps.previous[row].filter(|_| steps.reset[row] > 0);
    let end = seen.find(next, usize::MAX).find_map(end_before).filter(|&end| end < until);
    if end.is_some_and(|end| steps.observation.row(end) == s || steps.next_observation.row(end) == s) {
        return RowOrigin::IntoReset;
    }
    let is_reached = |row: &[f32]| reached.find(row, until).next().is_some();
    match (seen.find(s, until).next().is_some() || is_reached(s), is_reached(next) || end.is_some()) {
        (true, true) => RowOrigin::Never,
        (false, true) => RowOrigin::UnknownObservation,
        (true, false) => RowOrigin::UnknownNext,
        (false, false) => RowOrigin::Unknown,
    }
}
