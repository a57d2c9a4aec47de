//! What a run's policy does, for a page: its choice over pole angle and angular velocity, and an episode.

use std::path::Path;

use serde::Serialize;

use super::ReportError;
use crate::draw::{Motion, motions};
use crate::env::CartPole;
use crate::env::catalogue::EnvironmentId;
use crate::env::scene::Outline;
use crate::run::names::{BEST, CHECKPOINTS, LAST};
use crate::run::{Checkpoint, SavedPolicy};
use crate::trainer::{Frame, SCORE_SEED, record};

/// Largest angular velocity of the picture, rad/s.
const MAX_VELOCITY: f64 = 2.5;
/// Points of the picture in each direction; odd, so that the upright pole at rest is one.
const SIZE: usize = 81;

/// The policy of a run.
#[derive(Serialize)]
pub(super) struct Portrait {
    checkpoint: String,
    env_steps: Option<u64>,
    max_angle: f64,
    max_velocity: f64,
    size: usize,
    steps_per_second: f64,
    /// What each action and each coordinate of a state is called.
    actions: Vec<String>,
    coordinates: Vec<String>,
    /// Q(right) − Q(left) at x = ẋ = 0: rows of angular velocity from the smallest, in each the angles from the
    /// smallest.
    preference: Vec<f64>,
    episode: Episode,
}

/// One episode of it; of every series one value per state, `actions` and `q_values` without the last.
#[derive(Serialize)]
struct Episode {
    seed: u64,
    /// The series of every coordinate.
    state: Vec<Vec<f64>>,
    /// The picture; empty if the environment has none.
    shapes: Vec<MovingShape>,
    actions: Vec<usize>,
    q_values: Vec<Vec<f64>>,
}

/// A rigid shape of the picture, and where it is: `x` and `y` in pixels, `angle` in rad counterclockwise.
#[derive(Serialize)]
struct MovingShape {
    color: &'static str,
    #[serde(flatten)]
    outline: PageOutline,
    x: Vec<f64>,
    y: Vec<f64>,
    angle: Vec<f64>,
}

#[derive(Serialize)]
#[serde(rename_all = "lowercase")]
enum PageOutline {
    Polygon(Vec<(f64, f64)>),
    Radius(f64),
    Line(Vec<(f64, f64)>),
}

impl Portrait {
    /// The portrait of the policy in a run's directory; none without a checkpoint.
    pub(super) fn of(folder: &Path, environment: EnvironmentId) -> Result<Option<Self>, ReportError> {
        let mut found = None;
        for name in [BEST, LAST].map(|name| format!("{CHECKPOINTS}/{name}")) {
            let path = folder.join(&name);
            if path.try_exists().map_err(|error| ReportError::unreadable(&path, &error))? {
                found = Some((name, path));
                break;
            }
        }
        let Some((name, path)) = found else { return Ok(None) };
        let checkpoint = Checkpoint::read(&path).map_err(|error| ReportError::new(&path, error.problem))?;
        let task = environment.spec();
        let saved =
            SavedPolicy::of(&checkpoint, &task).map_err(|problem| ReportError::new(&path, problem))?;
        let observations = observations();
        let mut policy = saved.greedy(observations.len());
        policy.forward_batch(observations.iter().map(AsRef::as_ref));
        let preference = |sample| rounded(policy.q_value(sample, 1) - policy.q_value(sample, 0));
        let environment = environment.make(task.max_steps);
        let frames = environment
            .and_then(|mut environment| record(&mut saved.greedy(1), &mut *environment, SCORE_SEED))
            .map_err(|error| ReportError::new(folder, error))?;
        Ok(Some(Self {
            checkpoint: name,
            env_steps: saved.header.as_ref().map(|header| header.env_steps),
            max_angle: CartPole::MAX_ANGLE,
            max_velocity: MAX_VELOCITY,
            size: SIZE,
            steps_per_second: task.steps_per_second,
            actions: task.actions,
            coordinates: task.observations,
            preference: (0..observations.len()).map(preference).collect(),
            episode: Episode::new(&frames),
        }))
    }
}

impl Episode {
    fn new(frames: &[Frame]) -> Self {
        let coordinates = frames.first().map_or(0, |frame| frame.state.len());
        let coordinate = |i: usize| frames.iter().map(|frame| rounded(frame.state[i])).collect();
        let scenes: Vec<_> = frames.iter().filter_map(|frame| frame.scene.clone()).collect();
        let values = |frame: &Frame| frame.q_values.iter().map(|&q| rounded(f64::from(q))).collect();
        Self {
            seed: SCORE_SEED,
            state: (0..coordinates).map(coordinate).collect(),
            shapes: motions(&scenes).iter().map(MovingShape::new).collect(),
            actions: frames.iter().filter_map(|frame| frame.action).collect(),
            q_values: frames.iter().filter(|frame| frame.action.is_some()).map(values).collect(),
        }
    }
}

impl MovingShape {
    fn new(motion: &Motion<'_>) -> Self {
        let pixels = |value: f64| (value * 100.0).round() / 100.0;
        Self {
            color: motion.shape.color.name(),
            outline: match &motion.shape.outline {
                Outline::Polygon(points) => PageOutline::Polygon(points.clone()),
                Outline::Circle(radius) => PageOutline::Radius(*radius),
                Outline::Line(points) => PageOutline::Line(points.clone()),
            },
            x: series(motion.at.iter().map(|at| pixels(at.0))),
            y: series(motion.at.iter().map(|at| pixels(at.1))),
            angle: series(motion.angle.iter().map(|&angle| rounded(angle))),
        }
    }
}

/// All values, or one if they are the same.
fn series(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.collect();
    if values.iter().all(|value| *value == values[0]) {
        values.truncate(1);
    }
    values
}

/// The observations of the picture, row by row.
fn observations() -> Vec<[f32; 4]> {
    let at = |i: usize, limit: f64| ((2 * i) as f64 / (SIZE - 1) as f64 - 1.0) * limit;
    (0..SIZE * SIZE)
        .map(|i| [0.0, 0.0, at(i % SIZE, CartPole::MAX_ANGLE) as f32, at(i / SIZE, MAX_VELOCITY) as f32])
        .collect()
}

/// What a picture can show.
fn rounded(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}
