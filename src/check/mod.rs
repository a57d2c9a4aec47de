//! A debugger for other people's DQN: which known mistake reproduces the numbers of their update?
//!
//! | file | what it holds |
//! | --- | --- |
//! | `file.rs` | an [`Update`] from a `.safetensors` file |
//! | `rounding.rs` | a network's passes in f64, and how far rounding may move each number |
//! | `reference.rs` | targets, loss, gradients and weights, the right way or with a mistake |
//! | `catalogue.rs` | the known mistakes |
//! | `verdict.rs` | the search for the mistakes that give somebody's numbers |
//! | `trace/` | a whole loop: what is wrong around the update |

mod catalogue;
mod file;
mod reference;
mod rounding;
pub mod trace;
mod verdict;

pub use catalogue::{CATALOGUE, Stage};
pub use file::{Batch, Moments, Results, Settings, Update};
pub(crate) use file::{EpsilonPlace, START};
pub use reference::{Reference, Variant};
pub use rounding::Number;
pub(crate) use verdict::{Explained, Judged, check_with};
pub use verdict::{QuantityState, Verdict, check};
