//! A debugger for other people's DQN: which known mistake reproduces the numbers of their update?
//!
//! | file | what it holds |
//! | --- | --- |
//! | `file.rs` | an [`Update`] from a `.safetensors` file |
//! | `batch.rs` | its rows against the physics of their task |
//! | `rounding.rs` | how far rounding may move a number |
//! | `pass.rs`, `activation.rs` | a network's passes in f64 |
//! | `variant.rs` | the ways of computing an update, right and with a mistake |
//! | `reference.rs` | Q-values, targets, loss, gradients and weights, the right way or with a mistake |
//! | `mistakes.rs` | everything that can be named |
//! | `fit.rs` | numbers that the settings say otherwise, and what differing numbers have in common |
//! | `verdict.rs` | the search for the mistakes that give somebody's numbers |
//! | `trace/` | a whole loop: what is wrong around the update |

mod activation;
mod batch;
mod file;
mod fit;
mod mistakes;
mod pass;
mod reference;
mod rounding;
pub mod trace;
mod variant;
mod verdict;

pub(crate) use batch::BatchVerdict;
pub use file::{Batch, Moments, OptimizerName, Results, Settings, Update};
pub(crate) use file::{EpsilonPlace, START};
pub use mistakes::{CHANGES, Found, MISTAKES, Mistake, Stage};
pub use reference::Reference;
pub use rounding::Number;
pub use variant::Variant;
pub(crate) use verdict::{Explained, Judged, check_with};
pub use verdict::{QuantityState, Verdict, check};
