//! Plays episodes without learning, and scores their returns.

use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

use crate::agent::{Actor, Played, Policy, Probes, Random};
use crate::env::{Answer, Environment, EnvironmentError, Make, Outcome, Spec, Start, VectorEnvironment};
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
pub fn evaluate(
    policy: &Policy, make: &Make, max_steps: u32, first_seed: u64, episodes: u64, gamma: f64,
) -> Answer<Vec<Played>> {
    Play { policy, make, max_steps, gamma, is_test: false }.episodes(first_seed, episodes)
}

/// Whether a policy, played from [`LASTING_EPISODES`] starts, lasts `steps` steps from each: no episode terminates, and none is cut
/// off before by the environment itself.
///
/// From every second start an action is random with probability [`LASTING_EPSILON`]: such an episode sees states that the policy by
/// itself reaches from one start in a hundred. The others show whether it drifts when it is left alone. The starts are those of
/// the evaluations and of the seeds after them. The random actions of an episode come from [`Stream::Explore`] of its seed.
/// The number is how many steps were played.
pub fn lasts(policy: &Policy, make: &Make, steps: u32) -> Answer<(bool, u64)> {
    let test = Play { policy, make, max_steps: steps, gamma: 1.0, is_test: true };
    let played = test.episodes(super::EVALUATION_SEED, LASTING_EPISODES)?;
    let lasts = played.iter().all(|episode| !episode.terminated && episode.steps >= u64::from(steps));
    Ok((lasts, played.iter().map(|episode| episode.steps).sum()))
}

struct Play<'a> {
    policy: &'a Policy,
    make: &'a Make,
    max_steps: u32,
    gamma: f64,
    /// See [`lasts`]. Episodes after the first termination may be missing, or stop where they are.
    is_test: bool,
}

impl Play<'_> {
    fn ends_with(&self, episode: &Played) -> bool {
        self.is_test && episode.terminated
    }

    /// Plays `episodes` episodes, from the seed `first_seed` and those after it.
    fn episodes(&self, first_seed: u64, episodes: u64) -> Answer<Vec<Played>> {
        let some = |episodes: Range<u64>| self.lockstep(episodes.map(|i| first_seed.wrapping_add(i)));
        if let Some(processes) = (self.make)(self.max_steps)?.processes() {
            return self.in_processes(processes, episodes, |i| Ok(some(i..i + 1)?.remove(0)));
        }
        let mut played = Vec::new();
        for start in (0..episodes).step_by(LOCKSTEP as usize) {
            played.extend(some(start..episodes.min(start + LOCKSTEP))?);
        }
        Ok(played)
    }

    /// Plays so many episodes, each with `play`, up to `processes` at the same time. Who plays which one changes nothing.
    fn in_processes(
        &self, processes: usize, episodes: u64, play: impl Fn(u64) -> Answer<Played> + Sync,
    ) -> Answer<Vec<Played>> {
        let next = AtomicU64::new(0);
        let ended = Mutex::new(std::collections::BTreeMap::new());
        let play_on = || {
            while let episode = next.fetch_add(1, Ordering::Relaxed)
                && episode < episodes
            {
                let played = play(episode);
                if played.as_ref().map_or(true, |played| self.ends_with(played)) {
                    next.store(episodes, Ordering::Relaxed);
                }
                ended.lock().unwrap_or_else(PoisonError::into_inner).insert(episode, played);
            }
        };
        std::thread::scope(|scope| {
            (1..processes.min(episodes as usize)).for_each(|_| drop(scope.spawn(play_on)));
            play_on();
        });
        // Up to the first one that ends the test or fails: which others were played is chance.
        let mut all = Vec::new();
        for episode in ended.into_inner().unwrap_or_else(PoisonError::into_inner).into_values() {
            all.push(episode?);
            if all.last().is_some_and(|last| self.ends_with(last)) {
                break;
            }
        }
        Ok(all)
    }

    fn lockstep(&self, seeds: impl Iterator<Item = u64>) -> Answer<Vec<Played>> {
        let environment = (self.make)(self.max_steps)?;
        let Spec { observation_size, num_actions, max_steps: scored_steps, .. } = *environment.spec();
        let mut environments = environment.vector(self.max_steps).unwrap_or_else(|| {
            Box::new(Separate { play: self, first: Some(environment), environments: Vec::new() })
        });
        let (mut playing, mut observations) = (Vec::new(), Vec::new());
        for (index, seed) in seeds.enumerate() {
            observations.resize((index + 1) * observation_size, 0.0);
            environments.add(Start::Seed(seed), &mut observations[index * observation_size..])?;
            let is_disturbed = self.is_test && seed % 2 == 1;
            playing.push((index, is_disturbed.then(|| Rng::spawn(seed, Stream::Explore))));
        }
        let mut played = vec![Played::default(); playing.len()];
        let mut greedy = self.policy.greedy(playing.len());
        let (mut actions, mut outcomes, mut discount) = (Vec::new(), Vec::new(), 1.0);
        while !playing.is_empty() {
            // Ended episodes stay in the batch. It is rebuilt when half of it has ended.
            if playing.len() <= greedy.batch() / 2 {
                greedy = self.policy.greedy(playing.len());
            }
            greedy.forward_batch(observations.chunks_exact(observation_size));
            actions.clear();
            actions.extend(playing.iter_mut().enumerate().map(|(place, (_, rng))| {
                let disturbing = rng.as_mut().and_then(|rng| (rng.unit() <= LASTING_EPSILON).then_some(rng));
                disturbing.map_or_else(|| greedy.action(place), |rng| rng.below(num_actions as u64) as usize)
            }));
            environments.step(&actions, &mut observations, &mut outcomes)?;
            let mut is_over = false;
            // From the last one, so that the one that takes the place of an ended one has been counted.
            for place in (0..playing.len()).rev() {
                let (outcome, episode) = (outcomes[place], &mut played[playing[place].0]);
                if episode.steps == 0 {
                    episode.expected = greedy.q_value(place, actions[place]);
                }
                episode.count(outcome, u64::from(scored_steps), discount);
                is_over |= self.ends_with(episode);
                if outcome.ended() {
                    playing.swap_remove(place);
                    environments.swap_remove(place);
                    observations.copy_within(playing.len() * observation_size.., place * observation_size);
                    observations.truncate(playing.len() * observation_size);
                }
            }
            if is_over {
                break;
            }
            discount *= self.gamma;
        }
        Ok(played)
    }
}

/// Environments that know no other way to take their steps than one after the other.
struct Separate<'a> {
    play: &'a Play<'a>,
    /// One that has been made and waits for its start.
    first: Option<Box<dyn Environment>>,
    environments: Vec<Box<dyn Environment>>,
}

impl VectorEnvironment for Separate<'_> {
    fn add(&mut self, start: Start<'_>, observation: &mut [f32]) -> Answer<()> {
        let mut environment = self.first.take().map_or_else(|| (self.play.make)(self.play.max_steps), Ok)?;
        environment.reset(start, observation)?;
        self.environments.push(environment);
        Ok(())
    }

    fn step(
        &mut self, actions: &[usize], observations: &mut [f32], outcomes: &mut Vec<Outcome>,
    ) -> Answer<()> {
        outcomes.clear();
        let size = observations.len() / self.environments.len();
        let rows = self.environments.iter_mut().zip(observations.chunks_exact_mut(size)).zip(actions);
        for ((environment, observation), &action) in rows {
            outcomes.push(environment.step(action, observation)?);
        }
        Ok(())
    }

    fn swap_remove(&mut self, place: usize) {
        self.environments.swap_remove(place);
    }
}

impl Played {
    /// Counts a step, whose reward is in the return if it is one of the first `scored_steps`.
    pub fn count(&mut self, outcome: Outcome, scored_steps: u64, discount: f64) {
        if self.steps < scored_steps {
            self.total += outcome.reward;
        }
        self.discounted += discount * outcome.reward;
        self.steps += 1;
        self.terminated = outcome.terminated;
    }
}

pub(crate) struct Moment<'a> {
    pub(crate) environment: &'a mut dyn Environment,
    /// Steps before it.
    pub(crate) step: u64,
    pub observation: &'a [f32],
    /// What the step before it brought; none at the start.
    pub(crate) outcome: Option<Outcome>,
    /// The action that is taken in it; none at the end.
    pub action: Option<usize>,
    /// The Q-values on which it is taken; empty at the end, and of an actor that has none.
    pub(crate) q_values: Vec<f32>,
}

impl Moment<'_> {
    /// The environment's state, or the observation of one that shows none.
    pub(crate) fn state(&self) -> Vec<f64> {
        let shown = || self.observation.iter().map(|&value| f64::from(value)).collect();
        self.environment.state().map_or_else(shown, <[f64]>::to_vec)
    }
}

/// Plays one episode from a seed. `see` gets every moment, the end included, and says whether to play on.
///
/// # Errors
/// The first error of the environment or of `see`, which ends the episode.
pub(crate) fn play<X: From<EnvironmentError>>(
    actor: &mut impl Actor, environment: &mut dyn Environment, seed: u64,
    see: impl FnMut(Moment<'_>) -> Result<bool, X>,
) -> Result<(), X> {
    let mut observation = vec![0.0; environment.spec().observation_size];
    environment.reset(Start::Seed(seed), &mut observation)?;
    play_from(actor, environment, &mut observation, see)
}

/// As [`play`], from the observation that the environment has been reset to.
fn play_from<X: From<EnvironmentError>>(
    actor: &mut impl Actor, environment: &mut dyn Environment, observation: &mut [f32],
    mut see: impl FnMut(Moment<'_>) -> Result<bool, X>,
) -> Result<(), X> {
    let mut outcome: Option<Outcome> = None;
    for step in 0.. {
        let goes_on = outcome.is_none_or(|outcome| !outcome.ended());
        let action = goes_on.then(|| actor.act(observation));
        let q_values = action.map_or_else(Vec::new, |_| actor.q_values());
        let is_watched = see(Moment { environment, step, observation, outcome, action, q_values })?;
        let Some(action) = action.filter(|_| is_watched) else { break };
        outcome = Some(environment.step(action, observation)?);
    }
    Ok(())
}

#[derive(Clone, Debug, PartialEq)]
pub struct Recording {
    /// Every moment of it, the end included.
    pub(crate) frames: Vec<Frame>,
    pub total: f64,
    pub terminated: bool,
}

/// One moment of an episode, with what [`Moment`] has.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Frame {
    pub state: Vec<f64>,
    pub observation: Vec<f32>,
    pub(crate) scene: Option<crate::env::scene::Scene>,
    pub action: Option<usize>,
    pub(crate) q_values: Vec<f32>,
}

pub fn record(actor: &mut impl Actor, environment: &mut dyn Environment, seed: u64) -> Answer<Recording> {
    let mut recording = Recording { frames: Vec::new(), total: 0.0, terminated: false };
    play(actor, environment, seed, |moment| {
        let (state, scene) = (moment.state(), moment.environment.scene());
        let Moment { observation, outcome, action, q_values, .. } = moment;
        recording.total += outcome.map_or(0.0, |outcome| outcome.reward);
        recording.terminated = outcome.is_some_and(|outcome| outcome.terminated);
        recording.frames.push(Frame { state, observation: observation.to_vec(), scene, action, q_values });
        Ok::<_, EnvironmentError>(true)
    })?;
    Ok(recording)
}

#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Score {
    pub episodes: u64,
    pub mean: f64,
    /// Their population standard deviation.
    pub std: f64,
    pub min: f64,
    /// The middle one, or the mean of the two in the middle.
    pub median: f64,
    pub max: f64,
}

impl Score {
    pub fn new(returns: &[f64]) -> Self {
        let count = returns.len() as f64;
        let mean = returns.iter().sum::<f64>() / count;
        let variance = returns.iter().map(|value| (value - mean) * (value - mean)).sum::<f64>() / count;
        let mut sorted = returns.to_vec();
        sorted.sort_by(f64::total_cmp);
        let middle = (returns.len() - 1) / 2;
        let median = (sorted[middle] + sorted[returns.len() / 2]) / 2.0;
        Self {
            episodes: returns.len() as u64,
            mean,
            std: variance.sqrt(),
            min: sorted[0],
            median,
            max: sorted[sorted.len() - 1],
        }
    }

    /// Half the width of the 95 % interval of the mean over episodes, 1.96 standard errors; `None` for one episode.
    pub fn interval(&self) -> Option<f64> {
        let count = self.episodes as f64;
        (self.episodes > 1).then(|| 1.96 * self.std * (count / (count - 1.0)).sqrt() / count.sqrt())
    }
}

/// Gymnasium seed of the first episode that gives probes.
const PROBE_SEED: u64 = 3_000_000;
const PROBES: usize = 128;

/// Probes from episodes of the random policy: every observation is an ordinary one, and the last before a termination
/// is doomed.
pub(super) fn probes(make: &Make, max_steps: u32) -> Answer<Probes> {
    let mut probes = Probes::default();
    let mut environment = make(max_steps)?;
    let num_actions = environment.spec().num_actions;
    let mut observation = vec![0.0; environment.spec().observation_size];
    for episode in 0..PROBES as u64 {
        let mut rng = Rng::from_seed(PROBE_SEED + episode);
        environment.reset(Start::Stream(&mut rng), &mut observation)?;
        let (mut actor, mut before) = (Random { num_actions, rng }, Vec::new());
        play_from(&mut actor, &mut *environment, &mut observation, |moment| {
            if moment.outcome.is_some_and(|outcome| outcome.terminated) {
                probes.doomed.push(std::mem::take(&mut before));
            } else if moment.action.is_some() && probes.ordinary.len() < PROBES {
                probes.ordinary.push(moment.observation.to_vec());
            }
            before = moment.observation.to_vec();
            Ok::<_, EnvironmentError>(true)
        })?;
    }
    Ok(probes)
}
