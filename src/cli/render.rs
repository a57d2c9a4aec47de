//! `cartpole-dqn render`

use std::path::PathBuf;

use clap::Args;

use super::eval::{check_output, load_policy};
use super::{Failure, print};
use crate::agent::Greedy;
use crate::env::CartPole;
use crate::files::write_whole;
use crate::render::{svg, write_gif};
use crate::trainer::play;

/// Draw an episode of a trained policy as an animated picture.
///
/// 600 × 400 pixels and 50 frames a second, in the look of Gymnasium's renderer. The same checkpoint and seed give the
/// same bytes.
#[derive(Debug, Args)]
#[command(after_help = "Example: cartpole-dqn render --checkpoint runs/my-run -o episode.gif")]
pub(super) struct Arguments {
    /// A checkpoint, a safetensors file of a torch.nn.Sequential, or a run's folder (its best, else its last)
    #[arg(long, value_name = "FILE")]
    checkpoint: PathBuf,
    /// The picture: .gif, or .svg, which is smaller and plays in browsers
    #[arg(long, short, value_name = "FILE")]
    output: PathBuf,
    /// Gymnasium seed of the episode
    #[arg(long, value_name = "S", default_value_t = 2_000_000, value_parser = super::seed,
        allow_negative_numbers = true)]
    seed: u64,
    /// Draw no more than the first N steps of the episode
    #[arg(long, value_name = "N", default_value_t = 500, allow_negative_numbers = true,
        value_parser = super::integer::<1, 500>)]
    steps: u64,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let Arguments { checkpoint, output, seed, steps } = arguments;
    let bad = |problem: &str| Failure::BadInput(format!("cannot write {}: {problem}", output.display()));
    let extension = output.extension().map(|extension| extension.to_string_lossy().to_lowercase());
    let is_gif = match extension.as_deref() {
        Some("gif") => true,
        Some("svg") => false,
        _ => return Err(bad("its name must end in .gif or .svg")),
    };
    check_output(output, Some(checkpoint)).map_err(|problem| bad(&problem))?;
    let states = states(Greedy::new(load_policy(checkpoint)?, 1), *seed, *steps);
    let written = write_whole(output, |file| match is_gif {
        true => write_gif(file, &states),
        false => file.write_all(svg(&states).as_bytes()),
    });
    written.map_err(|error| bad(&error.to_string()))?;
    print(&format!("{}: {} steps from Gymnasium's seed {seed}\n", output.display(), states.len() - 1))
}

/// The states of an episode: the first, and what the policy sees after each of at most `steps` steps.
fn states(mut policy: Greedy, seed: u64, steps: u64) -> Vec<[f64; 4]> {
    let mut states = Vec::new();
    // The error is only how the episode is left.
    let _ = play(&mut policy, CartPole::v1(), seed, |traced| {
        if traced.step == 0 {
            states.extend(<[f64; 4]>::try_from(traced.state));
        }
        states.push(traced.outcome.observation.map(f64::from));
        if traced.step + 1 == steps { Err(()) } else { Ok(()) }
    });
    states
}
