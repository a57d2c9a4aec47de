//! The evaluations of one run: when it solved, what it kept, and its curve.

use serde::Serialize;

use crate::env::Spec;
use crate::env::catalogue::EnvironmentId;
use crate::trainer::{EndReason, Evaluation};

/// Environment steps before the first evaluation that solves.
pub fn steps_to_solve(evaluations: &[Evaluation], task: &Spec) -> Option<u64> {
    evaluations.iter().find(|evaluation| task.is_solved_by(evaluation.mean)).map(|first| first.env_steps)
}

/// The key that ended a run before its budget was used up; none if no key did.
pub(crate) fn stopped_by(reason: EndReason) -> Option<&'static str> {
    match reason {
        EndReason::Lasting => Some("stop_when_lasting_steps"),
        EndReason::Solved => Some("stop_when_solved"),
        EndReason::Budget | EndReason::Interrupted => None,
    }
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Retention {
    /// Evaluations after the first that solved.
    pub evaluations: usize,
    /// How many of those solved too.
    pub solved: usize,
    /// The worst of them, the first of equals.
    pub worst: Option<Evaluation>,
    /// How often the solution was lost to less than half way back, see [`LostSolution::collapse`].
    pub collapses: usize,
    /// How often it was lost, and not so far.
    pub dips: usize,
}

/// A solution that was lost: the evaluations after one that solved, until the next that solves.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LostSolution {
    /// The last evaluation that solved.
    pub before: Evaluation,
    /// The first below the threshold.
    pub after: Evaluation,
    /// The lowest before the next that solves, the first of equals.
    pub lowest: Evaluation,
    /// The first below [`half_way`]; none if it was a dip.
    pub collapse: Option<Evaluation>,
    /// The next that solves.
    pub recovered: Option<Evaluation>,
}

/// What a run kept; none if it never solved.
pub fn retention(evaluations: &[Evaluation], task: &Spec) -> Option<Retention> {
    let solves = |evaluation: &Evaluation| task.is_solved_by(evaluation.mean);
    let first = evaluations.iter().position(solves)?;
    let after = &evaluations[first + 1..];
    let losses = losses(evaluations, task);
    let collapses = losses.iter().filter(|loss| loss.collapse.is_some()).count();
    let (evaluations, dips) = (after.len(), losses.len() - collapses);
    let solved = after.iter().filter(|evaluation| solves(evaluation)).count();
    let worst = after.iter().min_by(|a, b| a.mean.total_cmp(&b.mean)).copied();
    Some(Retention { evaluations, solved, worst, collapses, dips })
}

/// The middle between the mean return that solves a task and that of the random policy; none if nothing solves the task. Where
/// nobody has measured the random policy, the lowest evaluation before the first that solves stands for it.
pub fn half_way(evaluations: &[Evaluation], task: &Spec) -> Option<f64> {
    let known = EnvironmentId::from_name(&task.id).map(EnvironmentId::random_return);
    let unsolved = evaluations.iter().map(|evaluation| evaluation.mean);
    let unsolved = unsolved.take_while(|&mean| !task.is_solved_by(mean));
    let random = known.or_else(|| unsolved.min_by(f64::total_cmp)).unwrap_or(task.return_range.0);
    task.solved_return.map(|threshold| f64::midpoint(threshold, random))
}

pub fn losses(evaluations: &[Evaluation], task: &Spec) -> Vec<LostSolution> {
    let Some(half_way) = half_way(evaluations, task) else { return Vec::new() };
    let solves = |evaluation: &Evaluation| task.is_solved_by(evaluation.mean);
    let is_lost = |pair: &[Evaluation]| solves(&pair[0]) && !solves(&pair[1]);
    let starts = evaluations.windows(2).enumerate().filter(|(_, pair)| is_lost(pair));
    let loss = |(i, pair): (usize, &[Evaluation])| {
        let rest = &evaluations[i + 1..];
        let (lost, later) = rest.split_at(rest.iter().position(solves).unwrap_or(rest.len()));
        let (before, after, recovered) = (pair[0], pair[1], later.first().copied());
        let lowest = lost.iter().copied().min_by(|a, b| a.mean.total_cmp(&b.mean)).unwrap_or(after);
        let collapse = lost.iter().find(|evaluation| evaluation.mean < half_way).copied();
        LostSolution { before, after, lowest, collapse, recovered }
    };
    starts.map(loss).collect()
}

/// The mean return at a step: of the latest of the evaluations at `steps` until then. After its last evaluation, as before
/// its first, a run that failed is worth the lowest return of its task. One that ended early keeps its last policy.
pub fn value_at(step: u64, steps: &[u64], means: &[f64], failed: bool, task: &Spec) -> f64 {
    match steps.partition_point(|&evaluated| evaluated <= step) {
        0 => task.return_range.0,
        count if failed && count == steps.len() && step > steps[count - 1] => task.return_range.0,
        count => means[count - 1],
    }
}

/// Area under a curve by trapezoids over its width: the mean return during training.
pub fn area_under_curve(grid: &[u64], curve: &[f64]) -> f64 {
    let (Some(first), Some(last)) = (grid.first(), grid.last()) else { return 0.0 };
    if first == last {
        return curve[0];
    }
    let pairs = grid.windows(2).zip(curve.windows(2));
    let area: f64 = pairs.map(|(x, y)| (x[1] - x[0]) as f64 * (y[0] + y[1]) / 2.0).sum();
    area / (last - first) as f64
}
