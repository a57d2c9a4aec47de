//! The cart and the pole: Barto, Sutton and Anderson (1983), "Neuronlike adaptive elements that can solve
//! difficult learning control problems", in the form of Gymnasium's `CartPole-v1`.

use std::sync::LazyLock;

use super::map::{MapAxis, Quantity};
use super::scene::{Bounds, Color, Outline, Scene, Shape};
use super::{Answer, Environment, Outcome, Spec, Start, TimeLimit};
use crate::mirror::Mirror;

const GRAVITY: f64 = 9.8; // m/s²
const CART_MASS: f64 = 1.0; // kg
const POLE_MASS: f64 = 0.1; // kg
const TOTAL_MASS: f64 = CART_MASS + POLE_MASS;
const HALF_LENGTH: f64 = 0.5; // m, from the axle to the pole's centre of mass
const POLE_MASS_LENGTH: f64 = POLE_MASS * HALF_LENGTH;
const FORCE: f64 = 10.0; // N
const TIME_STEP: f64 = 0.02; // s
const START_RANGE: f64 = 0.05; // every coordinate starts uniformly in ± this
const MAX_STEPS: u32 = 500;

/// Made once: an evaluation makes an environment for each of its episodes.
static SPEC: LazyLock<Spec> = LazyLock::new(|| Spec {
    id: "CartPole-v1".into(),
    observation_size: 4,
    num_actions: 2,
    max_steps: MAX_STEPS,
    solved_return: Some(475.0),
    return_range: (0.0, f64::from(MAX_STEPS)),
    steps_per_second: 50.0,
    actions: ["left", "right"].map(String::from).into(),
    observations: ["x", "ẋ", "θ", "θ̇"].map(String::from).into(),
    // Left and right exchanged: (−s, the other action) leads to −s′.
    mirror: Some(Mirror { observation: (0..4).map(|i| (i, -1.0)).collect(), actions: vec![1, 0] }),
    map: Some([(2, "pole angle", "°", CartPole::MAX_ANGLE), (3, "angular velocity", " °/s", 2.5)].map(
        |(coordinate, name, unit, limit)| MapAxis {
            name: name.into(),
            unit: unit.into(),
            range: (-limit.to_degrees(), limit.to_degrees()),
            factor: 1f64.to_degrees(),
            quantity: Quantity::Coordinate(coordinate),
        },
    )),
});

/// The physics without a time limit. Action 0 pushes the cart to the left, 1 to the right.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CartPole {
    /// Position x in m, velocity in m/s, pole angle θ in rad (0 upright, positive to the right), angular velocity in rad/s.
    state: [f64; 4],
}

impl CartPole {
    /// The distance of the cart from the middle, in m, beyond which an episode terminates.
    pub const MAX_POSITION: f64 = 2.4;
    /// The angle of the pole, in rad, beyond which an episode terminates.
    pub(crate) const MAX_ANGLE: f64 = 12.0 * 2.0 * std::f64::consts::PI / 360.0;

    /// A cart at the given x, ẋ, θ, θ̇.
    pub fn at(state: [f64; 4]) -> Self {
        Self { state }
    }

    /// CartPole-v1: the physics under its limit of 500 steps.
    pub fn v1() -> TimeLimit<Self> {
        TimeLimit::new(Self::default(), MAX_STEPS)
    }

    /// One explicit Euler step of the equations of motion (Florian 2007, eqs. 23 and 24, frictionless).
    fn integrate([x, x_dot, theta, theta_dot]: [f64; 4], force: f64) -> [f64; 4] {
        let (sin, cos) = (libm::sin(theta), libm::cos(theta));
        let temp = (force + POLE_MASS_LENGTH * (theta_dot * theta_dot) * sin) / TOTAL_MASS;
        let theta_acc =
            (GRAVITY * sin - cos * temp) / (HALF_LENGTH * (4.0 / 3.0 - POLE_MASS * (cos * cos) / TOTAL_MASS));
        let x_acc = temp - POLE_MASS_LENGTH * theta_acc * cos / TOTAL_MASS;
        [
            x + TIME_STEP * x_dot,
            x_dot + TIME_STEP * x_acc,
            theta + TIME_STEP * theta_dot,
            theta_dot + TIME_STEP * theta_acc,
        ]
    }

    /// Moves to a state and writes what the agent sees there.
    fn enter(&mut self, state: [f64; 4], observation: &mut [f32]) {
        self.state = state;
        observation.copy_from_slice(&state.map(|coordinate| coordinate as f32));
    }
}

impl Environment for CartPole {
    fn spec(&self) -> &Spec {
        &SPEC
    }

    fn reset(&mut self, start: Start<'_>, observation: &mut [f32]) -> Answer<()> {
        let state = start.draw(|rng| std::array::from_fn(|_| rng.uniform(-START_RANGE, START_RANGE)));
        self.enter(state, observation);
        Ok(())
    }

    fn step(&mut self, action: usize, observation: &mut [f32]) -> Answer<Outcome> {
        debug_assert!(action < SPEC.num_actions);
        let state = Self::integrate(self.state, if action == 1 { FORCE } else { -FORCE });
        self.enter(state, observation);
        let [x, _, theta, _] = state;
        let terminated = x.abs() > Self::MAX_POSITION || theta.abs() > Self::MAX_ANGLE;
        Ok(Outcome { reward: 1.0, terminated, truncated: false })
    }

    fn state(&self) -> Option<&[f64]> {
        Some(&self.state)
    }

    fn ending(&self) -> &'static str {
        if self.state[0].abs() > Self::MAX_POSITION { "left the track" } else { "fell" }
    }

    /// The picture of Gymnasium's `cartpole.py`, with its numbers. Gymnasium cuts the corners to whole pixels.
    fn scene(&self) -> Option<Scene> {
        const METRE: f64 = Scene::WIDTH as f64 / (2.0 * CartPole::MAX_POSITION);
        const CENTER: f64 = Scene::WIDTH as f64 / 2.0;
        const TRACK: f64 = 100.0;
        const CART: (f64, f64) = (50.0, 30.0);
        const AXLE: f64 = CART.1 / 4.0; // above the cart's middle
        const POLE_WIDTH: f64 = 10.0;
        let [x, _, theta, _] = self.state;
        let at = (CENTER + x * METRE, TRACK + AXLE);
        let rectangle = |width: f64, bottom, top| {
            Outline::rectangle(Bounds { left: -width / 2.0, right: width / 2.0, bottom, top })
        };
        let cart = rectangle(CART.0, -CART.1 / 2.0 - AXLE, CART.1 / 2.0 - AXLE);
        let pole = rectangle(POLE_WIDTH, -POLE_WIDTH / 2.0, METRE * 2.0 * HALF_LENGTH - POLE_WIDTH / 2.0);
        let axle = Outline::Circle(POLE_WIDTH / 2.0);
        let track = Outline::Line(vec![(-CENTER, 0.0), (CENTER, 0.0)]);
        Some(Scene {
            // The ends of the track, and the pole at its highest.
            focus: Bounds {
                left: -0.25 * METRE,
                right: 2.0 * CENTER + 0.25 * METRE,
                bottom: TRACK - 0.2 * METRE,
                top: TRACK + 1.1 * METRE,
            },
            shapes: vec![
                Shape { outline: cart, at, angle: 0.0, color: Color::Ink },
                Shape { outline: pole, at, angle: -theta, color: Color::Tan },
                Shape { outline: axle, at, angle: 0.0, color: Color::Lavender },
                Shape { outline: track, at: (CENTER, TRACK + 0.5), angle: 0.0, color: Color::Ink },
            ],
        })
    }
}
