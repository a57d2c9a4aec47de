//! Who takes the events of a run. Sinks see events and nothing else of the trainer.

mod console;
mod json_lines;
mod tensorboard;

pub use console::Console;
pub use json_lines::JsonLines;
pub use tensorboard::{TENSORBOARD_PREFIX, TensorBoard};
