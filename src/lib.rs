//! Deep Q-learning by hand, reproducible to the last bit; its tasks are Gymnasium's CartPole-v1, Acrobot-v1 and
//! MountainCar-v0.
//!
//! | module | what it holds |
//! | --- | --- |
//! | `os` | what differs between Linux, macOS and Windows |
//! | [`rng`] | one seed, one stream of random numbers per consumer |
//! | [`mirror`], [`memory`] | the mirror image of a task; whether there is enough memory |
//! | [`text`] | how a foreign name is shown; tables and sentences that fit a terminal |
//! | [`env`](mod@env) | environments: CartPole, Acrobot and MountainCar, the time limit, and which names a config knows |
//! | [`nn`] | network, backpropagation, losses, Adam, and their kernels |
//! | [`tensors`] | named tensors as safetensors bytes |
//! | [`agent`] | agents, of which DQN is one, and the policies that they make |
//! | [`trainer`] | the loop, its events, who observes it, evaluation |
//! | [`config`] | the JSON files that decide a run |
//!
//! That is the core. Features of the crate add the rest:
//!
//! | module | what it holds |
//! | --- | --- |
//! | `files` | files that are whole or not there |
//! | `check`, `explain` | which known mistake another program's update has; one update of our own, with all its numbers |
//! | `sink` | observers of a run: metrics, progress, TensorBoard |
//! | `run` | the directory of a run: names, lock, checkpoints, resuming, verifying |
//! | `study` | many runs: every config with every seed |
//! | `draw`, `view` | a scene as a GIF, an SVG or in the terminal; views in a terminal |
//! | `report` | what a study or a run amounts to, from files alone |
//! | `cli` | one file per command |
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
