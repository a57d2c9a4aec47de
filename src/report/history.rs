//! The evaluations of one run: when it solved, what it kept, and its curve.

use serde::Serialize;

use crate::env::Spec;
use crate::trainer::Evaluation;

/// Environment steps before the first evaluation that solves.
pub fn steps_to_solve(evaluations: &[Evaluation], task: &Spec) -> Option<u64> {
    evaluations.iter().find(|evaluation| task.is_solved_by(evaluation.mean)).map(|first| first.env_steps)
}

/// What a run kept of a solution.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Retention {
    /// Evaluations after the first that solved.
    pub evaluations: usize,
    /// How many of those solved too.
    pub solved: usize,
    /// The worst of them, the first of equals.
    pub worst: Option<Evaluation>,
    /// How often an evaluation that solved was followed by one that did not.
    pub collapses: usize,
}

/// What a run kept; none if it never solved.
pub fn retention(evaluations: &[Evaluation], task: &Spec) -> Option<Retention> {
    let solves = |evaluation: &Evaluation| task.is_solved_by(evaluation.mean);
    let first = evaluations.iter().position(solves)?;
    let after = &evaluations[first + 1..];
    Some(Retention {
        evaluations: after.len(),
        solved: after.iter().filter(|evaluation| solves(evaluation)).count(),
        worst: after.iter().min_by(|a, b| a.mean.total_cmp(&b.mean)).copied(),
        collapses: collapses(evaluations, task).count(),
    })
}

/// The pairs of evaluations in which a solution was lost: the last that solved, and the next.
pub fn collapses<'a>(
    evaluations: &'a [Evaluation],
    task: &'a Spec,
) -> impl Iterator<Item = (Evaluation, Evaluation)> + 'a {
    let is_lost = |a: &Evaluation, b: &Evaluation| task.is_solved_by(a.mean) && !task.is_solved_by(b.mean);
    evaluations.windows(2).filter(move |pair| is_lost(&pair[0], &pair[1])).map(|pair| (pair[0], pair[1]))
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
