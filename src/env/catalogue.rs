//! The environments that a config can name.

use serde::de::IntoDeserializer;
use serde::{Deserialize, Serialize};

use super::{Acrobot, Answer, CartPole, Environment, MountainCar, Outcome, Spec, TimeLimit};

/// The name of an environment. A new one is a variant, its name, and a line in each function below.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum EnvironmentId {
    /// Under a time limit of 500 steps.
    #[serde(rename = "CartPole-v1")]
    CartPoleV1,
    /// Under a time limit of 500 steps.
    #[serde(rename = "Acrobot-v1")]
    AcrobotV1,
    /// Under a time limit of 200 steps.
    #[serde(rename = "MountainCar-v0")]
    MountainCarV0,
}

impl EnvironmentId {
    pub const NAMES: &[&str] = &["CartPole-v1", "Acrobot-v1", "MountainCar-v0"];

    pub fn from_name(name: &str) -> Option<Self> {
        Self::deserialize(IntoDeserializer::<serde::de::value::Error>::into_deserializer(name)).ok()
    }

    pub fn spec(self) -> Spec {
        match self {
            Self::CartPoleV1 => CartPole::default().spec().clone(),
            Self::AcrobotV1 => Acrobot::default().spec().clone(),
            Self::MountainCarV0 => MountainCar::default().spec().clone(),
        }
    }

    /// Mean return of the policy that takes every action with the same probability, over 5,000 episodes.
    pub fn random_return(self) -> f64 {
        match self {
            Self::CartPoleV1 => 22.2,
            Self::AcrobotV1 => -499.0,
            Self::MountainCarV0 => -200.0,
        }
    }

    /// One step from what an agent sees, without a time limit: what it sees then, in f64. None for a state that no agent sees.
    pub fn step_from(self, seen: &[f64], action: usize) -> Option<(Vec<f64>, Outcome)> {
        let mut observation = vec![0.0; seen.len()];
        let mut stepped = |mut environment: Box<dyn Environment>| {
            let outcome = environment.step(action, &mut observation).ok()?;
            Some((environment.state()?.to_vec(), outcome))
        };
        match self {
            Self::CartPoleV1 => stepped(Box::new(CartPole::at(seen.try_into().ok()?))),
            Self::MountainCarV0 => stepped(Box::new(MountainCar::at(seen.try_into().ok()?))),
            Self::AcrobotV1 => {
                let &[cos1, sin1, cos2, sin2, velocity1, velocity2] = seen else { return None };
                let angles = [libm::atan2(sin1, cos1), libm::atan2(sin2, cos2)];
                let state = [angles[0], angles[1], velocity1, velocity2];
                let (state, outcome) = stepped(Box::new(Acrobot::at(state)))?;
                let turned = |angle: f64| [libm::cos(angle), libm::sin(angle)];
                Some(([turned(state[0]), turned(state[1]), [state[2], state[3]]].concat(), outcome))
            }
        }
    }

    /// Whether an episode can start with this observation, but for rounding.
    pub(crate) fn can_start_with(self, seen: &[f64]) -> bool {
        let is_small = |values: &[f64], range: f64| values.iter().all(|value| value.abs() < range + 1e-6);
        match (self, seen) {
            (Self::CartPoleV1, _) => is_small(seen, 0.05),
            (Self::MountainCarV0, &[position, velocity]) => {
                (position + 0.5).abs() < 0.1 + 1e-6 && velocity == 0.0
            }
            (Self::AcrobotV1, &[cos1, sin1, cos2, sin2, velocity1, velocity2]) => {
                is_small(&[sin1, sin2, velocity1, velocity2], 0.1) && cos1 > 0.0 && cos2 > 0.0
            }
            _ => false,
        }
    }

    /// The environment, whose episodes are truncated after `max_steps` steps.
    pub fn make(self, max_steps: u32) -> Answer<Box<dyn Environment>> {
        match self {
            Self::CartPoleV1 => Ok(Box::new(TimeLimit::new(CartPole::default(), max_steps))),
            Self::AcrobotV1 => Ok(Box::new(TimeLimit::new(Acrobot::default(), max_steps))),
            Self::MountainCarV0 => Ok(Box::new(TimeLimit::new(MountainCar::default(), max_steps))),
        }
    }
}
