//! `cartpole-dqn study`

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use indicatif::ProgressBar;

use super::permission::{AllowCommand, SharedPrograms};
use super::plan;
use super::signals::Signals;
use super::ui::{Failure, cannot_write, check_out, note, on_one_line, print, say};
use super::variations::{Variations, configs};
use crate::config::Config;
use crate::report;
use crate::sink::{LINE_INTERVAL, progress_bar};
use crate::study::{
    Cause, Finished, MAX_SEEDS, NamedConfig, Omitted, Shard, Study, StudyDir, StudyError, Trial, Unended,
};
use crate::text::{shell_word, shown, visible, wrapped};

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
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example: cartpole-dqn study --vary gamma=0.95,0.99 --set stop_when_lasting_steps=null \
        --seeds 0..100 --out studies/gamma\nThen:    cartpole-dqn report studies/gamma"
)]
pub(super) struct StudyArguments {
    /// Directory of a study to resume, as its study.json says
    #[arg(value_name = "DIR", conflicts_with_all = ["config", "vary", "set", "seeds", "out", "lasting"])]
    directory: Option<PathBuf>,
    #[command(flatten)]
    variations: Variations,
    /// Train with the seeds A to B − 1
    #[arg(long, value_name = "A..B", value_parser = seeds, allow_hyphen_values = true,
        required_unless_present = "directory")]
    seeds: Option<Range<u64>>,
    /// Directory for the study
    #[arg(long, value_name = "DIR", required_unless_present = "directory")]
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

impl StudyArguments {
    /// The directory of the study. Without it, clap demands --out.
    fn path(&self) -> &Path {
        self.directory.as_deref().or(self.out.as_deref()).unwrap_or(Path::new("."))
    }

    fn jobs(&self) -> usize {
        let cpus = || std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        self.jobs.map_or_else(cpus, |jobs| jobs as usize)
    }

    fn open(&self) -> Result<StudyDir, Failure> {
        if let (Some(out), Some(seeds)) = (&self.out, &self.seeds) {
            check_out(out)?;
            let study = Study::new(configs(&self.variations)?, seeds.clone(), self.lasting);
            self.check_memory(&study)?;
            return Ok(StudyDir::create(out, study)?);
        }
        let mut dir = StudyDir::open(self.path())?;
        let (place, mut programs) = (format!("study {}", shown(self.path())), SharedPrograms::default());
        for NamedConfig { config, .. } in &mut dir.study.configs {
            let permit = |program: &mut _| self.allow.permit(program, &place, false);
            programs.share(&mut config.environment, permit).map_err(Failure::BadInput)?;
        }
        self.check_memory(&dir.study)?;
        Ok(dir)
    }

    /// Whether so many trials at the same time find the memory that they take. A plan trains one.
    fn check_memory(&self, study: &Study) -> Result<(), Failure> {
        let jobs = self.jobs();
        let at_once = jobs.min(study.trials(Shard::ALL).take(jobs).count());
        let checked = study.configs.iter().try_for_each(|named| named.config.check_memory(at_once));
        let problem = |error: String| format!("{error} (--jobs {jobs} trains so many runs at the same time)");
        if self.plan { Ok(()) } else { checked.map_err(|error| Failure::BadInput(problem(error))) }
    }

    fn report_command(&self) -> String {
        format!("cartpole-dqn report {}", shell_word(&self.path().to_string_lossy()))
    }
}

pub(super) fn run(arguments: &StudyArguments) -> Result<(), Failure> {
    match arguments.shard {
        _ if arguments.status => print(&plan::status(&StudyDir::open_to_read(arguments.path())?)?),
        _ if arguments.plan => plan(arguments),
        shard => train_trials(arguments, shard),
    }
}

fn plan(arguments: &StudyArguments) -> Result<(), Failure> {
    let dir = arguments.open()?;
    if arguments.quiet {
        return Ok(());
    }
    start_program(&dir.study.configs[0]);
    print(&plan::estimate(&dir, arguments.path(), &Signals::listen(false).stop)?)
}

/// Trains a shard or all, and says what came of it: of a shard only counts, as others train the rest.
fn train_trials(arguments: &StudyArguments, shard: Option<Shard>) -> Result<(), Failure> {
    let dir = arguments.open()?;
    let counts = train(arguments, &dir, shard.unwrap_or(Shard::ALL))?;
    let Counts { done, trained, failed, .. } = counts;
    let path = arguments.path();
    if !arguments.quiet {
        print(&match shard {
            None => {
                let (standing, command) = (report::standing(&dir)?, arguments.report_command());
                format!("{standing}\nstudy      {}\nreport     {command}\n", shown(path))
            }
            Some(_) => format!(
                "trials     {done} of this shard, of which this process trained {trained}\nfailed     {failed}\n\
                 progress   cartpole-dqn study {} --status\n",
                shell_word(&path.to_string_lossy())
            ),
        })?;
    }
    counts.failures(arguments)
}

fn train(arguments: &StudyArguments, dir: &StudyDir, shard: Shard) -> Result<Counts, Failure> {
    let study = &dir.study;
    let (mut finished, mut counts) = (std::collections::HashSet::new(), Counts::default());
    let Omitted { notes, .. } = dir.read(|Finished { config, trial }| {
        if study.is_in(shard, (config, trial.seed)) {
            finished.insert((config, trial.seed));
            counts.count_failure(&trial);
        }
        Ok(())
    })?;
    notes.iter().for_each(|text| note(text));
    let pending: Vec<_> = study.trials(shard).filter(|trial| !finished.contains(trial)).collect();
    counts.done = finished.len() as u64;
    counts.total = counts.done + pending.len() as u64;
    let configs: std::collections::BTreeSet<usize> = pending.iter().map(|(config, _)| *config).collect();
    configs.iter().for_each(|&config| start_program(&study.configs[config]));
    let signals = Signals::listen(false);
    arguments.time_limit.map_or(Ok(()), |limit| signals.stop_after(limit))?;
    let mut progress = TrialProgress::new(study, counts, arguments.quiet);
    let ended = dir.run(&pending, &Config::make, arguments.jobs(), &signals.stop, |one| progress.show(one));
    progress.bar.finish_and_clear();
    ended?;
    dir.tidy()?;
    match progress.counts.left() {
        None => Ok(progress.counts),
        Some(left) if signals.stop.load(std::sync::atomic::Ordering::Relaxed) => {
            Err(Failure::Interrupted(format!("stopped: {left}"), signals.exit_code()))
        }
        Some(left) => Err(Failure::Disturbed(left)),
    }
}

/// Waits for the program of a config, as long as a signal ends the process at once. Whether it fails is seen by its trials.
fn start_program(NamedConfig { config, task, .. }: &NamedConfig) {
    drop((config.make())(task.max_steps));
}

#[derive(Default)]
struct Counts {
    total: u64,
    /// Trials with a result, those of them that this process has trained, and how many of these solved.
    done: u64,
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

impl Counts {
    fn count_failure<S>(&mut self, Trial { config, seed, error, .. }: &Trial<S>) {
        let Some(error) = error else { return };
        self.failed += 1;
        if self.first_error.as_ref().is_none_or(|(first, _)| seed < first) {
            self.first_error = Some((*seed, visible(&format!("{config}, seed {seed}: {error}"))));
        }
    }

    fn count_unended(&mut self, unended: &Unended) {
        *if unended.is_kept { &mut self.kept } else { &mut self.lost } += 1;
        if matches!(unended.cause, Cause::Failed(_)) {
            self.disturbed += 1;
            self.first_disturbance.get_or_insert_with(|| visible(&unended.to_string()));
        }
    }

    fn left(&self) -> Option<String> {
        let Self { done, total, kept, lost, disturbed, .. } = self;
        let first = self.first_disturbance.as_deref().unwrap_or_default();
        let parts = [
            (1, format!("{done} of {total} trials are finished and kept. ")),
            (*disturbed, format!("{disturbed} ended without a result, for example {first}. ")),
            (*kept, format!("{kept} that had begun are resumed from their checkpoints. ")),
            (*lost, format!("{lost} that had begun have no checkpoint and are trained again. ")),
            (1, "Resume the study with the same command:".into()),
        ];
        let what: String = parts.into_iter().filter(|(count, _)| *count > 0).map(|(_, part)| part).collect();
        let words = std::env::args_os().map(|word| visible(&shell_word(&word.to_string_lossy())));
        let command = words.collect::<Vec<_>>().join(" ");
        (done < total).then(|| format!("{}  {command}", wrapped(&what, 0)))
    }

    fn failures(&self, arguments: &StudyArguments) -> Result<(), Failure> {
        let Self { failed, done, first_error: Some((_, error)), .. } = self else { return Ok(()) };
        let report = arguments.report_command();
        Err(Failure::Failed(format!("{failed} of {done} trials failed, for example {error}; see: {report}")))
    }
}

/// Counts trials as they end, and shows that on stderr: a bar on a terminal, elsewhere a plain line now and then.
struct TrialProgress<'a> {
    study: &'a Study,
    counts: Counts,
    bar: ProgressBar,
    quiet: bool,
    last_line: Instant,
}

impl<'a> TrialProgress<'a> {
    fn new(study: &'a Study, counts: Counts, quiet: bool) -> Self {
        let bar = match quiet {
            true => ProgressBar::hidden(),
            false => progress_bar(counts.total, counts.done, "trial {pos}/{len} {wide_bar} eta {eta}"),
        };
        Self { study, counts, bar, quiet, last_line: Instant::now() }
    }

    fn show(&mut self, ended: &Result<Trial, Unended>) {
        let trial = match ended {
            Ok(trial) => trial,
            Err(unended) => return self.counts.count_unended(unended),
        };
        let named = self.study.configs.iter().find(|named| named.name == trial.config);
        self.counts.done += 1;
        self.counts.trained += 1;
        self.counts.solved += u64::from(named.is_some_and(|named| trial.solved(&named.task)));
        self.counts.count_failure(trial);
        let Counts { done, total, trained, solved, failed, .. } = self.counts;
        let counts = format!("final policy solved {solved} of {trained}, failed {failed}");
        self.bar.set_position(done);
        if !self.quiet && self.bar.is_hidden() && self.last_line.elapsed() >= LINE_INTERVAL {
            self.last_line = Instant::now();
            say(&format!("trial {done}/{total} | {counts} | eta {} s", self.bar.eta().as_secs()));
        }
        self.bar.set_message(counts);
    }
}
