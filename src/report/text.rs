//! The report of a study in words: tables and notes.

use super::ranking::{self, Ranked, failure_lines, last_try_lines, named_table};
use super::statistics::{Estimate, shown};
use super::summary::{Comparison, ConfigReport, ConfigRetention, Endurance, StepsToSolve, StudyReport};
use crate::env::Spec;
use crate::study;
use crate::text::{shortened, table, visible, wrapped};

/// Widest name in a sentence, in columns.
const MAX_NAME: usize = 48;
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
pub(super) fn footnote(task: &Spec, has_intervals: bool) -> String {
    let intervals = if has_intervals { " In brackets: 95 % intervals over training seeds." } else { "" };
    format!(
        "Solved: mean return {} over the {} episodes that eval plays; an evaluation during training plays \
         others, and can solve where they do not. IQM: the mean without the best and the worst quarter of the seeds.{intervals}",
        task.goal(),
        study::SCORE_EPISODES
    )
}

/// The notes below the tables.
pub(super) fn remarks(report: &StudyReport) -> Vec<String> {
    let mut remarks = failure_lines(&report.failures, report.finished);
    remarks.extend(last_try_lines(&report.last_tries));
    remarks.extend(report.warnings.iter().map(|warning| format!("note: {}", visible(warning))));
    remarks.push(footnote(
        &report.configs[0].task,
        report.configs.iter().any(|config| config.final_iqm.low.is_some()),
    ));
    remarks
}

pub(super) fn describe(report: &StudyReport) -> String {
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
