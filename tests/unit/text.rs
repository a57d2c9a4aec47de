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
    let rows = [row("rank", "config", "value"), row("1", &"n".repeat(200), "0.5"), row("2", "short", "12")];
    let table = table(&rows);
    assert!(table.lines().all(|line| width(line) <= COLUMNS), "{table}");
    assert!(table.contains("   1  nnn") && table.contains("nnn    0.5\n"), "{table}");
}

#[test]
fn names_are_cut_to_what_tells_them_apart() {
    let long = ["tutorial learn.every_steps=2 gamma=0.95", "tutorial learn.every_steps=2 gamma=0.999"];
    assert_eq!(labels(&long, 20), ["… gamma=0.95", "… gamma=0.999"]);
    assert_eq!(labels(&long, 40), long);
    assert_eq!(labels(&["a gamma=0.95", "a gamma=0.99"], 20), ["a gamma=0.95", "a gamma=0.99"]);
    let keys = ["a optimizer.learning_rate=0.1", "a optimizer.learning_rate=1"];
    assert_eq!(labels(&keys, 20), ["… learning_rate=0.1", "… learning_rate=1"]);
    let names: Vec<String> = (0..30).map(|i| format!("{}{i}{}", "m".repeat(30), "n".repeat(30))).collect();
    let labels = labels(&names.iter().map(String::as_str).collect::<Vec<_>>(), 20);
    assert!(labels.iter().all(|label| width(label) <= 20), "{labels:?}");
    assert_eq!(labels.iter().collect::<std::collections::BTreeSet<_>>().len(), 30, "{labels:?}");
    let full = legend([("… gamma=0.95", long[0]), ("short", "short")].into_iter());
    assert_eq!(full, "Names in full:\n  … gamma=0.95: tutorial learn.every_steps=2 gamma=0.95\n");
}

#[test]
fn what_could_steer_a_terminal_is_shown_as_its_escape() {
    assert_eq!(visible("a\u{1b}[31m\nb\u{202e}ü"), "a\\u{1b}[31m\\nb\\u{202e}ü");
}

#[test]
fn an_excerpt_says_that_it_is_one() {
    assert_eq!(excerpt("äbc\n", 3), "äbc");
    assert_eq!(excerpt("äb\ncd", 3), "äb\\n…");
}

#[test]
fn a_command_is_quoted_only_where_a_shell_would_read_something_else() {
    let line = |words: &[&str]| shell_line(&words.iter().map(|&word| word.to_owned()).collect::<Vec<_>>());
    assert_eq!(line(&["python3", "walk.py", "--a=b"]), "python3 walk.py --a=b");
    assert_eq!(line(&["time", "time"]), "'time' time");
    assert_eq!(line(&["A=b", "A=b"]), "'A=b' A=b");
    assert_eq!(line(&["x", "", "it's", "=x", "$(y)"]), r"x '' 'it'\''s' '=x' '$(y)'");
    assert_eq!(
        line(&["x", "a\nb\u{1b}'\\", "\u{202e}", "\u{200b}é"]),
        r"x $'a\nb\033\'\\' $'\342\200\256' $'\342\200\213é'"
    );
}
