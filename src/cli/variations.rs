//! The configs of a study: every `--config` in every variation of `--vary`.

use std::path::PathBuf;

use serde_json::{Value, json};

use super::layers::{DEFAULT_NAME, config_name, read_config};
use super::ui::Failure;
use crate::config::{Config, ConfigError};
use crate::study::NamedConfig;
use crate::text::visible;

/// Most configs of a study, so that a slip of the keyboard does not fill the memory.
const MAX_CONFIGS: usize = 10_000;

/// What the configs of a study are made of.
#[derive(Debug, clap::Args)]
pub(super) struct Variations {
    /// Settings: a name that `config list` prints, a JSON file, or `-` for standard input; may be repeated [default: cartpole]
    #[arg(long, value_name = "NAME|FILE")]
    config: Vec<PathBuf>,
    /// Values of a config key to compare: KEY=V1,V2, or KEY=[V1, V2] as JSON if values hold commas; may be repeated
    #[arg(long, value_name = "KEY=VALUES", value_parser = variation)]
    vary: Vec<Variation>,
    /// Set one config key in all configs; may be repeated
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
}

#[derive(Clone, Debug)]
struct Variation {
    key: String,
    values: Vec<String>,
}

fn variation(text: &str) -> Result<Variation, String> {
    let (key, list) = text.split_once('=').ok_or("expected KEY=V1,V2 or KEY=[V1, V2]")?;
    let values: Vec<String> = if list.starts_with('[') {
        let values: Vec<Value> =
            serde_json::from_str(list).map_err(|error| format!("expected a JSON list: {error}"))?;
        values.iter().map(Value::to_string).collect()
    } else if list.starts_with('{') {
        return Err(format!("write objects as a JSON list: {key}=[{{…}}, {{…}}]"));
    } else {
        list.split(',').map(str::to_owned).collect()
    };
    if key == "seed" {
        Err("the seeds of a study are given by --seeds".into())
    } else if values.iter().any(String::is_empty) || values.is_empty() {
        Err("a value is missing".into())
    } else if values.iter().collect::<std::collections::BTreeSet<_>>().len() < values.len() {
        Err("a value is given twice; remove one".into())
    } else {
        Ok(Variation { key: key.into(), values })
    }
}

pub(super) fn configs(arguments: &Variations) -> Result<Vec<NamedConfig>, Failure> {
    let bad = |problem: String| Err(Failure::BadInput(problem));
    let read = |path: &PathBuf| {
        let (origin, text) = read_config(path)?;
        Ok((config_name(path), visible(&origin), text))
    };
    let mut sources = arguments.config.iter().map(read).collect::<Result<Vec<_>, Failure>>()?;
    if sources.is_empty() {
        sources.push((DEFAULT_NAME.into(), "the default config".into(), "{}".into()));
    }
    if arguments.set.iter().any(|set| set.starts_with("seed=")) {
        return bad("--set seed: the seeds of a study are given by --seeds".into());
    }
    for Variation { key, .. } in &arguments.vary {
        let is_below = |set: &str| set.strip_prefix(key).is_some_and(|rest| rest.starts_with(['=', '.']));
        if let Some(set) = arguments.set.iter().find(|set| is_below(set)) {
            let set = visible(set);
            return bad(format!("--vary {key} overwrites --set {set}; give one of the two"));
        }
    }
    let variations = combinations(&arguments.vary, MAX_CONFIGS / sources.len())?;
    let mut configs: Vec<NamedConfig> = Vec::new();
    let mut programs = super::permission::SharedPrograms::default();
    for (stem, origin, text) in &sources {
        let mut seen = std::collections::BTreeMap::new();
        for variation in &variations {
            let varied = variation.join(" ");
            let name = if varied.is_empty() { stem.clone() } else { format!("{stem} {varied}") };
            let config = Config::variation(Some((origin, text)), &arguments.set, variation);
            let mut config = config.map_err(|error| match error {
                // The only one whose reason the variation may be.
                ConfigError::Key { problem: "misplaced key", .. } | ConfigError::Value { .. }
                    if !variation.is_empty() =>
                {
                    Failure::BadInput(format!("variation {varied}: {error}"))
                }
                error => error.into(),
            })?;
            // Two spellings of one value, such as 0.9 and 0.90, would train the same config twice.
            if let Some(other) = seen.insert(json!(config).to_string(), varied.clone()) {
                return bad(format!("--vary: {other} and {varied} are the same config; leave one out"));
            }
            if configs.iter().any(|other| other.name == name) {
                return bad(format!("--config {origin}: two configs are called {stem:?}; rename a file"));
            }
            programs.share(&mut config.environment, |program| {
                super::permission::allow(program, false);
                Ok::<_, Failure>(())
            })?;
            config.ask_task()?;
            configs.push(NamedConfig::new(name, config)?);
        }
    }
    Ok(configs)
}

/// The cross product of the variations, each as `key=value`s.
fn combinations(vary: &[Variation], limit: usize) -> Result<Vec<Vec<String>>, Failure> {
    let mut products = vec![Vec::new()];
    for (i, Variation { key, values }) in vary.iter().enumerate() {
        if vary[..i].iter().any(|other| other.key == *key) {
            return Err(Failure::BadInput(format!(
                "--vary {key} is given twice; put all its values into one --vary"
            )));
        }
        if products.len().saturating_mul(values.len()) > limit {
            return Err(Failure::BadInput(format!("--vary makes more than {MAX_CONFIGS} configs")));
        }
        let with = |product: &[String], value| [product, &[format!("{key}={value}")]].concat();
        let extend = |product: &Vec<String>| values.iter().map(|one| with(product, one)).collect::<Vec<_>>();
        products = products.iter().flat_map(extend).collect();
    }
    Ok(products)
}
