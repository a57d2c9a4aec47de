//! The command line: one file per command. Only here is printed, and only here an exit code chosen.

mod check;
mod completions;
mod config;
mod eval;
mod explain;
mod flags;
mod init;
mod inspect;
mod output;
mod policy;
mod render;
mod report;
mod resume;
mod run_dir;
mod runs;
mod signals;
mod study;
mod train;
mod verify;
mod watch;

use std::io::{self, Write};
use std::path::Path;
use std::process::ExitCode;

use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{Parser, Subcommand};

use crate::checkpoint::{CheckpointError, Problem};
use crate::config::ConfigError;
use crate::nn::kernels;
use crate::text::steers;
use crate::trainer::TrainError;
use crate::view::NoView;

/// Trains Deep Q-Learning agents on CartPole-v1, reproducibly to the last bit.
///
/// Exit codes: 0 done; 1 tried and failed, or below --min-mean; 2 wrong usage or bad input; 130 or 143 stopped by a signal.
#[derive(Debug, Parser)]
#[command(version, about, max_term_width = 80)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Train(train::Arguments),
    Eval(eval::Arguments),
    Inspect(inspect::Arguments),
    Runs(runs::Arguments),
    Watch(watch::Arguments),
    Render(render::Arguments),
    Study(study::Arguments),
    Report(report::Arguments),
    Verify(verify::Arguments),
    Check(check::Arguments),
    Explain(explain::Arguments),
    Config(config::Arguments),
    Completions(completions::Arguments),
    // A name that no slip of the keyboard is similar to, so that it is never suggested.
    #[command(name = "__words", hide = true)]
    CompleteWords(completions::Words),
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

impl Failure {
    /// A file that cannot be written. The same cause has the same exit code in every command: a place that can never be
    /// written is bad input, a disk that fails or is full is a failure.
    fn unwritten(message: String, error: &io::Error) -> Self {
        use io::ErrorKind as Kind;
        match error.kind() {
            Kind::PermissionDenied
            | Kind::ReadOnlyFilesystem
            | Kind::NotFound
            | Kind::NotADirectory
            | Kind::IsADirectory
            | Kind::AlreadyExists
            | Kind::InvalidFilename
            | Kind::InvalidInput => Self::BadInput(message),
            _ => Self::Failed(message),
        }
    }
}

impl From<ConfigError> for Failure {
    fn from(error: ConfigError) -> Self {
        let hint = match error {
            ConfigError::Read { .. } | ConfigError::Json { .. } => {
                "; --config takes a JSON file such as configs/cartpole.json"
            }
            _ => "",
        };
        Self::BadInput(on_one_line(&error) + hint)
    }
}

impl From<CheckpointError> for Failure {
    fn from(error: CheckpointError) -> Self {
        let hint = match error.problem {
            Problem::Unreadable(_) | Problem::NotSafetensors(_) => {
                "; give a .safetensors file or the directory of a run"
            }
            _ => "",
        };
        Self::BadInput(on_one_line(&error) + hint)
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
            NoView::NoTerminal | NoView::Dumb | NoView::TooSmall(_) => Self::BadInput(error.to_string()),
        }
    }
}

/// Runs the command that the process was started with.
pub fn run() -> ExitCode {
    let result = match Arguments::try_parse() {
        Ok(arguments) => execute(arguments.command),
        Err(error) => match explain(&error) {
            Some(message) => Err(Failure::BadInput(message)),
            None => return print_usage(with_tip(error)),
        },
    };
    let Err(failure) = result else { return ExitCode::SUCCESS };
    let (message, exit_code) = match failure {
        Failure::BadInput(message) => (format!("error: {message}"), 2),
        Failure::Failed(message) => (format!("error: {message}"), 1),
        Failure::Interrupted(message, exit_code) => (message, exit_code),
    };
    say(&message);
    ExitCode::from(exit_code)
}

fn execute(command: Command) -> Result<(), Failure> {
    kernels::Path::from_environment().map_err(|error| Failure::BadInput(error.to_string()))?;
    signals::watch()?;
    match command {
        Command::Train(arguments) => train::run(arguments),
        Command::Eval(arguments) => eval::run(arguments),
        Command::Inspect(arguments) => inspect::run(&arguments),
        Command::Runs(arguments) => runs::run(&arguments),
        Command::Watch(arguments) => watch::run(&arguments),
        Command::Render(arguments) => render::run(&arguments),
        Command::Study(arguments) => study::run(&arguments),
        Command::Report(arguments) => report::run(&arguments),
        Command::Verify(arguments) => verify::run(&arguments),
        Command::Check(arguments) => check::run(&arguments),
        Command::Explain(arguments) => explain::run(&arguments),
        Command::Config(arguments) => config::run(arguments),
        Command::Completions(arguments) => completions::run(&arguments),
        Command::CompleteWords(arguments) => completions::run_words(&arguments),
    }
}

/// What is wrong with the command line, where this program knows more about it than clap.
fn explain(error: &clap::Error) -> Option<String> {
    let not_utf8 = || std::env::args_os().find(|argument| argument.to_str().is_none());
    if error.kind() == ErrorKind::InvalidUtf8
        && let Some(argument) = not_utf8()
    {
        return Some(format!("the argument {argument:?} is not valid UTF-8; only paths may be so"));
    }
    let arguments = std::env::args_os().skip(1).map(|argument| argument.to_string_lossy().into_owned());
    flags::key_for_option(error, &arguments.collect::<Vec<_>>())
}

/// An error of usage, with what the user may have meant where clap finds nothing.
fn with_tip(mut error: clap::Error) -> clap::Error {
    let takes_config =
        std::env::args_os().nth(1).is_some_and(|command| command == "train" || command == "study");
    let is_unknown = error.kind() == ErrorKind::UnknownArgument;
    if takes_config && is_unknown && error.get(ContextKind::SuggestedArg).is_none() {
        let is_directory = match error.get(ContextKind::InvalidArg) {
            Some(ContextValue::String(argument)) => Path::new(argument).is_dir(),
            _ => false,
        };
        let tip = if is_directory {
            "a new run or study is written to --out DIR; `train --resume DIR` resumes a run"
        } else {
            "a config file is given as --config FILE, a key of the config as --set KEY=VALUE"
        };
        error.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![tip.into()]));
    }
    error
}

/// Prints clap's message, which may be the help.
fn print_usage(mut error: clap::Error) -> ExitCode {
    // Clap would leave control characters of an argument out, or print them as they are.
    let typed = error.context().filter_map(|(kind, value)| match value {
        ContextValue::String(text) => Some((kind, ContextValue::String(escaped(text)))),
        _ => None,
    });
    for (kind, text) in typed.collect::<Vec<_>>() {
        error.insert(kind, text);
    }
    let is_strange = |argument: std::ffi::OsString| {
        let argument = argument.to_string_lossy();
        escaped(&argument) != argument
    };
    if error.use_stderr() && std::env::args_os().any(is_strange) {
        // Plain, as the escape sequences that colour the message cannot be told from those in an argument.
        say(error.render().to_string().trim_end());
    } else {
        // A closed stderr or stdout leaves nobody to tell.
        let _ = error.print();
    }
    u8::try_from(error.exit_code()).map_or(ExitCode::FAILURE, ExitCode::from)
}

/// A text with its control characters, line breaks and tabs apart, written as in JSON: what stands in the name of somebody's
/// file must not move the cursor or change the terminal.
fn escaped(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '\n' | '\t' => escaped.push(character),
            // All of them are below U+10000.
            control if steers(control) => escaped += &format!("\\u{:04x}", u32::from(control)),
            character => escaped.push(character),
        }
    }
    escaped
}

/// This program, as it was called.
fn program() -> String {
    let program = std::env::args_os().next().unwrap_or_else(|| "cartpole-dqn".into());
    shell_word(&program.to_string_lossy())
}

/// A word as it can be typed into a shell.
fn shell_word(word: &str) -> String {
    let is_plain = |c: char| c.is_alphanumeric() || "/\\:._-+=,".contains(c);
    let is_word = !word.is_empty() && word.chars().all(is_plain);
    if is_word { word.to_owned() } else { format!("'{}'", word.replace('\'', "'\\''")) }
}

/// Parses an integer from `LOW` to `HIGH`.
fn integer<const LOW: u64, const HIGH: u64>(text: &str) -> Result<u64, String> {
    let number = text.parse().ok().filter(|number| (LOW..=HIGH).contains(number));
    number.ok_or_else(|| format!("expected an integer from {LOW} to {HIGH}, in digits alone"))
}

/// Parses a seed.
fn seed(text: &str) -> Result<u64, String> {
    integer::<0, { u64::MAX }>(text)
}

/// A message about one file, in whose name a line break must not begin a line.
fn on_one_line(error: &impl std::fmt::Display) -> String {
    error.to_string().replace('\n', "\\n")
}

/// Says on stderr what the user should know though nothing has failed.
fn note(text: &str) {
    say(&format!("note: {text}"));
}

/// Prints a line to stderr; a closed stderr leaves nobody to tell.
fn say(text: &str) {
    let _ = writeln!(io::stderr(), "{}", escaped(text));
}

/// Prints to stdout. A reader that has gone away (`| head`) is no failure. JSON stays JSON: see [`escaped`].
fn print(text: &str) -> Result<(), Failure> {
    let mut stdout = io::stdout().lock();
    match stdout.write_all(escaped(text).as_bytes()).and_then(|()| stdout.flush()) {
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
