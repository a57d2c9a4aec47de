//! Why trials of a study failed, and why others have no result.

use super::outcome::{Group, TrialOutcome};

const MAX_REASONS: usize = 5;

#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub(super) struct Failures {
    trials: usize,
    reason: String,
    config: String,
    seed: u64,
}

pub(super) fn failures(groups: &[Group]) -> Vec<Failures> {
    reasons(groups.iter().flat_map(|Group { name, outcomes, .. }| {
        outcomes.iter().filter_map(|TrialOutcome { seed, error, .. }| {
            Some((name.clone(), *seed, error.as_deref()?.to_owned()))
        })
    }))
}

pub(super) fn of_last_tries(begun: usize) -> String {
    format!("Why the last tries of {begun} missing trials ended without a result; the next ones resume them:")
}

/// The reasons of trials, given as (config, seed, reason), the most frequent first. Reasons that differ in their numbers alone are one.
pub(super) fn reasons(trials: impl IntoIterator<Item = (String, u64, String)>) -> Vec<Failures> {
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

/// The heading for so many trials, and a line for each reason; nothing if there is none.
pub(super) fn reason_lines(
    failures: &[Failures], heading: impl Fn(usize) -> String, label: impl Fn(&str) -> String,
) -> Vec<String> {
    let count: usize = failures.iter().map(|failures| failures.trials).sum();
    let line = |Failures { trials, reason, config, seed }: &Failures| {
        let which = if *trials == 1 { "" } else { "first: " };
        format!("  {trials} ×: {} ({which}{}, seed {seed})", crate::text::visible(reason), label(config))
    };
    let mut lines: Vec<String> = (count > 0).then(|| heading(count)).into_iter().collect();
    lines.extend(failures.iter().take(MAX_REASONS).map(line));
    if failures.len() > MAX_REASONS {
        lines.push(format!("  … and {} other reasons; report.json has all", failures.len() - MAX_REASONS));
    }
    lines
}
