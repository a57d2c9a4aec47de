//! The training episode that is being played.

use super::ResumeError;
use crate::env::{Answer, Environment, Outcome, Start};
use crate::rng::{Rng, Stream};
use crate::tensors::{TensorError, Tensors};

/// An environment in the middle of an episode. A checkpoint holds where the episode started and the actions since then, and
/// not the environment: played again, they lead to the state of any deterministic environment, of another program too.
pub(super) struct TrainingEpisode {
    environment: Box<dyn Environment>,
    /// Start states are drawn from here.
    rng: Rng,
    /// The generator before the start of this episode.
    start: Rng,
    actions: Vec<u8>,
    /// An action of the agent that the environment has not carried out, because it failed before the run was resumed.
    pending: Option<usize>,
    pub(super) observation: Vec<f32>,
    /// What it sees after the latest step, until [`Self::advance`].
    pub(super) next_observation: Vec<f32>,
}

impl TrainingEpisode {
    /// The first episode of a run with this seed.
    pub(super) fn first(environment: Box<dyn Environment>, seed: u64) -> Answer<Self> {
        let observation = vec![0.0; environment.spec().observation_size];
        let rng = Rng::spawn(seed, Stream::Environment);
        let (start, next_observation) = (rng.clone(), observation.clone());
        let mut episode = Self {
            environment,
            rng,
            start,
            actions: Vec::new(),
            pending: None,
            observation,
            next_observation,
        };
        episode.reset()?;
        Ok(episode)
    }

    pub(super) fn reset(&mut self) -> Answer<()> {
        self.start = self.rng.clone();
        self.actions.clear();
        self.environment.reset(Start::Stream(&mut self.rng), &mut self.observation)
    }

    /// The next action: the one that is pending, or else what the agent chooses.
    pub(super) fn action(&mut self, choose: impl FnOnce(&[f32]) -> usize) -> usize {
        self.pending.take().unwrap_or_else(|| choose(&self.observation))
    }

    /// One step. If the environment fails, a checkpoint holds the action too.
    pub(super) fn step(&mut self, action: usize) -> Answer<Outcome> {
        self.actions.push(action as u8);
        self.environment.step(action, &mut self.next_observation)
    }

    /// The next observation becomes the one that the agent acts on.
    pub(super) fn advance(&mut self) {
        std::mem::swap(&mut self.observation, &mut self.next_observation);
    }

    pub(super) fn save(&self, tensors: &mut Tensors) {
        tensors.put_rng("episode.start", &self.start);
        tensors.put("episode.actions", &[self.actions.len()], &self.actions);
        tensors.put("episode.observation", &[self.observation.len()], &self.observation);
    }

    /// Plays the episode of a checkpoint, which has `steps` steps, up to where it was.
    pub(super) fn load(&mut self, tensors: &Tensors, steps: u64) -> Result<(), ResumeError> {
        self.rng = tensors.get_rng("episode.start")?;
        self.reset()?;
        let len = tensors.shape("episode.actions")?.iter().product();
        let actions: Vec<u8> = tensors.get("episode.actions", &[len])?;
        let num_actions = self.environment.spec().num_actions;
        let pending = actions.get(steps as usize..).unwrap_or_default();
        if !(steps..=steps + 1).contains(&(len as u64))
            || actions.iter().any(|&action| usize::from(action) >= num_actions)
        {
            return Err(TensorError::Inconsistent("episode").into());
        }
        self.pending = pending.first().map(|&action| action.into());
        for &action in actions.iter().take(steps as usize) {
            if self.step(usize::from(action))?.ended() {
                return Err(ResumeError::NotDeterministic);
            }
            self.advance();
        }
        let expected: Vec<f32> = tensors.get("episode.observation", &[self.observation.len()])?;
        if self.observation == expected { Ok(()) } else { Err(ResumeError::NotDeterministic) }
    }
}
