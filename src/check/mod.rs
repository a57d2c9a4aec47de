//! A debugger for other people's DQN: which known mistake reproduces the numbers of their update?
//!
//! | file | what it holds |
//! | --- | --- |
//! | `file.rs` | an [`Update`] from a `.safetensors` file |
//! | `rounding.rs` | a network's passes in f64, and how far rounding may move each number |
//! | `reference.rs` | targets, loss, gradients and weights, the right way or with a mistake |
//! | `catalogue.rs` | the known mistakes |
//! | `verdict.rs` | the search for the mistakes that give somebody's numbers |

mod catalogue;
mod file;
mod reference;
mod rounding;
mod verdict;

pub use catalogue::{CATALOGUE, Mistake, Stage};
pub use file::{Batch, EpsilonPlace, Moments, Problem, Results, START, Settings, Update, UpdateError};
pub use reference::{
    Clipping, Decay, LossOf, Mask, NextValue, Optimizer, Penalty, Predicted, Reached, Reduction, Reference,
    Reward, Targets, Variant,
};
pub use rounding::Number;
pub use verdict::{Explained, Judged, QuantityState, Verdict, check, check_with};
