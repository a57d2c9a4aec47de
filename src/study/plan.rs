//! The plan of a study: which configs are trained with which seeds. Its file is `study.json`.

use std::collections::BTreeSet;
use std::io;
use std::ops::Range;
use std::path::Path;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::StudyError;
use crate::config::{Config, difference};
use crate::env::{Answer, Spec};
use crate::files::{Directory, create_directories, if_there, is_unfinished, read_text_limited, remove_empty};
use crate::run::names::MANIFEST;

pub const FORMAT_VERSION: u32 = 2;
/// Most seeds of a study: a mistyped number must not fill the memory.
pub(crate) const MAX_SEEDS: u64 = 1_000_000;
const MAX_FILE_SIZE: u64 = 1 << 26;

/// What a study runs. Serialised it is the manifest, `study.json`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Study {
    pub(crate) format_version: u32,
    /// The program's version: another one may train with other bits.
    pub(crate) version: String,
    pub(crate) configs: Vec<NamedConfig>,
    pub(crate) seeds: Range<u64>,
    /// Whether its trials test if policies last [`super::LASTING_STEPS`] steps.
    #[serde(rename = "endurance", default, skip_serializing_if = "std::ops::Not::not")]
    pub(crate) lasting: bool,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct NamedConfig {
    pub name: String,
    /// The config; its seed is 0, and each trial puts its own there.
    pub config: Config,
    /// Its task: a report needs the threshold, and starts no environment.
    pub task: Spec,
}

impl NamedConfig {
    pub fn new(name: String, config: Config) -> Answer<Self> {
        Ok(Self { name, task: config.environment.spec()?, config })
    }

    /// Whether the task is that of the config's environment. The map, which only a page shows, is not compared.
    fn has_its_own_task(&self) -> bool {
        let own = self.config.environment.spec();
        own.is_ok_and(|own| Spec { map: None, ..own } == Spec { map: None, ..self.task.clone() })
    }
}

/// A part of a study: every `count`-th trial, from number `index` on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    index: usize,
    count: usize,
}

impl Shard {
    pub const ALL: Self = Self { index: 0, count: 1 };
}

impl FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
        let shard = parts.map(|(index, count)| Self { index, count });
        shard.filter(|shard| shard.index < shard.count).ok_or_else(|| {
            "expected I/N with integers, I from 0 to N − 1, for example 0/4, 1/4, 2/4 and 3/4".into()
        })
    }
}

impl Study {
    pub fn new(mut configs: Vec<NamedConfig>, seeds: Range<u64>, lasting: bool) -> Self {
        configs.iter_mut().for_each(|named| named.config.seed = 0);
        let version = env!("CARGO_PKG_VERSION").into();
        Self { format_version: FORMAT_VERSION, version, configs, seeds, lasting }
    }

    /// Every trial of a part as (index of its config, seed). Configs take turns, so that an unfinished study has the same seeds of all.
    pub fn trials(&self, shard: Shard) -> impl Iterator<Item = (usize, u64)> {
        let all = self.seeds.clone().flat_map(|seed| (0..self.configs.len()).map(move |i| (i, seed)));
        all.skip(shard.index).step_by(shard.count)
    }

    pub(crate) fn is_in(&self, shard: Shard, (config, seed): (usize, u64)) -> bool {
        let number = u128::from(seed - self.seeds.start) * self.configs.len() as u128 + config as u128;
        number % shard.count as u128 == shard.index as u128
    }

    pub(crate) fn total(&self) -> u64 {
        (self.configs.len() as u64).saturating_mul(self.seeds.end.saturating_sub(self.seeds.start))
    }

    /// The study in a directory, which another version of this program may have written.
    pub fn read(path: &Path) -> Result<Self, StudyError> {
        let bad = |problem: String| StudyError::directory(path, problem);
        let manifest = read_manifest(path).map_err(bad)?;
        let study: Self = serde_json::from_value(manifest).map_err(|error| bad(not_a_study(&error)))?;
        let names: BTreeSet<&str> = study.configs.iter().map(|named| named.name.as_str()).collect();
        if names.is_empty() || names.contains("") || names.len() < study.configs.len() {
            return Err(bad(not_a_study(&"it has no config, or one without a name, or two of one name")));
        }
        if let Some(named) = study.configs.iter().find(|named| !named.has_its_own_task()) {
            let name = crate::text::excerpt(&named.name, 100);
            return Err(bad(not_a_study(&format!("the task of `{name}` is not that of its environment"))));
        }
        let Range { start, end } = study.seeds;
        if end.checked_sub(start).is_none_or(|seeds| seeds > MAX_SEEDS) {
            return Err(bad(not_a_study(&format!(
                "its seeds are {start}..{end}; at most {MAX_SEEDS} in ascending order are allowed"
            ))));
        }
        Ok(study)
    }

    pub(super) fn check(&self) -> Result<(), String> {
        let (version, own) = (&self.version, env!("CARGO_PKG_VERSION"));
        if version != own {
            return Err(format!(
                "holds a study of version {version}, and this is version {own}, which may train with other bits; use that \
                 version, or begin the study again elsewhere"
            ));
        }
        for NamedConfig { name, config, .. } in &self.configs {
            Config::from_layers(Some((name, &json!(config).to_string())), &[])
                .map_err(|error| format!("has a {MANIFEST} with a config that is not allowed: {error}"))?;
        }
        Ok(())
    }

    /// Writes the plan into the directory of a new study, or of the same study, which may have had fewer seeds.
    ///
    /// Two processes may do so at the same time: the second compares its plan with that of the first.
    pub(super) fn write(&self, path: &Path) -> Result<(), StudyError> {
        let bad = |problem: String| StudyError::directory(path, problem);
        let unwritable = |source: io::Error| StudyError::Unwritable(path.into(), source);
        let manifest = path.join(MANIFEST);
        if is_free(path).map_err(bad)? {
            let made = create_directories(path).map_err(unwritable)?;
            let written = Directory::open(path).and_then(|dir| dir.write_json_new(&manifest, self));
            // Another process may have been faster; whether it runs the same study is seen below.
            if let Err(error) = written
                && error.kind() != io::ErrorKind::AlreadyExists
            {
                remove_empty(&made);
                return Err(unwritable(error));
            }
        }
        match self.has_more_seeds_than(&read_manifest(path).map_err(bad)?).map_err(bad)? {
            true => Directory::open(path).and_then(|dir| dir.write_json(&manifest, self)).map_err(unwritable),
            false => Ok(()),
        }
    }

    /// Whether a study is the one of the manifest `found` with more seeds; an error if it is another study.
    fn has_more_seeds_than(&self, found: &Value) -> Result<bool, String> {
        let mut given = json!(self);
        let bound = |name: &str| found["seeds"][name].as_u64();
        let (start, end) = (bound("start"), bound("end"));
        let grows = start == Some(self.seeds.start) && end.is_some_and(|end| end < self.seeds.end);
        if grows {
            given["seeds"] = found["seeds"].clone();
        }
        match difference("", found, &given) {
            None => Ok(grows),
            Some(difference) => Err(format!(
                "holds another study: {difference}. To continue that study, repeat its command, which may add seeds at the \
                 end. Otherwise choose another --out"
            )),
        }
    }
}

fn not_a_study(error: &dyn std::fmt::Display) -> String {
    format!("has a {MANIFEST} that does not describe a study: {error}")
}

fn read_manifest(path: &Path) -> Result<Value, String> {
    let unread = |error: io::Error| match error.kind() {
        io::ErrorKind::NotFound => format!("does not hold a study: it has no {MANIFEST}"),
        _ => format!("has a {MANIFEST} that cannot be read: {error}"),
    };
    let text = read_text_limited(&path.join(MANIFEST), MAX_FILE_SIZE).map_err(unread)?;
    let manifest: Value = serde_json::from_str(&text).map_err(|error| not_a_study(&error))?;
    match &manifest["format_version"] {
        version if *version == FORMAT_VERSION => Ok(manifest),
        Value::Number(version) => Err(format!(
            "has a {MANIFEST} with format_version {version}, and this program reads {FORMAT_VERSION}; train the study \
             again in another directory, or use the program that wrote it"
        )),
        _ => Err(not_a_study(&"it has no format_version")),
    }
}

/// Whether a new study can take the directory; an error if neither that nor a study is in it.
fn is_free(path: &Path) -> Result<bool, String> {
    let found = if_there(std::fs::read_dir(path).and_then(Iterator::collect::<io::Result<Vec<_>>>));
    let found =
        found.map_err(|error| format!("cannot be used for a study: {error}; choose another --out"))?;
    if found.iter().flatten().all(|entry| is_unfinished(&entry.file_name())) {
        Ok(true)
    } else if path.join(MANIFEST).is_file() {
        Ok(false)
    } else {
        Err(format!("is not empty and does not hold a study (no {MANIFEST}); choose another --out"))
    }
}
