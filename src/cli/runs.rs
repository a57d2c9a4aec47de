//! `cartpole-dqn runs`

use std::collections::BTreeMap;
use std::fmt::Write;
use std::io;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use serde_json::{Value, json};

use super::find::{RUNS, find, written_at};
use super::ui::{Failure, note, print, print_json};
use crate::run::names::{LAST, PREVIOUS};
use crate::text::{COLUMNS, legend, lines, shortened, shown, table, visible};
use crate::trainer::{Evaluation, Event};

const INDENT: usize = 4;
/// Largest width of each column of the table; the run's name takes the rest.
const WIDTHS: [usize; 8] = [16, usize::MAX, 10, 6, 7, 6, 6, 7];

/// List the runs below a directory, the newest first.
///
/// `written` is when the run last wrote a file, `steps` counts the training steps so far, `best` is the best evaluation, the latest
/// of equals, and `final` the latest. `config` is what the config file was called, and ? where the run does not know. The line below
/// a run has the keys that differ from the default, apart from seed and budget. A run that failed diverged: to train it again would
/// end the same way.
#[derive(Debug, clap::Args)]
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

#[derive(Default, serde::Serialize)]
struct ListedRun {
    path: String,
    /// `running`: a process trains it; `stopped`: it can be resumed; `failed`: it has diverged, and would again; `ended`; `damaged`.
    state: &'static str,
    problem: Option<String>,
    written: Option<String>,
    config: Option<String>,
    /// The keys that differ from the default, but for seed and budget, with their values.
    changed: BTreeMap<&'static str, Value>,
    seed: Option<u64>,
    env_steps: Option<u64>,
    /// The best evaluation, the latest of equals.
    best: Option<Evaluation>,
    #[serde(rename = "final")]
    final_: Option<Evaluation>,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let Arguments { directory, json } = arguments;
    let found = find(directory)?;
    let runs: Vec<ListedRun> = found.runs.iter().map(|path| ListedRun::read(path)).collect();
    if *json {
        let problem = |(path, error): &(PathBuf, io::Error)| json!({"path": path.to_string_lossy(), "problem": error.to_string()});
        let unreadable: Vec<Value> = found.unreadable.iter().map(problem).collect();
        return print_json(&json!({"runs": runs, "unreadable": unreadable}));
    }
    let none = format!("no runs below {}\n", shown(directory));
    print(&if runs.is_empty() { none } else { listed(&runs, directory) })?;
    for (path, error) in &found.unreadable {
        note(&format!("{} cannot be searched: {error}", shown(path)));
    }
    for problem in runs.iter().filter_map(|run| run.problem.as_ref()) {
        note(&format!("damaged: {}", visible(problem)));
    }
    Ok(())
}

impl ListedRun {
    fn read(path: &Path) -> Self {
        let (name, written) = (path.to_string_lossy().into_owned(), written_at(path).and_then(iso));
        let mut run = Self { path: name, state: "damaged", written, ..Self::default() };
        run.problem = run.read_files(path).err();
        run
    }

    /// Reads all but the path and when it was written; the error is why the run is damaged.
    fn read_files(&mut self, path: &Path) -> Result<(), String> {
        let (directory, config) = crate::run::RunDir::open(path).map_err(|error| error.to_string())?;
        let about = directory.read_about();
        (self.seed, self.changed) = (Some(config.seed), changed_keys(&config));
        self.config = about.as_ref().map(|about| about.config.clone());
        let (metrics, mut has_ended) = (directory.metrics(), false);
        let read = crate::run::read_events(&metrics, |event| {
            has_ended = matches!(event, Event::End { .. });
            self.take(&event);
        });
        read.map_err(|error| format!("{}: {error}", metrics.display()))?;
        // A shared lock for a moment, which is why `train` tries several times to get its own. A run that has ended is not asked.
        let shared = || crate::files::open_shared(&metrics);
        let is_locked = || shared().is_err_and(|error| error.kind() == io::ErrorKind::WouldBlock);
        let has_checkpoint = directory.last().exists() || directory.previous().exists();
        self.state = match has_ended {
            true if has_checkpoint => "ended",
            false if is_locked() => "running",
            _ if !has_checkpoint => {
                let checkpoints = directory.checkpoints();
                return Err(format!("{}: {LAST} and {PREVIOUS} are missing", checkpoints.display()));
            }
            _ if about.is_some_and(|about| about.failed.is_some()) => "failed",
            _ => "stopped",
        };
        Ok(())
    }

    fn cells(&self, root: &Path) -> Vec<String> {
        let Self { path, state, written, config, seed, env_steps, best, final_, .. } = self;
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
            or_none(env_steps.map(|steps| steps.to_string())),
            mean(*best),
            mean(*final_),
            (*state).into(),
        ];
        cells.iter().zip(WIDTHS).map(|(cell, width)| shortened(cell, width)).collect()
    }

    fn take(&mut self, event: &Event) {
        self.env_steps = Some(event.env_steps());
        if let Event::Evaluation { env_steps, mean, best, .. } = *event {
            self.final_ = Some(Evaluation { env_steps, mean });
            if best {
                self.best = self.final_;
            }
        }
    }
}

fn changed_keys(config: &crate::config::Config) -> BTreeMap<&'static str, Value> {
    let is_own = |path: &str| path == "seed" || path.starts_with("budget") || path == "$schema";
    let changed = config.settings().into_iter().filter(|setting| setting.value != setting.default);
    changed.filter(|setting| !is_own(setting.path)).map(|setting| (setting.path, setting.value)).collect()
}

fn iso(time: SystemTime) -> Option<String> {
    let mut text = String::new();
    let time = Some(time).filter(|time| *time >= SystemTime::UNIX_EPOCH)?;
    // A year of five digits is an error.
    write!(text, "{}", humantime::format_rfc3339_seconds(time)).ok().map(|()| text)
}

/// The runs as a table. A line below a run has as many of the keys that differ as fit.
fn listed(runs: &[ListedRun], root: &Path) -> String {
    let head =
        ["written (UTC)", "run", "config", "seed", "steps", "best", "final", "state"].map(String::from);
    let mut rows = vec![head.to_vec()];
    rows.extend(runs.iter().map(|run| run.cells(root)));
    let table = table(&rows);
    let mut text = String::new();
    for (i, line) in table.lines().enumerate() {
        text += &format!("{line}\n");
        if let Some(ListedRun { changed, .. }) = i.checked_sub(1).and_then(|run| runs.get(run))
            && !changed.is_empty()
        {
            // First what tells the runs apart.
            let is_shared = |(key, value): &(&&str, &Value)| {
                runs.iter().all(|other| other.changed.get(**key) == Some(*value))
            };
            let (shared, own): (Vec<_>, Vec<_>) = changed.iter().partition(is_shared);
            let keys = own.into_iter().chain(shared).map(|(key, value)| format!("{key}={value}"));
            let keys = lines(&visible(&keys.collect::<Vec<_>>().join(" ")), COLUMNS - INDENT - 2);
            let more = if keys.len() > 1 { " …" } else { "" };
            text += &format!("{:INDENT$}{}{more}\n", "", keys[0]);
        }
    }
    let cut = rows[1..].iter().filter(|row| !table.contains(&row[1]));
    text + &legend(cut.map(|row| (row[0].as_str(), row[1].as_str())))
}
