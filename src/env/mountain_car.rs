//! A car in a valley, too weak to drive up the hill at once: Moore (1990), "Efficient memory-based learning for robot
//! control", in the form of Gymnasium's `MountainCar-v0`.

use std::sync::LazyLock;

use super::map::{MapAxis, Quantity};
use super::scene::{Bounds, Color, Outline, Scene, Shape};
use super::{Answer, Environment, Outcome, Spec, Start};

const MIN_POSITION: f64 = -1.2;
const MAX_POSITION: f64 = 0.6;
const GOAL: f64 = 0.5;
const MAX_VELOCITY: f64 = 0.07; // per step
const FORCE: f64 = 0.001;
const GRAVITY: f64 = 0.0025;
const MAX_STEPS: u32 = 200;

/// Made once: an evaluation makes an environment for each of its episodes.
static SPEC: LazyLock<Spec> = LazyLock::new(|| Spec {
    id: "MountainCar-v0".into(),
    observation_size: 2,
    num_actions: 3,
    max_steps: MAX_STEPS,
    solved_return: Some(-110.0),
    return_range: (-f64::from(MAX_STEPS), 0.0),
    steps_per_second: 30.0,
    actions: ["left", "coast", "right"].map(String::from).into(),
    observations: ["x", "v"].map(String::from).into(),
    // The goal is on one side, and the wall on the other is nearer to the bottom.
    mirror: None,
    map: Some(
        [(0, "position", (MIN_POSITION, MAX_POSITION)), (1, "velocity", (-MAX_VELOCITY, MAX_VELOCITY))].map(
            |(coordinate, name, range)| MapAxis {
                name: name.into(),
                unit: String::new(),
                range,
                factor: 1.0,
                quantity: Quantity::Coordinate(coordinate),
            },
        ),
    ),
});

/// The physics without a time limit. Actions 0, 1 and 2 push the car to the left, not at all, and to the right.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MountainCar {
    /// Position x, and velocity v in positions per step.
    state: [f64; 2],
}

impl MountainCar {
    /// A car at the given x, v.
    pub fn at(state: [f64; 2]) -> Self {
        Self { state }
    }

    /// Moves to a state and writes what the agent sees there.
    fn enter(&mut self, state: [f64; 2], observation: &mut [f32]) {
        self.state = state;
        observation.copy_from_slice(&state.map(|coordinate| coordinate as f32));
    }
}

/// The height of the hill at x, for pictures: the physics takes its slope to be cos 3x.
fn height(x: f64) -> f64 {
    libm::sin(3.0 * x) * 0.45 + 0.55
}

impl Environment for MountainCar {
    fn spec(&self) -> &Spec {
        &SPEC
    }

    fn reset(&mut self, start: Start<'_>, observation: &mut [f32]) -> Answer<()> {
        let position = start.draw(|rng| rng.uniform(-0.6, -0.4));
        self.enter([position, 0.0], observation);
        Ok(())
    }

    fn step(&mut self, action: usize, observation: &mut [f32]) -> Answer<Outcome> {
        debug_assert!(action < SPEC.num_actions);
        let [position, velocity] = self.state;
        let push = (action as f64 - 1.0) * FORCE;
        let velocity = velocity + (push + libm::cos(3.0 * position) * -GRAVITY);
        let velocity = velocity.clamp(-MAX_VELOCITY, MAX_VELOCITY);
        let position = (position + velocity).clamp(MIN_POSITION, MAX_POSITION);
        let hits_the_wall = position <= MIN_POSITION && velocity < 0.0;
        let velocity = if hits_the_wall { 0.0 } else { velocity };
        self.enter([position, velocity], observation);
        let terminated = position >= GOAL && velocity >= 0.0;
        Ok(Outcome { reward: -1.0, terminated, truncated: false })
    }

    fn state(&self) -> Option<&[f64]> {
        Some(&self.state)
    }

    fn ending(&self) -> &'static str {
        "reached the flag"
    }

    /// The picture of Gymnasium's `mountain_car.py`, with its numbers. Its coordinates are the middles of pixels.
    fn scene(&self) -> Option<Scene> {
        const SCALE: f64 = Scene::WIDTH as f64 / (MAX_POSITION - MIN_POSITION);
        const POINTS: u32 = 100;
        const CAR: (f64, f64) = (40.0, 20.0);
        const CLEARANCE: f64 = 10.0;
        let on_the_hill = |x: f64| ((x - MIN_POSITION) * SCALE + 0.5, height(x) * SCALE + 0.5);
        let point = |i| MIN_POSITION + (MAX_POSITION - MIN_POSITION) * f64::from(i) / f64::from(POINTS - 1);
        let hill = Outline::Line((0..POINTS).map(|i| on_the_hill(point(i))).collect());
        let [position, _] = self.state;
        let angle = libm::cos(3.0 * position);
        let (x, y) = on_the_hill(position);
        let at = (x, y + CLEARANCE);
        let car =
            Outline::rectangle(Bounds { left: -CAR.0 / 2.0, right: CAR.0 / 2.0, bottom: 0.0, top: CAR.1 });
        let wheel = |from_middle: f64| Shape {
            outline: Outline::Circle(CAR.1 / 2.5),
            at: (at.0 + from_middle * libm::cos(angle), at.1 + from_middle * libm::sin(angle)),
            angle: 0.0,
            color: Color::Grey,
        };
        let flag = on_the_hill(GOAL);
        let still = |outline, at, color| Shape { outline, at, angle: 0.0, color };
        Some(Scene {
            focus: Bounds { left: 0.0, right: f64::from(Scene::WIDTH), bottom: 20.0, top: 390.0 },
            shapes: vec![
                still(hill, (0.0, 0.0), Color::Ink),
                Shape { outline: car, at, angle, color: Color::Ink },
                wheel(CAR.0 / 4.0),
                wheel(-CAR.0 / 4.0),
                still(Outline::Line(vec![(0.0, 0.0), (0.0, 50.0)]), flag, Color::Ink),
                still(Outline::Polygon(vec![(0.0, 50.0), (0.0, 40.0), (25.0, 45.0)]), flag, Color::Yellow),
            ],
        })
    }
}
