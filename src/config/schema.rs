//! What can be said of the keys: the JSON Schema of a config file, and a config explained key by key.

use std::borrow::Cow;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde_json::{Map, Value, json};

use super::keys::{KEYS, Key};
use super::layer::object;
use super::{Config, DEFAULT_SCHEDULE, alternatives};

/// The schema of a config *file*, in which every key may be left out. Of a path as a key (`"replay.capacity"`) it allows
/// any value, and it does not know what binds several keys.
impl JsonSchema for Config {
    fn schema_name() -> Cow<'static, str> {
        "Config of cartpole-dqn".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        members("", &json!(Config::default()))
    }
}

/// The schema of the object whose keys begin with `prefix`.
fn members(prefix: &str, defaults: &Value) -> Schema {
    let mut properties = Map::new();
    for key in KEYS {
        let Some(name) = key.path.strip_prefix(prefix).and_then(|rest| rest.split('.').next()) else {
            continue;
        };
        let path = format!("{prefix}{name}");
        if !properties.contains_key(name) {
            properties.insert(name.into(), member(&path, &defaults[name]).to_value());
        }
    }
    closed(properties)
}

fn member(path: &str, default: &Value) -> Schema {
    let below = format!("{path}.");
    let has_members = KEYS.iter().any(|key| key.path.starts_with(&below));
    match (find(path), alternatives(&Config::default()).into_iter().find(|(group, _)| *group == path)) {
        (Some(key), _) if has_members => {
            let schedule = members(&below, &json!(DEFAULT_SCHEDULE));
            described(json_schema!({"anyOf": [schedule, {"type": "null"}]}), key, default)
        }
        (Some(key), _) => described(key.allowed.schema(), key, default),
        (None, Some((_, shapes))) => {
            let shapes: Vec<Schema> =
                shapes.iter().map(|shape| alternative(&below, shape, &shapes[0])).collect();
            json_schema!({"anyOf": shapes})
        }
        (None, None) => members(&below, default),
    }
}

/// The schema of one of a group's alternatives. Those of another name than the first must give it.
fn alternative(prefix: &str, shape: &Map<String, Value>, first: &Map<String, Value>) -> Schema {
    let mut properties = Map::new();
    let mut required = Vec::new();
    for (name, value) in shape {
        let Some(key) = find(&format!("{prefix}{name}")) else { continue };
        let schema = if value.is_string() { json_schema!({"const": value}) } else { key.allowed.schema() };
        properties.insert(name.clone(), described(schema, key, value).to_value());
        if value.is_string() && first.get(name) != Some(value) {
            required.push(name);
        }
    }
    let mut schema = closed(properties);
    if !required.is_empty() {
        schema.insert("required".into(), json!(required));
    }
    schema
}

fn find(path: &str) -> Option<&'static Key> {
    KEYS.iter().find(|key| key.path == path)
}

fn described(mut schema: Schema, key: &Key, default: &Value) -> Schema {
    schema.insert("description".into(), key.meaning.into());
    // `$schema` has none.
    if key.path != "$schema" {
        schema.insert("default".into(), default.clone());
    }
    schema
}

/// An object with these members and no others, except paths.
fn closed(properties: Map<String, Value>) -> Schema {
    json_schema!({
        "type": "object",
        "properties": properties,
        "patternProperties": {"\\.": true},
        "additionalProperties": false,
    })
}

/// One key of a config.
#[derive(Clone, Debug, PartialEq)]
pub struct Setting {
    /// Its path, `group.name`.
    pub path: &'static str,
    /// What it holds.
    pub value: Value,
    /// What it would hold if nothing had set it.
    pub default: Value,
    /// What it decides.
    pub meaning: &'static str,
    /// What it may hold.
    pub allowed: String,
}

/// Every key that `--set` takes: its path, what it decides and, where there are only a few, its values.
pub fn keys() -> impl Iterator<Item = (&'static str, &'static str, Vec<&'static str>)> {
    let settable = KEYS.iter().filter(|key| key.path != "$schema");
    settable.map(|key| (key.path, key.meaning, key.allowed.names()))
}

impl Config {
    /// Every key that the config has, in the order of the documentation.
    pub fn settings(&self) -> Vec<Setting> {
        let (config, default) = (json!(self), json!(self.defaults()));
        let setting = |key: &Key| {
            let pointer = format!("/{}", key.path.replace('.', "/"));
            let value = config.pointer(&pointer).filter(|value| !value.is_object())?.clone();
            let default = default.pointer(&pointer).cloned().unwrap_or_default();
            let Key { path, meaning, ref allowed } = *key;
            Some(Setting { path, value, default, meaning, allowed: allowed.to_string() })
        };
        KEYS.iter().filter_map(setting).collect()
    }

    /// The defaults of the keys that this config has.
    fn defaults(&self) -> Value {
        let config = json!(self);
        let default = Config::default();
        let mut defaults = json!(default);
        for (group, shapes) in alternatives(&default) {
            let same_keys = |shape: &&Map<String, Value>| shape.keys().eq(object(&config[group]).keys());
            let Some(shape) = shapes.iter().find(same_keys) else { continue };
            for (name, value) in shape.iter().filter(|(_, value)| !value.is_string()) {
                defaults[group][name] = value.clone();
            }
        }
        if self.optimizer.schedule.is_some() {
            defaults["optimizer"]["schedule"] = json!(DEFAULT_SCHEDULE);
        }
        defaults
    }
}
