//! `cartpole-dqn train`

use std::io;
use std::path::{Path, PathBuf};
use std::time::{Instant, SystemTime};

use clap::Args;
use serde::Serialize;
use serde_json::json;

use super::init::start_from;
use super::resume::{Resumed, Run, Start, resume};
use super::run_dir::{RunDir, bad, cannot_write, check_out, checkpoint_of};
use super::signals::Signals;
use super::{Failure, print, print_json, program, say, shell_word};
use crate::checkpoint::sha256;
use crate::config::{self, Config};
use crate::env::{CartPole, Environment};
use crate::files::{read_limited, read_text_limited, write_json};
use crate::nn::kernels;
use crate::sink::{Console, EpisodeLog, JsonLines, ProgressCsv, TensorBoard};
use crate::text::shown;
use crate::trainer::{Budget, EndReason, Evaluation, Event, EventSink, Summary, TrainError, Trainer};
use crate::view::{Live, Pace, check_terminal};

/// The default config, `configs/cartpole.json`.
pub(super) const DEFAULT_CONFIG: &str = include_str!("../../configs/cartpole.json");
pub(super) const DEFAULT_NAME: &str = "cartpole";

/// Train an agent.
///
/// Writes the complete config, metrics, a summary and checkpoints into one directory.
///
/// The progress shows two mean returns: `train` is the mean of the last 100 training episodes, `eval` that of the latest
/// evaluation. Then come ε (the probability of a random action) and the loss of the last episode. --live shows more. Press q
/// to leave that view: while the run is training, q also stops the run with a checkpoint.
#[derive(Debug, Args)]
#[command(
    after_help = "Example: cartpole-dqn train --config configs/tutorial.json --seed 7 --set gamma=0.99"
)]
pub(super) struct Arguments {
    #[command(flatten)]
    layers: Layers,
    /// Directory to write the run to [default: runs/<config name>-s<seed>-<UTC time>]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Replace the run that is already in the directory
    #[arg(long)]
    force: bool,
    /// Resume the run in this directory from its last checkpoint; --set can give it a larger budget
    #[arg(long, value_name = "DIR", conflicts_with_all = ["config", "out", "force"])]
    resume: Option<PathBuf>,
    /// Start with the weights of a policy, a run directory (its best) or a .safetensors file; all else starts afresh
    #[arg(long, value_name = "CHECKPOINT", conflicts_with = "resume")]
    init_from: Option<PathBuf>,
    /// Also write event files for TensorBoard, into the run's subdirectory `tensorboard`
    #[arg(long)]
    tensorboard: bool,
    /// Show no progress and no summary
    #[arg(long)]
    quiet: bool,
    /// Instead of the progress, print a line for every N-th training episode
    #[arg(long, value_name = "N", conflicts_with_all = ["quiet", "live"], allow_negative_numbers = true,
        value_parser = super::integer::<1, { u64::MAX }>)]
    log_every: Option<u64>,
    /// Show the run in the terminal while it trains: learning curve, diagnostics, the latest policy at play
    #[arg(long, conflicts_with = "quiet")]
    live: bool,
    /// With --live: train at most at this multiple of simulated time (50 steps a second), for example 5x
    /// [default: full speed]
    #[arg(long, value_name = "FACTOR", requires = "live", allow_negative_numbers = true)]
    pace: Option<Pace>,
    /// Print the summary as JSON, and nothing else, on standard output
    #[arg(long)]
    json: bool,
}

/// What a config is made of.
#[derive(Debug, Args)]
pub(super) struct Layers {
    /// JSON file with the settings of the run, `-` for standard input [default: the built-in configs/cartpole.json]
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Seed of the run's random numbers, 0 to 2⁶⁴−1; takes precedence over --config and --set
    #[arg(long, value_name = "N", value_parser = super::seed, allow_negative_numbers = true)]
    seed: Option<u64>,
    /// Set one config key, for example optimizer.learning_rate=0.001; may be repeated (`config show` lists the keys)
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// End the run at the first evaluation that solves the task; short for --set stop_when_solved=true
    #[arg(long)]
    stop_when_solved: bool,
}

/// The name of a config file in messages, and its text; `-` is standard input.
pub(super) fn read_config(path: &Path) -> Result<(String, String), Failure> {
    if path.as_os_str() != "-" {
        return Ok((shown(path), config::read_file(path)?));
    }
    let name = "standard input";
    let text = config::read(io::stdin().lock())
        .map_err(|source| config::ConfigError::Read { path: name.into(), source })?;
    Ok((name.into(), text))
}

/// What a run or a trial is called after its config file.
pub(super) fn config_name(path: &Path) -> String {
    match path.file_stem() {
        Some(stem) if path.as_os_str() != "-" => stem.to_string_lossy().into_owned(),
        _ => "stdin".into(),
    }
}

impl Layers {
    /// Defaults < file < `--set` < `--seed`.
    pub(super) fn resolve(&self) -> Result<Config, Failure> {
        let file = self.config.as_deref().map(read_config).transpose()?;
        let layer = match &file {
            Some((name, text)) => (name.as_str(), text.as_str()),
            None => ("the built-in config", DEFAULT_CONFIG),
        };
        Ok(Config::from_layers(Some(layer), &self.sets())?)
    }

    /// `--set` < `--seed`, `--stop-when-solved`.
    fn sets(&self) -> Vec<String> {
        let seed = self.seed.map(|seed| format!("seed={seed}"));
        let stop = self.stop_when_solved.then(|| "stop_when_solved=true".to_owned());
        self.set.iter().cloned().chain(seed).chain(stop).collect()
    }

    /// What a run of this config is called.
    fn name(&self) -> String {
        self.config.as_deref().map_or_else(|| DEFAULT_NAME.into(), config_name)
    }
}

pub(super) fn run(arguments: Arguments) -> Result<(), Failure> {
    if arguments.live {
        check_terminal()?;
    }
    // Before the signals are taken: Ctrl-C ends a process that waits for its standard input.
    let config = if arguments.resume.is_none() { Some(arguments.layers.resolve()?) } else { None };
    let signals = if arguments.live { Signals::listen_for_view() } else { Signals::listen() };
    let started = match (&arguments.resume, config) {
        (Some(path), _) => resume(path, &arguments.layers.sets())?,
        (None, config) => Start::Run(Box::new(start(&arguments, config.unwrap_or_default())?)),
    };
    let (run, metrics, mut trainer) = match started {
        Start::Run(started) => *started,
        Start::Ended(run) if arguments.json => return print_json(&read_summary(&run)?),
        Start::Ended(_) => return Ok(()),
    };
    if !arguments.quiet && !arguments.json {
        say(&announce(&arguments, &run, &trainer));
    }
    if !arguments.live {
        signals.tell_if_slow();
    }
    let mut sinks = sinks(&arguments, &run, metrics, &trainer, &signals)?;
    let start = Instant::now();
    let result = trainer.run(&mut sinks, Some(&run.checkpoints()), &signals.stop);
    let seconds = start.elapsed().as_secs_f64();
    let reason = match result {
        Ok(EndReason::Interrupted) => {
            drop(sinks);
            if arguments.json {
                print_json(&unended(&run, &trainer, seconds, "interrupted"))?;
            }
            let steps = trainer.progress().env_steps;
            let message = format!("stopped after step {steps}; resume with:\n  {}", resume_command(&run));
            return Err(Failure::Interrupted(message, signals.exit_code()));
        }
        Ok(reason) => reason,
        Err(error) => {
            drop(sinks);
            if arguments.json {
                let mut record = unended(&run, &trainer, seconds, "failed");
                record["error"] = json!(error.to_string());
                print_json(&record)?;
            }
            return Err(Failure::Failed(format!("{error}; {}", what_is_kept(&run, &error))));
        }
    };
    let record = Record::new(&run, &trainer, reason, seconds);
    // The summary is also printed when it cannot be saved.
    let saved = write_json(&run.summary(), &record);
    drop(sinks);
    match (arguments.json, arguments.quiet) {
        (true, _) => print_json(&record)?,
        (false, true) => {}
        (false, false) => print(&describe(&record, trainer.config().budget, &run))?,
    }
    saved.map_err(|error| cannot_write(&run.summary(), &error, ""))
}

/// As far as a run came that has not ended.
fn unended(run: &RunDir, trainer: &Run, seconds: f64, end_reason: &str) -> serde_json::Value {
    let mut record = json!(Record::new(run, trainer, EndReason::Budget, seconds));
    record["end_reason"] = json!(end_reason);
    record
}

/// What a run that has failed leaves, and how it can be resumed.
fn what_is_kept(run: &RunDir, error: &TrainError) -> String {
    let path = run.path().display();
    let kept = match () {
        () if run.last().is_file() => format!("the last good checkpoint is kept in {path}"),
        () if run.metrics().is_file() => format!("what was written is kept in {path}"),
        () => {
            return format!("the directory {path} is gone or was emptied, and the run with it; train again");
        }
    };
    match error {
        TrainError::Diverged { .. } => kept,
        _ => format!("{kept}; when the problem is solved, resume with: {}", resume_command(run)),
    }
}

/// `summary.json` of a run that has ended.
fn read_summary(run: &RunDir) -> Result<serde_json::Value, Failure> {
    let text = read_text_limited(&run.summary(), config::MAX_BYTES).map_err(|error| error.to_string());
    let summary = text.and_then(|text| serde_json::from_str(&text).map_err(|error| error.to_string()));
    summary.map_err(|error| bad(run.path(), &format!("has a summary.json that cannot be read: {error}")))
}

/// Who takes the events of the run.
fn sinks(
    arguments: &Arguments,
    run: &RunDir,
    mut metrics: JsonLines,
    trainer: &Run,
    signals: &Signals,
) -> Result<Vec<Box<dyn EventSink>>, Failure> {
    let budget = trainer.config().budget;
    let progress = ProgressCsv::create(&run.progress()).and_then(|mut progress| {
        metrics.replay(&mut progress)?;
        Ok(progress)
    });
    let progress = progress.map_err(|error| cannot_write(&run.progress(), &error, ""))?;
    let mut sinks: Vec<Box<dyn EventSink>> = vec![Box::new(metrics), Box::new(progress)];
    if arguments.live {
        let pace = arguments.pace.unwrap_or(Pace::FULL);
        let (name, end_process) = (run.path().to_string_lossy(), signals.end_process());
        sinks.push(Box::new(Live::open(&name, budget, pace, &signals.interrupts, end_process)?));
    } else if let Some(every) = arguments.log_every {
        sinks.push(Box::new(EpisodeLog::new(budget, every)));
    } else if !arguments.quiet {
        sinks.push(Box::new(Console::new(budget, trainer.progress().env_steps)));
    }
    // A resumed run that has event files goes on with them.
    if arguments.tensorboard || (arguments.resume.is_some() && run.has_events()) {
        let (folder, optimizer) = (run.tensorboard(), trainer.config().optimizer);
        let learning_rate = move |steps| optimizer.learning_rate_after(steps);
        let events = TensorBoard::create(&folder, trainer.progress().env_steps, learning_rate);
        sinks.push(Box::new(events.map_err(|error| cannot_write(&folder, &error, ""))?));
    }
    Ok(sinks)
}

/// Largest file of which the summary has the SHA-256, in bytes.
const MAX_HASHED: u64 = 1 << 32;

/// `summary.json`: what the run came to, and what it takes to repeat it.
#[derive(Serialize)]
pub(super) struct Record {
    #[serde(flatten)]
    summary: Summary,
    /// Mean return of the last 100 training episodes, or of as many as there are.
    mean_return_100: Option<f64>,
    /// SHA-256 over the weights that `--init-from` gave the run; none if they were drawn.
    #[serde(skip_serializing_if = "Option::is_none")]
    init_sha256: Option<String>,
    /// SHA-256 over `config.json`; none if it is gone.
    config_sha256: Option<String>,
    version: &'static str,
    /// None where the program was not built from a clone; `-dirty` behind it if from changed files.
    git_revision: Option<&'static str>,
    /// The instruction set of the kernels.
    cpu_path: &'static str,
}

impl Record {
    /// What says how the program was built and where it ran, and not what it computed.
    pub(super) const CIRCUMSTANCES: [&str; 4] = ["wall_seconds", "version", "git_revision", "cpu_path"];

    pub(super) fn new(run: &RunDir, trainer: &Run, reason: EndReason, wall_seconds: f64) -> Self {
        let file_sha256 = |path: PathBuf| read_limited(&path, MAX_HASHED).ok().map(|bytes| sha256([bytes]));
        Self {
            summary: trainer.summary(reason, wall_seconds),
            mean_return_100: trainer.progress().mean_return_100(),
            init_sha256: file_sha256(run.init()),
            config_sha256: file_sha256(run.config()),
            version: env!("CARGO_PKG_VERSION"),
            git_revision: option_env!("CARTPOLE_DQN_REVISION"),
            cpu_path: kernels::Path::current().name(),
        }
    }
}

/// A new run in its own directory.
fn start(arguments: &Arguments, config: Config) -> Result<Resumed, Failure> {
    config.check_memory(1).map_err(Failure::BadInput)?;
    let mut trainer = Trainer::new(config.clone(), config.make_environment());
    let init = match &arguments.init_from {
        Some(path) => Some(start_from(&checkpoint_of(path)?, &mut trainer)?),
        None => None,
    };
    let out = arguments.out.clone().unwrap_or_else(|| default_out(arguments, &config));
    check_out(&out)?;
    let (run, metrics) = RunDir::create(&out, arguments.force, &config, init.as_ref())?;
    // From now on a run without a checkpoint is one that has lost it, however early the process is killed.
    trainer.save_last(&mut Vec::<Event>::new(), Some(&run.checkpoints()))?;
    Ok((run, metrics, trainer))
}

fn default_out(arguments: &Arguments, config: &Config) -> PathBuf {
    let name = arguments.layers.name();
    let time = humantime::format_rfc3339_millis(SystemTime::now()).to_string().replace(['-', ':', '.'], "");
    Path::new("runs").join(format!("{name}-s{}-{time}", config.seed))
}

/// The first line: what is trained, with which seed, and where it is written.
fn announce(arguments: &Arguments, run: &RunDir, trainer: &Run) -> String {
    let (seed, budget) = (trainer.config().seed, budget(trainer.config().budget));
    let what = match (&arguments.resume, &arguments.init_from) {
        (Some(_), _) => {
            let step = trainer.progress().env_steps;
            format!("resuming at step {step}: seed {seed}, budget {budget}")
        }
        (None, None) => format!("training {}: seed {seed}, budget {budget}", arguments.layers.name()),
        (None, Some(path)) => format!(
            "training {}: seed {seed}, budget {budget}, from the weights of {}",
            arguments.layers.name(),
            shown(path)
        ),
    };
    fitting(&format!("{what}, in"), &run.path().display().to_string())
}

fn budget(budget: Budget) -> String {
    match budget {
        Budget::Steps(steps) => format!("{steps} steps"),
        Budget::Episodes(episodes) => format!("{episodes} episodes"),
    }
}

/// Two texts in a line, or in two where one would not fit into a terminal of 80 columns.
fn fitting(label: &str, value: &str) -> String {
    if label.chars().count() + value.chars().count() < 80 {
        format!("{label} {value}")
    } else {
        format!("{}\n  {value}", label.trim_end())
    }
}

fn describe(record: &Record, given: Budget, run: &RunDir) -> String {
    let Summary {
        env_steps, episodes, updates, seed, wall_seconds, best_evaluation, final_evaluation, ..
    } = record.summary;
    let ended = match record.summary.end_reason {
        EndReason::Solved => "the first evaluation that solved the task (stop_when_solved)".into(),
        _ => format!("the whole budget of {} was trained", budget(given)),
    };
    let training = record.mean_return_100.map_or_else(
        || "no episode has ended".into(),
        |mean| format!("mean return {mean:.1} over the last {} training episodes", episodes.min(100)),
    );
    let best = best_evaluation.map_or_else(|| "none".into(), evaluated);
    let final_ = final_evaluation.map_or_else(|| "none".into(), evaluated);
    let collapsed = match (best_evaluation.map(solves), final_evaluation.map(solves)) {
        (Some(true), Some(false)) => {
            "\nThe final policy no longer solves the task. The best policy is kept; use that one.\n"
        }
        _ => "",
    };
    let path = run.path().display().to_string();
    let (program, argument) = (program(), shell_word(&path));
    format!(
        "\
{}
trained    {env_steps} steps, {episodes} episodes, {updates} updates in {wall_seconds:.2} s (seed {seed})
ended      {ended}
training   {training}
best       {best}
final      {final_}
weights    SHA-256 of the online network at the end:
           {}
{collapsed}
Next: play the best policy on new episodes, watch it, draw the learning curve.
  {program} eval {argument}
  {program} watch {argument}
  {program} report {argument}
",
        fitting("run       ", &path),
        record.summary.weights_sha256,
    )
}

fn evaluated(evaluation: Evaluation) -> String {
    let Evaluation { mean, env_steps } = evaluation;
    let solved = if solves(evaluation) { "solved" } else { "not solved" };
    format!("mean return {mean:.1} in the evaluation at step {env_steps}: {solved}")
}

fn solves(evaluation: Evaluation) -> bool {
    evaluation.mean >= CartPole::SOLVED_RETURN
}

fn resume_command(run: &RunDir) -> String {
    format!("{} train --resume {}", program(), shell_word(&run.path().to_string_lossy()))
}
