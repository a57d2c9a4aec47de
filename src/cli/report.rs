//! `cartpole-dqn report`

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use clap::Args;

use super::run_dir::cannot_write;
use super::{Failure, print, print_json};
use crate::files::{begins_with, write_json, write_whole};
use crate::report::{self, REPORT, Report, ReportError};

/// Say what a study or a run amounts to.
///
/// Prints a table and writes report.json, evaluations.csv and plots (SVG); with --html one page with everything instead.
#[derive(Debug, Args)]
#[command(after_help = "Example: cartpole-dqn report studies/gamma
         cartpole-dqn report runs/one runs/other --html runs.html")]
pub(super) struct Arguments {
    /// Folder of a study or of a run; with --html several runs are compared
    #[arg(value_name = "DIR", required = true)]
    folders: Vec<PathBuf>,
    /// Write one HTML file that needs no other and no network, and nothing else
    #[arg(long, value_name = "FILE", conflicts_with_all = ["out", "json"])]
    html: Option<PathBuf>,
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
    if let Some(file) = &arguments.html {
        return write_page(file, &arguments.folders);
    }
    let [folder] = &arguments.folders[..] else {
        return Err(Failure::BadInput("several folders need --html FILE; without it give one".into()));
    };
    let report = Report::of(folder)?;
    let out = arguments.out.as_ref().unwrap_or(folder);
    fs::create_dir_all(out).map_err(|error| cannot_write(out, &error, ""))?;
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
        let is_written =
            |(path, result): &(PathBuf, io::Result<()>)| result.is_ok().then(|| path.display().to_string());
        let names: Vec<String> = written.iter().filter_map(is_written).collect();
        let names = if names.is_empty() { "nothing".into() } else { names.join(", ") };
        print(&format!("{}\nwritten: {names}\n", report.text))?;
    }
    for (path, result) in written {
        result.map_err(|error| cannot_write(&path, &error, ""))?;
    }
    Ok(())
}

fn write_page(file: &Path, folders: &[PathBuf]) -> Result<(), Failure> {
    let bad = |problem: &str| Failure::BadInput(format!("cannot write --html {}: {problem}", file.display()));
    if file.is_dir() {
        return Err(bad("it is a folder; give a file"));
    }
    if file.is_file() && !begins_with(file, b"<!DOCTYPE html>") {
        return Err(bad("the file that is there is no page; choose another"));
    }
    let page = report::page(folders)?;
    write_whole(file, |file| file.write_all(page.as_bytes()))
        .map_err(|error| cannot_write(file, &error, ""))?;
    print(&format!("written: {}\n", file.display()))
}
