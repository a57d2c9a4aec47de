//! What a study or a run amounts to: numbers, tables and plots, from files alone.

mod events;
pub mod history;
mod html;
mod panels;
mod plots;
mod portrait;
mod run;
pub mod statistics;
mod study;
mod svg;

use std::fmt::Write;
use std::path::{Path, PathBuf};

use serde_json::Value;

pub use html::page;

use crate::files::read_text_limited;
use crate::study::MANIFEST;
use crate::trainer::Evaluation;

/// Name of the report.
pub const REPORT: &str = "report.json";
/// Name of the table of evaluations.
pub const EVALUATIONS: &str = "evaluations.csv";
/// Name of a page in the folder that it is about.
const PAGE: &str = "report.html";
/// Version of `report.json`.
pub const FORMAT_VERSION: u32 = 1;

/// Largest file that is read, in bytes.
const MAX_FILE_SIZE: u64 = 1 << 30;

/// A finished report.
#[derive(Clone, Debug)]
pub struct Report {
    /// For people.
    pub text: String,
    /// `report.json`.
    pub json: Value,
    /// The other files: name and content.
    pub files: Vec<(&'static str, String)>,
}

/// Why there is no report.
#[derive(Debug, thiserror::Error)]
#[error("{}: {problem}", path.display())]
pub struct ReportError {
    path: PathBuf,
    problem: String,
}

impl ReportError {
    fn new(path: &Path, problem: impl ToString) -> Self {
        Self { path: path.into(), problem: problem.to_string() }
    }

    fn neither(folder: &Path) -> Self {
        Self::new(folder, format!("is no study (no {MANIFEST}) and no run (no {})", events::METRICS))
    }
}

impl Report {
    /// The report of a study's or a run's folder.
    ///
    /// # Errors
    /// When it is neither, nothing has been finished in it, or a file in it is damaged.
    pub fn of(folder: &Path) -> Result<Self, ReportError> {
        if folder.join(MANIFEST).is_file() {
            study::report(folder)
        } else if folder.join(events::METRICS).is_file() {
            run::report(folder)
        } else {
            Err(ReportError::neither(folder))
        }
    }
}

/// Whether a file in a folder is of a report.
pub fn is_part(name: &std::ffi::OsStr) -> bool {
    [REPORT, EVALUATIONS, PAGE].into_iter().chain(plots::NAMES).any(|part| name == part)
}

fn read(path: &Path) -> Result<String, ReportError> {
    read_text_limited(path, MAX_FILE_SIZE).map_err(|error| ReportError::new(path, error))
}

fn parse<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T, ReportError> {
    serde_json::from_str(&read(path)?).map_err(|error| ReportError::new(path, error))
}

/// `evaluations.csv`: one row per evaluation.
fn csv<'a>(runs: impl Iterator<Item = (&'a str, u64, &'a [Evaluation])>) -> String {
    let mut text = String::from("config,seed,env_steps,mean_return\n");
    for (config, seed, evaluations) in runs {
        let config = quoted(config);
        for Evaluation { env_steps, mean } in evaluations {
            // Writing to a string cannot fail.
            let _ = writeln!(text, "{config},{seed},{env_steps},{mean}");
        }
    }
    text
}

/// A field of CSV (RFC 4180).
fn quoted(field: &str) -> String {
    if field.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", field.replace('"', "\"\""))
    } else {
        field.to_owned()
    }
}

/// Rows with their columns below each other; the first column to the left, the others to the right.
fn table(rows: &[Vec<String>]) -> String {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let widths: Vec<usize> = (0..columns)
        .map(|i| rows.iter().filter_map(|row| row.get(i)).map(|cell| cell.chars().count()).max().unwrap_or(0))
        .collect();
    let mut text = String::new();
    for row in rows {
        for (i, (cell, &width)) in row.iter().zip(&widths).enumerate() {
            let _ = if i == 0 { write!(text, "{cell:<width$}") } else { write!(text, "  {cell:>width$}") };
        }
        text.truncate(text.trim_end().len());
        text.push('\n');
    }
    text
}
