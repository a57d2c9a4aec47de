//! A dense network, its gradient and its optimiser, by hand.
//!
//! **Layout.** Matrices are nalgebra's, column-major. A batch of activations is (batch, features): the values of one feature
//! lie next to each other over the batch, so that vector lanes run over the batch. A layer is its weight, (in, out) with the
//! outputs next to each other, and behind it its bias, the weight of an input that is always 1; so the gradients of both are
//! one product, and one observation's lanes run over the outputs. A checkpoint holds the transposed weight, [out, in], as
//! `torch.nn.Linear` has it. All parameters of a network are one flat allocation, layer by layer; Adam is one loop over it.
//!
//! **Order of sums.** See [`kernels`].

mod adam;
mod init;
pub mod kernels;
mod loss;
mod mlp;
mod optimizer;

pub use adam::Adam;
pub(crate) use init::Init;
pub(crate) use kernels::Float;
pub use kernels::Kernels;
pub use loss::Loss;
pub use mlp::{Activations, Mlp};
pub use optimizer::OptimizerConfig;
pub(crate) use optimizer::{LearningRate, LearningRateSchedule, clip_norm, norm};

/// The shape and the start of the Q-network. Configs that earlier versions recorded have one more key.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct NetworkConfig {
    pub hidden: Vec<usize>,
    pub(crate) init: Init,
}

impl NetworkConfig {
    /// All layer sizes, from the observation to the Q-values.
    pub fn sizes(&self, observation_size: usize, num_actions: usize) -> Vec<usize> {
        [&[observation_size], self.hidden.as_slice(), &[num_actions]].concat()
    }
}
