//! `cartpole-dqn eval`

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use serde::Serialize;

use super::run_dir::checkpoint_of;
use super::{Failure, print, print_json};
use crate::agent::{Greedy, Policy, Random};
use crate::checkpoint::{Checkpoint, CheckpointError};
use crate::env::{CartPole, Environment, TimeLimit};
use crate::files::write_whole;
use crate::nn::Mlp;
use crate::rng::Rng;
use crate::trainer::{Score, evaluate, play};

type Task = TimeLimit<CartPole>;

/// Play a trained policy and score it.
///
/// Episode i is Gymnasium's CartPole-v1 after reset(seed = SEED + i), so every score can be repeated there.
#[derive(Debug, Args)]
#[command(after_help = "Example: cartpole-dqn eval --checkpoint runs/my-run --episodes 100 --min-mean 475")]
pub(super) struct Arguments {
    /// A checkpoint, a safetensors file of a torch.nn.Sequential, or a run's folder (its best, else its last)
    #[arg(long, value_name = "FILE", required_unless_present = "policy", conflicts_with = "policy")]
    checkpoint: Option<PathBuf>,
    /// Play a policy that needs no checkpoint
    #[arg(long)]
    policy: Option<Baseline>,
    /// Number of episodes
    #[arg(long, value_name = "N", default_value_t = 100, allow_negative_numbers = true,
        value_parser = super::integer::<1, 10_000_000>)]
    episodes: u64,
    /// Gymnasium seed of the first episode; the others follow
    #[arg(long, value_name = "S", default_value_t = 2_000_000, value_parser = super::seed,
        allow_negative_numbers = true)]
    seed: u64,
    /// Exit with code 1 if the mean return is below this
    #[arg(long, value_name = "X", value_parser = finite, allow_negative_numbers = true)]
    min_mean: Option<f64>,
    /// Write every step to this file, one JSON object a line
    #[arg(long, value_name = "FILE")]
    trace: Option<PathBuf>,
    /// Print the score as JSON, alone on standard output
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Baseline {
    /// Every action with the same probability
    Random,
}

#[derive(Serialize)]
struct Report<'a> {
    episodes: u64,
    seed: u64,
    mean: f64,
    std: f64,
    min: f64,
    median: f64,
    max: f64,
    solved: bool,
    returns: &'a [f64],
}

/// One line of `--trace`.
#[derive(Serialize)]
struct TraceLine<'a> {
    episode: u64,
    seed: u64,
    step: u64,
    state: &'a [f64],
    action: usize,
    q_values: &'a [f32],
    reward: f32,
    terminated: bool,
    truncated: bool,
}

fn finite(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|value: &f64| value.is_finite()).ok_or_else(|| "expected a finite number".into())
}

pub(super) fn run(arguments: Arguments) -> Result<(), Failure> {
    if arguments.seed.checked_add(arguments.episodes - 1).is_none() {
        return Err(Failure::BadInput(format!(
            "--seed {} + --episodes {} goes past the largest seed, {}",
            arguments.seed,
            arguments.episodes,
            u64::MAX
        )));
    }
    if let Some(trace) = &arguments.trace {
        check_output(trace, arguments.checkpoint.as_deref()).map_err(|problem| bad_trace(trace, &problem))?;
    }
    let returns = match &arguments.checkpoint {
        Some(path) => {
            let network = load_policy(path)?;
            match arguments.trace {
                None => evaluate(&network, &CartPole::v1(), arguments.seed, arguments.episodes),
                Some(_) => play_all(&mut Greedy::new(network, 1), &arguments)?,
            }
        }
        None => play_all(&mut Random::new(Task::NUM_ACTIONS, Rng::from_seed(arguments.seed)), &arguments)?,
    };
    let score = Score::new(&returns);
    if arguments.json {
        print_json(&report(&score, &returns, arguments.seed))?;
    } else {
        print(&describe(&score, &returns, &arguments))?;
    }
    match arguments.min_mean {
        Some(minimum) if score.mean < minimum => {
            Err(Failure::Failed(format!("mean return {:.2} is below --min-mean {minimum}", score.mean)))
        }
        _ => Ok(()),
    }
}

/// The policy of a checkpoint or of a run's folder.
pub(super) fn load_policy(path: &Path) -> Result<Mlp<f32>, Failure> {
    let path = checkpoint_of(path)?;
    let policy = Checkpoint::read(&path)?.policy(Task::OBSERVATION_SIZE, Task::NUM_ACTIONS);
    policy.map_err(|problem| CheckpointError { path, problem }.into())
}

/// Plays one episode after another, and writes the trace if one is asked for.
fn play_all(policy: &mut impl Policy, arguments: &Arguments) -> Result<Vec<f64>, Failure> {
    let mut returns = Vec::new();
    let mut play = |file: &mut dyn Write| -> io::Result<()> {
        for episode in 0..arguments.episodes {
            returns.push(trace_episode(policy, episode, arguments.seed + episode, file)?);
        }
        Ok(())
    };
    match &arguments.trace {
        None => play(&mut io::sink()).map_err(|error| Failure::Failed(error.to_string()))?,
        Some(path) => write_whole(path, play).map_err(|error| bad_trace(path, &error.to_string()))?,
    }
    Ok(returns)
}

/// Says what would be noticed only after the episodes, or would destroy the checkpoint.
pub(super) fn check_output(output: &Path, checkpoint: Option<&Path>) -> Result<(), String> {
    // What is wrong with the checkpoint is said when it is read.
    let checkpoint = checkpoint.and_then(|path| checkpoint_of(path).ok());
    let is_checkpoint = || Some(output.canonicalize().ok()? == checkpoint?.canonicalize().ok()?);
    if output.is_dir() {
        Err("it is a folder; give a file".into())
    } else if is_checkpoint() == Some(true) {
        Err("it is the checkpoint; choose another file".into())
    } else {
        Ok(())
    }
}

fn bad_trace(path: &Path, problem: &str) -> Failure {
    Failure::BadInput(format!("cannot write --trace {}: {problem}", path.display()))
}

fn trace_episode(policy: &mut impl Policy, episode: u64, seed: u64, file: &mut dyn Write) -> io::Result<f64> {
    play(policy, CartPole::v1(), seed, |traced| {
        let line = TraceLine {
            episode,
            seed,
            step: traced.step,
            state: traced.state,
            action: traced.action,
            q_values: traced.q_values,
            reward: traced.outcome.reward,
            terminated: traced.outcome.terminated,
            truncated: traced.outcome.truncated,
        };
        serde_json::to_writer(&mut *file, &line)?;
        file.write_all(b"\n")
    })
}

fn report<'a>(score: &Score, returns: &'a [f64], seed: u64) -> Report<'a> {
    let Score { episodes, mean, std, min, median, max } = *score;
    Report { episodes, seed, mean, std, min, median, max, solved: score.solves(Task::SOLVED_RETURN), returns }
}

fn describe(score: &Score, returns: &[f64], arguments: &Arguments) -> String {
    let Score { episodes, mean, std, min, median, max } = score;
    let interval = score.interval().map_or(String::new(), |half| format!(" ± {half:.2} (95 % interval)"));
    let full =
        returns.iter().filter(|&&value| value >= Task::MAX_RETURN).count() as f64 * 100.0 / *episodes as f64;
    let solved = match (score.solves(Task::SOLVED_RETURN), *episodes >= 100) {
        (true, _) => "yes",
        (false, true) => "no",
        (false, false) => "open: it takes at least 100 episodes",
    };
    format!(
        "\
mean return    {mean:.2}{interval}
std            {std:.2}
min/median/max {min} / {median} / {max}
at {:<11} {full:.0} % of episodes
episodes       {episodes}, Gymnasium's seeds {} to {}
solved         {solved} (CartPole-v1: mean ≥ {} over at least 100 episodes)
",
        Task::MAX_RETURN,
        arguments.seed,
        arguments.seed + (episodes - 1),
        Task::SOLVED_RETURN,
    )
}
