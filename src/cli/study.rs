//! `cartpole-dqn study`

use std::collections::{BTreeMap, BTreeSet};
use std::io::{self, Write};
use std::num::NonZero;
use std::ops::Range;
use std::path::PathBuf;
use std::thread;
use std::time::{Duration, Instant};

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::Value;

use super::layers::{DEFAULT_CONFIG, DEFAULT_NAME, config_name, read_config};
use super::permission::Programs;
use super::signals::Signals;
use super::ui::{Failure, cannot_write, check_out, print, shell_word};
use crate::config::Config;
use crate::env::Spec;
use crate::report;
use crate::study::{NamedConfig, Study, StudyDir, StudyError, Trial};
use crate::text::{visible, wrapped};

/// Shortest time between two plain lines of progress.
const LINE_INTERVAL: Duration = Duration::from_secs(2);
/// Most configs of a study, so that a slip of the keyboard does not fill the memory.
const MAX_CONFIGS: usize = 10_000;
/// Most seeds of a study, for the same reason.
const MAX_SEEDS: u64 = 1_000_000;

/// Train every combination of config, variation and seed.
///
/// Each combination of config, variation and seed is a trial and writes one file. A study that was stopped is resumed by
/// the same command, which may have more seeds at the end. The results do not depend on --jobs. At the end the configs
/// are printed, the best first; the exit code is 1 if a trial failed.
#[derive(Debug, Args)]
#[command(
    after_help = "Example: cartpole-dqn study --vary gamma=0.95,0.99 --vary loss=mse,huber --seeds 0..100 \
        --out studies/gamma\nThen:    cartpole-dqn report studies/gamma"
)]
pub(super) struct Arguments {
    /// JSON file with settings, `-` for standard input, may be repeated [default: the built-in configs/cartpole.json]
    #[arg(long, value_name = "FILE")]
    config: Vec<PathBuf>,
    /// Values of a config key to compare: KEY=V1,V2, or KEY=[V1, V2] as JSON if values hold commas; may be repeated
    #[arg(long, value_name = "KEY=VALUES", value_parser = variation)]
    vary: Vec<Variation>,
    /// Set one config key in all configs; may be repeated
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Train with the seeds A to B − 1
    #[arg(long, value_name = "A..B", value_parser = seeds, allow_hyphen_values = true)]
    seeds: Range<u64>,
    /// Directory for the study
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// How many trials run at the same time [default: one per CPU]
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = super::ui::integer::<1, 4096>)]
    jobs: Option<u64>,
    /// Also play every policy for up to 20,000 steps, which shows a cart that drifts away slowly; only CartPole's episodes can last so long
    #[arg(long)]
    endurance: bool,
    /// Show no progress and no result
    #[arg(long)]
    quiet: bool,
}

/// A key and the values that it takes in turn.
#[derive(Clone, Debug)]
struct Variation {
    key: String,
    values: Vec<String>,
}

impl From<StudyError> for Failure {
    fn from(error: StudyError) -> Self {
        match error {
            StudyError::Unwritable { path, source } => cannot_write(&path, &source, "; choose another --out"),
            StudyError::Write { .. } => Self::Failed(error.to_string()),
            StudyError::Folder { .. } | StudyError::Trial { .. } => Self::BadInput(error.to_string()),
        }
    }
}

fn seeds(text: &str) -> Result<Range<u64>, String> {
    let range = text.split_once("..").and_then(|(start, end)| Some(start.parse().ok()?..end.parse().ok()?));
    let range: Range<u64> = range.filter(|range: &Range<u64>| !range.is_empty()).ok_or_else(|| {
        format!("expected A..B with integers A < B up to {}, for example 0..100, which ends at 99", u64::MAX)
    })?;
    match range.end - range.start {
        0..=MAX_SEEDS => Ok(range),
        seeds => Err(format!("the range has {seeds} seeds; at most {MAX_SEEDS} are allowed")),
    }
}

fn variation(text: &str) -> Result<Variation, String> {
    let (key, list) = text.split_once('=').ok_or("expected KEY=V1,V2 or KEY=[V1, V2]")?;
    let values: Vec<String> = if list.starts_with('[') {
        let values: Vec<Value> =
            serde_json::from_str(list).map_err(|error| format!("expected a JSON list: {error}"))?;
        values.iter().map(Value::to_string).collect()
    } else if list.starts_with('{') {
        return Err(format!("write objects as a JSON list: {key}=[{{…}}, {{…}}]"));
    } else {
        list.split(',').map(str::to_owned).collect()
    };
    if key == "seed" {
        Err("the seeds of a study are given by --seeds".into())
    } else if values.iter().any(String::is_empty) || values.is_empty() {
        Err("a value is missing".into())
    } else if values.iter().collect::<BTreeSet<_>>().len() < values.len() {
        Err("a value is given twice; remove one".into())
    } else {
        Ok(Variation { key: key.into(), values })
    }
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    check_out(&arguments.out)?;
    let study = Study::new(configs(arguments)?, arguments.seeds.clone(), arguments.endurance);
    let cpus = || thread::available_parallelism().map_or(1, NonZero::get);
    let jobs = arguments.jobs.map_or_else(cpus, |jobs| jobs as usize);
    let at_once = jobs.min(study.trials().take(jobs).count());
    for NamedConfig { config, .. } in &study.configs {
        config.check_memory(at_once).map_err(|error| {
            Failure::BadInput(format!("{error} (--jobs {jobs} trains so many runs at the same time)"))
        })?;
    }
    let signals = Signals::listen();
    let folder = StudyDir::open(&arguments.out, &study)?;
    let mut progress = Progress::new(&study, arguments.quiet);
    for trial in folder.finished(&study) {
        progress.count(&trial?);
    }
    progress.start();
    let ended = folder.run(&study, jobs, &signals.stop, |trial| {
        progress.count(trial);
        progress.show();
    });
    progress.bar.finish_and_clear();
    ended?;
    if progress.done < progress.total {
        return Err(Failure::Interrupted(progress.interrupted(), signals.exit_code()));
    }
    let out = arguments.out.to_string_lossy();
    let report = format!("cartpole-dqn report {}", shell_word(&out));
    if !arguments.quiet {
        let result = report::standing(&arguments.out)?;
        print(&format!(
            "{}\n{result}\nstudy      {}\nreport     {report}\n",
            progress.result(),
            visible(&out)
        ))?;
    }
    match progress.first_error {
        None => Ok(()),
        Some(error) => {
            let Progress { failed, done, .. } = progress;
            Err(Failure::Failed(format!(
                "{failed} of {done} trials failed, for example {error}; see: {report}"
            )))
        }
    }
}

/// The command that this process was started with.
fn own_command() -> String {
    let words: Vec<String> =
        std::env::args_os().map(|word| visible(&shell_word(&word.to_string_lossy()))).collect();
    words.join(" ")
}

/// Every config in every variation, all of them valid.
fn configs(arguments: &Arguments) -> Result<Vec<NamedConfig>, Failure> {
    let mut sources = Vec::new();
    for path in &arguments.config {
        let (origin, text) = read_config(path)?;
        sources.push((config_name(path), visible(&origin), text));
    }
    if sources.is_empty() {
        sources.push((DEFAULT_NAME.into(), "the built-in config".into(), DEFAULT_CONFIG.into()));
    }
    if arguments.set.iter().any(|set| set.starts_with("seed=")) {
        return Err(Failure::BadInput("--set seed: the seeds of a study are given by --seeds".into()));
    }
    for Variation { key, .. } in &arguments.vary {
        let is_overwritten = |set: &&String| {
            let below = set.strip_prefix(key.as_str());
            below.is_some_and(|rest| rest.starts_with(['=', '.']))
        };
        if let Some(set) = arguments.set.iter().find(is_overwritten) {
            return Err(Failure::BadInput(format!(
                "--vary {key} overwrites --set {}; give one of the two",
                visible(set)
            )));
        }
    }
    let variations = combinations(&arguments.vary, MAX_CONFIGS / sources.len())?;
    let mut configs: Vec<NamedConfig> = Vec::new();
    let mut programs = Programs::default();
    for (stem, origin, text) in &sources {
        let mut seen = BTreeMap::new();
        for variation in &variations {
            let name = [std::slice::from_ref(stem), variation].concat().join(" ");
            let sets = [&arguments.set[..], variation].concat();
            let mut config =
                Config::from_layers(Some((origin, text)), &sets).map_err(|error| match &variation[..] {
                    [] => error.into(),
                    _ => Failure::BadInput(format!("variation {}: {error}", variation.join(" "))),
                })?;
            // Two spellings of one value, such as 0.9 and 0.90, would train the same config twice.
            let parsed =
                serde_json::to_string(&config).map_err(|error| Failure::Failed(error.to_string()))?;
            if let Some(other) = seen.insert(parsed, variation) {
                return Err(Failure::BadInput(format!(
                    "--vary: {} and {} are the same config; leave one out",
                    other.join(" "),
                    variation.join(" ")
                )));
            }
            if configs.iter().any(|other| other.name == name) {
                return Err(Failure::BadInput(format!(
                    "--config {origin}: two configs are called {stem:?}; rename a file"
                )));
            }
            programs.ask_task(&mut config)?;
            configs.push(NamedConfig::new(name, config)?);
        }
    }
    Ok(configs)
}

/// The cross product of the variations, each as `key=value`s.
fn combinations(vary: &[Variation], limit: usize) -> Result<Vec<Vec<String>>, Failure> {
    let mut products = vec![Vec::new()];
    for (i, Variation { key, values }) in vary.iter().enumerate() {
        if vary[..i].iter().any(|other| other.key == *key) {
            return Err(Failure::BadInput(format!(
                "--vary {key} is given twice; put all its values into one --vary"
            )));
        }
        if products.len().saturating_mul(values.len()) > limit {
            return Err(Failure::BadInput(format!("--vary makes more than {MAX_CONFIGS} configs")));
        }
        let extend = |product: &Vec<String>| {
            values
                .iter()
                .map(|value| [&product[..], &[format!("{key}={value}")]].concat())
                .collect::<Vec<_>>()
        };
        products = products.iter().flat_map(extend).collect();
    }
    Ok(products)
}

/// Counts trials, and shows them on stderr: a bar on a terminal, elsewhere a plain line now and then.
struct Progress {
    bar: ProgressBar,
    quiet: bool,
    last_line: Instant,
    /// What each config is called, and its task.
    tasks: Vec<(String, Spec)>,
    total: u64,
    done: u64,
    solved: u64,
    failed: u64,
    first_error: Option<String>,
}

impl Progress {
    fn new(study: &Study, quiet: bool) -> Self {
        let total = (study.configs.len() as u64).saturating_mul(study.seeds.end - study.seeds.start);
        let bar = if quiet { ProgressBar::hidden() } else { ProgressBar::new(total) };
        if let Ok(style) = ProgressStyle::with_template("trial {pos}/{len} {wide_bar} eta {eta}\n{wide_msg}")
        {
            bar.set_style(style);
        }
        Self {
            bar,
            quiet,
            last_line: Instant::now(),
            tasks: study.configs.iter().map(|named| (named.name.clone(), named.task.clone())).collect(),
            total,
            done: 0,
            solved: 0,
            failed: 0,
            first_error: None,
        }
    }

    fn count(&mut self, trial: &Trial) {
        self.done += 1;
        let task = self.tasks.iter().find(|(name, _)| *name == trial.config);
        self.solved += u64::from(task.is_some_and(|(_, task)| trial.solved(task)));
        if let Some(error) = &trial.error {
            self.failed += 1;
            let Trial { config, seed, .. } = trial;
            self.first_error.get_or_insert_with(|| visible(&format!("{config}, seed {seed}: {error}")));
        }
    }

    /// The trials counted until now took no time.
    fn start(&self) {
        self.bar.set_position(self.done);
        self.bar.reset_eta();
        self.bar.set_message(self.counts());
    }

    fn counts(&self) -> String {
        format!("final policy solved {} of {}, failed {}", self.solved, self.done, self.failed)
    }

    fn show(&mut self) {
        self.bar.set_position(self.done);
        self.bar.set_message(self.counts());
        if !self.quiet && self.bar.is_hidden() && self.last_line.elapsed() >= LINE_INTERVAL {
            self.last_line = Instant::now();
            let eta = self.bar.eta().as_secs();
            // A closed stderr is no reason to stop a study.
            let _ = writeln!(
                io::stderr(),
                "trial {}/{} | {} | eta {eta} s",
                self.done,
                self.total,
                self.counts()
            );
        }
    }

    fn result(&self) -> String {
        format!(
            "trials     {}\nsolved     {} by the final policy (mean return {} over eval's 100 episodes)\n\
             failed     {}\n",
            self.done,
            self.solved,
            self.tasks[0].1.goal(),
            self.failed
        )
    }

    fn interrupted(&self) -> String {
        let Self { done, total, .. } = self;
        let what = format!(
            "stopped: {done} of {total} trials are finished and kept; those that were training were dropped and begin \
             again. Resume the study with the same command:"
        );
        format!("{}  {}", wrapped(&what, 0), own_command())
    }
}
