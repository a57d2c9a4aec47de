//! `cartpole-dqn report`

use std::path::{Path, PathBuf};

use super::output::Output;
use super::ui::{Failure, cannot_write, note, on_one_line, print, print_json};
use crate::report::{self, Report, ReportError};
use crate::run::names::REPORT;
use crate::text::{shown, wrapped};

/// Summarise a study or a run: what happened, and how good the result is.
///
/// Prints tables and writes report.json, evaluations.csv and plots (SVG); with --html one page with everything instead.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: cartpole-dqn report studies/gamma
         cartpole-dqn report runs/one runs/other --html runs.html")]
pub(super) struct ReportArguments {
    /// Directory of a study or of a run; with --html several runs are compared
    #[arg(value_name = "DIR", required = true)]
    directories: Vec<PathBuf>,
    /// Write one HTML file instead, which needs no other file and no network; - is standard output
    #[arg(long, value_name = "FILE", conflicts_with_all = ["out", "json"])]
    html: Option<PathBuf>,
    /// Directory for the files [default: DIR itself]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print report.json, and nothing else, on standard output
    #[arg(long)]
    json: bool,
}

impl From<ReportError> for Failure {
    fn from(error: ReportError) -> Self {
        Self::BadInput(on_one_line(&error))
    }
}

pub(super) fn run(arguments: &ReportArguments) -> Result<(), Failure> {
    if let Some(file) = &arguments.html {
        return write_page(file, &arguments.directories);
    }
    let [studied] = &arguments.directories[..] else {
        return Err(Failure::BadInput("several directories need --html FILE; without it give one".into()));
    };
    let report = Report::of(studied)?;
    report.notes.iter().for_each(|text| note(text));
    let out = arguments.out.as_ref().unwrap_or(studied);
    let names: Vec<&str> = [REPORT].into_iter().chain(report.files.iter().map(|(name, _)| *name)).collect();
    for name in &names {
        let path = &out.join(name);
        Output { option: "--out", path, what: "of a report", is_own: report::is_own }.check()?;
        // A pipe that nobody reads would never be written.
        if path.symlink_metadata().is_ok_and(|found| !found.is_file()) {
            let problem = format!("{} is a link or not an ordinary file; remove it", shown(path));
            return Err(Failure::BadInput(problem));
        }
    }
    // The report is also printed when it cannot be saved.
    let printed = if arguments.json { print_json(&report.json) } else { print(&report.text) };
    printed?;
    let hint = "; choose another --out";
    let directory = crate::files::create_directories(out).and_then(|_| crate::files::Directory::open(out));
    let directory = directory.map_err(|error| cannot_write(out, &error, hint))?;
    let json = out.join(REPORT);
    directory.write_json(&json, &report.json).map_err(|error| cannot_write(&json, &error, hint))?;
    for (name, content) in &report.files {
        let path = out.join(name);
        directory.write_whole(&path, None, content).map_err(|error| cannot_write(&path, &error, hint))?;
    }
    if arguments.json {
        return Ok(());
    }
    print(&format!("\n{}", wrapped(&format!("written to {}: {}", shown(out), names.join(", ")), 2)))
}

fn write_page(file: &Path, directories: &[PathBuf]) -> Result<(), Failure> {
    let (what, is_own) = ("a page of `report`", report::is_page);
    let output = Output { option: "--html", path: file, what, is_own };
    output.check()?;
    if let Some(parent) = file.parent().filter(|parent| !parent.as_os_str().is_empty() && !parent.is_dir()) {
        return Err(Failure::BadInput(output.message(&format!("there is no directory {}", shown(parent)))));
    }
    let page = report::page(directories)?;
    output.write(|file| file.write_all(page.as_bytes()))?;
    if output.is_standard() { Ok(()) } else { print(&format!("written: {}\n", shown(file))) }
}
