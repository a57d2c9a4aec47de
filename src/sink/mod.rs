//! Who takes the events of a run. Sinks see events and nothing else of the trainer.

mod console;
mod json_lines;
mod progress_csv;
mod tensorboard;

pub use console::{Console, EpisodeLog};
pub use json_lines::JsonLines;
pub use progress_csv::ProgressCsv;
pub use tensorboard::{TENSORBOARD_PREFIX, TensorBoard};
