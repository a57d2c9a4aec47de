//! The plots of runs in a page: one panel for each quantity, all over the same steps.

use super::run::{History, Run};
use super::svg::{Layout, Plot};

/// (Environment steps, value).
type Points = Vec<(f64, f64)>;

/// Columns of a thinned line, each with at most two points.
const COLUMNS: usize = 600;

/// This many statistics are visible at once; the others can be unfolded.
const FOLDED_FROM: usize = 4;

/// A plot in two sizes; the style sheet shows one of them.
pub(super) fn figure(draw: impl Fn(Layout) -> Plot) -> String {
    let (wide, narrow) = (draw(Layout::WIDE), draw(Layout::NARROW).finish());
    let (caption, wide) = (wide.caption(), wide.finish());
    format!(
        "<figure class=\"plot\">\n<figcaption>{caption}</figcaption>\n<div class=\"wide\">{wide}</div>\n\
         <div class=\"narrow\">{narrow}</div>\n</figure>\n"
    )
}

pub(super) fn learning(runs: &[Run]) -> String {
    let ends = runs.iter().flat_map(|run| &run.history.evaluations).map(|evaluation| evaluation.env_steps);
    let end = ends.max().unwrap_or_default() as f64;
    let statistic = |known: &crate::agent::Statistic| {
        let of = |history: &History| {
            let samples = history.statistics.get(known.name).into_iter().flatten();
            samples.map(|&(step, value)| (step as f64, value)).collect()
        };
        panel(runs, end, known.title, known.is_logarithmic, of)
    };
    let mut shown = figure(|layout| learning_curve(layout, runs, end));
    shown += &panel(runs, end, "Exploration: ε after an episode", false, |history| history.epsilon.clone());
    shown += &panel(runs, end, "Loss: mean over an episode", true, |history| history.loss.clone());
    let drawn = crate::agent::STATISTICS.iter().filter(|statistic| !statistic.title.is_empty());
    let mut panels = drawn.map(statistic);
    shown.extend(panels.by_ref().take(FOLDED_FROM));
    let folded: String = panels.collect();
    if !folded.is_empty() {
        shown += &format!(
            "<details>\n<summary>More of what learning looks like from inside</summary>\n{folded}</details>\n"
        );
    }
    shown
}

/// The learning curve: one run has the range of its evaluations, several runs have a colour each.
fn learning_curve(layout: Layout, runs: &[Run], end: f64) -> Plot {
    let mut plot = super::plots::returns(layout, "Learning curve", &runs[0].task, end);
    for (series, Run { name, history, .. }) in runs.iter().enumerate() {
        let evaluations: Points = history.evaluations.iter().map(|e| (e.env_steps as f64, e.mean)).collect();
        if let [_] = runs {
            plot.band(0, &history.extremes);
            plot.faint_line(1, &thinned(&history.training));
            plot.legend(0, "evaluations, with their smallest and largest return");
            plot.legend(1, "last 100 training episodes");
        } else {
            plot.faint_line(series, &thinned(&history.training));
            plot.legend(series, name);
        }
        plot.line(series, &evaluations);
    }
    plot
}

/// One quantity of all runs; empty if no run has it. A logarithmic axis shows only values above 0.
fn panel(
    runs: &[Run], end: f64, title: &str, is_logarithmic: bool, of: impl Fn(&History) -> Points,
) -> String {
    let mut lines: Vec<Points> = runs.iter().map(|run| thinned(&of(&run.history))).collect();
    if is_logarithmic {
        for line in &mut lines {
            line.retain(|&(_, value)| value > 0.0);
            line.iter_mut().for_each(|(_, value)| *value = libm::log10(*value));
        }
    }
    let values = || lines.iter().flatten().map(|&(_, value)| value);
    if values().next().is_none() {
        return String::new();
    }
    let (low, high) = (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max));
    let range = if is_logarithmic {
        (low.floor(), high.ceil())
    } else {
        let air = 0.05 * (high - low.min(0.0));
        (if low < 0.0 { low - air } else { 0.0 }, high + air)
    };
    figure(|layout| {
        let mut plot = Plot::new(layout.low(), title, ["", ""], (0.0, end), range);
        plot.is_logarithmic = is_logarithmic;
        lines.iter().enumerate().for_each(|(series, line)| plot.line(series, line));
        plot
    })
}

/// Only the smallest and the largest value of each column, so that no outlier is lost.
fn thinned(points: &[(f64, f64)]) -> Points {
    if points.len() <= 2 * COLUMNS {
        return points.to_vec();
    }
    let column = |points: &[(f64, f64)]| {
        let places = || 0..points.len();
        let smallest = places().min_by(|&a, &b| points[a].1.total_cmp(&points[b].1));
        let largest = places().max_by(|&a, &b| points[a].1.total_cmp(&points[b].1));
        let mut kept: Vec<usize> = smallest.into_iter().chain(largest).collect();
        kept.sort_unstable();
        kept.dedup();
        kept.into_iter().map(|i| points[i]).collect::<Points>()
    };
    points.chunks(points.len().div_ceil(COLUMNS)).flat_map(column).collect()
}

#[cfg(test)]
#[path = "../../tests/unit/report_panels.rs"]
mod tests;
