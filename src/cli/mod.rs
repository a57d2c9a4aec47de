//! The command line: one file per command. Only here is printed, and only here an exit code chosen.

mod check;
mod completions;
mod config;
mod eval;
mod explain;
mod find;
mod flags;
mod inspect;
mod layers;
mod output;
mod permission;
mod plan;
mod policy;
mod render;
mod report;
mod runs;
mod signals;
mod study;
mod train;
mod ui;
mod variations;
mod verify;
mod watch;
#[cfg(feature = "web")]
mod web;

use std::process::ExitCode;

use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{CommandFactory, Parser, Subcommand};

use crate::config::OTHER_ENVIRONMENTS;
use crate::nn::kernels;
use ui::{Failure, escaped, say};

/// Trains Deep Q-Learning agents on CartPole-v1 and other tasks, reproducibly to the last bit.
///
/// Exit codes: 0 done; 1 tried and failed, or below --min-mean; 2 wrong usage or bad input; 130 or 143 stopped by a signal.
#[derive(Debug, Parser)]
#[command(version, about, max_term_width = 80)]
struct CommandLine {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Train(train::TrainArguments),
    Eval(eval::EvalArguments),
    Inspect(inspect::InspectArguments),
    Runs(runs::Arguments),
    Watch(watch::WatchArguments),
    Render(render::RenderArguments),
    Study(study::StudyArguments),
    Report(report::ReportArguments),
    Verify(verify::VerifyArguments),
    Check(check::CheckArguments),
    Explain(explain::ExplainArguments),
    Config(config::ConfigArguments),
    #[cfg(feature = "web")]
    Web(web::WebArguments),
    Completions(completions::CompletionsArguments),
    // A name that no slip of the keyboard is similar to, so that it is never suggested.
    #[command(name = "__words", hide = true)]
    CompleteWords(completions::Words),
}

/// All commands with their options, for a program that documents them.
pub fn command() -> clap::Command {
    CommandLine::command()
}

pub fn run() -> ExitCode {
    let typed: Vec<_> = std::env::args_os().skip(1).map(|word| word.to_string_lossy().into_owned()).collect();
    let result = match CommandLine::try_parse() {
        Ok(arguments) => execute(arguments.command),
        Err(error) => match what_is_wrong(&error, &typed) {
            Some(message) => Err(Failure::BadInput(message)),
            None => return print_usage(with_tip(error, &typed)),
        },
    };
    let Err(failure) = result else { return ExitCode::SUCCESS };
    let (message, exit_code) = match failure {
        Failure::BadInput(message) => (format!("error: {message}"), 2),
        Failure::Failed(message) => (format!("error: {message}"), 1),
        Failure::Disturbed(message) => match signals::asked() {
            Some(exit_code) => (format!("stopped: {message}"), exit_code),
            None => (format!("error: {message}"), 1),
        },
        Failure::Interrupted(message, exit_code) => (message, exit_code),
    };
    say(&message);
    ExitCode::from(exit_code)
}

fn execute(command: Command) -> Result<(), Failure> {
    kernels::InstructionSet::from_environment().map_err(|error| Failure::BadInput(error.to_string()))?;
    signals::watch()
        .map_err(|error| Failure::Failed(format!("cannot listen to signals such as Ctrl-C: {error}")))?;
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
        #[cfg(feature = "web")]
        Command::Web(arguments) => web::run(&arguments),
        Command::Completions(arguments) => completions::run(&arguments, CommandLine::command()),
        Command::CompleteWords(arguments) => completions::run_words(&arguments, CommandLine::command()),
    }
}

/// What is wrong with the command line, where this program knows more about it than clap.
fn what_is_wrong(error: &clap::Error, arguments: &[String]) -> Option<String> {
    if error.kind() == ErrorKind::InvalidUtf8 {
        let argument = std::env::args_os().find(|argument| argument.to_str().is_none())?;
        return Some(format!("the argument {argument:?} is not valid UTF-8; only paths may be so"));
    }
    flags::key_for_option(error, &CommandLine::command(), arguments)
}

/// An error of usage, with what the user may have meant where clap finds nothing.
fn with_tip(mut error: clap::Error, arguments: &[String]) -> clap::Error {
    let root = CommandLine::command();
    let (_, command) = flags::command_of(&root, arguments);
    let is_unknown = error.kind() == ErrorKind::UnknownArgument;
    if flags::has_option(command, "set") && is_unknown && error.get(ContextKind::SuggestedArg).is_none() {
        let is_directory = matches!(error.get(ContextKind::InvalidArg),
            Some(ContextValue::String(argument)) if std::path::Path::new(argument).is_dir());
        let tip = match is_directory && flags::has_option(command, "resume") {
            true => "a new run is written to --out DIR; `train --resume DIR` resumes a run",
            false => "a config is given as --config NAME or --config FILE, a key of it as --set KEY=VALUE",
        };
        error.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![tip.into()]));
    }
    if matches!(error.get(ContextKind::InvalidArg), Some(ContextValue::String(option)) if option.starts_with("--environment"))
    {
        error.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![OTHER_ENVIRONMENTS.into()]));
    }
    error
}

/// Bytes of an argument that is not repeated whole in a message.
const LONG: usize = 1000;

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
        escaped(&argument) != argument || argument.len() > LONG
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
