//! How `cartpole-dqn check` shows what it says: the parts, and what it says of a loop.

use serde::Serialize;

use super::ui::{Failure, print, print_json};
use crate::check::trace::Judgement;
use crate::check::{Mistake, Settings};
use crate::text::{COLUMNS, lines, visible};

const INDENT: usize = 12;

/// What `--json` prints.
#[derive(Serialize)]
pub(super) struct Printed<'a, V> {
    pub file: &'a str,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub settings: Option<Settings>,
    #[serde(flatten)]
    pub verdict: &'a V,
}

/// Prints it. Fails if a mistake is named.
pub(super) fn show(file: &str, judgement: &Judgement, is_json: bool) -> Result<(), Failure> {
    if is_json {
        print_json(&Printed { file, settings: None, verdict: judgement })?;
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
    put_all(&mut text, "loop", &judgement.facts);
    for found in &judgement.mistakes {
        put(&mut text, "MISTAKE", &found.mistake.name());
        put_mistake(&mut text, found.mistake, Some(&found.evidence));
    }
    if judgement.mistakes.is_empty() {
        put(&mut text, "verdict", "nothing that could be seen is wrong");
    }
    put_all(&mut text, "not seen", &judgement.unseen);
    text
}

pub(super) fn put_mistake(text: &mut String, mistake: &Mistake, evidence: Option<&str>) {
    put(text, "  what", &mistake.what);
    evidence.into_iter().for_each(|evidence| put(text, "  shown by", evidence));
    put(text, "  why", &mistake.why);
    put(text, "  mend", &mistake.mend);
}

/// Adds paragraphs behind one name.
pub(super) fn put_all<'a>(text: &mut String, name: &str, paragraphs: impl IntoIterator<Item = &'a String>) {
    let names = [name].into_iter().chain(std::iter::repeat(""));
    paragraphs.into_iter().zip(names).for_each(|(paragraph, name)| put(text, name, paragraph));
}

/// Adds a paragraph behind its name.
pub(super) fn put(text: &mut String, name: &str, paragraph: &str) {
    let margin = format!("\n{:INDENT$}", "");
    *text += &format!("{name:<INDENT$}{}\n", lines(&visible(paragraph), COLUMNS - INDENT).join(&margin));
}
