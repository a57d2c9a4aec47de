//! Many runs: every config of a study with every seed, in any number of processes on any number of machines.
//!
//! A trial follows from its config and seed alone: whichever processes run the trials, and however often, results are the same.

mod local;
mod plan;
mod store;
mod trial;

use std::io;
use std::path::{Path, PathBuf};

use crate::text::shown;

pub(crate) use plan::MAX_SEEDS;
pub use plan::{FORMAT_VERSION, NamedConfig, Shard, Study};
pub use store::StudyDir;
pub(crate) use store::{Finished, Omitted};
pub(crate) use trial::{Cause, LASTING_STEPS, PolicyScore, SCORE_EPISODES, Trial, TrialSummary, Unended};

#[derive(Debug, thiserror::Error)]
pub enum StudyError {
    #[error("{0}")]
    Unusable(String),
    #[error("cannot write {}: {}; choose another --out", shown(.0), .1)]
    Unwritable(PathBuf, io::Error),
    #[error("cannot write {}: {}; when the problem is solved, the same command resumes the study", shown(.0), .1)]
    Write(PathBuf, io::Error),
}

impl StudyError {
    fn directory(path: &Path, problem: impl std::fmt::Display) -> Self {
        Self::Unusable(format!("directory {} {problem}", shown(path)))
    }

    fn unreadable(path: &Path, source: &io::Error) -> Self {
        Self::Unusable(format!("{} cannot be read: {source}", shown(path)))
    }
}
