//! `cartpole-dqn watch`

use std::path::PathBuf;
use std::sync::atomic::Ordering;

use clap::Args;

use super::Failure;
use super::eval::load_policy;
use super::signals::Signals;
use crate::view;

/// Watch a trained policy play in the terminal, and push the cart yourself.
///
/// A push replaces the policy's action for 3 steps, 0.06 s; a key that is held down pushes on. The time runs at 50 steps
/// a second; +/- change that, space pauses, s goes on by one step, n plays the next seed, r the same again, q quits.
#[derive(Debug, Args)]
#[command(after_help = "Example: cartpole-dqn watch --checkpoint runs/my-run")]
pub(super) struct Arguments {
    /// A checkpoint, a safetensors file of a torch.nn.Sequential, or a run's folder (its best, else its last)
    #[arg(long, value_name = "FILE")]
    checkpoint: PathBuf,
    /// Gymnasium seed of the first episode; the others follow
    #[arg(long, value_name = "S", default_value_t = 2_000_000, value_parser = super::seed,
        allow_negative_numbers = true)]
    seed: u64,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let policy = load_policy(&arguments.checkpoint)?;
    let signals = Signals::listen_for_view();
    view::watch(policy, &arguments.checkpoint.to_string_lossy(), arguments.seed, &signals.stop)?;
    if signals.stop.load(Ordering::Relaxed) {
        return Err(Failure::Interrupted("stopped".into(), signals.exit_code()));
    }
    Ok(())
}
