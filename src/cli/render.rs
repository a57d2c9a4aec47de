//! `cartpole-dqn render`

use std::io::{self, IsTerminal};
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};

use super::output::Output;
use super::permission::AllowCommand;
use super::policy::{Place, STANDARD};
use super::ui::{Failure, note, print};
use crate::draw::{is_gif, is_svg, svg, write_gif};
use crate::env::scene::Scene;
use crate::text::shown;
use crate::trainer::{Frame, SCORE_SEED, record};

/// Draw an episode of a trained policy as an animated picture.
///
/// The picture has 600 × 400 pixels and looks as Gymnasium's renderer draws it. It has a frame for each step, as many a second
/// as the environment makes steps: 50 for CartPole-v1. The same checkpoint and seed give the same bytes.
#[derive(Debug, Args)]
#[command(after_help = "Example: cartpole-dqn render runs/my-run -o episode.gif")]
pub(super) struct Arguments {
    #[command(flatten)]
    place: Place,
    #[command(flatten)]
    allow: AllowCommand,
    /// File to write: .gif, or .svg, which is smaller and plays in browsers; "-" is standard output
    #[arg(long, short, value_name = "FILE")]
    output: PathBuf,
    /// Format of the picture [default: from the name of the file; gif on standard output]
    #[arg(long, value_name = "FORMAT")]
    format: Option<Format>,
    /// Gymnasium seed of the episode
    #[arg(long, value_name = "S", default_value_t = SCORE_SEED, value_parser = super::ui::seed,
        allow_negative_numbers = true)]
    seed: u64,
    /// Draw only the first N steps of the episode [default: all]
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = super::ui::integer::<1, 1_000_000>)]
    steps: Option<u64>,
    /// Print nothing
    #[arg(long)]
    quiet: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Format {
    Gif,
    Svg,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let Arguments { place, allow, output: path, seed, steps, quiet, .. } = arguments;
    let format = format(arguments)?;
    let (what, is_own): (_, fn(&[u8]) -> bool) = match format {
        Format::Gif => ("a GIF of `render`", is_gif),
        Format::Svg => ("an SVG of `render`", is_svg),
    };
    let output = Output { option: "--output", path, what, is_own };
    if output.is_standard() && matches!(format, Format::Gif) && io::stdout().is_terminal() {
        return Err(Failure::BadInput("a terminal cannot show a GIF; give a file: -o episode.gif".into()));
    }
    output.check()?;
    let found = place.find(*quiet)?;
    let policy = found.policy()?;
    let mut environment = found.make_environment(*allow)?;
    let frames = record(&mut policy.greedy(1), &mut *environment, *seed)?.frames;
    let count = steps.map_or(frames.len(), |steps| steps as usize + 1);
    let task = environment.spec();
    let scenes = scenes(frames.into_iter().take(count), &task.id)?;
    let drawn = scenes.len() - 1;
    let is_read = output.write(|file| match format {
        Format::Gif => write_gif(file, &scenes, task.steps_per_second),
        Format::Svg => {
            let title = format!("{}, {drawn} steps", task.id);
            file.write_all(svg(&scenes, task.steps_per_second, &title).as_bytes())
        }
    })?;
    let said = format!("{}: {drawn} steps from Gymnasium's seed {seed}", shown(path));
    match (quiet, output.is_standard()) {
        (true, _) => {}
        (false, true) if is_read => note(&said),
        (false, true) => {}
        (false, false) => print(&(said + "\n"))?,
    }
    Ok(())
}

fn format(arguments: &Arguments) -> Result<Format, Failure> {
    let path = &arguments.output;
    let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase());
    match (arguments.format, extension.as_deref()) {
        (Some(format), _) => Ok(format),
        (None, Some("gif")) => Ok(Format::Gif),
        (None, Some("svg")) => Ok(Format::Svg),
        (None, _) if path == Path::new(STANDARD) => Ok(Format::Gif),
        (None, _) => Err(Failure::BadInput(format!(
            "cannot write --output {}: its name must end in .gif or .svg, or --format must say what it is",
            shown(path)
        ))),
    }
}

/// The scenes of an episode.
fn scenes(frames: impl Iterator<Item = Frame>, id: &str) -> Result<Vec<Scene>, Failure> {
    let scenes: Option<Vec<_>> = frames.map(|frame| frame.scene).collect();
    let problem = || format!("{id} has no picture to draw; `eval --trace` writes the states of an episode");
    scenes.ok_or_else(|| Failure::BadInput(problem()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_environment_without_a_picture_is_refused() {
        let (state, observation) = (vec![0.0], vec![0.0]);
        let frame = Frame { state, observation, scene: None, action: None, q_values: Vec::new() };
        let refused = scenes(std::iter::once(frame), "TwoStates");
        assert!(
            matches!(refused, Err(Failure::BadInput(message)) if message.contains("TwoStates has no picture"))
        );
    }
}
