//! `cartpole-dqn explain`

use std::fmt::Write;
use std::path::PathBuf;

use clap::Args;
use nalgebra::DMatrix;

use super::layers::Layers;
use super::output::Output;
use super::permission::ask_task;
use super::ui::{Failure, print};
use crate::check::START;
use crate::explain::{ExplainError, ExplainedUpdate, explain};
use crate::nn::{Activations, Loss, Mlp, norm};

/// Transitions that are shown without --all.
const SHOWN: usize = 3;

/// Show one update of the training with all its numbers.
///
/// Trains to that update and prints what it is made of: the transitions, their Q-values, every TD target with its numbers
/// filled in, the loss, the gradient, Adam's step, and the Q-values after it. Writes no run.
#[derive(Debug, Args)]
#[command(after_help = "Example: cartpole-dqn explain --config configs/tutorial.json --update 40
         cartpole-dqn explain --update 1000 --out update.safetensors")]
pub(super) struct ExplainArguments {
    #[command(flatten)]
    layers: Layers,
    /// Number of the update, a step of Adam; the first is 1
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    update: u64,
    /// Show every transition of the minibatch
    #[arg(long)]
    all: bool,
    /// Also write the update to a file that `check` reads, as could your own program; `-`: to standard output alone
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

impl From<ExplainError> for Failure {
    fn from(error: ExplainError) -> Self {
        match error {
            ExplainError::TooFar(_) | ExplainError::NoDqn => Self::BadInput(error.to_string()),
            ExplainError::Train(error) => error.into(),
            ExplainError::Environment(error) => error.into(),
            ExplainError::NotFinite(_) => Self::Failed(error.to_string()),
        }
    }
}

pub(super) fn run(arguments: &ExplainArguments) -> Result<(), Failure> {
    let mut config = arguments.layers.resolve()?;
    ask_task(&mut config, false)?;
    let is_own = |start: &[u8]| start.get(8..).is_some_and(|start| start.starts_with(START));
    let output = |path| Output { option: "--out", path, what: "an update", is_own };
    let output = arguments.out.as_deref().map(output);
    output.as_ref().map_or(Ok(()), Output::check)?;
    let explained = explain(&config, arguments.update)?;
    if !output.as_ref().is_some_and(Output::is_standard) {
        print(&describe(&explained, arguments))?;
    }
    if let Some(output) = output {
        let bytes = explained.tensors().to_safetensors(Some(explained.settings().metadata()));
        let bytes = bytes.map_err(|error| Failure::Failed(error.to_string()))?;
        output.write(|file| file.write_all(&bytes))?;
    }
    Ok(())
}

fn describe(explained: &ExplainedUpdate, arguments: &ExplainArguments) -> String {
    let mut text = String::new();
    // Writing to a string cannot fail.
    let _ = head(&mut text, explained, arguments.update);
    let size = explained.targets.len();
    let shown = if arguments.all { size } else { size.min(SHOWN) };
    let q = Values::of(explained);
    let _ = (0..shown).try_for_each(|sample| transition(&mut text, explained, &q, sample));
    if shown < size {
        let _ = writeln!(text, "\n     … and {} more; --all shows them", size - shown);
    }
    let _ = step(&mut text, explained);
    let _ = (0..shown).try_for_each(|sample| afterwards(&mut text, explained, &q, sample));
    let again: f32 =
        (0..size).map(|sample| explained.config.loss.value(q.error_after(explained, sample))).sum();
    let again = number(again / size as f32);
    let _ = writeln!(text, "     loss on the same targets: {again}, before {}", number(explained.loss));
    text
}

/// Q-values before and after the update, (batch, actions).
struct Values {
    current: DMatrix<f32>,
    next: DMatrix<f32>,
    target_of_next: DMatrix<f32>,
    after: DMatrix<f32>,
}

impl Values {
    fn of(explained: &ExplainedUpdate) -> Self {
        let (s, next) = (&explained.minibatch.observations, &explained.minibatch.next_observations);
        Self {
            current: q_values(&explained.before.online.mlp, s),
            next: q_values(&explained.before.online.mlp, next),
            target_of_next: q_values(explained.target(), next),
            after: q_values(&explained.after.online.mlp, s),
        }
    }

    fn error_after(&self, explained: &ExplainedUpdate, sample: usize) -> f32 {
        self.after[(sample, usize::from(explained.minibatch.actions[sample]))] - explained.targets[sample]
    }
}

fn q_values(network: &Mlp<f32>, observations: &DMatrix<f32>) -> DMatrix<f32> {
    let mut activations = Activations::new(network.sizes(), observations.nrows());
    activations.set_input(observations);
    network.forward(&mut activations);
    activations.output().clone()
}

fn head(text: &mut String, explained: &ExplainedUpdate, update: u64) -> std::fmt::Result {
    let config = &explained.config;
    let sizes: Vec<_> = explained.before.online.mlp.sizes().iter().map(ToString::to_string).collect();
    let target =
        if explained.has_target() { "Q⁻ is the target network's" } else { "no target network: Q⁻ is Q" };
    writeln!(text, "update     {update}, seed {}", explained.seed)?;
    writeln!(
        text,
        "when       after environment step {}, in episode {}",
        explained.env_steps, explained.episodes
    )?;
    writeln!(text, "network    {}; {target}", sizes.join("-"))?;
    if config.observation_divisors.is_some() || config.reward_scale != 1.0 {
        writeln!(text, "scales     observations and rewards are shown as the network gets them: scaled")?;
    }
    let (samples, remembered) = (explained.targets.len(), explained.before.replay.len());
    writeln!(text, "minibatch  {samples} of the {remembered} transitions remembered")
}

fn transition(text: &mut String, explained: &ExplainedUpdate, q: &Values, sample: usize) -> std::fmt::Result {
    let batch = &explained.minibatch;
    let action = usize::from(batch.actions[sample]);
    let (reward, discount) = (number(batch.rewards[sample]), number(batch.discounts[sample]));
    let end = if batch.terminated[sample] { "; the episode terminated there" } else { "" };
    writeln!(text, "\n{:>4} s  = {}", sample + 1, row(&batch.observations, sample))?;
    writeln!(text, "     a  = {action}, r = {reward}")?;
    writeln!(text, "     s′ = {}{end}", row(&batch.next_observations, sample))?;
    writeln!(text, "     Q(s, ·) = {}", row(&q.current, sample))?;
    let target = number(explained.targets[sample]);
    if batch.terminated[sample] {
        writeln!(text, "     y = r = {target}")?;
    } else if explained.config.double {
        let best = crate::agent::argmax(&q.next, sample);
        let value = number(q.target_of_next[(sample, best)]);
        writeln!(text, "     Q(s′, ·) = {} is largest for action {best}", row(&q.next, sample))?;
        writeln!(text, "     Q⁻(s′, ·) = {}", row(&q.target_of_next, sample))?;
        writeln!(text, "     y = {reward} + {discount} · {value} = {target}")?;
    } else {
        writeln!(text, "     y = {reward} + {discount} · max{} = {target}", row(&q.target_of_next, sample))?;
    }
    let predicted = q.current[(sample, action)];
    let td_error = predicted - explained.targets[sample];
    let loss = explained.config.loss;
    let formula = match loss {
        Loss::Mse => "δ²",
        Loss::Huber if td_error.abs() < 1.0 => "½ δ²",
        Loss::Huber => "|δ| - ½",
    };
    writeln!(
        text,
        "     δ = Q(s, {action}) - y = {} - {target} = {}; loss {formula} = {}",
        number(predicted),
        number(td_error),
        number(loss.value(td_error))
    )
}

fn step(text: &mut String, explained: &ExplainedUpdate) -> std::fmt::Result {
    let (before, after) = (&explained.before, &explained.after);
    writeln!(text, "\nloss       {}, the mean of {}", number(explained.loss), explained.targets.len())?;
    let whole = norm(explained.gradient.parameters());
    let is_shortened = explained.config.optimizer.max_gradient_norm.filter(|max| whole > max * 0.999);
    let shortened =
        is_shortened.map_or(String::new(), |max| format!(", shortened to max_gradient_norm {max}"));
    writeln!(text, "gradient   norm {}{shortened}", number(whole as f32))?;
    let weights = after.online.mlp.parameters().iter().zip(before.online.mlp.parameters());
    let moved: Vec<f32> = weights.map(|(after, before)| after - before).collect();
    let length_of = |values: &[f32]| number(norm(values) as f32);
    let mut start = 0;
    for layer in 0..before.online.mlp.num_layers() {
        let length = before.online.mlp.layer(layer).len();
        writeln!(
            text,
            "     layer {}: norms: gradient {}, step {}, weights {}",
            layer + 1,
            length_of(explained.gradient.layer(layer)),
            length_of(&moved[start..start + length]),
            length_of(before.online.mlp.layer(layer))
        )?;
        start += length;
    }
    let largest = moved.iter().fold(0.0, |largest: f32, step| largest.max(step.abs()));
    writeln!(
        text,
        "Adam       step {}, learning rate {}, largest move of a weight {}",
        after.adam.steps,
        number(before.adam.learning_rate as f32),
        number(largest)
    )?;
    writeln!(text, "\nafter it")
}

fn afterwards(text: &mut String, explained: &ExplainedUpdate, q: &Values, sample: usize) -> std::fmt::Result {
    let action = usize::from(explained.minibatch.actions[sample]);
    let before = q.current[(sample, action)] - explained.targets[sample];
    writeln!(
        text,
        "{:>4} Q(s, ·) = {}; δ = {}, before {}",
        sample + 1,
        row(&q.after, sample),
        number(q.error_after(explained, sample)),
        number(before)
    )
}

/// A row as (1, 0.5, …).
fn row(matrix: &DMatrix<f32>, sample: usize) -> String {
    let numbers: Vec<_> = matrix.row(sample).iter().map(|&value| number(value)).collect();
    format!("({})", numbers.join(", "))
}

/// A number with at most five digits.
fn number(value: f32) -> String {
    let size = value.abs();
    if value == 0.0 || (0.01..10_000.0).contains(&size) {
        let text = format!("{value:.4}");
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        format!("{value:.2e}")
    }
}
