//! The directory of a study. Beside `study.json` it has the finished trials, one a line: each process appends its own to a
//! file of its own, `trials/HOST-PROCESS-RANDOM.jsonl`. So processes need no lock, and a process that is killed can leave
//! nothing worse than an unfinished last line, which readers ignore.
//!
//! `unfinished/CONFIG-SEED.safetensors` is the newest checkpoint of a trial that has no line, and `unfinished/CONFIG-SEED.txt`
//! says why its last try ended. Both are removed when the trial has its line.

use std::collections::{BTreeSet, HashMap};
use std::fs::{self, File};
use std::io::{self, BufRead, BufReader, Read, Seek, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use super::{Study, StudyError, Trial, TrialSummary};
use crate::files::{Directory, if_there, open_ordinary, random_name, read_text_limited};
use crate::run::names::MANIFEST;
use crate::text::shown;

const TRIALS: &str = "trials";
const UNFINISHED: &str = "unfinished";
const EXTENSION: &str = "jsonl";
pub(super) const CHECKPOINT: &str = "safetensors";
const REASON: &str = "txt";
const MAX_REASON: u64 = 1 << 16;
const MAX_LINE: u64 = 1 << 26;
const BUFFER: usize = 1 << 18;
/// Longest time between two fsyncs; a power cut loses at most these trials.
const SYNC_INTERVAL: Duration = Duration::from_secs(1);

type Each<'a> = dyn FnMut(Finished) -> Result<(), String> + 'a;

/// The directory of a study, which any number of processes may use at the same time.
#[derive(Debug)]
pub struct StudyDir {
    pub(crate) path: PathBuf,
    /// In which nothing is reached through a link.
    pub(super) directory: Directory,
    /// What it runs. Its environments may need a permission to be started.
    pub(crate) study: Study,
}

#[derive(Debug)]
pub struct Finished {
    pub config: usize,
    pub(crate) trial: Trial<TrialSummary>,
}

#[derive(Debug, Default)]
pub struct Omitted {
    /// Notes on unfinished lines, and on trials with seeds that the study does not have.
    pub(crate) notes: Vec<String>,
    /// The trials that have begun and have no line, in the order of config and seed, and how their last tries ended.
    pub(crate) last_tries: Vec<(String, u64, String)>,
}

impl StudyDir {
    /// Makes the directory of a new study, or opens the directory of the same study, which may have had fewer seeds.
    pub fn create(path: &Path, study: Study) -> Result<Self, StudyError> {
        if path.is_dir() {
            refuse_links(path)?;
        }
        study.write(path)?;
        Self::with(path, study)
    }

    /// Opens the directory of a study to continue it, which only the version that began it can.
    pub fn open(path: &Path) -> Result<Self, StudyError> {
        let study_dir = Self::open_to_read(path)?;
        refuse_links(path)?;
        study_dir.study.check().map_err(|problem| StudyError::directory(path, problem))?;
        Ok(study_dir)
    }

    pub fn open_to_read(path: &Path) -> Result<Self, StudyError> {
        Self::with(path, Study::read(path)?)
    }

    fn with(path: &Path, study: Study) -> Result<Self, StudyError> {
        let directory = Directory::open(path).map_err(|error| StudyError::unreadable(path, &error))?;
        Ok(Self { path: path.into(), directory, study })
    }

    /// The newest checkpoint of a trial without a line, or the reason why its last try ended.
    pub(super) fn unfinished(&self, (config, seed): (usize, u64), extension: &str) -> PathBuf {
        self.path.join(UNFINISHED).join(format!("{config}-{seed}.{extension}"))
    }

    /// Records why a try ended. An error is ignored: the process has printed the reason, and the trial is missing either way.
    pub(super) fn record_last_try(&self, trial: (usize, u64), reason: &str) {
        let path = self.unfinished(trial, REASON);
        let made = self.directory.create_dir(&self.path.join(UNFINISHED));
        let write = |_| self.directory.write_whole(&path, None, |file| file.write_all(reason.as_bytes()));
        drop(made.and_then(write));
    }

    pub(super) fn forget_last_try(&self, trial: (usize, u64)) {
        let _ = self.directory.remove_file(&self.unfinished(trial, REASON));
    }

    /// Removes the checkpoint and the reason of a trial that has its line now.
    pub(super) fn forget_unfinished(&self, trial: (usize, u64)) {
        self.forget_last_try(trial);
        let _ = self.directory.remove_file(&self.unfinished(trial, CHECKPOINT));
    }

    fn kept(&self) -> BTreeSet<(usize, u64)> {
        let trial = |entry: io::Result<fs::DirEntry>| {
            let path = entry.ok()?.path();
            let extension = path.extension()?;
            let (config, seed) = path.file_stem()?.to_str()?.split_once('-')?;
            let is_own = extension == CHECKPOINT || extension == REASON;
            is_own.then_some((config.parse().ok()?, seed.parse().ok()?))
        };
        fs::read_dir(self.path.join(UNFINISHED)).into_iter().flatten().filter_map(trial).collect()
    }

    /// Removes checkpoints of trials that have their line, which killed processes left; after the last trial the directory too.
    pub(crate) fn tidy(&self) -> Result<(), StudyError> {
        let unfinished = self.path.join(UNFINISHED);
        if unfinished.is_dir() {
            let found = self.read_all(&mut |_| Ok(()))?.found;
            let done = self.kept().into_iter().filter(|trial| found.contains_key(trial));
            done.for_each(|trial| self.forget_unfinished(trial));
            if found.len() as u64 == self.study.total() {
                let _ = self.directory.remove_unfinished(&unfinished);
                let _ = self.directory.remove_dir(&unfinished);
            }
        }
        Ok(())
    }

    /// Shows `each` every finished trial once, in no particular order, and returns the rest. Two lines of one trial must be equal.
    pub fn read(&self, mut each: impl FnMut(Finished) -> Result<(), String>) -> Result<Omitted, StudyError> {
        let Reader { mut notes, found, others, circumstances, .. } = self.read_all(&mut each)?;
        if others > 0 {
            notes.push(format!("{others} trials with other seeds than those of {MANIFEST} are ignored"));
        }
        if circumstances > 0 {
            notes.push(format!(
                "{circumstances} lines of an earlier version say that an environment failed, which is no result: they are \
                 ignored, and the study trains such trials again"
            ));
        }
        let reason = |trial| {
            read_text_limited(&self.unfinished(trial, REASON), MAX_REASON)
                .unwrap_or_else(|_| "it is still being trained, or its process was killed".into())
        };
        let is_missing = |trial: &(usize, u64)| {
            let (config, seed) = trial;
            !found.contains_key(trial)
                && *config < self.study.configs.len()
                && self.study.seeds.contains(seed)
        };
        let name = |config: usize| self.study.configs[config].name.clone();
        let last_try = |(config, seed)| (name(config), seed, reason((config, seed)));
        let last_tries = self.kept().into_iter().filter(is_missing).map(last_try).collect();
        Ok(Omitted { notes, last_tries })
    }

    fn read_all(&self, each: &mut Each) -> Result<Reader<'_>, StudyError> {
        let trials = self.path.join(TRIALS);
        let paths = fs::read_dir(&trials).and_then(|all| all.map(|entry| Ok(entry?.path())).collect());
        let paths = if_there(paths).map_err(|error| StudyError::unreadable(&trials, &error))?;
        let mut files: Vec<PathBuf> = paths.unwrap_or_default();
        files.retain(|path| path.extension().is_some_and(|extension| extension == EXTENSION));
        files.sort();
        let names = self.study.configs.iter().enumerate();
        let configs = names.map(|(i, named)| (named.name.as_str(), i)).collect();
        let (study, found, notes) = (&self.study, HashMap::new(), Vec::new());
        let mut reader = Reader { files, study, configs, found, notes, others: 0, circumstances: 0 };
        (0..reader.files.len()).try_for_each(|file| reader.read(file, each))?;
        Ok(reader)
    }
}

/// Refuses a study in which a process would write, replace or remove something through a link.
fn refuse_links(path: &Path) -> Result<(), StudyError> {
    let check = || {
        let directory = Directory::open(path)?;
        let names = [MANIFEST, TRIALS, UNFINISHED].iter();
        names.copied().try_for_each(|name| directory.refuse_link(&path.join(name)))?;
        let mut kept = fs::read_dir(path.join(UNFINISHED)).into_iter().flatten();
        kept.try_for_each(|entry| directory.refuse_link(&entry?.path()))
    };
    check().map_err(|error| StudyError::directory(path, format!("cannot be used for a study: {error}")))
}

struct Reader<'a> {
    files: Vec<PathBuf>,
    study: &'a Study,
    configs: HashMap<&'a str, usize>,
    /// Where each trial was found first: index of the file, and the line's offset in bytes.
    found: HashMap<(usize, u64), (usize, u64)>,
    notes: Vec<String>,
    others: u64,
    /// Lines that are no results.
    circumstances: u64,
}

impl Reader<'_> {
    fn read(&mut self, file: usize, each: &mut Each) -> Result<(), StudyError> {
        let path = self.files[file].clone();
        let unreadable = |error: io::Error| StudyError::unreadable(&path, &error);
        // A process that had nothing to write has removed its file.
        let Some(opened) = if_there(open_ordinary(&path)).map_err(unreadable)? else { return Ok(()) };
        let mut reader = BufReader::with_capacity(BUFFER, opened);
        let (mut line, mut place) = (Vec::new(), 0);
        for number in 1.. {
            line.clear();
            let length = reader.by_ref().take(MAX_LINE).read_until(b'\n', &mut line).map_err(unreadable)?;
            if length == 0 {
                break;
            }
            if line.pop_if(|byte| *byte == b'\n').is_none() && (length as u64) < MAX_LINE {
                // Another process is writing it, or was killed while it did.
                self.notes.push(format!("line {number} of {} is not finished and is ignored", shown(&path)));
                break;
            }
            let bad = |problem| StudyError::Unusable(format!("{} line {number} {problem}", shown(&path)));
            self.show((file, place), &line, each).map_err(bad)?;
            place += length as u64;
        }
        Ok(())
    }

    /// Shows a line, unless it is a copy.
    fn show(&mut self, place: (usize, u64), line: &[u8], each: &mut Each) -> Result<(), String> {
        let not_a_trial = |problem: String| {
            format!("is not a trial of this study: {problem}; remove the line, and the study trains it again")
        };
        let trial: Trial<TrialSummary> =
            serde_json::from_slice(line).map_err(|error| not_a_trial(error.to_string()))?;
        let Trial { config, seed, .. } = &trial;
        let index = self.configs.get(config.as_str());
        let index = *index.ok_or_else(|| not_a_trial(format!("it belongs to a config {config:?}")))?;
        if trial.is_circumstance() {
            self.circumstances += 1;
            return Ok(());
        }
        if let Some(problem) = trial.problem() {
            return Err(not_a_trial(problem.into()));
        }
        if !self.study.seeds.contains(seed) {
            self.others += 1;
            return Ok(());
        }
        match self.found.get(&(index, *seed)) {
            None => {
                self.found.insert((index, *seed), place);
                each(Finished { config: index, trial }).map_err(not_a_trial)
            }
            Some(&first) => self.compare(first, line).map_err(|other| {
                format!(
                    "has config {config:?} with seed {seed}, and so has {other}, with other bytes. Equal programs on sound \
                     machines write equal lines, and the names of the files begin with those of the machines. Find out which \
                     computes wrongly: train the trial on another, and remove the lines that differ"
                )
            }),
        }
    }

    /// Checks that the line at a place is the same; otherwise the error names that place.
    fn compare(&self, (file, place): (usize, u64), line: &[u8]) -> Result<(), String> {
        let path = &self.files[file];
        let read = || {
            let (mut file, mut bytes) = (File::open(path)?, vec![0; line.len() + 1]);
            file.seek(io::SeekFrom::Start(place))?;
            file.read_exact(&mut bytes).map(|()| bytes)
        };
        match read() {
            Ok(bytes) if bytes.strip_suffix(b"\n") == Some(line) => Ok(()),
            _ => {
                let before = BufReader::new(File::open(path).map_err(|error| error.to_string())?).take(place);
                Err(format!("line {} of {}", before.split(b'\n').count() + 1, shown(path)))
            }
        }
    }
}

pub(super) struct TrialWriter {
    directory: Directory,
    path: PathBuf,
    file: File,
    synced: Instant,
    is_empty: bool,
}

impl TrialWriter {
    /// A new file, of a name that no other process has.
    pub(super) fn new(study_dir: &StudyDir) -> Result<Self, StudyError> {
        let trials = study_dir.path.join(TRIALS);
        let host = crate::os::host_name().replace(|c: char| !c.is_alphanumeric(), "_");
        let directory = study_dir.directory.clone();
        let path = trials.join(format!("{host}-{}-{}.{EXTENSION}", std::process::id(), random_name()));
        let new = directory.create_dir(&trials).and_then(|_| directory.create_file(&path));
        let file = new.map_err(|error| StudyError::Write(trials, error))?;
        Ok(Self { directory, path, file, synced: Instant::now(), is_empty: true })
    }

    /// Appends a trial. After an error the file ends in the middle of a line, and nothing may follow.
    pub(super) fn append(&mut self, trial: &Trial) -> Result<(), StudyError> {
        self.is_empty = false;
        let written = serde_json::to_vec(trial).map_err(io::Error::from).and_then(|mut line| {
            line.push(b'\n');
            self.file.write_all(&line)?;
            if self.synced.elapsed() < SYNC_INTERVAL { Ok(()) } else { self.sync() }
        });
        written.map_err(|error| StudyError::Write(self.path.clone(), error))
    }

    fn sync(&mut self) -> io::Result<()> {
        self.synced = Instant::now();
        self.file.sync_data()
    }

    /// Flushes all trials to the disk; removes a file without any.
    pub(super) fn finish(mut self) -> Result<(), StudyError> {
        let result = if self.is_empty { self.directory.remove_file(&self.path) } else { self.sync() };
        result.map_err(|error| StudyError::Write(self.path, error))
    }
}
