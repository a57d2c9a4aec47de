//! What can be observed of a run: one stream of events, the same for every sink and file.

use std::io;

use serde::{Deserialize, Serialize};

use crate::agent::Statistics;
use crate::nn::Mlp;

/// Something that happened. No event holds a wall-clock time, so that equal runs write equal files.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Event {
    /// A training episode ended.
    Episode {
        /// Environment steps of the run so far.
        env_steps: u64,
        /// Number of the episode, from 0.
        episode: u64,
        /// Undiscounted sum of its rewards.
        #[serde(rename = "return")]
        return_: f64,
        /// Its environment steps.
        length: u64,
        /// Mean return of the last 100 episodes, or of as many as there are.
        mean_return_100: f64,
        /// ε after the episode.
        epsilon: f64,
        /// Mean loss of the learning steps during the episode; null if there were none.
        loss: Option<f64>,
        /// Gradient steps of the run so far.
        updates: u64,
    },
    /// The greedy policy was evaluated.
    Evaluation {
        /// Environment steps of the run so far.
        env_steps: u64,
        /// Evaluation episodes.
        episodes: u64,
        /// Mean return.
        mean: f64,
        /// Population standard deviation of the returns.
        std: f64,
        /// Smallest return.
        min: f64,
        /// Largest return.
        max: f64,
        /// Whether it is better than all before, so that this policy became the best checkpoint.
        best: bool,
        /// Whether the mean reached the task's threshold.
        solved: bool,
    },
    /// What learning looked like from inside at an evaluation, once the replay memory holds anything.
    Statistics {
        /// Environment steps of the run so far.
        env_steps: u64,
        /// Mean over the evaluation's episodes of max_a Q of the first observation less the discounted return that
        /// was then obtained; an episode cut off by the time limit obtains a little less than it is worth.
        overestimation: f64,
        /// See [`Statistics`].
        #[serde(flatten)]
        agent: Statistics,
    },
    /// The run ended.
    End {
        /// Environment steps of the run.
        env_steps: u64,
        /// Complete training episodes.
        episodes: u64,
        /// Gradient steps.
        updates: u64,
        /// Why.
        reason: EndReason,
    },
}

/// Why a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EndReason {
    /// The budget is used up.
    Budget,
    /// An evaluation solved the task, and `stop_when_solved` is set.
    Solved,
    /// Somebody stopped the run, which can go on from its checkpoint: in no event and in no file.
    #[serde(skip)]
    Interrupted,
}

/// Takes the events of a run.
pub trait EventSink {
    /// Takes one event.
    ///
    /// # Errors
    /// When it cannot be written; the run then ends.
    fn emit(&mut self, event: &Event) -> io::Result<()>;

    /// Flushes all events to the disk. Called before every checkpoint, because resuming expects all earlier events there.
    ///
    /// # Errors
    /// When that fails; the run then ends.
    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }

    /// Sees the policy of an evaluation, before its event; most sinks have no use for it.
    fn see_policy(&mut self, _policy: &Mlp<f32>) {}
}

impl EventSink for Vec<Event> {
    fn emit(&mut self, event: &Event) -> io::Result<()> {
        self.push(event.clone());
        Ok(())
    }
}

/// Every sink in turn.
impl EventSink for Vec<Box<dyn EventSink>> {
    fn emit(&mut self, event: &Event) -> io::Result<()> {
        self.iter_mut().try_for_each(|sink| sink.emit(event))
    }

    fn sync(&mut self) -> io::Result<()> {
        self.iter_mut().try_for_each(|sink| sink.sync())
    }

    fn see_policy(&mut self, policy: &Mlp<f32>) {
        self.iter_mut().for_each(|sink| sink.see_policy(policy));
    }
}
