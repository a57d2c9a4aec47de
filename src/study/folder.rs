//! The directory of a study: `study.json`, and `trials/<index of the config>/<seed>.json`.

use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::{Study, Trial};
use crate::config::difference;
use crate::files::{
    create_folders, is_at, is_unfinished, open_ordinary, read_text_limited, remove_empty, remove_unfinished,
    write_json, write_json_new, write_whole,
};
use crate::run::names::MANIFEST;
use crate::text::shown;

const TRIALS: &str = "trials";
/// Largest file of a study that is read, in bytes.
const MAX_FILE_SIZE: u64 = 1 << 26;

/// Why a study cannot be run.
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
    /// A trial's file is not one.
    #[error(
        "{} is not a trial of this study: {problem}; remove the file, and the study trains it again",
        shown(path)
    )]
    Trial {
        /// The file.
        path: PathBuf,
        /// Why.
        problem: String,
    },
    /// The directory cannot be written.
    #[error("cannot write {}: {source}; choose another --out", shown(path))]
    Unwritable {
        /// The directory.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A trial cannot be written.
    #[error("cannot write {}: {source}; the same command resumes the study", shown(path))]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
}

/// The file of a trial, given as (index of its config, seed), in the directory of its study.
pub fn trial_path(folder: &Path, (config, seed): (usize, u64)) -> PathBuf {
    folder.join(TRIALS).join(config.to_string()).join(format!("{seed}.json"))
}

/// The seeds with which a config, given by its index, has been trained, in order.
///
/// # Errors
/// When the directory cannot be read.
pub fn finished_seeds(folder: &Path, config: usize) -> io::Result<Vec<u64>> {
    let entries = match fs::read_dir(folder.join(TRIALS).join(config.to_string())) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries?,
    };
    let mut seeds = Vec::new();
    for entry in entries {
        let path = entry?.path();
        let seed = path.file_stem().and_then(|stem| stem.to_str()?.parse().ok());
        seeds.extend(seed.filter(|&seed| path == trial_path(folder, (config, seed))));
    }
    seeds.sort_unstable();
    Ok(seeds)
}

/// The directory of a study that this process runs.
#[derive(Debug)]
pub struct StudyDir {
    path: PathBuf,
    /// `study.json`, locked: two processes would run the same trials.
    _manifest: File,
}

impl StudyDir {
    /// Makes the directory of a new study, or opens the directory of the same study, which may have had fewer seeds.
    ///
    /// # Errors
    /// When there is something else in the directory, another study included, or it cannot be written.
    pub fn open(path: &Path, study: &Study) -> Result<Self, StudyError> {
        let bad = |problem| StudyError::Folder { path: path.into(), problem };
        let unwritable = |source: io::Error| StudyError::Unwritable { path: path.into(), source };
        let manifest = path.join(MANIFEST);
        if is_free(path).map_err(bad)? {
            let made = create_folders(path).map_err(unwritable)?;
            match write_json_new(&manifest, study) {
                // Another process was faster; whether it runs the same study is seen below.
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                written => written.map_err(|error| {
                    remove_empty(&made);
                    unwritable(error)
                })?,
            }
        }
        let (mut locked, text) = lock(&manifest).map_err(bad)?;
        let found = serde_json::from_str(&text).map_err(|error| {
            bad(format!("has a {MANIFEST} that does not describe a study: {error}; choose another --out"))
        })?;
        if more_seeds(&found, study).map_err(bad)? {
            write_json(&manifest, study).map_err(unwritable)?;
            (locked, _) = lock(&manifest).map_err(bad)?;
        }
        let study_dir = Self { path: path.into(), _manifest: locked };
        study_dir.prepare(study.configs.len()).map_err(unwritable)?;
        Ok(study_dir)
    }

    /// Makes the directories of the trials and removes what a killed process has left half-written.
    fn prepare(&self, configs: usize) -> io::Result<()> {
        let folders = (0..configs).map(|config| self.path.join(TRIALS).join(config.to_string()));
        for folder in folders.chain([self.path.clone()]) {
            fs::create_dir_all(&folder)?;
            remove_unfinished(&folder)?;
        }
        Ok(())
    }

    /// Whether a trial has been run.
    pub(super) fn has(&self, trial: (usize, u64)) -> bool {
        trial_path(&self.path, trial).exists()
    }

    /// The trials that have been run, one after the other.
    pub fn finished<'a>(&'a self, study: &'a Study) -> impl Iterator<Item = Result<Trial, StudyError>> + 'a {
        study.trials().filter(|&trial| self.has(trial)).map(|(config, seed)| {
            let path = trial_path(&self.path, (config, seed));
            read_trial(&path, &study.configs[config].name, seed)
        })
    }

    pub(super) fn write(&self, trial: (usize, u64), content: &Trial) -> Result<(), StudyError> {
        let path = trial_path(&self.path, trial);
        write_whole(&path, |file| {
            serde_json::to_writer(&mut *file, content)?;
            file.write_all(b"\n")
        })
        .map_err(|source| StudyError::Write { path, source })
    }
}

/// Reads the file of the trial of a config (its name) with a seed.
///
/// # Errors
/// When it cannot be read, or holds something else.
pub fn read_trial(path: &Path, config: &str, seed: u64) -> Result<Trial, StudyError> {
    let bad = |problem| StudyError::Trial { path: path.into(), problem };
    let text = read_text_limited(path, MAX_FILE_SIZE).map_err(|error| bad(error.to_string()))?;
    let trial: Trial = serde_json::from_str(&text).map_err(|error| bad(error.to_string()))?;
    if trial.config != config || trial.seed != seed {
        return Err(bad(format!("it belongs to config {:?}, seed {}", trial.config, trial.seed)));
    }
    if !trial.evaluations.is_sorted_by(|a, b| a.env_steps < b.env_steps) {
        return Err(bad("its evaluations are not in the order of their steps".into()));
    }
    Ok(trial)
}

/// Whether a new study can take the directory; an error if neither that nor a study is in it.
fn is_free(path: &Path) -> Result<bool, String> {
    let entries = match fs::read_dir(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(true),
        entries => entries.and_then(Iterator::collect::<io::Result<Vec<_>>>),
    };
    let entries =
        entries.map_err(|error| format!("cannot be used for a study: {error}; choose another --out"))?;
    if entries.iter().all(|entry| is_unfinished(&entry.file_name())) {
        Ok(true)
    } else if path.join(MANIFEST).is_file() {
        Ok(false)
    } else {
        Err(format!("is not empty and does not hold a study (no {MANIFEST}); choose another --out"))
    }
}

/// Locks a study against other processes until the file is closed, and reads its manifest.
fn lock(manifest: &Path) -> Result<(File, String), String> {
    let unreadable = |error: io::Error| format!("has a {MANIFEST} that cannot be read: {error}");
    let file = open_ordinary(File::options().read(true), manifest).map_err(unreadable)?;
    // A file system without locks is no reason to refuse. Who replaces the manifest has the lock of the old one.
    let is_taken = matches!(file.try_lock(), Err(TryLockError::WouldBlock));
    if is_taken || !is_at(&file, manifest).map_err(unreadable)? {
        return Err(
            "is in use by another process that runs this study; wait until it ends, or choose another --out"
                .into(),
        );
    }
    let text = read_text_limited(manifest, MAX_FILE_SIZE).map_err(unreadable)?;
    Ok((file, text))
}

/// Whether a study is the one of the manifest `found` with more seeds; an error if it is another study.
fn more_seeds(found: &Value, study: &Study) -> Result<bool, String> {
    let mut given = json!(study);
    let bound = |name: &str| found["seeds"][name].as_u64();
    let (start, end) = (bound("start"), bound("end"));
    let grows = start == Some(study.seeds.start) && end.is_some_and(|end| end < study.seeds.end);
    if grows {
        given["seeds"] = found["seeds"].clone();
    }
    match difference("", found, &given) {
        None => Ok(grows),
        Some(difference) => Err(format!(
            "holds another study: {difference}. To continue that study, repeat its command, which may add seeds at the end. \
             Otherwise choose another --out"
        )),
    }
}
