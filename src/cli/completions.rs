//! `cartpole-dqn completions`
//!
//! The scripts for bash, zsh and fish ask the hidden command `__words` what may follow. It reads the answer off
//! the definitions of the commands, so that the three shells offer the same and nothing is listed twice in the code.

use std::fs;

use clap::builder::PossibleValue;
use clap::{Arg, ArgAction, Args, Command, ValueHint};
use clap_complete::Shell;

use super::ui::{Failure, print};
use crate::config::{self, SHIPPED};

/// Print a script that lets a shell complete commands, options, config keys and paths.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples, each a line for the file that the shell reads when it starts:
  bash, ~/.bashrc:                   source <(cartpole-dqn completions bash)
  zsh,  ~/.zshrc, after `compinit`:  source <(cartpole-dqn completions zsh)
  fish, ~/.config/fish/config.fish:  cartpole-dqn completions fish | source")]
pub(super) struct CompletionsArguments {
    shell: Shell,
}

pub(super) fn run(arguments: &CompletionsArguments, mut root: Command) -> Result<(), Failure> {
    let script = match arguments.shell {
        Shell::Bash => include_str!("completions/cartpole-dqn.bash").into(),
        Shell::Zsh => include_str!("completions/cartpole-dqn.zsh").into(),
        Shell::Fish => include_str!("completions/cartpole-dqn.fish").into(),
        // The others complete commands and options, and no values.
        shell => {
            let mut script = Vec::new();
            clap_complete::generate(shell, &mut root, "cartpole-dqn", &mut script);
            String::from_utf8_lossy(&script).into_owned()
        }
    };
    print(&script)
}

/// Print what may stand in the place of the last word.
#[derive(Debug, Args)]
pub(super) struct Words {
    /// The words after the name of the program, up to the cursor; the last may be empty
    #[arg(last = true)]
    words: Vec<std::ffi::OsString>,
}

/// A line for each candidate: the word, a tab, what it means. `:files` and `:directories` ask the shell, which quotes paths.
pub(super) fn run_words(arguments: &Words, mut root: Command) -> Result<(), Failure> {
    let words: Vec<_> = arguments.words.iter().map(|word| word.to_string_lossy()).collect();
    let words: Vec<&str> = words.iter().map(AsRef::as_ref).collect();
    let Some((word, before)) = words.split_last() else { return Ok(()) };
    root.build();
    let lines = candidates(&root, before, word).into_iter();
    // A line is a candidate: nothing else can be told apart.
    let lines = lines.filter(|(value, _)| !value.contains(char::is_control));
    print(&lines.map(|(value, help)| format!("{value}\t{help}\n")).collect::<String>())
}

type Candidate = (String, String);

fn candidates(root: &Command, before: &[&str], word: &str) -> Vec<Candidate> {
    let (mut command, mut waiting, mut positionals) = (root, None, 0);
    // Behind `--` there are no options.
    let after_options = before.iter().position(|word| *word == "--");
    for (i, &word) in before.iter().enumerate().filter(|(i, _)| Some(*i) != after_options) {
        if waiting.take().is_some() {
            continue;
        }
        if word.len() > 1 && word.starts_with('-') && after_options.is_none_or(|end| i < end) {
            let is_complete = |option: &Arg| !option.get_action().takes_values() || word.contains('=');
            waiting = named(command, word).filter(|option| !is_complete(option));
        } else if let Some(inner) = command.find_subcommand(word) {
            command = inner;
        } else {
            positionals += 1;
        }
    }
    let values_of = |argument: Option<&Arg>, word| argument.map_or_else(Vec::new, |arg| values(arg, word));
    let options = || if after_options.is_some() { Vec::new() } else { options(command, before) };
    let mut all = match word.split_once('=') {
        _ if waiting.is_some() => values_of(waiting, word),
        Some((name, value)) if word.starts_with('-') => {
            let mut values = values_of(named(command, name), value);
            let words = values.iter_mut().map(|(value, _)| value).filter(|value| !is_request(value));
            words.for_each(|value| value.insert_str(0, &format!("{name}=")));
            values
        }
        _ if word.starts_with('-') => options(),
        _ => {
            let commands = command.get_subcommands().filter(|command| !command.is_hide_set());
            let about = |command: &Command| (command.get_name().into(), first_line(command.get_about()));
            // Only the last takes many values.
            let takes_many = |arg: &&Arg| matches!(arg.get_action(), ArgAction::Append);
            let positional = command.get_positionals().nth(positionals);
            let values = values_of(positional.or(command.get_positionals().last().filter(takes_many)), word);
            let all: Vec<Candidate> = commands.map(about).chain(values).collect();
            if all.is_empty() { options() } else { all }
        }
    };
    all.retain(|(value, _)| value.starts_with(word) || is_request(value));
    all
}

fn named<'a>(command: &'a Command, word: &str) -> Option<&'a Arg> {
    let name = word.split('=').next()?;
    command.get_arguments().find(|arg| match name.strip_prefix("--") {
        Some(long) => arg.get_long() == Some(long),
        None => arg.get_short().is_some_and(|short| name.strip_prefix('-') == Some(&short.to_string())),
    })
}

fn options(command: &Command, before: &[&str]) -> Vec<Candidate> {
    let given: Vec<_> = before.iter().filter_map(|word| named(command, word)).collect();
    let is_free = |arg: &&Arg| matches!(arg.get_action(), ArgAction::Append) || !given.contains(arg);
    let options = command.get_arguments().filter(|arg| !arg.is_hide_set()).filter(is_free);
    options.filter_map(|arg| Some((format!("--{}", arg.get_long()?), first_line(arg.get_help())))).collect()
}

/// What may be the value of an argument and begins with `word`.
fn values(arg: &Arg, word: &str) -> Vec<Candidate> {
    let possible = arg.get_possible_values();
    if !possible.is_empty() {
        let is_shown = |value: &&PossibleValue| !value.is_hide_set();
        let candidate = |value: &PossibleValue| (value.get_name().to_owned(), first_line(value.get_help()));
        return possible.iter().filter(is_shown).map(candidate).collect();
    }
    let name = arg.get_value_names().and_then(<[_]>::first).map_or("", |name| name.as_str());
    match name {
        "KEY=VALUE" => settings(word),
        // The seeds of a study have an option of their own.
        "KEY=VALUES" => settings(word).into_iter().filter(|(key, _)| key != "seed=").collect(),
        _ => {
            let is_path = ["FILE", "DIR", "PATH"].iter().any(|part| name.contains(part));
            if !is_path && arg.get_value_hint() != ValueHint::AnyPath {
                return Vec::new();
            }
            let takes_run = arg.is_positional() || ["checkpoint", "resume"].contains(&arg.get_id().as_str());
            let mut candidates = match arg.get_id().as_str() {
                _ if word.contains('/') => Vec::new(),
                "config" => SHIPPED.iter().map(|config| (config.name.into(), config.about.into())).collect(),
                _ if takes_run => runs(),
                _ => Vec::new(),
            };
            let request = if name.contains("DIR") { ":directories" } else { ":files" };
            candidates.push((request.into(), String::new()));
            candidates
        }
    }
}

fn is_request(value: &str) -> bool {
    value.starts_with(':')
}

/// The keys of a config as `key=`; after the `=` the key's values, where there are only a few, and another after a comma.
fn settings(word: &str) -> Vec<Candidate> {
    let Some((name, _)) = word.split_once('=') else {
        return config::keys().map(|(key, meaning, _)| (format!("{key}="), meaning.into())).collect();
    };
    let values = config::keys().find(|(key, ..)| *key == name).map_or_else(Vec::new, |(.., values)| values);
    let before = &word[..=word.rfind([',', '=']).unwrap_or(name.len())];
    values.into_iter().map(|value| (format!("{before}{value}"), String::new())).collect()
}

fn runs() -> Vec<Candidate> {
    let entries = fs::read_dir("runs").into_iter().flatten().flatten();
    let is_run = |entry: &fs::DirEntry| entry.path().join("config.json").is_file();
    let paths = entries.filter(is_run).filter_map(|entry| entry.path().into_os_string().into_string().ok());
    let mut runs: Vec<Candidate> = paths.map(|path| (path, "run".into())).collect();
    runs.sort();
    runs
}

fn first_line(text: Option<&clap::builder::StyledStr>) -> String {
    text.map(ToString::to_string).unwrap_or_default().lines().next().unwrap_or_default().into()
}
