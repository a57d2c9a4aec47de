//! Episodes: their starts and their ends.

use super::file::Trace;
use super::{Judgement, counted};

/// Episodes that are described at the end of a run.
const LAST: usize = 20;

#[derive(Debug, Default)]
pub(super) struct Episodes {
    /// The first row of the episode that each row belongs to.
    pub first: Vec<usize>,
    /// Rows with which an episode began.
    pub starts: Vec<usize>,
    /// Returns of the episodes that have ended, in their order.
    returns: Vec<f64>,
}

impl Episodes {
    fn of(trace: &Trace) -> Self {
        let steps = &trace.steps;
        let mut episodes = Self::default();
        let mut totals: Vec<f64> = Vec::new();
        for row in 0..steps.action.len() {
            let before = trace.before(row);
            let first = before.map_or(row, |before| episodes.first[before]);
            episodes.first.push(first);
            if first == row {
                episodes.starts.push(row);
            }
            totals.push(before.map_or(0.0, |before| totals[before]) + steps.reward[row]);
            if trace.ended(row) && !before.is_some_and(|before| trace.ended(before)) {
                episodes.returns.push(totals[row]);
            }
        }
        episodes
    }
}

impl Trace {
    pub(super) fn ended(&self, row: usize) -> bool {
        self.steps.terminated[row] || self.steps.truncated[row]
    }

    /// The step before in the same episode.
    pub(super) fn before(&self, row: usize) -> Option<usize> {
        self.steps.previous[row].filter(|_| self.steps.reset[row] == 0)
    }
}

pub(super) fn judge(trace: &Trace, judgement: &mut Judgement) -> Episodes {
    let (episodes, steps) = (Episodes::of(trace), &trace.steps);
    if steps.action.is_empty() {
        judgement.doubt(
            "no environment step was recorded: step the environment that recorder.environment(env) returns",
        );
        return episodes;
    }
    let ended = episodes.returns.len();
    let terminated = steps.terminated.iter().filter(|terminated| **terminated).count();
    let task = Some(trace.header.environment.as_str()).filter(|name| !name.is_empty()).unwrap_or("a task");
    let vector = match trace.header.environments {
        0 | 1 => String::new(),
        environments => format!(" of {environments} environments"),
    };
    judgement.fact(format!(
        "{}: {}{vector}, {} ended, {terminated} terminated",
        crate::text::visible(task),
        counted(steps.action.len(), "step"),
        counted(ended, "episode"),
    ));
    if ended > 0 {
        let last = &episodes.returns[ended.saturating_sub(LAST)..];
        let mean = last.iter().sum::<f64>() / last.len() as f64;
        judgement.fact(format!("the last {} had a mean return of {mean:.1}", counted(last.len(), "episode")));
    }
    steps_after_ends(trace, judgement);
    same_starts(trace, &episodes, judgement);
    episodes
}

/// Steps whose predecessor ended an episode, without a reset between.
fn steps_after_ends(trace: &Trace, judgement: &mut Judgement) {
    let ends = (0..trace.steps.action.len()).filter_map(|row| trace.before(row));
    let (terminated, truncated): (Vec<usize>, Vec<usize>) =
        ends.filter(|&row| trace.ended(row)).partition(|&row| trace.steps.terminated[row]);
    let (id, rows, by) = match terminated.is_empty() {
        false => ("steps_after_the_end", terminated, "terminated"),
        true => ("truncation_ignored", truncated, "truncated"),
    };
    if let Some(first) = rows.first() {
        let (steps, first) = (counted(rows.len(), "step"), first + 2);
        let numbers = format!("{steps} came after {by} without a reset, the first of them is step {first}");
        judgement.name(id, numbers);
    }
}

fn same_starts(trace: &Trace, episodes: &Episodes, judgement: &mut Judgement) {
    let steps = &trace.steps;
    // The first one may have had another seed.
    let starts = episodes.starts.get(1..).unwrap_or_default();
    let is_same = |row: &usize| steps.observation.row(*row) == steps.observation.row(starts[0]);
    if starts.len() < 3 || !starts.iter().all(is_same) {
        return;
    }
    let shown = counted(starts.len(), "episode");
    // A task may have one start; a seed that is given again and again makes it one.
    if starts[1..].iter().all(|&row| steps.reset[row] == 2) {
        let numbers = format!("{shown}, all reset with the same seed, start from the same observation");
        judgement.name("same_start_every_episode", numbers);
    } else {
        judgement.fact(format!("all {shown} start from the same observation"));
    }
}
