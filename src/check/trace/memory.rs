//! The rows of minibatches, and which rows are sampled.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use super::ends::Episodes;
use super::file::Trace;
use super::rows::Origin;
use super::{Judgement, count, counted};

/// Rows that are enough to speak of all of them.
const ENOUGH_ROWS: usize = 20;
/// Minibatches that are enough to speak of all of them.
const ENOUGH: usize = 5;
/// A natural logarithm of a probability that no right loop meets.
const NEVER: f64 = -50.0;

/// A recorded minibatch.
struct Minibatch {
    rows: Range<usize>,
    /// Steps before its update.
    steps: usize,
}

impl Minibatch {
    fn size(&self) -> usize {
        self.rows.len()
    }
}

fn minibatches(trace: &Trace) -> Vec<Minibatch> {
    let mut all: Vec<Minibatch> = Vec::new();
    for (row, &update) in trace.batches.update.iter().enumerate() {
        match all.last_mut() {
            Some(last) if trace.batches.update[last.rows.start] == update => last.rows.end = row + 1,
            _ => {
                let steps = trace.updates.step.get(update).copied().unwrap_or(0);
                all.push(Minibatch { rows: row..row + 1, steps });
            }
        }
    }
    all
}

pub(super) fn judge(trace: &Trace, origins: &[Origin], episodes: &Episodes, judgement: &mut Judgement) {
    let minibatches = minibatches(trace);
    if minibatches.is_empty() {
        judgement.doubt(
            "no minibatch was recorded, so nothing is said of the memory: give `learned` the batch".into(),
        );
        return;
    }
    repeated(trace, &minibatches, judgement);
    if origins.is_empty() {
        judgement.doubt(
            "which steps the minibatches are from: their observations are of another size than the environment's, or most \
             of them are the same"
                .into(),
        );
        return;
    }
    let unknown = origins.iter().filter(|origin| **origin == Origin::Unknown).count();
    if changed(trace, origins, judgement) {
        return;
    }
    if unknown * 10 > origins.len() * 9 {
        judgement.doubt(
            "which steps the minibatches are from: their observations are not those of the environment. If a wrapper scales \
             them, let recorder.environment be the outermost one; if they are scaled elsewhere, use a wrapper"
                .into(),
        );
        return;
    }
    contents(trace, origins, episodes, judgement);
    if !judgement.has(&["state_not_advanced", "row_that_never_happened", "next_is_current"]) {
        stored_ends(trace, origins, judgement);
        ages(trace, origins, episodes, &minibatches, judgement);
    }
}

/// Minibatches of one transition.
fn repeated(trace: &Trace, minibatches: &[Minibatch], judgement: &mut Judgement) {
    let batches = &trace.batches;
    let row = |row: usize| {
        (batches.observations.row(row), batches.next_observations.row(row), batches.actions[row])
    };
    let late: Vec<_> =
        minibatches.iter().filter(|one| one.size() >= 4 && one.steps >= 4 * one.size()).collect();
    let same =
        late.iter().filter(|one| one.rows.clone().all(|other| row(other) == row(one.rows.start))).count();
    if same >= ENOUGH && same * 10 >= late.len() * 9 {
        judgement
            .name("one_transition_repeated", format!("{} of {} minibatches", count(same), count(late.len())));
    }
}

/// Rows of which one observation is not the environment's, or is rounded.
fn changed(trace: &Trace, origins: &[Origin], judgement: &mut Judgement) -> bool {
    let of = |kind: Origin| origins.iter().filter(|origin| **origin == kind).count();
    let (s, next, unknown) = (of(Origin::UnknownObservation), of(Origin::UnknownNext), of(Origin::Unknown));
    let all = origins.len();
    let mostly = |number: usize| number * 10 >= all * 9 && number >= ENOUGH_ROWS;
    let whole = |values: &[f32]| values.iter().all(|value| value.fract() == 0.0);
    let numbers = if mostly(s) {
        format!("s′ of {} of {} rows is one that the environment gave, s is not", count(s), count(all))
    } else if mostly(next) {
        format!("s of {} of {} rows is one that the environment gave, s′ is not", count(next), count(all))
    } else if mostly(unknown)
        && whole(&trace.batches.observations.values)
        && !whole(&trace.steps.observation.values)
    {
        format!(
            "the observations of all {} rows are whole numbers, those of the environment are not",
            count(all)
        )
    } else {
        return false;
    };
    judgement.name("observation_changed", numbers);
    true
}

/// Whether the rows are steps of the task.
fn contents(trace: &Trace, origins: &[Origin], episodes: &Episodes, judgement: &mut Judgement) {
    let (batches, all) = (&trace.batches, origins.len());
    let same = origins.iter().filter(|origin| **origin == Origin::Same).count();
    if same >= ENOUGH_ROWS && same * 10 >= all * 9 {
        judgement.name("next_is_current", format!("{} of {} rows", count(same), count(all)));
        return;
    }
    let reset = origins.iter().zip(&batches.terminated);
    let reset = reset.filter(|(origin, ends)| matches!(origin, Origin::IntoReset { .. }) && !**ends).count();
    if reset >= 3 {
        let shown =
            format!("{} of {} rows lead there without being stored as terminated", count(reset), count(all));
        judgement.name("next_is_reset", shown);
    }
    let spans: Vec<Span> = spans(origins).collect();
    let from_start = spans.iter().filter(|span| episodes.first[span.first] == span.first).count();
    let lengths: BTreeSet<_> = spans.iter().map(|span| span.between).collect();
    if spans.len() >= ENOUGH_ROWS && from_start * 100 >= spans.len() * 95 && lengths.len() >= 3 {
        let farthest = counted(lengths.last().map_or(0, |length| length + 1), "step");
        judgement.name(
            "state_not_advanced",
            format!(
                "s of {} of {} rows is the first of its episode, s′ is up to {farthest} on",
                count(from_start),
                count(spans.len())
            ),
        );
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
    let never = origins.iter().filter(|origin| **origin == Origin::Never).count() + wrong;
    if never >= ENOUGH_ROWS && never * 20 >= all {
        let numbers = format!("{} of {} rows; both observations are in the record", count(never), count(all));
        judgement.name("row_that_never_happened", numbers);
        return;
    }
    if most > 0 {
        judgement.fact(format!("rows of {} steps", most + 1));
    }
    actions(trace, &spans, judgement);
    if most == 0 {
        rewards(trace, &spans, judgement);
    }
}

/// A row whose steps are known.
struct Span {
    row: usize,
    first: usize,
    last: usize,
    between: usize,
}

fn spans(origins: &[Origin]) -> impl Iterator<Item = Span> {
    origins.iter().enumerate().filter_map(|(row, origin)| match *origin {
        Origin::Steps { first, last, between } => Some(Span { row, first, last, between }),
        _ => None,
    })
}

/// n − 1 of most rows.
fn most_between(spans: &[Span]) -> usize {
    let mut lengths: BTreeMap<usize, usize> = BTreeMap::new();
    for span in spans {
        *lengths.entry(span.between).or_default() += 1;
    }
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
        return;
    }
    let shown =
        format!("{} of {} rows have another action than their step", count(other), count(spans.len()));
    judgement.name("stored_action_is_another", shown);
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
    let shown =
        format!("{} of {} rows have another reward than their step", count(other), count(spans.len()));
    let mut after = vec![None; steps.action.len()];
    steps
        .previous
        .iter()
        .enumerate()
        .filter_map(|(row, before)| Some((row, (*before)?)))
        .for_each(|(row, before)| after[before] = Some(row));
    for (neighbours, name) in [(&steps.previous, "before"), (&after, "after")] {
        let known: Vec<_> =
            spans.iter().filter_map(|span| Some((span.row, neighbours[span.first]?))).collect();
        let fits = known.iter().filter(|(row, step)| is_of(*row, *step)).count();
        if other >= ENOUGH_ROWS && other * 5 >= spans.len() && fits * 100 >= known.len() * 95 {
            let numbers =
                format!("{shown}, {} of {} that of the step {name}", count(fits), count(known.len()));
            judgement.name("reward_of_another_step", numbers);
            return;
        }
    }
    judgement.fact(format!("{shown}: scaled, clipped or shaped"));
}

/// Whether the ends are stored as the environment said them.
fn stored_ends(trace: &Trace, origins: &[Origin], judgement: &mut Judgement) {
    let (steps, stored) = (&trace.steps, &trace.batches.terminated);
    let share = |is_such: &dyn Fn(usize) -> bool| {
        let all: Vec<Span> = spans(origins).filter(|span| is_such(span.last)).collect();
        (all.len(), all.iter().filter(|span| stored[span.row]).count())
    };
    let (cut, as_terminated) = share(&|last| steps.truncated[last] && !steps.terminated[last]);
    let (terminated, kept) = share(&|last| steps.terminated[last]);
    if as_terminated >= 2 && as_terminated * 2 > cut {
        let numbers = format!(
            "{} of {} rows with which the time limit ended an episode",
            count(as_terminated),
            count(cut)
        );
        judgement.name("time_limit_stored_as_terminated", numbers);
    }
    if terminated >= 3 && (terminated - kept) * 2 > terminated {
        let numbers = format!(
            "{} of {} rows with which an episode terminated",
            count(terminated - kept),
            count(terminated)
        );
        judgement.name("terminated_never_stored", numbers);
    }
    if cut == 0 && !judgement.has(&["next_is_reset"]) {
        judgement.doubt(
            "whether rows at the time limit are stored rightly: no recorded minibatch has one. \
             gymnasium.make(…, max_episode_steps=20) shows it within a minute"
                .into(),
        );
    }
}

/// Which of the steps so far are sampled.
fn ages(
    trace: &Trace,
    origins: &[Origin],
    episodes: &Episodes,
    minibatches: &[Minibatch],
    judgement: &mut Judgement,
) {
    // The steps of each minibatch, where all but a few are known.
    let known: Vec<(&Minibatch, Vec<usize>)> = minibatches
        .iter()
        .map(|one| (one, spans(&origins[one.rows.clone()]).map(|span| span.first).collect::<Vec<_>>()))
        .filter(|(one, firsts)| firsts.len() * 10 >= one.size() * 9)
        .collect();
    too_early(minibatches, origins, judgement);
    let age = |one: &Minibatch, first: usize| one.steps.saturating_sub(first);
    let Some(oldest) =
        known.iter().flat_map(|(one, firsts)| firsts.iter().map(|&first| age(one, first))).max()
    else {
        return;
    };
    let (steps, size) = known.last().map_or((0, 0), |(one, _)| (one.steps, one.size()));
    let late: Vec<_> =
        known.iter().filter(|(one, _)| one.steps >= 8 * one.size() && one.size() > 1).collect();
    let span = trace.header.environments.max(1) * 2;
    let is_newest = |(one, firsts): &&&(&Minibatch, Vec<usize>)| {
        let distinct: BTreeSet<_> = firsts.iter().collect();
        distinct.len() == firsts.len() && firsts.iter().all(|&first| age(one, first) <= one.size() + span)
    };
    let newest = late.iter().filter(is_newest).count();
    let half: Vec<_> = known.iter().filter(|(one, _)| 2 * one.steps > steps).collect();
    let latest = half.iter().flat_map(|(_, firsts)| firsts).max().copied().unwrap_or(0);
    let sampled: usize = half.iter().map(|(_, firsts)| firsts.len()).sum();
    let are_old = half.iter().all(|(one, _)| one.steps * 10 > latest * 13);
    if newest >= ENOUGH && newest * 10 >= late.len() * 9 {
        judgement
            .name("samples_only_newest", format!("{} of {} minibatches", count(newest), count(late.len())));
    } else if half.len() >= ENOUGH && sampled >= 100 && are_old && latest > 0 {
        let numbers = format!(
            "of {} rows none is newer than step {}, up to step {}",
            count(sampled),
            count(latest + 1),
            count(steps)
        );
        judgement.name("samples_only_oldest", numbers);
    } else if let Some(numbers) = emptied(trace, episodes, &known) {
        judgement.name("memory_emptied", numbers);
    } else if oldest * 10 < 36 * size && late.len() >= ENOUGH && size > 1 {
        let numbers =
            format!("no row is older than {} with minibatches of {}", counted(oldest, "step"), count(size));
        judgement.name("memory_too_small", numbers);
    } else if oldest * 10 < steps * 9 {
        judgement.fact(format!("the memory holds about {}", counted(oldest, "row")));
    } else {
        judgement.fact(format!("the memory holds {} or more", counted(oldest, "row")));
    }
}

/// More rows in the first minibatch than there are steps.
fn too_early(minibatches: &[Minibatch], origins: &[Origin], judgement: &mut Judgement) {
    let Some(first) = minibatches.first() else { return };
    let firsts: Vec<_> = spans(&origins[first.rows.clone()]).map(|span| span.first).collect();
    let distinct: BTreeSet<_> = firsts.iter().collect();
    if firsts.len() == first.size() && first.steps < first.size() && distinct.len() < first.size() {
        judgement.name(
            "learns_before_a_batch_is_there",
            format!(
                "the first minibatch has {} rows after {}",
                count(first.size()),
                counted(first.steps, "step")
            ),
        );
    }
}

/// The numbers that show that no minibatch reaches behind the start of the current episode, although the memory is large enough.
fn emptied(trace: &Trace, episodes: &Episodes, known: &[(&Minibatch, Vec<usize>)]) -> Option<String> {
    if trace.header.environments > 1 || episodes.starts.len() < ENOUGH {
        return None;
    }
    let start = |one: &Minibatch| episodes.first[one.steps.max(1) - 1];
    let stays = |(one, firsts): &(&Minibatch, Vec<usize>)| firsts.iter().all(|&first| first >= start(one));
    if !known.iter().all(stays) {
        return None;
    }
    let length = |one: &Minibatch| (one.steps - start(one)).max(1);
    let longest = known.iter().map(|(one, _)| length(one)).max()?;
    // The chance of a memory of the longest episode to have given only rows of the current one.
    let chance: f64 = known
        .iter()
        .map(|(one, firsts)| {
            firsts.len() as f64 * (length(one) as f64 / longest.min(one.steps.max(1)) as f64).min(1.0).ln()
        })
        .sum();
    let shown = format!(
        "all rows of {} are from the episode in which they are learned",
        counted(known.len(), "minibatch").replace("hs", "hes")
    );
    (chance < NEVER).then_some(shown)
}
