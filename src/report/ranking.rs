//! The configs of a study, the best first, and why trials failed.

use std::collections::BTreeMap;

use serde::Serialize;

use super::comparison::Scored;
use super::outcome::{Group, Outcome, Score};
use super::statistics::{Estimate, Sample, iqm, mean, shown, sorted};
use crate::env::Spec;
use crate::study::{LastTry, Study};
use crate::text::{self, COLUMNS, GAP, LEAST_NAME, visible, width};

/// Most reasons that are printed.
const MAX_REASONS: usize = 5;

/// What decides the place of a config.
#[derive(Clone, Debug)]
pub(super) struct Ranked {
    pub(super) name: String,
    pub(super) task: Spec,
    pub(super) seeds: usize,
    pub(super) failed: usize,
    /// Seeds whose final policy solves.
    pub(super) solved: usize,
    pub(super) iqm: Estimate,
    pub(super) mean: f64,
    /// The sorted final scores, for the comparisons.
    pub(super) finals: Sample,
}

/// Trials that failed for the same reason.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Failures {
    trials: usize,
    /// That of the first, with its numbers.
    reason: String,
    config: String,
    seed: u64,
}

/// A policy's mean return; the lowest of the task where a failed run left no policy.
pub(super) fn score(policy: Option<&Score>, task: &Spec) -> f64 {
    policy.map_or(task.return_range.0, |policy| policy.mean)
}

impl Ranked {
    pub(super) fn of(Group { name, task, outcomes }: &Group) -> Self {
        let scores = || outcomes.iter().map(|outcome| score(outcome.final_.as_ref(), task));
        let finals = sorted(scores());
        Self {
            name: name.clone(),
            task: task.clone(),
            seeds: outcomes.len(),
            failed: outcomes.iter().filter(|outcome| outcome.error.is_some()).count(),
            solved: scores().filter(|&score| task.is_solved_by(score)).count(),
            iqm: Estimate::of(&finals, iqm),
            mean: mean(&finals),
            finals,
        }
    }
}

impl Ranked {
    /// What comparisons need of it.
    pub(super) fn scored<'a>(&'a self, labels: &'a Labels) -> Scored<'a> {
        Scored { name: &self.name, label: &labels[&self.name], task: &self.task, finals: &self.finals }
    }
}

/// How tables, sentences and pictures call the configs of a study: name → label.
pub(super) type Labels = BTreeMap<String, String>;

/// The labels that leave the ranked table in [`COLUMNS`].
pub(super) fn labels(study: &Study, ranked: &[Ranked]) -> Labels {
    let names: Vec<&str> = study.configs.iter().map(|config| config.name.as_str()).collect();
    let rows = rows(ranked.iter(), &Labels::new());
    let numbers =
        |row: &Vec<String>| (0..row.len()).filter(|&i| i != 1).map(|i| width(&row[i])).collect::<Vec<_>>();
    let widest = |a: Vec<usize>, b: Vec<usize>| a.into_iter().zip(b).map(|(a, b)| a.max(b)).collect();
    let taken: usize =
        rows.iter().map(numbers).reduce(widest).into_iter().flatten().map(|column| column + GAP.len()).sum();
    let labels = text::labels(&names, COLUMNS.saturating_sub(taken).max(LEAST_NAME));
    names.iter().map(ToString::to_string).zip(labels).collect()
}

/// The places of the configs, the best first: by final IQM, then by mean, then as the study has them.
pub(super) fn order<'a>(scores: impl Iterator<Item = &'a Ranked>) -> Vec<usize> {
    let scores: Vec<(f64, f64)> = scores.map(|ranked| (ranked.iqm.value, ranked.mean)).collect();
    let mut order: Vec<usize> = (0..scores.len()).collect();
    order.sort_by(|&a, &b| {
        let ((iqm_a, mean_a), (iqm_b, mean_b)) = (scores[a], scores[b]);
        iqm_b.total_cmp(&iqm_a).then(mean_b.total_cmp(&mean_a))
    });
    order
}

/// The rows of the ranked table.
pub(super) fn rows<'a>(ranked: impl Iterator<Item = &'a Ranked>, labels: &Labels) -> Vec<Vec<String>> {
    let heading = ["rank", "config", "seeds", "failed", "solved", "IQM", "mean"].map(String::from);
    let row = |(i, config): (usize, &Ranked)| {
        vec![
            (i + 1).to_string(),
            labels.get(&config.name).cloned().unwrap_or_default(),
            config.seeds.to_string(),
            config.failed.to_string(),
            config.solved.to_string(),
            shown(&config.iqm, 1),
            format!("{:.1}", config.mean),
        ]
    };
    std::iter::once(heading.to_vec()).chain(ranked.enumerate().map(row)).collect()
}

/// What the rows are.
pub(super) const HEADING: &str = "Mean return of the final policies over the seeds, the best config first:";

/// Why trials diverged, see [`reasons`].
pub(super) fn failures(groups: &[Group]) -> Vec<Failures> {
    reasons(groups.iter().flat_map(|Group { name, outcomes, .. }| {
        let reason = |outcome: &'_ Outcome| Some((outcome.seed, outcome.error.as_deref()?.to_owned()));
        outcomes.iter().filter_map(reason).map(|(seed, error)| (name.clone(), seed, error))
    }))
}

/// Why the last tries of missing trials ended, see [`reasons`].
pub(super) fn last_tries(study: &Study, last_tries: Vec<LastTry>) -> Vec<Failures> {
    let name = |config: usize| study.configs[config].name.clone();
    reasons(last_tries.into_iter().map(|LastTry { config, seed, reason }| (name(config), seed, reason)))
}

/// The reasons of trials by config and seed, the most frequent first. Reasons that differ in their numbers alone are one.
fn reasons(trials: impl Iterator<Item = (String, u64, String)>) -> Vec<Failures> {
    let mut kinds: Vec<(String, Failures)> = Vec::new();
    for (config, seed, reason) in trials {
        let kind = reason.replace(|c: char| c.is_ascii_digit(), "");
        match kinds.iter_mut().find(|(known, _)| *known == kind) {
            Some((_, failures)) => failures.trials += 1,
            None => kinds.push((kind, Failures { trials: 1, reason, config, seed })),
        }
    }
    let mut failures: Vec<Failures> = kinds.into_iter().map(|(_, failures)| failures).collect();
    failures.sort_by_key(|failures| std::cmp::Reverse(failures.trials));
    failures
}

/// How the last tries of missing trials ended, a line for each reason; nothing if there was none.
pub(super) fn last_try_lines(last_tries: &[Failures], labels: &Labels) -> Vec<String> {
    match last_tries.iter().map(|failures| failures.trials).sum() {
        0 => Vec::new(),
        begun => reason_lines(
            last_tries,
            labels,
            format!(
                "Why the last tries of {begun} missing trials ended without a result; the next ones resume them:"
            ),
        ),
    }
}

/// A sentence on how many of the trials failed, and one on each reason; nothing if none did.
pub(super) fn failure_lines(failures: &[Failures], trials: usize, labels: &Labels) -> Vec<String> {
    match failures.iter().map(|failures| failures.trials).sum() {
        0 => Vec::new(),
        failed => reason_lines(
            failures,
            labels,
            format!("{failed} of {trials} trials failed and count with the lowest return of the task:"),
        ),
    }
}

fn reason_lines(failures: &[Failures], labels: &Labels, heading: String) -> Vec<String> {
    let line = |Failures { trials, reason, config, seed }: &Failures| {
        let label = labels.get(config).cloned().unwrap_or_else(|| visible(config));
        let which = if *trials == 1 { "" } else { "first: " };
        format!("  {trials} ×: {} ({which}{label}, seed {seed})", visible(reason))
    };
    let mut lines = vec![heading];
    lines.extend(failures.iter().take(MAX_REASONS).map(line));
    if failures.len() > MAX_REASONS {
        lines.push(format!("  … and {} other reasons; report.json has all", failures.len() - MAX_REASONS));
    }
    lines
}
