//! Options that people know from other programs, and the config keys that they stand for here.

use clap::Command;
use clap::error::{ContextKind, ContextValue, ErrorKind};
use serde_json::Value;

use super::ui::program;
use crate::config::meanings;

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
    let (line, replaced, others) = corrected(command, arguments);
    if !replaced.contains(option) {
        return None;
    }
    let options = replaced.iter().map(|option| format!("`{option}`")).collect::<Vec<_>>().join(", ");
    let are = if replaced.len() == 1 { "is no option" } else { "are no options" };
    let (program, line) = (program(), joined(&line));
    Some(format!(
        "{options} {are} of `{name}`: settings are keys of the config, given with --set. Type\n  {program} {line}{others}"
    ))
}

fn joined(words: &[String]) -> String {
    words.iter().map(|word| crate::text::shell_word(word)).collect::<Vec<_>>().join(" ")
}

/// A command line with `--set` in place of every option that is a setting; these options, and what they could mean besides.
fn corrected(command: &Command, arguments: &[String]) -> (Vec<String>, Vec<String>, String) {
    let (mut line, mut replaced, mut others) = (Vec::new(), Vec::new(), String::new());
    let mut words = arguments.iter().peekable();
    while let Some(word) = words.next() {
        let (option, attached) = word.split_once('=').map_or((word.as_str(), None), |(o, v)| (o, Some(v)));
        let name = option.strip_prefix("--").filter(|name| !has_option(command, name));
        // Every command that takes settings has an option of its own for seeds.
        let is_setting = |meaning: &Vec<String>| !["$schema={}", "seed={}"].contains(&meaning[0].as_str());
        let found = |value: &Value| {
            let found = name.map_or_else(Vec::new, |name| meanings(name, value));
            found.into_iter().filter(is_setting).collect::<Vec<_>>()
        };
        let known = found(&Value::Null);
        let is = |setting: &str| known.first().is_some_and(|meaning| meaning[0] == setting);
        // A negative number is no option, and `--double` alone switches it on.
        let is_value = |next: &&String| match next.as_str() {
            "true" | "false" => true,
            next => !is("double={}") && (!next.starts_with('-') || next.parse::<f64>().is_ok()),
        };
        let most = if is("network.hidden={}") { usize::MAX } else { usize::from(!known.is_empty()) };
        let mut values = Vec::from_iter(attached.filter(|value| !value.is_empty()));
        while attached.is_none()
            && values.len() < most
            && let Some(value) = words.next_if(is_value)
        {
            values.push(value);
        }
        let value = match values.join(",") {
            value if value.is_empty() && is("double={}") => "true".into(),
            value if value.is_empty() => PLACEHOLDER.into(),
            value => value,
        };
        let found = found(&serde_json::from_str(&value).unwrap_or_else(|_| Value::from(&*value)));
        let mut meanings = found.iter().map(|settings| given(settings, &value, command));
        let Some(by) = meanings.next() else {
            line.push(word.clone());
            continue;
        };
        for other in meanings {
            let (other, by) = (joined(&other), joined(&by));
            others +=
                &format!("\n`{option}` could also be {other}: if you mean that, type it in place of {by}");
        }
        line.extend(by);
        replaced.push(option.to_owned());
    }
    (line, replaced, others)
}

/// Settings as a command takes them. Several values of a study are varied.
fn given(settings: &[String], value: &str, command: &Command) -> Vec<String> {
    let is_list = settings[0] == "network.hidden={}";
    let option =
        if !is_list && value.contains(',') && has_option(command, "vary") { "--vary" } else { "--set" };
    let value = if is_list && !value.starts_with('[') { format!("[{value}]") } else { value.into() };
    settings.iter().flat_map(|setting| [option.to_owned(), setting.replace("{}", &value)]).collect()
}
