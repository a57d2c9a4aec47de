//! A recorded loop in a `.safetensors` file, whoever wrote it. docs/check.md describes the layout.

use std::borrow::Cow;
use std::cell::OnceCell;
use std::collections::{BTreeMap, HashMap};

use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensors};
use serde::Deserialize;
use serde_json::Value;

use super::super::file::{Settings, Update, numbers};
use crate::tensors::{check_count, header_of};

/// The version of the format that is read.
const VERSION: u64 = 1;
/// The metadata's key that only a trace has.
const TRACE: &str = "trace";
const SETTINGS: &str = "settings";
/// Largest file that is read, in bytes.
pub(crate) const MAX_FILE_SIZE: usize = 1 << 28;
/// Most numbers in a column, most numbers of an observation, and most actions.
const MAX_NUMBERS: usize = 1 << 25;
const MAX_WIDTH: usize = 4096;
const EMPTY: &str = "holds no step and no update: was `learned` called, or the environment that `recorder.environment` \
                     returned stepped?";

/// A loop, in columns. What the file does not hold is empty.
#[derive(Debug, Default)]
pub(crate) struct Trace {
    pub header: Heading,
    pub told: Told,
    pub steps: Steps,
    pub updates: Updates,
    pub batches: Batches,
    pub whole: Vec<Whole>,
    /// How much of the file is there, if not all of it.
    pub cut: Option<String>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(crate) struct Heading {
    pub closed: bool,
    pub environment: String,
    pub environments: usize,
    /// How many actions the environment has; 0 if it does not say.
    pub actions: usize,
    pub tensors: Vec<String>,
    /// Whether target and online network were one object.
    pub same_object: bool,
    /// What the recorder could not record.
    pub not_recorded: Vec<String>,
}

/// Numbers in rows of the same length.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Vectors {
    pub values: Vec<f32>,
    pub width: usize,
}

impl Vectors {
    pub fn row(&self, index: usize) -> &[f32] {
        &self.values[index * self.width..(index + 1) * self.width]
    }
}

/// Environment steps, in their order. A row is a step of one environment.
#[derive(Debug, Default)]
pub(crate) struct Steps {
    pub observation: Vectors,
    pub next_observation: Vectors,
    pub action: Vec<usize>,
    pub reward: Vec<f64>,
    pub terminated: Vec<bool>,
    pub truncated: Vec<bool>,
    /// 0; 1 if the observation is the first of an episode; 2 if it was reset with the same seed as before.
    pub reset: Vec<usize>,
    /// NaN where none were told; without width if none were told at all.
    pub q_values: Vectors,
    pub epsilon: Vec<f64>,
    /// The row before of the same environment.
    pub previous: Vec<Option<usize>>,
}

#[derive(Debug, Default)]
pub(crate) struct Updates {
    /// Vectors of [`Steps`] before the update.
    pub step: Vec<usize>,
    /// After the update: a checksum of each tensor, and some of the weights.
    pub online: Vec<Vec<u64>>,
    pub target: Vec<Vec<u64>>,
    pub online_sample: Vectors,
    /// Without width if there is no target network.
    pub target_sample: Vectors,
    pub loss: Vec<f64>,
    pub largest_target: Vec<f64>,
    pub batch_size: Vec<usize>,
    /// Adam's t; below 0 if it is not known.
    pub optimizer_steps: Vec<f64>,
}

/// Some minibatches, one behind the other.
#[derive(Debug, Default)]
pub(crate) struct Batches {
    pub update: Vec<usize>,
    pub observations: Vectors,
    pub next_observations: Vectors,
    pub actions: Vec<usize>,
    pub rewards: Vec<f64>,
    pub terminated: Vec<bool>,
    pub discounts: Vec<f64>,
}

/// All tensors of one update, under the names of an update's file; but `result.q` is Q(s, ·) after the update.
#[derive(Debug, Default)]
pub(crate) struct Whole {
    pub number: usize,
    pub told: Told,
    tensors: BTreeMap<String, (Dtype, Vec<usize>, Vec<u8>)>,
    without_optimizer: OnceCell<Option<Update>>,
}

/// Settings, and the names of those that the file says.
#[derive(Clone, Debug, Default)]
pub(crate) struct Told {
    pub settings: Settings,
    names: Vec<String>,
}

impl Told {
    fn new(texts: &[&str]) -> Result<Self, serde_json::Error> {
        let mut all = serde_json::Map::new();
        for text in texts {
            all.extend(serde_json::from_str::<serde_json::Map<_, _>>(text)?);
        }
        let names = all.keys().cloned().collect();
        Ok(Self { settings: serde_json::from_value(Value::Object(all))?, names })
    }

    pub fn has(&self, name: &str) -> bool {
        self.names.iter().any(|told| told == name)
    }
}

impl Whole {
    /// The update with these settings, of the tensors for which there is a new name.
    pub fn update(
        &self, settings: Settings, new_name: impl for<'a> Fn(&'a str) -> Option<Cow<'a, str>>,
    ) -> Option<Update> {
        let views = self.tensors.iter().filter_map(|(name, (dtype, shape, bytes))| {
            Some((new_name(name)?, TensorView::new(*dtype, shape.clone(), bytes).ok()?))
        });
        let bytes = safetensors::serialize(views.collect::<Vec<_>>(), Some(settings.metadata())).ok()?;
        Update::from_bytes(&bytes).ok()
    }

    /// The update without what the optimiser remembers.
    pub fn without_optimizer(&self) -> Option<&Update> {
        let is_kept = |name: &str| !(name.starts_with("adam.") || name == "result.q");
        let read = || self.update(self.told.settings, |name| is_kept(name).then(|| name.into()));
        self.without_optimizer.get_or_init(read).as_ref()
    }

    /// The forward pass of the online network after the update.
    pub fn forward(&self) -> Option<Update> {
        self.update(self.told.settings, |name| match name.strip_prefix("result.online.") {
            Some(rest) => Some(format!("online.{rest}").into()),
            None => (name.starts_with("batch.") || name == "result.q").then(|| name.into()),
        })
    }
}

/// How long a file is as its header says.
fn whole_size(bytes: &[u8]) -> Option<usize> {
    let header: HashMap<String, Value> = serde_json::from_slice(header_of(bytes)).ok()?;
    let ends = header.values().filter_map(|tensor| tensor["data_offsets"][1].as_u64()).max();
    usize::try_from(ends.unwrap_or(0).checked_add(8 + header_of(bytes).len() as u64)?).ok()
}

/// Whether the bytes of a safetensors file, as far as they go, are a trace.
pub(crate) fn is_trace(bytes: &[u8]) -> bool {
    let header: Option<Value> = serde_json::from_slice(header_of(bytes)).ok();
    header.is_some_and(|header| header["__metadata__"][TRACE].is_string())
}

impl Trace {
    pub(crate) fn from_bytes(bytes: &[u8]) -> Result<Self, String> {
        let damaged = |error: safetensors::SafeTensorError| format!("is damaged ({error})");
        check_count(header_of(bytes)).map_err(|problem| format!("is too large to check: {problem}"))?;
        let has = bytes.len();
        let size = whole_size(bytes).filter(|size| *size <= MAX_FILE_SIZE).unwrap_or(has);
        // A file that was cut off is read as far as it goes: tensors that are not whole are left out.
        let mut bytes = Cow::from(bytes);
        if has < size {
            bytes.to_mut().resize(size, 0);
        }
        let (header_size, metadata) = SafeTensors::read_metadata(&bytes).map_err(damaged)?;
        let file = SafeTensors::deserialize(&bytes).map_err(damaged)?;
        let texts = metadata.metadata().clone().unwrap_or_default();
        let header = header(texts.get(TRACE).map_or("", String::as_str))?;
        let settings = texts.get(SETTINGS).map_or("{}", String::as_str);
        let told = Told::new(&[settings]).map_err(unread(SETTINGS))?;
        told.settings.validate()?;
        let end = |name: &str| metadata.info(name).map_or(0, |info| header_size + 8 + info.data_offsets.1);
        let (views, lost): (HashMap<_, _>, HashMap<_, _>) =
            file.iter().map(|(name, view)| (name.to_owned(), view)).partition(|(name, _)| end(name) <= has);
        let mut columns = Columns { views, is_cut: !lost.is_empty() };
        let cut = (has < size).then(|| format!("the file is cut off: {has} of its {size} bytes are there"));
        let whole = columns.whole(|number| {
            let own = format!("update.{number}.{SETTINGS}");
            let own = texts.get(&own).map_or("{}", String::as_str);
            // What the optimiser says of itself comes first: the user's word is the last.
            Told::new(&[own, settings]).unwrap_or_else(|_| told.clone())
        });
        let (steps, updates, batches) = (columns.steps()?, columns.updates()?, columns.batches()?);
        let trace = Self { header, told, steps, updates, batches, whole, cut };
        let (steps, updates) = (trace.steps.action.len(), trace.updates.step.len());
        let is_in = |step: &usize| *step <= steps || steps == 0;
        if !trace.updates.step.iter().all(is_in) || !trace.updates.step.is_sorted() {
            return Err(format!("tensor `updates.step` must ascend to at most {steps}, the number of steps"));
        }
        let of_batches = &trace.batches.update;
        if !of_batches.is_sorted() || (updates > 0 && of_batches.last().is_some_and(|last| *last >= updates))
        {
            return Err(format!(
                "tensor `batches.update` must ascend below {updates}, the number of updates"
            ));
        }
        match steps + updates {
            0 if trace.cut.is_none() => Err(EMPTY.into()),
            _ => Ok(trace),
        }
    }
}

fn unread(key: &str) -> impl Fn(serde_json::Error) -> String {
    move |error| format!("has metadata `{key}` that cannot be read: {error}")
}

fn header(text: &str) -> Result<Heading, String> {
    let value: Value = serde_json::from_str(text).map_err(unread(TRACE))?;
    match value["version"].as_u64() {
        Some(VERSION) => serde_json::from_value(value).map_err(unread(TRACE)),
        _ => Err(format!(
            "is a trace of version {}; this program reads version {VERSION}. Install the program and the Python module of \
             the same release",
            value["version"]
        )),
    }
}

/// The tensors of a file that have not been taken yet.
#[derive(Default)]
struct Columns<'a> {
    views: HashMap<String, TensorView<'a>>,
    is_cut: bool,
}

impl Columns<'_> {
    /// A tensor's numbers and how many each row has, 1 to `width`; none if the file does not have it.
    fn column(&mut self, name: &str, rows: usize, width: usize) -> Result<Option<(Vec<f64>, usize)>, String> {
        let Some(view) = self.views.remove(name) else { return Ok(None) };
        let has = match *view.shape() {
            [length] if length == rows => 1,
            [length, width] if length == rows => width,
            _ => 0,
        };
        if !(1..=width).contains(&has) {
            return Err(format!(
                "tensor `{name}` has the shape {:?}; expected are {rows} rows, as many as the other columns have, each of 1 to \
                 {width} numbers",
                view.shape()
            ));
        }
        let values = Some(view).filter(|_| rows.saturating_mul(has) <= MAX_NUMBERS);
        let values = values.and_then(|view| numbers(&view));
        let unread = || format!("tensor `{name}` is too large, or of a type that is not read");
        Ok(Some((values.ok_or_else(unread)?, has)))
    }

    /// One number for each row, NaN where nothing was told; empty if the file does not have it.
    fn floats(&mut self, name: &str, rows: usize) -> Result<Vec<f64>, String> {
        Ok(self.column(name, rows, 1)?.map_or(Vec::new(), |(values, _)| values))
    }

    /// A whole number from 0 for each row; 0 if the file does not have it.
    fn integers(&mut self, name: &str, rows: usize) -> Result<Vec<usize>, String> {
        let values = self.column(name, rows, 1)?.map_or(vec![0.0; rows], |(values, _)| values);
        match values.iter().find(|value| value.fract() != 0.0 || !(0.0..9e15).contains(*value)) {
            Some(value) => Err(format!("tensor `{name}` holds {value}; expected whole numbers from 0")),
            None => Ok(values.into_iter().map(|value| value as usize).collect()),
        }
    }

    fn flags(&mut self, name: &str, rows: usize) -> Result<Vec<bool>, String> {
        Ok(self.integers(name, rows)?.into_iter().map(|value| value != 0).collect())
    }

    fn rows(&mut self, name: &str, rows: usize) -> Result<Vectors, String> {
        let (values, width) = self.column(name, rows, MAX_WIDTH)?.unwrap_or_default();
        // −0 is 0: the same observation.
        Ok(Vectors { values: values.into_iter().map(|value| value as f32 + 0.0).collect(), width })
    }

    /// The observations and next observations of a group, which are as long as each other.
    fn observations(&mut self, names: [&str; 2], rows: usize) -> Result<[Vectors; 2], String> {
        let both = [self.rows(names[0], rows)?, self.rows(names[1], rows)?];
        for (name, rows) in names.iter().zip(&both) {
            if let Some(at) = rows.values.iter().position(|value| !value.is_finite()) {
                let (value, row) = (rows.values[at], at / rows.width);
                return Err(format!("tensor `{name}` holds {value} in row {row}; expected finite numbers"));
            }
        }
        match both[0].width == both[1].width {
            true => Ok(both),
            false => Err(format!("its tensors `{}` and `{}` differ in their shape", names[0], names[1])),
        }
    }

    /// How many rows the columns of a group have; none if the group is not there, or not all of it because the file is cut off.
    fn length(&self, needed: &[&str]) -> Result<Option<usize>, String> {
        let missing: Vec<_> = needed.iter().filter(|name| !self.views.contains_key(**name)).collect();
        match missing.first() {
            Some(_) if self.is_cut || missing.len() == needed.len() => Ok(None),
            Some(name) => Err(format!("has no tensor `{name}`; expected are {}", needed.join(", "))),
            None => Ok(self.views.get(needed[0]).and_then(|view| view.shape().first().copied())),
        }
    }

    fn steps(&mut self) -> Result<Steps, String> {
        const OBSERVATIONS: [&str; 2] = ["steps.observation", "steps.next_observation"];
        let flags = ["steps.terminated", "steps.truncated"];
        let needed = ["steps.action", OBSERVATIONS[0], OBSERVATIONS[1], "steps.reward", flags[0], flags[1]];
        let Some(rows) = self.length(&needed)? else { return Ok(Steps::default()) };
        let environment = self.integers("steps.environment", rows)?;
        let mut last = HashMap::new();
        let previous = environment.iter().enumerate().map(|(row, env)| last.insert(*env, row)).collect();
        let [observation, next_observation] = self.observations(OBSERVATIONS, rows)?;
        Ok(Steps {
            observation,
            next_observation,
            action: self.integers("steps.action", rows)?,
            reward: self.floats("steps.reward", rows)?,
            terminated: self.flags(flags[0], rows)?,
            truncated: self.flags(flags[1], rows)?,
            reset: self.integers("steps.reset", rows)?,
            q_values: self.rows("steps.q_values", rows)?,
            epsilon: self.floats("steps.epsilon", rows)?,
            previous,
        })
    }

    fn updates(&mut self) -> Result<Updates, String> {
        let needed = ["updates.step", "updates.online"];
        let Some(rows) = self.length(&needed)? else { return Ok(Updates::default()) };
        Ok(Updates {
            step: self.integers("updates.step", rows)?,
            online: self.checksums("updates.online", rows)?,
            target: self.checksums("updates.target", rows)?,
            online_sample: self.rows("updates.online_sample", rows)?,
            target_sample: self.rows("updates.target_sample", rows)?,
            loss: self.floats("updates.loss", rows)?,
            largest_target: self.floats("updates.largest_target", rows)?,
            batch_size: self.integers("updates.batch_size", rows)?,
            optimizer_steps: self.floats("updates.optimizer_steps", rows)?,
        })
    }

    fn checksums(&mut self, name: &str, rows: usize) -> Result<Vec<Vec<u64>>, String> {
        let (values, width) = self.column(name, rows, MAX_WIDTH)?.unwrap_or_default();
        Ok(values.chunks(width.max(1)).map(|row| row.iter().map(|value| value.to_bits()).collect()).collect())
    }

    fn batches(&mut self) -> Result<Batches, String> {
        const OBSERVATIONS: [&str; 2] = ["batches.observations", "batches.next_observations"];
        let others = ["batches.update", "batches.actions", "batches.rewards", "batches.terminated"];
        let needed = [&others[..], &OBSERVATIONS].concat();
        let Some(rows) = self.length(&needed)? else { return Ok(Batches::default()) };
        let [observations, next_observations] = self.observations(OBSERVATIONS, rows)?;
        Ok(Batches {
            observations,
            next_observations,
            update: self.integers(others[0], rows)?,
            actions: self.integers(others[1], rows)?,
            rewards: self.floats(others[2], rows)?,
            terminated: self.flags(others[3], rows)?,
            discounts: self.floats("batches.discounts", rows)?,
        })
    }

    /// The whole updates, by their numbers.
    fn whole(&self, told: impl Fn(usize) -> Told) -> Vec<Whole> {
        let mut updates: BTreeMap<usize, Whole> = BTreeMap::new();
        for (name, view) in &self.views {
            let parts = name.strip_prefix("update.").and_then(|rest| rest.split_once('.'));
            let Some((number, name)) = parts.and_then(|(number, name)| Some((number.parse().ok()?, name)))
            else {
                continue;
            };
            let new = || Whole { number, told: told(number), ..Whole::default() };
            let tensor = (view.dtype(), view.shape().to_vec(), view.data().to_vec());
            updates.entry(number).or_insert_with(new).tensors.insert(name.to_owned(), tensor);
        }
        updates.into_values().collect()
    }
}
