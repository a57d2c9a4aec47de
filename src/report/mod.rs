//! What a study or a run amounts to: numbers, tables and plots, from files alone.

mod comparison;
mod failures;
pub mod history;
mod html;
mod outcome;
mod panels;
mod plots;
mod portrait;
mod run;
pub mod statistics;
mod study;
mod summary;
mod svg;
mod text;

use std::io::{self, Write};
use std::path::Path;

pub(crate) use html::{is_page, page};
pub(crate) use study::describe_last_tries;
pub use study::standing;

use crate::files::read_text_limited;
use crate::run::names::{MANIFEST, METRICS};
use crate::study::StudyError;
use crate::trainer::Evaluation;

/// How every `report.json` begins, whatever its version.
const JSON_START: &str = "{\n  \"format_version\": ";
const CSV_START: &str = "config,seed,env_steps,mean_return\n";
pub const FORMAT_VERSION: u32 = 1;

const MAX_FILE_SIZE: u64 = 1 << 30;

/// Writes the content of a file: the table of a large study would fill the memory.
pub(crate) type Content = Box<dyn Fn(&mut dyn Write) -> io::Result<()>>;

pub struct Report {
    pub(crate) text: String,
    pub(crate) json: serde_json::Value,
    pub(crate) files: Vec<(&'static str, Content)>,
    /// Notes on the lines that it ignores.
    pub(crate) notes: Vec<String>,
}

#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct ReportError(String);

impl ReportError {
    fn new(path: &Path, problem: impl ToString) -> Self {
        Self(format!("{}: {}", crate::text::visible(&path.to_string_lossy()), problem.to_string()))
    }

    fn unreadable(path: &Path, error: &io::Error) -> Self {
        Self::new(path, format!("cannot be read: {error}"))
    }
}

/// Whether a directory holds a study; otherwise it holds a run.
fn is_study(directory: &Path) -> Result<bool, ReportError> {
    let found = directory.metadata().map_err(|error| match error.kind() {
        io::ErrorKind::NotFound => {
            ReportError::new(directory, "there is no such directory; give that of a study or of a run")
        }
        _ => ReportError::unreadable(directory, &error),
    })?;
    if !found.is_dir() {
        return Err(ReportError::new(directory, "is a file; give the directory of a study or of a run"));
    }
    for (name, is_study) in [(MANIFEST, true), (METRICS, false)] {
        let path = directory.join(name);
        if path.try_exists().map_err(|error| ReportError::unreadable(&path, &error))? {
            return Ok(is_study);
        }
    }
    let problem = format!("is neither a study (it has no {MANIFEST}) nor a run (it has no {METRICS})");
    Err(ReportError::new(directory, problem))
}

impl Report {
    pub fn of(directory: &Path) -> Result<Self, ReportError> {
        if is_study(directory)? { study::report(directory) } else { run::report(directory) }
    }
}

/// Whether a file with this beginning may be a file of a report other than its page.
pub(crate) fn is_own(start: &[u8]) -> bool {
    [JSON_START, CSV_START, svg::START].iter().any(|own| start.starts_with(own.as_bytes()))
}

fn parse<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T, ReportError> {
    let text = read_text_limited(path, MAX_FILE_SIZE).map_err(|error| ReportError::new(path, error))?;
    serde_json::from_str(&text).map_err(|error| ReportError::new(path, error))
}

/// `evaluations.csv`: one row per evaluation.
fn csv<'a>(
    file: &mut dyn Write, runs: impl Iterator<Item = (&'a str, u64, Vec<Evaluation>)>,
) -> io::Result<()> {
    write!(file, "{CSV_START}")?;
    for (config, seed, evaluations) in runs {
        let config = quoted(config);
        for Evaluation { env_steps, mean } in evaluations {
            writeln!(file, "{config},{seed},{env_steps},{mean}")?;
        }
    }
    Ok(())
}

fn whole(text: String) -> Content {
    Box::new(move |file| file.write_all(text.as_bytes()))
}

impl From<StudyError> for ReportError {
    fn from(error: StudyError) -> Self {
        Self(error.to_string())
    }
}

/// A field of CSV (RFC 4180).
fn quoted(field: &str) -> String {
    let is_plain = !field.contains([',', '"', '\n', '\r']);
    if is_plain { field.to_owned() } else { format!("\"{}\"", field.replace('"', "\"\"")) }
}
