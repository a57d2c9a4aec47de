//! `cartpole-dqn train`

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;

use super::run_dir::RunDir;
use super::signals::Signals;
use super::{Failure, print, print_json};
use crate::config::{self, Config};
use crate::env::CartPole;
use crate::files::write_json;
use crate::sink::Console;
use crate::trainer::{EndReason, EventSink, Summary, Trainer};
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
    /// Config file (JSON); without it the built-in default, configs/cartpole.json
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Seed of the run, 0…2⁶⁴−1; wins over config and --set
    #[arg(long, value_name = "N", value_parser = super::seed, allow_negative_numbers = true)]
    seed: Option<u64>,
    /// Set one config key, for instance optimizer.learning_rate=0.001; repeatable
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Folder for the run [default: runs/<config name>-s<seed>-<UTC time>]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Replace the run that is in the folder
    #[arg(long)]
    force: bool,
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

pub(super) fn run(arguments: Arguments) -> Result<(), Failure> {
    let config = resolve(&arguments)?;
    let signals = Signals::listen()
        .map_err(|error| Failure::Failed(format!("cannot listen to signals such as Ctrl-C: {error}")))?;
    if arguments.live {
        check_terminal()?;
    }
    let out = arguments.out.clone().unwrap_or_else(|| default_out(&arguments, &config));
    let (run, metrics) = RunDir::create(&out, arguments.force, &config)?;
    let mut sinks: Vec<Box<dyn EventSink>> = vec![Box::new(metrics)];
    if arguments.live {
        let pace = arguments.pace.unwrap_or(Pace::FULL);
        sinks.push(Box::new(Live::open(&run.path().to_string_lossy(), config.budget, pace, &signals.stop)?));
    } else if !arguments.quiet {
        sinks.push(Box::new(Console::new(config.budget)));
    }
    let start = Instant::now();
    let mut trainer = Trainer::new(config, CartPole::v1());
    let reason = trainer.run(&mut sinks, Some(&run.checkpoints()), &signals.stop).map_err(|error| {
        let kept = if run.last().is_file() { "the last good checkpoint is" } else { "what was written is" };
        Failure::Failed(format!("{error}; {kept} kept in {}", run.path().display()))
    })?;
    if reason == EndReason::Interrupted {
        let (steps, path) = (trainer.progress().env_steps, run.last());
        let message = format!("stopped after step {steps}; everything is in {}", path.display());
        return Err(Failure::Interrupted(message, signals.exit_code()));
    }
    let summary = trainer.summary(reason, start.elapsed().as_secs_f64());
    // The summary is also printed when it cannot be saved.
    let saved = write_json(&run.summary(), &summary);
    drop(sinks);
    match (arguments.json, arguments.quiet) {
        (true, _) => print_json(&summary)?,
        (false, true) => {}
        (false, false) => print(&describe(&summary, &run))?,
    }
    saved.map_err(|error| Failure::Failed(format!("cannot write {}: {error}", run.summary().display())))
}

/// Defaults < file < `--set` < `--seed`.
fn resolve(arguments: &Arguments) -> Result<Config, Failure> {
    let file = arguments.config.as_deref().map(|path| Ok::<_, Failure>((path, config::read_file(path)?)));
    let file = file.transpose()?;
    let name = file.as_ref().map(|(path, _)| path.display().to_string());
    let layer = match (&name, &file) {
        (Some(name), Some((_, text))) => (name.as_str(), text.as_str()),
        _ => ("the built-in config", DEFAULT_CONFIG),
    };
    let seed = arguments.seed.map(|seed| format!("seed={seed}"));
    let sets: Vec<String> = arguments.set.iter().cloned().chain(seed).collect();
    Ok(Config::from_layers(Some(layer), &sets)?)
}

fn default_out(arguments: &Arguments, config: &Config) -> PathBuf {
    let stem = arguments.config.as_deref().and_then(Path::file_stem);
    let name = stem.map_or(DEFAULT_NAME.into(), |stem| stem.to_string_lossy());
    let time = jiff::Timestamp::now().strftime("%Y%m%dT%H%M%S%3fZ");
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
        shell_word(&std::env::args().next().unwrap_or_else(|| "cartpole-dqn".into())),
        shell_word(&run.path().to_string_lossy()),
        path = run.path().display(),
    )
}

/// A word as it can be typed into a shell.
fn shell_word(word: &str) -> String {
    let is_plain = |c: char| c.is_alphanumeric() || "/\\:._-+".contains(c);
    if word.chars().all(is_plain) { word.to_owned() } else { format!("'{}'", word.replace('\'', "'\\''")) }
}
