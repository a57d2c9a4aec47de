//! How `cartpole-dqn check` shows what it says of a loop.

use serde::Serialize;

use super::ui::{Failure, print, print_json};
use crate::check::trace::Judgement;
use crate::text::{COLUMNS, lines, visible};

pub(super) const INDENT: usize = 12;

#[derive(Serialize)]
struct Printed<'a> {
    file: &'a str,
    #[serde(flatten)]
    judgement: &'a Judgement,
}

/// Prints it. Fails if a mistake is named.
pub(super) fn show(file: &str, judgement: &Judgement, is_json: bool) -> Result<(), Failure> {
    if is_json {
        print_json(&Printed { file, judgement })?;
    } else {
        print(&describe(file, judgement))?;
    }
    match judgement.mistakes.len() {
        0 => Ok(()),
        1 => Err(Failure::Failed("the loop has a known mistake".into())),
        mistakes => Err(Failure::Failed(format!("the loop has {mistakes} known mistakes"))),
    }
}

fn describe(file: &str, judgement: &Judgement) -> String {
    let mut text = String::new();
    put(&mut text, "file", file);
    for (index, fact) in judgement.facts.iter().enumerate() {
        put(&mut text, if index == 0 { "loop" } else { "" }, &visible(fact));
    }
    for named in &judgement.mistakes {
        put(&mut text, "MISTAKE", &named.mistake.id.replace('_', " "));
        put(&mut text, "  what", &named.mistake.what);
        put(&mut text, "  shown by", &visible(&named.evidence));
        put(&mut text, "  why", &named.mistake.why);
        put(&mut text, "  mend", &named.mistake.mend);
    }
    if judgement.mistakes.is_empty() {
        put(&mut text, "verdict", "nothing that could be seen is wrong");
    }
    for (index, sentence) in judgement.unseen.iter().enumerate() {
        put(&mut text, if index == 0 { "not seen" } else { "" }, &visible(sentence));
    }
    text
}

/// Adds a paragraph behind its name.
pub(super) fn put(text: &mut String, name: &str, paragraph: &str) {
    let margin = format!("\n{:INDENT$}", "");
    *text += &format!("{name:<INDENT$}{}\n", lines(paragraph, COLUMNS - INDENT).join(&margin));
}
