//! Options that people know from other programs, and the config keys that they stand for here.

use clap::error::{ContextKind, ContextValue, ErrorKind};

use super::ui::program;
use crate::config;
use crate::text::shell_word;

/// What replaces a value that the user has not given.
const PLACEHOLDER: &str = "VALUE";

/// The settings that an option stands for, with `{}` in the place of its value; none if nobody uses such an option.
fn settings(option: &str, value: &str) -> Option<Vec<String>> {
    let is_above_one = value.parse().is_ok_and(|value: f64| value > 1.0);
    let settings: &[&str] = match option {
        "steps" | "total-steps" | "num-steps" | "max-steps" | "train-steps" | "training-steps"
        | "timesteps" | "total-timesteps" | "num-timesteps" | "frames" => &["budget.steps={}"],
        "episodes" | "num-episodes" | "n-episodes" | "max-episodes" | "train-episodes" => {
            &["budget.episodes={}"]
        }
        "lr" | "alpha" | "step-size" => &["optimizer.learning_rate={}"],
        "discount" | "discount-factor" => &["gamma={}"],
        "batch" | "minibatch-size" => &["replay.batch_size={}"],
        "buffer-size" | "buffer" | "buffer-capacity" | "memory-size" | "memory" | "replay-size"
        | "replay-memory" => &["replay.capacity={}"],
        "warmup" | "learning-starts" | "learn-start" | "start-steps" | "min-replay-size" => {
            &["replay.warmup_steps={}"]
        }
        "epsilon" | "eps" => &["exploration.initial={}", "exploration.final={}"],
        "epsilon-start" | "eps-start" | "epsilon-max" | "epsilon-initial" | "initial-epsilon" => {
            &["exploration.initial={}"]
        }
        "epsilon-end" | "eps-end" | "epsilon-min" | "eps-min" | "epsilon-final" | "final-epsilon" => {
            &["exploration.final={}"]
        }
        // A factor after each episode, or a number of steps.
        "epsilon-decay" | "eps-decay" if !is_above_one => {
            &["exploration.schedule=per_episode", "exploration.decay={}"]
        }
        "epsilon-decay" | "eps-decay" | "epsilon-decay-steps" | "exploration-steps" => {
            &["exploration.schedule=linear", "exploration.steps={}"]
        }
        "tau" => &["target.kind=soft", "target.tau={}"],
        // Only the weights of a soft target network can be the policy.
        "target-update" | "target-update-freq" | "target-update-interval" | "target-update-steps" => {
            &["policy_weights=online", "target.kind=hard", "target.every_steps={}"]
        }
        "double" | "double-dqn" | "double-q" | "ddqn" => &["double=true"],
        "no-double" => &["double=false"],
        "huber" => &["loss=huber"],
        "mse" => &["loss=mse"],
        "hidden-size" | "hidden-sizes" | "hidden-units" | "hidden-layers" | "layers" => {
            &["network.hidden={}"]
        }
        "n-steps" | "multi-step" => &["n_step={}"],
        "train-freq" | "train-every" | "learn-every" | "update-every" | "update-freq" => {
            &["learn.every_steps={}"]
        }
        "gradient-steps" | "updates-per-step" => &["learn.updates={}"],
        "max-grad-norm" | "grad-clip" | "clip-grad" | "gradient-clip" => &["optimizer.max_gradient_norm={}"],
        "eval-freq" | "eval-every" | "eval-interval" => &["evaluation.every_steps={}"],
        "eval-episodes" | "n-eval-episodes" => &["evaluation.episodes={}"],
        "save-freq" | "save-every" | "checkpoint-every" | "checkpoint-freq" => &["checkpoint.every_steps={}"],
        "env" => &["environment={}"],
        _ => return Some(vec![format!("{}={{}}", key(option)?)]),
    };
    Some(settings.iter().map(|&setting| setting.to_owned()).collect())
}

/// The key of the config whose path, or whose name where only one key has it, is the option.
fn key(option: &str) -> Option<&'static str> {
    // `train` has an option for the seed, and a study has no single one.
    let same = |name: &str| name.replace(['.', '_'], "-") == option;
    let mut named = config::key_paths().filter(|path| path.rsplit('.').next().is_some_and(same));
    let only = named.next().filter(|_| named.next().is_none());
    config::key_paths().find(|path| same(path)).or(only).filter(|path| !["$schema", "seed"].contains(path))
}

/// What to type in place of an option that is a key of the config here; none if the error is another one.
pub(super) fn key_for_option(error: &clap::Error, arguments: &[String]) -> Option<String> {
    let Some(ContextValue::String(option)) = error.get(ContextKind::InvalidArg) else { return None };
    let command = arguments.first().filter(|name| ["train", "study", "config"].contains(&name.as_str()))?;
    if error.kind() != ErrorKind::UnknownArgument {
        return None;
    }
    let (command_line, replaced) = with_sets(arguments);
    if !replaced.contains(option) {
        return None;
    }
    let options: Vec<String> = replaced.iter().map(|option| format!("`{option}`")).collect();
    let are = if replaced.len() == 1 { "is no option" } else { "are no options" };
    let words: Vec<String> = command_line.iter().map(|word| shell_word(word)).collect();
    Some(format!(
        "{} {are} of `{command}`: settings are keys of the config, given with --set. Type\n  {} {}",
        options.join(", "),
        program(),
        words.join(" ")
    ))
}

/// The arguments with `--set` in place of every option that is a setting, and these options.
fn with_sets(arguments: &[String]) -> (Vec<String>, Vec<String>) {
    let (mut line, mut replaced) = (Vec::new(), Vec::new());
    let mut words = arguments.iter().peekable();
    while let Some(word) = words.next() {
        let (option, attached) = match word.split_once('=') {
            Some((option, value)) => (option, Some(value.to_owned())),
            None => (word.as_str(), None),
        };
        let Some(name) = option.strip_prefix("--").map(|name| name.to_lowercase().replace(['.', '_'], "-"))
        else {
            line.push(word.clone());
            continue;
        };
        let mut values = Vec::from_iter(attached);
        let next = words.peek().map_or("", |next| next.as_str());
        let Some(settings) = settings(&name, values.first().map_or(next, String::as_str)) else {
            line.push(word.clone());
            continue;
        };
        let takes_value = settings.iter().any(|setting| setting.contains("{}"));
        let is_list = settings.iter().any(|setting| setting == "network.hidden={}");
        while takes_value
            && (values.is_empty() || is_list)
            && let Some(value) = words.next_if(|next| is_value(next))
        {
            values.push(value.clone());
        }
        let value = match values.join(",") {
            value if value.is_empty() => PLACEHOLDER.to_owned(),
            value if is_list && !value.starts_with('[') => format!("[{value}]"),
            value => value,
        };
        for setting in settings {
            line.extend(["--set".to_owned(), setting.replace("{}", &value)]);
        }
        replaced.push(option.to_owned());
    }
    (line, replaced)
}

/// Whether a word is no option: a negative number is none.
fn is_value(word: &str) -> bool {
    !word.starts_with('-') || word.parse::<f64>().is_ok()
}
