//! Who takes the events of a run. Sinks see events and nothing else of the trainer.

mod console;
mod json_lines;

pub use console::Console;
pub use json_lines::JsonLines;
