//! The plane in which a page shows what a policy prefers.

use serde::{Deserialize, Serialize};

/// One axis of the plane. Values along it are `factor` times the quantity that an observation holds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MapAxis {
    pub name: String,
    /// Its unit, as it is written behind a number; empty if it has none.
    pub(crate) unit: String,
    /// The smallest and the largest value that are shown.
    pub range: (f64, f64),
    /// What the quantity is multiplied by to be shown, for example 180/π.
    pub(crate) factor: f64,
    pub(crate) quantity: Quantity,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Quantity {
    Coordinate(usize),
    /// An angle, of which two coordinates are the cosine and the sine.
    Angle {
        cos: usize,
        sin: usize,
    },
}

impl MapAxis {
    /// Whether this can be an axis for observations of so many numbers.
    pub(super) fn fits(&self, observation_size: usize) -> bool {
        let (low, high) = self.range;
        let is_there = match self.quantity {
            Quantity::Coordinate(i) => i < observation_size,
            Quantity::Angle { cos, sin } => cos.max(sin) < observation_size,
        };
        is_there && low < high && (high - low).is_finite() && self.factor.is_normal()
    }

    /// Puts a value of the axis into an observation.
    pub fn write(&self, value: f64, observation: &mut [f32]) {
        let value = value / self.factor;
        match self.quantity {
            Quantity::Coordinate(i) => observation[i] = value as f32,
            Quantity::Angle { cos, sin } => {
                (observation[cos], observation[sin]) = (libm::cos(value) as f32, libm::sin(value) as f32);
            }
        }
    }

    /// Where an observation lies along the axis.
    pub fn read(&self, observation: &[f32]) -> f64 {
        let coordinate = |i: usize| f64::from(observation[i]);
        self.factor
            * match self.quantity {
                Quantity::Coordinate(i) => coordinate(i),
                Quantity::Angle { cos, sin } => libm::atan2(coordinate(sin), coordinate(cos)),
            }
    }
}
