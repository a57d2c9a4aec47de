//! What a checkpoint says of itself.

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::{Value, json};

use super::{Checkpoint, CheckpointProblem};
use crate::config::Config;
use crate::trainer::{Evaluation, Progress, Snapshot};

/// The header of a checkpoint that a run has written.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Header {
    pub env_steps: u64,
    /// The latest evaluation; in `best.safetensors` that of the policy itself.
    pub evaluation: Option<Evaluation>,
    /// The run's config, in a file as [`config_of_checkpoint`] has it.
    #[serde(deserialize_with = "config_with_defaults")]
    pub config: Config,
    /// The counters of the run, in `last.safetensors` only.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub progress: Option<Progress>,
}

/// A config with defaults for the keys that are not in it.
fn config_with_defaults<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Config, D::Error> {
    let text = serde_json::Value::deserialize(deserializer)?.to_string();
    Config::from_layers(Some(("config", &text)), &[]).map_err(D::Error::custom)
}

/// A config without what says when the run ends: an extended run leaves the bytes of one with the larger budget from the start.
pub(crate) fn config_of_checkpoint(config: &Config) -> Value {
    let mut value = json!(config);
    for key in ["budget", "stop_when_lasting_steps"] {
        value.as_object_mut().map(|keys| keys.shift_remove(key));
    }
    value
}

impl Checkpoint {
    pub fn of_run(config: &Config, snapshot: Snapshot) -> std::io::Result<Self> {
        let Snapshot { env_steps, evaluation, progress, tensors } = snapshot;
        let mut header = json!(Header { env_steps, evaluation, config: config.clone(), progress });
        header["config"] = config_of_checkpoint(config);
        let mut checkpoint = Self::new(&header)?;
        checkpoint.tensors = tensors;
        Ok(checkpoint)
    }
}

/// A policy that can be played, with the header of its file; a file of another program has none.
#[derive(Clone, Debug)]
pub struct SavedPolicy {
    pub policy: crate::agent::Policy,
    pub header: Option<Header>,
}

impl SavedPolicy {
    pub fn of(checkpoint: &Checkpoint, spec: &crate::env::Spec) -> Result<Self, CheckpointProblem> {
        let header = match checkpoint.header() {
            Err(CheckpointProblem::NoHeader) => None,
            header => Some(header?),
        };
        Ok(Self { policy: checkpoint.policy(spec)?, header })
    }

    /// The greedy policy for up to `batch` observations. Every Q-value a user sees is from here, in the environment's units.
    pub fn greedy(&self, batch: usize) -> crate::agent::Greedy {
        let reward_scale = self.header.as_ref().map_or(1.0, |header| header.config.agent.reward_scale());
        self.policy.greedy(batch).with_reward_scale(reward_scale)
    }
}
