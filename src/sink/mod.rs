//! Who takes the events of a run. Sinks see events and nothing else of the trainer.

#[cfg(feature = "cli")]
mod console;
mod json_lines;
#[cfg(feature = "tensorboard")]
mod tensorboard;

#[cfg(feature = "cli")]
pub(crate) use console::{Console, EpisodeLog, LINE_INTERVAL, progress_bar};
pub(crate) use json_lines::JsonLines;
#[cfg(feature = "tensorboard")]
pub(crate) use tensorboard::TensorBoard;

/// The prefix by which TensorBoard finds event files.
pub(crate) const TENSORBOARD_PREFIX: &str = "events.out.tfevents.";
