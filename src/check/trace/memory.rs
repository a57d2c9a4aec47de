//! The rows of minibatches, and which rows are sampled.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use super::ends::Episodes;
use super::file::Trace;
use super::rows::RowOrigin;
use super::{Judgement, counted};

/// Rows that are enough to speak of all of them.
const ENOUGH_ROWS: usize = 20;
/// Minibatches that are enough to speak of all of them.
const ENOUGH: usize = 5;
/// A natural logarithm of a probability that no right loop meets.
const NEVER: f64 = -50.0;

struct Sampled {
    rows: Range<usize>,
    size: usize,
    /// Steps before its update.
    steps: usize,
}

fn minibatches(trace: &Trace) -> Vec<Sampled> {
    let updates = &trace.batches.update;
    let rows = (0..updates.len()).collect::<Vec<_>>();
    let minibatch = |rows: &[usize]| {
        let steps = trace.updates.step.get(updates[rows[0]]).copied().unwrap_or(0);
        Sampled { rows: rows[0]..rows[0] + rows.len(), size: rows.len(), steps }
    };
    rows.chunk_by(|a, b| updates[*a] == updates[*b]).map(minibatch).collect()
}

pub(super) fn judge(trace: &Trace, origins: &[RowOrigin], episodes: &Episodes, judgement: &mut Judgement) {
    let minibatches = minibatches(trace);
    if minibatches.is_empty() {
        judgement
            .doubt("no minibatch was recorded, so nothing is said of the memory: give `learned` the batch");
        return;
    }
    repeated(trace, &minibatches, judgement);
    if origins.is_empty() {
        judgement.doubt(
            "which steps the minibatches are from: their observations are of another size than the environment's, or most \
             of them are the same",
        );
        return;
    }
    if changed(trace, origins, judgement) {
        return;
    }
    if count(origins, RowOrigin::Unknown) * 10 > origins.len() * 9 {
        judgement.doubt(
            "which steps the minibatches are from: their observations are not those of the environment. If a wrapper scales \
             them, let recorder.environment be the outermost one; if they are scaled elsewhere, use a wrapper",
        );
        return;
    }
    contents(trace, origins, episodes, judgement);
    if !judgement.has(&["state_not_advanced", "row_that_never_happened", "next_is_current"]) {
        stored_ends(trace, origins, judgement);
        ages(trace, origins, episodes, &minibatches, judgement);
    }
}

fn count(origins: &[RowOrigin], kind: RowOrigin) -> usize {
    origins.iter().filter(|origin| **origin == kind).count()
}

/// Minibatches of one transition.
fn repeated(trace: &Trace, minibatches: &[Sampled], judgement: &mut Judgement) {
    let batches = &trace.batches;
    let row = |row: usize| {
        (batches.observations.row(row), batches.next_observations.row(row), batches.actions[row])
    };
    let is_late = |one: &&Sampled| one.size >= 4 && one.steps >= 4 * one.size;
    let late: Vec<_> = minibatches.iter().filter(is_late).collect();
    let is_one = |one: &&&Sampled| one.rows.clone().all(|other| row(other) == row(one.rows.start));
    let same = late.iter().filter(is_one).count();
    if same >= ENOUGH && same * 10 >= late.len() * 9 {
        judgement.name("one_transition_repeated", format!("{same} of {} minibatches", late.len()));
    }
}

/// Rows of which one observation is not the environment's, or is rounded.
fn changed(trace: &Trace, origins: &[RowOrigin], judgement: &mut Judgement) -> bool {
    let all = origins.len();
    let [s, next, unknown] = [RowOrigin::UnknownObservation, RowOrigin::UnknownNext, RowOrigin::Unknown]
        .map(|kind| count(origins, kind));
    let mostly = |number: usize| number >= ENOUGH_ROWS && number * 10 >= all * 9;
    let whole = |values: &[f32]| values.iter().all(|value| value.fract() == 0.0);
    let numbers = if mostly(s) {
        format!("s′ of {s} of {all} rows is one that the environment gave, s is not")
    } else if mostly(next) {
        format!("s of {next} of {all} rows is one that the environment gave, s′ is not")
    } else if mostly(unknown)
        && whole(&trace.batches.observations.values)
        && !whole(&trace.steps.observation.values)
    {
        format!("the observations of all {all} rows are whole numbers, those of the environment are not")
    } else {
        return false;
    };
    judgement.name("observation_changed", numbers);
    true
}

/// Whether the rows are steps of the task.
fn contents(trace: &Trace, origins: &[RowOrigin], episodes: &Episodes, judgement: &mut Judgement) {
    let (batches, all) = (&trace.batches, origins.len());
    let same = count(origins, RowOrigin::Same);
    if same >= ENOUGH_ROWS && same * 10 >= all * 9 {
        judgement.name("next_is_current", format!("in {same} of {all} rows"));
        return;
    }
    let reset = origins.iter().zip(&batches.terminated);
    let reset = reset.filter(|(origin, ends)| **origin == RowOrigin::IntoReset && !**ends).count();
    if reset >= 3 {
        let numbers = format!("{reset} of {all} rows lead there without being stored as terminated");
        judgement.name("next_is_reset", numbers);
    }
    let spans = spans(origins);
    let from_start = spans.iter().filter(|span| episodes.first[span.first] == span.first).count();
    let lengths: BTreeSet<_> = spans.iter().map(|span| span.between).collect();
    if spans.len() >= ENOUGH_ROWS && from_start * 100 >= spans.len() * 95 && lengths.len() >= 3 {
        let farthest = lengths.last().map_or(0, |length| length + 1);
        let (spans, farthest) = (spans.len(), counted(farthest, "step"));
        let numbers = format!(
            "s of {from_start} of {spans} rows is the first of its episode, s′ is up to {farthest} on"
        );
        judgement.name("state_not_advanced", numbers);
        return;
    }
    let most = most_between(&spans);
    // A sample of n steps may end at the newest step.
    let is_newest = |span: &Span| {
        let until = trace.updates.step.get(batches.update[span.row]).copied().unwrap_or(0);
        span.last + trace.header.environments.max(1) >= until
    };
    let is_right = |span: &&Span| {
        span.between == most || (span.between < most && (trace.ended(span.last) || is_newest(span)))
    };
    let wrong = spans.len() - spans.iter().filter(is_right).count();
    let never = count(origins, RowOrigin::Never) + wrong;
    if never >= ENOUGH_ROWS && never * 20 >= all {
        let numbers = format!("{never} of {all} rows; both observations are in the record");
        judgement.name("row_that_never_happened", numbers);
        return;
    }
    actions(trace, &spans, judgement);
    match most {
        0 => rewards(trace, &spans, judgement),
        _ => judgement.fact(format!("rows of {} steps", most + 1)),
    }
}

/// A row whose steps are known.
struct Span {
    row: usize,
    first: usize,
    last: usize,
    between: usize,
}

fn spans(origins: &[RowOrigin]) -> Vec<Span> {
    let span = |(row, origin): (usize, &RowOrigin)| match *origin {
        RowOrigin::Steps { first, last, between } => Some(Span { row, first, last, between }),
        _ => None,
    };
    origins.iter().enumerate().filter_map(span).collect()
}

/// n − 1 of most rows.
fn most_between(spans: &[Span]) -> usize {
    let mut lengths: BTreeMap<usize, usize> = BTreeMap::new();
    spans.iter().for_each(|span| *lengths.entry(span.between).or_default() += 1);
    lengths.into_iter().max_by_key(|(_, number)| *number).map_or(0, |(length, _)| length)
}

fn actions(trace: &Trace, spans: &[Span], judgement: &mut Judgement) {
    let pair = |span: &Span| (trace.batches.actions[span.row], trace.steps.action[span.first]);
    let other = spans.iter().map(pair).filter(|(stored, done)| stored != done).count();
    if other < 3 {
        return;
    }
    let pairs: BTreeSet<_> = spans.iter().map(pair).collect();
    let (stored, done): (BTreeSet<_>, BTreeSet<_>) = pairs.iter().copied().unzip();
    if pairs.len() == stored.len() && stored != done && stored.len() > 1 {
        judgement.fact("actions are stored under other numbers than the environment gets".into());
    } else {
        let numbers = format!("{other} of {} rows have another action than their step", spans.len());
        judgement.name("stored_action_is_another", numbers);
    }
}

fn rewards(trace: &Trace, spans: &[Span], judgement: &mut Judgement) {
    let (stored, steps) = (&trace.batches.rewards, &trace.steps);
    let is_of = |row: usize, step: usize| {
        (stored[row] - steps.reward[step]).abs() <= 1e-5 * (1.0 + steps.reward[step].abs())
    };
    let other = spans.iter().filter(|span| !is_of(span.row, span.first)).count();
    if other == 0 {
        return;
    }
    let shown = format!("{other} of {} rows have another reward than their step", spans.len());
    let mut after = vec![None; steps.action.len()];
    for (row, before) in steps.previous.iter().enumerate() {
        before.iter().for_each(|&before| after[before] = Some(row));
    }
    for (neighbours, name) in [(&steps.previous, "before"), (&after, "after")] {
        let known = spans.iter().filter_map(|span| Some((span.row, neighbours[span.first]?)));
        let known: Vec<_> = known.collect();
        let fits = known.iter().filter(|(row, step)| is_of(*row, *step)).count();
        if other >= ENOUGH_ROWS && other * 5 >= spans.len() && fits * 100 >= known.len() * 95 {
            let numbers = format!("{shown}, {fits} of {} that of the step {name}", known.len());
            judgement.name("reward_of_another_step", numbers);
            return;
        }
    }
    judgement.fact(format!("{shown}: scaled, clipped or shaped"));
}

/// Whether the ends are stored as the environment said them.
fn stored_ends(trace: &Trace, origins: &[RowOrigin], judgement: &mut Judgement) {
    let (steps, stored) = (&trace.steps, &trace.batches.terminated);
    let ends = |is_such: &dyn Fn(usize) -> bool| {
        let all: Vec<Span> = spans(origins).into_iter().filter(|span| is_such(span.last)).collect();
        (all.len(), all.iter().filter(|span| stored[span.row]).count())
    };
    let (cut, as_terminated) = ends(&|last| steps.truncated[last] && !steps.terminated[last]);
    let (terminated, kept) = ends(&|last| steps.terminated[last]);
    if as_terminated >= 2 && as_terminated * 2 > cut {
        let numbers = format!("{as_terminated} of {cut} rows with which the time limit ended an episode");
        judgement.name("time_limit_stored_as_terminated", numbers);
    }
    let lost = terminated - kept;
    if terminated >= 3 && lost * 2 > terminated {
        let numbers = format!("{lost} of {terminated} rows with which an episode terminated");
        judgement.name("terminated_never_stored", numbers);
    }
    if cut == 0 && !judgement.has(&["next_is_reset"]) {
        judgement.doubt(
            "whether rows at the time limit are stored rightly: no recorded minibatch has one. \
             gymnasium.make(…, max_episode_steps=20) shows it within a minute",
        );
    }
}

/// A minibatch, and the first step of each of its rows.
type Known<'a> = (&'a Sampled, Vec<usize>);

/// Which of the steps so far are sampled.
fn ages(
    trace: &Trace, origins: &[RowOrigin], episodes: &Episodes, minibatches: &[Sampled],
    judgement: &mut Judgement,
) {
    let firsts = |one: &Sampled| spans(&origins[one.rows.clone()]).iter().map(|span| span.first).collect();
    let mut known: Vec<Known> = minibatches.iter().map(|one| (one, firsts(one))).collect();
    too_early(&known[0], judgement);
    // Those of which all but a few steps are known.
    known.retain(|(one, firsts)| firsts.len() * 10 >= one.size * 9);
    let age = |one: &Sampled, first: usize| one.steps.saturating_sub(first);
    let ages = known.iter().flat_map(|(one, firsts)| firsts.iter().map(|&first| age(one, first)));
    let Some((oldest, (last, _))) = ages.max().zip(known.last()) else { return };
    let (steps, size) = (last.steps, last.size);
    let late: Vec<_> = known.iter().filter(|(one, _)| one.steps >= 8 * one.size && one.size > 1).collect();
    let span = trace.header.environments.max(1) * 2;
    let is_newest = |(one, firsts): &&&Known| {
        let distinct: BTreeSet<_> = firsts.iter().collect();
        distinct.len() == firsts.len() && firsts.iter().all(|&first| age(one, first) <= one.size + span)
    };
    let newest = late.iter().filter(is_newest).count();
    let half: Vec<_> = known.iter().filter(|(one, _)| 2 * one.steps > steps).collect();
    let latest = half.iter().flat_map(|(_, firsts)| firsts).max().copied().unwrap_or(0);
    let sampled: usize = half.iter().map(|(_, firsts)| firsts.len()).sum();
    let are_old = half.iter().all(|(one, _)| one.steps * 10 > latest * 13);
    if newest >= ENOUGH && newest * 10 >= late.len() * 9 {
        judgement.name("samples_only_newest", format!("{newest} of {} minibatches", late.len()));
    } else if half.len() >= ENOUGH && sampled >= 100 && are_old && latest > 0 {
        let newest = latest + 1;
        let numbers = format!("of {sampled} rows none is newer than step {newest}, up to step {steps}");
        judgement.name("samples_only_oldest", numbers);
    } else if is_emptied(trace, episodes, &known) {
        let numbers =
            format!("all rows of {} minibatches are from the episode in which they are learned", known.len());
        judgement.name("memory_emptied", numbers);
    } else if oldest * 10 < 36 * size && late.len() >= ENOUGH && size > 1 {
        let numbers = format!("no row is older than {oldest} steps with minibatches of {size}");
        judgement.name("memory_too_small", numbers);
    } else {
        let (about, more) = if oldest * 10 < steps * 9 { ("about ", "") } else { ("", " or more") };
        judgement.fact(format!("the memory holds {about}{oldest} rows{more}"));
    }
}

/// More rows in the first minibatch than there are steps.
fn too_early((one, firsts): &Known, judgement: &mut Judgement) {
    let distinct: BTreeSet<_> = firsts.iter().collect();
    if firsts.len() == one.size && one.steps < one.size && distinct.len() < one.size {
        let steps = counted(one.steps, "step");
        let numbers = format!("the first minibatch has {} rows after {steps}", one.size);
        judgement.name("learns_before_a_batch_is_there", numbers);
    }
}

/// Whether no minibatch reaches behind the start of the current episode, although the memory is large enough.
fn is_emptied(trace: &Trace, episodes: &Episodes, known: &[Known]) -> bool {
    let start = |one: &Sampled| episodes.first[one.steps.max(1) - 1];
    let stays = |(one, firsts): &Known| firsts.iter().all(|&first| first >= start(one));
    if trace.header.environments > 1 || episodes.starts.len() < ENOUGH || !known.iter().all(stays) {
        return false;
    }
    let length = |one: &Sampled| (one.steps - start(one)).max(1);
    let longest = known.iter().map(|(one, _)| length(one)).max().unwrap_or(1);
    // The chance of a memory of the longest episode to have given only rows of the current one.
    let chance = |(one, firsts): &Known| {
        let share = length(one) as f64 / longest.min(one.steps.max(1)) as f64;
        firsts.len() as f64 * share.min(1.0).ln()
    };
    known.iter().map(chance).sum::<f64>() < NEVER
}
