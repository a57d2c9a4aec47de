//! Two links that hang from a fixed point, with a motor in the joint between them: Sutton (1996), "Generalization in
//! reinforcement learning: successful examples using sparse coarse coding", with the equations of motion of Sutton and
//! Barto's book, in the form of Gymnasium's `Acrobot-v1`.

use std::f64::consts::{FRAC_PI_2, PI};
use std::sync::LazyLock;

use super::map::{MapAxis, Quantity};
use super::scene::{Bounds, Color, Outline, Scene, Shape};
use super::{Answer, Environment, Outcome, Spec, Start};

const GRAVITY: f64 = 9.8; // m/s²
const MASS: f64 = 1.0; // kg, of each link
const LENGTH: f64 = 1.0; // m, of each link
const CENTER: f64 = 0.5; // m, from a link's upper end to its centre of mass
const INERTIA: f64 = 1.0; // kg·m², of each link
const TIME_STEP: f64 = 0.2; // s
const MAX_VELOCITIES: [f64; 2] = [4.0 * PI, 9.0 * PI]; // rad/s
const START_RANGE: f64 = 0.1; // every coordinate starts uniformly in ± this
const MAX_STEPS: u32 = 500;

/// Made once: an evaluation makes an environment for each of its episodes.
static SPEC: LazyLock<Spec> = LazyLock::new(|| Spec {
    id: "Acrobot-v1".into(),
    observation_size: 6,
    num_actions: 3,
    max_steps: MAX_STEPS,
    solved_return: Some(-100.0),
    return_range: (-f64::from(MAX_STEPS), 0.0),
    steps_per_second: 15.0,
    actions: ["torque −1", "torque 0", "torque +1"].map(String::from).into(),
    observations: ["cos θ₁", "sin θ₁", "cos θ₂", "sin θ₂", "θ̇₁", "θ̇₂"].map(String::from).into(),
    // Left and right exchanged: every angle and velocity changes its sign, and so does the torque.
    mirror: Some(crate::mirror::Mirror {
        observation: [1.0, -1.0, 1.0, -1.0, -1.0, -1.0].into_iter().enumerate().collect(),
        actions: vec![2, 1, 0],
    }),
    map: Some([(0, "angle of the upper link"), (2, "angle of the lower link")].map(|(cos, name)| MapAxis {
        name: name.into(),
        unit: "°".into(),
        range: (-180.0, 180.0),
        factor: 1f64.to_degrees(),
        quantity: Quantity::Angle { cos, sin: cos + 1 },
    })),
});

/// The physics without a time limit. Actions 0, 1 and 2 apply a torque of −1, 0 and 1 N·m between the links.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Acrobot {
    /// Angle of the upper link θ₁ in rad (0 hanging down), angle of the lower link against the upper one θ₂ in rad, and
    /// their velocities in rad/s.
    state: [f64; 4],
}

impl Acrobot {
    /// Two links at the given θ₁, θ₂, θ̇₁, θ̇₂.
    pub fn at(state: [f64; 4]) -> Self {
        Self { state }
    }

    /// The time derivative of a state under a torque. Every sum is in Gymnasium's order, for the same bits.
    fn derivative([theta1, theta2, theta1_dot, theta2_dot]: [f64; 4], torque: f64) -> [f64; 4] {
        let (sin2, cos2) = (libm::sin(theta2), libm::cos(theta2));
        let d1 = MASS * (CENTER * CENTER)
            + MASS * (LENGTH * LENGTH + CENTER * CENTER + 2.0 * LENGTH * CENTER * cos2)
            + INERTIA
            + INERTIA;
        let d2 = MASS * (CENTER * CENTER + LENGTH * CENTER * cos2) + INERTIA;
        let phi2 = MASS * CENTER * GRAVITY * libm::cos(theta1 + theta2 - FRAC_PI_2);
        let phi1 = -MASS * LENGTH * CENTER * (theta2_dot * theta2_dot) * sin2
            - 2.0 * MASS * LENGTH * CENTER * theta2_dot * theta1_dot * sin2
            + (MASS * CENTER + MASS * LENGTH) * GRAVITY * libm::cos(theta1 - FRAC_PI_2)
            + phi2;
        let theta2_acc =
            (torque + d2 / d1 * phi1 - MASS * LENGTH * CENTER * (theta1_dot * theta1_dot) * sin2 - phi2)
                / (MASS * (CENTER * CENTER) + INERTIA - d2 * d2 / d1);
        let theta1_acc = -(d2 * theta2_acc + phi1) / d1;
        [theta1_dot, theta2_dot, theta1_acc, theta2_acc]
    }

    /// One step of the classic Runge-Kutta method of fourth order.
    fn integrate(state: [f64; 4], torque: f64) -> [f64; 4] {
        let moved = |step: f64, slope: [f64; 4]| std::array::from_fn(|i| state[i] + step * slope[i]);
        let half = TIME_STEP / 2.0;
        let k1 = Self::derivative(state, torque);
        let k2 = Self::derivative(moved(half, k1), torque);
        let k3 = Self::derivative(moved(half, k2), torque);
        let k4 = Self::derivative(moved(TIME_STEP, k3), torque);
        moved(TIME_STEP / 6.0, std::array::from_fn(|i| k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]))
    }

    /// Moves to a state and writes what the agent sees there.
    fn enter(&mut self, state: [f64; 4], observation: &mut [f32]) {
        self.state = state;
        let [theta1, theta2, theta1_dot, theta2_dot] = state;
        let turned = |theta| [libm::cos(theta), libm::sin(theta)];
        let ([cos1, sin1], [cos2, sin2]) = (turned(theta1), turned(theta2));
        observation
            .copy_from_slice(&[cos1, sin1, cos2, sin2, theta1_dot, theta2_dot].map(|value| value as f32));
    }
}

/// The same angle within ±π.
fn wrapped(mut angle: f64) -> f64 {
    while angle > PI {
        angle -= 2.0 * PI;
    }
    while angle < -PI {
        angle += 2.0 * PI;
    }
    angle
}

impl Environment for Acrobot {
    fn spec(&self) -> &Spec {
        &SPEC
    }

    fn reset(&mut self, start: Start<'_>, observation: &mut [f32]) -> Answer<()> {
        // Gymnasium starts from numbers of 32 bits.
        let state = start
            .draw(|rng| std::array::from_fn(|_| f64::from(rng.uniform(-START_RANGE, START_RANGE) as f32)));
        self.enter(state, observation);
        Ok(())
    }

    fn step(&mut self, action: usize, observation: &mut [f32]) -> Answer<Outcome> {
        debug_assert!(action < SPEC.num_actions);
        let [theta1, theta2, theta1_dot, theta2_dot] = Self::integrate(self.state, action as f64 - 1.0);
        let (theta1, theta2) = (wrapped(theta1), wrapped(theta2));
        let [max1, max2] = MAX_VELOCITIES;
        self.enter(
            [theta1, theta2, theta1_dot.clamp(-max1, max1), theta2_dot.clamp(-max2, max2)],
            observation,
        );
        let terminated = -libm::cos(theta1) - libm::cos(theta2 + theta1) > LENGTH;
        Ok(Outcome { reward: if terminated { 0.0 } else { -1.0 }, terminated, truncated: false })
    }

    fn state(&self) -> Option<&[f64]> {
        Some(&self.state)
    }

    fn ending(&self) -> &'static str {
        "reached the line"
    }

    /// The picture of Gymnasium's `acrobot.py`, which is a square, in the middle and as high as the picture.
    fn scene(&self) -> Option<Scene> {
        const METRE: f64 = Scene::HEIGHT as f64 / (2.0 * REACH);
        const REACH: f64 = 2.0 * LENGTH + 0.2;
        const HALF: f64 = 0.1 * METRE; // of the width of a link
        let [theta1, theta2, ..] = self.state;
        let (x, y) = (f64::from(Scene::WIDTH) / 2.0, f64::from(Scene::HEIGHT) / 2.0);
        let joint = (x + METRE * LENGTH * libm::sin(theta1), y - METRE * LENGTH * libm::cos(theta1));
        let link =
            || Outline::rectangle(Bounds { left: 0.0, right: METRE * LENGTH, bottom: -HALF, top: HALF });
        let line = Outline::Line(vec![(-REACH * METRE, 0.0), (REACH * METRE, 0.0)]);
        let shape = |outline, at, angle, color| Shape { outline, at, angle, color };
        let (upper, lower) = (theta1 - FRAC_PI_2, theta1 + theta2 - FRAC_PI_2);
        Some(Scene {
            focus: Bounds {
                left: x - REACH * METRE,
                right: x + REACH * METRE,
                bottom: y - REACH * METRE,
                top: y + REACH * METRE,
            },
            shapes: vec![
                shape(line, (x, y + METRE * LENGTH), 0.0, Color::Ink),
                shape(link(), (x, y), upper, Color::Cyan),
                shape(Outline::Circle(HALF), (x, y), 0.0, Color::Yellow),
                shape(link(), joint, lower, Color::Cyan),
                shape(Outline::Circle(HALF), joint, 0.0, Color::Yellow),
            ],
        })
    }
}
