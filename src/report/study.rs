//! The report of a study, from its files.

use std::path::Path;

use serde_json::json;

use super::comparison::{Comparison, early_ends};
use super::failures::{failures, of_last_tries, reason_lines, reasons};
use super::outcome::{self, Group};
use super::statistics::{BOOTSTRAP_SEED, LEAST_SEEDS, RESAMPLES};
use super::summary::{ConfigReport, StudyReport, config_report};
use super::text::{self, Labels, describe};
use super::{FORMAT_VERSION, Report, ReportError, csv, plots};
use crate::study::{self, NamedConfig, StudyDir};

const MAX_NAMED: usize = 3;

pub(super) struct ReadStudy {
    pub(super) configs: Vec<NamedConfig>,
    groups: Vec<Group>,
    pub(super) report: StudyReport,
    pub(super) notes: Vec<String>,
}

impl ReadStudy {
    pub(super) fn read(path: &Path) -> Result<Self, ReportError> {
        Self::of(&StudyDir::open_to_read(path)?)
    }

    fn of(study_dir: &StudyDir) -> Result<Self, ReportError> {
        let study = &study_dir.study;
        let (groups, left_out) = outcome::read(study_dir)?;
        if groups.is_empty() {
            let why = describe_last_tries(left_out.last_tries);
            let problem = format!("no trial is finished yet; run the study's command first\n{why}");
            return Err(ReportError::new(&study_dir.path, problem.trim_end()));
        }
        let mut configs: Vec<ConfigReport> = groups.iter().map(config_report).collect();
        let labels = text::labels(study, &configs);
        configs.iter_mut().for_each(|config| config.label.clone_from(&labels[&config.name]));
        let others = configs[1..].iter();
        let report = StudyReport {
            format_version: FORMAT_VERSION,
            kind: "study",
            threshold: configs[0].task.solved_return,
            trials: study.total(),
            finished: groups.iter().map(|group| group.outcomes.len()).sum(),
            failed: configs.iter().map(|config| config.failed).sum(),
            failures: failures(&groups),
            last_tries: reasons(left_out.last_tries),
            bootstrap: json!({"confidence": 0.95, "resamples": RESAMPLES, "seed": BOOTSTRAP_SEED}),
            warnings: early_ends(&groups).into_iter().chain(warnings(study, &configs, &labels)).collect(),
            comparisons: others.map(|config| Comparison::new(config.scored(), configs[0].scored())).collect(),
            seeds: study.seeds.clone(),
            configs,
        };
        Ok(Self { configs: study.configs.clone(), groups, report, notes: left_out.notes })
    }
}

pub(super) fn report(path: &Path) -> Result<Report, ReportError> {
    let ReadStudy { groups, report, notes, .. } = ReadStudy::read(path)?;
    let mut files = plots::study(&report);
    let (text, json) = (describe(&report), json!(report));
    let rows = move |file: &mut dyn std::io::Write| {
        let trials = groups.iter().flat_map(|Group { name, outcomes, .. }| {
            outcomes.iter().map(|outcome| (name.as_str(), outcome.seed, outcome.evaluations()))
        });
        csv(file, trials)
    };
    files.insert(0, (crate::run::names::EVALUATIONS, Box::new(rows)));
    Ok(Report { text, json, files, notes })
}

/// Why the last tries of missing trials ended, in words; nothing if there was none.
pub(crate) fn describe_last_tries(tries: Vec<(String, u64, String)>) -> String {
    let lines = reason_lines(&reasons(tries), of_last_tries, crate::text::visible);
    lines.iter().map(|line| crate::text::wrapped(line, 0)).collect()
}

/// What a reader must know to judge the numbers. Configs for which the same note is true share it.
fn warnings(manifest: &study::Study, configs: &[ConfigReport], labels: &Labels) -> Vec<String> {
    let seeds = manifest.seeds.clone().count();
    let mut notes: Vec<(String, Vec<&str>)> = Vec::new();
    let mut add = |note: String, name| match notes.iter_mut().find(|(known, _)| *known == note) {
        Some((_, names)) => names.push(name),
        None => notes.push((note, vec![name])),
    };
    for (name, label) in labels {
        let finished = configs.iter().find(|config| config.name == *name).map_or(0, |config| config.seeds);
        let rest = format!(
            "{finished} of {seeds} seeds are finished; the study's command, given again, trains the rest"
        );
        let few = format!(
            "{finished} seeds are fewer than {LEAST_SEEDS}; an interval over so few would mislead, so there is none"
        );
        let all = [(finished < seeds, rest), ((1..LEAST_SEEDS).contains(&finished), few)];
        all.into_iter().filter(|(is_so, _)| *is_so).for_each(|(_, note)| add(note, label.as_str()));
    }
    let all = manifest.configs.len();
    let sentence = |(note, names): &(String, Vec<&str>)| match names.len() {
        count if count == all && all > 1 => format!("all {all} configs: {note}"),
        count if count <= MAX_NAMED => format!("{}: {note}", names.join(", ")),
        count => format!("{} and {} other configs: {note}", names[0], count - 1),
    };
    notes.iter().map(sentence).collect()
}

pub fn standing(study_dir: &StudyDir) -> Result<String, ReportError> {
    Ok(text::standing(&ReadStudy::of(study_dir)?.report))
}
