//! `cartpole-dqn inspect`

use std::fmt::Write;
use std::path::PathBuf;

use clap::Args;

use super::run_dir::checkpoint_of;
use super::{Failure, print};
use crate::checkpoint::{Checkpoint, CheckpointError, Problem};
use crate::env::{CartPole, Environment, TimeLimit};
use crate::trainer::Header;

/// Print what is in a checkpoint.
#[derive(Debug, Args)]
#[command(after_help = "Example: cartpole-dqn inspect --checkpoint runs/my-run/checkpoints/last.safetensors")]
pub(super) struct Arguments {
    /// A checkpoint, or a run's folder (its best, else its last)
    #[arg(long, value_name = "FILE")]
    checkpoint: PathBuf,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let path = checkpoint_of(&arguments.checkpoint)?;
    let checkpoint = Checkpoint::read(&path)?;
    let text = describe(&checkpoint).map_err(|problem| CheckpointError { path: path.clone(), problem })?;
    print(&format!("file       {}\n{text}", path.display()))
}

fn describe(checkpoint: &Checkpoint) -> Result<String, Problem> {
    let mut text = String::new();
    // Writing to a string cannot fail.
    let _ = match checkpoint.header::<Header>() {
        Err(Problem::NoHeader) => writeln!(text, "written by another program"),
        Err(problem) => return Err(problem),
        Ok(header) => describe_header(&mut text, &header, checkpoint.version()?),
    };
    type Task = TimeLimit<CartPole>;
    let _ = match checkpoint.policy(Task::OBSERVATION_SIZE, Task::NUM_ACTIONS) {
        Ok(policy) => writeln!(
            text,
            "policy     layers {:?}, weights sha256 {}",
            policy.sizes(),
            crate::checkpoint::weights_sha256(&policy)
        ),
        Err(problem) => writeln!(text, "policy     none that eval can play: {problem}"),
    };
    for (name, dtype, shape) in checkpoint.tensors() {
        let _ = writeln!(text, "tensor     {name} {dtype:?} {shape:?}");
    }
    Ok(text)
}

fn describe_header(text: &mut String, header: &Header, version: Option<u32>) -> std::fmt::Result {
    let state = if header.state.is_some() { "policy and state of the run" } else { "policy" };
    writeln!(text, "format     cartpole-dqn version {}: {state}", version.unwrap_or_default())?;
    writeln!(text, "env_steps  {}", header.env_steps)?;
    if let Some(evaluation) = header.evaluation {
        writeln!(text, "evaluation mean return {:.2} at step {}", evaluation.mean, evaluation.env_steps)?;
    }
    let config = serde_json::to_string_pretty(&header.config).map_err(|_| std::fmt::Error)?;
    writeln!(text, "config     {}", config.replace('\n', "\n           "))
}
