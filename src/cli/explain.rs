//! `cartpole-dqn explain`

use nalgebra::DMatrix;

use super::output::Output;
use super::ui::{Failure, print};
use crate::explain::{ExplainError, ExplainedUpdate, explain};
use crate::nn::{Activations, Loss, Mlp, norm};

const SHOWN: usize = 3;

/// Show one update of the training with all its numbers.
///
/// Trains to that update and prints what it is made of: the transitions, their Q-values, every TD target with its numbers
/// filled in, the loss, the gradient, Adam's step, and the Q-values after it. Writes no run.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: cartpole-dqn explain --config tutorial --update 40
         cartpole-dqn explain --update 1000 --out update.safetensors")]
pub(super) struct ExplainArguments {
    #[command(flatten)]
    layers: super::layers::Layers,
    /// Number of the update, a step of Adam; the first is 1
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    update: u64,
    /// Show every transition of the minibatch
    #[arg(long)]
    all: bool,
    /// Also write the update to a file that `check` reads, as could your own program; `-`: to standard output alone
    #[arg(long, value_name = "FILE")]
    out: Option<std::path::PathBuf>,
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
    super::permission::ask_task(&mut config, false)?;
    let is_own = |start: &[u8]| start.get(8..).is_some_and(|start| start.starts_with(crate::check::START));
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
    let size = explained.targets.len();
    let shown = if arguments.all { size } else { size.min(SHOWN) };
    let q = Values::of(explained);
    let mut text = head(explained, arguments.update);
    text.extend((0..shown).map(|sample| transition(explained, &q, sample)));
    if shown < size {
        text += &format!("\n     … and {} more; --all shows them\n", size - shown);
    }
    text += &step(explained);
    text.extend((0..shown).map(|sample| afterwards(explained, &q, sample)));
    let losses = (0..size).map(|sample| explained.config.loss.value(td_error(&q.after, explained, sample)));
    let (again, before) = (number(losses.sum::<f32>() / size as f32), number(explained.loss));
    text + &format!("     loss on the same targets: {again}, before {before}\n")
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
}

fn q_values(network: &Mlp<f32>, observations: &DMatrix<f32>) -> DMatrix<f32> {
    let mut activations = Activations::new(network.sizes(), observations.nrows());
    activations.set_input(observations);
    network.forward(&mut activations);
    activations.output().clone()
}

/// δ = Q(s, a) - y
fn td_error(q: &DMatrix<f32>, explained: &ExplainedUpdate, sample: usize) -> f32 {
    q[(sample, usize::from(explained.minibatch.actions[sample]))] - explained.targets[sample]
}

fn head(explained: &ExplainedUpdate, update: u64) -> String {
    let ExplainedUpdate { config, seed, env_steps, episodes, before, targets, .. } = explained;
    let sizes: Vec<_> = before.online.mlp.sizes().iter().map(ToString::to_string).collect();
    let target =
        if explained.has_target() { "Q⁻ is the target network's" } else { "no target network: Q⁻ is Q" };
    let scales = match config.observation_divisors.is_some() || config.reward_scale != 1.0 {
        true => "scales     observations and rewards are shown as the network gets them: scaled\n",
        false => "",
    };
    format!(
        "\
update     {update}, seed {seed}
when       after environment step {env_steps}, in episode {episodes}
network    {}; {target}
{scales}minibatch  {} of the {} transitions remembered
",
        sizes.join("-"),
        targets.len(),
        before.replay.len()
    )
}

fn transition(explained: &ExplainedUpdate, q: &Values, sample: usize) -> String {
    let batch = &explained.minibatch;
    let action = usize::from(batch.actions[sample]);
    let (reward, discount) = (number(batch.rewards[sample]), number(batch.discounts[sample]));
    let (place, end) =
        (sample + 1, if batch.terminated[sample] { "; the episode terminated there" } else { "" });
    let [s, next] = [&batch.observations, &batch.next_observations].map(|states| row(states, sample));
    let [current, of_next, target_of_next] =
        [&q.current, &q.next, &q.target_of_next].map(|values| row(values, sample));
    let target = number(explained.targets[sample]);
    let y = if batch.terminated[sample] {
        format!("y = r = {target}")
    } else if explained.config.double {
        let best = crate::agent::argmax(&q.next, sample);
        let value = number(q.target_of_next[(sample, best)]);
        format!(
            "Q(s′, ·) = {of_next} is largest for action {best}\n     Q⁻(s′, ·) = {target_of_next}\n     \
             y = {reward} + {discount} · {value} = {target}"
        )
    } else {
        format!("y = {reward} + {discount} · max{target_of_next} = {target}")
    };
    let (td_error, loss) = (td_error(&q.current, explained, sample), explained.config.loss);
    let formula = match loss {
        Loss::Mse => "δ²",
        Loss::Huber if td_error.abs() < 1.0 => "½ δ²",
        Loss::Huber => "|δ| - ½",
    };
    let [predicted, delta, loss] = [q.current[(sample, action)], td_error, loss.value(td_error)].map(number);
    format!(
        "
{place:>4} s  = {s}
     a  = {action}, r = {reward}
     s′ = {next}{end}
     Q(s, ·) = {current}
     {y}
     δ = Q(s, {action}) - y = {predicted} - {target} = {delta}; loss {formula} = {loss}
"
    )
}

fn step(explained: &ExplainedUpdate) -> String {
    let ExplainedUpdate { before, after, gradient, .. } = explained;
    let [old, new] = [before, after].map(|agent| &agent.online.mlp);
    let whole = norm(gradient.parameters());
    let is_shortened = explained.config.optimizer.max_gradient_norm.filter(|max| whole > max * 0.999);
    let shortened =
        is_shortened.map_or(String::new(), |max| format!(", shortened to max_gradient_norm {max}"));
    let (loss, size, length) = (number(explained.loss), explained.targets.len(), number(whole as f32));
    let mut text = format!("\nloss       {loss}, the mean of {size}\ngradient   norm {length}{shortened}\n");
    let moves = |old: &[f32], new: &[f32]| old.iter().zip(new).map(|(a, b)| b - a).collect::<Vec<_>>();
    for layer in 0..old.num_layers() {
        let step = moves(old.layer(layer), new.layer(layer));
        let norms = [gradient.layer(layer), &step, old.layer(layer)];
        let [gradient, step, weights] = norms.map(|values| number(norm(values) as f32));
        let layer = layer + 1;
        text += &format!("     layer {layer}: norms: gradient {gradient}, step {step}, weights {weights}\n");
    }
    let moves = moves(old.parameters(), new.parameters());
    let largest = number(moves.iter().fold(0.0, |largest: f32, step| largest.max(step.abs())));
    let (steps, rate) = (after.adam.steps, number(before.adam.learning_rate as f32));
    text + &format!(
        "Adam       step {steps}, learning rate {rate}, largest move of a weight {largest}\n\nafter it\n"
    )
}

fn afterwards(explained: &ExplainedUpdate, q: &Values, sample: usize) -> String {
    let [before, after] = [&q.current, &q.after].map(|q| number(td_error(q, explained, sample)));
    let (place, values) = (sample + 1, row(&q.after, sample));
    format!("{place:>4} Q(s, ·) = {values}; δ = {after}, before {before}\n")
}

fn row(matrix: &DMatrix<f32>, sample: usize) -> String {
    let numbers: Vec<_> = matrix.row(sample).iter().map(|&value| number(value)).collect();
    format!("({})", numbers.join(", "))
}

fn number(value: f32) -> String {
    if value == 0.0 || (0.01..10_000.0).contains(&value.abs()) {
        format!("{value:.4}").trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        format!("{value:.2e}")
    }
}
