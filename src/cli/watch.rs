//! `cartpole-dqn watch`

use std::sync::atomic::Ordering;

use clap::Args;

use super::permission::AllowCommand;
use super::policy::PolicyArguments;
use super::signals::Signals;
use super::ui::Failure;
use crate::text::shown;
use crate::trainer::SCORE_SEED;
use crate::view;

/// Watch a trained policy play in the terminal, and act yourself.
///
/// The arrow keys take the first and the last action, for CartPole a push to the left and to the right; the digits take the
/// action of their number, from 0. Such an action replaces the policy's for 3 steps, and a key that is held down keeps acting.
/// Time runs at the environment's speed, 50 steps a second for CartPole. The keys + and - change it, space pauses, s makes one
/// step, n plays the next seed, r plays the same episode again, q quits.
#[derive(Debug, Args)]
#[command(after_help = "Example: cartpole-dqn watch runs/my-run")]
pub(super) struct WatchArguments {
    #[command(flatten)]
    place: PolicyArguments,
    #[command(flatten)]
    allow: AllowCommand,
    /// Gymnasium seed of the first episode; each later episode has the next seed
    #[arg(long, value_name = "S", default_value_t = SCORE_SEED, value_parser = super::ui::seed,
        allow_negative_numbers = true)]
    seed: u64,
}

pub(super) fn run(arguments: &WatchArguments) -> Result<(), Failure> {
    let found = arguments.place.find(false)?;
    let policy = found.policy()?.greedy(1);
    let signals = Signals::listen(true);
    let environment = found.make(arguments.allow, true)?;
    view::watch(policy, environment, &shown(&found.place), arguments.seed, &signals.stop)?;
    if signals.stop.load(Ordering::Relaxed) {
        return Err(Failure::Interrupted("stopped".into(), signals.exit_code()));
    }
    Ok(())
}
