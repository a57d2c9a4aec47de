//! Initial weights, drawn in the order in which the parameters lie in memory.

/// How the weights start. `in` and `out` are a layer's sizes; U(a) is uniform in ± a.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Init {
    /// Weights U(√(6 / (in + out))), biases 0: Keras' default (Glorot and Bengio 2010, eq. 16).
    GlorotUniform,
    /// Weights U(√(6 / in)), biases 0 (He et al. 2015, eq. 10).
    HeUniform,
    /// Weights and biases U(1 / √in): PyTorch's default for `nn.Linear`.
    Torch,
}

impl Init {
    /// Fills one layer: `weight` is (in, out), `bias` is (out).
    pub(super) fn fill(self, weight: &mut [f32], bias: &mut [f32], rng: &mut crate::rng::Rng) {
        let outputs = bias.len();
        let inputs = weight.len() / outputs;
        let limit = match self {
            Self::GlorotUniform => (6.0 / (inputs + outputs) as f64).sqrt(),
            Self::HeUniform => (6.0 / inputs as f64).sqrt(),
            Self::Torch => 1.0 / (inputs as f64).sqrt(),
        };
        weight.fill_with(|| rng.uniform(-limit, limit) as f32);
        match self {
            Self::Torch => bias.fill_with(|| rng.uniform(-limit, limit) as f32),
            Self::GlorotUniform | Self::HeUniform => bias.fill(0.0),
        }
    }
}
