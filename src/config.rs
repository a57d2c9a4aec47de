//! The config of a run: defaults < config file < `--set key.path=value`.
//!
//! Each `Layer` is read as a flat map (`"budget.steps"` → value) and checked against one table, `KEYS`; they are
//! then merged into a [`Config`], and what binds several keys is checked last. A new key is a field, its default and
//! a line of `KEYS`, from which the JSON Schema and `config show` follow; a new alternative of a group is a line of
//! `alternatives`.

mod difference;
mod keys;
mod layer;
mod schema;

use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

use keys::Allowed;
use layer::{Layer, choose, choose_or_null, invalid, object};

use crate::agent::{
    DqnConfig, Exploration, LearnConfig, PolicyWeights, ReplayConfig, TargetUpdate, UpdateMode,
};
use crate::env::{CartPole, Environment, EnvironmentId, TimeLimit};
use crate::files::check_memory;
use crate::nn::{Init, LearningRateSchedule, Loss, NetworkConfig, OptimizerConfig};
use crate::trainer::{Budget, CheckpointConfig, EvaluationConfig};

pub use difference::difference;
pub use keys::key_paths;
pub use schema::{Setting, keys};

/// Largest config that is read, in bytes.
pub const MAX_BYTES: u64 = 1 << 20;
/// Most memory that a config may ask for, in bytes.
const MAX_MEMORY: u64 = 8 << 30;

/// Everything that decides a run. The fields are the keys of the JSON file; the default is plain DQN.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Seed of every random stream of the run, 0…2⁶⁴ − 1.
    pub seed: u64,
    /// The task.
    pub environment: EnvironmentId,
    /// Steps after which an episode of training or of an evaluation during training is truncated, 1…1,000,000.
    pub max_episode_steps: u32,
    /// The Q-network.
    pub network: NetworkConfig,
    /// Adam, the schedule of its step size and the limit of the gradient.
    pub optimizer: OptimizerConfig,
    /// The loss of a TD error.
    pub loss: Loss,
    /// Discount factor per step, 0…1.
    pub gamma: f64,
    /// Steps of reward before a target bootstraps, 1…100 (Sutton 1988; Mnih et al. 2016).
    pub n_step: usize,
    /// Whether the online network chooses the action that the target network values (van Hasselt et al. 2016).
    pub double: bool,
    /// The replay memory and how it is used.
    pub replay: ReplayConfig,
    /// When to learn.
    pub learn: LearnConfig,
    /// The schedule of ε.
    pub exploration: Exploration,
    /// The target network.
    pub target: TargetUpdate,
    /// Whether a truncated transition zeroes the bootstrap as a terminated one does (the tutorial's mistake).
    pub truncation_is_terminal: bool,
    /// What each coordinate of an observation is divided by, 1e-30…1e30; null for nothing.
    pub observation_divisors: Option<Vec<f64>>,
    /// What rewards are multiplied by before they are stored, 1e-30…1e30.
    pub reward_scale: f64,
    /// The weights that are evaluated and saved as the policy.
    pub policy_weights: PolicyWeights,
    /// When the run ends.
    pub budget: Budget,
    /// The greedy evaluations during training.
    pub evaluation: EvaluationConfig,
    /// How often `checkpoints/last.safetensors` is written.
    pub checkpoint: CheckpointConfig,
    /// Whether the run ends at the first evaluation that solves the task.
    pub stop_when_solved: bool,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            seed: 0,
            environment: EnvironmentId::CartPoleV1,
            max_episode_steps: CartPole::MAX_STEPS,
            network: NetworkConfig { hidden: vec![24, 24], init: Init::Torch },
            optimizer: OptimizerConfig {
                learning_rate: 1e-3,
                beta1: 0.9,
                beta2: 0.999,
                epsilon: 1e-8,
                max_gradient_norm: None,
                schedule: None,
            },
            loss: Loss::Mse,
            gamma: 0.99,
            n_step: 1,
            double: false,
            replay: ReplayConfig {
                capacity: 50_000,
                batch_size: 32,
                warmup_steps: 1000,
                update: UpdateMode::Minibatch,
                mirror: false,
            },
            learn: LearnConfig { every_steps: 1, updates: 1 },
            exploration: Exploration::Linear { initial: 1.0, final_: 0.05, steps: 10_000 },
            target: TargetUpdate::EverySteps(500),
            truncation_is_terminal: false,
            observation_divisors: None,
            reward_scale: 1.0,
            policy_weights: PolicyWeights::Online,
            budget: Budget::Steps(50_000),
            evaluation: EvaluationConfig { every_steps: 1000, episodes: 20 },
            checkpoint: CheckpointConfig { every_steps: 10_000 },
            stop_when_solved: false,
        }
    }
}

/// The groups of which a config holds one alternative, each alternative with its defaults. The first of a group is
/// the default; alternatives of the same name (their string) differ by their keys.
fn alternatives(default: &Config) -> [(&'static str, Vec<Map<String, Value>>); 3] {
    let per_episode = Exploration::PerEpisode { initial: 1.0, final_: 0.01, decay: 0.995 };
    let every_episodes = TargetUpdate::EveryEpisodes(10);
    let soft = TargetUpdate::Soft { tau: 0.005 };
    [
        ("exploration", vec![object(default.exploration), object(per_episode)]),
        (
            "target",
            vec![object(default.target), object(every_episodes), object(soft), object(TargetUpdate::None)],
        ),
        ("budget", vec![object(default.budget), object(Budget::Episodes(500))]),
    ]
}

/// What a schedule is as soon as it is not null.
const DEFAULT_SCHEDULE: LearningRateSchedule =
    LearningRateSchedule { final_learning_rate: 0.0, steps: 50_000 };

/// Why there is no config. An `origin` is the name of a file, or `--set`.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum ConfigError {
    /// The file cannot be read, is too large or is not UTF-8.
    #[error("cannot read {}: {source}", path.display())]
    Read { path: PathBuf, source: io::Error },
    /// Not JSON, or not an object; the source says where and why.
    #[error("{origin}: {source}")]
    Json { origin: String, source: serde_json::Error },
    /// A `--set` without `=`.
    #[error("--set {set}: expected key.path=value, for example --set gamma=0.9")]
    Set { set: String },
    /// A key that is unknown, comes twice or belongs to another alternative.
    #[error("{origin}: {problem} `{key}`; {hint}")]
    Key { origin: String, problem: &'static str, key: String, hint: String },
    /// A value of a wrong type or out of range.
    #[error("{origin}: `{key}` is {value}; allowed: {allowed}")]
    Value { origin: String, key: String, value: String, allowed: String },
}

impl Config {
    /// Merges the defaults, a file (its name for messages, and its text) and the `key.path=value`s of `--set`, which
    /// together are one layer. A value is JSON if it parses as JSON, or else a string.
    ///
    /// # Errors
    /// The first thing that is wrong in a layer, or between layers.
    pub fn from_layers(file: Option<(&str, &str)>, sets: &[String]) -> Result<Self, ConfigError> {
        let mut layers = Vec::new();
        if let Some((name, text)) = file {
            layers.push(Layer::from_json(name, text)?);
        }
        if !sets.is_empty() {
            layers.push(Layer::from_sets(sets)?);
        }
        let default = Self::default();
        let mut root = json!(default);
        for (key, value) in layers.iter().flat_map(|layer| &layer.values) {
            // Only a key of an alternative can be missing in the default; those are merged below.
            if let Some(slot) = root.pointer_mut(&format!("/{}", key.replace('.', "/"))) {
                *slot = value.clone();
            }
        }
        for (group, alternatives) in alternatives(&default) {
            root[group] = choose(group, &alternatives, &layers)?.into();
        }
        root["optimizer"]["schedule"] =
            choose_or_null("optimizer.schedule", &object(DEFAULT_SCHEDULE), &layers)?;
        let origin = layers.iter().map(|layer| layer.origin.as_str()).collect::<Vec<_>>().join(" with ");
        let config: Self = serde_json::from_value(root)
            .map_err(|source| ConfigError::Json { origin: origin.clone(), source })?;
        config.check_combinations(&origin)?;
        Ok(config)
    }

    /// Checks every value, and what binds several keys.
    ///
    /// # Errors
    /// The first key that is out of range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        Layer::from_json("config", &json!(self).to_string())?;
        self.check_combinations("config")
    }

    fn check_combinations(&self, origin: &str) -> Result<(), ConfigError> {
        let ReplayConfig { capacity, batch_size, warmup_steps, .. } = self.replay;
        let every = self.learn.every_steps;
        let (Exploration::PerEpisode { initial, final_, .. } | Exploration::Linear { initial, final_, .. }) =
            self.exploration;
        // The learning step in which the memory holds enough; the warm-up alone would leave nothing to train.
        let first_update = warmup_steps.max(batch_size as u64).checked_next_multiple_of(every);
        let least_steps = first_update.unwrap_or(u64::MAX).max(warmup_steps.saturating_add(1));
        let steps = if let Budget::Steps(steps) = self.budget { steps } else { u64::MAX };

        let at_most = |key: &str, limit: Value| format!("at most `{key}`, which is {limit}");
        let enough = format!(
            "at least {least_steps}, or nothing is learned (`replay.warmup_steps` is {warmup_steps}, \
             `replay.batch_size` {batch_size}, `learn.every_steps` {every})"
        );
        let rules = [
            (
                batch_size <= capacity,
                "replay.batch_size",
                json!(batch_size),
                at_most("replay.capacity", json!(capacity)),
            ),
            (
                final_ <= initial,
                "exploration.final",
                json!(final_),
                at_most("exploration.initial", json!(initial)),
            ),
            (steps >= least_steps, "budget.steps", json!(steps), enough),
            (
                self.observation_divisors
                    .as_ref()
                    .is_none_or(|scale| scale.len() == CartPole::OBSERVATION_SIZE),
                "observation_divisors",
                json!(self.observation_divisors),
                Allowed::OrNull(&Allowed::Scales).to_string(),
            ),
            (
                self.policy_weights == PolicyWeights::Online
                    || matches!(self.target, TargetUpdate::Soft { .. }),
                "policy_weights",
                json!(self.policy_weights),
                format!(
                    "\"online\"; \"target\" only if `target.kind` is \"soft\", and `target` is {}",
                    json!(self.target)
                ),
            ),
            (
                self.memory() <= MAX_MEMORY,
                "network.hidden",
                json!(self.network.hidden),
                format!(
                    "smaller layers: with `replay.batch_size` {batch_size} and `replay.capacity` {capacity} the run \
                     would take about {} GiB of memory; at most {} are allowed",
                    self.memory().div_ceil(1 << 30),
                    MAX_MEMORY >> 30
                ),
            ),
        ];
        match rules.into_iter().find(|(holds, ..)| !holds) {
            Some((_, key, value, allowed)) => Err(invalid(origin, key, &value, allowed)),
            None => Ok(()),
        }
    }

    /// About how many bytes the large parts of a run take: the replay memory, the networks with their gradient and
    /// Adam's moments, the activations of a batch.
    fn memory(&self) -> u64 {
        self.parts().iter().sum()
    }

    fn parts(&self) -> [u64; 3] {
        let sizes = self.network.sizes(CartPole::OBSERVATION_SIZE, CartPole::NUM_ACTIONS);
        let parameters: usize = sizes.windows(2).map(|pair| (pair[0] + 1) * pair[1]).sum();
        let units: usize = sizes.iter().sum();
        let ReplayConfig { capacity, batch_size, .. } = self.replay;
        [24 * capacity, 32 * parameters, 16 * batch_size * units].map(|bytes| bytes as u64)
    }

    /// Whether the system has the memory that so many runs at the same time take, each with a checkpoint of what it can
    /// fill of its replay memory: an allocation that fails in the middle of a run would end the process.
    ///
    /// # Errors
    /// When it has not; the message says how much it takes and what would make it less.
    pub fn check_memory(&self, runs: usize) -> Result<(), String> {
        let [replay, networks, batch] = self.parts();
        let filled = match self.budget {
            Budget::Steps(steps) => replay.min(steps.saturating_mul(24)),
            Budget::Episodes(_) => replay,
        };
        // A checkpoint is put together, and then written from one piece.
        let run = [replay / 3 * 2, replay / 3, networks, batch, filled + networks, filled + networks];
        check_memory(std::iter::repeat_n(run, runs).flatten()).map_err(|_| {
            let mib = (run.iter().sum::<u64>() >> 20) + 1;
            let ReplayConfig { capacity, batch_size, .. } = self.replay;
            format!(
                "not enough memory: a run takes up to {mib} MiB with `replay.capacity` {capacity}, `replay.batch_size` \
                 {batch_size} and `network.hidden` {:?}; make these smaller, or give the process more memory",
                self.network.hidden
            )
        })
    }

    /// The task, as training and its evaluations see it.
    pub fn make_environment(&self) -> TimeLimit<CartPole> {
        CartPole::limited(self.max_episode_steps)
    }

    /// The agent's part.
    pub fn dqn(&self) -> DqnConfig {
        DqnConfig {
            network: self.network.clone(),
            optimizer: self.optimizer,
            loss: self.loss,
            gamma: self.gamma,
            n_step: self.n_step,
            double: self.double,
            replay: self.replay.clone(),
            learn: self.learn.clone(),
            exploration: self.exploration,
            target: self.target,
            truncation_is_terminal: self.truncation_is_terminal,
            observation_divisors: self.observation_divisors.clone(),
            reward_scale: self.reward_scale,
            policy_weights: self.policy_weights,
        }
    }
}

/// Reads a config file of at most 1 MiB.
///
/// # Errors
/// The file cannot be opened or read, is larger, or is not UTF-8.
pub fn read_file(path: &Path) -> Result<String, ConfigError> {
    File::open(path).and_then(read).map_err(|source| ConfigError::Read { path: path.into(), source })
}

/// Reads the text of a config of at most 1 MiB.
///
/// # Errors
/// It cannot be read, is larger, or is not UTF-8.
pub fn read(source: impl Read) -> io::Result<String> {
    let mut bytes = Vec::new();
    source.take(MAX_BYTES + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > MAX_BYTES {
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, "larger than 1 MiB"));
    }
    String::from_utf8(bytes).map_err(|error| io::Error::new(io::ErrorKind::InvalidData, error))
}
