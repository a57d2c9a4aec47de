//! Options that people know from other programs, and the config keys that they stand for here.

use clap::Command;
use clap::error::{ContextKind, ContextValue, ErrorKind};
use serde_json::Value;

use super::ui::program;
use crate::config::meanings;
use crate::text::shell_word;

/// What replaces a value that the user has not given.
const PLACEHOLDER: &str = "VALUE";

/// The command that a command line is for: its name in messages, and itself.
pub(super) fn command_of<'a>(root: &'a Command, arguments: &[String]) -> (String, &'a Command) {
    let (mut names, mut command) = (Vec::new(), root);
    for word in arguments {
        let Some(below) = command.find_subcommand(word) else { break };
        names.push(word.as_str());
        command = below;
    }
    (names.join(" "), command)
}

/// Whether a command has an option of this long name.
pub(super) fn has_option(command: &Command, long: &str) -> bool {
    command.get_arguments().any(|argument| argument.get_long() == Some(long))
}

/// What to type in place of an option that is a key of the config here; none if the error is another one.
pub(super) fn key_for_option(error: &clap::Error, root: &Command, arguments: &[String]) -> Option<String> {
    let Some(ContextValue::String(option)) = error.get(ContextKind::InvalidArg) else { return None };
    let (name, command) = command_of(root, arguments);
    if error.kind() != ErrorKind::UnknownArgument || !has_option(command, "set") {
        return None;
    }
    let (line, replaced) = with_sets(command, arguments);
    if !replaced.iter().any(|known| known.option == *option) {
        return None;
    }
    let joined = |words: &[String]| words.iter().map(|word| shell_word(word)).collect::<Vec<_>>().join(" ");
    let options: Vec<String> = replaced.iter().map(|known| format!("`{}`", known.option)).collect();
    let are = if replaced.len() == 1 { "is no option" } else { "are no options" };
    let mut message = format!(
        "{} {are} of `{name}`: settings are keys of the config, given with --set. Type\n  {} {}",
        options.join(", "),
        program(),
        joined(&line)
    );
    for Replaced { option, by, others } in &replaced {
        for other in others {
            message += &format!(
                "\n`{option}` could also be {}: if you mean that, type it in place of {}",
                joined(other),
                joined(by)
            );
        }
    }
    Some(message)
}

/// An option that is a setting here.
struct Replaced {
    option: String,
    /// The words in its place.
    by: Vec<String>,
    /// What could be in its place if it means something else.
    others: Vec<Vec<String>>,
}

/// The arguments with `--set` in place of every option that is a setting, and these options.
fn with_sets(command: &Command, arguments: &[String]) -> (Vec<String>, Vec<Replaced>) {
    let (mut line, mut replaced) = (Vec::new(), Vec::new());
    let mut words = arguments.iter().peekable();
    while let Some(word) = words.next() {
        let (option, attached) = match word.split_once('=') {
            Some((option, value)) => (option, Some(value.to_owned())),
            None => (word.as_str(), None),
        };
        let mut values = Vec::from_iter(attached);
        let next = words.peek().map_or("", |next| next.as_str());
        let value = values.first().map_or(next, String::as_str);
        let value = serde_json::from_str(value).unwrap_or_else(|_| Value::from(value));
        let mut found = match option.strip_prefix("--").filter(|name| !has_option(command, name)) {
            Some(name) => meanings(name, &value),
            None => Vec::new(),
        };
        // Every command that takes settings has an option of its own for seeds.
        found.retain(|settings| !["$schema={}", "seed={}"].contains(&settings[0].as_str()));
        if found.is_empty() {
            line.push(word.clone());
            continue;
        }
        // `--double` alone switches it on.
        let next = words.peek().filter(|next| is_value(next));
        if found == [["double={}"]] && values.is_empty() && next.is_none_or(|next| !is_switch(next)) {
            values.push("true".into());
        }
        let is_list = found[0] == ["network.hidden={}"];
        let takes_value = found.iter().flatten().any(|setting| setting.contains("{}"));
        while takes_value
            && (values.is_empty() || is_list)
            && let Some(value) = words.next_if(|next| is_value(next))
        {
            values.push(value.clone());
        }
        let value = match values.join(",") {
            value if value.is_empty() => PLACEHOLDER.to_owned(),
            value if is_list && !value.starts_with('[') => format!("[{value}]"),
            value => value,
        };
        let mut alternatives = found.iter().map(|settings| given(settings, &value, is_list, command));
        let by = alternatives.next().unwrap_or_default();
        line.extend(by.iter().cloned());
        replaced.push(Replaced { option: option.to_owned(), by, others: alternatives.collect() });
    }
    (line, replaced)
}

/// Settings as a command takes them. Several values of a study are varied.
fn given(settings: &[String], value: &str, is_list: bool, command: &Command) -> Vec<String> {
    let is_varied = !is_list && value.contains(',') && has_option(command, "vary");
    let option = |setting: &str| if is_varied && setting.contains("{}") { "--vary" } else { "--set" };
    settings.iter().flat_map(|set| [option(set).to_owned(), set.replace("{}", value)]).collect()
}

/// Whether a word is no option: a negative number is none.
fn is_value(word: &str) -> bool {
    !word.starts_with('-') || word.parse::<f64>().is_ok()
}

fn is_switch(word: &str) -> bool {
    ["true", "false"].contains(&word)
}
