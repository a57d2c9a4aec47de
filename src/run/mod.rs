//! The directory of a run: its files, its lock, its checkpoints, and how a run in it is resumed and verified.

mod checkpoint;
mod dir;
mod events;
mod header;
pub(crate) mod names;
mod record;
mod resume;
mod verify;

use std::io;
use std::path::{Path, PathBuf};

use crate::text::shown;

pub(crate) use checkpoint::CheckpointError;
pub use checkpoint::{Checkpoint, CheckpointProblem, FORMAT_VERSION, seal};
pub use dir::RunDir;
pub(crate) use dir::{checkpoint_of, final_evaluation};
pub(crate) use events::read_events;
pub(crate) use header::config_of_checkpoint;
pub use header::{Header, SavedPolicy};
pub(crate) use record::{Recorder, RunRecord};
pub use resume::load;
pub(crate) use resume::{EndedRun, Resumed, Started, first_step, resume, start, start_again};
pub(crate) use verify::{Extent, compare_files, compare_summaries, read_summary};

#[derive(Debug, thiserror::Error)]
pub enum RunError {
    #[error("directory {} {problem}", shown(path))]
    Directory { path: PathBuf, problem: String },
    #[error("cannot write {}: {source}{hint}", shown(path))]
    Unwritable { path: PathBuf, source: io::Error, hint: &'static str },
    #[error("{0}")]
    Failed(String),
    #[error("{0}")]
    BadInput(String),
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    #[error(transparent)]
    Config(#[from] crate::config::ConfigError),
    #[error(transparent)]
    Environment(#[from] crate::env::EnvironmentError),
}

fn bad(path: &Path, problem: impl Into<String>) -> RunError {
    RunError::Directory { path: path.to_owned(), problem: problem.into() }
}

fn unwritable(path: &Path, source: io::Error, hint: &'static str) -> RunError {
    RunError::Unwritable { path: path.to_owned(), source, hint }
}
