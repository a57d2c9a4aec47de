//! Episodes: their starts and their ends.

use super::file::Trace;
use super::{Judgement, count, counted};

/// Episodes that are described at the end of a run.
const LAST: usize = 20;

/// Where the episodes of a loop are.
#[derive(Debug, Default)]
pub(super) struct Episodes {
    /// The first row of the episode that each row belongs to.
    pub first: Vec<usize>,
    /// Rows with which an episode began.
    pub starts: Vec<usize>,
    /// Returns of the episodes that have ended, in their order, and their lengths.
    pub returns: Vec<f64>,
    pub lengths: Vec<usize>,
}

impl Episodes {
    fn of(trace: &Trace) -> Self {
        let steps = &trace.steps;
        let mut episodes = Self::default();
        let (mut totals, mut lengths) = (Vec::new(), Vec::new());
        for row in 0..steps.action.len() {
            let before = steps.previous[row].filter(|_| steps.reset[row] == 0);
            let first = before.map_or(row, |before| episodes.first[before]);
            episodes.first.push(first);
            if first == row {
                episodes.starts.push(row);
            }
            totals.push(before.map_or(0.0, |before| totals[before]) + steps.reward[row]);
            lengths.push(before.map_or(0, |before| lengths[before]) + 1);
            let went_on = before.is_some_and(|before| trace.ended(before));
            if trace.ended(row) && !went_on {
                episodes.returns.push(totals[row]);
                episodes.lengths.push(lengths[row]);
            }
        }
        episodes
    }
}

impl Trace {
    pub(super) fn ended(&self, row: usize) -> bool {
        self.steps.terminated[row] || self.steps.truncated[row]
    }
}

pub(super) fn judge(trace: &Trace, judgement: &mut Judgement) -> Episodes {
    let episodes = Episodes::of(trace);
    let steps = &trace.steps;
    if steps.action.is_empty() {
        judgement.doubt(
            "no environment step was recorded: step the environment that recorder.environment(env) returns"
                .into(),
        );
        return episodes;
    }
    let ended = episodes.returns.len();
    let terminated = (0..steps.action.len()).filter(|&row| steps.terminated[row]).count();
    let task = Some(trace.header.environment.as_str()).filter(|name| !name.is_empty()).unwrap_or("a task");
    let environments = trace.header.environments;
    let vector = if environments > 1 { format!(" of {environments} environments") } else { String::new() };
    judgement.fact(format!(
        "{}: {}{vector}, {} ended, {} terminated",
        crate::text::visible(task),
        counted(steps.action.len(), "step"),
        counted(ended, "episode"),
        count(terminated)
    ));
    if ended > 0 {
        let last = ended.min(LAST);
        let mean = episodes.returns[ended - last..].iter().sum::<f64>() / last as f64;
        judgement.fact(format!("the last {} had a mean return of {mean:.1}", counted(last, "episode")));
    }
    steps_after_ends(trace, judgement);
    same_starts(trace, &episodes, judgement);
    episodes
}

/// Steps whose predecessor ended an episode, without a reset between.
fn steps_after_ends(trace: &Trace, judgement: &mut Judgement) {
    let steps = &trace.steps;
    let after = |row: &usize| match steps.previous[*row] {
        Some(before) if steps.reset[*row] == 0 && trace.ended(before) => Some(before),
        _ => None,
    };
    let ends: Vec<usize> = (0..steps.action.len()).filter_map(|row| after(&row)).collect();
    let (terminated, truncated): (Vec<usize>, Vec<usize>) =
        ends.into_iter().partition(|&row| steps.terminated[row]);
    let (id, rows, by) = match (terminated.first(), truncated.first()) {
        (Some(_), _) => ("steps_after_the_end", &terminated, "terminated"),
        (None, Some(_)) => ("truncation_ignored", &truncated, "truncated"),
        (None, None) => return,
    };
    let shown = counted(rows.len(), "step");
    judgement.name(
        id,
        format!("{shown} came after {by} without a reset, the first of them is step {}", count(rows[0] + 2)),
    );
}

fn same_starts(trace: &Trace, episodes: &Episodes, judgement: &mut Judgement) {
    let steps = &trace.steps;
    // The first one may have had another seed.
    let starts = episodes.starts.iter().skip(1).map(|&row| (steps.observation.row(row), steps.reset[row]));
    let Some((first, _)) = starts.clone().next() else { return };
    if episodes.starts.len() < 4 || !starts.clone().all(|(start, _)| start == first) {
        return;
    }
    let shown = counted(episodes.starts.len() - 1, "episode");
    // A task may have one start; a seed that is given again and again makes it one.
    if starts.skip(1).all(|(_, reset)| reset == 2) {
        judgement.name(
            "same_start_every_episode",
            format!("{shown}, all reset with the same seed, start from the same observation"),
        );
    } else {
        judgement.fact(format!("all {shown} start from the same observation"));
    }
}
