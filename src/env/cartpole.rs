//! The cart and the pole: Barto, Sutton and Anderson (1983), "Neuronlike adaptive elements that can solve
//! difficult learning control problems", in the form of Gymnasium's `CartPole-v1`.

use std::sync::LazyLock;

use super::map::{MapAxis, Quantity};
use super::scene::{Bounds, Color, Outline, Scene, Shape};
use super::{Answer, Environment, Outcome, Spec, Start, TimeLimit, VectorEnvironment};
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
    #[inline(always)]
    fn integrate([x, x_dot, theta, theta_dot]: [f64; 4], force: f64) -> [f64; 4] {
        let (sin, cos) = sin_cos(theta);
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

    fn start(start: Start<'_>) -> [f64; 4] {
        start.draw(|rng| std::array::from_fn(|_| rng.uniform(-START_RANGE, START_RANGE)))
    }

    /// The state after a time step, and what it brought.
    #[inline(always)]
    fn after(state: [f64; 4], action: usize) -> ([f64; 4], Outcome) {
        debug_assert!(action < SPEC.num_actions);
        // Without a branch: no processor guesses a good policy's next action.
        let direction = f64::from(2 * i8::from(action == 1) - 1);
        let state = Self::integrate(state, direction * FORCE);
        let [x, _, theta, _] = state;
        let terminated = x.abs() > Self::MAX_POSITION || theta.abs() > Self::MAX_ANGLE;
        (state, Outcome { reward: 1.0, terminated, truncated: false })
    }
}

/// Many carts, side by side in memory: a processor works on several at once.
struct Carts {
    max_steps: u32,
    elapsed_steps: u32,
    states: Vec<[f64; 4]>,
}

impl VectorEnvironment for Carts {
    fn add(&mut self, start: Start<'_>, observation: &mut [f32]) -> Answer<()> {
        self.states.push(CartPole::start(start));
        observe(self.states[self.states.len() - 1], observation);
        Ok(())
    }

    fn step(
        &mut self, actions: &[usize], observations: &mut [f32], outcomes: &mut Vec<Outcome>,
    ) -> Answer<()> {
        self.elapsed_steps += 1;
        let truncated = self.elapsed_steps >= self.max_steps;
        let rows = self.states.iter_mut().zip(observations.chunks_exact_mut(4)).zip(actions);
        outcomes.clear();
        outcomes.extend(rows.map(|((state, observation), &action)| {
            let (after, outcome) = CartPole::after(*state, action);
            *state = after;
            observe(after, observation);
            Outcome { truncated, ..outcome }
        }));
        Ok(())
    }

    fn swap_remove(&mut self, place: usize) {
        self.states.swap_remove(place);
    }
}

/// What the agent sees of a state.
fn observe(state: [f64; 4], observation: &mut [f32]) {
    observation.copy_from_slice(&state.map(|coordinate| coordinate as f32));
}

/// The sine and the cosine of an angle in rad: the bits of `libm::sin` and `libm::cos`, in a third of their time. Up to π/4 they are two
/// polynomials (FreeBSD's `k_sin.c` and `k_cos.c`, Sun Microsystems 1993), and a pole that stands leans less.
#[inline(always)]
fn sin_cos(angle: f64) -> (f64, f64) {
    if angle.abs() > 0.785 {
        return (libm::sin(angle), libm::cos(angle));
    }
    const S: [f64; 6] = [
        -1.6666666666666632e-1,
        8.33333333332249e-3,
        -1.984126982985795e-4,
        2.7557313707070068e-6,
        -2.5050760253406863e-8,
        1.58969099521155e-10,
    ];
    const C: [f64; 6] = [
        4.16666666666666e-2,
        -1.388888888887411e-3,
        2.480158728947673e-5,
        -2.7557314351390663e-7,
        2.087572321298175e-9,
        -1.1359647557788195e-11,
    ];
    let (z, w) = (angle * angle, angle * angle * (angle * angle));
    let sin = angle + z * angle * (S[0] + z * (S[1] + z * (S[2] + z * S[3]) + z * w * (S[4] + z * S[5])));
    let cosine = z * (C[0] + z * (C[1] + z * C[2])) + w * w * (C[3] + z * (C[4] + z * C[5]));
    let (half, rest) = (0.5 * z, 1.0 - 0.5 * z);
    (sin, rest + (((1.0 - rest) - half) + z * cosine))
}

impl Environment for CartPole {
    fn spec(&self) -> &Spec {
        &SPEC
    }

    fn reset(&mut self, start: Start<'_>, observation: &mut [f32]) -> Answer<()> {
        self.state = Self::start(start);
        observe(self.state, observation);
        Ok(())
    }

    fn step(&mut self, action: usize, observation: &mut [f32]) -> Answer<Outcome> {
        let outcome;
        (self.state, outcome) = Self::after(self.state, action);
        observe(self.state, observation);
        Ok(outcome)
    }

    fn state(&self) -> Option<&[f64]> {
        Some(&self.state)
    }

    fn ending(&self) -> &'static str {
        if self.state[0].abs() > Self::MAX_POSITION { "left the track" } else { "fell" }
    }

    fn vector(&self, max_steps: u32) -> Option<Box<dyn VectorEnvironment>> {
        Some(Box::new(Carts { max_steps, elapsed_steps: 0, states: Vec::new() }))
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

#[cfg(test)]
mod tests {
    /// Over all angles at which a pole stands, and beyond.
    #[test]
    fn sine_and_cosine_have_the_bits_of_libm() {
        for i in 0..=2_000_000 {
            for angle in [f64::from(i) * 1e-6, f64::from(i).powi(7) * 1e-44] {
                let bits = |(sin, cos): (f64, f64)| (sin.to_bits(), cos.to_bits());
                assert_eq!(
                    bits(super::sin_cos(angle)),
                    bits((libm::sin(angle), libm::cos(angle))),
                    "{angle}"
                );
                assert_eq!(bits(super::sin_cos(-angle)).1, libm::cos(angle).to_bits(), "{angle}");
            }
        }
    }
}
