//! `config` and `completions`: the JSON Schema, the explained config, what shells complete.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use cartpole_dqn::config::{self, Config};
use serde_json::{Value, json};

use crate::cli::{Sandbox, refusals, stdout_json};

fn stdout(arguments: &[&str]) -> String {
    let printed = Sandbox::new().run(arguments).success();
    String::from_utf8(printed.get_output().stdout.clone()).unwrap()
}

/// The schemas of the key at a path: one, or that of each alternative that has it.
fn schemas_at<'a>(schema: &'a Value, path: &str) -> Vec<&'a Value> {
    let (name, rest) = path.split_once('.').map_or((path, None), |(name, rest)| (name, Some(rest)));
    let own = schema["properties"].get(name).into_iter();
    let shapes = schema["anyOf"].as_array().into_iter().flatten();
    let own = own.flat_map(|member| rest.map_or_else(|| vec![member], |rest| schemas_at(member, rest)));
    own.chain(shapes.flat_map(|shape| schemas_at(shape, path))).collect()
}

/// Checks that a file of docs/ is what `write` makes of it. Where `CARTPOLE_DQN_WRITE_DOCS` is set, it writes the file.
#[track_caller]
fn check_docs(name: &str, write: impl Fn(&str) -> String) {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs").join(name);
    let found = fs::read_to_string(&file).unwrap();
    let expected = write(&found);
    if std::env::var_os("CARTPOLE_DQN_WRITE_DOCS").is_some() {
        fs::write(&file, expected).unwrap();
    } else {
        let command = "CARTPOLE_DQN_WRITE_DOCS=1 cargo test --test it written_docs";
        assert_eq!(found, expected, "docs/{name} is out of date; write it anew: {command}");
    }
}

#[test]
fn written_docs_have_the_schema_that_is_printed() {
    check_docs("config.schema.json", |_| stdout(&["config", "schema"]));
}

#[test]
fn written_docs_have_the_table_of_keys() {
    check_docs("configuration.md", |found| {
        let (before, rest) = found.split_once("written_docs -->\n").unwrap();
        let (_, after) = rest.split_once("<!-- End of the printed table.").unwrap();
        let table = config::markdown_table();
        format!("{before}written_docs -->\n{table}<!-- End of the printed table.{after}")
    });
}

#[test]
fn the_schema_has_the_meaning_and_the_default_of_every_key() {
    let schema = config::schema();
    for (path, meaning, _) in config::keys() {
        let found = schemas_at(&schema, path);
        assert!(!found.is_empty(), "{path} is not in the schema");
        found.iter().for_each(|schema| assert_eq!(schema["description"], json!(meaning), "{path}"));
    }
    for setting in Config::default().settings() {
        assert_eq!(setting.value, setting.default, "{}", setting.path);
        let found = schemas_at(&schema, setting.path);
        assert!(found.iter().any(|schema| schema["default"] == setting.default), "{}", setting.path);
    }
}

/// Every config below a directory.
fn shipped_configs(directory: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(directory).unwrap().map(|entry| entry.unwrap().path());
    let files = |path: PathBuf| if path.is_dir() { shipped_configs(&path) } else { vec![path] };
    entries.flat_map(files).filter(|path| path.extension().is_some_and(|end| end == "json")).collect()
}

#[test]
fn shipped_configs_name_the_schema() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let files = shipped_configs(&root.join("configs"));
    assert!(files.contains(&root.join("configs/lunar_lander.json")) && files.len() >= 11, "{files:?}");
    for file in files {
        let config: Value = serde_json::from_str(&fs::read_to_string(&file).unwrap()).unwrap();
        let schema = file.parent().unwrap().join(config["$schema"].as_str().unwrap());
        assert_eq!(
            schema.canonicalize().unwrap(),
            root.join("docs/config.schema.json").canonicalize().unwrap()
        );
    }
}

#[test]
fn a_shown_config_can_be_set_again() {
    let tutorial = concat!(env!("CARGO_MANIFEST_DIR"), "/configs/tutorial.json");
    let options = ["--config", tutorial, "--seed", "7", "--set", "optimizer.schedule.steps=9"];
    let text = stdout(&[&["config", "show"], &options[..]].concat());
    let shown: Vec<&str> = text.lines().filter(|line| !line.starts_with(' ')).collect();
    assert!(shown.contains(&"exploration.decay=0.995") && shown.contains(&"optimizer.schedule.steps=9"));
    assert!(text.contains("replay.capacity=2000\n    transitions that the memory holds before it overwrites the oldest\n    default: 20000; allowed: an integer from 1 to 100000000\n"), "{text}");
    let sandbox = Sandbox::new();
    let config = stdout_json(&sandbox.run(&[&["config", "show", "--json"], &options[..]].concat()).success());
    assert_eq!(config["seed"], 7);
    let sets: Vec<String> = shown.iter().map(ToString::to_string).collect();
    assert_eq!(json!(Config::from_layers(None, &sets).unwrap()), config);
}

/// What may stand in the place of the last word.
fn candidates(words: &[&str]) -> Vec<String> {
    let printed = stdout(&[&["__words", "--"], words].concat());
    printed.lines().map(|line| line.split_once('\t').unwrap().0.to_owned()).collect()
}

/// The first word of each line of a section, without the short name of an option.
fn words_of(help: &str, heading: &str) -> Vec<String> {
    let section = help.lines().skip_while(|line| *line != heading).skip(1);
    let section = section.take_while(|line| line.starts_with("  "));
    let entries = section.filter(|line| !line.starts_with("          "));
    let words =
        entries.map(|line| line.split_whitespace().find(|word| !word.ends_with(',')).unwrap().to_owned());
    words.collect()
}

#[test]
fn every_command_and_every_option_is_completed() {
    let commands = candidates(&[""]);
    assert_eq!(commands, words_of(&stdout(&["--help"]), "Commands:"));
    for command in commands.iter().filter(|command| *command != "help") {
        let options = candidates(&[command, "--"]);
        let help = stdout(&[command, "-h"]);
        assert_eq!(options, words_of(&help, "Options:"), "{help}");
    }
}

/// As `scripts/release.sh` packs them.
#[test]
fn every_command_has_a_man_page_with_all_its_options() {
    let directory = tempfile::tempdir().unwrap();
    clap_mangen::generate_to(cartpole_dqn::cli::command(), &directory).unwrap();
    let entries = fs::read_dir(&directory).unwrap().map(|entry| entry.unwrap().path());
    let mut pages: Vec<PathBuf> = entries.collect();
    let (mut commands, mut next) = (vec![Vec::new()], 0);
    while let Some(command) = commands.get(next).cloned() {
        let arguments: Vec<&str> = command.iter().map(String::as_str).chain(["-h"]).collect();
        let help = stdout(&arguments);
        let name = [&["cartpole-dqn".to_owned()], &command[..]].concat().join("-") + ".1";
        let page = fs::read_to_string(directory.path().join(&name)).unwrap_or_else(|_| panic!("no {name}"));
        for option in words_of(&help, "Options:") {
            assert!(page.contains(&option.replace('-', "\\-")), "{name} has no {option}");
        }
        for section in [".TH ", ".SH NAME", ".SH SYNOPSIS", ".SH DESCRIPTION"] {
            assert!(page.lines().any(|line| line.starts_with(section)), "{name} has no {section}");
        }
        let below = words_of(&help, "Commands:").into_iter().filter(|word| word != "help");
        commands.extend(below.map(|word| [&command[..], &[word]].concat()));
        next += 1;
    }
    assert!(commands.len() == pages.len() && commands.len() > 15, "{commands:?} {pages:?}");
    pages.sort();
    match Command::new("groff").args(["-man", "-Kutf8", "-Tutf8", "-ww", "-z"]).args(&pages).output() {
        Ok(output) => assert!(output.status.success() && output.stderr.is_empty(), "{output:?}"),
        Err(error) => crate::skipped(&format!("there is no groff to read the man pages: {error}")),
    }
}

#[test]
fn every_key_of_a_config_is_completed_and_every_value_that_has_a_name() {
    let keys = candidates(&["train", "--set", ""]);
    for setting in Config::default().settings().iter().filter(|setting| setting.path != "$schema") {
        assert!(keys.contains(&format!("{}=", setting.path)), "{}", setting.path);
    }
    assert_eq!(candidates(&["train", "--set", "loss="]), ["loss=mse", "loss=huber"]);
    assert_eq!(candidates(&["config", "show", "--set=double=t"]), ["--set=double=true"]);
    assert_eq!(candidates(&["study", "--vary", "loss=mse,h"]), ["loss=mse,huber"]);
    assert!(!candidates(&["study", "--vary", ""]).contains(&"seed=".to_owned()));
    assert!(candidates(&["train", "--set", "nope="]).is_empty());
}

#[test]
fn a_path_is_completed_where_one_is_taken_and_nothing_where_a_number_is() {
    let sandbox = Sandbox::new();
    fs::create_dir_all(sandbox.path("runs/first")).unwrap();
    fs::create_dir_all(sandbox.path("runs/no-run")).unwrap();
    fs::write(sandbox.path("runs/first/config.json"), "{}").unwrap();
    let lines = |words: &[&str]| {
        let printed = sandbox.run(&[&["__words", "--"], words].concat()).success();
        String::from_utf8(printed.get_output().stdout.clone()).unwrap()
    };
    assert_eq!(lines(&["train", "--config", "x"]), ":files\t\n");
    assert_eq!(lines(&["train", "--config", "tu"]), "tutorial\ta beginner's tutorial in Keras\n:files\t\n");
    assert_eq!(lines(&["study", "--config=fa"]).lines().count(), 2);
    assert_eq!(lines(&["config", "show", "--config", "./tu"]), ":files\t\n");
    assert_eq!(lines(&["train", "--out=x"]), ":directories\t\n");
    assert_eq!(lines(&["eval", "--checkpoint", ""]), "runs/first\trun\n:files\t\n");
    assert_eq!(lines(&["train", "--resume", "ru"]), "runs/first\trun\n:directories\t\n");
    assert_eq!(lines(&["report", "a", "b", ""]), "runs/first\trun\n:directories\t\n");
    assert_eq!(lines(&["train", "--seed", ""]), "");
}

#[test]
fn an_option_is_offered_again_only_if_it_can_be_repeated() {
    let offered = candidates(&["train", "--quiet", "--set", "gamma=1", "--seed=1", "-"]);
    assert!(offered.contains(&"--set".into()) && offered.contains(&"--out".into()));
    assert!(!offered.contains(&"--quiet".into()) && !offered.contains(&"--seed".into()));
    assert!(candidates(&["report", "--", "--"]).iter().all(|word| !word.starts_with("--")));
    assert!(candidates(&["verify", "run", ""]).iter().all(|word| !word.starts_with("run")));
}

#[cfg(unix)]
#[test]
fn completing_says_nothing_and_succeeds_for_any_bytes() {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;
    let odd: [&[u8]; 12] = [
        b"",
        b"-",
        b"--",
        b"---",
        b"=",
        b"--=",
        b"-=x",
        b"--set=",
        b"--set=,=",
        b"\xff\xfe",
        b"-\xff",
        b"--vary=\xce\xb8=,",
    ];
    let programs = ["train", "help", "report"].map(str::as_bytes);
    for first in programs.iter().chain(&odd) {
        for second in odd {
            let mut command = Command::new(env!("CARGO_BIN_EXE_cartpole-dqn"));
            let words = [&b"__words"[..], b"--", first, second].map(OsStr::from_bytes);
            let output = command.args(words).output().unwrap();
            assert!(output.status.success() && output.stderr.is_empty(), "{words:?} {output:?}");
        }
    }
}

#[test]
fn bash_takes_the_script() {
    let script = stdout(&["completions", "bash"]);
    let taken = match Command::new("bash").args(["-c", &(script + "complete -p cartpole-dqn")]).output() {
        Ok(output) => output,
        Err(error) => return crate::skipped(&format!("there is no bash to take the completions: {error}")),
    };
    assert_eq!(
        String::from_utf8_lossy(&taken.stdout),
        "complete -F _cartpole_dqn cartpole-dqn\n",
        "{taken:?}"
    );
}

refusals! {
    refuses_config_without_a_command: [], ["config"] => ["Usage", "schema"];
    refuses_to_show_a_bad_config: [], ["config", "show", "--set", "gamma=2"] => ["`gamma` is 2", "from 0 to 1"];
    refuses_to_show_a_missing_config: [], ["config", "show", "--config", "no.json"] => ["no.json", "--config takes"];
    refuses_an_unknown_shell: [], ["completions", "ksh"] => ["ksh", "bash", "fish", "zsh"];
}
