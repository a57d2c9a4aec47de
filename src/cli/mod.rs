//! The command line: one file per command. Only here is printed, and only here an exit code chosen.

mod check;
mod completions;
mod config;
mod eval;
mod explain;
mod inspect;
mod render;
mod report;
mod resume;
mod run_dir;
mod signals;
mod study;
mod train;
mod verify;
mod watch;

use std::io::{self, Write};
use std::process::ExitCode;

use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{Parser, Subcommand};

use crate::checkpoint::{CheckpointError, Problem};
use crate::config::ConfigError;
use crate::nn::kernels;
use crate::trainer::TrainError;
use crate::view::NoView;

/// Trains Deep Q-Learning agents on CartPole-v1, reproducibly to the last bit.
///
/// Exit codes: 0 done, 1 failed (or below --min-mean), 2 wrong usage or bad input, 130 or 143 stopped by a signal.
#[derive(Debug, Parser)]
#[command(version, about, max_term_width = 100)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Train(train::Arguments),
    Eval(eval::Arguments),
    Inspect(inspect::Arguments),
    Watch(watch::Arguments),
    Render(render::Arguments),
    Study(study::Arguments),
    Report(report::Arguments),
    Verify(verify::Arguments),
    Check(check::Arguments),
    Explain(explain::Arguments),
    Config(config::Arguments),
    Completions(completions::Arguments),
}

/// Why a command ended without success.
#[derive(Debug)]
enum Failure {
    /// Something the user gave cannot be used: exit code 2.
    BadInput(String),
    /// It was tried and failed: exit code 1.
    Failed(String),
    /// A signal stopped it: that signal's exit code.
    Interrupted(String, u8),
}

impl From<ConfigError> for Failure {
    fn from(error: ConfigError) -> Self {
        let hint = match error {
            ConfigError::Read { .. } | ConfigError::Json { .. } => {
                "; --config takes a JSON file such as configs/cartpole.json"
            }
            _ => "",
        };
        Self::BadInput(format!("{error}{hint}"))
    }
}

impl From<CheckpointError> for Failure {
    fn from(error: CheckpointError) -> Self {
        let hint = match error.problem {
            Problem::Unreadable(_) | Problem::NotSafetensors(_) => {
                "; --checkpoint takes a .safetensors file or a run's folder"
            }
            _ => "",
        };
        Self::BadInput(format!("{error}{hint}"))
    }
}

impl From<TrainError> for Failure {
    fn from(error: TrainError) -> Self {
        Self::Failed(error.to_string())
    }
}

impl From<NoView> for Failure {
    fn from(error: NoView) -> Self {
        match error {
            NoView::Terminal(_) => Self::Failed(error.to_string()),
            NoView::NoTerminal | NoView::TooSmall(_) => Self::BadInput(error.to_string()),
        }
    }
}

/// Runs the command that the process was started with.
pub fn run() -> ExitCode {
    let command = Arguments::try_parse().unwrap_or_else(|error| with_tip(error).exit()).command;
    let path = kernels::Path::from_environment().map_err(|error| Failure::BadInput(error.to_string()));
    let result = path.and_then(|_| match command {
        Command::Train(arguments) => train::run(arguments),
        Command::Eval(arguments) => eval::run(arguments),
        Command::Inspect(arguments) => inspect::run(&arguments),
        Command::Watch(arguments) => watch::run(&arguments),
        Command::Render(arguments) => render::run(&arguments),
        Command::Study(arguments) => study::run(&arguments),
        Command::Report(arguments) => report::run(&arguments),
        Command::Verify(arguments) => verify::run(&arguments),
        Command::Check(arguments) => check::run(&arguments),
        Command::Explain(arguments) => explain::run(&arguments),
        Command::Config(arguments) => config::run(arguments),
        Command::Completions(arguments) => completions::run(&arguments),
    });
    let Err(failure) = result else { return ExitCode::SUCCESS };
    let (message, exit_code) = match failure {
        Failure::BadInput(message) => (format!("error: {message}"), 2),
        Failure::Failed(message) => (format!("error: {message}"), 1),
        Failure::Interrupted(message, exit_code) => (message, exit_code),
    };
    // A closed stderr leaves nobody to tell.
    let _ = writeln!(io::stderr(), "{message}");
    ExitCode::from(exit_code)
}

/// An error of usage, with what the user may have meant where clap finds nothing.
fn with_tip(mut error: clap::Error) -> clap::Error {
    let takes_config =
        std::env::args().nth(1).is_some_and(|command| command == "train" || command == "study");
    let is_unknown = error.kind() == ErrorKind::UnknownArgument;
    if takes_config && is_unknown && error.get(ContextKind::SuggestedArg).is_none() {
        let tip = "a config file is given as --config FILE, a key of the config as --set KEY=VALUE";
        error.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![tip.into()]));
    }
    error
}

/// Parses a seed.
fn seed(text: &str) -> Result<u64, String> {
    text.parse().map_err(|_| format!("expected an integer from 0 to {}", u64::MAX))
}

/// Says on stderr what the user should know though nothing has failed.
fn note(text: &str) {
    let _ = writeln!(io::stderr(), "note: {text}");
}

/// Prints to stdout. A reader that has gone away (`| head`) is no failure.
fn print(text: &str) -> Result<(), Failure> {
    let mut stdout = io::stdout().lock();
    match stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()) {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => {
            Err(Failure::Failed(format!("cannot write to standard output: {error}")))
        }
        _ => Ok(()),
    }
}

/// Prints one JSON value alone on stdout.
fn print_json(value: &impl serde::Serialize) -> Result<(), Failure> {
    let text = serde_json::to_string(value).map_err(|error| Failure::Failed(error.to_string()))?;
    print(&(text + "\n"))
}
