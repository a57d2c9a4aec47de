//! Playing episodes without learning, and what their returns amount to.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::thread;

use serde::Serialize;

use super::EVALUATION_SEED;
use crate::agent::{Actor, Played, Policy, Probes};
use crate::env::scene::Scene;
use crate::env::{Environment, EnvironmentError, Image, Make, Outcome, Start};
use crate::rng::{Rng, Stream};

/// Most episodes that are played at the same time.
const LOCKSTEP: u64 = 128;
/// From how many starts a policy has to last, see [`lasts`].
pub const LASTING_EPISODES: u64 = 100;
/// The probability of a random action in every second of them.
pub const LASTING_EPSILON: f64 = 0.05;

/// Plays a policy greedily in `episodes` episodes from the seeds `first_seed`, `first_seed + 1`, … as Gymnasium's
/// `reset(seed=…)` starts them, each truncated after `max_steps` steps. Returns are those of the first steps, as many as the
/// environment's own limit allows. `gamma` is the discount of [`Played::discounted`].
///
/// Episodes run in lockstep, as one batch, with the same bits as one by one ([`play`]). Those of another program run one by one
/// in each of its processes.
///
/// # Errors
/// When the environment fails.
pub fn evaluate(
    policy: &Policy,
    make: &Make,
    max_steps: u32,
    first_seed: u64,
    episodes: u64,
    gamma: f64,
) -> Result<Vec<Played>, EnvironmentError> {
    let processes = make(max_steps)?.processes();
    if let Some(processes) = processes {
        return in_processes(processes, episodes, Play::Greedily, |episode| {
            let seed = std::iter::once(first_seed.wrapping_add(episode));
            Ok(lockstep(policy, make, max_steps, seed, gamma, Play::Greedily)?.remove(0))
        });
    }
    let mut played = Vec::new();
    for start in (0..episodes).step_by(LOCKSTEP as usize) {
        let seeds = (start..episodes.min(start + LOCKSTEP)).map(|episode| first_seed.wrapping_add(episode));
        played.extend(lockstep(policy, make, max_steps, seeds, gamma, Play::Greedily)?);
    }
    Ok(played)
}

/// Whether a policy, played from [`LASTING_EPISODES`] starts, lasts `steps` steps from each: no episode terminates, and none is cut
/// off before by the environment itself.
///
/// From every second start an action is random with probability [`LASTING_EPSILON`]: such an episode sees states that the policy by
/// itself reaches from one start in a hundred. The others show whether it drifts when it is left alone. The starts are those of
/// the evaluations and of the seeds after them. The random actions of an episode come from [`Stream::Explore`] of its seed.
///
/// # Errors
/// When the environment fails.
pub fn lasts(policy: &Policy, make: &Make, steps: u32) -> Result<bool, EnvironmentError> {
    let test = |seeds| lockstep(policy, make, steps, seeds, 1.0, Play::AsTest);
    let seeds = EVALUATION_SEED..EVALUATION_SEED + LASTING_EPISODES;
    let played = match make(steps)?.processes() {
        Some(processes) => in_processes(processes, LASTING_EPISODES, Play::AsTest, |episode| {
            let seed = EVALUATION_SEED + episode;
            Ok(test(seed..seed + 1)?.remove(0))
        })?,
        None => test(seeds)?,
    };
    Ok(played.iter().all(|episode| !episode.terminated && episode.steps >= u64::from(steps)))
}

/// How episodes are played.
#[derive(Clone, Copy, PartialEq)]
enum Play {
    Greedily,
    /// See [`lasts`]. Episodes after the first termination may be missing, or stop where they are.
    AsTest,
}

impl Play {
    fn ends_with(self, episode: &Played) -> bool {
        self == Self::AsTest && episode.terminated
    }
}

/// Plays so many episodes, each with `play`, up to `processes` at the same time. Who plays which one changes nothing.
fn in_processes(
    processes: usize,
    episodes: u64,
    how: Play,
    play: impl Fn(u64) -> Result<Played, EnvironmentError> + Sync,
) -> Result<Vec<Played>, EnvironmentError> {
    let next = AtomicU64::new(0);
    let ended = Mutex::new(BTreeMap::new());
    let play_on = || {
        loop {
            let episode = next.fetch_add(1, Ordering::Relaxed);
            if episode >= episodes {
                break;
            }
            let played = play(episode);
            if played.as_ref().map_or(true, |played| how.ends_with(played)) {
                next.store(episodes, Ordering::Relaxed);
            }
            ended.lock().unwrap_or_else(PoisonError::into_inner).insert(episode, played);
        }
    };
    thread::scope(|scope| {
        (1..processes.min(episodes as usize)).for_each(|_| drop(scope.spawn(play_on)));
        play_on();
    });
    // Up to the first one that ends the test or fails: which others were played is chance.
    let mut all = Vec::new();
    for episode in ended.into_inner().unwrap_or_else(PoisonError::into_inner).into_values() {
        let episode = episode?;
        let is_last = how.ends_with(&episode);
        all.push(episode);
        if is_last {
            break;
        }
    }
    Ok(all)
}

/// An episode that is being played.
struct Playing {
    index: usize,
    environment: Box<dyn Environment>,
    observation: Vec<f32>,
    /// Of the random actions in a test.
    rng: Option<Rng>,
}

fn lockstep(
    policy: &Policy,
    make: &Make,
    max_steps: u32,
    seeds: impl Iterator<Item = u64>,
    gamma: f64,
    play: Play,
) -> Result<Vec<Played>, EnvironmentError> {
    let mut playing = Vec::new();
    for (index, seed) in seeds.enumerate() {
        let mut environment = make(max_steps)?;
        let mut observation = vec![0.0; environment.spec().observation_size];
        environment.reset(Start::Seed(seed), &mut observation)?;
        let is_disturbed = play == Play::AsTest && seed % 2 == 1;
        let rng = is_disturbed.then(|| Rng::spawn(seed, Stream::Explore));
        playing.push(Playing { index, environment, observation, rng });
    }
    let mut played = vec![Played::default(); playing.len()];
    let mut greedy = policy.greedy(playing.len());
    let scored_steps = playing.first().map_or(0, |first| u64::from(first.environment.spec().max_steps));
    let num_actions = playing.first().map_or(1, |first| first.environment.spec().num_actions as u64);
    let mut discount = 1.0;
    let mut failed = None;
    while !playing.is_empty() {
        // Ended episodes stay in the batch. It is rebuilt when half of it has ended.
        if playing.len() <= greedy.batch() / 2 {
            greedy = policy.greedy(playing.len());
        }
        greedy.forward_batch(playing.iter().map(|episode| &episode.observation[..]));
        let mut place = 0;
        playing.retain_mut(|Playing { index, environment, observation, rng }| {
            let disturbing = rng.as_mut().and_then(|rng| (rng.unit() <= LASTING_EPSILON).then_some(rng));
            let random = disturbing.map(|rng| rng.below(num_actions) as usize);
            let action = random.unwrap_or_else(|| greedy.action(place));
            let played = &mut played[*index];
            if played.steps == 0 {
                played.expected = greedy.q_value(place, action);
            }
            place += 1;
            let outcome = match environment.step(action, observation) {
                Ok(outcome) => outcome,
                Err(error) => {
                    failed = Some(error);
                    return false;
                }
            };
            if played.steps < scored_steps {
                played.total += outcome.reward;
            }
            played.discounted += discount * outcome.reward;
            played.steps += 1;
            played.terminated = outcome.terminated;
            !outcome.ended()
        });
        if let Some(error) = failed {
            return Err(error);
        }
        if played.iter().any(|episode| play.ends_with(episode)) {
            break;
        }
        discount *= gamma;
    }
    Ok(played)
}

/// One step of an episode that is being played.
#[derive(Debug)]
pub struct TraceStep<'a> {
    /// Steps before this one.
    pub step: u64,
    /// What the environment shows before the action: its state, or else the observation.
    pub state: &'a [f64],
    /// The action.
    pub action: usize,
    /// The policy's Q-values for the observation before the action; empty if it has none.
    pub q_values: Vec<f32>,
    /// What the action brought.
    pub outcome: Outcome,
}

/// The environment's state, or the observation of one that shows none.
fn state_of(environment: &dyn Environment, observation: &[f32]) -> Vec<f64> {
    let shown = || observation.iter().map(|&value| f64::from(value)).collect();
    environment.state().map_or_else(shown, <[f64]>::to_vec)
}

/// Plays one episode, shows every step to `watch`, and returns the undiscounted return.
///
/// # Errors
/// The first error of the environment or of `watch`, which ends the episode.
pub fn play<X: From<EnvironmentError>>(
    actor: &mut impl Actor,
    environment: &mut dyn Environment,
    seed: u64,
    mut watch: impl FnMut(TraceStep<'_>) -> Result<(), X>,
) -> Result<f64, X> {
    let mut observation = vec![0.0; environment.spec().observation_size];
    environment.reset(Start::Seed(seed), &mut observation)?;
    let mut total = 0.0;
    for step in 0.. {
        let state = state_of(environment, &observation);
        let action = actor.act(&observation);
        let q_values = actor.q_values();
        let outcome = environment.step(action, &mut observation)?;
        total += outcome.reward;
        watch(TraceStep { step, state: &state, action, q_values, outcome })?;
        if outcome.ended() {
            break;
        }
    }
    Ok(total)
}

/// An episode that has been kept.
#[derive(Clone, Debug, PartialEq)]
pub struct Recording {
    /// Every moment of it, the end included.
    pub frames: Vec<Frame>,
    /// The undiscounted return.
    pub total: f64,
    /// The last step.
    pub end: Outcome,
}

/// One moment of an episode.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// The environment's state, or the observation of one that shows none.
    pub state: Vec<f64>,
    /// What the agent saw.
    pub observation: Vec<f32>,
    /// What the environment looks like; none if it has no picture.
    pub scene: Option<Scene>,
    /// The action that was taken in it; none at the end.
    pub action: Option<usize>,
    /// The Q-values on which it was taken; empty at the end.
    pub q_values: Vec<f32>,
}

/// Plays one episode of a policy and keeps it.
///
/// # Errors
/// When the environment fails.
pub fn record(
    actor: &mut impl Actor,
    environment: &mut dyn Environment,
    seed: u64,
) -> Result<Recording, EnvironmentError> {
    let mut observation = vec![0.0; environment.spec().observation_size];
    environment.reset(Start::Seed(seed), &mut observation)?;
    let frame = |environment: &dyn Environment, seen: &[f32], action, q_values| {
        let (state, scene) = (state_of(environment, seen), environment.scene());
        Frame { state, observation: seen.to_vec(), scene, action, q_values }
    };
    let (mut frames, mut total) = (Vec::new(), 0.0);
    loop {
        let action = actor.act(&observation);
        frames.push(frame(environment, &observation, Some(action), actor.q_values()));
        let outcome = environment.step(action, &mut observation)?;
        total += outcome.reward;
        if outcome.ended() {
            frames.push(frame(environment, &observation, None, Vec::new()));
            return Ok(Recording { frames, total, end: outcome });
        }
    }
}

/// Plays the first `steps` steps of an episode of a policy, and shows `see` the pixels of every moment and whether it is the last
/// one; none if the environment draws nothing. Returns the steps.
///
/// # Errors
/// The first error of the environment or of `see`, which ends the episode.
pub fn film<X: From<EnvironmentError>>(
    actor: &mut impl Actor,
    environment: &mut dyn Environment,
    seed: u64,
    steps: u64,
    mut see: impl FnMut(Option<Image>, bool) -> Result<(), X>,
) -> Result<u64, X> {
    let mut observation = vec![0.0; environment.spec().observation_size];
    environment.reset(Start::Seed(seed), &mut observation)?;
    let (mut step, mut is_last) = (0, steps == 0);
    loop {
        see(environment.image()?, is_last)?;
        if is_last {
            return Ok(step);
        }
        step += 1;
        let outcome = environment.step(actor.act(&observation), &mut observation)?;
        is_last = outcome.ended() || step == steps;
    }
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
}

/// Gymnasium seed of the first episode that gives probes.
const PROBE_SEED: u64 = 3_000_000;
/// Number of probes of each kind.
const PROBES: usize = 128;

/// Probes from episodes of the random policy: every observation is an ordinary one, and the last before a termination
/// is doomed.
pub(super) fn probes(make: &Make, max_steps: u32) -> Result<Probes, EnvironmentError> {
    let mut probes = Probes::default();
    let mut environment = make(max_steps)?;
    let num_actions = environment.spec().num_actions as u64;
    let mut observation = vec![0.0; environment.spec().observation_size];
    for episode in 0..PROBES as u64 {
        let mut rng = Rng::from_seed(PROBE_SEED + episode);
        environment.reset(Start::Stream(&mut rng), &mut observation)?;
        loop {
            if probes.ordinary.len() < PROBES {
                probes.ordinary.push(observation.clone());
            }
            let before = observation.clone();
            let outcome = environment.step(rng.below(num_actions) as usize, &mut observation)?;
            if outcome.terminated {
                probes.doomed.push(before);
            }
            if outcome.ended() {
                break;
            }
        }
    }
    Ok(probes)
}
