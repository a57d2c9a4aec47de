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

use crate::config::ConfigError;
use crate::env::EnvironmentError;
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

/// Why a run cannot be made, opened or resumed.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The directory, or something in it, cannot be used.
    #[error("directory {} {problem}", shown(path))]
    Directory { path: PathBuf, problem: String },
    #[error("cannot write {}: {source}{hint}", shown(path))]
    Unwritable { path: PathBuf, source: io::Error, hint: &'static str },
    /// Something was tried and failed.
    #[error("{0}")]
    Failed(String),
    /// Something that the user gave cannot be used here.
    #[error("{0}")]
    BadInput(String),
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    #[error(transparent)]
    Config(#[from] ConfigError),
    #[error(transparent)]
    Environment(#[from] EnvironmentError),
}

fn bad(path: &Path, problem: impl Into<String>) -> RunError {
    RunError::Directory { path: path.to_owned(), problem: problem.into() }
}

fn unwritable(path: &Path, source: io::Error, hint: &'static str) -> RunError {
    RunError::Unwritable { path: path.to_owned(), source, hint }
}
