//! What is printed from the keys: the JSON Schema, the table of the documentation, and a config explained key by key.

use std::fmt::Write;

use serde_json::{Map, Value, json};

use super::environment::program_defaults;
use super::keys::{
    Allowed, Choice, ENVIRONMENT as KEY, KEYS, Key, alternatives, find, member_of, object, pointer,
};
use super::{AGENTS, Config, DQN};

/// The JSON Schema of a config *file*, in which every key may be left out. It allows any value for a path as a key
/// (`"replay.capacity"`), and it does not know the rules that concern several keys.
pub fn schema() -> Value {
    let mut schema = object(json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Config of cartpole-dqn",
    }));
    schema.extend(object(members("", &every_default())));
    schema.into()
}

/// The defaults of the keys of every agent. For a shared key, the default agent's value.
fn every_default() -> Value {
    AGENTS.iter().rev().flat_map(|agent| object(Config::with_agent(agent))).collect()
}

/// The schema of the object whose keys begin with `prefix`.
fn members(prefix: &str, defaults: &Value) -> Value {
    let mut properties = Map::new();
    for key in KEYS {
        let Some(name) = key.path.strip_prefix(prefix).and_then(|rest| rest.split('.').next()) else {
            continue;
        };
        let path = format!("{prefix}{name}");
        if !properties.contains_key(name) {
            properties.insert(name.into(), member(&path, &defaults[name]));
        }
    }
    closed(properties)
}

fn member(path: &str, default: &Value) -> Value {
    let below = format!("{path}.");
    match (find(path), alternatives().into_iter().find(|(group, _)| *group == path)) {
        (Some(key), None) => match &key.allowed {
            &Allowed::NameOr(names, _) => {
                let mut program = members(&below, &json!(program_defaults()));
                program["required"] = json!(["command"]);
                described(key, json!({"anyOf": [Allowed::OneOf(names).schema(), program]}), default)
            }
            allowed => described(key, allowed.schema(), default),
        },
        (None, None) => members(&below, default),
        (None, Some((_, shapes))) => {
            let schema = |shape| alternative(&below, shape, &shapes[0]);
            json!({"anyOf": shapes.iter().map(schema).collect::<Vec<_>>()})
        }
        // A group that has a line in `KEYS` is null or one object.
        (Some(key), Some((_, shapes))) => {
            let object = members(&below, &json!(shapes.last()));
            described(key, json!({"anyOf": [object, {"type": "null"}]}), default)
        }
    }
}

/// The schema of one of a group's alternatives. It requires the name unless the first alternative has the same name.
fn alternative(prefix: &str, shape: &Choice, first: &Choice) -> Value {
    let mut properties = Map::new();
    let mut required = Vec::new();
    for (name, value) in shape {
        let Some(key) = find(&format!("{prefix}{name}")) else { continue };
        let schema = if value.is_string() { json!({"const": value}) } else { key.allowed.schema() };
        properties.insert(name.clone(), described(key, schema, value));
        if value.is_string() && first.get(name) != Some(value) {
            required.push(name);
        }
    }
    let mut schema = closed(properties);
    if !required.is_empty() {
        schema["required"] = json!(required);
    }
    schema
}

fn described(key: &Key, schema: Value, default: &Value) -> Value {
    let mut described = object(json!({"description": key.meaning}));
    described.extend(object(schema));
    // Some keys have no default.
    if key.allowed.admits(default) {
        described.insert("default".into(), default.clone());
    }
    described.into()
}

/// The schema of an object with these members and no others, except paths.
fn closed(properties: Map<String, Value>) -> Value {
    json!({
        "type": "object",
        "properties": properties,
        "patternProperties": {"\\.": true},
        "additionalProperties": false,
    })
}

/// The table of all keys in docs/configuration.md, in Markdown.
pub fn markdown_table() -> String {
    let mut table =
        String::from("| key | meaning | unit | allowed | default |\n| --- | --- | --- | --- | --- |\n");
    for Key { path, allowed, unit, meaning } in KEYS {
        let unit = if unit.is_empty() { "–" } else { unit };
        let default = default_of(path).map_or("–".into(), |default| format!("`{default}`"));
        // Writing to a string cannot fail.
        let _ = writeln!(table, "| `{path}` | {meaning} | {unit} | {allowed} | {default} |");
    }
    table
}

/// The default of a key. `budget.episodes` has none: a config chooses that alternative only by setting the key.
fn default_of(path: &str) -> Option<Value> {
    let names = |one: &Choice| one.values().filter(|value| value.is_string()).cloned().collect::<Vec<_>>();
    for (group, shapes) in alternatives() {
        let Some(name) = member_of(path, group) else { continue };
        let shape = shapes.iter().find(|shape| shape.contains_key(name))?;
        let first = shapes.iter().find(|first| !first.is_empty() && names(first) == names(shape))?;
        return first.get(name).cloned();
    }
    if let Some(name) = member_of(path, KEY) {
        return program_defaults().get(name).cloned();
    }
    every_default().pointer(&pointer(path)).cloned()
}

/// One key of a config.
#[derive(Clone, Debug, PartialEq)]
pub struct Setting {
    pub path: &'static str,
    pub value: Value,
    /// The value that the key has if no layer sets it.
    pub default: Value,
    pub meaning: &'static str,
    /// The allowed values, in words.
    pub allowed: String,
}

/// Every key that `--set` takes: its path, its meaning and, where there are only a few, its values.
pub fn keys() -> impl Iterator<Item = (&'static str, &'static str, Vec<&'static str>)> {
    KEYS.iter().filter(|key| key.path != "$schema").map(|key| (key.path, key.meaning, key.allowed.names()))
}

impl Config {
    /// Every key that the config has, in the order of the documentation.
    pub fn settings(&self) -> Vec<Setting> {
        let (config, default) = (json!(self), json!(self.defaults()));
        let setting = |key: &Key| {
            let Key { path, meaning, ref allowed, .. } = *key;
            let value = config.pointer(&pointer(path)).filter(|value| !value.is_object())?.clone();
            let default = default.pointer(&pointer(path)).cloned().unwrap_or_default();
            Some(Setting { path, value, default, meaning, allowed: allowed.to_string() })
        };
        KEYS.iter().filter_map(setting).collect()
    }

    /// The defaults of the keys that this config has, those of its alternatives included.
    fn defaults(&self) -> Value {
        let config = json!(self);
        let mut defaults = json!(Config::default_of(config["agent"].as_str().unwrap_or(DQN), &config[KEY]));
        if config[KEY].is_object() {
            defaults[KEY] = program_defaults().into();
        }
        for (group, shapes) in alternatives() {
            let (Some(own), Some(group)) =
                (config.pointer(&pointer(group)), defaults.pointer_mut(&pointer(group)))
            else {
                continue;
            };
            let own = object(own);
            let same_keys = |shape: &Choice| shape.keys().eq(own.keys());
            let shape = shapes.into_iter().find(same_keys).unwrap_or_default();
            for (name, value) in shape.into_iter().filter(|(_, value)| !value.is_string()) {
                group[name] = value;
            }
        }
        defaults
    }
}
