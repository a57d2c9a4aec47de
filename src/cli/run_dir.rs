//! The folder of one run.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use super::Failure;
use crate::config::{Config, read_file};
use crate::files::{is_unfinished, write_json};
use crate::report;
use crate::sink::{JsonLines, TENSORBOARD_PREFIX};

const CONFIG: &str = "config.json";
const METRICS: &str = "metrics.jsonl";
const SUMMARY: &str = "summary.json";
const CHECKPOINTS: &str = "checkpoints";
const TENSORBOARD: &str = "tensorboard";
const BEST: &str = "best.safetensors";
const LAST: &str = "last.safetensors";

/// A run's folder and the paths in it.
#[derive(Debug)]
pub(super) struct RunDir {
    path: PathBuf,
}

impl RunDir {
    /// Makes the folder of a new run, with its config and the file for its metrics; nothing of it stays on an error.
    /// A folder with anything in it is refused, unless `force` is set and there is nothing in it but a run, which is
    /// then removed.
    pub(super) fn create(path: &Path, force: bool, config: &Config) -> Result<(Self, JsonLines), Failure> {
        let run = Self { path: path.to_owned() };
        let is_empty = match fs::read_dir(path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => true,
            Err(_) if path.exists() && !path.is_dir() => {
                return Err(bad(path, "is a file; choose another --out"));
            }
            Err(error) => {
                return Err(bad(path, &format!("cannot be used for a run: {error}; choose another --out")));
            }
            Ok(mut entries) => entries.next().is_none(),
        };
        if !is_empty && !force {
            return Err(bad(path, "is not empty; choose another --out, or --force to replace the run in it"));
        }
        if !is_empty {
            tempfile::tempfile_in(path).map_err(|error| bad(path, &format!("cannot be written: {error}")))?;
            run.remove_run().map_err(|reason| bad(path, &reason))?;
        }
        let missing: Vec<&Path> =
            path.ancestors().take_while(|path| !path.as_os_str().is_empty() && !path.exists()).collect();
        let metrics = run.fill(config).map_err(|error| {
            // What this call has made goes again; what was there is not empty and stays.
            let _ = fs::remove_dir(run.checkpoints());
            missing.iter().for_each(|path| drop(fs::remove_dir(path)));
            bad(path, &format!("cannot be written: {error}; choose another --out"))
        })?;
        Ok((run, metrics))
    }

    fn fill(&self, config: &Config) -> io::Result<JsonLines> {
        fs::create_dir_all(self.checkpoints())?;
        // The metrics first: this fails if another process has just taken the same folder.
        let metrics = JsonLines::create(&self.metrics())?;
        write_json(&self.config(), config).inspect_err(|_| drop(fs::remove_file(self.metrics())))?;
        Ok(metrics)
    }

    /// Removes a run's files, after making sure that there are no others.
    fn remove_run(&self) -> Result<(), String> {
        let own = [self.config(), self.metrics(), self.summary(), self.best(), self.last()];
        let unreadable = |error: io::Error| format!("cannot be read: {error}");
        let config = read_file(&self.config()).ok();
        if config.is_none_or(|text| serde_json::from_str::<Config>(&text).is_err()) {
            return Err(format!(
                "is not a run (it has no {CONFIG} of one); --force replaces a run and nothing else"
            ));
        }
        let mut entries = Vec::new();
        let mut files = Vec::new();
        for folder in [&self.path, &self.checkpoints(), &self.tensorboard()] {
            if folder.is_dir() {
                entries.extend(fs::read_dir(folder).map_err(unreadable)?);
            }
        }
        for entry in entries {
            let entry = entry.map_err(unreadable)?;
            let path = entry.path();
            match path.is_dir() {
                true if path == self.checkpoints() || path == self.tensorboard() => {}
                false
                    if own.contains(&path)
                        || self.is_events(&path)
                        || is_unfinished(&entry.file_name())
                        || report::is_part(&entry.file_name()) =>
                {
                    files.push(path);
                }
                _ => {
                    return Err(format!(
                        "holds {}, which is not of a run; --force replaces a run and nothing else",
                        path.display()
                    ));
                }
            }
        }
        // The config last: while it is there, what is left can still be replaced.
        files.sort_by_key(|path| *path == self.config());
        for path in files {
            fs::remove_file(&path)
                .map_err(|error| format!("cannot be replaced: {}: {error}", path.display()))?;
        }
        // The next run may have none; an error leaves an empty folder.
        let _ = fs::remove_dir(self.tensorboard());
        Ok(())
    }

    fn is_events(&self, path: &Path) -> bool {
        let has_prefix = |name: &std::ffi::OsStr| name.to_string_lossy().starts_with(TENSORBOARD_PREFIX);
        path.parent() == Some(&self.tensorboard()) && path.file_name().is_some_and(has_prefix)
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }
    pub(super) fn config(&self) -> PathBuf {
        self.path.join(CONFIG)
    }
    pub(super) fn metrics(&self) -> PathBuf {
        self.path.join(METRICS)
    }
    pub(super) fn summary(&self) -> PathBuf {
        self.path.join(SUMMARY)
    }
    pub(super) fn checkpoints(&self) -> PathBuf {
        self.path.join(CHECKPOINTS)
    }
    pub(super) fn tensorboard(&self) -> PathBuf {
        self.path.join(TENSORBOARD)
    }
    pub(super) fn best(&self) -> PathBuf {
        self.checkpoints().join(BEST)
    }
    pub(super) fn last(&self) -> PathBuf {
        self.checkpoints().join(LAST)
    }
}

/// The checkpoint that a user means: the file itself, or of a run's folder the best, else the last.
pub(super) fn checkpoint_of(path: &Path) -> Result<PathBuf, Failure> {
    if !path.is_dir() {
        return Ok(path.to_owned());
    }
    let run = RunDir { path: path.to_owned() };
    [run.best(), run.last()].into_iter().find(|file| file.is_file()).ok_or_else(|| {
        bad(path, &format!("has no {CHECKPOINTS}/{BEST} or {LAST}; give a checkpoint or a run"))
    })
}

fn bad(path: &Path, problem: &str) -> Failure {
    Failure::BadInput(format!("folder {} {problem}", path.display()))
}
