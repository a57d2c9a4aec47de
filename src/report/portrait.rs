//! What a run's policy does, for a page: its choice over two quantities of its task, and an episode.

use std::path::Path;

use serde::Serialize;

use super::ReportError;
use crate::agent::QTable;
use crate::config::EnvironmentConfig;
use crate::draw::{Motion, motions};
use crate::env::map::{MapAxis, Quantity};
use crate::env::scene::Outline;
use crate::run::names::{BEST, CHECKPOINTS, LAST};
use crate::run::{Checkpoint, SavedPolicy};
use crate::trainer::{Frame, Recording, SCORE_SEED, record};

/// Points of the map in each direction; odd, so that the middle is one.
const SIZE: usize = 81;

/// The policy of a run.
#[derive(Serialize)]
pub(super) struct Portrait {
    checkpoint: String,
    env_steps: Option<u64>,
    steps_per_second: f64,
    /// What each action and each coordinate of a state is called.
    actions: Vec<String>,
    coordinates: Vec<String>,
    /// None if the task has no plane for one.
    map: Option<Map>,
    episode: Episode,
}

/// What the policy prefers over the plane of its task: rows from the smallest value of the second axis, in each the values
/// of the first axis from the smallest.
#[derive(Serialize)]
struct Map {
    size: usize,
    axes: [Axis; 2],
    /// The best action of every point, and how much more it is worth than the second best.
    best: Vec<usize>,
    gap: Vec<f64>,
    /// Where the episode was, along each axis.
    trail: [Vec<f64>; 2],
    /// None for a network.
    table: Option<Cells>,
}

/// The cells of a table in the plane.
#[derive(Serialize)]
struct Cells {
    /// Their edges along each axis.
    edges: [Vec<f64>; 2],
    /// How often the cell of every point was updated.
    visits: Vec<u64>,
}

#[derive(Serialize)]
struct Axis {
    name: String,
    unit: String,
    low: f64,
    high: f64,
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
    total: f64,
    /// How it terminated, in words; empty if it did not.
    ending: &'static str,
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
    /// The portrait of the policy in a run's directory; none without a checkpoint, and none where the environment is a
    /// program, because a report starts none.
    pub(super) fn of(folder: &Path, environment: &EnvironmentConfig) -> Result<Option<Self>, ReportError> {
        if environment.command().is_some() {
            return Ok(None);
        }
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
        let task = environment.spec().map_err(|error| ReportError::new(folder, error))?;
        let saved =
            SavedPolicy::of(&checkpoint, &task).map_err(|problem| ReportError::new(&path, problem))?;
        let failed = |error| ReportError::new(folder, error);
        let mut environment = (environment.make())(task.max_steps).map_err(failed)?;
        let recording = record(&mut saved.greedy(1), &mut *environment, SCORE_SEED).map_err(failed)?;
        let (count, frames) = ([task.observation_size, task.num_actions], &recording.frames);
        let map = task.map.as_ref().map(|axes| Map::new(axes, count, &saved, frames));
        Ok(Some(Self {
            checkpoint: name,
            env_steps: saved.header.as_ref().map(|header| header.env_steps),
            steps_per_second: task.steps_per_second,
            actions: task.actions,
            coordinates: task.observations,
            map,
            episode: Episode::new(&recording, environment.ending()),
        }))
    }
}

impl Map {
    fn new(axes: &[MapAxis; 2], [size, actions]: [usize; 2], saved: &SavedPolicy, frames: &[Frame]) -> Self {
        let value = |axis: usize, i: usize| {
            let (low, high) = axes[axis].range;
            low + (high - low) * i as f64 / (SIZE - 1) as f64
        };
        let observation = |i: usize| {
            let mut observation = vec![0.0; size];
            axes[0].write(value(0, i % SIZE), &mut observation);
            axes[1].write(value(1, i / SIZE), &mut observation);
            observation
        };
        let observations: Vec<_> = (0..SIZE * SIZE).map(observation).collect();
        let mut policy = saved.greedy(observations.len());
        policy.forward_batch(observations.iter().map(AsRef::as_ref));
        let ranked = (0..observations.len()).map(|sample| {
            let mut order: Vec<usize> = (0..actions).collect();
            // The first of equals is the best, as in `argmax`.
            order.sort_by(|&a, &b| policy.q_value(sample, b).total_cmp(&policy.q_value(sample, a)));
            let second = order.get(1).unwrap_or(&order[0]);
            (order[0], rounded(policy.q_value(sample, order[0]) - policy.q_value(sample, *second)))
        });
        let (best, gap) = ranked.unzip();
        let axis = |MapAxis { name, unit, range, .. }: &MapAxis| {
            let (name, unit) = (name.clone(), unit.clone());
            Axis { name, unit, low: range.0, high: range.1 }
        };
        let trail =
            |axis: &MapAxis| frames.iter().map(|frame| rounded(axis.read(&frame.observation))).collect();
        let table = saved.policy.table().map(|table| Cells::new(table, axes, &observations));
        Self {
            size: SIZE,
            axes: axes.each_ref().map(axis),
            best,
            gap,
            trail: axes.each_ref().map(trail),
            table,
        }
    }
}

impl Cells {
    fn new(table: &QTable, axes: &[MapAxis; 2], observations: &[Vec<f32>]) -> Self {
        let edges = |axis: &MapAxis| match axis.quantity {
            Quantity::Coordinate(i) => {
                let edges = table.edges()[i].iter().map(|&edge| f64::from(edge) * axis.factor);
                edges.filter(|edge| axis.range.0 < *edge && *edge < axis.range.1).collect()
            }
            // The edges of a cosine and a sine are not straight in the plane of the angle.
            Quantity::Angle { .. } => Vec::new(),
        };
        let sum = |visits: &[u64]| visits.iter().fold(0, |sum: u64, &count| sum.saturating_add(count));
        let visits = observations.iter().map(|observation| sum(table.visits(observation))).collect();
        Self { edges: axes.each_ref().map(edges), visits }
    }
}

impl Episode {
    fn new(Recording { frames, total, terminated }: &Recording, ending: &'static str) -> Self {
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
            total: rounded(*total),
            ending: if *terminated { ending } else { "" },
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

/// What a picture can show.
fn rounded(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}
