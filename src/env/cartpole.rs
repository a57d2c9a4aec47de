//! The cart and the pole: Barto, Sutton and Anderson (1983), "Neuronlike adaptive elements that can solve
//! difficult learning control problems", in the form of Gymnasium's `CartPole-v1`.

use serde::{Deserialize, Serialize};

use super::{Environment, Step, TimeLimit};
use crate::mirror::Mirror;
use crate::rng::Rng;

const GRAVITY: f64 = 9.8; // m/s²
const CART_MASS: f64 = 1.0; // kg
const POLE_MASS: f64 = 0.1; // kg
const TOTAL_MASS: f64 = CART_MASS + POLE_MASS;
const HALF_LENGTH: f64 = 0.5; // m, from the axle to the pole's centre of mass
const POLE_MASS_LENGTH: f64 = POLE_MASS * HALF_LENGTH;
const FORCE: f64 = 10.0; // N
const TIME_STEP: f64 = 0.02; // s
const START_RANGE: f64 = 0.05; // every coordinate starts uniformly in ± this

/// The physics without a time limit. Action 0 pushes the cart to the left, 1 to the right.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CartPole {
    /// Position x in m, velocity in m/s, pole angle θ in rad (0 upright, positive to the right), angular
    /// velocity in rad/s.
    state: [f64; 4],
}

impl CartPole {
    /// The distance of the cart from the middle, in m, beyond which an episode terminates.
    pub const MAX_POSITION: f64 = 2.4;
    /// The angle of the pole, in rad, beyond which an episode terminates.
    pub const MAX_ANGLE: f64 = 12.0 * 2.0 * std::f64::consts::PI / 360.0;
    /// The length of the pole, in m.
    pub const POLE_LENGTH: f64 = 2.0 * HALF_LENGTH;
    /// Steps after which an episode of CartPole-v1 is truncated.
    pub const MAX_STEPS: u32 = 500;
    /// Steps in a second of simulated time.
    pub const STEPS_PER_SECOND: u32 = 50;

    /// A cart at the given x, ẋ, θ, θ̇.
    pub fn at(state: [f64; 4]) -> Self {
        Self { state }
    }

    /// CartPole-v1: the physics under its limit of 500 steps.
    pub fn v1() -> TimeLimit<Self> {
        Self::limited(Self::MAX_STEPS)
    }

    /// CartPole-v1 under another time limit.
    pub fn limited(max_steps: u32) -> TimeLimit<Self> {
        TimeLimit::new(Self::default(), max_steps)
    }

    /// One explicit Euler step of the equations of motion (Florian 2007, eqs. 23 and 24, frictionless).
    fn integrate(&mut self, force: f64) {
        let [x, x_dot, theta, theta_dot] = self.state;
        let (sin, cos) = (libm::sin(theta), libm::cos(theta));
        let temp = (force + POLE_MASS_LENGTH * (theta_dot * theta_dot) * sin) / TOTAL_MASS;
        let theta_acc =
            (GRAVITY * sin - cos * temp) / (HALF_LENGTH * (4.0 / 3.0 - POLE_MASS * (cos * cos) / TOTAL_MASS));
        let x_acc = temp - POLE_MASS_LENGTH * theta_acc * cos / TOTAL_MASS;
        self.state = [
            x + TIME_STEP * x_dot,
            x_dot + TIME_STEP * x_acc,
            theta + TIME_STEP * theta_dot,
            theta_dot + TIME_STEP * theta_acc,
        ];
    }

    fn observation(&self) -> [f32; 4] {
        self.state.map(|coordinate| coordinate as f32)
    }
}

impl Environment for CartPole {
    type Observation = [f32; 4];

    const OBSERVATION_SIZE: usize = 4;
    const NUM_ACTIONS: usize = 2;
    const SOLVED_RETURN: f64 = 475.0;
    const MAX_RETURN: f64 = Self::MAX_STEPS as f64;

    /// Left and right exchanged: (−s, the other action) leads to −s′.
    fn mirror() -> Option<Mirror> {
        Some(Mirror { observation: (0..4).map(|i| (i, -1.0)).collect(), actions: vec![1, 0] })
    }

    fn reset(&mut self, rng: &mut Rng) -> [f32; 4] {
        self.state = std::array::from_fn(|_| rng.uniform(-START_RANGE, START_RANGE));
        self.observation()
    }

    fn step(&mut self, action: usize) -> Step<[f32; 4]> {
        debug_assert!(action < Self::NUM_ACTIONS);
        self.integrate(if action == 1 { FORCE } else { -FORCE });
        let [x, _, theta, _] = self.state;
        let terminated = x.abs() > Self::MAX_POSITION || theta.abs() > Self::MAX_ANGLE;
        Step { observation: self.observation(), reward: 1.0, terminated, truncated: false }
    }

    fn state(&self) -> &[f64] {
        &self.state
    }
}
