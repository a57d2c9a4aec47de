//! The report of one run: what happened and when, each statement with its numbers.

use std::path::{Component, Path, PathBuf};

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::history::{self, LostSolution, Retention};
use super::{FORMAT_VERSION, Report, ReportError, csv, parse, plots};
use crate::config::EnvironmentConfig;
use crate::env::Spec;
use crate::run::names::{CONFIG, EVALUATIONS, METRICS, SUMMARY};
use crate::run::read_events;
use crate::trainer::{EndReason, Evaluation, Event};

/// Samples of a statistic that its usual range is taken from, at least and at most.
const BASELINE: std::ops::RangeInclusive<usize> = 5..=20;
/// Training episodes of the classic criterion.
const EPISODES: usize = 100;
/// Standard deviations from the mean of those at which a statistic has moved.
const MOVED: f64 = 4.0;

/// A statistic's name → (environment steps, value).
pub(super) type StatisticSeries = std::collections::BTreeMap<String, Vec<(u64, f64)>>;

#[derive(Default)]
pub(super) struct History {
    pub(super) evaluations: Vec<Evaluation>,
    pub(super) best: Option<Evaluation>,
    /// Environment steps of an evaluation, its smallest and its largest return.
    pub(super) extremes: Vec<(f64, f64, f64)>,
    /// Environment steps, mean return of the last 100 training episodes.
    pub(super) training: Vec<(f64, f64)>,
    /// Environment steps, ε after an episode.
    pub(super) epsilon: Vec<(f64, f64)>,
    /// Environment steps, mean loss of an episode.
    pub(super) loss: Vec<(f64, f64)>,
    pub(super) statistics: StatisticSeries,
    pub(super) end_reason: Option<EndReason>,
}

impl History {
    pub(super) fn read(path: &Path) -> Result<Self, ReportError> {
        let mut history = Self::default();
        read_events(path, |event| history.take(event)).map_err(|error| ReportError::new(path, error))?;
        Ok(history)
    }

    fn take(&mut self, event: Event) {
        let env_steps = event.env_steps();
        let x = env_steps as f64;
        match event {
            Event::Evaluation { mean, min, max, best, .. } => {
                self.evaluations.push(Evaluation { env_steps, mean });
                if best {
                    self.best = Some(Evaluation { env_steps, mean });
                }
                self.extremes.push((x, min, max));
            }
            Event::Episode { mean_return_100, epsilon, loss, .. } => {
                self.training.push((x, mean_return_100));
                self.epsilon.push((x, epsilon));
                self.loss.extend(loss.map(|loss| (x, loss)));
            }
            Event::Statistics { numbers, .. } => {
                for (name, number) in numbers.0 {
                    self.statistics.entry(name).or_default().push((env_steps, number));
                }
            }
            Event::End { reason, .. } => self.end_reason = Some(reason),
        }
    }
}

/// `report.json` of a run.
#[derive(Serialize)]
pub(super) struct RunReport {
    format_version: u32,
    kind: &'static str,
    threshold: Option<f64>,
    /// A lost solution with a lower mean return has collapsed.
    half_way: Option<f64>,
    pub(super) seed: u64,
    pub(super) ended: bool,
    end_reason: Option<EndReason>,
    evaluations: usize,
    pub(super) solved_at_step: Option<u64>,
    pub(super) best: Evaluation,
    #[serde(rename = "final")]
    pub(super) final_: Evaluation,
    area_under_curve: f64,
    training: Option<Training>,
    /// None before the run has ended.
    price: Option<Price>,
    retention: Option<Retention>,
    collapses: Vec<Collapse>,
    dips: Vec<LostSolution>,
    pub(super) statements: Vec<String>,
}

/// The training episodes, by the mean return of the last 100: the classic criterion of CartPole.
#[derive(Serialize)]
struct Training {
    episodes: usize,
    /// Of all episodes if there are fewer than 100.
    mean_return_100: f64,
    /// Environment steps after which 100 episodes in a row first had a mean of the threshold.
    solved_at_step: Option<u64>,
}

impl Training {
    /// From (environment steps, mean return of the last 100) of every episode.
    fn of(episodes: &[(f64, f64)], task: &Spec) -> Option<Self> {
        let (_, mean_return_100) = *episodes.last()?;
        let solved = episodes.iter().skip(EPISODES - 1).find(|(_, mean)| task.is_solved_by(*mean));
        let solved_at_step = solved.map(|&(env_steps, _)| env_steps as u64);
        Some(Self { episodes: episodes.len(), mean_return_100, solved_at_step })
    }
}

/// What the run cost, as its `summary.json` says.
#[derive(Serialize, Deserialize)]
struct Price {
    env_steps: u64,
    evaluation_steps: u64,
    lasting_test_steps: u64,
    cpu_seconds: Option<f64>,
}

/// A solution that was lost to less than half way back to the random policy.
#[derive(Serialize)]
struct Collapse {
    before: Evaluation,
    /// The first evaluation below half way.
    after: Evaluation,
    lowest: Evaluation,
    recovered: Option<Evaluation>,
    /// The statistics that left their usual range first; empty if none did, or there are none.
    moved_first: Vec<Moved>,
}

#[derive(Clone, Debug, Serialize)]
struct Moved {
    statistic: String,
    env_steps: u64,
    value: f64,
    usual_mean: f64,
    usual_std: f64,
}

pub(super) struct Run {
    /// The shortest end of its directory's path that no other run has, as text for a terminal.
    pub(super) name: String,
    pub(super) config: Value,
    pub(super) environment: EnvironmentConfig,
    pub(super) task: Spec,
    pub(super) history: History,
    pub(super) report: RunReport,
}

impl Run {
    pub(super) fn read(directory: &Path, name: String) -> Result<Self, ReportError> {
        let path = directory.join(CONFIG);
        let config: Value = parse(&path)?;
        // Not the whole config: another version may have written it.
        let environment = serde_json::from_value::<EnvironmentConfig>(config["environment"].clone());
        let environment = environment.map_err(|error| ReportError::new(&path, error))?;
        let task = environment.spec().map_err(|error| ReportError::new(&path, error))?;
        let path = directory.join(METRICS);
        let history = History::read(&path)?;
        let evaluations = &history.evaluations;
        let (Some(best), Some(&final_)) = (history.best, evaluations.last()) else {
            return Err(ReportError::new(&path, "holds no evaluation yet"));
        };
        let grid: Vec<u64> = evaluations.iter().map(|evaluation| evaluation.env_steps).collect();
        let curve: Vec<f64> = evaluations.iter().map(|evaluation| evaluation.mean).collect();
        let losses = history::losses(evaluations, &task);
        // Only a statistic that moved after the last evaluation that solved can explain a collapse.
        let collapse = |&LostSolution { before, lowest, collapse, recovered, .. }: &LostSolution| {
            let after = collapse?;
            let moved_first = moved_first(&history.statistics, before.env_steps, after.env_steps);
            Some(Collapse { before, after, lowest, recovered, moved_first })
        };
        let mut report = RunReport {
            format_version: FORMAT_VERSION,
            kind: "run",
            threshold: task.solved_return,
            half_way: history::half_way(evaluations, &task),
            seed: config["seed"].as_u64().unwrap_or_default(),
            ended: history.end_reason.is_some(),
            end_reason: history.end_reason,
            evaluations: evaluations.len(),
            solved_at_step: history::steps_to_solve(evaluations, &task),
            best,
            final_,
            area_under_curve: history::area_under_curve(&grid, &curve),
            training: Training::of(&history.training, &task),
            price: parse(&directory.join(SUMMARY)).ok(),
            retention: history::retention(evaluations, &task),
            collapses: losses.iter().filter_map(collapse).collect(),
            dips: losses.iter().filter(|loss| loss.collapse.is_none()).copied().collect(),
            statements: Vec::new(),
        };
        report.statements = statements(&report, &task, !history.statistics.is_empty());
        Ok(Self { name, config, environment, task, history, report })
    }
}

/// The names of runs: the shortest ends of their paths that differ from all others.
pub(super) fn names(directories: &[PathBuf]) -> Result<Vec<String>, ReportError> {
    let absolute = |directory: &PathBuf| {
        directory.canonicalize().map_err(|error| ReportError::unreadable(directory, &error))
    };
    let paths = directories.iter().map(absolute).collect::<Result<Vec<_>, _>>()?;
    let parts: Vec<Vec<Component>> = paths.iter().map(|path| path.components().collect()).collect();
    let name = |(own, directory): (&Vec<Component>, &PathBuf)| {
        let mut ends = (0..own.len()).rev().map(|start| &own[start..]);
        let is_own = |end: &&[Component]| parts.iter().filter(|other| other.ends_with(end)).count() == 1;
        let end = ends.find(is_own);
        let end = end.ok_or_else(|| ReportError::new(directory, "is given twice; give every run once"))?;
        Ok(crate::text::visible(&end.iter().collect::<PathBuf>().to_string_lossy()))
    };
    parts.iter().zip(directories).map(name).collect()
}

pub(super) fn report(directory: &Path) -> Result<Report, ReportError> {
    let name = names(&[directory.to_owned()])?.concat();
    let Run { name, task, history, report, .. } = Run::read(directory, name)?;
    let mut files = plots::run(&name, &task, &history.evaluations, &history.training);
    let text = report.statements.iter().map(|statement| crate::text::wrapped(statement, 2)).collect();
    let (seed, json) = (report.seed, json!(report));
    let rows = move |file: &mut dyn std::io::Write| {
        csv(file, std::iter::once((name.as_str(), seed, history.evaluations.clone())))
    };
    files.insert(0, (EVALUATIONS, Box::new(rows)));
    Ok(Report { text, json, files, notes: Vec::new() })
}

/// The statistics that left their usual range first from `start` to `end`: all that did so at the earliest step.
fn moved_first(statistics: &StatisticSeries, start: u64, end: u64) -> Vec<Moved> {
    let moved: Vec<Moved> =
        statistics.iter().filter_map(|(name, samples)| first_move(name, samples, start, end)).collect();
    let earliest = moved.iter().map(|moved| moved.env_steps).min();
    moved.into_iter().filter(|moved| Some(moved.env_steps) == earliest).collect()
}

/// The first sample in [start, end] further than [`MOVED`] standard deviations from the mean of the [`BASELINE`] before it.
fn first_move(name: &str, samples: &[(u64, f64)], start: u64, end: u64) -> Option<Moved> {
    let (least, most) = (*BASELINE.start(), *BASELINE.end());
    (least..samples.len()).find_map(|i| {
        let (env_steps, value) = samples[i];
        let usual = &samples[i.saturating_sub(most)..i];
        let count = usual.len() as f64;
        let usual_mean = usual.iter().map(|(_, value)| value).sum::<f64>() / count;
        let squares = usual.iter().map(|(_, value)| (value - usual_mean) * (value - usual_mean));
        let usual_std = (squares.sum::<f64>() / (count - 1.0)).sqrt();
        let has_moved = (start..=end).contains(&env_steps) && (value - usual_mean).abs() > MOVED * usual_std;
        has_moved.then(|| Moved { statistic: name.into(), env_steps, value, usual_mean, usual_std })
    })
}

fn statements(report: &RunReport, task: &Spec, has_statistics: bool) -> Vec<String> {
    let at = |one: &Evaluation| format!("mean return {:.1} at step {}", one.mean, one.env_steps);
    let RunReport { evaluations, best, final_, .. } = report;
    let mut said = vec![match (report.solved_at_step, &report.retention) {
        (Some(step), Some(Retention { solved, .. })) => format!(
            "solved at step {step}: the first evaluation {}; {} of {evaluations} evaluations are",
            task.goal(),
            solved + 1
        ),
        _ if task.solved_return.is_none() => {
            format!("the task has no threshold: the best of {evaluations} evaluations is {}", at(best))
        }
        _ => {
            let is_close = report.half_way.is_some_and(|half| best.mean >= half);
            let (verb, best, goal) = (if is_close { "solved" } else { "learned" }, at(best), task.goal());
            format!("never {verb}: the best of {evaluations} evaluations is {best}, and {goal} solves")
        }
    }];
    let end = if report.ended { "until the end of the run" } else { "so far" };
    for Collapse { before, after, recovered, moved_first, .. } in &report.collapses {
        let recovery = recovered.map_or(format!("not solved again {end}"), |again| {
            format!("solved again at step {}", again.env_steps)
        });
        let (step, after, before) = (after.env_steps, at(after), at(before));
        said.push(format!("collapsed at step {step}: {after}, {before} before; {recovery}"));
        for Moved { statistic, env_steps, value, usual_mean, usual_std } in moved_first {
            said.push(format!(
                "  moved first: {statistic} was {value:.4} at step {env_steps}, {usual_mean:.4} ± {usual_std:.4} before"
            ));
        }
        if has_statistics && moved_first.is_empty() {
            said.push(format!(
                "  no statistic left its usual range ({MOVED} standard deviations) since the last evaluation that solved"
            ));
        }
    }
    if let Some(lowest) = report.dips.iter().map(|dip| dip.lowest).min_by(|a, b| a.mean.total_cmp(&b.mean)) {
        let count = report.dips.len();
        let times = if count == 1 { "once".into() } else { format!("{count} times") };
        said.push(format!(
            "dipped {times} below the threshold without a collapse, which is below {:.1}, half way back to the random policy: \
             the lowest is {}",
            report.half_way.unwrap_or_default(),
            at(&lowest)
        ));
    }
    if let Some(Retention { evaluations, solved, worst: Some(worst), collapses, dips }) = &report.retention {
        said.push(format!(
            "retained: {solved} of the {evaluations} evaluations after the first solution solve, collapses: {collapses}, \
             dips: {dips}, the worst is {}",
            at(worst)
        ));
    }
    if let Some(key) = report.end_reason.and_then(history::stopped_by) {
        said.push(format!(
            "ended early: {key} ended the run after the evaluation at step {}, so nothing shows what more training would have \
             kept or lost",
            final_.env_steps
        ));
    }
    if let Some(Training { episodes, mean_return_100, solved_at_step }) = &report.training {
        let solved = match solved_at_step {
            _ if task.solved_return.is_none() => "the task has no threshold".into(),
            _ if *episodes < EPISODES => format!("the classic criterion takes {EPISODES}"),
            Some(step) => format!("solved by the classic criterion, {}, first at step {step}", task.goal()),
            None => format!("not once {}, the classic criterion", task.goal()),
        };
        let count = EPISODES.min(*episodes);
        said.push(format!(
            "training: mean return {mean_return_100:.1} over the last {count} training episodes; {solved}"
        ));
    }
    if let Some(Price { env_steps, evaluation_steps, lasting_test_steps, cpu_seconds }) = &report.price {
        let cpu = cpu_seconds.map_or_else(String::new, |seconds| format!("; {seconds:.2} s of CPU"));
        said.push(format!(
            "price: {env_steps} steps of training; without learning {evaluation_steps} steps in evaluations and \
             {lasting_test_steps} in tests whether a policy lasts{cpu}"
        ));
    }
    said.push(format!("best: {}", at(best)));
    said.push(format!("final: {}{}", at(final_), if report.ended { "" } else { " (the run has not ended)" }));
    said
}
