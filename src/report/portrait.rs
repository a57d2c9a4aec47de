//! What a run's policy does, for a page: its choice over pole angle and angular velocity, and an episode.

use std::path::Path;

use serde::Serialize;

use super::ReportError;
use crate::checkpoint::Checkpoint;
use crate::env::{CartPole, TimeLimit};
use crate::study::SCORE_SEED;
use crate::trainer::{Frame, SavedPolicy, record};

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
    /// The portrait of the policy in a run's folder; none without a checkpoint.
    pub(super) fn of(folder: &Path) -> Result<Option<Self>, ReportError> {
        let mut found = None;
        for name in CHECKPOINTS {
            let path = folder.join(name);
            if path.try_exists().map_err(|error| ReportError::unreadable(&path, &error))? {
                found = Some((name, path));
                break;
            }
        }
        let Some((name, path)) = found else { return Ok(None) };
        let checkpoint = Checkpoint::read(&path).map_err(|error| ReportError::new(&path, error.problem))?;
        let saved = SavedPolicy::of::<TimeLimit<CartPole>>(&checkpoint)
            .map_err(|problem| ReportError::new(&path, problem))?;
        let observations = observations();
        let mut policy = saved.greedy(observations.len());
        policy.see(observations.iter().map(AsRef::as_ref));
        let preference = |sample| rounded(policy.q_value(sample, 1) - policy.q_value(sample, 0));
        let frames = record(&mut saved.greedy(1), CartPole::v1(), SCORE_SEED);
        Ok(Some(Self {
            checkpoint: name,
            env_steps: saved.header.as_ref().map(|header| header.env_steps),
            max_angle: MAX_ANGLE,
            max_velocity: MAX_VELOCITY,
            size: SIZE,
            preference: (0..observations.len()).map(preference).collect(),
            episode: Episode::new(&frames),
        }))
    }
}

impl Episode {
    fn new(frames: &[Frame]) -> Self {
        let coordinate = |i: usize| frames.iter().map(|frame| rounded(frame.state[i])).collect();
        let values = |frame: &Frame| frame.q_values.iter().map(|&q| rounded(f64::from(q))).collect();
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
