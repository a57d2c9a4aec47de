//! The environments that a config can name.

use serde::de::IntoDeserializer;
use serde::de::value::Error;
use serde::{Deserialize, Serialize};

use super::{Acrobot, CartPole, Environment, EnvironmentError, MountainCar, Spec, TimeLimit};

/// The name of an environment. A new one is a variant, its name, and a line in each function below.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum EnvironmentId {
    /// Gymnasium's CartPole-v1: [`CartPole`] under a [`TimeLimit`] of 500 steps.
    #[serde(rename = "CartPole-v1")]
    CartPoleV1,
    /// Gymnasium's Acrobot-v1: [`Acrobot`] under a [`TimeLimit`] of 500 steps.
    #[serde(rename = "Acrobot-v1")]
    AcrobotV1,
    /// Gymnasium's MountainCar-v0: [`MountainCar`] under a [`TimeLimit`] of 200 steps.
    #[serde(rename = "MountainCar-v0")]
    MountainCarV0,
}

impl EnvironmentId {
    pub const NAMES: &[&str] = &["CartPole-v1", "Acrobot-v1", "MountainCar-v0"];

    pub fn from_name(name: &str) -> Option<Self> {
        Self::deserialize(IntoDeserializer::<Error>::into_deserializer(name)).ok()
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

    /// The environment, whose episodes are truncated after `max_steps` steps.
    pub fn make(self, max_steps: u32) -> Result<Box<dyn Environment>, EnvironmentError> {
        match self {
            Self::CartPoleV1 => Ok(Box::new(TimeLimit::new(CartPole::default(), max_steps))),
            Self::AcrobotV1 => Ok(Box::new(TimeLimit::new(Acrobot::default(), max_steps))),
            Self::MountainCarV0 => Ok(Box::new(TimeLimit::new(MountainCar::default(), max_steps))),
        }
    }
}
