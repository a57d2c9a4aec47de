//! A layer is the settings of one source. This module reads, checks and merges layers.

use std::collections::BTreeMap;
use std::fmt;
use std::iter::once;

use serde::Deserialize;
use serde::de::{Deserializer, MapAccess, Visitor};
use serde_json::{Map, Value, json};

use super::aliases::{hint, keys_in};
use super::keys::{Allowed, Choice, ENVIRONMENT, REMOVED, alternatives, find, member_of, pointer, whole};
use super::{AGENTS, Config, ConfigError};
use crate::env::Spec;
use crate::text::excerpt;

/// What is said to somebody who names an environment that is not built in.
pub(crate) const OTHER_ENVIRONMENTS: &str = "adapters/gymnasium.py is a program that plays Gymnasium's environments, \
     and configs/lunar_lander.json a config with it";

/// The keys that one source sets, each known and within its range.
pub(super) struct Layer {
    pub(super) origin: String,
    /// Path of a key → value.
    pub(super) values: BTreeMap<String, Value>,
}

impl Layer {
    pub(super) fn from_json(origin: &str, text: &str) -> Result<Self, ConfigError> {
        let Members(members) = serde_json::from_str(text.trim_start_matches('\u{feff}'))
            .map_err(|source| ConfigError::Json { origin: origin.into(), source })?;
        let mut layer = Self { origin: origin.into(), values: BTreeMap::new() };
        members.into_iter().try_for_each(|(key, node)| layer.insert(key, node))?;
        layer.checked()
    }

    /// `key=value`s of the option `origin`.
    pub(super) fn from_sets(origin: &str, sets: &[String]) -> Result<Self, ConfigError> {
        let mut layer = Self { origin: origin.into(), values: BTreeMap::new() };
        for set in sets {
            let (key, text) = set.split_once('=').ok_or_else(|| ConfigError::Set { set: shown(set) })?;
            let mut one = Self { origin: origin.into(), values: BTreeMap::new() };
            one.insert(key.into(), serde_json::from_str(text).unwrap_or_else(|_| Node::Leaf(text.into())))?;
            layer.values.extend(one.values);
        }
        layer.checked()
    }

    /// Adds what `node` holds. An object is also added as `{}` under its own path, so that a second one is noticed.
    fn insert(&mut self, key: String, node: Node) -> Result<(), ConfigError> {
        let value = match node {
            node if is_one_value(&key) => node.into(),
            Node::Leaf(value) => whole(value),
            Node::Object(Members(members)) => {
                let insert = |(name, member)| self.insert(format!("{key}.{name}"), member);
                members.into_iter().try_for_each(insert)?;
                json!({})
            }
        };
        match self.values.insert(key.clone(), value) {
            None => Ok(()),
            Some(_) => Err(key_error(&self.origin, "duplicate key", &key, "a key may come once".into())),
        }
    }

    /// Refuses the keys of another agent than the one whose defaults are `root`.
    pub(super) fn check_agent(&self, root: &Value) -> Result<(), ConfigError> {
        let belongs = |key: &str, root: &Value| {
            let is_in = |(group, _): &(&str, _)| key == *group || member_of(key, group).is_some();
            let known = |path: &str| root.pointer(&pointer(path)).is_some();
            let is_the_tasks = key.split('.').next() == Some(ENVIRONMENT);
            is_the_tasks || known(key) || alternatives().iter().any(|group| is_in(group) && known(group.0))
        };
        match self.values.keys().find(|key| !belongs(key, root)) {
            None => Ok(()),
            Some(key) => {
                let has_it = |agent: &&&str| belongs(key, &json!(Config::with_agent(agent)));
                let others: Vec<_> = AGENTS.iter().filter(has_it).map(|name| format!("\"{name}\"")).collect();
                let hint = format!(
                    "it belongs to the agent {}, and `agent` is {} here; a config is for one agent",
                    others.join(" or "),
                    root["agent"]
                );
                Err(misplaced(&self.origin, key, hint))
            }
        }
    }

    /// Checks the layer against the table of keys and leaves only what it sets.
    fn checked(mut self) -> Result<Self, ConfigError> {
        for &(key, neutral, hint) in REMOVED {
            if self.values.remove(key).is_some_and(|value| value != neutral) {
                return Err(key_error(&self.origin, "removed key", key, hint.into()));
            }
        }
        for (key, value) in &self.values {
            let members = keys_in(&format!("{key}."));
            let is_below = |other: &String| member_of(other, key).is_some();
            let is_empty = || value.is_object() && !self.values.keys().any(is_below);
            let allowed = match find(key).map(|known| &known.allowed) {
                // No name, and no program either.
                Some(allowed @ Allowed::NameOr(..)) if is_empty() => allowed.to_string(),
                Some(allowed) if allowed.admits(value) => continue,
                Some(allowed @ Allowed::NameOr(..)) => format!("{allowed}; {OTHER_ENVIRONMENTS}"),
                Some(allowed @ Allowed::Task) => {
                    let problem = serde_json::from_value::<Spec>(value.clone()).err();
                    format!("{allowed}: {}", problem.map_or_else(String::new, |error| error.to_string()))
                }
                Some(allowed) => allowed.to_string(),
                None if members.is_empty() => {
                    return Err(key_error(&self.origin, "unknown key", key, hint(key, value)));
                }
                None if value.is_object() => continue,
                None => format!("an object with {members}"),
            };
            return Err(invalid(&self.origin, key, value, allowed));
        }
        self.values.retain(|key, value| key != "$schema" && (!value.is_object() || is_one_value(key)));
        Ok(self)
    }
}

/// Merges one group. The last layer that names an alternative, sets null, or sets a key of only one alternative decides.
/// Keys that both alternatives have are kept from lower layers; the other keys of lower layers are dropped.
pub(super) fn choose(group: &str, alternatives: &[Choice], layers: &[Layer]) -> Result<Value, ConfigError> {
    let mut chosen = &alternatives[0];
    let mut values = Map::new();
    for Layer { origin, values: layer } in layers {
        let own = members_of(group, layer);
        let is_null = layer.contains_key(group);
        let same_name = |alternative: &&Choice| {
            let mut names = alternative.iter().filter(|(_, value)| value.is_string());
            names.all(|(key, name)| own.get(key).or(chosen.get(key)) == Some(name))
                && (alternative.is_empty() || !is_null)
        };
        let foreign_key = |alternative: &Map<_, _>| own.keys().find(|key| !alternative.contains_key(*key));
        let candidates: Vec<_> = once(chosen).chain(alternatives).filter(same_name).collect();
        chosen = candidates.iter().find(|candidate| foreign_key(candidate).is_none()).ok_or_else(|| {
            let nearest = candidates.first().unwrap_or(&chosen);
            let key = format!("{group}.{}", foreign_key(nearest).map_or("", String::as_str));
            let all = alternatives.iter().map(shape).collect::<Vec<_>>().join(" or ");
            misplaced(origin, &key, format!("`{group}` is {} here, and can be {all}", shape(nearest)))
        })?;
        values.extend(own);
        values.retain(|key, _| chosen.contains_key(key));
    }
    let merged: Map<_, _> = chosen.clone().into_iter().chain(values).collect();
    Ok(if merged.is_empty() { Value::Null } else { merged.into() })
}

/// What a layer sets below a group.
pub(super) fn members_of(group: &str, layer: &BTreeMap<String, Value>) -> Map<String, Value> {
    let member = |(path, value): (&String, &Value)| Some((member_of(path, group)?.into(), value.clone()));
    layer.iter().filter_map(member).collect()
}

/// Writes the keys of an alternative and its name, for messages: `{"kind": "hard", "every_steps"}`.
fn shape(alternative: &Choice) -> String {
    if alternative.is_empty() {
        return "null".into();
    }
    let shown = |(key, value): (&String, &Value)| match value {
        Value::String(name) => format!("\"{key}\": \"{name}\""),
        _ => format!("\"{key}\""),
    };
    format!("{{{}}}", alternative.iter().map(shown).collect::<Vec<_>>().join(", "))
}

/// Whether an object under this key is not a group of keys.
fn is_one_value(key: &str) -> bool {
    find(key).is_some_and(|known| matches!(known.allowed, Allowed::Task))
}

/// An object of JSON as a list, because a map would hide a duplicate key.
struct Members(Vec<(String, Node)>);

#[derive(Deserialize)]
#[serde(untagged)]
enum Node {
    Object(Members),
    Leaf(Value),
}

impl From<Node> for Value {
    fn from(node: Node) -> Self {
        match node {
            Node::Leaf(value) => value,
            Node::Object(Members(members)) => {
                members.into_iter().map(|(name, node)| (name, Self::from(node))).collect()
            }
        }
    }
}

impl<'de> Deserialize<'de> for Members {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Object;
        impl<'de> Visitor<'de> for Object {
            type Value = Members;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "an object with settings")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Members, A::Error> {
                std::iter::from_fn(|| map.next_entry().transpose()).collect::<Result<_, _>>().map(Members)
            }
        }
        deserializer.deserialize_map(Object)
    }
}

fn key_error(origin: &str, problem: &'static str, key: &str, hint: String) -> ConfigError {
    ConfigError::Key { origin: origin.into(), problem, key: shown(key), hint }
}

/// The error of a key that the value above it leaves no room for.
pub(super) fn misplaced(origin: &str, key: &str, hint: String) -> ConfigError {
    key_error(origin, "misplaced key", key, hint)
}

pub(super) fn invalid(origin: &str, key: &str, value: &Value, allowed: String) -> ConfigError {
    ConfigError::Value { origin: origin.into(), key: key.into(), value: shown(&value.to_string()), allowed }
}

pub(super) fn shown(text: &str) -> String {
    excerpt(text, 80)
}
