//! Many runs: every config of a study with every seed, in any number of processes on any number of machines.
//!
//! A trial is a function of its config and seed alone. So it does not matter which process runs it, how often, and in which
//! order: the trials that a study leaves are the same.

mod local;
mod plan;
mod store;
mod trial;

use std::io;
use std::path::PathBuf;

use crate::text::shown;

pub use plan::{FORMAT_VERSION, MAX_SEEDS, NamedConfig, Shard, Study};
pub use store::{Finished, LastTry, LeftOut, StudyDir};
pub use trial::{Cause, ENDURANCE_STEPS, Ended, PolicyScore, SCORE_EPISODES, Trial, Unended};

/// Why a study cannot be run or read.
#[derive(Debug, thiserror::Error)]
pub enum StudyError {
    /// The directory cannot be used.
    #[error("directory {} {problem}", shown(path))]
    Folder {
        /// The directory.
        path: PathBuf,
        /// Why.
        problem: String,
    },
    /// A file of trials, or the directory of these files, cannot be read.
    #[error("{} cannot be read: {source}", shown(path))]
    Unreadable {
        /// The file or directory.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A line of a file of trials cannot be used.
    #[error("{} line {line} {problem}", shown(path))]
    Line {
        /// The file.
        path: PathBuf,
        /// The number of the line, from 1.
        line: u64,
        /// Why.
        problem: String,
    },
    /// A new study cannot be written into the directory.
    #[error("cannot write {}: {source}; choose another --out", shown(path))]
    Unwritable {
        /// The directory.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A trial cannot be written.
    #[error(
        "cannot write {}: {source}; when the problem is solved, the same command resumes the study",
        shown(path)
    )]
    Write {
        /// The file, or the directory of these files.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
}
