//! `cartpole-dqn runs`

use std::collections::BTreeMap;
use std::fmt::Write;
use std::fs::TryLockError;
use std::io::{self, BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use clap::Args;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::find::{RUNS, find, written_at};
use super::ui::{Failure, note, print, print_json};
use crate::config::Config;
use crate::files::open_ordinary;
use crate::run::RunDir;
use crate::run::names::{LAST, PREVIOUS};
use crate::text::{COLUMNS, legend, lines, shortened, shown, table, visible};
use crate::trainer::Evaluation;

/// Longest line of a metrics file, in bytes; a line of `train` has a few hundred.
const MAX_LINE: u64 = 1 << 16;
/// Spaces before the keys that differ.
const INDENT: usize = 4;
/// Most columns of each cell of the table; the run's name takes what they leave.
const WIDTHS: [usize; 8] = [16, usize::MAX, 10, 6, 7, 6, 6, 7];

/// List the runs below a directory, the newest first.
///
/// `written` is when the run last wrote a file, `steps` counts the training steps so far, `best` is the best evaluation, the latest
/// of equals, and `final` the latest. `config` is what the config file was called, and ? where the run does not know. The line below
/// a run has the keys that differ from the default, apart from seed and budget. A run that failed diverged: to train it again would
/// end the same way.
#[derive(Debug, Args)]
#[command(after_help = "Example: cartpole-dqn runs
         cartpole-dqn runs studies --json")]
pub(super) struct Arguments {
    /// The directory; links in it are not followed
    #[arg(value_name = "DIR", default_value = RUNS)]
    directory: PathBuf,
    /// Print the list as JSON, and nothing else, on standard output
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct List {
    runs: Vec<Run>,
    unreadable: Vec<Unreadable>,
}

#[derive(Serialize)]
struct Unreadable {
    path: String,
    problem: String,
}

#[derive(Serialize)]
struct Run {
    path: String,
    state: State,
    /// Why the run is damaged.
    problem: Option<String>,
    /// When one of its files was last written.
    written: Option<String>,
    /// What the config was called that it was started with; none where the run does not know.
    config: Option<String>,
    /// The keys that differ from the default, but for seed and budget, with their values.
    changed: BTreeMap<&'static str, Value>,
    seed: Option<u64>,
    #[serde(flatten)]
    history: History,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
enum State {
    /// A process trains it.
    Running,
    /// It can be resumed.
    Stopped,
    /// Its training has diverged, and would again.
    Failed,
    Ended,
    Damaged,
}

/// What a metrics file says.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
struct History {
    env_steps: Option<u64>,
    /// The best evaluation, the latest of equals.
    best: Option<Evaluation>,
    /// The latest evaluation.
    #[serde(rename = "final")]
    final_: Option<Evaluation>,
    #[serde(skip)]
    ended: bool,
}

/// What is read of an event.
#[derive(Deserialize)]
struct Line {
    event: String,
    env_steps: u64,
    mean: Option<f64>,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let Arguments { directory, json } = arguments;
    let found = find(directory)?;
    let runs = found.runs.iter().map(|path| Run::read(path)).collect();
    let unreadable = found.unreadable.into_iter().map(|(path, error)| Unreadable {
        path: path.to_string_lossy().into_owned(),
        problem: error.to_string(),
    });
    let list = List { runs, unreadable: unreadable.collect() };
    if *json {
        return print_json(&list);
    }
    match list.runs.is_empty() {
        true => print(&format!("no runs below {}\n", shown(directory)))?,
        false => print(&list.table(directory))?,
    }
    for Unreadable { path, problem } in &list.unreadable {
        note(&format!("{} cannot be searched: {problem}", visible(path)));
    }
    for run in &list.runs {
        if let Some(problem) = &run.problem {
            note(&format!("damaged: {}", visible(problem)));
        }
    }
    Ok(())
}

impl Run {
    fn read(path: &Path) -> Self {
        let mut run = Self {
            path: path.to_string_lossy().into_owned(),
            state: State::Damaged,
            problem: None,
            written: written_at(path).and_then(iso),
            config: None,
            changed: BTreeMap::new(),
            seed: None,
            history: History::default(),
        };
        let (directory, config) = match RunDir::open(path) {
            Ok(opened) => opened,
            Err(error) => {
                run.problem = Some(error.to_string());
                return run;
            }
        };
        let about = directory.read_about();
        (run.seed, run.changed) = (Some(config.seed), changed_keys(&config));
        run.config = about.as_ref().map(|about| about.config.clone());
        match History::read(&directory.metrics()) {
            Ok(history) => run.history = history,
            Err(error) => {
                run.problem = Some(format!("{}: {error}", directory.metrics().display()));
                return run;
            }
        }
        let has_checkpoint = directory.last().exists() || directory.previous().exists();
        run.state = match run.history.ended {
            true if has_checkpoint => State::Ended,
            // Only a run that has not ended is asked for: the lock that tells is held for a moment.
            false if is_locked(&directory.metrics()) => State::Running,
            _ if !has_checkpoint => {
                let folder = directory.checkpoints();
                run.problem = Some(format!("{}: {LAST} and {PREVIOUS} are missing", folder.display()));
                State::Damaged
            }
            _ if about.is_some_and(|about| about.failed.is_some()) => State::Failed,
            _ => State::Stopped,
        };
        run
    }

    fn cells(&self, root: &Path) -> Vec<String> {
        let Self { path, state, written, config, seed, history, .. } = self;
        let or_none = |value: Option<String>| value.unwrap_or_else(|| "-".into());
        let name = match Path::new(path).strip_prefix(root) {
            Ok(name) if name != Path::new("") => shown(name),
            _ => visible(path),
        };
        let mean = |evaluation: Option<Evaluation>| or_none(evaluation.map(|e| format!("{:.1}", e.mean)));
        let cells = [
            // To the minute.
            or_none(written.as_ref().map(|time| time.replace('T', " ").chars().take(WIDTHS[0]).collect())),
            name,
            config.as_ref().map_or_else(|| "?".into(), |config| visible(config)),
            or_none(seed.map(|seed| seed.to_string())),
            or_none(history.env_steps.map(|steps| steps.to_string())),
            mean(history.best),
            mean(history.final_),
            state.name().into(),
        ];
        cells.iter().zip(WIDTHS).map(|(cell, width)| shortened(cell, width)).collect()
    }
}

impl State {
    fn name(self) -> &'static str {
        match self {
            Self::Running => "running",
            Self::Stopped => "stopped",
            Self::Failed => "failed",
            Self::Ended => "ended",
            Self::Damaged => "damaged",
        }
    }
}

impl History {
    /// Reads a metrics file line by line, until the first line that is none of a run.
    fn read(path: &Path) -> io::Result<Self> {
        let mut reader = BufReader::new(open_ordinary(path)?);
        let mut history = Self::default();
        let mut line = Vec::new();
        for number in 1.. {
            line.clear();
            let length = (&mut reader).take(MAX_LINE).read_until(b'\n', &mut line)?;
            // A run that was killed can leave half a line at the end.
            if length == 0 || (line.last() != Some(&b'\n') && (length as u64) < MAX_LINE) {
                break;
            }
            let event = serde_json::from_slice(&line).map_err(|_| {
                io::Error::new(io::ErrorKind::InvalidData, format!("line {number} is not an event of a run"))
            })?;
            history.take(&event);
        }
        Ok(history)
    }

    fn take(&mut self, line: &Line) {
        let Line { ref event, env_steps, mean } = *line;
        self.env_steps = Some(env_steps);
        self.ended = event == "end";
        if let ("evaluation", Some(mean)) = (event.as_str(), mean) {
            let evaluation = Some(Evaluation { env_steps, mean });
            self.final_ = evaluation;
            if self.best.is_none_or(|best| mean >= best.mean) {
                self.best = evaluation;
            }
        }
    }
}

/// Whether another process trains the run of this metrics file. To ask takes a lock that others may share, for a moment;
/// `train` asks several times before it takes that for another process that trains.
fn is_locked(metrics: &Path) -> bool {
    let file = open_ordinary(metrics);
    file.is_ok_and(|file| matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock)))
}

/// The keys that differ from the default, but for seed and budget.
fn changed_keys(config: &Config) -> BTreeMap<&'static str, Value> {
    let is_own = |path: &str| path == "seed" || path.starts_with("budget") || path == "$schema";
    let changed = config.settings().into_iter().filter(|setting| setting.value != setting.default);
    changed.filter(|setting| !is_own(setting.path)).map(|setting| (setting.path, setting.value)).collect()
}

/// A time of this calendar, to the second.
fn iso(time: SystemTime) -> Option<String> {
    let mut text = String::new();
    let time = Some(time).filter(|time| *time >= SystemTime::UNIX_EPOCH)?;
    // A year of five digits is an error.
    write!(text, "{}", humantime::format_rfc3339_seconds(time)).ok().map(|()| text)
}

impl List {
    /// The runs as a table. A line below a run has as many of the keys that differ as fit.
    fn table(&self, root: &Path) -> String {
        let head =
            ["written (UTC)", "run", "config", "seed", "steps", "best", "final", "state"].map(String::from);
        let rows: Vec<Vec<String>> =
            std::iter::once(head.to_vec()).chain(self.runs.iter().map(|run| run.cells(root))).collect();
        let table = table(&rows);
        let mut text = String::new();
        for (i, line) in table.lines().enumerate() {
            text += &format!("{line}\n");
            if let Some(Run { changed, .. }) = i.checked_sub(1).and_then(|run| self.runs.get(run))
                && !changed.is_empty()
            {
                // First what tells the runs apart.
                let is_shared = |(key, value): &(&&str, &Value)| {
                    self.runs.iter().all(|other| other.changed.get(**key) == Some(*value))
                };
                let (shared, own): (Vec<_>, Vec<_>) = changed.iter().partition(is_shared);
                let keys = own.into_iter().chain(shared).map(|(key, value)| format!("{key}={value}"));
                let keys: Vec<String> = keys.collect();
                let keys = lines(&visible(&keys.join(" ")), COLUMNS - INDENT - 2);
                let more = if keys.len() > 1 { " …" } else { "" };
                text += &format!("{:INDENT$}{}{more}\n", "", keys[0]);
            }
        }
        let cut = rows[1..].iter().filter(|row| !table.contains(&row[1]));
        text + &legend(cut.map(|row| (row[0].as_str(), row[1].as_str())))
    }
}
