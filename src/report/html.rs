//! A report as one HTML file that needs nothing else: no network, no other file.

use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::panels::{figure, learning};
use super::portrait::portrait;
use super::run::{self, Run};
use super::study::ReadStudy;
use super::svg::{DARK, escaped};
use super::text::{self, Table};
use super::{ReportError, is_study, parse, plots};
use crate::config::{Config, Setting};
use crate::run::names::{CONFIG, SUMMARY};
use crate::trainer::Evaluation;

const PAGE: &str = include_str!("html/page.html");
const STYLE: &str = include_str!("html/page.css");
const SCRIPT: &str = include_str!("html/page.js");
const POLICY: &str = include_str!("html/policy.html");

/// Whether a file with this beginning may be a [`page`], which another page may replace.
pub(crate) fn is_page(start: &[u8]) -> bool {
    start.starts_with(PAGE.split("{{").next().unwrap_or_default().as_bytes())
}

pub(crate) fn page(directories: &[PathBuf]) -> Result<String, ReportError> {
    let kinds = directories.iter().map(|directory| is_study(directory)).collect::<Result<Vec<_>, _>>()?;
    match (kinds.iter().position(|is_study| *is_study), directories) {
        (None, _) => runs_page(directories),
        (Some(_), [study]) => study_page(study),
        (Some(i), _) => Err(ReportError::new(
            &directories[i],
            "is a study; a page shows either one study or several runs",
        )),
    }
}

fn runs_page(directories: &[PathBuf]) -> Result<String, ReportError> {
    let named = directories.iter().zip(run::names(directories)?);
    let runs = named.map(|(directory, name)| Run::read(directory, name)).collect::<Result<Vec<_>, _>>()?;
    let mut portraits = Vec::new();
    for (directory, run) in directories.iter().zip(&runs) {
        portraits.push(json!({"name": run.name, "portrait": portrait(directory, &run.environment)?}));
    }
    let title = match &runs[..] {
        [run] => format!("Run {}", run.name),
        runs => format!("{} runs", runs.len()),
    };
    let mut sections = results(&runs);
    let mut note = String::from("All panels are over the environment steps of training.");
    if runs.len() > 1 {
        note += " In the learning curve the bold line is the mean return of an evaluation, the faint one that of the last \
                 100 training episodes.";
    }
    sections += &section("Learning", &format!("<p class=\"note\">{note}</p>\n{}", learning(&runs)));
    let is_hidden = |portrait: &Value| portrait["portrait"].is_null();
    let hidden = directories.iter().zip(&runs).zip(&portraits).filter(|(_, portrait)| is_hidden(portrait));
    let unplayed: String = hidden.map(|((directory, run), _)| unplayed(directory, run)).collect();
    let are_all_hidden = portraits.iter().all(is_hidden);
    sections += if are_all_hidden { "" } else { POLICY };
    if !unplayed.is_empty() {
        let title = if are_all_hidden { "The policy" } else { "Policies that are not played" };
        sections += &section(title, &unplayed);
    }
    let configs: Vec<(&str, &Value)> = runs.iter().map(|run| (run.name.as_str(), &run.config)).collect();
    sections += &section("Config", &config_tables(&configs));
    let mut how = String::from(
        "<p>The same config gives the same weights, bit for bit. Save the run's config as <code>config.json</code>:</p>\n\
         <pre>cartpole-dqn train --config config.json --out again</pre>\n",
    );
    for (directory, (name, config)) in directories.iter().zip(&configs) {
        let hash = parse::<Value>(&directory.join(SUMMARY)).ok();
        if let Some(hash) = hash.as_ref().and_then(|summary| summary["weights_sha256"].as_str()) {
            let (name, hash) = (escaped(name), escaped(hash));
            how += &format!("<p>{name} ended with weights sha256 <code>{hash}</code>.</p>\n");
        }
        how += &config_file(&format!("{CONFIG} of {name}"), config);
    }
    sections += &section("How to reproduce it", &how);
    let subtitle = if runs.iter().all(|run| run.report.ended) { "" } else { "Not every run has ended." };
    Ok(assembled(&title, subtitle, &sections, &json!({"runs": portraits})))
}

fn study_page(directory: &Path) -> Result<String, ReportError> {
    let ReadStudy { configs, report, notes, .. } = ReadStudy::read(directory)?;
    let mut result = list(&text::conclusions(&report));
    for Table { title, rows } in text::tables(&report) {
        result += &format!("<p>{}</p>\n{}", escaped(&title), table(&rows, 2));
    }
    let shortened = text::names(&report).filter(|(label, name)| label != name);
    let full: String =
        shortened.map(|(label, name)| format!("<li>{}: {}</li>\n", escaped(label), escaped(name))).collect();
    if !full.is_empty() {
        result += &format!("<p>Names in full:</p>\n<ul>\n{full}</ul>\n");
    }
    for remark in text::remarks(&report).into_iter().chain(notes) {
        result += &format!("<p class=\"note\">{}</p>\n", escaped(&remark));
    }
    let mut sections = section("Result", &result);
    let drawn = plots::STUDY.iter().map(|(_, draw)| figure(|shape| draw(&report, shape)));
    sections += &section("Plots", &drawn.collect::<String>());
    let values: Vec<Value> = configs.iter().map(|named| json!(named.config)).collect();
    let configs: Vec<(&str, &Value)> = configs.iter().map(|named| named.name.as_str()).zip(&values).collect();
    sections += &section("Configs", &config_tables(&configs));
    let std::ops::Range { start, end } = report.seeds;
    let files: String = (0..configs.len()).map(|i| format!(" --config {i}.json")).collect();
    let mut how = format!(
        "<p>The same configs and seeds give the same trials, bit for bit. Save the configs, in their order, as \
         <code>0.json</code>, <code>1.json</code>, …:</p>\n\
         <pre>cartpole-dqn study{files} --seeds {start}..{end} --out again\ncartpole-dqn report again</pre>\n"
    );
    for (i, (name, config)) in configs.iter().enumerate() {
        how += &config_file(&format!("{i}.json: {name}"), config);
    }
    sections += &section("How to reproduce it", &how);
    let path = directory.canonicalize().unwrap_or_default();
    let title = format!("Study {}", path.file_name().unwrap_or_default().to_string_lossy());
    let subtitle = format!("{} configs, seeds {start} to {}", configs.len(), end.saturating_sub(1));
    Ok(assembled(&title, &subtitle, &sections, &json!({"runs": []})))
}

/// Why a run has no portrait, and what its evaluations recorded.
fn unplayed(directory: &Path, run: &Run) -> String {
    let name = escaped(&run.name);
    if crate::run::checkpoint_of(directory).is_err() {
        return format!(
            "<p>{name}: there is no checkpoint in the directory, so there is nothing to play.</p>\n"
        );
    }
    let mut rows =
        vec![["evaluation", "step", "mean return", "smallest", "largest"].map(String::from).to_vec()];
    for (which, Evaluation { env_steps, mean }) in [("best", run.report.best), ("final", run.report.final_)] {
        let extremes = run.history.extremes.iter().find(|(step, ..)| *step == env_steps as f64);
        let shown = |value: Option<f64>| value.map_or_else(|| "–".into(), |value| format!("{value:.1}"));
        let [smallest, largest] = [extremes.map(|e| e.1), extremes.map(|e| e.2)].map(shown);
        rows.push(vec![which.into(), env_steps.to_string(), format!("{mean:.1}"), smallest, largest]);
    }
    format!(
        "<p>{name}: the policy's task is a program, which a report does not start, so no episode is shown. \
         <code>cartpole-dqn watch DIR --allow-command</code> starts it and plays. This is what the run recorded of the \
         policy:</p>\n{}",
        table(&rows, 1)
    )
}

/// The results: one run has cards, several runs have a table; then the statements on each.
fn results(runs: &[Run]) -> String {
    let solved = |run: &Run| match (run.report.solved_at_step, run.task.solved_return) {
        (Some(step), _) => step.to_string(),
        (None, Some(_)) => "never".into(),
        (None, None) => "no threshold".into(),
    };
    if let [run] = runs {
        let (best, last, seed) = (run.report.best.mean, run.report.final_.mean, run.report.seed);
        let cards = format!(
            "<div class=\"cards\"><div>solved at step<b>{}</b></div>\n<div>best evaluation<b>{best:.1}</b></div>\n\
             <div>final evaluation<b>{last:.1}</b></div>\n<div>seed<b>{seed}</b></div>\n</div>\n",
            solved(run)
        );
        return section("Result", &(cards + &list(&run.report.statements)));
    }
    let head = ["run", "seed", "solved at step", "best evaluation", "final evaluation"];
    let mut rows = vec![head.map(String::from).to_vec()];
    let mut said = String::new();
    for run in runs {
        let report = &run.report;
        let [best, last] = [report.best, report.final_].map(|evaluation| format!("{:.1}", evaluation.mean));
        rows.push(vec![run.name.clone(), report.seed.to_string(), solved(run), best, last]);
        let (name, said_of_it) = (escaped(&run.name), list(&report.statements));
        said += &format!("<details>\n<summary>What happened in {name}</summary>\n{said_of_it}</details>\n");
    }
    section("Result", &(table(&rows, 1) + &said))
}

fn section(title: &str, content: &str) -> String {
    format!("<section>\n<h2>{title}</h2>\n{content}</section>\n")
}

fn list(lines: &[String]) -> String {
    let items: String = lines.iter().map(|line| format!("<li>{}</li>\n", escaped(line.trim()))).collect();
    if items.is_empty() { items } else { format!("<ul>\n{items}</ul>\n") }
}

/// Rows of numbers below a heading, with so many columns of names at the front.
fn table(rows: &[Vec<String>], names: usize) -> String {
    let mut html = String::from("<div class=\"scroll\"><table class=\"stack\">\n");
    for (i, row) in rows.iter().enumerate() {
        let tag = if i == 0 { "th" } else { "td" };
        html += "<tr>";
        for (j, cell) in row.iter().enumerate() {
            let class = if j < names { "" } else { " class=\"number\"" };
            // A narrow page shows every cell with its heading, one below the other.
            let heading = rows[0].get(j).map_or("", String::as_str);
            let (heading, cell) = (escaped(heading), escaped(cell));
            html += &format!("<{tag}{class} data-heading=\"{heading}\">{cell}</{tag}>");
        }
        html += "</tr>\n";
    }
    html + "</table></div>\n"
}

/// Path, value, default and meaning of every key; only path and value if this version does not know the config.
fn settings(config: &Value) -> Vec<[String; 4]> {
    fn flatten(path: &str, value: &Value, rows: &mut Vec<[String; 4]>) {
        match value.as_object() {
            Some(members) => members.iter().for_each(|(key, member)| {
                let path = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
                flatten(&path, member, rows);
            }),
            None => rows.push([path.into(), value.to_string(), String::new(), String::new()]),
        }
    }
    let Ok(known) = serde_json::from_value::<Config>(config.clone()) else {
        let mut rows = Vec::new();
        flatten("", config, &mut rows);
        return rows;
    };
    let row = |Setting { path, value, default, meaning, .. }: Setting| {
        [path.into(), value.to_string(), default.to_string(), meaning.replace('`', "")]
    };
    known.settings().into_iter().map(row).collect()
}

/// Every key of one config. For several configs: the keys in which they differ, then every key of the first.
fn config_tables(configs: &[(&str, &Value)]) -> String {
    let all: Vec<Vec<[String; 4]>> = configs.iter().map(|(_, config)| settings(config)).collect();
    let (name, keys) = (escaped(configs[0].0), keys(&all[0]));
    if let [_] = configs {
        return keys;
    }
    let rows = differences(configs, &all);
    let differ = match rows.len() {
        1 => "<p>All are the same.</p>\n".into(),
        _ => format!("<p>Where they differ:</p>\n{}", table(&rows, 1)),
    };
    format!("{differ}<details>\n<summary>Every key of {name}</summary>\n{keys}</details>\n")
}

fn differences(configs: &[(&str, &Value)], all: &[Vec<[String; 4]>]) -> Vec<Vec<String>> {
    let heading = std::iter::once("").chain(configs.iter().map(|(name, _)| *name));
    let mut rows = vec![heading.map(String::from).collect::<Vec<_>>()];
    let mut seen = std::collections::BTreeSet::new();
    for [key, ..] in all.iter().flatten().filter(|[key, ..]| seen.insert(key)) {
        let value = |rows: &Vec<[String; 4]>| {
            let own = rows.iter().find(|[own, ..]| own == key);
            own.map_or_else(|| "–".into(), |[_, value, ..]| value.clone())
        };
        let values: Vec<String> = all.iter().map(value).collect();
        if values.iter().any(|value| *value != values[0]) {
            rows.push([vec![key.clone()], values].concat());
        }
    }
    rows
}

fn keys(settings: &[[String; 4]]) -> String {
    let mut html = String::from(
        "<p class=\"note\">Bold: what is not the default.</p>\n<div class=\"scroll\"><table class=\"keys\">\n\
         <tr><th>key</th><th>value</th><th>default</th><th>meaning</th></tr>\n",
    );
    for [key, value, default, meaning] in settings {
        let class = if value == default { "" } else { " class=\"set\"" };
        let cells = [value, default, meaning].map(|cell| format!("<td>{}</td>", escaped(cell))).concat();
        html += &format!("<tr{class}><td><code>{}</code></td>{cells}</tr>\n", escaped(key));
    }
    html + "</table></div>\n"
}

fn config_file(title: &str, config: &Value) -> String {
    let (title, text) = (escaped(title), format!("{config:#}"));
    let text = text.lines().map(escaped).collect::<Vec<_>>().join("\n");
    format!("<details>\n<summary>{title}</summary>\n<pre>{text}</pre>\n</details>\n")
}

fn assembled(title: &str, subtitle: &str, sections: &str, data: &Value) -> String {
    let rule = |(light, dark): &(&str, &str)| {
        format!(
            "  figure [stroke=\"{light}\"] {{ stroke: {dark}; }} figure [fill=\"{light}\"] {{ fill: {dark}; }}\n"
        )
    };
    let style = filled(STYLE, &[("dark", DARK.iter().map(rule).collect::<String>().trim_end())]);
    // In a script element only `<` can end it or begin a comment; JSON has it in strings alone.
    let data = data.to_string().replace('<', "\\u003c");
    filled(
        PAGE,
        &[
            ("title", &escaped(title)),
            ("subtitle", &escaped(subtitle)),
            ("style", &style),
            ("sections", sections),
            ("version", env!("CARGO_PKG_VERSION")),
            ("data", &data),
            ("script", SCRIPT),
        ],
    )
}

/// A template with its `{{name}}`s replaced, in one pass: what is put in is not looked at again.
fn filled(template: &str, values: &[(&str, &str)]) -> String {
    let mut pieces = template.split("{{");
    let mut text = pieces.next().unwrap_or_default().to_owned();
    for piece in pieces {
        let (name, rest) = piece.split_once("}}").unwrap_or((piece, ""));
        text += values.iter().find(|(known, _)| *known == name).map_or("", |(_, value)| value);
        text += rest;
    }
    text
}
