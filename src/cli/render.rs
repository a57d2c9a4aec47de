//! `cartpole-dqn render`

use std::io::{self, IsTerminal};
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};

use super::output::{Output, WriteError};
use super::policy::{PolicyArguments, STANDARD};
use super::ui::{Failure, note, print};
use crate::draw::{Film, is_film, is_gif, is_svg, svg, write_gif};
use crate::env::Environment;
use crate::run::SavedPolicy;
use crate::text::shown;
use crate::trainer::{Frame, SCORE_SEED, play, record};

/// Draw an episode of a trained policy as an animated picture.
///
/// The picture has 600 × 400 pixels and looks as Gymnasium's renderer draws it. It has a frame for each step, as many a second
/// as the environment makes steps: 50 for CartPole-v1. An environment that is another program draws its picture itself. The
/// same checkpoint and seed give the same bytes.
#[derive(Debug, Args)]
#[command(after_help = "Example: cartpole-dqn render runs/my-run -o episode.gif")]
pub(super) struct RenderArguments {
    #[command(flatten)]
    place: PolicyArguments,
    #[command(flatten)]
    allow: super::permission::AllowCommand,
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

pub(super) fn run(arguments: &RenderArguments) -> Result<(), Failure> {
    let RenderArguments { place, allow, output: path, seed, quiet, .. } = arguments;
    let format = format(arguments)?;
    let (what, is_own): (_, fn(&[u8]) -> bool) = match format {
        Format::Gif => ("a GIF of `render`", |start| is_gif(start) || is_film(start)),
        Format::Svg => ("an SVG of `render`", is_svg),
    };
    let output = Output { option: "--output", path, what, is_own };
    if output.is_standard() && matches!(format, Format::Gif) && io::stdout().is_terminal() {
        return Err(Failure::BadInput("a terminal cannot show a GIF; give a file: -o episode.gif".into()));
    }
    output.check()?;
    let found = place.find(*quiet)?;
    let policy = found.policy()?;
    let mut environment = found.make(*allow, false)?;
    let (drawn, is_read) = match (environment.processes(), format) {
        (None, _) => draw(&output, format, &policy, &mut *environment, arguments)?,
        (Some(_), Format::Gif) => write_film(&output, &policy, &mut *environment, arguments)?,
        (Some(_), Format::Svg) => {
            return Err(Failure::BadInput(format!(
                "an SVG is made of shapes, and {} is a program, which gives pixels; give a file that ends in .gif",
                environment.spec().id
            )));
        }
    };
    let said = format!("{}: {drawn} steps from Gymnasium's seed {seed}", shown(path));
    match output.is_standard() {
        _ if *quiet || !is_read => {}
        true => note(&said),
        false => print(&(said + "\n"))?,
    }
    Ok(())
}

/// Writes an episode of shapes. Returns its steps, and whether somebody reads it.
fn draw(
    output: &Output<'_>, format: Format, policy: &SavedPolicy, environment: &mut dyn Environment,
    arguments: &RenderArguments,
) -> Result<(u64, bool), Failure> {
    let frames = record(&mut policy.greedy(1), environment, arguments.seed)?.frames;
    let task = environment.spec();
    let count = arguments.steps.map_or(frames.len(), |steps| steps as usize + 1);
    let scenes = scenes(frames.into_iter().take(count), &task.id)?;
    let drawn = scenes.len() as u64 - 1;
    let is_read = output.write(|file| match format {
        Format::Gif => write_gif(file, &scenes, task.steps_per_second),
        Format::Svg => {
            let title = format!("{}, {drawn} steps", task.id);
            file.write_all(svg(&scenes, task.steps_per_second, &title).as_bytes())
        }
    })?;
    Ok((drawn, is_read))
}

/// Writes an episode of a program, which gives pixels. Returns its steps, and whether somebody reads it.
fn write_film(
    output: &Output<'_>, policy: &SavedPolicy, environment: &mut dyn Environment, arguments: &RenderArguments,
) -> Result<(u64, bool), Failure> {
    let rate = environment.spec().steps_per_second;
    let (seed, steps) = (arguments.seed, arguments.steps.unwrap_or(u64::MAX));
    let mut drawn = 0;
    let is_read = output.write::<WriteError>(|file| {
        let (mut out, mut film) = (Some(file), None);
        play(&mut policy.greedy(1), environment, seed, |moment| {
            let is_last = moment.action.is_none() || moment.step == steps;
            let image = moment.environment.image()?.ok_or(WriteError::NoFrame)?;
            drawn = moment.step;
            if let Some(out) = out.take() {
                film = Some(Film::new(out, &image, rate)?);
            }
            film.iter_mut().try_for_each(|film| film.add(&image, is_last))?;
            Ok::<_, WriteError>(!is_last)
        })?;
        Ok(())
    })?;
    Ok((drawn, is_read))
}

fn format(arguments: &RenderArguments) -> Result<Format, Failure> {
    let path = &arguments.output;
    let extension = path.extension().and_then(|extension| Format::from_str(extension.to_str()?, true).ok());
    let default = (path == Path::new(STANDARD)).then_some(Format::Gif);
    arguments.format.or(extension).or(default).ok_or_else(|| {
        Failure::BadInput(format!(
            "cannot write --output {}: its name must end in .gif or .svg, or --format must say what it is",
            shown(path)
        ))
    })
}

fn scenes(frames: impl Iterator<Item = Frame>, id: &str) -> Result<Vec<crate::env::scene::Scene>, Failure> {
    let scenes: Option<Vec<_>> = frames.map(|frame| frame.scene).collect();
    let problem = || format!("{id} has no picture to draw; `eval --trace` writes the states of an episode");
    scenes.ok_or_else(|| Failure::BadInput(problem()))
}

#[cfg(test)]
#[path = "../../tests/unit/cli_render.rs"]
mod tests;
