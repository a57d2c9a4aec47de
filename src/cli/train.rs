//! `cartpole-dqn train`

use std::path::{Path, PathBuf};
use std::time::{Instant, SystemTime};

use clap::Args;
use serde::Serialize;

use super::resume::{Resumed, Run, resume};
use super::run_dir::RunDir;
use super::signals::Signals;
use super::{Failure, print, print_json};
use crate::checkpoint::sha256;
use crate::config::{self, Config};
use crate::env::CartPole;
use crate::files::{read_limited, write_json};
use crate::nn::kernels;
use crate::sink::{Console, JsonLines, TensorBoard};
use crate::trainer::{EndReason, EventSink, Summary, TrainError, Trainer};
use crate::view::{Live, Pace, check_terminal};

/// The default config, `configs/cartpole.json`.
pub(super) const DEFAULT_CONFIG: &str = include_str!("../../configs/cartpole.json");
pub(super) const DEFAULT_NAME: &str = "cartpole";

/// Train an agent.
///
/// Writes a folder with the resolved config, metrics, a summary and checkpoints.
///
/// The progress shows the mean return of the last 100 episodes, ε, the loss of the last episode and the mean return of
/// the latest evaluation. --live shows more, until q is pressed: during training that stops the run with a checkpoint.
#[derive(Debug, Args)]
#[command(
    after_help = "Example: cartpole-dqn train --config configs/tutorial.json --seed 7 --set gamma=0.99"
)]
pub(super) struct Arguments {
    #[command(flatten)]
    layers: Layers,
    /// Folder for the run [default: runs/<config name>-s<seed>-<UTC time>]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Replace the run that is in the folder
    #[arg(long)]
    force: bool,
    /// Go on with the run in this folder where it was stopped; --set can give it a larger budget
    #[arg(long, value_name = "DIR", conflicts_with_all = ["config", "out", "force"])]
    resume: Option<PathBuf>,
    /// Write TensorBoard event files to the run's folder `tensorboard`
    #[arg(long)]
    tensorboard: bool,
    /// Show no progress and no summary
    #[arg(long)]
    quiet: bool,
    /// Show the run in the terminal: learning curve, diagnostics, the latest policy at play
    #[arg(long, conflicts_with = "quiet")]
    live: bool,
    /// With --live, train at this multiple of simulated time (50 steps a second), as 5x [default: full speed]
    #[arg(long, value_name = "FACTOR", requires = "live", allow_negative_numbers = true)]
    pace: Option<Pace>,
    /// Print the summary as JSON, alone on standard output
    #[arg(long)]
    json: bool,
}

/// What a config is made of.
#[derive(Debug, Args)]
pub(super) struct Layers {
    /// Config file (JSON); without it the built-in default, configs/cartpole.json
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Seed of the run, 0…2⁶⁴−1; wins over config and --set
    #[arg(long, value_name = "N", value_parser = super::seed, allow_negative_numbers = true)]
    seed: Option<u64>,
    /// Set one config key, for instance optimizer.learning_rate=0.001; repeatable
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
}

impl Layers {
    /// Defaults < file < `--set` < `--seed`.
    pub(super) fn resolve(&self) -> Result<Config, Failure> {
        let file = self.config.as_deref();
        let file = file.map(|path| Ok::<_, Failure>((path.display().to_string(), config::read_file(path)?)));
        let file = file.transpose()?;
        let layer = match &file {
            Some((name, text)) => (name.as_str(), text.as_str()),
            None => ("the built-in config", DEFAULT_CONFIG),
        };
        Ok(Config::from_layers(Some(layer), &self.sets())?)
    }

    /// `--set` < `--seed`.
    fn sets(&self) -> Vec<String> {
        let seed = self.seed.map(|seed| format!("seed={seed}"));
        self.set.iter().cloned().chain(seed).collect()
    }
}

pub(super) fn run(arguments: Arguments) -> Result<(), Failure> {
    let signals = Signals::listen()?;
    if arguments.live {
        check_terminal()?;
    }
    let started = match &arguments.resume {
        Some(path) => resume(path, &arguments.layers.sets())?,
        None => Some(start(&arguments)?),
    };
    let Some((run, metrics, mut trainer)) = started else { return Ok(()) };
    let mut sinks = sinks(&arguments, &run, metrics, &trainer, &signals)?;
    let start = Instant::now();
    let reason = trainer.run(&mut sinks, Some(&run.checkpoints()), &signals.stop).map_err(|error| {
        let kept = if run.last().is_file() { "the last good checkpoint is" } else { "what was written is" };
        let hint = match error {
            TrainError::Diverged { .. } => String::new(),
            _ => format!("; once that is mended, go on with: {}", resume_command(&run)),
        };
        Failure::Failed(format!("{error}; {kept} kept in {}{hint}", run.path().display()))
    })?;
    if reason == EndReason::Interrupted {
        drop(sinks);
        let steps = trainer.progress().env_steps;
        let message = format!("stopped after step {steps}; go on with:\n  {}", resume_command(&run));
        return Err(Failure::Interrupted(message, signals.exit_code()));
    }
    let record = Record::new(&run, &trainer, reason, start.elapsed().as_secs_f64());
    // The summary is also printed when it cannot be saved.
    let saved = write_json(&run.summary(), &record);
    drop(sinks);
    match (arguments.json, arguments.quiet) {
        (true, _) => print_json(&record)?,
        (false, true) => {}
        (false, false) => print(&describe(&record.summary, &run))?,
    }
    saved.map_err(|error| cannot_write(&run.summary(), &error))
}

/// Who takes the events of the run.
fn sinks(
    arguments: &Arguments,
    run: &RunDir,
    metrics: JsonLines,
    trainer: &Run,
    signals: &Signals,
) -> Result<Vec<Box<dyn EventSink>>, Failure> {
    let budget = trainer.config().budget;
    let mut sinks: Vec<Box<dyn EventSink>> = vec![Box::new(metrics)];
    if arguments.live {
        let pace = arguments.pace.unwrap_or(Pace::FULL);
        sinks.push(Box::new(Live::open(&run.path().to_string_lossy(), budget, pace, &signals.stop)?));
    } else if !arguments.quiet {
        sinks.push(Box::new(Console::new(budget, trainer.progress().env_steps)));
    }
    if arguments.tensorboard {
        let (folder, optimizer) = (run.tensorboard(), trainer.config().optimizer);
        let learning_rate = move |steps| optimizer.learning_rate_after(steps);
        let events = TensorBoard::create(&folder, trainer.progress().env_steps, learning_rate);
        sinks.push(Box::new(events.map_err(|error| cannot_write(&folder, &error))?));
    }
    Ok(sinks)
}

fn cannot_write(path: &Path, error: &std::io::Error) -> Failure {
    Failure::Failed(format!("cannot write {}: {error}", path.display()))
}

/// `summary.json`: what the run came to, and what it takes to repeat it.
#[derive(Serialize)]
pub(super) struct Record {
    #[serde(flatten)]
    summary: Summary,
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
        let config = read_limited(&run.config(), config::MAX_BYTES);
        Self {
            summary: trainer.summary(reason, wall_seconds),
            config_sha256: config.ok().map(|config| sha256([config])),
            version: env!("CARGO_PKG_VERSION"),
            git_revision: option_env!("CARTPOLE_DQN_REVISION"),
            cpu_path: kernels::Path::current().name(),
        }
    }
}

/// A new run in its own folder.
fn start(arguments: &Arguments) -> Result<Resumed, Failure> {
    let config = arguments.layers.resolve()?;
    let out = arguments.out.clone().unwrap_or_else(|| default_out(arguments, &config));
    let (run, metrics) = RunDir::create(&out, arguments.force, &config)?;
    Ok((run, metrics, Trainer::new(config, CartPole::v1())))
}

fn default_out(arguments: &Arguments, config: &Config) -> PathBuf {
    let stem = arguments.layers.config.as_deref().and_then(Path::file_stem);
    let name = stem.map_or(DEFAULT_NAME.into(), |stem| stem.to_string_lossy());
    let time = humantime::format_rfc3339_millis(SystemTime::now()).to_string().replace(['-', ':', '.'], "");
    Path::new("runs").join(format!("{name}-s{}-{time}", config.seed))
}

fn describe(summary: &Summary, run: &RunDir) -> String {
    let Summary { env_steps, episodes, updates, seed, wall_seconds, .. } = summary;
    let evaluation = |evaluation: Option<crate::trainer::Evaluation>| {
        evaluation
            .map_or_else(|| "none".into(), |e| format!("mean return {:.1} at step {}", e.mean, e.env_steps))
    };
    let ended = match summary.end_reason {
        EndReason::Budget => "budget used up",
        EndReason::Solved => "solved",
        EndReason::Interrupted => "interrupted",
    };
    let solved = summary.solved_at_step.map_or_else(|| "not".into(), |step| format!("first at step {step}"));
    format!(
        "\
trained    {env_steps} steps, {episodes} episodes, {updates} updates in {wall_seconds:.2} s (seed {seed}; {ended})
best       {}
final      {}
solved     {solved}
weights    sha256 {}
run        {path}

Evaluate it on episodes that it has not seen:
  {} eval --checkpoint {}
",
        evaluation(summary.best_evaluation),
        evaluation(summary.final_evaluation),
        summary.weights_sha256,
        program(),
        shell_word(&run.path().to_string_lossy()),
        path = run.path().display(),
    )
}

fn resume_command(run: &RunDir) -> String {
    format!("{} train --resume {}", program(), shell_word(&run.path().to_string_lossy()))
}

/// This program, as it was called.
fn program() -> String {
    shell_word(&std::env::args().next().unwrap_or_else(|| "cartpole-dqn".into()))
}

/// A word as it can be typed into a shell.
pub(super) fn shell_word(word: &str) -> String {
    let is_plain = |c: char| c.is_alphanumeric() || "/\\:._-+".contains(c);
    if word.chars().all(is_plain) { word.to_owned() } else { format!("'{}'", word.replace('\'', "'\\''")) }
}
