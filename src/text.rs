//! Text for a terminal: how a foreign name is shown, and how tables and sentences fit a line.

use std::path::Path;

use unicode_width::UnicodeWidthStr;

/// Columns that every table and message fits.
pub const COLUMNS: usize = 80;
/// A column of names is not made narrower than this.
const LEAST_NAME: usize = 8;
const GAP: &str = "  ";

/// Whether a character could steer a terminal or reorder a line.
pub fn steers(c: char) -> bool {
    c.is_control() || matches!(c, '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

/// A name as it can be shown anywhere: characters that could steer a terminal or reorder a line become their escapes.
pub fn visible(text: &str) -> String {
    let mut shown = String::with_capacity(text.len());
    for c in text.chars() {
        if steers(c) { shown.extend(c.escape_default()) } else { shown.push(c) }
    }
    shown
}

/// A path as it can be shown anywhere: see [`visible`].
pub fn shown(path: &Path) -> String {
    visible(&path.to_string_lossy())
}

/// Columns that a text takes in a terminal.
pub fn width(text: &str) -> usize {
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
pub fn shortened(text: &str, columns: usize) -> String {
    if width(text) <= columns {
        return text.to_owned();
    }
    let kept = columns.saturating_sub(1);
    let tail = fitting(text.chars().rev(), kept / 2);
    let head = fitting(text.chars(), kept - kept / 2);
    head.into_iter().chain(['…']).chain(tail.into_iter().rev()).collect()
}

/// Widest name in a report, in columns.
pub const NAME: usize = 18;

/// Names of configs, or of anything else that is told apart by its words, of at most [`NAME`] columns. Where one is longer, all go
/// without the words that they share, and `…` stands for those.
pub fn labels(names: &[&str]) -> Vec<String> {
    let names: Vec<String> = names.iter().map(|name| visible(name)).collect();
    if names.iter().all(|name| width(name) <= NAME) {
        return names;
    }
    let is_shared = |word: &&str| names.iter().all(|name| name.split(' ').any(|other| other == *word));
    let own = |name: &String| {
        let (shared, own): (Vec<&str>, Vec<&str>) = name.split(' ').partition(is_shared);
        let omitted = if shared.is_empty() { "" } else { "… " };
        if own.is_empty() { name.clone() } else { format!("{omitted}{}", own.join(" ")) }
    };
    let labels: Vec<String> = names.iter().map(|name| shortened(&own(name), NAME)).collect();
    let is_double = |label: &String| labels.iter().filter(|other| *other == label).count() > 1;
    let numbered = |(i, label): (usize, &String)| match is_double(label) {
        true => format!("{} {}", i + 1, shortened(label, NAME - 7)),
        false => label.clone(),
    };
    labels.iter().enumerate().map(numbered).collect()
}

/// The lines of a text, none wider than `columns`; a word that is wider is cut.
pub fn lines(text: &str, columns: usize) -> Vec<String> {
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
pub fn wrapped(text: &str, indent: usize) -> String {
    // The first line is indented by what it begins with.
    let own = text.len() - text.trim_start().len();
    let margin = indent.max(own);
    let lines = lines(text, COLUMNS - margin);
    format!("{}{}\n", &text[..own], lines.join(&format!("\n{}", " ".repeat(margin))))
}

/// Rows below a heading, no line wider than [`COLUMNS`]: the second column holds names, which are shortened as far as
/// that takes; the other columns are aligned to the right.
pub fn table(rows: &[Vec<String>]) -> String {
    const NAMES: usize = 1;
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let widest =
        |i: usize| rows.iter().filter_map(|row| row.get(i)).map(|cell| width(cell)).max().unwrap_or(0);
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
pub fn legend<'a>(names: impl Iterator<Item = (&'a str, &'a str)>) -> String {
    let shortened = names.map(|(label, name)| (label, visible(name))).filter(|(label, name)| label != name);
    let names: String = shortened.map(|(label, name)| wrapped(&format!("  {label}: {name}"), 4)).collect();
    if names.is_empty() { names } else { format!("Names in full:\n{names}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shortened_text_keeps_both_ends_and_fits() {
        assert_eq!(shortened("gamma=0.99", 10), "gamma=0.99");
        assert_eq!(shortened("gamma=0.999", 10), "gamma….999");
        for columns in 1..12 {
            assert!(width(&shortened("漢字漢字 gamma=0.99", columns)) <= columns);
        }
    }

    #[test]
    fn lines_break_at_spaces_and_cut_what_is_wider() {
        assert_eq!(lines("one two three", 7), ["one two", "three"]);
        assert_eq!(lines("a 0123456789 b", 4), ["a", "0123", "4567", "89 b"]);
        assert_eq!(lines("漢字漢字", 5), ["漢字", "漢字"]);
        assert_eq!(lines("", 5), [""]);
        assert!(wrapped(&format!("  {}", "x".repeat(200)), 4).lines().all(|line| line.len() <= COLUMNS));
    }

    #[test]
    fn a_table_shortens_its_names_and_nothing_else() {
        let row = |rank: &str, name: &str, value: &str| [rank, name, value].map(String::from).to_vec();
        let rows =
            [row("rank", "config", "value"), row("1", &"n".repeat(200), "0.5"), row("2", "short", "12")];
        let table = table(&rows);
        assert!(table.lines().all(|line| width(line) <= COLUMNS), "{table}");
        assert!(table.contains("   1  nnn") && table.contains("nnn    0.5\n"), "{table}");
    }

    #[test]
    fn names_are_cut_to_what_tells_them_apart() {
        let long = ["tutorial learn.every_steps=2 gamma=0.95", "tutorial learn.every_steps=2 gamma=0.999"];
        assert_eq!(labels(&long), ["… gamma=0.95", "… gamma=0.999"]);
        assert_eq!(labels(&["a gamma=0.95", "a gamma=0.99"]), ["a gamma=0.95", "a gamma=0.99"]);
        let names: Vec<String> =
            (0..30).map(|i| format!("{}{i}{}", "m".repeat(30), "n".repeat(30))).collect();
        let labels = labels(&names.iter().map(String::as_str).collect::<Vec<_>>());
        assert!(labels.iter().all(|label| width(label) <= NAME), "{labels:?}");
        assert_eq!(labels.iter().collect::<std::collections::BTreeSet<_>>().len(), 30, "{labels:?}");
        let full = legend([("… gamma=0.95", long[0]), ("short", "short")].into_iter());
        assert_eq!(full, "Names in full:\n  … gamma=0.95: tutorial learn.every_steps=2 gamma=0.95\n");
    }

    #[test]
    fn what_could_steer_a_terminal_is_shown_as_its_escape() {
        assert_eq!(visible("a\u{1b}[31m\nb\u{202e}ü"), "a\\u{1b}[31m\\nb\\u{202e}ü");
    }
}
