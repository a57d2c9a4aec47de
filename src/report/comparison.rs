//! A config of a study against the first: what their final scores show, and what distorts it.

use serde::Serialize;

use super::statistics::{self, Estimate, LEAST_SEEDS, Sample, iqm, shown};

/// A config against the first of the study, in its final scores.
#[derive(Serialize)]
pub(super) struct Comparison {
    pub(super) config: String,
    pub(super) against: String,
    /// The label of the config, and that of the other.
    #[serde(skip)]
    pub(super) labels: [String; 2],
    pub(super) probability_of_improvement: Estimate,
    pub(super) iqm_difference: Estimate,
    verdict: ComparisonVerdict,
    pub(super) statement: String,
}

/// What the intervals of a comparison show.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
enum ComparisonVerdict {
    Better,
    Worse,
    /// Each interval holds the value of two equal configs.
    NoDifferenceShown,
    /// One number says better, and the other worse.
    Mixed,
    TooFewSeeds,
    OtherTask,
}

/// Whether an interval lies above (1) or below (−1) the value of two equal configs, or contains it (0).
fn side(estimate: &Estimate, equal: f64) -> Option<i8> {
    let (low, high) = estimate.interval()?;
    Some(i8::from(low > equal) - i8::from(high < equal))
}

#[derive(Clone, Copy)]
pub(super) struct Scored<'a> {
    pub(super) name: &'a str,
    pub(super) label: &'a str,
    pub(super) task: &'a crate::env::Spec,
    pub(super) finals: &'a Sample,
}

impl Comparison {
    pub(super) fn new(config: Scored<'_>, against: Scored<'_>) -> Self {
        let (x, y) = (config.finals, against.finals);
        let probability = Estimate::of_two(x, y, statistics::probability_of_improvement);
        let difference = Estimate::of_two(x, y, |x, y| iqm(x) - iqm(y));
        let verdict = match side(&probability, 0.5).zip(side(&difference, 0.0)) {
            _ if config.task != against.task => ComparisonVerdict::OtherTask,
            None => ComparisonVerdict::TooFewSeeds,
            Some((0, 0)) => ComparisonVerdict::NoDifferenceShown,
            Some((a, b)) if a * b < 0 => ComparisonVerdict::Mixed,
            Some((a, b)) if a + b > 0 => ComparisonVerdict::Better,
            Some(_) => ComparisonVerdict::Worse,
        };
        let mut comparison = Self {
            config: config.name.into(),
            against: against.name.into(),
            labels: [config.label.into(), against.label.into()],
            probability_of_improvement: probability,
            iqm_difference: difference,
            verdict,
            statement: String::new(),
        };
        comparison.statement = comparison.said(x.len().min(y.len()));
        comparison
    }

    /// The sentence: the verdict, and the two intervals that it follows from.
    fn said(&self, seeds: usize) -> String {
        let [config, against] = &self.labels;
        let both = format!("{config} and {against}");
        let interval = |estimate: &Estimate, digits: usize, equal: f64| {
            let place = if side(estimate, equal) == Some(0) { "contains" } else { "excludes" };
            format!("{} {place} {equal}", shown(estimate, digits))
        };
        let probability = interval(&self.probability_of_improvement, 3, 0.5);
        let difference = interval(&self.iqm_difference, 1, 0.0);
        let intervals = format!("P(better) {probability}, the difference of the IQMs {difference}");
        match self.verdict {
            ComparisonVerdict::Better => format!("{config} is better than {against}: {intervals}"),
            ComparisonVerdict::Worse => format!("{against} is better than {config}: {intervals}"),
            ComparisonVerdict::NoDifferenceShown => {
                format!("no difference shown between {both}: {intervals}")
            }
            ComparisonVerdict::Mixed => {
                format!("{both} differ, and neither is better throughout: {intervals}")
            }
            ComparisonVerdict::OtherTask => format!("nothing shown of {both}: they play different tasks"),
            ComparisonVerdict::TooFewSeeds => format!(
                "nothing shown of {both}: an interval takes {LEAST_SEEDS} seeds of both, and there are {seeds}"
            ),
        }
    }
}

/// The statements of comparisons; those with too few seeds share one.
pub(super) fn statements(comparisons: &[Comparison]) -> Vec<String> {
    let has_few = |comparison: &&Comparison| comparison.verdict == ComparisonVerdict::TooFewSeeds;
    let said = |comparison: &Comparison| comparison.statement.clone();
    let mut few = comparisons.iter().filter(has_few).map(said);
    let (first, others) = (few.next(), few.count());
    let more = if others > 0 { format!(". So it is with {others} more") } else { String::new() };
    let enough = comparisons.iter().filter(|comparison| !has_few(comparison)).map(said);
    enough.chain(first.map(|first| first + &more)).collect()
}

/// How many runs a key ended before their budget was used up, and what that does to the numbers; none if no run ended so.
pub(super) fn early_ends(groups: &[super::outcome::Group]) -> Option<String> {
    let outcomes = || groups.iter().flat_map(|group| &group.outcomes);
    let mut keys: Vec<&str> = outcomes().filter_map(|outcome| outcome.stopped_by).collect();
    let (early, all) = (keys.len(), outcomes().count());
    keys.sort_unstable();
    keys.dedup();
    let remedy =
        |key: &&str| format!("{key} to {}", if *key == "stop_when_solved" { "false" } else { "null" });
    let remedies: Vec<String> = keys.iter().map(remedy).collect();
    (early > 0).then(|| {
        format!(
            "{early} of {all} runs ended early, so final scores hide differences; set {} to compare whole trainings. Up to \
             the end of the longest run, a run that ended early counts in the learning curves and their area with its last \
             evaluation. What is retained, collapses and dips count until its end alone",
            remedies.join(" and ")
        )
    })
}
