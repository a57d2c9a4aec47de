//! The report of a study in words: tables and notes.

use super::comparison::{Comparison, statements};
use super::failures::{of_last_tries, reason_lines};
use super::statistics::{Estimate, shown};
use super::summary::{ConfigReport, ConfigRetention, Lasting, StepsPlayed, StepsToSolve, StudyReport};
use crate::study::{LASTING_STEPS, SCORE_EPISODES, Study};
use crate::text::{self, COLUMNS, GAP, LEAST_NAME, legend, table, visible, width, wrapped};
use crate::trainer::LASTING_EPISODES;

fn share_shown(count: usize, share: &Estimate) -> String {
    match share.interval() {
        Some((low, high)) => format!("{count} [{:.1}, {:.1} %]", 100.0 * low, 100.0 * high),
        None => count.to_string(),
    }
}

pub(super) struct Table {
    pub(super) title: String,
    pub(super) rows: Vec<Vec<String>>,
}

/// How tables, sentences and pictures call the configs of a study: name → label.
pub(super) type Labels = std::collections::BTreeMap<String, String>;

/// The labels that leave the ranked table in [`COLUMNS`].
pub(super) fn labels(study: &Study, configs: &[ConfigReport]) -> Labels {
    let Table { rows, .. } = ranked(configs);
    let widest = |i: usize| rows.iter().map(|row| width(&row[i])).max().unwrap_or(0) + GAP.len();
    let taken: usize = (0..rows[0].len()).filter(|&i| i != 1).map(widest).sum();
    let names: Vec<&str> = study.configs.iter().map(|config| config.name.as_str()).collect();
    let labels = text::labels(&names, COLUMNS.saturating_sub(taken).max(LEAST_NAME));
    names.iter().map(ToString::to_string).zip(labels).collect()
}

type Cells<'a> = &'a dyn Fn(&ConfigReport) -> Option<Vec<String>>;

/// A table of the configs that have these cells, the best first: by final IQM, then by mean, then as the study has them.
fn by_rank(configs: &[ConfigReport], title: &str, heading: &[&str], cells: Cells) -> Table {
    let mut ranked: Vec<&ConfigReport> = configs.iter().collect();
    ranked.sort_by(|a, b| {
        let by_iqm = b.final_iqm.value.total_cmp(&a.final_iqm.value);
        by_iqm.then(b.final_mean.value.total_cmp(&a.final_mean.value))
    });
    let mut rows = vec![["rank", "config"].iter().chain(heading).map(ToString::to_string).collect()];
    for (rank, config) in ranked.into_iter().enumerate() {
        let name = [(rank + 1).to_string(), config.label.clone()];
        rows.extend(cells(config).map(|cells| [&name[..], &cells].concat()));
    }
    Table { title: title.into(), rows }
}

fn ranked(configs: &[ConfigReport]) -> Table {
    let title = "Mean return of the final policies over the seeds, the best config first:";
    by_rank(configs, title, &["seeds", "failed", "solved", "IQM", "mean"], &|c| {
        let counts = [c.seeds, c.failed, c.final_solved].map(|count| count.to_string());
        let means = [shown(&c.final_iqm, 1), format!("{:.1}", c.final_mean.value)];
        Some([&counts[..], &means].concat())
    })
}

pub(super) fn tables(report: &StudyReport) -> Vec<Table> {
    let configs = &report.configs;
    let table = |title: &str, heading: &[&str], cells: Cells| by_rank(configs, title, heading, cells);
    let mut tables = vec![
        ranked(configs),
        table(
            "How many seeds' final policy solves, and how many seeds' best one:",
            &["final solved", "best solved"],
            &|c| {
                let of_final = share_shown(c.final_solved, &c.final_solved_share);
                Some(vec![of_final, share_shown(c.best_solved, &c.best_solved_share)])
            },
        ),
        table(
            "Steps before the first evaluation during training that solved, after which 10, 50 and 90 % of the seeds had \
             one; how many seeds had none; area under the learning curve:",
            &["10 %", "50 %", "90 %", "none", "area"],
            &|c| {
                let StepsToSolve { q10, q50, q90, never, .. } = c.steps_to_solve;
                let steps = |steps: Option<u64>| steps.map_or_else(|| "never".into(), |n| n.to_string());
                let [q10, q50, q90] = [q10, q50, q90].map(steps);
                Some(vec![q10, q50, q90, never.to_string(), shown(&c.area_under_curve, 1)])
            },
        ),
        table(
            "How many runs a key ended early; the share of the evaluations after the first solution that solved too, and the \
             worst of them; how often a solution was lost, on how many seeds: in a collapse to less than half way back to the \
             random policy, and in a dip not so far:",
            &["ended early", "retained", "worst", "collapses", "dips"],
            &|c| {
                let ConfigRetention { share, worst, collapses, collapsed_seeds, dips, dipped_seeds, .. } =
                    &c.retention;
                Some(vec![
                    c.ended_early.to_string(),
                    share.map_or_else(|| "-".into(), |share| format!("{:.1} %", 100.0 * share)),
                    worst.as_ref().map_or_else(|| "-".into(), |worst| format!("{:.1}", worst.mean)),
                    format!("{collapses} on {collapsed_seeds}"),
                    format!("{dips} on {dipped_seeds}"),
                ])
            },
        ),
        table("Mean and median of the final policies over the seeds:", &["mean", "median"], &|c| {
            Some(vec![shown(&c.final_mean, 1), shown(&c.final_median, 1)])
        }),
    ];
    if configs.iter().any(|config| config.steps_played.is_some()) {
        tables.push(table(
            "What a run costs, in environment steps, the median over the seeds: those of training, and those that were played \
             without learning, in evaluations and in tests whether a policy lasts:",
            &["training", "evaluations", "tests"],
            &|c| {
                let StepsPlayed { training, evaluations, lasting_tests } = c.steps_played.as_ref()?;
                Some([training, evaluations, lasting_tests].map(ToString::to_string).to_vec())
            },
        ));
    }
    if configs.iter().any(|config| config.lasting.is_some()) {
        tables.push(table(
            &format!(
                "How many seeds have a policy that lasts {LASTING_STEPS} steps from all {LASTING_EPISODES} starts:"
            ),
            &["final lasts", "best lasts"],
            &|c| {
                let Lasting { final_, best, final_share, best_share } = c.lasting.as_ref()?;
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
            &|c| {
                let comparison = report.comparisons.iter().find(|comparison| comparison.config == c.name)?;
                Some(vec![shown(&comparison.probability_of_improvement, 3), shown(&comparison.iqm_difference, 1)])
            },
        ));
    }
    tables
}

pub(super) fn names(report: &StudyReport) -> impl Iterator<Item = (&str, &str)> {
    report.configs.iter().map(|config| (config.label.as_str(), config.name.as_str()))
}

fn footnote(configs: &[ConfigReport]) -> String {
    let has_intervals = configs.iter().any(|config| config.final_iqm.low.is_some());
    let intervals = if has_intervals { " In brackets: 95 % intervals over training seeds." } else { "" };
    let task = &configs[0].task;
    let solved = match task.solved_return {
        Some(_) => format!(
            "Solved: mean return {} over the {SCORE_EPISODES} episodes that eval plays; an evaluation during training plays \
             others, and can solve where they do not.",
            task.goal()
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

fn failed(report: &StudyReport) -> Vec<String> {
    let heading = |failed| {
        format!("{failed} of {} trials failed and count with the lowest return of the task:", report.finished)
    };
    reason_lines(&report.failures, heading, |config| label(report, config))
}

/// How tables call a config; its name if it has no finished trial.
fn label(report: &StudyReport, name: &str) -> String {
    names(report).find(|(_, other)| *other == name).map_or_else(|| visible(name), |(label, _)| label.into())
}

pub(super) fn remarks(report: &StudyReport) -> Vec<String> {
    let mut remarks = failed(report);
    remarks.extend(reason_lines(&report.last_tries, of_last_tries, |config| label(report, config)));
    remarks.push(footnote(&report.configs));
    remarks
}

/// The result of a study, as it is printed when it ends.
pub(super) fn standing(report: &StudyReport) -> String {
    let (StudyReport { configs, finished, .. }, task) = (report, &report.configs[0].task);
    let solved: usize = configs.iter().map(|config| config.final_solved).sum();
    let solved = match task.solved_return {
        Some(_) => format!(
            "{solved} by the final policy (mean return {} over eval's {SCORE_EPISODES} episodes)",
            task.goal()
        ),
        None => "unknown, since the task has no threshold".into(),
    };
    let Table { title, rows } = ranked(configs);
    let failures = report.failed;
    let mut text = format!("trials     {finished}\nsolved     {solved}\nfailed     {failures}\n\n{title}\n");
    text += &(table(&rows) + &legend(names(report)));
    statements(&report.comparisons).iter().for_each(|statement| text += &wrapped(statement, 2));
    failed(report).iter().for_each(|line| text += &wrapped(line, 7));
    report.warnings.iter().for_each(|note| text += &wrapped(&format!("note: {}", visible(note)), 0));
    text + &wrapped(&footnote(configs), 0)
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
