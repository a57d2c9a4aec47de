//! `cartpole-dqn check`

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use clap::Args;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde::Serialize;

use super::policy::{is_standard_input, standard_input};
use super::ui::{Failure, on_one_line, print, print_json};
use crate::check::trace::{self, Judgement};
use crate::check::{
    BatchVerdict, EpsilonPlace, Explained, Judged, Mistake, OptimizerName, QuantityState, Settings, Stage,
    Update, Verdict, check_with,
};
use crate::files::{read_limited, read_rest};
use crate::nn::Loss;
use crate::text::{COLUMNS, lines, shown, visible};

/// How long a check shows no progress.
const PATIENCE: Duration = Duration::from_secs(1);
const INDENT: usize = 12;

/// Say which known mistake another program's DQN has.
///
/// FILE holds the numbers of one update, or what a whole loop did; docs/check.md has the function and the class of
/// Python that write them for PyTorch, Keras, JAX and NumPy. An update is computed again in f64, and what differs is
/// explained. Exit code 0 if everything in the file is right, 1 if something is not.
#[derive(Debug, Args)]
#[command(after_help = "Example: cartpole-dqn check update.safetensors")]
pub(super) struct CheckArguments {
    /// The update or the recorded loop; `-` is standard input
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Print the verdict as JSON, alone on standard output
    #[arg(long)]
    json: bool,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Printed<'a, V> {
    file: &'a str,
    #[serde(skip_serializing_if = "Option::is_none")]
    settings: Option<Settings>,
    #[serde(flatten)]
    verdict: &'a V,
}

pub(super) fn run(arguments: &CheckArguments) -> Result<(), Failure> {
    let is_standard = is_standard_input(&arguments.file);
    let path = if is_standard { Path::new("standard input") } else { &arguments.file };
    let read = match is_standard {
        true => {
            let mut bytes = Vec::new();
            let input = standard_input("cartpole-dqn check - < update.safetensors")?;
            read_rest(input, &mut bytes, trace::MAX_FILE_SIZE as u64).map(|()| bytes)
        }
        false => read_limited(path, trace::MAX_FILE_SIZE as u64),
    };
    let file = shown(path);
    if let Some(bytes) = read.as_ref().ok().filter(|bytes| trace::is_trace(bytes)) {
        let judged = in_view(|show| trace::judge(bytes, show));
        let judgement = judged.map_err(|problem| Failure::BadInput(format!("{file}: {problem}")))?;
        return show_loop(&file, &judgement, arguments.json);
    }
    let update = Update::named(read, path).map_err(|error| Failure::BadInput(on_one_line(&error)))?;
    let verdict = in_view(|show| check_with(&update, show));
    if arguments.json {
        print_json(&Printed { file: &file, settings: Some(update.settings), verdict: &verdict })?;
    } else {
        print(&describe(&file, &update, &verdict))?;
    }
    if verdict.equal { Ok(()) } else { Err(Failure::Failed(summary(&verdict))) }
}

/// Checks a file; in a terminal a bar shows how far a check that takes longer is.
fn in_view<T>(check: impl FnOnce(&(dyn Fn(Stage, usize, usize) + Sync)) -> T) -> T {
    let (start, bar) = (Instant::now(), ProgressBar::with_draw_target(Some(1), ProgressDrawTarget::stderr()));
    if let Ok(style) = ProgressStyle::with_template("{msg} {wide_bar} {pos}/{len} mistakes tried") {
        bar.set_style(style);
    }
    let show = |stage: Stage, done: usize, candidates: usize| {
        if start.elapsed() > PATIENCE {
            bar.set_message(stage.name());
            bar.set_length(candidates as u64);
            bar.set_position(done as u64);
        }
    };
    let verdict = check(&show);
    bar.finish_and_clear();
    verdict
}

fn summary(verdict: &Verdict) -> String {
    let unexplained = verdict.quantities.iter().filter(|quantity| quantity.state == QuantityState::Different);
    let unexplained: Vec<_> = unexplained.map(|quantity| quantity.name.name()).collect();
    let known = match verdict.explanations.first().map_or(0, Vec::len) {
        0 => String::new(),
        1 => "a known mistake explains what differs".into(),
        count => format!("{count} known mistakes together explain what differs"),
    };
    let numbers = match (known.is_empty(), unexplained.is_empty()) {
        (_, true) => known,
        (false, false) => format!("{known}, but not the {}", unexplained.join(" and the ")),
        (true, false) => format!("no known mistake explains the {}", unexplained.join(" and the ")),
    };
    let batch = if verdict.batch.mistakes.is_empty() { "" } else { "the batch is wrong" };
    [batch, &numbers].into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join("; ")
}

fn describe(file: &str, update: &Update, verdict: &Verdict) -> String {
    let mut text = String::new();
    put(&mut text, "file", file);
    let sizes: Vec<_> = update.online.sizes().iter().map(ToString::to_string).collect();
    let float = if update.rounding_unit > 1e-10 { "f32" } else { "f64" };
    let networks = if update.target.is_some() { "with a target network" } else { "no target network" };
    let batch = update.batch.rewards.len();
    put(&mut text, "update", &format!("layers {}, {networks}, batch of {batch}, {float}", sizes.join("-")));
    put(&mut text, "settings", &settings(update));
    describe_batch(&mut text, &verdict.batch);
    for quantity in &verdict.quantities {
        put(&mut text, quantity.name.name(), &state(quantity, verdict));
        put_all(&mut text, "  in common", &quantity.common);
        let explanation = verdict.explanations.first().into_iter().flatten();
        for explained in explanation.filter(|explained| explained.quantity == quantity.name) {
            let only = "only this number has it: what follows is computed without it";
            let only = explained.reported_only.then_some(only);
            put_mistake(&mut text, explained.mistake, explained.measured.as_deref().or(only));
        }
    }
    for other in verdict.explanations.iter().skip(1) {
        let name = |explained: &Explained| match &explained.measured {
            Some(measured) => format!("{} ({measured})", explained.mistake.what),
            None => explained.mistake.what.clone(),
        };
        let names: Vec<String> = other.iter().map(name).collect();
        put(&mut text, "or", &format!("these numbers are as well explained by: {}", names.join(" AND ")));
    }
    put_all(&mut text, "fact", &verdict.facts);
    if let Some(form) = verdict.norm_clipping {
        put(&mut text, "clipping", &format!("the norm is shortened as {form}; both forms are right"));
    }
    put_all(&mut text, "possible", &verdict.unseen);
    if !verdict.mistakes_left_out.is_empty() || verdict.pairs_left_out {
        put(&mut text, "not tried", &not_tried(verdict));
    }
    if !verdict.not_visible.is_empty() {
        let mistakes = verdict.not_visible.join(", ");
        let what = "the numbers of this update would be the same with these mistakes";
        put(&mut text, "not seen", &format!("{what}: {mistakes}"));
    }
    text
}

fn describe_batch(text: &mut String, batch: &BatchVerdict) {
    let BatchVerdict { mistakes, facts, unseen, .. } = batch;
    let wrong = (!mistakes.is_empty()).then_some("WRONG");
    let state: Vec<&str> = wrong.into_iter().chain(facts.iter().map(String::as_str)).collect();
    let unknown = "of a task whose physics this program does not know";
    put(text, "batch", &if state.is_empty() { unknown.into() } else { state.join("; ") });
    mistakes.iter().for_each(|found| put_mistake(text, found.mistake, Some(&found.evidence)));
    put_all(text, "possible", unseen);
}

fn not_tried(verdict: &Verdict) -> String {
    let mut left_out: Vec<String> = verdict.mistakes_left_out.iter().map(|id| id.replace('_', " ")).collect();
    left_out.extend(verdict.pairs_left_out.then(|| "some pairs of mistakes".into()));
    format!(
        "for an update of this size these would take too long: {}. An update with a smaller batch or a smaller network \
         shows them as well",
        left_out.join(", ")
    )
}

fn settings(update: &Update) -> String {
    let settings = &update.settings;
    let Settings { gamma, learning_rate, beta1, beta2, epsilon, alpha, huber_delta, .. } = settings;
    let mut said = vec![format!("gamma {gamma}")];
    said.push(match settings.loss {
        Loss::Mse => "loss mse".into(),
        Loss::Huber if *huber_delta == 1.0 => "loss huber".into(),
        Loss::Huber => format!("loss huber with delta {huber_delta}"),
    });
    said.extend(settings.double.then(|| "double".into()));
    let step = update.adam.steps + 1;
    let place =
        if settings.epsilon_place == EpsilonPlace::TensorFlow { " in TensorFlow's place" } else { "" };
    let adam = format!(", beta1 {beta1}, beta2 {beta2}, epsilon {epsilon:e}{place}");
    let amsgrad = if settings.amsgrad { " (amsgrad)" } else { "" };
    let (optimizer, more) = match settings.optimizer {
        OptimizerName::Adam => (format!("Adam{amsgrad} step {step}"), adam),
        OptimizerName::AdamW => (format!("AdamW{amsgrad} step {step}"), adam),
        OptimizerName::RmsProp => ("RMSprop".into(), format!(", alpha {alpha}, epsilon {epsilon:e}{place}")),
        OptimizerName::Sgd => ("SGD".into(), String::new()),
    };
    said.push(format!("{optimizer} with learning_rate {learning_rate}{more}"));
    let named = [
        ("weight_decay", settings.weight_decay),
        ("momentum", Some(settings.momentum).filter(|momentum| *momentum > 0.0)),
        ("max_gradient_norm", settings.max_gradient_norm),
        ("clip_value", settings.clip_value),
    ];
    said.extend(named.into_iter().filter_map(|(name, value)| Some(format!("{name} {}", value?))));
    said.join(", ")
}

fn state(quantity: &Judged, verdict: &Verdict) -> String {
    let difference = quantity.largest_relative_difference.unwrap_or(0.0);
    let mut above = verdict.quantities.iter().take_while(|other| other.name != quantity.name);
    let is_given = above.any(|one| matches!(one.state, QuantityState::Explained | QuantityState::Different));
    let given = if is_given { " given the above" } else { "" };
    let all = quantity.numbers;
    let differing = if all == 1 { String::new() } else { format!(", {} of {all}", quantity.differing) };
    let difference = format!("(largest relative difference {difference:.1e})");
    let differs = format!("DIFFERENT{given}{differing} {difference}");
    match quantity.state {
        QuantityState::Absent => "absent".into(),
        QuantityState::Equal => format!("equal{given} {difference}"),
        QuantityState::Explained => differs,
        QuantityState::Different => differs + ", and no known mistake gives these numbers",
    }
}

/// Prints what is said of a loop. Fails if a mistake is named.
fn show_loop(file: &str, judgement: &Judgement, is_json: bool) -> Result<(), Failure> {
    let json = Printed { file, settings: None, verdict: judgement };
    let printed = if is_json { print_json(&json) } else { print(&describe_loop(file, judgement)) };
    printed?;
    match judgement.mistakes.len() {
        0 => Ok(()),
        1 => Err(Failure::Failed("the loop has a known mistake".into())),
        mistakes => Err(Failure::Failed(format!("the loop has {mistakes} known mistakes"))),
    }
}

fn describe_loop(file: &str, judgement: &Judgement) -> String {
    let mut text = String::new();
    put(&mut text, "file", file);
    put_all(&mut text, "loop", &judgement.facts);
    for found in &judgement.mistakes {
        put(&mut text, "MISTAKE", &found.mistake.name());
        put_mistake(&mut text, found.mistake, Some(&found.evidence));
    }
    if judgement.mistakes.is_empty() {
        put(&mut text, "verdict", "nothing that could be seen is wrong");
    }
    put_all(&mut text, "not seen", &judgement.unseen);
    text
}

fn put_mistake(text: &mut String, mistake: &Mistake, evidence: Option<&str>) {
    put(text, "  what", &mistake.what);
    evidence.into_iter().for_each(|evidence| put(text, "  shown by", evidence));
    put(text, "  why", &mistake.why);
    put(text, "  mend", &mistake.mend);
}

/// Adds paragraphs behind one name.
fn put_all<'a>(text: &mut String, name: &str, paragraphs: impl IntoIterator<Item = &'a String>) {
    let names = [name].into_iter().chain(std::iter::repeat(""));
    paragraphs.into_iter().zip(names).for_each(|(paragraph, name)| put(text, name, paragraph));
}

/// Adds a paragraph behind its name.
fn put(text: &mut String, name: &str, paragraph: &str) {
    let margin = format!("\n{:INDENT$}", "");
    *text += &format!("{name:<INDENT$}{}\n", lines(&visible(paragraph), COLUMNS - INDENT).join(&margin));
}
