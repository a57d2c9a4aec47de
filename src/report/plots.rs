//! The plots of a report.

use super::statistics::{Estimate, shown};
use super::summary::{ConfigReport, StudyReport};
use super::svg::{Layout, Plot};
use super::{Content, whole};
use crate::env::Spec;
use crate::run::names::PLOTS;

const STEPS: &str = "environment steps";

type Draw = fn(&StudyReport, Layout) -> Plot;

pub(super) const STUDY: [(&str, Draw); 4] = [
    (PLOTS[0], learning_curves),
    (PLOTS[1], performance_profile),
    (PLOTS[2], steps_to_solve),
    (PLOTS[3], compare),
];

pub(super) fn study(report: &StudyReport) -> Vec<(&'static str, Content)> {
    STUDY.iter().map(|(name, draw)| (*name, whole(draw(report, Layout::FILE).finish()))).collect()
}

/// The returns that a plot of these tasks shows, with some air above.
fn range<'a>(tasks: impl Iterator<Item = &'a Spec>) -> (f64, f64) {
    let (low, high) =
        tasks.map(|task| task.return_range).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1))).unwrap_or((0.0, 1.0));
    (low, high + 0.02 * (high - low))
}

fn tasks(configs: &[ConfigReport]) -> impl Iterator<Item = &Spec> {
    configs.iter().map(|config| &config.task)
}

/// A level at the mean return that solves, where all tasks have the same.
fn draw_threshold<'a>(plot: &mut Plot, mut tasks: impl Iterator<Item = &'a Spec>) {
    let first = tasks.next().and_then(|task| task.solved_return);
    if let Some(threshold) = first.filter(|_| tasks.all(|task| task.solved_return == first)) {
        plot.level(threshold, "solved");
    }
}

/// The file of a run's plot: its evaluations, and the mean return of the last 100 training episodes.
pub(super) fn run(
    name: &str, task: &Spec, evaluations: &[crate::trainer::Evaluation], training: &[(f64, f64)],
) -> Vec<(&'static str, Content)> {
    let points: Vec<_> = evaluations.iter().map(|e| (e.env_steps as f64, e.mean)).collect();
    let end = points.iter().chain(training).map(|&(step, _)| step).fold(0.0, f64::max);
    let mut plot = returns(Layout::FILE, &format!("Learning curve of {name}"), task, end);
    plot.line(0, &points);
    plot.line(1, training);
    plot.legend(0, "evaluations");
    plot.legend(1, "last 100 training episodes");
    vec![(PLOTS[4], whole(plot.finish()))]
}

/// An empty plot of returns over environment steps.
pub(super) fn returns(layout: Layout, title: &str, task: &Spec, end: f64) -> Plot {
    let mut plot = Plot::new(layout, title, [STEPS, "mean return"], (0.0, end), range(std::iter::once(task)));
    draw_threshold(&mut plot, std::iter::once(task));
    plot
}

/// What a title says of intervals: nothing where none is drawn.
fn with_intervals<'a>(title: &str, mut estimates: impl Iterator<Item = &'a Estimate>, kind: &str) -> String {
    let drawn = estimates.any(|estimate| estimate.interval().is_some());
    if drawn { format!("{title}, 95 % {kind} interval") } else { title.into() }
}

fn last_step(configs: &[ConfigReport]) -> f64 {
    let last = configs.iter().filter_map(|config| config.learning_curve.last()).map(|point| point.env_steps);
    last.max().unwrap_or(0) as f64
}

fn legend(plot: &mut Plot, configs: &[ConfigReport]) {
    for (series, config) in configs.iter().enumerate() {
        plot.legend(series, &format!("{} ({} seeds)", config.name, config.seeds));
    }
}

/// A line with its band for each config, through points (x, estimate).
fn draw_bands(plot: &mut Plot, configs: &[ConfigReport], points: fn(&ConfigReport) -> Vec<(f64, Estimate)>) {
    for (series, config) in configs.iter().enumerate() {
        let points = points(config);
        let band = points.iter().map(|(x, estimate)| estimate.interval().map(|(low, high)| (*x, low, high)));
        plot.band(series, &band.collect::<Option<Vec<_>>>().unwrap_or_default());
        plot.line(series, &points.iter().map(|(x, estimate)| (*x, estimate.value)).collect::<Vec<_>>());
    }
    legend(plot, configs);
}

fn learning_curves(StudyReport { configs, .. }: &StudyReport, layout: Layout) -> Plot {
    let points = configs.iter().flat_map(|config| &config.learning_curve).map(|point| &point.iqm);
    let title = with_intervals("Learning curves: IQM over seeds", points, "bootstrap");
    let (labels, end) = ([STEPS, "mean return of an evaluation"], last_step(configs));
    let mut plot = Plot::new(layout, &title, labels, (0.0, end), range(tasks(configs)));
    draw_threshold(&mut plot, tasks(configs));
    draw_bands(&mut plot, configs, |config| {
        config.learning_curve.iter().map(|point| (point.env_steps as f64, point.iqm)).collect()
    });
    plot
}

fn performance_profile(StudyReport { configs, .. }: &StudyReport, layout: Layout) -> Plot {
    let points = configs.iter().flat_map(|config| &config.performance_profile).map(|point| &point.share);
    let title = with_intervals("Performance profile of the final policies", points, "Wilson");
    let labels = ["mean return τ", "share of seeds above τ"];
    let (low, _) = range(tasks(configs));
    let high = tasks(configs).map(|task| task.return_range.1).fold(low, f64::max);
    let mut plot = Plot::new(layout, &title, labels, (low, high), (0.0, 1.02));
    draw_bands(&mut plot, configs, |config| {
        config.performance_profile.iter().map(|point| (point.tau, point.share)).collect()
    });
    plot
}

fn steps_to_solve(StudyReport { configs, .. }: &StudyReport, layout: Layout) -> Plot {
    let end = last_step(configs);
    let title = "Steps before the first evaluation during training that solves";
    let mut plot = Plot::new(layout, title, [STEPS, "share of seeds"], (0.0, end), (0.0, 1.02));
    for (series, config) in configs.iter().enumerate() {
        let seeds = config.seeds as f64;
        let solved = config.steps_to_solve.solved.iter().enumerate();
        let mut points = vec![(0.0, 0.0)];
        points.extend(solved.map(|(i, &step)| (step as f64, (i + 1) as f64 / seeds)));
        points.push((end, config.steps_to_solve.solved.len() as f64 / seeds));
        // One point a step, the last: a million seeds would otherwise be a picture of 20 MB.
        points.dedup_by(|next, kept| {
            let is_same_step = next.0 == kept.0;
            kept.1 = if is_same_step { next.1 } else { kept.1 };
            is_same_step
        });
        plot.steps(series, &points);
    }
    legend(&mut plot, configs);
    plot
}

/// Differences of the IQMs from the first config's; for a single config its IQM. The axis covers only these values.
fn compare(StudyReport { configs, comparisons, .. }: &StudyReport, layout: Layout) -> Plot {
    let is_difference = !comparisons.is_empty();
    let (what, label, rows): (_, _, Vec<(&String, &Estimate)>) = match comparisons.first() {
        Some(super::comparison::Comparison { labels: [_, against], .. }) => {
            let what = format!("Difference of the final IQMs from {against}");
            let rows = comparisons.iter().map(|config| (&config.labels[0], &config.iqm_difference));
            (what, "difference of the mean return", rows.collect())
        }
        None => {
            let rows = configs.iter().map(|config| (&config.label, &config.final_iqm));
            ("IQM of the final policies over seeds".into(), "mean return", rows.collect())
        }
    };
    let title = with_intervals(&what, rows.iter().map(|(_, estimate)| *estimate), "bootstrap");
    let values = rows.iter().flat_map(|(_, e)| [Some(e.value), e.low, e.high]).flatten();
    let values = values.chain(is_difference.then_some(0.0));
    let low = values.clone().fold(f64::INFINITY, f64::min);
    let high = values.fold(f64::NEG_INFINITY, f64::max);
    let air = if high > low { 0.08 * (high - low) } else { 0.5 };
    let count = rows.len() as f64;
    let (x, y) = ((low - air, high + air), (0.0, count));
    let mut plot = Plot::new(layout.for_rows(rows.len()), &title, [label, ""], x, y);
    plot.has_y_ticks = false;
    if is_difference {
        plot.upright(0.0);
    }
    for (series, (label, estimate)) in rows.iter().enumerate() {
        let text = format!("{label}: {}", shown(estimate, 1));
        let y = count - series as f64 - 0.7;
        plot.interval(series + usize::from(is_difference), y, estimate.value, estimate.interval(), &text);
    }
    plot
}
