//! What decides a run besides its agent and its environment.

use serde::{Deserialize, Serialize};

/// Settings of a run. Each is a key of the config, see `config::keys`.
#[derive(Clone, Debug, PartialEq)]
pub struct TrainerConfig {
    pub seed: u64,
    /// Steps after which a training episode is truncated. Evaluations have the environment's own limit.
    pub max_episode_steps: u32,
    pub budget: Budget,
    pub evaluation: EvaluationConfig,
    pub(crate) checkpoint: CheckpointConfig,
    pub(crate) stop_when_solved: bool,
    /// The steps that a policy must last, see [`lasts`](super::lasts), to end the run.
    pub stop_when_lasting_steps: Option<u32>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Budget {
    Steps(u64),
    Episodes(u64),
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EvaluationConfig {
    pub every_steps: u64,
    pub episodes: u64,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct CheckpointConfig {
    pub every_steps: u64,
}
