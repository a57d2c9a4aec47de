//! The report of a study.

use std::ops::Range;
use std::path::Path;

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::history::{self, Retention, THRESHOLD};
use super::ranking::{self, Failures, Ranked, failure_lines, failures, named_table};
use super::statistics::{self, BOOTSTRAP_SEED, Estimate, LEAST_SEEDS, RESAMPLES, iqm, mean, median, sorted};
use super::{EVALUATIONS, FORMAT_VERSION, Report, ReportError, csv, parse, plots};
use crate::study::{self, MANIFEST, PolicyScore, Trial, finished_seeds, read_trial, trial_path};
use crate::text::{shortened, table, visible, wrapped};
use crate::trainer::Evaluation;

/// Most configs that a note names.
const MAX_NAMED: usize = 3;
/// Widest name in a sentence, in columns.
const MAX_NAME: usize = 48;
/// The thresholds τ of a performance profile: 0, 5, …, 495.
const PROFILE_STEP: u32 = 5;
const PROFILE_POINTS: u32 = 100;

/// What the report needs of `study.json`.
#[derive(Deserialize)]
pub(super) struct Manifest {
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

impl Manifest {
    pub(super) fn read(folder: &Path) -> Result<Self, ReportError> {
        let path = folder.join(MANIFEST);
        let manifest: Self = parse(&path)?;
        if manifest.format_version != study::FORMAT_VERSION {
            let problem = format!(
                "has format_version {}, and this program reads {}",
                manifest.format_version,
                study::FORMAT_VERSION
            );
            return Err(ReportError::new(&path, problem));
        }
        Ok(manifest)
    }
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
    pub(super) failures: Vec<Failures>,
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
        let manifest = Manifest::read(folder)?;
        let trials = read_trials(folder, &manifest)?;
        let configs: Vec<ConfigReport> = trials.iter().map(|trials| config_report(trials)).collect();
        let report = StudyReport {
            format_version: FORMAT_VERSION,
            kind: "study",
            threshold: THRESHOLD,
            trials: manifest.seeds.clone().count().saturating_mul(manifest.configs.len()),
            finished: trials.iter().map(Vec::len).sum(),
            failed: configs.iter().map(|config| config.failed).sum(),
            failures: failures(trials.iter().flatten()),
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

/// The finished trials of each config that has any, in the order of their seeds.
pub(super) fn read_trials(folder: &Path, manifest: &Manifest) -> Result<Vec<Vec<Trial>>, ReportError> {
    let mut groups = Vec::new();
    for (i, Named { name, .. }) in manifest.configs.iter().enumerate() {
        let mut trials = Vec::new();
        let seeds = finished_seeds(folder, i).map_err(|error| ReportError::new(folder, error))?;
        for seed in seeds.into_iter().filter(|seed| manifest.seeds.contains(seed)) {
            let trial = read_trial(&trial_path(folder, (i, seed)), name, seed);
            trials.push(trial.map_err(|error| ReportError::new(folder, error))?);
        }
        groups.push(trials);
    }
    groups.retain(|trials| !trials.is_empty());
    if groups.is_empty() {
        return Err(ReportError::new(folder, "no trial is finished yet; run the study's command first"));
    }
    Ok(groups)
}

/// What a reader must know of the numbers: one note for all configs that it is true of.
fn warnings(manifest: &Manifest, configs: &[ConfigReport]) -> Vec<String> {
    let seeds = manifest.seeds.clone().count();
    let mut notes: Vec<(String, Vec<&str>)> = Vec::new();
    let mut add = |note: String, name| match notes.iter_mut().find(|(known, _)| *known == note) {
        Some((_, names)) => names.push(name),
        None => notes.push((note, vec![name])),
    };
    for Named { name, .. } in &manifest.configs {
        let finished = configs.iter().find(|config| config.name == *name).map_or(0, |config| config.seeds);
        if finished < seeds {
            let note = format!(
                "{finished} of {seeds} seeds are finished; the study's command, given again, trains the rest"
            );
            add(note, name.as_str());
        }
        if (1..LEAST_SEEDS).contains(&finished) {
            let note = format!(
                "{finished} seeds are fewer than {LEAST_SEEDS}; an interval over so few would mislead, so there is none"
            );
            add(note, name.as_str());
        }
    }
    let all = manifest.configs.len();
    let sentence = |(note, names): &(String, Vec<&str>)| match names.len() {
        count if count == all && all > 1 => format!("all {all} configs: {note}"),
        count if count <= MAX_NAMED => format!("{}: {note}", names.join(", ")),
        count => format!("{} and {} other configs: {note}", names[0], count - 1),
    };
    notes.iter().map(sentence).collect()
}

/// A policy's mean return; 0 where a failed run left none.
pub(super) fn score(policy: Option<&PolicyScore>) -> f64 {
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
pub(super) fn shown(estimate: &Estimate, digits: usize) -> String {
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

impl ConfigReport {
    fn ranked(&self) -> Ranked {
        Ranked {
            name: self.name.clone(),
            seeds: self.seeds,
            failed: self.failed,
            solved: self.final_solved,
            iqm: self.final_iqm,
            mean: self.final_mean.value,
        }
    }

    /// What the policies came to.
    fn scores(&self) -> Vec<String> {
        vec![
            share_shown(self.final_solved, &self.final_solved_share),
            share_shown(self.best_solved, &self.best_solved_share),
            shown(&self.final_mean, 1),
        ]
    }

    /// How they got there.
    fn course(&self) -> Vec<String> {
        let ConfigRetention { collapses, collapsed_seeds, .. } = &self.retention;
        vec![
            shown(&self.final_median, 1),
            shown(&self.area_under_curve, 1),
            format!("{collapses} on {collapsed_seeds}"),
        ]
    }

    fn solutions(&self) -> Vec<String> {
        let steps = |steps: Option<u64>| steps.map_or_else(|| "never".into(), |steps| steps.to_string());
        let StepsToSolve { q10, q50, q90, never, .. } = self.steps_to_solve;
        let ConfigRetention { share, worst, .. } = &self.retention;
        let share = share.map_or_else(|| "-".into(), |share| format!("{:.1} %", 100.0 * share));
        let worst = worst.as_ref();
        let worst = worst.map_or_else(|| "-".into(), |worst| format!("{:.1}", worst.mean));
        vec![steps(q10), steps(q50), steps(q90), never.to_string(), share, worst]
    }
}

/// A table and what it shows.
pub(super) struct Table {
    pub(super) title: String,
    pub(super) rows: Vec<Vec<String>>,
}

/// The tables of a report, the best config first in each.
pub(super) fn tables(report: &StudyReport) -> Vec<Table> {
    let configs = &report.configs;
    let ranked: Vec<Ranked> = configs.iter().map(ConfigReport::ranked).collect();
    let order = ranking::order(ranked.iter());
    let table = |title: &str, heading: &[&str], cells: &dyn Fn(usize) -> Option<Vec<String>>| {
        let mut rows = vec![["rank", "config"].iter().chain(heading).map(ToString::to_string).collect()];
        for (rank, &i) in order.iter().enumerate() {
            let name = [(rank + 1).to_string(), visible(&configs[i].name)];
            rows.extend(cells(i).map(|cells| [&name[..], &cells].concat()));
        }
        Table { title: title.into(), rows }
    };
    let mut tables = vec![
        Table { title: ranking::HEADING.into(), rows: ranking::rows(order.iter().map(|&i| &ranked[i])) },
        table(
            "How many seeds solved, and the mean over the seeds:",
            &["final solved", "best solved", "mean"],
            &|i| Some(configs[i].scores()),
        ),
        table(
            "Median over the seeds, area under the learning curve, and how often a solution was lost, on how many seeds:",
            &["median", "area", "collapses"],
            &|i| Some(configs[i].course()),
        ),
        table(
            "Steps before the first evaluation during training that solved, after which 10, 50 and 90 % of the seeds had \
             one; how many seeds had none; the share of later evaluations that solved too, and the worst of them:",
            &["10 %", "50 %", "90 %", "none", "retained", "worst"],
            &|i| Some(configs[i].solutions()),
        ),
    ];
    if let Some(Comparison { against, .. }) = report.comparisons.first() {
        tables.push(table(
            &format!(
                "Against {}, the first config: probability that a seed of the config beats a seed of that one, and \
                 difference of the IQMs:",
                shortened(&visible(against), MAX_NAME)
            ),
            &["P(better)", "difference"],
            &|i| {
                let comparison = report.comparisons.get(i.checked_sub(1)?)?;
                Some(vec![shown(&comparison.probability_of_improvement, 3), shown(&comparison.iqm_difference, 1)])
            },
        ));
    }
    tables
}

/// What the tables mean.
pub(super) fn footnote(has_intervals: bool) -> String {
    let intervals = if has_intervals { " In brackets: 95 % intervals over training seeds." } else { "" };
    format!(
        "Solved: mean return ≥ {THRESHOLD} over the {} episodes that eval plays; an evaluation during training plays \
         others, and can solve where they do not. IQM: the mean without the best and the worst quarter of the seeds.{intervals}",
        study::SCORE_EPISODES
    )
}

/// The notes below the tables.
pub(super) fn remarks(report: &StudyReport) -> Vec<String> {
    let mut remarks = failure_lines(&report.failures, report.finished);
    remarks.extend(report.warnings.iter().map(|warning| format!("note: {}", visible(warning))));
    remarks.push(footnote(report.configs.iter().any(|config| config.final_iqm.low.is_some())));
    remarks
}

fn describe(report: &StudyReport) -> String {
    let mut text = String::new();
    for (i, Table { title, rows }) in tables(report).iter().enumerate() {
        text += &wrapped(title, 0);
        // The first has every name in full.
        text += &if i == 0 { named_table(rows) } else { table(rows) };
        text.push('\n');
    }
    remarks(report).iter().for_each(|remark| text += &wrapped(remark, 0));
    text
}
