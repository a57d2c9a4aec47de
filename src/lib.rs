//! Deep Q-learning by hand, reproducible to the last bit; its tasks are Gymnasium's CartPole-v1, Acrobot-v1 and
//! MountainCar-v0.
//!
//! The rooms are below, each with what it holds. `rng` to `config` are the core; features of the crate add the rest.
//!
//! The direction: `rng, env, nn <- tensors <- agent <- trainer <- config <- run <- study <- report <- cli`. A room uses only
//! rooms before it. The agent knows no environment. The trainer prints nothing, and knows no path and no config.
//! `tests/it/arrows.rs` has the whole list.
//!
//! # Glossary
//! - *observation, next_observation*: s and s′, what the agent sees before and after an action.
//! - *terminated*: the task has ended, what follows is worth 0. *truncated*: cut off from outside, it is not.
//! - *return*: undiscounted sum of an episode's rewards.
//! - *online, target*: the network that learns, and the older copy that values the next observation.
//! - *td_target, td_error*: y = r + γ max Q_target(s′, ·), and Q(s, a) − y.
//! - *epsilon*: probability of a random action. *gamma*: discount factor.

// Without the command line parts of the rooms have no user.
#![cfg_attr(not(feature = "cli"), allow(dead_code, unused_imports))]

pub mod agent;
#[cfg(feature = "files")]
pub mod check;
#[cfg(feature = "cli")]
pub mod cli;
pub mod config;
#[cfg(feature = "draw")]
pub mod draw;
pub mod env;
#[cfg(feature = "files")]
pub mod explain;
#[cfg(feature = "files")]
pub mod files;
pub mod memory;
pub mod mirror;
pub mod nn;
pub(crate) mod os;
#[cfg(feature = "report")]
pub mod report;
pub mod rng;
#[cfg(feature = "files")]
pub mod run;
#[cfg(feature = "files")]
pub mod sink;
#[cfg(feature = "files")]
pub mod study;
pub mod tensors;
pub mod text;
pub mod trainer;
#[cfg(feature = "view")]
pub mod view;

/// The README's example, compiled and run by `cargo test`.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
