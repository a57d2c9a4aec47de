//! The report of a study in words: tables and notes.

use super::comparison::{Comparison, statements};
use super::ranking::{self, Ranked, failure_lines, last_try_lines};
use super::statistics::{Estimate, shown};
use super::summary::{ConfigReport, ConfigRetention, Endurance, StepsToSolve, StudyReport};
use crate::env::Spec;
use crate::study;
use crate::text::{legend, table, visible, wrapped};

fn share_shown(count: usize, share: &Estimate) -> String {
    let percent = |value: f64| 100.0 * value;
    match (share.low, share.high) {
        (Some(low), Some(high)) => format!("{count} [{:.1}, {:.1} %]", percent(low), percent(high)),
        _ => count.to_string(),
    }
}

impl ConfigReport {
    pub(super) fn ranked(&self) -> Ranked {
        Ranked {
            name: self.name.clone(),
            task: self.task.clone(),
            seeds: self.seeds,
            failed: self.failed,
            solved: self.final_solved,
            iqm: self.final_iqm,
            mean: self.final_mean.value,
            finals: self.scores.clone(),
        }
    }

    /// How many policies solve.
    fn solved(&self) -> Vec<String> {
        vec![
            share_shown(self.final_solved, &self.final_solved_share),
            share_shown(self.best_solved, &self.best_solved_share),
        ]
    }

    /// What the runs kept.
    fn course(&self) -> Vec<String> {
        let ConfigRetention { share, worst, collapses, collapsed_seeds, dips, dipped_seeds, .. } =
            &self.retention;
        vec![
            self.ended_early.to_string(),
            share.map_or_else(|| "-".into(), |share| format!("{:.1} %", 100.0 * share)),
            worst.as_ref().map_or_else(|| "-".into(), |worst| format!("{:.1}", worst.mean)),
            format!("{collapses} on {collapsed_seeds}"),
            format!("{dips} on {dipped_seeds}"),
        ]
    }

    fn solutions(&self) -> Vec<String> {
        let steps = |steps: Option<u64>| steps.map_or_else(|| "never".into(), |steps| steps.to_string());
        let StepsToSolve { q10, q50, q90, never, .. } = self.steps_to_solve;
        vec![steps(q10), steps(q50), steps(q90), never.to_string()]
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
    let labels = names(report).map(|(label, name)| (name.to_owned(), label.to_owned())).collect();
    let order = ranking::order(ranked.iter());
    let table = |title: &str, heading: &[&str], cells: &dyn Fn(usize) -> Option<Vec<String>>| {
        let mut rows = vec![["rank", "config"].iter().chain(heading).map(ToString::to_string).collect()];
        for (rank, &i) in order.iter().enumerate() {
            let name = [(rank + 1).to_string(), configs[i].label.clone()];
            rows.extend(cells(i).map(|cells| [&name[..], &cells].concat()));
        }
        Table { title: title.into(), rows }
    };
    let mut tables = vec![
        Table {
            title: ranking::HEADING.into(),
            rows: ranking::rows(order.iter().map(|&i| &ranked[i]), &labels),
        },
        table(
            "How many seeds' final policy solves, and how many seeds' best one:",
            &["final solved", "best solved"],
            &|i| Some(configs[i].solved()),
        ),
        table(
            "Steps before the first evaluation during training that solved, after which 10, 50 and 90 % of the seeds had \
             one; how many seeds had none; area under the learning curve:",
            &["10 %", "50 %", "90 %", "none", "area"],
            &|i| Some([configs[i].solutions(), vec![shown(&configs[i].area_under_curve, 1)]].concat()),
        ),
        table(
            "How many runs a key ended early; the share of the evaluations after the first solution that solved too, and the \
             worst of them; how often a solution was lost, on how many seeds: in a collapse to less than half way back to the \
             random policy, and in a dip not so far:",
            &["ended early", "retained", "worst", "collapses", "dips"],
            &|i| Some(configs[i].course()),
        ),
        table("Mean and median of the final policies over the seeds:", &["mean", "median"], &|i| {
            Some(vec![shown(&configs[i].final_mean, 1), shown(&configs[i].final_median, 1)])
        }),
    ];
    if configs.iter().any(|config| config.endurance.is_some()) {
        tables.push(table(
            &format!(
                "How many seeds have a policy that lasts {} steps from all {} starts:",
                study::ENDURANCE_STEPS,
                study::SCORE_EPISODES
            ),
            &["final lasts", "best lasts"],
            &|i| {
                let Endurance { final_, best, final_share, best_share } = configs[i].endurance.as_ref()?;
                Some(vec![share_shown(*final_, final_share), share_shown(*best, best_share)])
            },
        ));
    }
    if let Some(Comparison { labels: [_, against], .. }) = report.comparisons.first() {
        tables.push(table(
            &format!(
                "Against {against}, the first config: probability that a seed of the config beats a seed of that one, and \
                 difference of the IQMs:"
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

/// The labels of the configs, and their names.
pub(super) fn names(report: &StudyReport) -> impl Iterator<Item = (&str, &str)> {
    report.configs.iter().map(|config| (config.label.as_str(), config.name.as_str()))
}

/// What the tables mean.
pub(super) fn footnote(task: &Spec, has_intervals: bool) -> String {
    let intervals = if has_intervals { " In brackets: 95 % intervals over training seeds." } else { "" };
    let solved = match task.solved_return {
        Some(_) => format!(
            "Solved: mean return {} over the {} episodes that eval plays; an evaluation during training plays others, and can \
             solve where they do not.",
            task.goal(),
            study::SCORE_EPISODES
        ),
        None => "The task has no threshold, so nothing is said to solve it.".into(),
    };
    format!("{solved} IQM: the mean without the best and the worst quarter of the seeds.{intervals}")
}

/// What the comparisons show, and what distorts it: the first thing to read.
pub(super) fn conclusions(report: &StudyReport) -> Vec<String> {
    let mut said = statements(&report.comparisons);
    said.extend(report.warnings.iter().map(|warning| format!("note: {}", visible(warning))));
    said
}

/// The notes below the tables.
pub(super) fn remarks(report: &StudyReport) -> Vec<String> {
    let labels = names(report).map(|(label, name)| (name.to_owned(), label.to_owned())).collect();
    let mut remarks = failure_lines(&report.failures, report.finished, &labels);
    remarks.extend(last_try_lines(&report.last_tries, &labels));
    remarks.push(footnote(
        &report.configs[0].task,
        report.configs.iter().any(|config| config.final_iqm.low.is_some()),
    ));
    remarks
}

pub(super) fn describe(report: &StudyReport) -> String {
    let mut text = String::new();
    for (i, Table { title, rows }) in tables(report).iter().enumerate() {
        text += &(wrapped(title, 0) + &table(rows));
        if i == 0 {
            text += &legend(names(report));
            conclusions(report).iter().for_each(|said| text += &wrapped(&format!("  {said}"), 4));
        }
        text.push('\n');
    }
    remarks(report).iter().for_each(|remark| text += &wrapped(remark, 0));
    text
}
