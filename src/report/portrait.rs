//! What a run's policy does, for a page: its choice over pole angle and angular velocity, and an episode.

use std::path::Path;

use serde::Serialize;

use super::ReportError;
use crate::checkpoint::Checkpoint;
use crate::env::{CartPole, Environment, TimeLimit};
use crate::study::SCORE_SEED;
use crate::trainer::{Frame, Header, q_values, record};

/// Largest pole angle of the picture, rad: that at which an episode ends.
const MAX_ANGLE: f64 = 0.209_439_510_239_319_55;
/// Largest angular velocity of the picture, rad/s.
const MAX_VELOCITY: f64 = 2.5;
/// Points of the picture in each direction; odd, so that the upright pole at rest is one.
const SIZE: usize = 81;
/// The checkpoints of a run, in the order in which `eval` looks for them.
const CHECKPOINTS: [&str; 2] = ["checkpoints/best.safetensors", "checkpoints/last.safetensors"];

/// The policy of a run.
#[derive(Serialize)]
pub(super) struct Portrait {
    checkpoint: &'static str,
    env_steps: Option<u64>,
    max_angle: f64,
    max_velocity: f64,
    size: usize,
    /// Q(right) − Q(left) at x = ẋ = 0: rows of angular velocity from the smallest, in each the angles from the
    /// smallest.
    preference: Vec<f64>,
    episode: Episode,
}

/// One episode of it; of every series one value per state, `actions` and `q_values` without the last.
#[derive(Serialize)]
struct Episode {
    seed: u64,
    positions: Vec<f64>,
    angles: Vec<f64>,
    velocities: Vec<f64>,
    actions: Vec<usize>,
    q_values: Vec<Vec<f64>>,
}

impl Portrait {
    /// The portrait of the policy in a run's folder; none without a checkpoint. Q-values are divided by `reward_scale`,
    /// so that they are returns.
    pub(super) fn of(folder: &Path, reward_scale: f64) -> Result<Option<Self>, ReportError> {
        let mut found = None;
        for name in CHECKPOINTS {
            let path = folder.join(name);
            if path.try_exists().map_err(|error| ReportError::unreadable(&path, &error))? {
                found = Some((name, path));
                break;
            }
        }
        let Some((name, path)) = found else { return Ok(None) };
        type Task = TimeLimit<CartPole>;
        let checkpoint = Checkpoint::read(&path).map_err(|error| ReportError::new(&path, error.problem))?;
        let policy = checkpoint
            .policy(Task::OBSERVATION_SIZE, Task::NUM_ACTIONS)
            .map_err(|problem| ReportError::new(&path, problem))?;
        let values = q_values(&policy, &observations());
        let frames = record(&policy, CartPole::v1(), SCORE_SEED);
        Ok(Some(Self {
            checkpoint: name,
            env_steps: checkpoint.header::<Header>().ok().map(|header| header.env_steps),
            max_angle: MAX_ANGLE,
            max_velocity: MAX_VELOCITY,
            size: SIZE,
            preference: values.iter().map(|q| rounded((q[1] - q[0]) / reward_scale)).collect(),
            episode: Episode::new(&frames, reward_scale),
        }))
    }
}

impl Episode {
    fn new(frames: &[Frame], reward_scale: f64) -> Self {
        let coordinate = |i: usize| frames.iter().map(|frame| rounded(frame.state[i])).collect();
        let values =
            |frame: &Frame| frame.q_values.iter().map(|&q| rounded(f64::from(q) / reward_scale)).collect();
        Self {
            seed: SCORE_SEED,
            positions: coordinate(0),
            angles: coordinate(2),
            velocities: coordinate(3),
            actions: frames.iter().filter_map(|frame| frame.action).collect(),
            q_values: frames.iter().filter(|frame| frame.action.is_some()).map(values).collect(),
        }
    }
}

/// The observations of the picture, row by row.
fn observations() -> Vec<[f32; 4]> {
    let at = |i: usize, limit: f64| ((2 * i) as f64 / (SIZE - 1) as f64 - 1.0) * limit;
    (0..SIZE * SIZE)
        .map(|i| [0.0, 0.0, at(i % SIZE, MAX_ANGLE) as f32, at(i / SIZE, MAX_VELOCITY) as f32])
        .collect()
}

/// What a picture can show.
fn rounded(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}
