//! `cartpole-dqn runs`

use std::fs::TryLockError;
use std::io::{self, BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

use clap::Args;
use serde::{Deserialize, Serialize};

use super::find::{RUNS, find};
use super::ui::{Failure, note, print, print_json};
use crate::config::Config;
use crate::files::open_ordinary;
use crate::run::RunDir;
use crate::run::names::{LAST, PREVIOUS};
use crate::text::{shortened, shown, visible, width};
use crate::trainer::Evaluation;

/// Longest line of a metrics file, in bytes; a line of `train` has a few hundred.
const MAX_LINE: u64 = 1 << 16;
/// Columns of the table.
const WIDTH: usize = 80;
/// Most columns of a cell but for the run's name, which takes what is left.
const MAX_CELL: usize = 12;
/// The configs of this repository, by which those of runs are called.
const CONFIGS: [(&str, &str); 10] = [
    ("cartpole", include_str!("../../configs/cartpole.json")),
    ("tutorial", include_str!("../../configs/tutorial.json")),
    ("fast", include_str!("../../configs/fast.json")),
    ("plain", include_str!("../../configs/plain.json")),
    ("smoke", include_str!("../../configs/smoke.json")),
    ("acrobot", include_str!("../../configs/acrobot.json")),
    ("mountain_car", include_str!("../../configs/mountain_car.json")),
    ("q_table", include_str!("../../configs/q_table.json")),
    ("q_table_fine", include_str!("../../configs/q_table_fine.json")),
    ("q_table_mountain_car", include_str!("../../configs/q_table_mountain_car.json")),
];

/// List the runs below a directory, the newest first.
///
/// `steps` counts the training steps so far, `best` is the best evaluation and `final` the latest. `config` names the file in
/// configs/ from which the run's config differs least, and +N says in how many keys it differs, apart from seed and budget.
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
    config: Option<Named>,
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
    Ended,
    Damaged,
}

/// What a metrics file says.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
struct History {
    env_steps: Option<u64>,
    /// The best evaluation, the first of equals.
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

/// A config, by the nearest one that has a name.
#[derive(Serialize)]
struct Named {
    nearest: &'static str,
    /// The keys that differ.
    changed: Vec<&'static str>,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let Arguments { directory, json } = arguments;
    let found = find(directory)?;
    let named: Vec<(&str, Config)> = CONFIGS
        .into_iter()
        .filter_map(|(name, text)| Some((name, Config::from_layers(Some((name, text)), &[]).ok()?)))
        .collect();
    let runs = found.runs.iter().map(|path| Run::read(path, &named)).collect();
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
    fn read(path: &Path, named: &[(&'static str, Config)]) -> Self {
        let mut run = Self {
            path: path.to_string_lossy().into_owned(),
            state: State::Damaged,
            problem: None,
            config: None,
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
        (run.seed, run.config) = (Some(config.seed), Named::of(&config, named));
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
            _ => State::Stopped,
        };
        run
    }

    fn cells(&self, root: &Path) -> [String; 7] {
        let Self { path, state, config, seed, history, .. } = self;
        let or_none = |value: Option<String>| value.unwrap_or_else(|| "-".into());
        let name = match Path::new(path).strip_prefix(root) {
            Ok(name) if name != Path::new("") => shown(name),
            _ => visible(path),
        };
        let mean = |evaluation: Option<Evaluation>| or_none(evaluation.map(|e| format!("{:.1}", e.mean)));
        let config = config.as_ref().map(|Named { nearest, changed }| match changed.len() {
            0 => (*nearest).to_owned(),
            count => format!("{nearest}+{count}"),
        });
        [
            name,
            or_none(config),
            or_none(seed.map(|seed| seed.to_string())),
            or_none(history.env_steps.map(|steps| steps.to_string())),
            mean(history.best),
            mean(history.final_),
            state.name().into(),
        ]
    }
}

impl State {
    fn name(self) -> &'static str {
        match self {
            Self::Running => "running",
            Self::Stopped => "stopped",
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
            if self.best.is_none_or(|best| mean > best.mean) {
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

impl Named {
    fn of(config: &Config, named: &[(&'static str, Config)]) -> Option<Self> {
        let changed = |other: &Config| changed_keys(config, other);
        let all = named.iter().map(|(nearest, other)| Self { nearest, changed: changed(other) });
        all.min_by_key(|named| named.changed.len())
    }
}

/// The keys in which two configs differ, but for seed and budget.
fn changed_keys(config: &Config, other: &Config) -> Vec<&'static str> {
    let [settings, others] = [config, other].map(Config::settings);
    let value = |path: &str| others.iter().find(|setting| setting.path == path).map(|setting| &setting.value);
    let is_own = |path: &str| path == "seed" || path.starts_with("budget") || path == "$schema";
    let changed = settings.iter().filter(|setting| value(setting.path) != Some(&setting.value));
    changed.map(|setting| setting.path).filter(|path| !is_own(path)).collect()
}

impl List {
    fn table(&self, root: &Path) -> String {
        let head = ["run", "config", "seed", "steps", "best", "final", "state"].map(String::from);
        let mut rows: Vec<_> =
            std::iter::once(head).chain(self.runs.iter().map(|run| run.cells(root))).collect();
        for cell in rows.iter_mut().flat_map(|row| &mut row[1..]) {
            *cell = shortened(cell, MAX_CELL);
        }
        let widest = |column: usize| rows.iter().map(|row| width(&row[column])).max().unwrap_or(0);
        let mut widths = [0, 1, 2, 3, 4, 5, 6].map(widest);
        let others = widths[1..].iter().map(|width| width + 2).sum::<usize>();
        widths[0] = widths[0].min(WIDTH - others);
        let mut text = String::new();
        for row in &rows {
            let name = shortened(&row[0], widths[0]);
            let padding = " ".repeat(widths[0] - width(&name));
            let cells: [String; 6] = [1, 2, 3, 4, 5, 6].map(|column| {
                let (cell, width) = (&row[column], widths[column]);
                if [1, 6].contains(&column) {
                    format!("  {cell:<width$}")
                } else {
                    format!("  {cell:>width$}")
                }
            });
            text += (name + &padding + &cells.concat()).trim_end();
            text.push('\n');
        }
        text
    }
}
