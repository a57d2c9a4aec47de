//! The config of a run: defaults < config file < `--set key.path=value`.
//!
//! Each `Layer` is read as a flat map (`"budget.steps"` → value) and checked against one table, `KEYS`. The layers are
//! then merged into a [`Config`], and the rules that concern several keys are checked last. A new key is a field, its
//! default and a line of `KEYS`. Messages, `config show`, the JSON Schema and the table in docs/configuration.md follow
//! from that line. A new alternative of a group is a line of `keys::alternatives`.

mod aliases;
mod difference;
mod dqn;
mod environment;
mod keys;
mod layer;
mod schema;
mod shipped;
mod table;

use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use keys::{alternatives, pointer};
use layer::{Layer, choose, invalid};

use crate::agent::{Agent, AgentConfig, Exploration};
use crate::env::catalogue::EnvironmentId;
use crate::env::{EnvironmentError, Make, Spec};
use crate::memory::check_memory;
use crate::text::excerpt;
use crate::trainer::{Budget, CheckpointConfig, EvaluationConfig, Trainer, TrainerConfig};

pub(crate) use aliases::meanings;
pub(crate) use difference::difference;
pub(crate) use environment::EnvironmentConfig;
pub(crate) use layer::OTHER_ENVIRONMENTS;
pub(crate) use schema::Setting;
pub use schema::{keys, markdown_table, schema};
pub(crate) use shipped::nearest_shipped;
pub use shipped::{SHIPPED, shipped};

/// Largest config that is read, in bytes.
pub(crate) const MAX_BYTES: u64 = 1 << 20;
/// Most memory that a config may ask for, in bytes.
const MAX_MEMORY: u64 = 8 << 30;

/// The agents' names, as `agent` has them, and all of them, the default agent first.
const DQN: &str = "dqn";
const Q_TABLE: &str = "q_table";
const AGENTS: &[&str] = &[DQN, Q_TABLE];

/// A rule between keys, or a key and the task: whether it holds; the key, its value and what is allowed if it does not.
type Rule = (bool, &'static str, Value, String);

/// What an agent adds to the rules of a config.
trait AgentRules {
    /// The rules between several of its keys.
    fn rules(&self, _config: &Config) -> Vec<Rule> {
        Vec::new()
    }

    fn task_rules(&self, task: &Spec) -> Vec<Rule>;

    /// The memory that the agent takes for a task of these sizes.
    fn memory(&self, observation_size: usize, num_actions: usize) -> AgentMemory;

    /// The keys that decide this, with their values, for messages.
    fn sizes(&self) -> String;
}

/// The rule of the key that makes use of the task's mirror image.
fn mirror_rule(key: &'static str, is_used: bool, task: &Spec) -> Rule {
    let allowed = format!("false, because {} is not known to be its own mirror image", task.id);
    (!is_used || task.mirror.is_some(), key, json!(true), allowed)
}

/// About how many bytes the large parts of an agent take.
#[derive(Default)]
struct AgentMemory {
    /// The replay memory, and a transition in it.
    replay: u64,
    transition: u64,
    /// What learns: networks with their gradient and Adam's moments, or a table.
    learned: u64,
    /// The activations of a batch.
    batch: u64,
}

/// Everything that decides a run. The fields are the keys of the JSON file, which `keys.rs` explains.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Config {
    pub seed: u64,
    pub(crate) environment: EnvironmentConfig,
    pub max_episode_steps: Option<u32>,
    #[serde(flatten)]
    pub agent: AgentConfig,
    pub budget: Budget,
    pub evaluation: EvaluationConfig,
    pub(crate) checkpoint: CheckpointConfig,
    pub(crate) stop_when_solved: bool,
    pub stop_when_lasting_steps: Option<u32>,
}

/// `configs/cartpole.json`.
impl Default for Config {
    fn default() -> Self {
        Self {
            seed: 0,
            environment: EnvironmentConfig::Named(EnvironmentId::CartPoleV1),
            max_episode_steps: Some(10_000),
            agent: AgentConfig::Dqn(dqn::default()),
            budget: Budget::Steps(40_000),
            evaluation: EvaluationConfig { every_steps: 500, episodes: 20 },
            checkpoint: CheckpointConfig { every_steps: 10_000 },
            stop_when_solved: false,
            stop_when_lasting_steps: Some(5000),
        }
    }
}

/// Why there is no config. An `origin` is the name of a file, or `--set`.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    #[error("cannot read {}: {source}", path.display())]
    Read { path: PathBuf, source: io::Error },
    #[error("no config that comes with the program is called `{name}`; {hint}")]
    Name { name: String, hint: String },
    /// Not JSON, or not an object; the source says where and why.
    #[error("{origin}: {source}")]
    Json { origin: String, source: serde_json::Error },
    #[error("--set {set}: expected key.path=value, for example --set gamma=0.9")]
    Set { set: String },
    /// A key that is unknown, comes twice or belongs to another alternative.
    #[error("{origin}: {problem} `{key}`; {hint}")]
    Key { origin: String, problem: &'static str, key: String, hint: String },
    #[error("{origin}: `{key}` is {value}; allowed: {allowed}")]
    Value { origin: String, key: String, value: String, allowed: String },
    #[error(transparent)]
    Environment(#[from] EnvironmentError),
}

impl Config {
    fn with_agent(name: &str) -> Self {
        Self::default_of(name, &json!(Self::default().environment))
    }

    /// The default with another agent and task, without what they cannot have: a mirror image, the test of a lasting policy.
    fn default_of(agent: &str, environment: &Value) -> Self {
        let (mut config, mut dqn) = (Self::default(), dqn::default());
        if *environment != json!(config.environment) {
            let named = serde_json::from_value::<EnvironmentId>(environment.clone());
            dqn.replay.mirror = named.is_ok_and(|id| id.spec().mirror.is_some());
            config.stop_when_lasting_steps = None;
        }
        config.agent = match agent {
            Q_TABLE => table::default(&dqn),
            _ => AgentConfig::Dqn(dqn),
        };
        config
    }

    /// Merges the defaults, a file (its name for messages, and its text) and the `key.path=value`s of `--set`, which
    /// together are one layer. A value is JSON if it parses as JSON, or else a string.
    pub fn from_layers(file: Option<(&str, &str)>, sets: &[String]) -> Result<Self, ConfigError> {
        Self::variation(file, sets, &[])
    }

    /// As [`Self::from_layers`], with the `key.path=value`s of `--vary` in the layer of `--set`.
    pub(crate) fn variation(
        file: Option<(&str, &str)>, sets: &[String], varied: &[String],
    ) -> Result<Self, ConfigError> {
        let file = file.map(|(name, text)| Layer::from_json(name, text)).transpose()?;
        let mut layers: Vec<_> = file.into_iter().collect();
        let given = [("--set", sets), ("--vary", varied)].into_iter().filter(|(_, sets)| !sets.is_empty());
        let given = given.map(|(name, sets)| Layer::from_sets(name, sets)).collect::<Result<Vec<_>, _>>()?;
        layers.extend(given.into_iter().reduce(|below, above| Layer {
            origin: format!("{} and {}", below.origin, above.origin),
            values: below.values.into_iter().chain(above.values).collect(),
        }));
        let agent = layers.iter().rev().find_map(|layer| layer.values.get("agent"));
        let environment = environment::merged(&Self::default().environment, &layers)?;
        let mut root = json!(Self::default_of(agent.and_then(Value::as_str).unwrap_or(DQN), &environment));
        layers.iter().try_for_each(|layer| layer.check_agent(&root))?;
        for (key, value) in layers.iter().flat_map(|layer| &layer.values) {
            // Only a key of an alternative can be missing in the default; those are merged below.
            if let Some(slot) = root.pointer_mut(&pointer(key)) {
                *slot = value.clone();
            }
        }
        for (group, alternatives) in alternatives() {
            if let Some(slot) = root.pointer_mut(&pointer(group)) {
                *slot = choose(group, &alternatives, &layers)?;
            }
        }
        root[keys::ENVIRONMENT] = environment;
        let origin = layers.iter().map(|layer| layer.origin.as_str()).collect::<Vec<_>>().join(" with ");
        let config: Self = serde_json::from_value(root)
            .map_err(|source| ConfigError::Json { origin: origin.clone(), source })?;
        config.check(&origin)?;
        Ok(config)
    }

    /// Asks a program for its task, checks the config against it and keeps it. An environment of this crate needs no question.
    pub(crate) fn ask_task(&mut self) -> Result<(), ConfigError> {
        self.environment.ask()?;
        self.check(&excerpt(&self.environment.command().unwrap_or_default(), 200))
    }

    fn check(&self, origin: &str) -> Result<(), ConfigError> {
        let (Exploration::PerEpisode { initial, final_, .. } | Exploration::Linear { initial, final_, .. }) =
            self.agent.exploration();
        let allowed = format!("at most `exploration.initial`, which is {}", json!(initial));
        let mut rules = vec![(final_ <= initial, "exploration.final", json!(final_), allowed)];
        rules.extend(self.rules().rules(self));
        // The task of a program is checked once it is known.
        rules.extend(self.environment.spec().map_or(Vec::new(), |task| self.rules().task_rules(&task)));
        match rules.into_iter().find(|(holds, ..)| !holds) {
            Some((_, key, value, allowed)) => Err(invalid(origin, key, &value, allowed)),
            None => Ok(()),
        }
    }

    fn rules(&self) -> &dyn AgentRules {
        match &self.agent {
            AgentConfig::Dqn(dqn) => dqn,
            AgentConfig::QTable(table) => table,
        }
    }

    /// The memory that the agent takes; for the smallest task as long as nothing is known of the task.
    fn memory(&self) -> AgentMemory {
        let sizes = self.environment.spec().map(|task| (task.observation_size, task.num_actions));
        let (observation_size, num_actions) = sizes.unwrap_or((1, 1));
        self.rules().memory(observation_size, num_actions)
    }

    /// Whether the system has the memory that so many runs at the same time take, each with a checkpoint of what it can
    /// fill of its replay memory: an allocation that fails in the middle of a run would end the process.
    ///
    /// # Errors
    /// When it has not; the message says how much it takes and what would make it less.
    pub fn check_memory(&self, runs: usize) -> Result<(), String> {
        let AgentMemory { replay, transition, learned, batch } = self.memory();
        let filled = match self.budget {
            Budget::Steps(steps) => replay.min(steps.saturating_mul(transition)),
            Budget::Episodes(_) => replay,
        };
        // A checkpoint is put together, and then written from one piece.
        let run = [replay / 3 * 2, replay / 3, learned, batch, filled + learned, filled + learned];
        check_memory(std::iter::repeat_n(run, runs).flatten()).map_err(|_| {
            let mib = (run.iter().sum::<u64>() >> 20) + 1;
            let sizes = self.rules().sizes();
            format!(
                "not enough memory: a run takes up to {mib} MiB with {sizes}; make these smaller, or give the process more \
                 memory"
            )
        })
    }

    pub fn make(&self) -> Arc<Make> {
        self.environment.make()
    }

    pub(crate) fn make_agent(&self, spec: &Spec) -> Box<dyn Agent> {
        self.agent.make(spec.observation_size, spec.num_actions, spec.mirror.as_ref(), self.seed)
    }

    /// The run in its own environment, before its first step.
    pub fn make_trainer(&self) -> Result<Trainer, EnvironmentError> {
        self.make_trainer_in(self.make())
    }

    /// The run in the environment that `make` makes, before its first step.
    pub fn make_trainer_in(&self, make: Arc<Make>) -> Result<Trainer, EnvironmentError> {
        Trainer::new(self.trainer(), |spec| self.make_agent(spec), make)
    }

    pub fn trainer(&self) -> TrainerConfig {
        // Where the task is not known, the run cannot be made.
        let own_limit = || self.environment.spec().map_or(1, |task| task.max_steps);
        TrainerConfig {
            seed: self.seed,
            max_episode_steps: self.max_episode_steps.unwrap_or_else(own_limit),
            budget: self.budget,
            evaluation: self.evaluation.clone(),
            checkpoint: self.checkpoint.clone(),
            stop_when_solved: self.stop_when_solved,
            stop_when_lasting_steps: self.stop_when_lasting_steps,
        }
    }
}

/// Reads a config file of at most 1 MiB.
pub fn read_file(path: &Path) -> Result<String, ConfigError> {
    File::open(path).and_then(read).map_err(|source| ConfigError::Read { path: path.into(), source })
}

/// Reads the text of a config of at most 1 MiB.
pub fn read(source: impl Read) -> io::Result<String> {
    let mut bytes = Vec::new();
    source.take(MAX_BYTES + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > MAX_BYTES {
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, "larger than 1 MiB"));
    }
    String::from_utf8(bytes).map_err(|error| io::Error::new(io::ErrorKind::InvalidData, error))
}
