//! The report of a study, from its files.

use std::fmt::Write;
use std::path::Path;

use serde_json::{Value, json};

use super::ranking::{self, Ranked, failure_lines, failures, named_table};
use super::statistics::{BOOTSTRAP_SEED, LEAST_SEEDS, RESAMPLES};
use super::summary::{Bootstrap, ConfigReport, StudyReport, compare, config_report};
use super::text::{describe, footnote};
use super::{FORMAT_VERSION, Report, ReportError, csv, parse, plots};
use crate::env::Spec;
use crate::run::names::{EVALUATIONS, MANIFEST};
use crate::study::{self, NamedConfig, Trial, finished_seeds, read_trial, trial_path};
use crate::text::wrapped;

/// Most configs that a note names.
const MAX_NAMED: usize = 3;
/// Reads what a study runs.
pub(super) fn read_manifest(folder: &Path) -> Result<study::Study, ReportError> {
    let path = folder.join(MANIFEST);
    let manifest: Value = parse(&path)?;
    let version = &manifest["format_version"];
    if *version != study::FORMAT_VERSION {
        let problem =
            format!("has format_version {version}, and this program reads {}", study::FORMAT_VERSION);
        return Err(ReportError::new(&path, problem));
    }
    serde_json::from_value(manifest).map_err(|error| ReportError::new(&path, error))
}

/// A study that has been read and judged.
pub(super) struct Study {
    pub(super) configs: Vec<NamedConfig>,
    trials: Vec<Vec<Trial>>,
    pub(super) report: StudyReport,
}

impl Study {
    pub(super) fn read(folder: &Path) -> Result<Self, ReportError> {
        let manifest = read_manifest(folder)?;
        let groups = read_trials(folder, &manifest)?;
        let configs: Vec<ConfigReport> =
            groups.iter().map(|(task, trials)| config_report(task, trials)).collect();
        let trials: Vec<Vec<Trial>> = groups.into_iter().map(|(_, trials)| trials).collect();
        let report = StudyReport {
            format_version: FORMAT_VERSION,
            kind: "study",
            threshold: configs[0].task.solved_return,
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

/// The report of the study in a directory.
pub(super) fn report(folder: &Path) -> Result<Report, ReportError> {
    let Study { trials, report, .. } = Study::read(folder)?;
    let runs = trials.iter().flatten();
    let evaluations = csv(runs.map(|trial| (trial.config.as_str(), trial.seed, &trial.evaluations[..])));
    let mut files = vec![(EVALUATIONS, evaluations)];
    files.extend(plots::study(&report.configs));
    Ok(Report { text: describe(&report), json: json!(report), files })
}

/// The task and the finished trials of each config that has any, in the order of their seeds.
pub(super) fn read_trials(
    folder: &Path,
    manifest: &study::Study,
) -> Result<Vec<(Spec, Vec<Trial>)>, ReportError> {
    let mut groups = Vec::new();
    for (i, NamedConfig { name, task, .. }) in manifest.configs.iter().enumerate() {
        let mut trials = Vec::new();
        let seeds = finished_seeds(folder, i).map_err(|error| ReportError::new(folder, error))?;
        for seed in seeds.into_iter().filter(|seed| manifest.seeds.contains(seed)) {
            let trial = read_trial(&trial_path(folder, (i, seed)), name, seed);
            trials.push(trial.map_err(|error| ReportError::new(folder, error))?);
        }
        groups.push((task.clone(), trials));
    }
    groups.retain(|(_, trials)| !trials.is_empty());
    if groups.is_empty() {
        return Err(ReportError::new(folder, "no trial is finished yet; run the study's command first"));
    }
    Ok(groups)
}

/// What a reader must know of the numbers: one note for all configs that it is true of.
fn warnings(manifest: &study::Study, configs: &[ConfigReport]) -> Vec<String> {
    let seeds = manifest.seeds.clone().count();
    let mut notes: Vec<(String, Vec<&str>)> = Vec::new();
    let mut add = |note: String, name| match notes.iter_mut().find(|(known, _)| *known == note) {
        Some((_, names)) => names.push(name),
        None => notes.push((note, vec![name])),
    };
    for NamedConfig { name, .. } in &manifest.configs {
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

/// The result of the study in a directory, as it is printed when it ends.
///
/// # Errors
/// When it is no study, nothing has been finished in it, or a file in it is damaged.
pub fn standing(folder: &Path) -> Result<String, ReportError> {
    let manifest = read_manifest(folder)?;
    let groups = read_trials(folder, &manifest)?;
    let ranked: Vec<Ranked> =
        groups.iter().map(|(task, trials)| Ranked::of(&trials[0].config, task, trials)).collect();
    let order = ranking::order(ranked.iter());
    let mut text =
        format!("{}\n{}", ranking::HEADING, named_table(&ranking::rows(order.iter().map(|&i| &ranked[i]))));
    let trials = groups.iter().flat_map(|(_, trials)| trials);
    for line in failure_lines(&failures(trials.clone()), trials.count()) {
        text += &wrapped(&line, 7);
    }
    text += &wrapped(&footnote(&groups[0].0, ranked.iter().any(|config| config.iqm.low.is_some())), 0);
    if ranked.iter().any(|config| config.seeds < LEAST_SEEDS) {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "With fewer than {LEAST_SEEDS} seeds there are no 95 % intervals.");
    }
    Ok(text)
}
