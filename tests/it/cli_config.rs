//! `config` and `completions`: the JSON Schema, the explained config, the shells' scripts.

use std::path::Path;
use std::process::Command;

use cartpole_dqn::config::Config;
use schemars::schema_for;
use serde_json::{Value, json};

use crate::cli::{Sandbox, refusals, stdout_json};

const DOCUMENTED: &str = include_str!("../../docs/configuration.md");

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

#[test]
fn the_shipped_schema_is_the_one_that_is_printed() {
    let shipped = include_str!("../../docs/config.schema.json");
    assert_eq!(
        stdout(&["config", "schema"]),
        shipped,
        "cartpole-dqn config schema > docs/config.schema.json"
    );
}

/// The schema has the default of every key of a config, the documentation's words and no other key.
#[test]
fn the_schema_the_documentation_and_the_config_have_the_same_keys() {
    let schema = schema_for!(Config).to_value();
    let (table, _) = DOCUMENTED.split_once("## Alternatives").unwrap();
    let documented: Vec<(&str, &str)> = table
        .lines()
        .filter_map(|line| {
            let cells: Vec<&str> = line.strip_prefix("| `")?.split(" | ").collect();
            (cells.len() == 5).then(|| (cells[0].trim_end_matches('`'), cells[1]))
        })
        .collect();
    assert!(documented.len() > 40);
    for (path, meaning) in &documented {
        let found = schemas_at(&schema, path);
        assert!(!found.is_empty(), "{path} is not in the schema");
        found.iter().for_each(|schema| assert_eq!(schema["description"], json!(meaning), "{path}"));
    }
    fn leaves(schema: &Value) -> usize {
        let members = schema["properties"].as_object().into_iter().flat_map(|members| members.values());
        let shapes = schema["anyOf"].as_array().into_iter().flatten();
        usize::from(schema.get("description").is_some()) + members.chain(shapes).map(leaves).sum::<usize>()
    }
    let described: usize = documented.iter().map(|(path, _)| schemas_at(&schema, path).len()).sum();
    assert_eq!(leaves(&schema), described, "the schema has keys that are not documented");
    for setting in Config::default().settings() {
        assert_eq!(setting.value, setting.default, "{}", setting.path);
        let found = schemas_at(&schema, setting.path);
        assert!(found.iter().any(|schema| schema["default"] == setting.default), "{}", setting.path);
    }
}

#[test]
fn shipped_configs_name_the_schema() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let files = ["cartpole", "fast", "plain", "smoke", "tutorial", "studies/base"];
    for file in files.map(|name| root.join(format!("configs/{name}.json"))) {
        let config: Value = serde_json::from_str(&std::fs::read_to_string(&file).unwrap()).unwrap();
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
    assert!(text.contains("replay.capacity=2000\n    transitions held before the oldest is overwritten\n    default: 50000; allowed: an integer from 1 to 100000000\n"), "{text}");
    let sandbox = Sandbox::new();
    let config = stdout_json(&sandbox.run(&[&["config", "show", "--json"], &options[..]].concat()).success());
    assert_eq!(config["seed"], 7);
    let sets: Vec<String> = shown.iter().map(ToString::to_string).collect();
    assert_eq!(json!(Config::from_layers(None, &sets).unwrap()), config);
}

#[test]
fn the_shells_complete_every_command() {
    let help = stdout(&["--help"]);
    let commands: Vec<&str> = help
        .lines()
        .skip_while(|line| *line != "Commands:")
        .skip(1)
        .map_while(|line| line.strip_prefix("  ")?.split_whitespace().next())
        .collect();
    assert!(commands.contains(&"train") && commands.contains(&"completions"), "{help}");
    for shell in ["bash", "zsh", "fish"] {
        let script = stdout(&["completions", shell]);
        for word in commands.iter().chain(&["checkpoint", "schema"]) {
            assert!(script.contains(word), "{shell}: {word}");
        }
    }
}

#[test]
fn bash_takes_the_script() {
    let script = stdout(&["completions", "bash"])
        + "COMP_WORDS=(cartpole-dqn ev); COMP_CWORD=1
           for word in $(complete -p cartpole-dqn); do [ \"$previous\" = -F ] && function=$word; previous=$word; done
           $function cartpole-dqn ev cartpole-dqn; echo ${COMPREPLY[@]}";
    let completed = match Command::new("bash").args(["-c", &script]).output() {
        Ok(output) => output,
        Err(error) => return eprintln!("not checked, no bash: {error}"),
    };
    assert_eq!(String::from_utf8_lossy(&completed.stdout), "eval\n", "{completed:?}");
}

refusals! {
    refuses_config_without_a_command: [], ["config"] => ["Usage", "schema"];
    refuses_to_show_a_bad_config: [], ["config", "show", "--set", "gamma=2"] => ["`gamma` is 2", "from 0 to 1"];
    refuses_to_show_a_missing_config: [], ["config", "show", "--config", "no.json"] => ["no.json", "--config takes"];
    refuses_an_unknown_shell: [], ["completions", "ksh"] => ["ksh", "bash", "fish", "zsh"];
}
