//! Every key of a config: what it may hold, in which unit, and what it means. The defaults are [`Config::default`].
//!
//! Messages, `config show`, the JSON Schema and the table in docs/configuration.md are made from this table.

use std::fmt;
use std::ops::Bound::{self, Excluded, Included};
use std::ops::RangeBounds;

use serde::Serialize;
use serde_json::{Map, Value, json};

use super::{AGENTS, Config};
use crate::agent::{Exploration, Period, TargetUpdate};
use crate::env::Spec;
use crate::env::catalogue::EnvironmentId;
use crate::nn::LearningRateSchedule;
use crate::trainer::Budget;

/// The key of an environment, and what those of a program begin with.
pub(super) const ENVIRONMENT: &str = "environment";

pub(super) struct Key {
    /// `group.name`.
    pub(super) path: &'static str,
    pub(super) allowed: Allowed,
    /// Empty for a name, a switch and a number without a unit.
    pub(super) unit: &'static str,
    pub(super) meaning: &'static str,
}

impl Key {
    const fn new(path: &'static str, allowed: Allowed, unit: &'static str, meaning: &'static str) -> Self {
        Self { path, allowed, unit, meaning }
    }
}

/// Every key. `AgentRules` has the rules that concern several keys.
#[rustfmt::skip]
pub(super) const KEYS: &[Key] = &[
    Key::new("$schema", Allowed::Text, "", "ignored, for editors"),
    Key::new("seed", Allowed::Integer(0, u64::MAX), "", "seed of every random stream of the run"),
    Key::new("environment", Allowed::NameOr(EnvironmentId::NAMES, "a program as an object with `command`, `processes`, `timeout_seconds`"), "", "the task"),
    Key::new("environment.command", Allowed::Command, "", "a program that is the environment, and its arguments (docs/environments.md)"),
    Key::new("environment.processes", Allowed::Integer(1, 256), "processes", "only of a program: number of processes that play evaluations at the same time"),
    Key::new("environment.timeout_seconds", Allowed::Integer(1, 86_400), "seconds", "only of a program: its time for an answer"),
    Key::new("environment.task", Allowed::Task, "", "only of a program: its description of the task, recorded by the run"),
    Key::new("max_episode_steps", Allowed::OrNull(&Allowed::Integer(1, 1_000_000)), "steps", "time limit of training episodes; `null`: the environment's own, which evaluations always have"),
    Key::new("agent", Allowed::OneOf(AGENTS), "", "`dqn`: a network; `q_table`: Q-learning in a table over the cells of a grid"),
    Key::new("network.hidden", Allowed::LayerSizes, "units", "units of each hidden layer, first to last; `[]` is a linear network"),
    Key::new("network.init", Allowed::OneOf(&["glorot_uniform", "he_uniform", "torch"]), "", "how the weights start"),
    Key::new("table.bins", Allowed::PerCoordinate(&Allowed::Bins), "cells", "only `q_table`: for each coordinate the number of equal cells between `low` and `high`, or the list of their inner edges. The outermost cells have no outer edge"),
    Key::new("table.low", Allowed::PerCoordinate(&EDGE), "as the coordinates", "only `q_table`: where the equal cells of each coordinate begin; without effect for a list of edges"),
    Key::new("table.high", Allowed::PerCoordinate(&EDGE), "as the coordinates", "only `q_table`: where they end"),
    Key::new("table.initial", EDGE, "return", "only `q_table`: every Q-value at the start"),
    Key::new("table.mirror", Allowed::Bool, "", "only `q_table`: the table learns from each transition and from its mirror image"),
    Key::new("optimizer.learning_rate", POSITIVE, "", "step size α; with a schedule its value at the start. A table's default is 0.1"),
    Key::new("optimizer.beta1", BELOW_ONE, "", "decay of the first moment"),
    Key::new("optimizer.beta2", BELOW_ONE, "", "decay of the second moment"),
    Key::new("optimizer.epsilon", Allowed::Number("from 1e-30 to 1", (Included(1e-30), Included(1.0))), "", "added to the root of the bias-corrected second moment"),
    Key::new("optimizer.max_gradient_norm", Allowed::OrNull(&SCALE), "", "a gradient with a larger norm is shortened to this norm; `null`: no limit"),
    Key::new("optimizer.schedule", Allowed::OrNull(&Allowed::Object("an object with `final_learning_rate`, `steps`")), "", "how the step size changes during training; `null`: it does not"),
    Key::new("optimizer.schedule.final_learning_rate", UNIT, "", "step size at the end of the schedule"),
    Key::new("optimizer.schedule.steps", PERIOD, "steps", "length of the straight line from `learning_rate` to `final_learning_rate`"),
    Key::new("loss", Allowed::OneOf(&["mse", "huber"]), "", "loss of a TD error"),
    Key::new("gamma", UNIT, "per step", "discount factor γ"),
    Key::new("n_step", Allowed::Integer(1, 100), "steps", "how many rewards a target sums before the target network's value is added"),
    Key::new("double", Allowed::Bool, "", "double Q-learning: the online network chooses the action that the target network values"),
    Key::new("replay.capacity", Allowed::Integer(1, 100_000_000), "transitions", "transitions that the memory holds before it overwrites the oldest"),
    Key::new("replay.batch_size", Allowed::Integer(1, 65_536), "transitions", "transitions in a minibatch"),
    Key::new("replay.warmup_steps", Allowed::Integer(0, u64::MAX), "steps", "no learning happens before this step"),
    Key::new("replay.update", Allowed::OneOf(&["minibatch", "per_sample"]), "", "`minibatch`: one Adam step on the mean loss; `per_sample`: one per transition, in turn"),
    Key::new("replay.mirror", Allowed::Bool, "", "each sample becomes its mirror image (left and right exchanged) with probability ½; not every environment has one"),
    Key::new("learn.every_steps", PERIOD, "steps", "period of the learning steps"),
    Key::new("learn.updates", Allowed::Integer(1, u32::MAX as u64), "minibatches", "minibatches per learning step"),
    Key::new("exploration.schedule", Allowed::OneOf(&["per_episode", "linear"]), "", "how ε falls"),
    Key::new("exploration.initial", UNIT, "probability", "ε at the start"),
    Key::new("exploration.final", UNIT, "probability", "`linear`: ε from step `steps` on; `per_episode`: at or below this ε stays"),
    Key::new("exploration.decay", POSITIVE, "per episode", "only `per_episode`: factor after every episode"),
    Key::new("exploration.steps", PERIOD, "steps", "only `linear`: length of the straight line from `initial` to `final`"),
    Key::new("exploration.repeat", Allowed::Integer(1, 10_000), "steps", "a random action is repeated for up to this many steps, n with a probability proportional to 1/n²"),
    Key::new("target.kind", Allowed::OneOf(&["hard", "none", "soft"]), "", "`hard`: the target network is copied from the online network; `soft`: it moves a share of the way; `none`: there is none"),
    Key::new("target.every_steps", PERIOD, "steps", "only `hard`: period of the copies"),
    Key::new("target.every_episodes", PERIOD, "episodes", "only `hard`, instead of `every_steps`: period of the copies, from episode 0 on"),
    Key::new("target.tau", POSITIVE, "per learning step", "only `soft`: share of the way, after every learning step"),
    Key::new("truncation_is_terminal", Allowed::Bool, "", "the time limit counts as the end of the task, as a termination does"),
    Key::new("observation_divisors", Allowed::OrNull(&Allowed::PerCoordinate(&SCALE)), "as the coordinates", "each coordinate of an observation is divided by its divisor; `null`: nothing is divided"),
    Key::new("reward_scale", SCALE, "", "stored rewards are multiplied by this; metrics show the raw ones"),
    Key::new("policy_weights", Allowed::OneOf(&["online", "target"]), "", "the weights that are evaluated and saved as the policy"),
    Key::new("budget.steps", PERIOD, "steps", "the run ends after this many steps"),
    Key::new("budget.episodes", PERIOD, "episodes", "instead of `steps`: the run ends after this many complete episodes"),
    Key::new("evaluation.every_steps", PERIOD, "steps", "period of the greedy evaluations; there is always one at the end"),
    Key::new("evaluation.episodes", Allowed::Integer(1, 100_000), "episodes", "episodes of an evaluation, on Gymnasium's seeds 1,000,000, 1,000,001, …"),
    Key::new("checkpoint.every_steps", PERIOD, "steps", "period of `last.safetensors`; it is always written at the end"),
    Key::new("stop_when_solved", Allowed::Bool, "", "the run ends at the first evaluation that solves the task"),
    Key::new("stop_when_lasting_steps", Allowed::OrNull(&Allowed::Integer(1, 1_000_000)), "steps", "the run ends when two evaluations in a row solve the task and the policy of the second survives this many steps from each of 100 starts (docs/dqn.md); `null`: no policy ends the run"),
];

pub(super) fn find(path: &str) -> Option<&'static Key> {
    KEYS.iter().find(|key| key.path == path)
}

/// A key of earlier versions, the one value with which a recorded config still means the same, and what to do about others.
pub(super) const REMOVED: &[(&str, bool, &str)] = &[(
    "network.symmetric",
    false,
    "no network is its own mirror image any more; remove the key, and set `replay.mirror` to true to learn from mirror images",
)];

/// The members of an alternative, with their defaults.
pub(super) type Choice = Map<String, Value>;

/// The groups that hold one of several alternatives, each with its defaults, the group's default first. An alternative
/// without keys is null. Alternatives of the same name (their string) differ by their keys.
pub(super) fn alternatives() -> [(&'static str, Vec<Choice>); 4] {
    let default = Config::default();
    let per_episode = Exploration::PerEpisode { initial: 1.0, final_: 0.01, decay: 0.995, repeat: 1 };
    let targets = [
        TargetUpdate::Soft { tau: 0.02 },
        TargetUpdate::Hard(Period::EverySteps(500)),
        TargetUpdate::Hard(Period::EveryEpisodes(10)),
        TargetUpdate::None,
    ];
    let schedule = LearningRateSchedule { final_learning_rate: 0.0, steps: 50_000 };
    [
        ("exploration", vec![object(default.agent.exploration()), object(per_episode)]),
        ("target", targets.map(object).into()),
        ("budget", vec![object(default.budget), object(Budget::Episodes(500))]),
        ("optimizer.schedule", vec![object(default.agent.learning_rate().schedule), object(schedule)]),
    ]
}

/// The members of what is written as an object; none of anything else.
pub(super) fn object(value: impl Serialize) -> Map<String, Value> {
    if let Value::Object(map) = json!(value) { map } else { Map::new() }
}

/// Turns a float that is a whole number, such as `1000.0` or `1e3`, into an integer. The same happens in a list.
pub(super) fn whole(value: Value) -> Value {
    match (value.as_f64(), value) {
        (_, Value::Array(list)) => list.into_iter().map(whole).collect(),
        (Some(x), Value::Number(n)) if n.is_f64() && x.fract() == 0.0 && (0.0..9e15).contains(&x) => {
            json!(x as u64)
        }
        (_, value) => value,
    }
}

/// The name of a key within a group; none of a key of another group.
pub(super) fn member_of<'a>(path: &'a str, group: &str) -> Option<&'a str> {
    path.strip_prefix(group)?.strip_prefix('.')
}

/// Where the value of a key is in a config's JSON, as a JSON Pointer.
pub(super) fn pointer(path: &str) -> String {
    format!("/{}", path.replace('.', "/"))
}

const PERIOD: Allowed = Allowed::Integer(1, u64::MAX);
const UNIT: Allowed = Allowed::Number("from 0 to 1", (Included(0.0), Included(1.0)));
/// Most cells of a coordinate.
const MAX_BINS: usize = 10_000;
const BINS: Allowed = Allowed::Integer(1, MAX_BINS as u64);
const BELOW_ONE: Allowed = Allowed::Number("from 0 to below 1", (Included(0.0), Excluded(1.0)));
const POSITIVE: Allowed = Allowed::Number("above 0 and at most 1", (Excluded(0.0), Included(1.0)));
const EDGE: Allowed = Allowed::Number("from -1e30 to 1e30", (Included(-1e30), Included(1e30)));
pub(super) const SCALE: Allowed = Allowed::Number("from 1e-30 to 1e30", (Included(1e-30), Included(1e30)));

/// What a key may hold.
pub(super) enum Allowed {
    Bool,
    Text,
    OneOf(&'static [&'static str]),
    /// A name, or an object, with its keys in words. Each of these keys has a line of its own.
    NameOr(&'static [&'static str], &'static str),
    /// A program and its arguments.
    Command,
    /// A [`Spec`], which is one value.
    Task,
    /// From the first number to the second, both included.
    Integer(u64, u64),
    /// The range in words and as bounds.
    Number(&'static str, (Bound<f64>, Bound<f64>)),
    LayerSizes,
    /// One of these for each coordinate of an observation. The environment decides how many these are.
    PerCoordinate(&'static Allowed),
    /// A number of cells, or a list of their inner edges.
    Bins,
    /// An object, with its keys in words. Each of these keys has a line of its own.
    Object(&'static str),
    OrNull(&'static Allowed),
}

impl Allowed {
    pub(super) fn admits(&self, value: &Value) -> bool {
        match self {
            Self::Bool => value.is_boolean(),
            Self::Text => value.is_string(),
            Self::OneOf(names) => value.as_str().is_some_and(|name| names.contains(&name)),
            Self::NameOr(names, _) => value.is_object() || Self::OneOf(names).admits(value),
            Self::Command => value.as_array().is_some_and(|words| {
                let is_word = |word: &Value| word.as_str().is_some_and(|word| !word.contains('\0'));
                words.iter().all(is_word) && words.first().is_some_and(|program| program != "")
            }),
            Self::Task => serde_json::from_value::<Spec>(value.clone()).is_ok(),
            Self::Integer(low, high) => value.as_u64().is_some_and(|n| (*low..=*high).contains(&n)),
            Self::Number(_, range) => value.as_f64().is_some_and(|number| range.contains(&number)),
            Self::LayerSizes => value.as_array().is_some_and(|sizes| {
                sizes.len() <= 16 && sizes.iter().all(|size| Self::Integer(1, 4096).admits(size))
            }),
            Self::PerCoordinate(one) => value.as_array().is_some_and(|all| all.iter().all(|x| one.admits(x))),
            Self::Bins => match value.as_array() {
                Some(edges) => edges.len() < MAX_BINS && edges.iter().all(|edge| EDGE.admits(edge)),
                None => BINS.admits(value),
            },
            Self::Object(_) => value.is_object(),
            Self::OrNull(allowed) => value.is_null() || allowed.admits(value),
        }
    }

    /// The values that have a name.
    pub(super) fn names(&self) -> Vec<&'static str> {
        match self {
            Self::Bool => vec!["true", "false"],
            Self::OneOf(names) | Self::NameOr(names, _) => names.to_vec(),
            Self::OrNull(allowed) => [vec!["null"], allowed.names()].concat(),
            _ => Vec::new(),
        }
    }

    /// [`Self::admits`] as a JSON Schema. Of an object it says only that it is one.
    pub(super) fn schema(&self) -> Value {
        match self {
            Self::Bool => json!({"type": "boolean"}),
            Self::Text => json!({"type": "string"}),
            Self::OneOf(names) => json!({"enum": names}),
            Self::NameOr(names, _) => json!({"anyOf": [Self::OneOf(names).schema(), {"type": "object"}]}),
            Self::Command => json!({"type": "array", "minItems": 1, "items": {"type": "string"}}),
            Self::Integer(low, high) => json!({"type": "integer", "minimum": low, "maximum": high}),
            Self::Number(_, (low, high)) => {
                let mut schema = json!({"type": "number"});
                let bounds = [(low, "minimum", "exclusiveMinimum"), (high, "maximum", "exclusiveMaximum")];
                for (bound, included, excluded) in bounds {
                    match bound {
                        Included(value) => schema[included] = json!(value),
                        Excluded(value) => schema[excluded] = json!(value),
                        Bound::Unbounded => {}
                    }
                }
                schema
            }
            Self::LayerSizes => {
                json!({"type": "array", "maxItems": 16, "items": Self::Integer(1, 4096).schema()})
            }
            Self::PerCoordinate(allowed) => json!({"type": "array", "items": allowed.schema()}),
            Self::Bins => {
                json!({"anyOf": [BINS.schema(), {"type": "array", "maxItems": MAX_BINS - 1, "items": EDGE.schema()}]})
            }
            Self::Task | Self::Object(_) => json!({"type": "object"}),
            Self::OrNull(allowed) => json!({"anyOf": [allowed.schema(), {"type": "null"}]}),
        }
    }
}

impl fmt::Display for Allowed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Bool => write!(f, "true or false"),
            Self::Text => write!(f, "a string"),
            Self::OneOf(names) => write!(f, "\"{}\"", names.join("\" or \"")),
            Self::NameOr(names, object) => write!(f, "{}, or {object}", Self::OneOf(names)),
            Self::Command => write!(f, "a list of strings, the program first"),
            Self::Task => write!(f, "an object that a run has recorded"),
            Self::Integer(low, u64::MAX) => write!(f, "an integer from {low} to 2^64 - 1"),
            Self::Integer(low, high) => write!(f, "an integer from {low} to {high}"),
            Self::Number(range, _) => write!(f, "a number {range}"),
            Self::LayerSizes => {
                write!(f, "a list of at most 16 integers, each from 1 to 4096, such as [24, 24]")
            }
            Self::PerCoordinate(one) => write!(f, "a list with {one} for each observation coordinate"),
            Self::Bins => write!(f, "{BINS} or a list of edges, in ascending order"),
            Self::Object(keys) => write!(f, "{keys}"),
            Self::OrNull(allowed) => write!(f, "null or {allowed}"),
        }
    }
}
