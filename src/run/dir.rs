//! The directory of one run.

use std::fs::{self, DirEntry, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use serde::{Deserialize, Serialize};

use super::names::{
    ABOUT, BEST, CHECKPOINTS, CONFIG, INIT, LAST, MANIFEST, METRICS, PREVIOUS, PROGRESS, SUMMARY,
    TENSORBOARD, is_of_a_report,
};
use super::{Checkpoint, RunError, bad, unwritable};
use crate::config::{Config, MAX_BYTES};
use crate::files::{
    Directory, create_directories, is_unfinished, open_shared, read_text_limited, remove_empty,
};
use crate::sink::{JsonLines, TENSORBOARD_PREFIX};
use crate::text::shown;
use crate::trainer::{Evaluation, Summary};

/// Facts about a run that are no part of its result.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct About {
    /// The name of the config that the run was started with.
    pub config: String,
    /// Why the run cannot be trained any further with its config.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) failed: Option<String>,
}

#[derive(Clone, Debug)]
pub struct RunDir {
    path: PathBuf,
    /// Held from its first use on.
    directory: OnceLock<Directory>,
}

impl From<&Path> for RunDir {
    fn from(path: &Path) -> Self {
        Self { path: path.to_owned(), directory: OnceLock::new() }
    }
}

impl RunDir {
    /// What `train` makes in the directory of every run.
    pub(crate) const PARTS: [&str; 4] = [CONFIG, METRICS, SUMMARY, CHECKPOINTS];

    /// Makes the directory of a new run, with its config and the file for its metrics; nothing of it stays on an error.
    /// A directory with anything in it is refused, unless `force` is set and there is nothing in it but a run, which is
    /// then removed. Nothing is changed before the metrics are locked: another process may train in the directory.
    /// `name` is what the config is called, and `init` the file of the weights that the run starts with, where they are not drawn.
    pub fn create(
        path: &Path, force: bool, name: &str, config: &Config, init: Option<&Checkpoint>,
    ) -> Result<(Self, JsonLines), RunError> {
        let run = Self::from(path);
        run.replaced(force)?;
        let failed = |error: io::Error| match error.kind() {
            io::ErrorKind::WouldBlock => in_use(path),
            _ => unwritable(path, error, "; choose another --out"),
        };
        let made = create_directories(path).map_err(failed)?;
        let (mut metrics, is_new) = run.lock().map_err(|error| {
            remove_empty(&made);
            failed(error)
        })?;
        // Another process may have made, changed or removed a run before this one had the lock.
        let mut made_checkpoints = false;
        let filled = run.replaced(force).and_then(|replaced| {
            let created = run.directory().and_then(|directory| directory.create_dir(&run.checkpoints()));
            made_checkpoints = created.map_err(failed)?;
            run.fill(&mut metrics, replaced, name, config, init).map_err(failed)
        });
        filled.inspect_err(|_| {
            // Between the making of the metrics and their lock another process may have made a run, and even ended it.
            if let Ok(directory) = run.directory() {
                if is_new && !run.config().exists() {
                    let files = [run.metrics(), run.init(), run.about()];
                    files.iter().for_each(|file| drop(directory.remove_file(file)));
                }
                if made_checkpoints {
                    let _ = directory.remove_dir(&run.checkpoints());
                }
            }
            remove_empty(&made);
        })?;
        Ok((run, metrics))
    }

    /// The files of the old run that a new run replaces; none where the directory is free or missing.
    fn replaced(&self, force: bool) -> Result<Vec<PathBuf>, RunError> {
        let path = &self.path;
        let entries = match fs::read_dir(path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Vec::new(),
            Err(_) if path.exists() && !path.is_dir() => {
                return Err(bad(path, "is a file; choose another --out"));
            }
            entries => entries.and_then(Iterator::collect).map_err(|error| {
                bad(path, format!("cannot be used for a run: {error}; choose another --out"))
            })?,
        };
        if entries.iter().all(|entry| self.is_of_no_run(entry)) {
            return Ok(Vec::new());
        }
        let problem = match self.replaceable() {
            Ok(files) if force => return Ok(files),
            Err(reason) if force => reason,
            Ok(_) => "is not empty: it holds a run; choose another --out, --force to replace that run, or resume it: \
                      train --resume"
                .into(),
            Err(_) => "is not empty, and holds no run that --force could replace; choose another --out".into(),
        };
        Err(bad(path, problem))
    }

    /// Locks the metrics, and makes the file if it is missing; the result says whether it was made.
    fn lock(&self) -> io::Result<(JsonLines, bool)> {
        let directory = self.directory()?;
        loop {
            match JsonLines::open(directory, &self.metrics()) {
                Err(error) if error.kind() == io::ErrorKind::NotFound => {}
                opened => return Ok((opened?, false)),
            }
            match JsonLines::create(directory, &self.metrics()) {
                // Another process was faster.
                Err(error)
                    if error.kind() == io::ErrorKind::AlreadyExists && is_ordinary(&self.metrics()) => {}
                made => return Ok((made?, true)),
            }
        }
    }

    /// Opens the directory of an existing run; returns it with its config.
    pub fn open(path: &Path) -> Result<(Self, Config), RunError> {
        let run = Self::from(path);
        let config = run.read_config()?;
        let files = run.files();
        let directories = [run.checkpoints(), run.tensorboard()];
        let is_foreign = |path: &&PathBuf| match path.symlink_metadata() {
            Ok(found) if directories.contains(path) => !found.is_dir(),
            Ok(found) => !found.is_file(),
            Err(_) => false,
        };
        if let Some(foreign) = files.iter().chain(&directories).find(is_foreign) {
            let kind = "which is a link or not the kind of file that its name promises";
            return Err(bad(path, format!("holds {}, {kind}", foreign.display())));
        }
        if !run.metrics().exists() {
            let what = "so its run cannot be resumed; train again with another --out";
            return Err(bad(path, format!("has no {METRICS}, {what}")));
        }
        Ok((run, config))
    }

    /// Opens and locks the metrics: until they are dropped, no other process can change the run.
    pub(crate) fn take(&self) -> Result<JsonLines, RunError> {
        let opened = self.directory().and_then(|directory| JsonLines::open(directory, &self.metrics()));
        opened.map_err(|error| match error.kind() {
            io::ErrorKind::WouldBlock => in_use(&self.path),
            _ => unwritable(&self.metrics(), error, ""),
        })
    }

    /// Keeps other processes from changing the run until the file is dropped. The file need not be writable.
    pub fn share(&self) -> Result<File, RunError> {
        open_shared(&self.metrics()).map_err(|error| match error.kind() {
            io::ErrorKind::WouldBlock => in_use(&self.path),
            _ => bad(&self.path, format!("cannot be read: {METRICS}: {error}")),
        })
    }

    pub(crate) fn read_config(&self) -> Result<Config, RunError> {
        if !self.path.is_dir() {
            let problem = if self.path.exists() { "is not a directory" } else { "does not exist" };
            let expected = "give the directory of a run, such as runs/my-run";
            return Err(bad(&self.path, format!("{problem}; {expected}")));
        }
        let path = self.config();
        let text = read_text_limited(&path, MAX_BYTES)
            .map_err(|error| bad(&self.path, format!("does not hold a run: {CONFIG}: {error}")))?;
        // A run that is older than this key never looked for a policy that lasts.
        let key = "stop_when_lasting_steps";
        let never = (!text.contains(key)).then(|| format!("{key}=null"));
        Ok(Config::from_layers(Some((&shown(&path), &text)), never.as_slice())?)
    }

    fn fill(
        &self, metrics: &mut JsonLines, replaced: Vec<PathBuf>, name: &str, config: &Config,
        init: Option<&Checkpoint>,
    ) -> io::Result<()> {
        let directory = self.directory()?;
        if !replaced.is_empty() {
            // Before the first file is gone: the checkpoints may be writable where the run's directory is not.
            directory.check_writable(&self.config())?;
        }
        // The old config stays until the new one takes its place: a run that is half replaced can still be replaced.
        for path in replaced {
            match path.file_name() {
                Some(name) if is_unfinished(name) => directory.remove_abandoned(&path)?,
                _ => directory.remove_file(&path)?,
            }
        }
        // Fails if the directory still holds files, which is fine.
        let _ = directory.remove_dir(&self.tensorboard());
        metrics.cut(0)?;
        // Before the config, which makes it a run: no run may lack the weights that it starts with.
        if let Some(init) = init {
            init.write_in(directory, &self.init(), None)?;
        }
        self.write_json(&self.about(), &About { config: name.into(), failed: None })?;
        self.write_json(&self.config(), config)
    }

    pub(crate) fn write_json(&self, path: &Path, value: &impl serde::Serialize) -> io::Result<()> {
        self.directory()?.write_json(path, value)
    }

    /// The directory, in which nothing is reached through a link.
    pub(crate) fn directory(&self) -> io::Result<&Directory> {
        match self.directory.get() {
            Some(directory) => Ok(directory),
            None => {
                let directory = Directory::open(&self.path)?;
                Ok(self.directory.get_or_init(|| directory))
            }
        }
    }

    /// Whether an entry is a harmless leftover of a process that was killed before it made a run.
    fn is_of_no_run(&self, entry: &DirEntry) -> bool {
        let path = entry.path();
        let is_empty_directory = || fs::read_dir(&path).is_ok_and(|mut entries| entries.next().is_none());
        is_unfinished(&entry.file_name())
            || (path == self.metrics()
                && is_ordinary(&path)
                && entry.metadata().is_ok_and(|file| file.len() == 0))
            || (path == self.checkpoints() && !path.is_symlink() && is_empty_directory())
            || (path == self.about() && is_ordinary(&path) && !self.config().exists())
    }

    /// The files of a run that is to be replaced, but for its config and metrics; an error if there are others.
    fn replaceable(&self) -> Result<Vec<PathBuf>, String> {
        let unreadable = |error: io::Error| format!("cannot be read: {error}");
        // More than `read_config` asks for: every key.
        let config = read_text_limited(&self.config(), MAX_BYTES).ok();
        if config.is_none_or(|text| serde_json::from_str::<Config>(&text).is_err()) {
            return Err(format!(
                "does not hold a run (it has no {CONFIG} of a run), and --force replaces only runs; choose another --out"
            ));
        }
        let stay = [self.config(), self.metrics()];
        let parts = [self.checkpoints(), self.tensorboard()];
        let mut entries = Vec::new();
        let mut files = Vec::new();
        for directory in [&self.path].into_iter().chain(&parts) {
            if directory.is_dir() {
                entries.extend(fs::read_dir(directory).map_err(unreadable)?);
            }
        }
        for entry in entries {
            let entry = entry.map_err(unreadable)?;
            let (path, name) = (entry.path(), entry.file_name());
            // A link could lead to the checkpoints of another run.
            let is_directory = !path.is_symlink() && path.is_dir();
            if (parts.contains(&path) && is_directory) || (stay.contains(&path) && is_ordinary(&path)) {
                continue;
            }
            let is_own = self.files().contains(&path)
                || path == self.path.join(PROGRESS)
                || self.is_events(&path)
                || is_of_a_report(&name);
            if !is_ordinary(&path) || !(is_own || is_unfinished(&name)) {
                // What is gone since was of another process, whose lock refuses this one.
                if path.symlink_metadata().is_err_and(|error| error.kind() == io::ErrorKind::NotFound) {
                    continue;
                }
                return Err(format!(
                    "holds {}, which is a link or does not belong to a run, and --force replaces only runs; choose another --out",
                    shown(&path)
                ));
            }
            files.push(path);
        }
        Ok(files)
    }

    /// Every file of a run but those for TensorBoard.
    fn files(&self) -> [PathBuf; 8] {
        let [best, last, previous] = [self.best(), self.last(), self.previous()];
        [self.config(), self.about(), self.metrics(), self.summary(), self.init(), best, last, previous]
    }

    fn is_events(&self, path: &Path) -> bool {
        let has_prefix = |name: &std::ffi::OsStr| name.to_string_lossy().starts_with(TENSORBOARD_PREFIX);
        path.parent() == Some(&self.tensorboard()) && path.file_name().is_some_and(has_prefix)
    }

    pub(crate) fn has_events(&self) -> bool {
        let entries = fs::read_dir(self.tensorboard());
        entries.is_ok_and(|entries| entries.flatten().any(|entry| self.is_events(&entry.path())))
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// What is known of the run; none of one that an earlier version has started.
    pub(crate) fn read_about(&self) -> Option<About> {
        serde_json::from_str(&read_text_limited(&self.about(), MAX_BYTES).ok()?).ok()
    }

    /// Records why the run cannot be trained any further, or that it can.
    pub(crate) fn set_failed(&self, failed: Option<String>) -> io::Result<()> {
        match self.read_about() {
            Some(old) if old.failed != failed => self.write_json(&self.about(), &About { failed, ..old }),
            _ => Ok(()),
        }
    }
}

macro_rules! paths {
    ($($function:ident: $name:ident in $above:ident),* $(,)?) => {$(
        #[doc = concat!("Where [`", stringify!($name), "`](super::names::", stringify!($name), ") is.")]
        pub fn $function(&self) -> PathBuf {
            self.$above().join($name)
        }
    )*};
}

impl RunDir {
    paths! {
        config: CONFIG in path,
        about: ABOUT in path,
        metrics: METRICS in path,
        summary: SUMMARY in path,
        tensorboard: TENSORBOARD in path,
        checkpoints: CHECKPOINTS in path,
        init: INIT in checkpoints,
        best: BEST in checkpoints,
        last: LAST in checkpoints,
        previous: PREVIOUS in checkpoints,
    }
}

/// A file, and not a link to one: what is written to a run must not go elsewhere.
fn is_ordinary(path: &Path) -> bool {
    path.symlink_metadata().is_ok_and(|found| found.is_file())
}

/// The checkpoint that a user means: the file itself, or of a run's directory the best, else the last.
pub(crate) fn checkpoint_of(path: &Path) -> Result<PathBuf, RunError> {
    if !path.is_dir() {
        return Ok(path.to_owned());
    }
    let run = RunDir::from(path);
    for file in [run.best(), run.last()] {
        match file.metadata() {
            Ok(found) if found.is_file() => return Ok(file),
            Err(error)
                if ![io::ErrorKind::NotFound, io::ErrorKind::NotADirectory].contains(&error.kind()) =>
            {
                let problem = format!("cannot be searched for a policy: {}: {error}", file.display());
                return Err(bad(path, problem));
            }
            _ => {}
        }
    }
    if path.join(MANIFEST).is_file() {
        return Err(bad(
            path,
            "is a study: its trials keep scores and no policies. To get a policy, train one of its configs: \
             cartpole-dqn train --config FILE --seed N",
        ));
    }
    Err(bad(path, format!("has no {CHECKPOINTS}/{BEST} or {LAST}; give a checkpoint or a run")))
}

/// The evaluation at the end of the run that a checkpoint belongs to, as the run's summary has it, and the checkpoint of that policy.
pub(crate) fn final_evaluation(checkpoint: &Path) -> Option<(Evaluation, PathBuf)> {
    let checkpoints = checkpoint.parent().filter(|above| above.ends_with(CHECKPOINTS))?;
    let run = RunDir::from(checkpoints.parent()?);
    let summary: Summary = serde_json::from_str(&read_text_limited(&run.summary(), MAX_BYTES).ok()?).ok()?;
    Some((summary.final_evaluation?, run.last()))
}

fn in_use(path: &Path) -> RunError {
    bad(
        path,
        "is in use by another process that trains there; wait until it ends, or choose another directory",
    )
}
