//! Finding runs below a directory.

use std::path::{Path, PathBuf};

use super::ui::{Failure, program};
use crate::run::names::{BEST, LAST};
use crate::run::{RunDir, checkpoint_of};
use crate::text::shown;

pub(super) const RUNS: &str = "runs";
const DEPTH: usize = 5;

#[derive(Default)]
pub(super) struct FoundRuns {
    pub(super) runs: Vec<PathBuf>,
    pub(super) unreadable: Vec<(PathBuf, std::io::Error)>,
}

pub(super) fn newest_with_policy(directory: &Path) -> Result<PathBuf, Failure> {
    let (exists, place) = (directory.exists(), directory.display());
    let runs = if exists { find(directory)?.runs } else { Vec::new() };
    runs.into_iter().find(|run| checkpoint_of(run).is_ok()).ok_or_else(|| {
        let what = match exists {
            true => format!("no run below {place} has a policy"),
            false => format!("there is no directory {place} here"),
        };
        Failure::BadInput(format!(
            "no path is given, and {what}; train a policy with: cartpole-dqn train, or give the path of one, such as \
             runs/my-run"
        ))
    })
}

/// The runs below a directory, the newest first; of equally new ones first the one whose name is last.
pub(super) fn find(directory: &Path) -> Result<FoundRuns, Failure> {
    if !directory.is_dir() {
        let problem = if directory.exists() { "is not a directory" } else { "does not exist" };
        let (place, program) = (shown(directory), program());
        return Err(Failure::BadInput(format!(
            "{place} {problem}; give a directory with runs in it, or train the first one, which makes {RUNS}: {program} train"
        )));
    }
    let mut found = FoundRuns::default();
    search(directory, DEPTH, &mut found);
    if let [(path, error)] = &found.unreadable[..]
        && path == directory
    {
        return Err(Failure::BadInput(format!("{} cannot be read: {error}", shown(directory))));
    }
    found.runs.sort_by_cached_key(|run| std::cmp::Reverse((written_at(run), run.clone())));
    Ok(found)
}

/// A run is a directory with at least two of the entries that `train` makes. What is in a run is not searched.
fn search(directory: &Path, depth: usize, found: &mut FoundRuns) {
    let mut inner = Vec::new();
    let mut parts = 0;
    let entries = std::fs::read_dir(directory).and_then(|entries| {
        for entry in entries {
            let entry = entry?;
            let is_part = RunDir::PARTS.iter().any(|part| entry.file_name() == *part);
            parts += usize::from(is_part);
            // The type of a link is not that of what it leads to.
            if !is_part && entry.file_type()?.is_dir() {
                inner.push(entry.path());
            }
        }
        Ok(())
    });
    if parts >= 2 {
        found.runs.push(directory.into());
        return;
    }
    if let Err(error) = entries {
        found.unreadable.push((directory.into(), error));
    }
    if depth > 1 {
        inner.iter().for_each(|inner| search(inner, depth - 1, found));
    }
}

/// When the run last wrote one of its own files; a report in the same directory is none of them.
pub(super) fn written_at(run: &Path) -> Option<std::time::SystemTime> {
    let [config, metrics, summary, checkpoints] = RunDir::PARTS.map(|part| run.join(part));
    let files = [config, metrics, summary, checkpoints.join(BEST), checkpoints.join(LAST)];
    files.iter().filter_map(|file| file.symlink_metadata().ok()?.modified().ok()).max()
}
