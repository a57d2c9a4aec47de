//! What a run's policy does, for a page: its choice over two quantities of its task, and an episode.

use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::ReportError;
use crate::config::EnvironmentConfig;
use crate::draw::{Motion, motions};
use crate::env::map::{MapAxis, Quantity};
use crate::env::scene::Outline;
use crate::run::names::{BEST, CHECKPOINTS, LAST};
use crate::run::{Checkpoint, SavedPolicy};
use crate::trainer::{Frame, Recording, SCORE_SEED, record};

/// Points of the map in each direction; odd, so that the middle is one.
const SIZE: usize = 81;

/// The portrait of the policy in a run's directory; null without a checkpoint, and for a program, as a report starts none.
pub(super) fn portrait(run: &Path, environment: &EnvironmentConfig) -> Result<Value, ReportError> {
    let (None, Some(path)) = (environment.command(), checkpoint_of(run)?) else { return Ok(Value::Null) };
    let checkpoint = Checkpoint::read(&path).map_err(|error| ReportError::new(&path, error.problem))?;
    let task = environment.spec().map_err(|error| ReportError::new(run, error))?;
    let saved = SavedPolicy::of(&checkpoint, &task).map_err(|problem| ReportError::new(&path, problem))?;
    let failed = |error| ReportError::new(run, error);
    let mut environment = (environment.make())(task.max_steps).map_err(failed)?;
    let recording = record(&mut saved.greedy(1), &mut *environment, SCORE_SEED).map_err(failed)?;
    let size = [task.observation_size, task.num_actions];
    Ok(json!({
        "checkpoint": path.strip_prefix(run).unwrap_or(&path).to_string_lossy(),
        "env_steps": saved.header.as_ref().map(|header| header.env_steps),
        "steps_per_second": task.steps_per_second,
        // What each action and each coordinate of a state is called.
        "actions": task.actions,
        "coordinates": task.observations,
        // Null if the task has no plane for one.
        "map": task.map.as_ref().map(|axes| map(axes, size, &saved, &recording.frames)),
        "episode": episode(&recording, environment.ending()),
    }))
}

/// The checkpoint of the best policy, else the last.
fn checkpoint_of(run: &Path) -> Result<Option<PathBuf>, ReportError> {
    for name in [BEST, LAST] {
        let path = run.join(CHECKPOINTS).join(name);
        if path.try_exists().map_err(|error| ReportError::unreadable(&path, &error))? {
            return Ok(Some(path));
        }
    }
    Ok(None)
}

/// What the policy prefers over the plane of its task: rows from the smallest value of the second axis, in each the values
/// of the first axis from the smallest.
fn map(axes: &[MapAxis; 2], [size, actions]: [usize; 2], saved: &SavedPolicy, frames: &[Frame]) -> Value {
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
    let (best, gap): (Vec<usize>, Vec<f64>) = ranked.unzip();
    let axis = |MapAxis { name, unit, range, .. }: &MapAxis| json!({"name": name, "unit": unit, "low": range.0, "high": range.1});
    let along = |axis: &MapAxis, frame: &Frame| rounded(axis.read(&frame.observation));
    let trail = |axis: &MapAxis| frames.iter().map(|frame| along(axis, frame)).collect::<Vec<_>>();
    json!({
        "size": SIZE,
        "axes": axes.each_ref().map(axis),
        // The best action of every point, and how much more it is worth than the second best.
        "best": best,
        "gap": gap,
        // Where the episode was, along each axis.
        "trail": axes.each_ref().map(trail),
        // Null for a network.
        "table": saved.policy.table().map(|table| cells(table, axes, &observations)),
    })
}

/// The cells of a table in the plane: their edges along each axis, and how often the cell of every point was updated.
fn cells(table: &crate::agent::QTable, axes: &[MapAxis; 2], observations: &[Vec<f32>]) -> Value {
    let edges = |axis: &MapAxis| -> Vec<f64> {
        match axis.quantity {
            Quantity::Coordinate(i) => {
                let edges = table.edges()[i].iter().map(|&edge| f64::from(edge) * axis.factor);
                edges.filter(|edge| axis.range.0 < *edge && *edge < axis.range.1).collect()
            }
            // The edges of a cosine and a sine are not straight in the plane of the angle.
            Quantity::Angle { .. } => Vec::new(),
        }
    };
    let sum = |visits: &[u64]| visits.iter().fold(0, |sum: u64, &count| sum.saturating_add(count));
    let visits: Vec<u64> = observations.iter().map(|observation| sum(table.visits(observation))).collect();
    json!({"edges": axes.each_ref().map(edges), "visits": visits})
}

/// One episode of it; of every series one value per state, `actions` and `q_values` without the last.
fn episode(Recording { frames, total, terminated }: &Recording, ending: &str) -> Value {
    let coordinates = frames.first().map_or(0, |frame| frame.state.len());
    let coordinate = |i: usize| -> Vec<f64> { frames.iter().map(|frame| rounded(frame.state[i])).collect() };
    let scenes: Vec<_> = frames.iter().filter_map(|frame| frame.scene.clone()).collect();
    let values = |frame: &Frame| frame.q_values.iter().map(|&q| rounded(q.into())).collect::<Vec<_>>();
    let before_end = || frames.iter().filter(|frame| frame.action.is_some());
    json!({
        "seed": SCORE_SEED,
        "state": (0..coordinates).map(coordinate).collect::<Vec<_>>(),
        // The picture; empty if the environment has none.
        "shapes": motions(&scenes).iter().map(shape).collect::<Vec<_>>(),
        "actions": before_end().map(|frame| frame.action).collect::<Vec<_>>(),
        "q_values": before_end().map(values).collect::<Vec<_>>(),
        "total": rounded(*total),
        // How it terminated, in words; empty if it did not.
        "ending": if *terminated { ending } else { "" },
    })
}

/// A rigid shape of the picture, and where it is: `x` and `y` in pixels, `angle` in rad counterclockwise.
fn shape(Motion { shape, at, angle }: &Motion<'_>) -> Value {
    let (outline, size) = match &shape.outline {
        Outline::Polygon(points) => ("polygon", json!(points)),
        Outline::Circle(radius) => ("radius", json!(radius)),
        Outline::Line(points) => ("line", json!(points)),
    };
    let pixels = |value: f64| (value * 100.0).round() / 100.0;
    json!({
        "color": shape.color,
        outline: size,
        "x": series(at.iter().map(|at| pixels(at.0))),
        "y": series(at.iter().map(|at| pixels(at.1))),
        "angle": series(angle.iter().map(|&angle| rounded(angle))),
    })
}

/// All values, or one if they are the same.
fn series(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.collect();
    if values.iter().all(|value| *value == values[0]) {
        values.truncate(1);
    }
    values
}

fn rounded(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}
