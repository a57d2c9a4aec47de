//! Environments: what an agent acts in. They know nothing of agents.
//!
//! An environment is a trait object whose sizes are data, so that the trainer is the same for every task. A step can fail,
//! because an environment may be another program.

mod acrobot;
mod cartpole;
pub mod catalogue;
pub(crate) mod map;
mod mountain_car;
#[cfg(feature = "program")]
pub mod program;
pub(crate) mod scene;
mod time_limit;

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::rng::Rng;
use crate::text::steers;
use map::MapAxis;
use scene::Scene;

pub use acrobot::Acrobot;
pub use cartpole::CartPole;
pub use mountain_car::MountainCar;
pub use time_limit::TimeLimit;

/// What is known of a task before its first step. Whoever reads one, of a program, a config, a study or a checkpoint, gets only
/// one that is [`checked`](Spec::checked).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(remote = "Self")]
pub struct Spec {
    pub id: String,
    /// Numbers in an observation, at least 1.
    pub observation_size: usize,
    /// Number of actions, 1…256; valid actions are `0..num_actions`.
    pub num_actions: usize,
    /// Steps after which an episode is truncated. Scores count as many.
    pub max_steps: u32,
    /// Mean return over 100 episodes from which the task counts as solved (Gymnasium's `reward_threshold`).
    pub solved_return: Option<f64>,
    /// No episode of `max_steps` steps has a return below the first or above the second. A run that failed scores the lowest.
    pub return_range: (f64, f64),
    pub steps_per_second: f64,
    pub actions: Vec<String>,
    pub observations: Vec<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mirror: Option<crate::mirror::Mirror>,
    /// The plane in which a page shows what a policy prefers, if the task has one. Coordinates that are on neither axis are 0
    /// there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub map: Option<[MapAxis; 2]>,
}

impl Spec {
    /// Whether a mean return solves the task; never where the task has no threshold.
    pub(crate) fn is_solved_by(&self, mean_return: f64) -> bool {
        self.solved_return.is_some_and(|threshold| mean_return >= threshold)
    }

    pub(crate) const MAX_OBSERVATION: usize = 4096;
    /// Most actions: the replay memory keeps an action in a byte.
    pub(crate) const MAX_ACTIONS: usize = 256;
    const MAX_NAME: usize = 100;
    const MAX_RETURN: f64 = 1e30;

    /// The same, if it describes a task.
    pub(crate) fn checked(self) -> Result<Self, String> {
        self.problem().map_or(Ok(self), Err)
    }

    fn problem(&self) -> Option<String> {
        let Self { observation_size: size, num_actions, max_steps, return_range: (low, high), .. } = *self;
        let is_short = |name: &str| name.chars().count() <= Self::MAX_NAME && !name.chars().any(steers);
        let is_name = |name: &String| !name.is_empty() && is_short(name);
        let is_return = |value: f64| value.abs() <= Self::MAX_RETURN;
        // Wide enough that its ends, and the marks of an axis between them, differ in f64.
        let least_width = (1e-9 * low.abs().max(high.abs())).max(1.0 / Self::MAX_RETURN);
        let is_inside = |value: f64| (low..=high).contains(&value);
        let mut names = std::iter::once(&self.id).chain(&self.actions).chain(&self.observations);
        let is_axis = |axis: &MapAxis| is_name(&axis.name) && is_short(&axis.unit) && axis.fits(size);
        let rules = [
            ((1..=Self::MAX_OBSERVATION).contains(&size), "the size of an observation must be 1 to 4096"),
            ((1..=Self::MAX_ACTIONS).contains(&num_actions), "the number of actions must be 1 to 256"),
            ((1..=1_000_000).contains(&max_steps), "`max_steps` must be 1 to 1000000"),
            (self.solved_return.is_none_or(is_return), "`solved_return` must be from -1e30 to 1e30"),
            (
                is_return(low) && is_return(high) && high - low >= least_width,
                "`return_range` must be [low, high] from -1e30 to 1e30, with `high` above `low` by 1e-30 or more, and by a \
                 billionth of the larger of the two or more",
            ),
            (
                self.solved_return.is_none_or(is_inside),
                "`solved_return` must be in `return_range`, or no policy or every policy would solve the task",
            ),
            ((1e-3..=1e6).contains(&self.steps_per_second), "`steps_per_second` must be 0.001 to 1000000"),
            (self.actions.len() == num_actions, "each action must have a name"),
            (self.observations.len() == size, "each number of an observation must have a name"),
            (
                names.all(is_name),
                "a name must have 1 to 100 characters, and no control characters or hidden ones",
            ),
            (
                self.map.as_ref().is_none_or(|axes| axes.iter().all(is_axis)),
                "`map` must be two axes with a range [low, high], over numbers of an observation",
            ),
            (
                self.mirror.as_ref().is_none_or(|mirror| mirror.fits(size, num_actions)),
                "`mirror` must be {\"observation\": a pair [index, factor] for each number, \"actions\": an index for each}, \
                 and the mirror image of a mirror image the same as before",
            ),
        ];
        rules.into_iter().find(|(holds, _)| !holds).map(|(_, rule)| rule.into())
    }

    /// Which mean return solves the task, in words.
    pub(crate) fn goal(&self) -> String {
        self.solved_return.map_or_else(|| "of no threshold".into(), |threshold| format!("≥ {threshold}"))
    }
}

impl Serialize for Spec {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        Self::serialize(self, serializer)
    }
}

impl<'de> Deserialize<'de> for Spec {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Self::deserialize(deserializer)?.checked().map_err(D::Error::custom)
    }
}

#[derive(Debug)]
pub enum Start<'a> {
    /// Where Gymnasium's `reset(seed=…)` starts it. Evaluations start here.
    Seed(u64),
    /// Where the next numbers of a stream lead. Training starts here.
    Stream(&'a mut Rng),
}

impl Start<'_> {
    pub fn draw<T>(self, draw: impl FnOnce(&mut Rng) -> T) -> T {
        match self {
            Self::Seed(seed) => draw(&mut Rng::from_seed(seed)),
            Self::Stream(rng) => draw(rng),
        }
    }
}

/// What one time step brought, besides the observation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outcome {
    pub reward: f64,
    /// The task itself has ended: the value of what follows is 0.
    pub terminated: bool,
    /// The episode was cut off from outside: what follows still has a value.
    pub truncated: bool,
}

impl Outcome {
    pub fn ended(&self) -> bool {
        self.terminated || self.truncated
    }
}

/// An environment has failed, and why. The crate's own cannot fail; another program can. The text is boxed, so that the result of a
/// step stays as small as its outcome.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the environment {}: {}", .0.0, .0.1)]
pub struct EnvironmentError(Box<(String, String)>);

impl EnvironmentError {
    /// The environment of this name has failed for this reason.
    pub fn new(id: &str, problem: &str) -> Self {
        Self(Box::new((id.to_owned(), problem.to_owned())))
    }
}

/// What an environment gives, or why it has failed.
pub type Answer<T> = Result<T, EnvironmentError>;

/// A Markov decision process with a finite set of actions, numbered from 0. It must be deterministic: the same start and the
/// same actions lead to the same observations.
pub trait Environment: Send {
    fn spec(&self) -> &Spec;

    /// Starts a new episode and writes its first observation, `observation_size` numbers.
    fn reset(&mut self, start: Start<'_>, observation: &mut [f32]) -> Answer<()>;

    /// Applies `action` for one time step and writes what the agent sees then.
    fn step(&mut self, action: usize, observation: &mut [f32]) -> Answer<Outcome>;

    /// The full state in f64, more precise than the observation; none if the environment does not show it.
    fn state(&self) -> Option<&[f64]> {
        None
    }

    /// How an episode that has terminated in this state ended, in a few words.
    fn ending(&self) -> &'static str {
        "terminated"
    }

    /// What the environment looks like now; none if the environment has no picture.
    fn scene(&self) -> Option<Scene> {
        None
    }

    /// What an environment without a scene looks like now; none if it draws nothing.
    fn image(&mut self) -> Answer<Option<Image>> {
        Ok(None)
    }

    /// Many of its kind that take their steps together, none yet; none if that is not faster. Episodes are truncated after
    /// `max_steps` steps.
    fn vector(&self, _max_steps: u32) -> Option<Box<dyn VectorEnvironment>> {
        None
    }

    /// In how many processes of its own the environment may be played at the same time; none if it is played in this process.
    fn processes(&self) -> Option<usize> {
        None
    }
}

/// Environments that take their steps together (Gymnasium's `VectorEnv`), each with the bits that it has alone.
pub trait VectorEnvironment {
    /// Adds an environment at a start, before the first step, and writes its first observation.
    fn add(&mut self, start: Start<'_>, observation: &mut [f32]) -> Answer<()>;

    /// One time step of each environment, with its action, and its observation in a row. `outcomes` gets one for each.
    fn step(
        &mut self, actions: &[usize], observations: &mut [f32], outcomes: &mut Vec<Outcome>,
    ) -> Answer<()>;

    /// Removes an environment. The last one takes its place.
    fn swap_remove(&mut self, place: usize);
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image {
    pub(crate) width: u16,
    pub(crate) height: u16,
    /// Red, green and blue of each pixel, row by row from the top.
    pub(crate) rgb: Vec<u8>,
}

/// Makes an environment whose episodes are truncated after so many steps. Evaluations and studies make their own.
pub type Make = dyn Fn(u32) -> Answer<Box<dyn Environment>> + Send + Sync;
