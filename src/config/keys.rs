//! Every key of a config: what it may hold, and what it means.

use std::fmt;
use std::ops::Bound::{self, Excluded, Included};
use std::ops::RangeBounds;

use schemars::{Schema, json_schema};
use serde_json::{Value, json};

use crate::env::{CartPole, Environment};

/// A line of [`KEYS`].
pub(super) struct Key {
    /// `group.name`.
    pub(super) path: &'static str,
    pub(super) allowed: Allowed,
    pub(super) meaning: &'static str,
}

const fn key(path: &'static str, allowed: Allowed, meaning: &'static str) -> Key {
    Key { path, allowed, meaning }
}

/// Every key. What binds several keys is in [`super::Config::check_combinations`].
#[rustfmt::skip]
pub(super) const KEYS: &[Key] = &[
    key("$schema", Allowed::Text, "ignored, for editors"),
    key("seed", Allowed::Integer(0, u64::MAX), "seed of every random stream of the run"),
    key("environment", Allowed::OneOf(&["CartPole-v1"]), "the task"),
    key("max_episode_steps", Allowed::Integer(1, 1_000_000), "episodes of training and of its evaluations are cut off after this many steps; scores still count the first 500"),
    key("network.hidden", Allowed::LayerSizes, "units of each hidden layer, first to last; `[]` is a linear network"),
    key("network.init", Allowed::OneOf(&["glorot_uniform", "he_uniform", "torch"]), "how the weights start"),
    key("optimizer.learning_rate", POSITIVE, "Adam's step size α; if there is a schedule, the value at its start"),
    key("optimizer.beta1", BELOW_ONE, "decay of the first moment"),
    key("optimizer.beta2", BELOW_ONE, "decay of the second moment"),
    key("optimizer.epsilon", Allowed::Number("from 1e-30 to 1", (Included(1e-30), Included(1.0))), "added to the root of the bias-corrected second moment"),
    key("optimizer.max_gradient_norm", Allowed::OrNull(&SCALE), "a gradient with a larger norm is shortened to this norm; `null`: no limit"),
    key("optimizer.schedule", Allowed::OrNull(&Allowed::Object("an object with `final_learning_rate`, `steps`")), "how the step size changes during training; `null`: it does not"),
    key("optimizer.schedule.final_learning_rate", UNIT, "step size at the end of the schedule"),
    key("optimizer.schedule.steps", PERIOD, "length of the straight line from `learning_rate` to `final_learning_rate`"),
    key("loss", Allowed::OneOf(&["mse", "huber"]), "loss of a TD error"),
    key("gamma", UNIT, "discount factor γ"),
    key("n_step", Allowed::Integer(1, 100), "how many rewards a target sums before the target network's value is added"),
    key("double", Allowed::Bool, "double Q-learning: the online network chooses the action that the target network values"),
    key("replay.capacity", Allowed::Integer(1, 100_000_000), "transitions that the memory holds before it overwrites the oldest"),
    key("replay.batch_size", Allowed::Integer(1, 65_536), "transitions in a minibatch"),
    key("replay.warmup_steps", Allowed::Integer(0, u64::MAX), "no learning happens before this step"),
    key("replay.update", Allowed::OneOf(&["minibatch", "per_sample"]), "`minibatch`: one Adam step on the mean loss; `per_sample`: one Adam step per transition, one after another"),
    key("replay.mirror", Allowed::Bool, "each sample of a minibatch becomes its mirror image (left and right exchanged) with probability ½"),
    key("learn.every_steps", PERIOD, "period of the learning steps"),
    key("learn.updates", Allowed::Integer(1, u32::MAX as u64), "minibatches per learning step"),
    key("exploration.schedule", Allowed::OneOf(&["per_episode", "linear"]), "how ε falls"),
    key("exploration.initial", UNIT, "ε at the start"),
    key("exploration.final", UNIT, "`linear`: ε from step `steps` on; `per_episode`: ε is not multiplied any more at or below this"),
    key("exploration.decay", POSITIVE, "only `per_episode`: factor after every episode"),
    key("exploration.steps", PERIOD, "only `linear`: length of the straight line from `initial` to `final`"),
    key("target.kind", Allowed::OneOf(&["hard", "none", "soft"]), "`hard`: a target network that is copied from the online network; `soft`: one that moves a share of the way to it; `none`: the online network bootstraps itself"),
    key("target.every_steps", PERIOD, "only `hard`: period of the copies"),
    key("target.every_episodes", PERIOD, "only `hard`, instead of `every_steps`: copied after episode e, from 0, if `e % every_episodes == 0`"),
    key("target.tau", POSITIVE, "only `soft`: share of the way, after every learning step"),
    key("truncation_is_terminal", Allowed::Bool, "the 500-step limit counts as the end of the task, as a fall does"),
    key("observation_divisors", Allowed::OrNull(&Allowed::Scales), "what x, ẋ, θ, θ̇ are divided by before the agent sees them; `null`: nothing"),
    key("reward_scale", SCALE, "what rewards are multiplied by before they are stored; metrics show the raw ones"),
    key("policy_weights", Allowed::OneOf(&["online", "target"]), "the weights that are evaluated and saved as the policy"),
    key("budget.steps", PERIOD, "the run ends after this many steps"),
    key("budget.episodes", PERIOD, "instead of `steps`: the run ends after this many complete episodes"),
    key("evaluation.every_steps", PERIOD, "period of the greedy evaluations; there is always one at the end"),
    key("evaluation.episodes", Allowed::Integer(1, 100_000), "episodes of an evaluation, on Gymnasium's seeds 1,000,000, 1,000,001, …"),
    key("checkpoint.every_steps", PERIOD, "period of `last.safetensors`; it is always written at the end"),
    key("stop_when_solved", Allowed::Bool, "the run ends at the first evaluation with a mean of at least 475"),
];

/// The path of every key, `group.name`.
pub fn key_paths() -> impl Iterator<Item = &'static str> {
    KEYS.iter().map(|key| key.path)
}

const PERIOD: Allowed = Allowed::Integer(1, u64::MAX);
const UNIT: Allowed = Allowed::Number("from 0 to 1", (Included(0.0), Included(1.0)));
const BELOW_ONE: Allowed = Allowed::Number("from 0 to below 1", (Included(0.0), Excluded(1.0)));
const POSITIVE: Allowed = Allowed::Number("above 0 and at most 1", (Excluded(0.0), Included(1.0)));
const SCALE: Allowed = Allowed::Number("from 1e-30 to 1e30", (Included(1e-30), Included(1e30)));

/// What a key may hold.
pub(super) enum Allowed {
    Bool,
    Text,
    OneOf(&'static [&'static str]),
    /// From the first to the last, both included.
    Integer(u64, u64),
    /// The range in words and as bounds.
    Number(&'static str, (Bound<f64>, Bound<f64>)),
    LayerSizes,
    /// One number for each coordinate of an observation.
    Scales,
    /// Its keys in words; each has its own line.
    Object(&'static str),
    OrNull(&'static Allowed),
}

impl Allowed {
    pub(super) fn admits(&self, value: &Value) -> bool {
        match self {
            Self::Bool => value.is_boolean(),
            Self::Text => value.is_string(),
            Self::OneOf(names) => value.as_str().is_some_and(|name| names.contains(&name)),
            Self::Integer(low, high) => value.as_u64().is_some_and(|n| (*low..=*high).contains(&n)),
            Self::Number(_, range) => value.as_f64().is_some_and(|number| range.contains(&number)),
            Self::LayerSizes => value.as_array().is_some_and(|sizes| {
                sizes.len() <= 16 && sizes.iter().all(|size| Self::Integer(1, 4096).admits(size))
            }),
            Self::Scales => {
                value.as_array().is_some_and(|scales| scales.iter().all(|scale| SCALE.admits(scale)))
            }
            Self::Object(_) => value.is_object(),
            Self::OrNull(allowed) => value.is_null() || allowed.admits(value),
        }
    }

    /// The values that have a name.
    pub(super) fn names(&self) -> Vec<&'static str> {
        match self {
            Self::Bool => vec!["true", "false"],
            Self::OneOf(names) => names.to_vec(),
            Self::OrNull(allowed) => [vec!["null"], allowed.names()].concat(),
            _ => Vec::new(),
        }
    }

    /// [`Self::admits`] as a JSON Schema; of an object only that it is one.
    pub(super) fn schema(&self) -> Schema {
        match self {
            Self::Bool => json_schema!({"type": "boolean"}),
            Self::Text => json_schema!({"type": "string"}),
            Self::OneOf(names) => json_schema!({"enum": names}),
            Self::Integer(low, high) => json_schema!({"type": "integer", "minimum": low, "maximum": high}),
            Self::Number(_, (low, high)) => {
                let mut schema = json_schema!({"type": "number"});
                for (bound, included, excluded) in
                    [(low, "minimum", "exclusiveMinimum"), (high, "maximum", "exclusiveMaximum")]
                {
                    match bound {
                        Included(value) => schema.insert(included.into(), json!(value)),
                        Excluded(value) => schema.insert(excluded.into(), json!(value)),
                        Bound::Unbounded => None,
                    };
                }
                schema
            }
            Self::LayerSizes => {
                json_schema!({"type": "array", "maxItems": 16, "items": Self::Integer(1, 4096).schema()})
            }
            Self::Scales => {
                let size = CartPole::OBSERVATION_SIZE;
                json_schema!({"type": "array", "minItems": size, "maxItems": size, "items": SCALE.schema()})
            }
            Self::Object(_) => json_schema!({"type": "object"}),
            Self::OrNull(allowed) => json_schema!({"anyOf": [allowed.schema(), {"type": "null"}]}),
        }
    }
}

impl fmt::Display for Allowed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Bool => write!(f, "true or false"),
            Self::Text => write!(f, "a string"),
            Self::OneOf(names) => write!(f, "\"{}\"", names.join("\" or \"")),
            Self::Integer(low, u64::MAX) => write!(f, "an integer from {low} to 2^64 - 1"),
            Self::Integer(low, high) => write!(f, "an integer from {low} to {high}"),
            Self::Number(range, _) => write!(f, "a number {range}"),
            Self::LayerSizes => {
                write!(f, "a list of at most 16 integers, each from 1 to 4096, such as [24, 24]")
            }
            Self::Scales => {
                write!(
                    f,
                    "a list with {SCALE} for each of the {} observation coordinates",
                    CartPole::OBSERVATION_SIZE
                )
            }
            Self::Object(keys) => write!(f, "{keys}"),
            Self::OrNull(allowed) => write!(f, "null or {allowed}"),
        }
    }
}
