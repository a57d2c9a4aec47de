//! `cartpole-dqn watch`

use super::ui::Failure;
use crate::view;

/// Watch a trained policy play in the terminal, and act yourself.
///
/// The arrow keys take the first and the last action, for CartPole a push to the left and to the right; the digits take the
/// action of their number, from 0. Such an action replaces the policy's for 3 steps, and a key that is held down keeps acting.
/// Time runs at the environment's speed, 50 steps a second for CartPole. The keys + and - change it, space pauses, s makes one
/// step, n plays the next seed, r plays the same episode again, q quits.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: cartpole-dqn watch runs/my-run")]
pub(super) struct WatchArguments {
    #[command(flatten)]
    place: super::policy::PolicyArguments,
    #[command(flatten)]
    allow: super::permission::AllowCommand,
    /// Gymnasium seed of the first episode; each later episode has the next seed
    #[arg(long, value_name = "S", default_value_t = crate::trainer::SCORE_SEED, value_parser = super::ui::seed,
        allow_negative_numbers = true)]
    seed: u64,
}

pub(super) fn run(arguments: &WatchArguments) -> Result<(), Failure> {
    let found = arguments.place.find(false)?;
    let policy = found.policy()?.greedy(1);
    let signals = super::signals::Signals::listen(true);
    let environment = found.make(arguments.allow, true)?;
    view::watch(policy, environment, &crate::text::shown(&found.place), arguments.seed, &signals.stop)?;
    if signals.stop.load(std::sync::atomic::Ordering::Relaxed) {
        return Err(Failure::Interrupted("stopped".into(), signals.exit_code()));
    }
    Ok(())
}
