//! `cartpole-dqn study`

use std::collections::{BTreeSet, HashSet};
use std::io::{self, Write};
use std::num::NonZero;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::thread;
use std::time::{Duration, Instant};

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};

use super::permission::{AllowCommand, Programs};
use super::plan;
use super::signals::Signals;
use super::ui::{Failure, cannot_write, check_out, note, on_one_line, print};
use super::variations::{Variations, configs};
use crate::config::Config;
use crate::env::Spec;
use crate::report;
use crate::study::{
    Cause, Finished, MAX_SEEDS, NamedConfig, Omitted, Shard, Study, StudyDir, StudyError, Trial, Unended,
};
use crate::text::{shell_word, shown, visible, wrapped};

/// Shortest time between two plain lines of progress.
const LINE_INTERVAL: Duration = Duration::from_secs(2);

/// Train every combination of config, variation and seed.
///
/// Each combination of config, variation and seed is a trial. A study that was stopped is resumed by the same command, which
/// may have more seeds at the end, or by `study DIR`. Any number of processes can work on one study at the same time, each
/// on its --shard. The results depend neither on that nor on --jobs. At the end the configs are printed, the best first.
///
/// A trial whose training diverges has failed, which is a result. A trial whose environment or disk fails has no result: the
/// other trials go on, and the same command resumes it.
///
/// The exit code is 1 if a trial failed or has no result, and 130 or 143 if a signal or --time-limit left trials to do.
#[derive(Debug, Args)]
#[command(
    after_help = "Example: cartpole-dqn study --vary gamma=0.95,0.99 --set stop_when_lasting_steps=null \
        --seeds 0..100 --out studies/gamma\nThen:    cartpole-dqn report studies/gamma"
)]
pub(super) struct Arguments {
    /// Directory of a study to go on with, as its study.json says
    #[arg(value_name = "DIR", conflicts_with_all = ["config", "vary", "set", "seeds", "out", "lasting"])]
    folder: Option<PathBuf>,
    /// The same as DIR alone
    #[arg(long, value_name = "DIR",
        conflicts_with_all = ["folder", "config", "vary", "set", "seeds", "out", "lasting"])]
    resume: Option<PathBuf>,
    #[command(flatten)]
    variations: Variations,
    /// Train with the seeds A to B − 1
    #[arg(long, value_name = "A..B", value_parser = seeds, allow_hyphen_values = true,
        required_unless_present_any = ["folder", "resume"])]
    seeds: Option<Range<u64>>,
    /// Directory for the study
    #[arg(long, value_name = "DIR", required_unless_present_any = ["folder", "resume"])]
    out: Option<PathBuf>,
    /// Run every N-th trial alone, from number I on (0 to N − 1), as one of N processes
    #[arg(long, value_name = "I/N")]
    shard: Option<Shard>,
    /// Write study.json, estimate from one trial what the study costs, and print how clusters run it
    #[arg(long, conflicts_with_all = ["shard", "status", "time_limit"])]
    plan: bool,
    /// Print how many trials of DIR are done, missing and failed
    #[arg(long, conflicts_with_all = ["seeds", "shard", "time_limit"])]
    status: bool,
    /// Stop after this time, such as 55m, as if SIGTERM had come
    #[arg(long, value_name = "TIME", value_parser = humantime::parse_duration)]
    time_limit: Option<Duration>,
    /// How many trials run at the same time [default: one per CPU]
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = super::ui::integer::<1, 4096>)]
    jobs: Option<u64>,
    /// Also test whether every policy lasts 20,000 steps, as `stop_when_lasting_steps` tests it; only CartPole's episodes can last so long
    #[arg(long, alias = "endurance")]
    lasting: bool,
    #[command(flatten)]
    allow: AllowCommand,
    /// Show no progress and no result
    #[arg(long)]
    quiet: bool,
}

impl From<StudyError> for Failure {
    fn from(error: StudyError) -> Self {
        match error {
            StudyError::Unwritable(path, source) => cannot_write(&path, &source, "; choose another --out"),
            StudyError::Write(_, ref source) => match Self::unwritten(on_one_line(&error), source) {
                Self::Failed(message) => Self::Disturbed(message),
                bad_input => bad_input,
            },
            StudyError::Unusable(_) => Self::BadInput(on_one_line(&error)),
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

impl Arguments {
    /// The directory of the study.
    fn path(&self) -> &Path {
        let path = self.folder.as_ref().or(self.resume.as_ref()).or(self.out.as_ref());
        path.map_or(Path::new("."), PathBuf::as_path)
    }

    fn jobs(&self) -> usize {
        let cpus = || thread::available_parallelism().map_or(1, NonZero::get);
        self.jobs.map_or_else(cpus, |jobs| jobs as usize)
    }

    /// Opens a study, or makes a new one.
    fn open(&self) -> Result<StudyDir, Failure> {
        let (Some(out), Some(seeds)) = (&self.out, &self.seeds) else {
            if self.status {
                return Ok(StudyDir::open_to_read(self.path())?);
            }
            let mut folder = StudyDir::open(self.path())?;
            let (place, mut programs) = (format!("study {}", shown(self.path())), Programs::default());
            for environment in folder.environments_mut() {
                programs.permit(self.allow, environment, &place).map_err(Failure::BadInput)?;
            }
            return Ok(folder);
        };
        check_out(out)?;
        let study = Study::new(configs(&self.variations)?, seeds.clone(), self.lasting);
        if !self.plan {
            check_memory(&study, self.jobs())?;
        }
        Ok(StudyDir::create(out, study)?)
    }
}

/// Whether so many trials at the same time find the memory that they take.
fn check_memory(study: &Study, jobs: usize) -> Result<(), Failure> {
    let at_once = jobs.min(study.trials(Shard::ALL).take(jobs).count());
    for NamedConfig { config, .. } in &study.configs {
        config.check_memory(at_once).map_err(|error| {
            Failure::BadInput(format!("{error} (--jobs {jobs} trains so many runs at the same time)"))
        })?;
    }
    Ok(())
}

/// Waits for the programs of these configs, as long as a signal ends the process at once. Whether one fails is seen by its
/// trials.
fn start_programs<'a>(configs: impl Iterator<Item = &'a NamedConfig>) {
    for NamedConfig { config, task, .. } in configs {
        drop((config.make())(task.max_steps));
    }
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let folder = arguments.open()?;
    if arguments.status {
        return print(&plan::status(&folder)?);
    }
    if arguments.plan && arguments.quiet {
        return Ok(());
    }
    if arguments.plan {
        start_programs(folder.study().configs.iter().take(1));
        let signals = Signals::listen();
        return print(&plan::estimate(&folder, arguments.path(), &signals.stop)?);
    }
    check_memory(folder.study(), arguments.jobs())?;
    let shard = arguments.shard.unwrap_or(Shard::ALL);
    let (pending, mut progress) = pending(&folder, shard, arguments.quiet)?;
    let configs: BTreeSet<usize> = pending.iter().map(|(config, _)| *config).collect();
    start_programs(configs.into_iter().map(|config| &folder.study().configs[config]));
    let signals = Signals::listen();
    arguments.time_limit.map_or(Ok(()), |limit| signals.stop_after(limit))?;
    let ended =
        folder.run(&pending, &Config::make, arguments.jobs(), &signals.stop, |ended| progress.show(ended));
    progress.bar.finish_and_clear();
    ended?;
    folder.tidy()?;
    if progress.done < progress.total {
        let message = progress.left();
        return Err(match signals.stop.load(Ordering::Relaxed) {
            true => Failure::Interrupted(format!("stopped: {message}"), signals.exit_code()),
            false => Failure::Disturbed(message),
        });
    }
    let out = arguments.path().to_string_lossy();
    let report = format!("cartpole-dqn report {}", shell_word(&out));
    if !arguments.quiet {
        match arguments.shard {
            None => print(&format!(
                "{}\nstudy      {}\nreport     {report}\n",
                report::standing(&folder)?,
                visible(&out)
            ))?,
            Some(_) => print(&progress.of_shard(&out))?,
        }
    }
    match progress.first_error {
        None => Ok(()),
        Some((_, error)) => {
            let Progress { failed, done, .. } = progress;
            Err(Failure::Failed(format!(
                "{failed} of {done} trials failed, for example {error}; see: {report}"
            )))
        }
    }
}

/// The trials of a shard that nobody has finished yet, and the progress until now.
fn pending(folder: &StudyDir, shard: Shard, quiet: bool) -> Result<(Vec<(usize, u64)>, Progress), Failure> {
    let study = folder.study();
    let (mut finished, mut failed) = (HashSet::new(), Vec::new());
    let Omitted { notes, .. } = folder.read(|Finished { config, trial }| {
        let number = (config, trial.seed);
        if study.is_in(shard, number) {
            finished.insert(number);
            failed.extend(trial.error.is_some().then_some(trial));
        }
        Ok(())
    })?;
    notes.iter().for_each(|text| note(text));
    let pending: Vec<_> = study.trials(shard).filter(|trial| !finished.contains(trial)).collect();
    let mut progress = Progress::new(study, finished.len() as u64, pending.len() as u64, quiet);
    failed.iter().for_each(|trial| progress.count_failure(trial));
    Ok((pending, progress))
}

/// The command that this process was started with.
fn own_command() -> String {
    let words: Vec<String> =
        std::env::args_os().map(|word| visible(&shell_word(&word.to_string_lossy()))).collect();
    words.join(" ")
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
    /// Trials that this process has trained, and how many of them solved.
    trained: u64,
    solved: u64,
    failed: u64,
    /// Of the smallest seed.
    first_error: Option<(u64, String)>,
    /// Trials without a result that have a checkpoint, and those without one.
    kept: u64,
    lost: u64,
    /// Those of them that were not asked to stop, and what ended the first.
    disturbed: u64,
    first_disturbance: Option<String>,
}

impl Progress {
    fn new(study: &Study, done: u64, pending: u64, quiet: bool) -> Self {
        let total = done + pending;
        let bar = if quiet { ProgressBar::hidden() } else { ProgressBar::new(total) };
        if let Ok(style) = ProgressStyle::with_template("trial {pos}/{len} {wide_bar} eta {eta}\n{wide_msg}")
        {
            bar.set_style(style);
        }
        // The trials that are done took no time.
        bar.set_position(done);
        bar.reset_eta();
        Self {
            bar,
            quiet,
            last_line: Instant::now(),
            tasks: study.configs.iter().map(|named| (named.name.clone(), named.task.clone())).collect(),
            total,
            done,
            trained: 0,
            solved: 0,
            failed: 0,
            first_error: None,
            kept: 0,
            lost: 0,
            disturbed: 0,
            first_disturbance: None,
        }
    }

    fn count_failure<S>(&mut self, trial: &Trial<S>) {
        let Some(error) = &trial.error else { return };
        self.failed += 1;
        if self.first_error.as_ref().is_none_or(|(seed, _)| trial.seed < *seed) {
            let Trial { config, seed, .. } = trial;
            self.first_error = Some((*seed, visible(&format!("{config}, seed {seed}: {error}"))));
        }
    }

    fn counts(&self) -> String {
        let Self { solved, trained, failed, .. } = self;
        format!("final policy solved {solved} of {trained}, failed {failed}")
    }

    fn show(&mut self, ended: &Result<Trial, Unended>) {
        match ended {
            Ok(trial) => self.show_trial(trial),
            Err(unended) => self.count_unended(unended),
        }
    }

    fn count_unended(&mut self, unended: &Unended) {
        let count = if unended.is_kept { &mut self.kept } else { &mut self.lost };
        *count += 1;
        if matches!(unended.cause, Cause::Failed(_)) {
            self.disturbed += 1;
            self.first_disturbance.get_or_insert_with(|| visible(&unended.to_string()));
        }
    }

    fn show_trial(&mut self, trial: &Trial) {
        self.done += 1;
        self.trained += 1;
        let task = self.tasks.iter().find(|(name, _)| *name == trial.config);
        self.solved += u64::from(task.is_some_and(|(_, task)| trial.solved(task)));
        self.count_failure(trial);
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

    fn of_shard(&self, out: &str) -> String {
        let Self { done, trained, failed, .. } = self;
        format!(
            "trials     {done} of this shard, of which this process trained {trained}\nfailed     {failed}\n\
             progress   cartpole-dqn study {} --status\n",
            shell_word(out)
        )
    }

    /// What there is left to do.
    fn left(&self) -> String {
        let Self { done, total, kept, lost, disturbed, .. } = self;
        let mut what = format!("{done} of {total} trials are finished and kept.");
        if let Some(first) = &self.first_disturbance {
            what += &format!(" {disturbed} ended without a result, for example {first}.");
        }
        what += &match (kept, lost) {
            (0, 0) => String::new(),
            (_, 0) => format!(" Those that had begun are resumed from their checkpoints ({kept})."),
            (0, _) => format!(" Those that had begun have no checkpoint and are trained again ({lost})."),
            _ => format!(
                " Those that had begun are resumed from their checkpoints ({kept}) or, without one, trained again ({lost})."
            ),
        };
        what += " Resume the study with the same command:";
        format!("{}  {}", wrapped(&what, 0), own_command())
    }
}
