//! The report of a study.

use std::fmt::Write;
use std::ops::Range;
use std::path::Path;

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::history::{self, Retention, THRESHOLD};
use super::statistics::{self, BOOTSTRAP_SEED, Estimate, LEAST_SEEDS, RESAMPLES, iqm, mean, median, sorted};
use super::{EVALUATIONS, FORMAT_VERSION, Report, ReportError, csv, parse, plots, table};
use crate::study::{self, MANIFEST, PolicyScore, Trial, finished_seeds, read_trial, trial_path};
use crate::trainer::Evaluation;

/// The thresholds τ of a performance profile: 0, 5, …, 495.
const PROFILE_STEP: u32 = 5;
const PROFILE_POINTS: u32 = 100;

/// What the report needs of `study.json`.
#[derive(Deserialize)]
struct Manifest {
    format_version: u32,
    configs: Vec<Named>,
    seeds: Range<u64>,
}

#[derive(Deserialize)]
pub(super) struct Named {
    pub(super) name: String,
    #[serde(default)]
    pub(super) config: Value,
}

/// `report.json` of a study.
#[derive(Serialize)]
pub(super) struct StudyReport {
    format_version: u32,
    kind: &'static str,
    threshold: f64,
    pub(super) seeds: Range<u64>,
    trials: usize,
    finished: usize,
    failed: usize,
    bootstrap: Bootstrap,
    pub(super) warnings: Vec<String>,
    pub(super) configs: Vec<ConfigReport>,
    comparisons: Vec<Comparison>,
}

#[derive(Serialize)]
struct Bootstrap {
    confidence: f64,
    resamples: usize,
    seed: u64,
}

/// What one config came to over its seeds.
#[derive(Clone, Debug, Serialize)]
pub(super) struct ConfigReport {
    pub(super) name: String,
    pub(super) seeds: usize,
    failed: usize,
    final_solved: usize,
    best_solved: usize,
    final_solved_share: Estimate,
    best_solved_share: Estimate,
    pub(super) final_iqm: Estimate,
    final_median: Estimate,
    final_mean: Estimate,
    best_iqm: Estimate,
    best_mean: Estimate,
    /// IQM over seeds of the area under the learning curve.
    area_under_curve: Estimate,
    pub(super) steps_to_solve: StepsToSolve,
    retention: ConfigRetention,
    pub(super) performance_profile: Vec<ProfilePoint>,
    pub(super) learning_curve: Vec<CurvePoint>,
    /// The sorted final scores, for the comparisons.
    #[serde(skip)]
    scores: Vec<f64>,
}

/// Quantiles of the environment steps before the first evaluation that solves; null where that is never.
#[derive(Clone, Debug, Serialize)]
pub(super) struct StepsToSolve {
    q10: Option<u64>,
    q25: Option<u64>,
    q50: Option<u64>,
    q75: Option<u64>,
    q90: Option<u64>,
    never: usize,
    #[serde(skip)]
    pub(super) solved: Vec<u64>,
}

/// [`Retention`] over the seeds that solved.
#[derive(Clone, Debug, Serialize)]
struct ConfigRetention {
    /// Mean over the seeds with an evaluation after the first that solved.
    share: Option<f64>,
    seeds: usize,
    worst: Option<Worst>,
    collapses: usize,
    collapsed_seeds: usize,
}

#[derive(Clone, Debug, Serialize)]
struct Worst {
    seed: u64,
    env_steps: u64,
    mean: f64,
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

/// A config against the first of the study, in its final scores.
#[derive(Clone, Debug, Serialize)]
struct Comparison {
    config: String,
    against: String,
    probability_of_improvement: Estimate,
    iqm_difference: Estimate,
}

/// A study that has been read and judged.
pub(super) struct Study {
    pub(super) configs: Vec<Named>,
    trials: Vec<Vec<Trial>>,
    pub(super) report: StudyReport,
}

impl Study {
    pub(super) fn read(folder: &Path) -> Result<Self, ReportError> {
        let path = folder.join(MANIFEST);
        let manifest: Manifest = parse(&path)?;
        if manifest.format_version != study::FORMAT_VERSION {
            let problem = format!(
                "has format_version {}, and this program reads {}",
                manifest.format_version,
                study::FORMAT_VERSION
            );
            return Err(ReportError::new(&path, problem));
        }
        let trials = read_trials(folder, &manifest)?;
        let configs: Vec<ConfigReport> = trials.iter().map(|trials| config_report(trials)).collect();
        let report = StudyReport {
            format_version: FORMAT_VERSION,
            kind: "study",
            threshold: THRESHOLD,
            trials: manifest.seeds.clone().count().saturating_mul(configs.len()),
            finished: trials.iter().map(Vec::len).sum(),
            failed: configs.iter().map(|config| config.failed).sum(),
            bootstrap: Bootstrap { confidence: 0.95, resamples: RESAMPLES, seed: BOOTSTRAP_SEED },
            warnings: warnings(&manifest, &configs),
            comparisons: configs.iter().skip(1).map(|config| compare(config, &configs[0])).collect(),
            seeds: manifest.seeds,
            configs,
        };
        Ok(Self { configs: manifest.configs, trials, report })
    }
}

/// The report of the study in a folder.
pub(super) fn report(folder: &Path) -> Result<Report, ReportError> {
    let Study { trials, report, .. } = Study::read(folder)?;
    let runs = trials.iter().flatten();
    let evaluations = csv(runs.map(|trial| (trial.config.as_str(), trial.seed, &trial.evaluations[..])));
    let mut files = vec![(EVALUATIONS, evaluations)];
    files.extend(plots::study(&report.configs));
    Ok(Report { text: describe(&report), json: json!(report), files })
}

/// The finished trials of each config, in the order of their seeds.
fn read_trials(folder: &Path, manifest: &Manifest) -> Result<Vec<Vec<Trial>>, ReportError> {
    let mut groups = Vec::new();
    for (i, Named { name, .. }) in manifest.configs.iter().enumerate() {
        let mut trials = Vec::new();
        let seeds = finished_seeds(folder, i).map_err(|error| ReportError::new(folder, error))?;
        for seed in seeds.into_iter().filter(|seed| manifest.seeds.contains(seed)) {
            let trial = read_trial(&trial_path(folder, (i, seed)), name, seed);
            trials.push(trial.map_err(|error| ReportError::new(folder, error))?);
        }
        if trials.is_empty() {
            let problem = format!("no trial of config {name:?} is finished; run the study's command first");
            return Err(ReportError::new(folder, problem));
        }
        groups.push(trials);
    }
    Ok(groups)
}

fn warnings(manifest: &Manifest, configs: &[ConfigReport]) -> Vec<String> {
    let seeds = manifest.seeds.clone().count();
    let mut warnings = Vec::new();
    for ConfigReport { name, seeds: finished, failed, .. } in configs {
        if *finished < seeds {
            warnings.push(format!(
                "{name}: {finished} of {seeds} seeds are finished; the study's command goes on"
            ));
        }
        if *finished < LEAST_SEEDS {
            warnings.push(format!(
                "{name}: {finished} seeds are fewer than {LEAST_SEEDS}; an interval over so few would mislead, so there is none"
            ));
        }
        if *failed > 0 {
            warnings.push(format!("{name}: {failed} seeds failed in training and count with a score of 0"));
        }
    }
    warnings
}

/// A policy's mean return; 0 where a failed run left none.
fn score(policy: Option<&PolicyScore>) -> f64 {
    policy.map_or(0.0, |policy| policy.mean)
}

fn config_report(trials: &[Trial]) -> ConfigReport {
    let finals = sorted(trials.iter().map(|trial| score(trial.final_.as_ref())));
    let bests = sorted(trials.iter().map(|trial| score(trial.best.as_ref())));
    let solved = |scores: &[f64]| scores.iter().filter(|&&score| score >= THRESHOLD).count();
    let (final_solved, best_solved) = (solved(&finals), solved(&bests));
    let longest = trials.iter().max_by_key(|trial| trial.evaluations.last().map(|last| last.env_steps));
    let grid: Vec<u64> =
        longest.into_iter().flat_map(|trial| &trial.evaluations).map(|e| e.env_steps).collect();
    let curves: Vec<Vec<f64>> = trials
        .iter()
        .map(|trial| history::on_grid(&trial.evaluations, trial.error.is_some(), &grid))
        .collect();
    let areas = sorted(curves.iter().map(|curve| history::area_under_curve(&grid, curve)));
    ConfigReport {
        name: trials[0].config.clone(),
        seeds: trials.len(),
        failed: trials.iter().filter(|trial| trial.error.is_some()).count(),
        final_solved,
        best_solved,
        final_solved_share: Estimate::share(final_solved, trials.len()),
        best_solved_share: Estimate::share(best_solved, trials.len()),
        final_iqm: Estimate::of(&finals, iqm),
        final_median: Estimate::of(&finals, median),
        final_mean: Estimate::of(&finals, mean),
        best_iqm: Estimate::of(&bests, iqm),
        best_mean: Estimate::of(&bests, mean),
        area_under_curve: Estimate::of(&areas, iqm),
        steps_to_solve: steps_to_solve(trials),
        retention: retention(trials),
        performance_profile: profile(&finals),
        learning_curve: learning_curve(&grid, &curves),
        scores: finals,
    }
}

fn steps_to_solve(trials: &[Trial]) -> StepsToSolve {
    let mut solved: Vec<u64> =
        trials.iter().filter_map(|trial| history::steps_to_solve(&trial.evaluations)).collect();
    solved.sort_unstable();
    let quantile = |q| statistics::censored_quantile(&solved, trials.len(), q);
    StepsToSolve {
        q10: quantile(0.1),
        q25: quantile(0.25),
        q50: quantile(0.5),
        q75: quantile(0.75),
        q90: quantile(0.9),
        never: trials.len() - solved.len(),
        solved,
    }
}

fn retention(trials: &[Trial]) -> ConfigRetention {
    let kept: Vec<(u64, Retention)> = trials
        .iter()
        .filter_map(|trial| Some((trial.seed, history::retention(&trial.evaluations)?)))
        .collect();
    let shares: Vec<f64> = kept
        .iter()
        .filter(|(_, kept)| kept.evaluations > 0)
        .map(|(_, kept)| kept.solved as f64 / kept.evaluations as f64)
        .collect();
    let worst = kept.iter().filter_map(|(seed, kept)| Some((*seed, kept.worst?)));
    let worst = worst.min_by(|(_, a), (_, b)| a.mean.total_cmp(&b.mean));
    ConfigRetention {
        share: (!shares.is_empty()).then(|| mean(&shares)),
        seeds: shares.len(),
        worst: worst.map(|(seed, Evaluation { env_steps, mean })| Worst { seed, env_steps, mean }),
        collapses: kept.iter().map(|(_, kept)| kept.collapses).sum(),
        collapsed_seeds: kept.iter().filter(|(_, kept)| kept.collapses > 0).count(),
    }
}

fn profile(scores: &[f64]) -> Vec<ProfilePoint> {
    let taus = (0..PROFILE_POINTS).map(|i| f64::from(i * PROFILE_STEP));
    let share = |tau| Estimate::share(statistics::count_above(scores, tau), scores.len());
    taus.map(|tau| ProfilePoint { tau, share: share(tau) }).collect()
}

fn learning_curve(grid: &[u64], curves: &[Vec<f64>]) -> Vec<CurvePoint> {
    let at = |i: usize| sorted(curves.iter().map(|curve| curve[i]));
    let point = |(i, &env_steps)| CurvePoint { env_steps, iqm: Estimate::of(&at(i), iqm) };
    grid.iter().enumerate().map(point).collect()
}

fn compare(config: &ConfigReport, first: &ConfigReport) -> Comparison {
    let (x, y) = (&config.scores, &first.scores);
    Comparison {
        config: config.name.clone(),
        against: first.name.clone(),
        probability_of_improvement: Estimate::of_two(x, y, statistics::probability_of_improvement),
        iqm_difference: Estimate::of_two(x, y, |x, y| iqm(x) - iqm(y)),
    }
}

/// `value [low, high]`.
fn shown(estimate: &Estimate, digits: usize) -> String {
    match (estimate.low, estimate.high) {
        (Some(low), Some(high)) => format!("{:.digits$} [{low:.digits$}, {high:.digits$}]", estimate.value),
        _ => format!("{:.digits$}", estimate.value),
    }
}

fn share_shown(count: usize, share: &Estimate) -> String {
    let percent = |value: f64| 100.0 * value;
    match (share.low, share.high) {
        (Some(low), Some(high)) => format!("{count} [{:.1}, {:.1} %]", percent(low), percent(high)),
        _ => count.to_string(),
    }
}

/// The tables of a report: what the policies came to, and how they got there.
pub(super) fn tables(report: &StudyReport) -> [Vec<Vec<String>>; 2] {
    let row = |cells: &[&str]| cells.iter().map(ToString::to_string).collect::<Vec<String>>();
    let steps = |steps: Option<u64>| steps.map_or_else(|| "never".into(), |steps| steps.to_string());
    let mut scores = vec![row(&[
        "config",
        "seeds",
        "failed",
        "final solved",
        "best solved",
        "final IQM",
        "mean",
        "median",
    ])];
    let mut courses = vec![row(&[
        "config",
        "solved after 10 %",
        "50 %",
        "90 % of seeds",
        "never",
        "area",
        "retained",
        "worst",
        "collapses",
    ])];
    for config in &report.configs {
        scores.push(vec![
            config.name.clone(),
            config.seeds.to_string(),
            config.failed.to_string(),
            share_shown(config.final_solved, &config.final_solved_share),
            share_shown(config.best_solved, &config.best_solved_share),
            shown(&config.final_iqm, 1),
            shown(&config.final_mean, 1),
            shown(&config.final_median, 1),
        ]);
        let StepsToSolve { q10, q50, q90, never, .. } = config.steps_to_solve;
        let ConfigRetention { share, worst, collapses, collapsed_seeds, .. } = &config.retention;
        courses.push(vec![
            config.name.clone(),
            steps(q10),
            steps(q50),
            steps(q90),
            never.to_string(),
            shown(&config.area_under_curve, 1),
            share.map_or_else(|| "-".into(), |share| format!("{:.1} %", 100.0 * share)),
            worst
                .as_ref()
                .map_or_else(|| "-".into(), |worst| format!("{:.1} (seed {})", worst.mean, worst.seed)),
            format!("{collapses} on {collapsed_seeds} seeds"),
        ]);
    }
    [scores, courses]
}

/// What is said of each config against the first.
pub(super) fn comparisons(report: &StudyReport) -> Vec<String> {
    let sentence = |comparison: &Comparison| {
        let Comparison { config, against, probability_of_improvement, iqm_difference } = comparison;
        format!(
            "{config} against {against}: probability of improvement {}, difference of IQMs {}",
            shown(probability_of_improvement, 3),
            shown(iqm_difference, 1)
        )
    };
    report.comparisons.iter().map(sentence).collect()
}

/// What the tables mean.
pub(super) fn footnote() -> String {
    format!(
        "Solved: mean return ≥ {THRESHOLD} over eval's {} episodes. In brackets: 95 % intervals over training seeds.",
        study::SCORE_EPISODES
    )
}

fn describe(report: &StudyReport) -> String {
    let [scores, courses] = tables(report);
    let mut text = format!("{}\n{}", table(&scores), table(&courses));
    for sentence in comparisons(report) {
        // Writing to a string cannot fail.
        let _ = write!(text, "\n{sentence}");
    }
    if !report.comparisons.is_empty() {
        text.push('\n');
    }
    for warning in &report.warnings {
        let _ = write!(text, "\nnote: {warning}");
    }
    let _ = write!(text, "\n{}\n", footnote());
    text
}
