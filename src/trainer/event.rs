//! What can be observed of a run: one stream of events, the same for every observer and file.

use serde::{Deserialize, Serialize};

/// Something that happened. No event holds a wall-clock time, so that equal runs write equal files. `env_steps` and `updates`
/// (gradient steps) count from the start of the run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Event {
    Episode {
        env_steps: u64,
        /// Number of the episode, from 0.
        episode: u64,
        #[serde(rename = "return")]
        return_: f64,
        length: u64,
        /// Mean return of the last 100 episodes, or of as many as there are.
        mean_return_100: f64,
        epsilon: f64,
        /// Mean loss of the learning steps during the episode; null if there were none.
        loss: Option<f64>,
        updates: u64,
    },
    Evaluation {
        env_steps: u64,
        /// Episodes of the evaluation; the numbers below are of their returns.
        episodes: u64,
        mean: f64,
        /// Population standard deviation of the returns.
        std: f64,
        min: f64,
        max: f64,
        mean_length: f64,
        /// Whether none before is better, so that this policy became the best checkpoint.
        best: bool,
        solved: bool,
    },
    /// What learning looked like from inside at an evaluation, once the replay memory holds anything.
    Statistics {
        env_steps: u64,
        /// See [`STATISTICS`](crate::agent::STATISTICS).
        #[serde(flatten)]
        numbers: crate::agent::NamedNumbers,
    },
    End {
        env_steps: u64,
        episodes: u64,
        updates: u64,
        reason: EndReason,
    },
}

impl Event {
    pub(crate) fn env_steps(&self) -> u64 {
        match *self {
            Self::Episode { env_steps, .. }
            | Self::Evaluation { env_steps, .. }
            | Self::Statistics { env_steps, .. }
            | Self::End { env_steps, .. } => env_steps,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EndReason {
    Budget,
    /// An evaluation solved the task, and `stop_when_solved` is set.
    Solved,
    /// The policy of an evaluation lasts the steps of `stop_when_lasting_steps`.
    Lasting,
    /// Somebody stopped the run, which can be resumed from its checkpoint. No event and no file says so.
    #[serde(skip)]
    Interrupted,
}
