//! One update in a `.safetensors` file, whoever computed it. docs/check.md describes the layout.

use std::collections::{BTreeMap, HashMap};
use std::io;
use std::path::{Path, PathBuf};

use nalgebra::DMatrix;
use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensors};
use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::env::catalogue::EnvironmentId;
use crate::files::read_limited;
use crate::nn::{Loss, Mlp};
use crate::tensors::{check_count, foreign_format, header_of, read_network};
use crate::text::shown;

/// Largest file that is read, in bytes.
const MAX_FILE_SIZE: u64 = 1 << 28;
/// Most samples in a batch: some mistakes pair every sample with every other.
const MAX_BATCH: usize = 1 << 13;
/// Most samples with targets [batch, batch].
const MAX_SQUARE: usize = 1 << 10;
/// Most products of one forward pass.
const MAX_PRODUCTS: usize = 1 << 30;
/// The network's outputs are the actions; an action is one byte.
const MAX_ACTIONS: usize = 256;
const SETTINGS: &str = "settings";
/// How a file with [`Settings::metadata`] begins, behind the eight bytes of its header's length.
pub(crate) const START: &[u8] = b"{\"__metadata__\":{\"settings\":";

/// One update: what it started from, and what somebody made of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Update {
    pub settings: Settings,
    /// The online network before the update.
    pub online: Mlp<f64>,
    /// The target network; none if the online network bootstraps itself.
    pub target: Option<Mlp<f64>>,
    pub batch: Batch,
    /// The optimiser before the update.
    pub adam: Moments,
    /// The gradients that were there before the update.
    pub before: Option<Mlp<f64>>,
    pub results: Results,
    /// The unit of rounding of what they computed: 2⁻²⁴ for f32, 2⁻⁵³ for f64.
    pub rounding_unit: f64,
}

/// How an update is to be computed. What a file leaves out is PyTorch's default.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// γ, 0…1; the default is that of PyTorch's DQN tutorial.
    pub gamma: f64,
    pub loss: Loss,
    /// Whether targets are those of double Q-learning.
    pub double: bool,
    /// Adam's α, above 0.
    pub learning_rate: f64,
    /// Adam's β₁, 0 ≤ β₁ < 1.
    pub beta1: f64,
    /// Adam's β₂, 0 ≤ β₂ < 1.
    pub beta2: f64,
    /// Adam's ε, at least 0.
    pub epsilon: f64,
    pub epsilon_place: EpsilonPlace,
    /// Norm to which a longer gradient is shortened, above 0; none if it is left alone.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_gradient_norm: Option<f64>,
    /// Size to which every element of the gradient is shortened, above 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub clip_value: Option<f64>,
    /// Where Huber's loss becomes linear, above 0.
    #[serde(skip_serializing_if = "is_one")]
    pub huber_delta: f64,
    #[serde(skip_serializing_if = "is_default")]
    pub optimizer: OptimizerName,
    /// Of AdamW the share of α by which the weights shrink (default 0.01); else what is added to the gradient (0).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub weight_decay: Option<f64>,
    #[serde(skip_serializing_if = "is_default")]
    pub amsgrad: bool,
    /// Of RMSprop and SGD, 0…1.
    #[serde(skip_serializing_if = "is_default")]
    pub momentum: f64,
    /// RMSprop's smoothing, 0 ≤ α < 1.
    #[serde(skip_serializing_if = "is_default_alpha")]
    pub alpha: f64,
    /// The task, if the program knows it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub environment: Option<EnvironmentId>,
}

const ALPHA: f64 = 0.99;

fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

fn is_one(value: &f64) -> bool {
    *value == 1.0
}

fn is_default_alpha(value: &f64) -> bool {
    *value == ALPHA
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum OptimizerName {
    #[default]
    Adam,
    AdamW,
    RmsProp,
    Sgd,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            gamma: 0.99,
            loss: Loss::Mse,
            double: false,
            learning_rate: 1e-3,
            beta1: 0.9,
            beta2: 0.999,
            epsilon: 1e-8,
            epsilon_place: EpsilonPlace::PyTorch,
            max_gradient_norm: None,
            clip_value: None,
            huber_delta: 1.0,
            optimizer: OptimizerName::Adam,
            weight_decay: None,
            amsgrad: false,
            momentum: 0.0,
            alpha: ALPHA,
            environment: None,
        }
    }
}

/// Where Adam's ε is added: two readings of the paper (Kingma and Ba 2015).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum EpsilonPlace {
    /// To the root of the corrected second moment, as in algorithm 1.
    PyTorch,
    /// To the root of the uncorrected one, as before section 2.1: TensorFlow, Keras.
    TensorFlow,
}

/// The transitions of an update. Observations are (batch, features), the rest (batch).
#[derive(Clone, Debug, PartialEq)]
pub struct Batch {
    pub observations: DMatrix<f64>,
    pub actions: Vec<usize>,
    pub rewards: Vec<f64>,
    pub next_observations: DMatrix<f64>,
    pub terminated: Vec<bool>,
    /// None where the file does not say which episodes were cut off.
    pub truncated: Option<Vec<bool>>,
    /// What multiplies the value of the next observation: γ, or with n-step rewards γᵏ.
    pub discounts: Vec<f64>,
    /// What multiplies the loss of each sample.
    pub weights: Option<Vec<f64>>,
}

impl Batch {
    pub(super) fn is_truncated(&self, row: usize) -> bool {
        self.truncated.as_ref().is_some_and(|truncated| truncated[row])
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct Moments {
    /// Steps done before this update.
    pub steps: u64,
    /// m and v, as networks.
    pub first: Mlp<f64>,
    pub second: Mlp<f64>,
    /// The largest v so far, of amsgrad.
    pub largest: Option<Mlp<f64>>,
}

/// What somebody computed, as far as they say.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Results {
    /// Q(s, ·), (batch, actions), as the online network gave it before the update.
    pub q: Option<DMatrix<f64>>,
    /// The TD targets, (batch); or (batch, batch), row by row, which is a mistake.
    pub targets: Option<Vec<f64>>,
    pub loss: Option<f64>,
    /// What the optimiser got.
    pub gradients: Option<Mlp<f64>>,
    /// The online network after the step.
    pub online: Option<Mlp<f64>>,
    /// The target network after the update.
    pub target: Option<Mlp<f64>>,
}

/// Why a file is no update.
#[derive(Debug, thiserror::Error)]
#[error("{}: {problem}", shown(path))]
pub struct UpdateError {
    pub path: PathBuf,
    problem: String,
}

const POLICY: &str = "holds a policy, which `eval` plays, and no update; docs/check.md has the function of Python that writes one";
const TABLE: &str = "holds a table of Q-values; `check` is about the update of a network, and docs/q_learning.md has that of a table";
const UNKNOWN: &str = "expected names are `online.…`, `target.…`, `adam.…`, `before.…`, `result.…` as in docs/check.md, and \
                       `batch.` with `observations`, `actions`, `rewards`, `next_observations`, `terminated`, `truncated`, \
                       `discounts`, `weights`";
const TOO_LARGE: &str = "is too large an update to check";
const NO_RESULT: &str = "holds no result to check; expected `result.targets`, `result.loss`, `result.gradients.0.weight`, … or \
                         `result.online.0.weight`, …";

impl Update {
    pub fn read(path: &Path) -> Result<Self, UpdateError> {
        Self::named(read_limited(path, MAX_FILE_SIZE), path)
    }

    /// An update from what was read; `path` is what errors call it.
    pub(crate) fn named(read: io::Result<Vec<u8>>, path: &Path) -> Result<Self, UpdateError> {
        read.map_err(|error| format!("cannot be read: {error}"))
            .and_then(|bytes| Self::from_bytes(&bytes))
            .map_err(|problem| UpdateError { path: path.to_owned(), problem })
    }

    pub fn from_bytes(bytes: &[u8]) -> Result<Self, String> {
        let damaged = |error: safetensors::SafeTensorError| {
            let damage = format!("is not a safetensors file, or is cut off or damaged ({error})");
            foreign_format(bytes).unwrap_or(damage)
        };
        check_count(header_of(bytes)).map_err(|problem| format!("{TOO_LARGE}: {problem}"))?;
        let (_, metadata) = SafeTensors::read_metadata(bytes).map_err(damaged)?;
        let settings = metadata.metadata().as_ref().and_then(|metadata| metadata.get(SETTINGS));
        let settings = settings.map_or(Ok(Settings::default()), |text| serde_json::from_str(text));
        let settings =
            settings.map_err(|error| format!("has metadata `{SETTINGS}` that cannot be read: {error}"))?;
        settings.validate()?;
        let safetensors = SafeTensors::deserialize(bytes).map_err(damaged)?;
        let views = safetensors.iter().map(|(name, view)| (name.to_owned(), view));
        let mut file = Remaining { views: views.collect() };
        for (name, what) in [("0.weight", POLICY), ("q_table", TABLE)] {
            if file.views.contains_key(name) {
                return Err(what.into());
            }
        }
        let update = file.update(settings)?;
        match file.views.pop_first() {
            Some((name, _)) => Err(format!("has a tensor `{name}`, which means nothing here; {UNKNOWN}")),
            None => Ok(update),
        }
    }
}

impl Settings {
    /// The metadata of a file with these settings.
    pub fn metadata(&self) -> HashMap<String, String> {
        HashMap::from([(SETTINGS.to_owned(), json!(self).to_string())])
    }

    /// What `weight_decay` stands for where it is left out: PyTorch's defaults.
    pub(super) fn weight_decay(&self) -> f64 {
        self.weight_decay.unwrap_or(if self.optimizer == OptimizerName::AdamW { 0.01 } else { 0.0 })
    }

    pub(super) fn validate(&self) -> Result<(), String> {
        let Self { gamma, learning_rate, beta1, beta2, epsilon, .. } = *self;
        let [norm, clip_value] = [self.max_gradient_norm, self.clip_value].map(|limit| limit.unwrap_or(1.0));
        let weight_decay = self.weight_decay();
        if self.max_gradient_norm.is_some() && self.clip_value.is_some() {
            return Err("the settings `max_gradient_norm` and `clip_value` exclude each other".into());
        }
        let below_one = "a number from 0 to below 1";
        let rules = [
            ("gamma", gamma, (0.0..=1.0).contains(&gamma), "a number from 0 to 1"),
            ("learning_rate", learning_rate, learning_rate > 0.0, "a number above 0"),
            ("beta1", beta1, (0.0..1.0).contains(&beta1), below_one),
            ("beta2", beta2, (0.0..1.0).contains(&beta2), below_one),
            ("epsilon", epsilon, epsilon >= 0.0, "a number from 0"),
            ("max_gradient_norm", norm, norm > 0.0, "a number above 0, or nothing"),
            ("clip_value", clip_value, clip_value > 0.0, "a number above 0, or nothing"),
            ("huber_delta", self.huber_delta, self.huber_delta > 0.0, "a number above 0"),
            ("weight_decay", weight_decay, weight_decay >= 0.0, "a number from 0"),
            ("momentum", self.momentum, (0.0..1.0).contains(&self.momentum), below_one),
            ("alpha", self.alpha, (0.0..1.0).contains(&self.alpha), below_one),
        ];
        match rules.into_iter().find(|(_, value, holds, _)| !(*holds && value.is_finite())) {
            Some((name, value, _, expected)) => {
                Err(format!("the setting `{name}` is {value}; expected {expected}"))
            }
            None => Ok(()),
        }
    }
}

/// The tensors of a file that have not been taken yet.
struct Remaining<'a> {
    views: BTreeMap<String, TensorView<'a>>,
}

impl Remaining<'_> {
    fn update(&mut self, settings: Settings) -> Result<Update, String> {
        let sizes = self.sizes()?;
        let (inputs, outputs) = (sizes[0], sizes[sizes.len() - 1]);
        let batch_size = self.batch_size()?;
        let products: usize = sizes.windows(2).map(|pair| (pair[0] + 1).saturating_mul(pair[1])).sum();
        if batch_size > MAX_BATCH
            || outputs > MAX_ACTIONS
            || products.saturating_mul(batch_size) > MAX_PRODUCTS
        {
            return Err(format!(
                "{TOO_LARGE}: layers {sizes:?} and a batch of {batch_size}; at most {MAX_ACTIONS} actions, {MAX_BATCH} \
                 transitions, and {MAX_PRODUCTS} as weights times transitions"
            ));
        }
        let is_single = self.computed_in_f32();
        let online = self.network("online.", &sizes, true)?;
        let mut network = |prefix: &str| {
            let is_there = self.views.keys().any(|name| name.starts_with(prefix));
            is_there.then(|| self.network(prefix, &sizes, !prefix.starts_with("result."))).transpose()
        };
        let target = network("target.")?;
        let moments = [network("adam.m.")?, network("adam.v.")?, network("adam.vmax.")?];
        let before = network("before.gradients.")?;
        let (gradients, after) = (network("result.gradients.")?, network("result.online.")?);
        let target_after = network("result.target.")?;
        let batch = self.batch(batch_size, inputs, outputs, settings.gamma)?;
        let adam = self.moments(&sizes, moments, &settings)?;
        let q = self.result("result.q", &[batch_size, outputs])?;
        let q = q.map(|q| DMatrix::from_row_slice(batch_size, outputs, &q));
        let targets = self.targets(batch_size)?;
        let loss = self.result("result.loss", &[])?.map(|loss| loss[0]);
        let results = Results { q, targets, loss, gradients, online: after, target: target_after };
        if results == Results::default() {
            return Err(NO_RESULT.into());
        }
        let rounding_unit = if is_single { f64::from(f32::EPSILON) } else { f64::EPSILON } / 2.0;
        Ok(Update { settings, online, target, batch, adam, before, results, rounding_unit })
    }

    /// y, [B]; or [B, B], of shapes that were broadcast.
    fn targets(&mut self, size: usize) -> Result<Option<Vec<f64>>, String> {
        let is_square = |view: &TensorView| *view.shape() == [size, size] && (2..=MAX_SQUARE).contains(&size);
        let is_square = self.views.get("result.targets").is_some_and(is_square);
        self.result("result.targets", &[size, size][..if is_square { 2 } else { 1 }])
    }

    /// What somebody computed, which may not be finite.
    fn result(&mut self, name: &str, shape: &[usize]) -> Result<Option<Vec<f64>>, String> {
        self.optional(name, |file, name| file.take(name, shape))
    }

    fn sizes(&self) -> Result<Vec<usize>, String> {
        let mut sizes: Vec<usize> = Vec::new();
        loop {
            let name = format!("online.{}.weight", 2 * sizes.len().saturating_sub(1));
            let inputs = sizes.last().map_or("inputs".into(), usize::to_string);
            let expected = format!("F32 or F64 [outputs, {inputs}]");
            match self.views.get(&name) {
                None if sizes.is_empty() => return Err(missing(&name, &expected)),
                None => return Ok(sizes),
                Some(view) => match *view.shape() {
                    [rows, columns]
                        if rows > 0 && columns > 0 && *sizes.last().unwrap_or(&columns) == columns =>
                    {
                        if sizes.is_empty() {
                            sizes.push(columns);
                        }
                        sizes.push(rows);
                    }
                    _ => return Err(wrong(&name, view, &expected)),
                },
            }
        }
    }

    fn batch_size(&self) -> Result<usize, String> {
        let (name, expected) = ("batch.observations", "numbers [batch, inputs], a batch of at least 1");
        let view = self.views.get(name).ok_or_else(|| missing(name, expected))?;
        match *view.shape() {
            [batch, _] if batch > 0 => Ok(batch),
            _ => Err(wrong(name, view, expected)),
        }
    }

    /// Whether the results are rounded to f32: by their type, or because f32 holds every weight that they start from.
    fn computed_in_f32(&self) -> bool {
        let is_weight = |name: &str| name.starts_with("online.") || name.starts_with("target.");
        let mut given = self.views.iter().filter(|(name, _)| is_weight(name) || name.starts_with("result."));
        let mut weights = self.views.iter().filter(|(name, _)| is_weight(name));
        let holds_f32 = |view: &TensorView| {
            numbers(view).is_some_and(|values| values.iter().all(|&value| f64::from(value as f32) == value))
        };
        given.any(|(_, view)| view.dtype() == Dtype::F32) || weights.all(|(_, view)| holds_f32(view))
    }

    fn network(&mut self, prefix: &str, sizes: &[usize], is_finite: bool) -> Result<Mlp<f64>, String> {
        let mut network = Mlp::zeros(sizes.to_vec());
        read_network(prefix, &mut network, |name, shape| match is_finite {
            true => self.floats(name, shape),
            false => self.take(name, shape),
        })?;
        Ok(network)
    }

    fn batch(&mut self, size: usize, inputs: usize, actions: usize, gamma: f64) -> Result<Batch, String> {
        let mut observations = |name| {
            self.floats(name, &[size, inputs]).map(|values| DMatrix::from_row_slice(size, inputs, &values))
        };
        let [observations, next_observations] =
            [observations("batch.observations")?, observations("batch.next_observations")?];
        let is_action = |value: f64| value.fract() == 0.0 && (0.0..actions as f64).contains(&value);
        let expected = format!("an action from 0 to {}, an output of the network", actions - 1);
        let actions = self.values("batch.actions", &[size], is_action, &expected)?;
        let rewards = self.floats("batch.rewards", &[size])?;
        let terminated = self.flags("batch.terminated", size)?;
        let truncated = self.optional("batch.truncated", |file, name| file.flags(name, size))?;
        let discounts = self.optional("batch.discounts", |file, name| file.floats(name, &[size]))?;
        let discounts = discounts.unwrap_or_else(|| vec![gamma; size]);
        let weights = self.optional("batch.weights", |file, name| file.floats(name, &[size]))?;
        let actions = actions.into_iter().map(|action| action as usize).collect();
        Ok(Batch {
            observations,
            actions,
            rewards,
            next_observations,
            terminated,
            truncated,
            discounts,
            weights,
        })
    }

    fn flags(&mut self, name: &str, size: usize) -> Result<Vec<bool>, String> {
        let values = self.values(name, &[size], |value| value == 0.0 || value == 1.0, "0 or 1")?;
        Ok(values.into_iter().map(|value| value == 1.0).collect())
    }

    /// What the optimiser remembers. SGD and RMSprop need not have both moments, nor a count of steps.
    fn moments(
        &mut self, sizes: &[usize], networks: [Option<Mlp<f64>>; 3], settings: &Settings,
    ) -> Result<Moments, String> {
        let [first, second, largest] = networks;
        let (name, expected) = ("adam.steps", "one integer from 0 to 2^53: the steps before this update");
        let is_count = |value: f64| value.fract() == 0.0 && (0.0..=9.0e15).contains(&value);
        let steps = self.optional(name, |file, name| file.values(name, &[], is_count, expected))?;
        let steps = steps.map(|steps| steps[0] as u64);
        let is_adam = matches!(settings.optimizer, OptimizerName::Adam | OptimizerName::AdamW);
        let is_fresh = matches!((steps, &first, &second), (None | Some(0), None, None));
        let moment = |name, of| missing(name, &format!("Adam's {of} moment, as there is `adam.steps`"));
        if is_adam && !is_fresh {
            steps.ok_or_else(|| missing(name, expected))?;
            first.as_ref().ok_or_else(|| moment("adam.m.0.weight", "first"))?;
            second.as_ref().ok_or_else(|| moment("adam.v.0.weight", "second"))?;
            if settings.amsgrad && largest.is_none() {
                let expected = "the largest second moment so far, as `amsgrad` is true";
                return Err(missing("adam.vmax.0.weight", expected));
            }
        }
        let expected = "a mean of squares, at least 0";
        for moment in [&second, &largest].into_iter().flatten() {
            check_all("adam.v.…", moment.parameters(), |value| value >= 0.0, expected)?;
        }
        let zeros = || Mlp::zeros(sizes.to_vec());
        let [first, second] = [first, second].map(|moment| moment.unwrap_or_else(zeros));
        Ok(Moments { steps: steps.unwrap_or(0), first, second, largest })
    }

    fn optional<T>(
        &mut self, name: &str, read: impl FnOnce(&mut Self, &str) -> Result<T, String>,
    ) -> Result<Option<T>, String> {
        self.views.contains_key(name).then(|| read(self, name)).transpose()
    }

    fn floats(&mut self, name: &str, shape: &[usize]) -> Result<Vec<f64>, String> {
        self.values(name, shape, |_| true, "a finite number")
    }

    fn values(
        &mut self, name: &str, shape: &[usize], fits: impl Fn(f64) -> bool, expected: &str,
    ) -> Result<Vec<f64>, String> {
        let values = self.take(name, shape)?;
        check_all(name, &values, fits, expected)?;
        Ok(values)
    }

    /// Takes a tensor. Axes of length 1 behind those of `shape` are allowed: a column is as good as a list.
    fn take(&mut self, name: &str, shape: &[usize]) -> Result<Vec<f64>, String> {
        let described = || match shape {
            [] => "one number, F32, F64, an integer or BOOL".to_owned(),
            shape => format!("F32, F64, an integer type or BOOL, of shape {shape:?}"),
        };
        let Some(view) = self.views.remove(name) else {
            return Err(missing(name, &described()));
        };
        let has_shape = view.shape().strip_prefix(shape).is_some_and(|rest| rest.iter().all(|&n| n == 1));
        numbers(&view).filter(|_| has_shape).ok_or_else(|| wrong(name, &view, &described()))
    }
}

fn missing(name: &str, expected: &str) -> String {
    format!("has no tensor `{name}`; expected {expected}")
}

fn wrong(name: &str, view: &TensorView, expected: &str) -> String {
    format!("tensor `{name}` is {:?} {:?}; expected {expected}", view.dtype(), view.shape())
}

/// The first of the values that does not fit.
fn check_all(name: &str, values: &[f64], fits: impl Fn(f64) -> bool, expected: &str) -> Result<(), String> {
    match values.iter().enumerate().find(|(_, value)| !(value.is_finite() && fits(**value))) {
        Some((i, x)) => Err(format!("tensor `{name}` holds {x} at position {i}; expected {expected}")),
        None => Ok(()),
    }
}

/// A tensor's numbers; none if it is of a type that is not read.
pub(super) fn numbers(view: &TensorView) -> Option<Vec<f64>> {
    macro_rules! decoded {
        ($type:ty) => {{
            let (chunks, _) = view.data().as_chunks::<{ size_of::<$type>() }>();
            chunks.iter().map(|&bytes| <$type>::from_le_bytes(bytes) as f64).collect()
        }};
    }
    Some(match view.dtype() {
        Dtype::F32 => decoded!(f32),
        Dtype::F64 => decoded!(f64),
        Dtype::I64 => decoded!(i64),
        Dtype::I32 => decoded!(i32),
        Dtype::I16 => decoded!(i16),
        Dtype::I8 => decoded!(i8),
        Dtype::U64 => decoded!(u64),
        Dtype::U32 => decoded!(u32),
        Dtype::U16 => decoded!(u16),
        Dtype::U8 | Dtype::BOOL => decoded!(u8),
        _ => return None,
    })
}
