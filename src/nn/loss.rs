//! Losses of the TD error, averaged over the batch.

use super::kernels::Float;

/// The loss of a TD error δ = Q(s, a) − y.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Loss {
    /// δ²
    Mse,
    /// ½ δ² where |δ| < 1, else |δ| − ½ (Huber 1964; PyTorch's `smooth_l1_loss`).
    Huber,
}

impl Loss {
    pub(crate) fn value<T: Float>(self, td_error: T) -> T {
        let half = T::from_f64(0.5);
        match self {
            Self::Mse => td_error * td_error,
            Self::Huber if td_error.abs() < T::ONE => half * td_error * td_error,
            Self::Huber => td_error.abs() - half,
        }
    }

    pub(crate) fn derivative<T: Float>(self, td_error: T) -> T {
        match self {
            Self::Mse => td_error + td_error,
            Self::Huber => td_error.clamp(-T::ONE, T::ONE),
        }
    }
}
