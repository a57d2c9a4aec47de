//! `cartpole-dqn report`

use std::fs;
use std::path::PathBuf;

use clap::Args;

use super::{Failure, print, print_json};
use crate::files::{write_json, write_whole};
use crate::report::{REPORT, Report, ReportError};

/// Say what a study or a run amounts to.
///
/// Prints a table and writes report.json, evaluations.csv and plots (SVG).
#[derive(Debug, Args)]
#[command(after_help = "Example: cartpole-dqn report studies/gamma")]
pub(super) struct Arguments {
    /// Folder of a study or of a run
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// Folder for the files [default: DIR itself]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print report.json, alone on standard output
    #[arg(long)]
    json: bool,
}

impl From<ReportError> for Failure {
    fn from(error: ReportError) -> Self {
        Self::BadInput(error.to_string())
    }
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let report = Report::of(&arguments.folder)?;
    let out = arguments.out.as_ref().unwrap_or(&arguments.folder);
    fs::create_dir_all(out)
        .map_err(|error| Failure::BadInput(format!("folder {} cannot be made: {error}", out.display())))?;
    let json = out.join(REPORT);
    let mut written = vec![(json.clone(), write_json(&json, &report.json))];
    for (name, content) in &report.files {
        let path = out.join(name);
        let result = write_whole(&path, |file| file.write_all(content.as_bytes()));
        written.push((path, result));
    }
    // The report is also printed when it cannot be saved.
    if arguments.json {
        print_json(&report.json)?;
    } else {
        let names: Vec<String> = written.iter().map(|(path, _)| path.display().to_string()).collect();
        print(&format!("{}\nwritten: {}\n", report.text, names.join(", ")))?;
    }
    for (path, result) in written {
        result.map_err(|error| Failure::Failed(format!("cannot write {}: {error}", path.display())))?;
    }
    Ok(())
}
