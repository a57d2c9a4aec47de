//! Playing episodes without learning, and what their returns amount to.

use std::convert::Infallible;

use serde::Serialize;

use crate::agent::{Greedy, Policy, Probes};
use crate::env::{Environment, Step};
use crate::nn::Mlp;
use crate::rng::Rng;

/// Most episodes that are played at the same time.
const LOCKSTEP: u64 = 128;

/// Plays a network's greedy policy in `episodes` episodes from the seeds `first_seed`, `first_seed + 1`, … as
/// Gymnasium's `reset(seed=…)` starts them, and returns their undiscounted returns.
///
/// Episodes run in lockstep, as one batch, with the same bits as one by one ([`play`]).
pub fn evaluate<E: Environment>(
    network: &Mlp<f32>,
    environment: &E,
    first_seed: u64,
    episodes: u64,
) -> Vec<f64> {
    let played = evaluate_discounted(network, environment, first_seed, episodes, 1.0);
    played.into_iter().map(|episode| episode.total).collect()
}

/// An episode's return, the same discounted, and what the network expected of its start.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Played {
    /// Undiscounted return.
    pub total: f64,
    /// Σ γᵗ rₜ
    pub discounted: f64,
    /// max_a Q of the first observation.
    pub expected: f64,
}

/// As [`evaluate`], with what else can be said of the episodes.
pub fn evaluate_discounted<E: Environment>(
    network: &Mlp<f32>,
    environment: &E,
    first_seed: u64,
    episodes: u64,
    gamma: f64,
) -> Vec<Played> {
    let starts = (0..episodes).step_by(LOCKSTEP as usize);
    starts
        .flat_map(|start| {
            let first_seed = first_seed.wrapping_add(start);
            lockstep(network, environment, first_seed, LOCKSTEP.min(episodes - start), gamma)
        })
        .collect()
}

fn lockstep<E: Environment>(
    network: &Mlp<f32>,
    environment: &E,
    first_seed: u64,
    episodes: u64,
    gamma: f64,
) -> Vec<Played> {
    let mut played = vec![Played::default(); episodes as usize];
    // What is still being played: index, environment and latest observation.
    let mut playing: Vec<(usize, E, E::Observation)> = (0..episodes)
        .map(|episode| {
            let mut environment = environment.clone();
            let observation = environment.reset(&mut Rng::from_seed(first_seed.wrapping_add(episode)));
            (episode as usize, environment, observation)
        })
        .collect();
    let mut policy = Greedy::new(network.clone(), playing.len());
    let (mut discount, mut starts) = (1.0, true);
    while !playing.is_empty() {
        // Ended episodes stay in the batch. It is rebuilt when half of it has ended.
        if playing.len() <= policy.batch() / 2 {
            policy = Greedy::new(network.clone(), playing.len());
        }
        policy.see(playing.iter().map(|(_, _, observation)| observation.as_ref()));
        let mut place = 0;
        playing.retain_mut(|(episode, environment, observation)| {
            let action = policy.action(place);
            let step = environment.step(action);
            let played = &mut played[*episode];
            if starts {
                played.expected = policy.q_value(place, action);
            }
            place += 1;
            played.total += f64::from(step.reward);
            played.discounted += discount * f64::from(step.reward);
            *observation = step.observation.clone();
            !step.ended()
        });
        discount *= gamma;
        starts = false;
    }
    played
}

/// One step of an episode that is being played.
#[derive(Debug)]
pub struct TraceStep<'a, O> {
    /// Steps before this one.
    pub step: u64,
    /// The environment's state before the action.
    pub state: &'a [f64],
    /// The action.
    pub action: usize,
    /// The policy's Q-values for the observation before the action; empty if it has none.
    pub q_values: Vec<f32>,
    /// What the action brought.
    pub outcome: &'a Step<O>,
}

/// Plays one episode, shows every step to `watch`, and returns the undiscounted return.
///
/// # Errors
/// The first error of `watch`, which ends the episode.
pub fn play<E: Environment, X>(
    policy: &mut impl Policy,
    mut environment: E,
    seed: u64,
    mut watch: impl FnMut(TraceStep<'_, E::Observation>) -> Result<(), X>,
) -> Result<f64, X> {
    let mut observation = environment.reset(&mut Rng::from_seed(seed));
    let mut total = 0.0;
    for step in 0.. {
        let before = environment.clone();
        let action = policy.act(observation.as_ref());
        let outcome = environment.step(action);
        total += f64::from(outcome.reward);
        watch(TraceStep {
            step,
            state: before.state(),
            action,
            q_values: policy.q_values(),
            outcome: &outcome,
        })?;
        if outcome.ended() {
            break;
        }
        observation = outcome.observation;
    }
    Ok(total)
}

/// One moment of an episode.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// The environment's state.
    pub state: Vec<f64>,
    /// The action that was taken in it; none at the end.
    pub action: Option<usize>,
    /// The Q-values on which it was taken; empty at the end.
    pub q_values: Vec<f32>,
}

/// Plays one episode of a policy and keeps it. The state of the last frame is in f32.
pub fn record<E: Environment>(policy: &mut impl Policy, environment: E, seed: u64) -> Vec<Frame> {
    let mut frames = Vec::new();
    let mut last = Vec::new();
    let played = play(policy, environment, seed, |traced| {
        let TraceStep { state, action, q_values, outcome, .. } = traced;
        frames.push(Frame { state: state.to_vec(), action: Some(action), q_values });
        last = outcome.observation.as_ref().iter().map(|&value| f64::from(value)).collect();
        Ok::<_, Infallible>(())
    });
    match played {
        Ok(_) => frames.push(Frame { state: last, action: None, q_values: Vec::new() }),
        Err(never) => match never {},
    }
    frames
}

/// What a set of returns amounts to.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Score {
    /// Number of returns, at least 1.
    pub episodes: u64,
    /// Their mean.
    pub mean: f64,
    /// Their population standard deviation.
    pub std: f64,
    /// The smallest.
    pub min: f64,
    /// The middle one, or the mean of the two in the middle.
    pub median: f64,
    /// The largest.
    pub max: f64,
}

impl Score {
    /// The score of at least one return.
    pub fn new(returns: &[f64]) -> Self {
        let count = returns.len() as f64;
        let mean = returns.iter().sum::<f64>() / count;
        let variance = returns.iter().map(|value| (value - mean) * (value - mean)).sum::<f64>() / count;
        let mut sorted = returns.to_vec();
        sorted.sort_by(f64::total_cmp);
        let middle = sorted.len() / 2;
        let median =
            if sorted.len() % 2 == 1 { sorted[middle] } else { (sorted[middle - 1] + sorted[middle]) / 2.0 };
        Self {
            episodes: returns.len() as u64,
            mean,
            std: variance.sqrt(),
            min: sorted[0],
            median,
            max: sorted[sorted.len() - 1],
        }
    }

    /// Half the width of the 95 % interval of the mean over episodes, 1.96 standard errors; `None` for one
    /// episode.
    pub fn interval(&self) -> Option<f64> {
        let count = self.episodes as f64;
        (self.episodes > 1).then(|| 1.96 * self.std * (count / (count - 1.0)).sqrt() / count.sqrt())
    }

    /// Whether a task counts as solved: the mean of at least 100 episodes reaches its threshold.
    pub fn solves(&self, threshold: f64) -> bool {
        self.episodes >= 100 && self.mean >= threshold
    }
}

/// Gymnasium seed of the first episode that gives probes.
const PROBE_SEED: u64 = 3_000_000;
/// Number of probes of each kind.
const PROBES: usize = 128;

/// Probes from episodes of the random policy: every observation is an ordinary one, and the last before a termination
/// is doomed.
pub(super) fn probes<E: Environment>(environment: &E) -> Probes {
    let mut probes = Probes::default();
    for episode in 0..PROBES as u64 {
        let mut rng = Rng::from_seed(PROBE_SEED + episode);
        let mut environment = environment.clone();
        let mut observation = environment.reset(&mut rng);
        loop {
            if probes.ordinary.len() < PROBES {
                probes.ordinary.push(observation.as_ref().to_vec());
            }
            let step = environment.step(rng.below(E::NUM_ACTIONS as u64) as usize);
            if step.terminated {
                probes.doomed.push(observation.as_ref().to_vec());
            }
            if step.ended() {
                break;
            }
            observation = step.observation;
        }
    }
    probes
}
