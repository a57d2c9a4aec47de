//! Environments: what an agent acts in. They know nothing of agents.
//!
//! An environment is a trait object whose sizes are data, so that the trainer is the same for every task. A step can fail,
//! because an environment may be another program.

mod acrobot;
mod cartpole;
pub mod catalogue;
pub mod map;
mod mountain_car;
pub mod scene;
mod time_limit;

use serde::{Deserialize, Serialize};

use crate::mirror::Mirror;
use crate::rng::Rng;
use map::MapAxis;
use scene::Scene;

pub use acrobot::Acrobot;
pub use cartpole::CartPole;
pub use mountain_car::MountainCar;
pub use time_limit::TimeLimit;

/// What is known of a task before its first step.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Spec {
    /// Its name, for example `CartPole-v1`.
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
    /// Steps in a second of simulated time.
    pub steps_per_second: f64,
    /// What each action is called.
    pub actions: Vec<String>,
    /// What each coordinate of an observation is called.
    pub observations: Vec<String>,
    /// The mirror image of the task, if it has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mirror: Option<Mirror>,
    /// The plane in which a page shows what a policy prefers, if the task has one. Coordinates that are on neither axis are 0
    /// there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub map: Option<[MapAxis; 2]>,
}

impl Spec {
    /// Whether a mean return solves the task; never where the task has no threshold.
    pub fn is_solved_by(&self, mean_return: f64) -> bool {
        self.solved_return.is_some_and(|threshold| mean_return >= threshold)
    }

    /// Which mean return solves the task, in words.
    pub fn goal(&self) -> String {
        self.solved_return.map_or_else(|| "of no threshold".into(), |threshold| format!("≥ {threshold}"))
    }
}

/// Where an episode starts.
#[derive(Debug)]
pub enum Start<'a> {
    /// Where Gymnasium's `reset(seed=…)` starts it. Evaluations start here.
    Seed(u64),
    /// Where the next numbers of a stream lead. Training starts here.
    Stream(&'a mut Rng),
}

impl Start<'_> {
    /// Draws a start state.
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
    /// Reward of the step.
    pub reward: f64,
    /// The task itself has ended: the value of what follows is 0.
    pub terminated: bool,
    /// The episode was cut off from outside: what follows still has a value.
    pub truncated: bool,
}

impl Outcome {
    /// Whether the episode is over, for whichever reason.
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

/// A Markov decision process with a finite set of actions, numbered from 0. It must be deterministic: the same start and the
/// same actions lead to the same observations.
pub trait Environment: Send {
    /// What is known of the task.
    fn spec(&self) -> &Spec;

    /// Starts a new episode and writes its first observation, `observation_size` numbers.
    ///
    /// # Errors
    /// When the environment fails.
    fn reset(&mut self, start: Start<'_>, observation: &mut [f32]) -> Result<(), EnvironmentError>;

    /// Applies `action` for one time step and writes what the agent sees then.
    ///
    /// # Errors
    /// When the environment fails.
    fn step(&mut self, action: usize, observation: &mut [f32]) -> Result<Outcome, EnvironmentError>;

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
}

/// Makes an environment whose episodes are truncated after so many steps. Evaluations and studies make their own.
pub type Make = dyn Fn(u32) -> Result<Box<dyn Environment>, EnvironmentError> + Send + Sync;
