//! Text for a terminal: how a foreign name is shown, and how tables and sentences fit a line.

use std::path::{Path, is_separator};

use unicode_width::{UnicodeWidthChar, UnicodeWidthStr};

/// Columns that every table and message fits.
pub(crate) const COLUMNS: usize = 80;
/// A column of names is not made narrower than this.
pub(crate) const LEAST_NAME: usize = 8;
/// What is between two columns of a table.
pub(crate) const GAP: &str = "  ";

/// Whether a character could steer a terminal, break or reorder a line, or hide in it.
pub fn steers(c: char) -> bool {
    const HIDDEN: &str = "\u{ad}\u{61c}\u{115f}\u{1160}\u{180e}\u{3164}\u{feff}\u{ffa0}";
    let is_in_hidden_range = matches!(
        c,
        '\u{200b}'..='\u{200f}'
            | '\u{2028}'..='\u{202e}'
            | '\u{2060}'..='\u{206f}'
            | '\u{fff9}'..='\u{fffb}'
            | '\u{e0000}'..='\u{e007f}'
    );
    c.is_control() || HIDDEN.contains(c) || is_in_hidden_range
}

/// A name as it can be shown anywhere: characters for which [`steers`] holds become their escapes.
pub(crate) fn visible(text: &str) -> String {
    let mut shown = String::with_capacity(text.len());
    for c in text.chars() {
        if steers(c) { shown.extend(c.escape_default()) } else { shown.push(c) }
    }
    shown
}

/// A path as it can be shown anywhere: see [`visible`].
pub(crate) fn shown(path: &Path) -> String {
    visible(&path.to_string_lossy())
}

/// The beginning of a text, for a message: at most `length` characters, and `…` for the rest. See [`visible`].
pub(crate) fn excerpt(text: &str, length: usize) -> String {
    let text = text.trim_end();
    let start = text.char_indices().nth(length).map_or(text, |(end, _)| &text[..end]);
    visible(start) + if start.len() < text.len() { "…" } else { "" }
}

/// A word as it can be typed into a shell, in one line. With unseen characters it is `$'…'`, as bash, zsh and ksh know it.
pub(crate) fn shell_word(word: &str) -> String {
    let is_unseen = |c: char| steers(c) || c.width() == Some(0);
    let is_plain = |c: char| c.is_alphanumeric() || ":._-+=,".contains(c) || is_separator(c);
    if word.chars().any(is_unseen) {
        return format!("$'{}'", word.chars().map(|c| ansi_c(c, is_unseen(c))).collect::<String>());
    }
    // zsh replaces a word that begins with `=` by the path of a program.
    let is_word = !word.is_empty() && !word.starts_with('=') && word.chars().all(is_plain);
    if is_word { word.to_owned() } else { format!("'{}'", word.replace('\'', "'\\''")) }
}

/// A character between `$'` and `'`.
fn ansi_c(c: char, is_unseen: bool) -> String {
    match c {
        '\n' => "\\n".into(),
        '\r' => "\\r".into(),
        '\t' => "\\t".into(),
        '\'' | '\\' => format!("\\{c}"),
        c if is_unseen => c.to_string().bytes().map(|byte| format!("\\{byte:03o}")).collect(),
        c => c.into(),
    }
}

/// A program and its arguments as they can be typed into a shell, in one line.
pub fn shell_line(command: &[String]) -> String {
    // As the first word of a line these are no programs.
    const KEYWORDS: [&str; 17] = [
        "case", "coproc", "do", "done", "elif", "else", "esac", "fi", "for", "function", "if", "in",
        "select", "then", "time", "until", "while",
    ];
    let mut words: Vec<String> = command.iter().map(|word| shell_word(word)).collect();
    if let (Some(first), Some(word)) = (words.first_mut(), command.first())
        && first == word
        && (KEYWORDS.contains(&word.as_str()) || word.contains('='))
    {
        *first = format!("'{word}'");
    }
    words.join(" ")
}

const MAX_MESSAGE: usize = 4000;

/// A message that has a limit whatever stands in it, a name or a value of any length: its middle is left out.
pub(crate) fn limited(text: &str) -> std::borrow::Cow<'_, str> {
    let nth = |n: usize| text.char_indices().nth(n).map(|(at, _)| at);
    if nth(MAX_MESSAGE).is_none() {
        return text.into();
    }
    let half = MAX_MESSAGE / 2;
    let head = nth(half).unwrap_or(text.len());
    let tail = text.char_indices().nth_back(half - 1).map_or(0, |(at, _)| at);
    format!("{} … ({} bytes are left out) … {}", &text[..head], tail - head, &text[tail..]).into()
}

/// Columns that a text takes in a terminal.
pub(crate) fn width(text: &str) -> usize {
    text.width()
}

/// As much of the beginning of the characters as fits.
fn fitting(characters: impl Iterator<Item = char>, columns: usize) -> Vec<char> {
    let mut taken = 0;
    let fits = |c: &char| {
        taken += width(c.encode_utf8(&mut [0; 4]));
        taken <= columns
    };
    characters.take_while(fits).collect()
}

/// A text of at most `columns`, with `…` for the middle where it is longer.
pub(crate) fn shortened(text: &str, columns: usize) -> String {
    if width(text) <= columns {
        return text.to_owned();
    }
    let kept = columns.saturating_sub(1);
    let tail = fitting(text.chars().rev(), kept / 2);
    let head = fitting(text.chars(), kept - kept / 2);
    head.into_iter().chain(['…']).chain(tail.into_iter().rev()).collect()
}

/// Names of configs, or of anything else that is told apart by its words, in at most so many columns. Where one is wider, all go
/// without the words that they share, for which `…` stands. Where one still is, `key=value` stands for `path.key=value`.
pub(crate) fn labels(names: &[&str], columns: usize) -> Vec<String> {
    let fit = |names: &[String]| names.iter().all(|name| width(name) <= columns);
    let names: Vec<String> = names.iter().map(|name| visible(name)).collect();
    if fit(&names) {
        return names;
    }
    let is_shared = |word: &&str| names.iter().all(|name| name.split(' ').any(|other| other == *word));
    let own = |name: &String| {
        let (shared, own): (Vec<&str>, Vec<&str>) = name.split(' ').partition(is_shared);
        let omitted = if shared.is_empty() { "" } else { "… " };
        if own.is_empty() { name.clone() } else { format!("{omitted}{}", own.join(" ")) }
    };
    let key_alone = |word: &str| match word.split_once('=') {
        Some((path, value)) => format!("{}={value}", path.rsplit('.').next().unwrap_or(path)),
        None => word.to_owned(),
    };
    let mut labels: Vec<String> = names.iter().map(own).collect();
    if !fit(&labels) {
        let words = |label: &String| label.split(' ').map(key_alone).collect::<Vec<_>>().join(" ");
        labels = labels.iter().map(words).map(|label| shortened(&label, columns)).collect();
    }
    let is_double = |label: &String| labels.iter().filter(|other| *other == label).count() > 1;
    let numbered = |(i, label): (usize, &String)| match is_double(label) {
        true => format!("{} {}", i + 1, shortened(label, columns.saturating_sub(7))),
        false => label.clone(),
    };
    labels.iter().enumerate().map(numbered).collect()
}

/// The lines of a text, none wider than `columns`; a word that is wider is cut.
pub(crate) fn lines(text: &str, columns: usize) -> Vec<String> {
    let mut lines = vec![String::new()];
    let mut taken = 0;
    for word in text.split_whitespace() {
        let mut rest = word;
        while !rest.is_empty() {
            let space = usize::from(taken > 0);
            let line = lines.len() - 1;
            if taken + space + width(rest) <= columns {
                lines[line] += &" "[..space];
                lines[line] += rest;
                taken += space + width(rest);
                break;
            }
            if taken == 0 {
                let piece: String = fitting(rest.chars(), columns.max(2)).into_iter().collect();
                rest = &rest[piece.len()..];
                lines[line] = piece;
            }
            lines.push(String::new());
            taken = 0;
        }
    }
    lines
}

/// A text in lines of at most [`COLUMNS`], all but the first indented by so many spaces.
pub(crate) fn wrapped(text: &str, indent: usize) -> String {
    // The first line is indented by what it begins with.
    let own = text.len() - text.trim_start().len();
    let margin = indent.max(own);
    let lines = lines(text, COLUMNS - margin);
    format!("{}{}\n", &text[..own], lines.join(&format!("\n{}", " ".repeat(margin))))
}

/// Rows below a heading, within [`COLUMNS`]: the second column, names, is shortened; the others are aligned to the right.
pub(crate) fn table(rows: &[Vec<String>]) -> String {
    const NAMES: usize = 1;
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let widest = |i: usize| rows.iter().filter_map(|row| Some(width(row.get(i)?))).max().unwrap_or(0);
    let mut widths: Vec<usize> = (0..columns).map(widest).collect();
    if columns > NAMES {
        let taken: usize = widths.iter().sum::<usize>() + GAP.len() * (columns - 1);
        let too_many = taken.saturating_sub(COLUMNS);
        widths[NAMES] = widths[NAMES].saturating_sub(too_many).max(LEAST_NAME.min(widths[NAMES]));
    }
    let mut text = String::new();
    for row in rows {
        let mut line = String::new();
        for (i, (cell, &columns)) in row.iter().zip(&widths).enumerate() {
            let cell = if i == NAMES { shortened(cell, columns) } else { cell.clone() };
            let space = " ".repeat(columns.saturating_sub(width(&cell)));
            line += if i == 0 { "" } else { GAP };
            line += &if i == NAMES { cell + &space } else { space + &cell };
        }
        text += line.trim_end();
        text.push('\n');
    }
    text
}

/// The names that their labels shorten, in full; nothing if none does.
pub(crate) fn legend<'a>(names: impl Iterator<Item = (&'a str, &'a str)>) -> String {
    let shortened = names.map(|(label, name)| (label, visible(name))).filter(|(label, name)| label != name);
    let names: String = shortened.map(|(label, name)| wrapped(&format!("  {label}: {name}"), 4)).collect();
    if names.is_empty() { names } else { format!("Names in full:\n{names}") }
}

#[cfg(test)]
#[path = "../tests/unit/text.rs"]
mod tests;
