//! What the configs of a study came to over their seeds: types and numbers.

use std::panic::resume_unwind;
use std::thread;

use serde::Serialize;

use super::comparison::{Comparison, Scored};
use super::failures::Failures;
use super::history::{self, Retention};
use super::outcome::{Group, PolicyOutcome, TrialOutcome, score};
use super::statistics::{self, Estimate, Sample, iqm, mean, median, sorted};
use crate::env::Spec;
use crate::trainer::Evaluation;

/// The thresholds τ of a performance profile: 0, 5, …, 495 for CartPole.
const PROFILE_POINTS: u32 = 100;

/// `report.json` of a study.
#[derive(Serialize)]
pub(super) struct StudyReport {
    pub(super) format_version: u32,
    pub(super) kind: &'static str,
    /// Of the first config's task.
    pub(super) threshold: Option<f64>,
    pub(super) seeds: std::ops::Range<u64>,
    pub(super) trials: u64,
    pub(super) finished: usize,
    pub(super) failed: usize,
    pub(super) failures: Vec<Failures>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) last_tries: Vec<Failures>,
    pub(super) bootstrap: serde_json::Value,
    pub(super) warnings: Vec<String>,
    pub(super) configs: Vec<ConfigReport>,
    pub(super) comparisons: Vec<Comparison>,
}

#[derive(Clone, Debug, Serialize)]
pub(super) struct ConfigReport {
    pub(super) name: String,
    pub(super) label: String,
    #[serde(skip)]
    pub(super) task: Spec,
    pub(super) seeds: usize,
    pub(super) failed: usize,
    /// Runs that a key ended before their budget was used up.
    pub(super) ended_early: usize,
    pub(super) final_solved: usize,
    pub(super) best_solved: usize,
    pub(super) final_solved_share: Estimate,
    pub(super) best_solved_share: Estimate,
    pub(super) final_iqm: Estimate,
    pub(super) final_median: Estimate,
    pub(super) final_mean: Estimate,
    pub(super) best_iqm: Estimate,
    pub(super) best_mean: Estimate,
    /// IQM over seeds of the area under the learning curve.
    pub(super) area_under_curve: Estimate,
    pub(super) steps_to_solve: StepsToSolve,
    /// None where no trial has counted them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) steps_played: Option<StepsPlayed>,
    pub(super) retention: ConfigRetention,
    /// None where the study did not ask.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) lasting: Option<Lasting>,
    pub(super) performance_profile: Vec<ProfilePoint>,
    pub(super) learning_curve: Vec<CurvePoint>,
    /// The sorted final scores, for the comparisons.
    #[serde(skip)]
    pub(super) scores: Sample,
}

/// Quantiles of the environment steps before the first evaluation that solves; null where that is never.
#[derive(Clone, Debug, Serialize)]
pub(super) struct StepsToSolve {
    pub(super) q10: Option<u64>,
    pub(super) q25: Option<u64>,
    pub(super) q50: Option<u64>,
    pub(super) q75: Option<u64>,
    pub(super) q90: Option<u64>,
    pub(super) never: usize,
    #[serde(skip)]
    pub(super) solved: Vec<u64>,
}

/// Medians over the seeds of the environment steps of a run, whose price these are. It learns from those of training alone.
#[derive(Clone, Debug, Serialize)]
pub(super) struct StepsPlayed {
    pub(super) training: u64,
    pub(super) evaluations: u64,
    pub(super) lasting_tests: u64,
}

/// [`Retention`] over the seeds that solved.
#[derive(Clone, Debug, Serialize)]
pub(super) struct ConfigRetention {
    /// Mean over the seeds with an evaluation after the first that solved.
    pub(super) share: Option<f64>,
    pub(super) seeds: usize,
    pub(super) worst: Option<Worst>,
    pub(super) collapses: usize,
    pub(super) collapsed_seeds: usize,
    pub(super) dips: usize,
    pub(super) dipped_seeds: usize,
}

/// How many seeds have a policy that lasts [`LASTING_STEPS`](crate::study::LASTING_STEPS) steps from every start.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Lasting {
    #[serde(rename = "final")]
    pub(super) final_: usize,
    pub(super) best: usize,
    pub(super) final_share: Estimate,
    pub(super) best_share: Estimate,
}

#[derive(Clone, Debug, Serialize)]
pub(super) struct Worst {
    pub(super) seed: u64,
    pub(super) env_steps: u64,
    pub(super) mean: f64,
}

#[derive(Clone, Debug, Serialize)]
pub(super) struct ProfilePoint {
    pub(super) tau: f64,
    #[serde(flatten)]
    pub(super) share: Estimate,
}

#[derive(Clone, Debug, Serialize)]
pub(super) struct CurvePoint {
    pub(super) env_steps: u64,
    #[serde(flatten)]
    pub(super) iqm: Estimate,
}

impl ConfigReport {
    pub(super) fn scored(&self) -> Scored<'_> {
        Scored { name: &self.name, label: &self.label, task: &self.task, finals: &self.scores }
    }
}

pub(super) fn config_report(Group { name, task, outcomes }: &Group) -> ConfigReport {
    let finals = sorted(outcomes.iter().map(|outcome| score(outcome.final_, task)));
    let bests = sorted(outcomes.iter().map(|outcome| score(outcome.best, task)));
    let solved = |scores: &Sample| scores.iter().filter(|&(score, _)| task.is_solved_by(score)).count();
    let (final_solved, best_solved) = (solved(&finals), solved(&bests));
    let longest = outcomes.iter().max_by_key(|outcome| outcome.steps.last());
    let grid: &[u64] = longest.map_or(&[], |outcome| &outcome.steps);
    let curve = |of: &TrialOutcome| grid.iter().map(|&step| of.value_at(step, task)).collect::<Vec<_>>();
    let areas = sorted(outcomes.iter().map(|outcome| history::area_under_curve(grid, &curve(outcome))));
    ConfigReport {
        name: name.clone(),
        label: name.clone(),
        task: task.clone(),
        seeds: outcomes.len(),
        failed: outcomes.iter().filter(|outcome| outcome.error.is_some()).count(),
        ended_early: outcomes.iter().filter(|outcome| outcome.stopped_by.is_some()).count(),
        final_solved,
        best_solved,
        final_solved_share: Estimate::share(final_solved, outcomes.len()),
        best_solved_share: Estimate::share(best_solved, outcomes.len()),
        final_iqm: Estimate::of(&finals, iqm),
        final_median: Estimate::of(&finals, median),
        final_mean: Estimate::of(&finals, mean),
        best_iqm: Estimate::of(&bests, iqm),
        best_mean: Estimate::of(&bests, mean),
        area_under_curve: Estimate::of(&areas, iqm),
        steps_to_solve: steps_to_solve(task, outcomes),
        steps_played: steps_played(outcomes),
        retention: retention(task, outcomes),
        lasting: lasting(outcomes),
        performance_profile: profile(task, &finals),
        learning_curve: learning_curve(task, grid, outcomes),
        scores: finals,
    }
}

fn steps_to_solve(task: &Spec, outcomes: &[TrialOutcome]) -> StepsToSolve {
    let steps = |outcome: &TrialOutcome| history::steps_to_solve(&outcome.evaluations(), task);
    let mut solved: Vec<u64> = outcomes.iter().filter_map(steps).collect();
    solved.sort_unstable();
    let quantile = |q| statistics::censored_quantile(&solved, outcomes.len(), q);
    let [q10, q25, q50, q75, q90] = [0.1, 0.25, 0.5, 0.75, 0.9].map(quantile);
    StepsToSolve { q10, q25, q50, q75, q90, never: outcomes.len() - solved.len(), solved }
}

fn steps_played(outcomes: &[TrialOutcome]) -> Option<StepsPlayed> {
    let played: Vec<[u64; 3]> = outcomes.iter().filter_map(|outcome| outcome.steps_played).collect();
    let median = |of: usize| {
        let mut steps: Vec<u64> = played.iter().map(|played| played[of]).collect();
        steps.sort_unstable();
        steps.get((steps.len().max(1) - 1) / 2).copied()
    };
    Some(StepsPlayed { training: median(0)?, evaluations: median(1)?, lasting_tests: median(2)? })
}

fn lasting(outcomes: &[TrialOutcome]) -> Option<Lasting> {
    outcomes.iter().find_map(|outcome| outcome.best?.lasts)?;
    let count = |of: fn(&TrialOutcome) -> Option<PolicyOutcome>| {
        outcomes.iter().filter(|outcome| of(outcome).and_then(|policy| policy.lasts) == Some(true)).count()
    };
    let (final_, best) = (count(|outcome| outcome.final_), count(|outcome| outcome.best));
    let [final_share, best_share] = [final_, best].map(|count| Estimate::share(count, outcomes.len()));
    Some(Lasting { final_, best, final_share, best_share })
}

fn retention(task: &Spec, outcomes: &[TrialOutcome]) -> ConfigRetention {
    let retained = |one: &TrialOutcome| Some((one.seed, history::retention(&one.evaluations(), task)?));
    let kept: Vec<(u64, Retention)> = outcomes.iter().filter_map(retained).collect();
    let judged = kept.iter().filter(|(_, kept)| kept.evaluations > 0);
    let shares: Vec<f64> = judged.map(|(_, kept)| kept.solved as f64 / kept.evaluations as f64).collect();
    let worst = kept.iter().filter_map(|(seed, kept)| Some((*seed, kept.worst?)));
    let worst = worst.min_by(|(_, a), (_, b)| a.mean.total_cmp(&b.mean));
    ConfigRetention {
        share: (!shares.is_empty()).then(|| shares.iter().sum::<f64>() / shares.len() as f64),
        seeds: shares.len(),
        worst: worst.map(|(seed, Evaluation { env_steps, mean })| Worst { seed, env_steps, mean }),
        collapses: kept.iter().map(|(_, kept)| kept.collapses).sum(),
        collapsed_seeds: kept.iter().filter(|(_, kept)| kept.collapses > 0).count(),
        dips: kept.iter().map(|(_, kept)| kept.dips).sum(),
        dipped_seeds: kept.iter().filter(|(_, kept)| kept.dips > 0).count(),
    }
}

fn profile(task: &Spec, scores: &Sample) -> Vec<ProfilePoint> {
    let (low, high) = task.return_range;
    let step = (high - low) / f64::from(PROFILE_POINTS);
    let taus = (0..PROFILE_POINTS).map(|i| low + f64::from(i) * step);
    let share = |tau| Estimate::share(statistics::count_above(scores, tau), scores.len());
    taus.map(|tau| ProfilePoint { tau, share: share(tau) }).collect()
}

fn learning_curve(task: &Spec, grid: &[u64], outcomes: &[TrialOutcome]) -> Vec<CurvePoint> {
    let point = |&env_steps: &u64| {
        let sample = sorted(outcomes.iter().map(|outcome| outcome.value_at(env_steps, task)));
        CurvePoint { env_steps, iqm: Estimate::of(&sample, iqm) }
    };
    // Most of a report's time: each part of the points has a thread.
    let threads = thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let parts = grid.chunks(grid.len().div_ceil(threads).max(1));
    thread::scope(|scope| {
        let points = |part: &[u64]| part.iter().map(point).collect::<Vec<_>>();
        let threads: Vec<_> = parts.map(|part| scope.spawn(move || points(part))).collect();
        let joined = threads.into_iter().map(|part| part.join().unwrap_or_else(|panic| resume_unwind(panic)));
        joined.flatten().collect()
    })
}
