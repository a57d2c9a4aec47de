//! Deep Q-learning on CartPole-v1, by hand and reproducible to the last bit.
//!
//! | module | what it holds |
//! | --- | --- |
//! | [`rng`] | one seed, one stream of random numbers per consumer |
//! | [`mirror`] | the mirror image of a task |
//! | [`env`](mod@env) | the cart and the pole, and the time limit |
//! | [`nn`] | network, backpropagation, losses, Adam, and their kernels |
//! | [`agent`] | DQN: acting, remembering, learning |
//! | [`trainer`] | the loop, its events, evaluation |
//! | [`config`] | the JSON files that decide a run |
//! | [`checkpoint`] | `.safetensors` files |
//! | [`sink`] | who takes the events: metrics file, progress bar |
//! | [`view`] | terminal views: an agent at play, a run that is training |
//! | [`study`] | many runs: every config with every seed |
//! | [`render`] | an episode as a GIF or an SVG |
//! | [`check`] | which known mistake another program's update has |
//! | [`explain`] | one update of our own training, with all its numbers |
//! | [`report`] | what a study or a run amounts to, from files alone |
//! | [`text`] | names, tables and sentences that fit a terminal |
//!
//! The arrows: `rng, env, nn <- agent <- trainer <- study <- report <- cli`.
//!
//! # Glossary
//! - *observation, next_observation*: s and s′, what the agent sees before and after an action.
//! - *terminated*: the task has ended, what follows is worth 0. *truncated*: cut off from outside, it is not.
//! - *return*: undiscounted sum of an episode's rewards.
//! - *online, target*: the network that learns, and the older copy that values the next observation.
//! - *td_target, td_error*: y = r + γ max Q_target(s′, ·), and Q(s, a) − y.
//! - *epsilon*: probability of a random action. *gamma*: discount factor.

pub mod agent;
pub mod check;
pub mod checkpoint;
pub mod cli;
pub mod config;
pub mod env;
pub mod explain;
pub mod files;
pub mod mirror;
pub mod nn;
pub mod render;
pub mod report;
pub mod rng;
pub mod sink;
pub mod study;
pub mod text;
pub mod trainer;
pub mod view;

/// The README's example, compiled and run by `cargo test`.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
