//! Replay memory (Lin 1992): a ring of the latest transitions, sampled uniformly.
//!
//! Structure of arrays, one slot per transition. Each observation is stored once: the next observation of a
//! transition is the observation in the following slot, and the final observation of an episode, which no slot
//! follows, has its own place in `finals`. One slot is spare, so that the newest transition has a following slot
//! when the ring is full. With four numbers an observation a transition takes 22 bytes and one bit.

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use crate::mirror::Mirror;
use crate::rng::Rng;
use crate::tensors::{TensorError, Tensors};

/// Settings of the replay memory. Each is a key of the config, see `config::keys`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReplayConfig {
    pub capacity: usize,
    pub batch_size: usize,
    pub(crate) warmup_steps: u64,
    pub(crate) update: UpdateMode,
    pub mirror: bool,
}

impl ReplayConfig {
    /// Transitions in one update.
    pub(crate) fn update_size(&self) -> usize {
        match self.update {
            UpdateMode::Minibatch => self.batch_size,
            UpdateMode::PerSample => 1,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum UpdateMode {
    /// One gradient step on the mean loss of the minibatch (Mnih et al. 2015).
    Minibatch,
    /// One gradient step per transition, one after another (the tutorial).
    PerSample,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transition<'a> {
    pub observation: &'a [f32],
    pub action: usize,
    pub reward: f32,
    pub next_observation: &'a [f32],
    /// Whether the value of `next_observation` is 0.
    pub terminated: bool,
    /// Whether the episode was cut off.
    pub truncated: bool,
}

/// A batch of windows of k ≥ 1 transitions, gathered for an update. Observations are (batch, features), the rest (batch).
#[derive(Clone, Debug, PartialEq)]
pub struct Minibatch {
    /// s, before the first transition
    pub observations: DMatrix<f32>,
    /// a, of the first transition
    pub actions: Vec<u8>,
    /// R = r₀ + γ r₁ + … + γᵏ⁻¹ rₖ₋₁
    pub rewards: Vec<f32>,
    /// γᵏ
    pub discounts: Vec<f32>,
    /// s′, after the last transition
    pub next_observations: DMatrix<f32>,
    /// Whether the value of s′ is 0.
    pub terminated: Vec<bool>,
}

impl Minibatch {
    pub fn new(batch_size: usize, observation_size: usize) -> Self {
        Self {
            observations: DMatrix::zeros(batch_size, observation_size),
            actions: vec![0; batch_size],
            rewards: vec![0.0; batch_size],
            discounts: vec![0.0; batch_size],
            next_observations: DMatrix::zeros(batch_size, observation_size),
            terminated: vec![false; batch_size],
        }
    }

    /// Replaces every sample by its mirror image with probability ½; `row` is scratch.
    pub(crate) fn reflect_half(&mut self, mirror: &Mirror, rng: &mut Rng, row: &mut Vec<f32>) {
        for sample in 0..self.actions.len() {
            if rng.below(2) == 1 {
                self.reflect(sample, mirror, row);
            }
        }
    }

    /// Replaces a sample by its mirror image; `row` is scratch.
    pub fn reflect(&mut self, sample: usize, mirror: &Mirror, row: &mut Vec<f32>) {
        let batch = self.actions.len();
        self.actions[sample] = mirror.actions[usize::from(self.actions[sample])];
        for observations in [&mut self.observations, &mut self.next_observations] {
            let values = observations.as_mut_slice();
            row.clear();
            row.extend(mirror.observation.iter().map(|&(j, factor)| factor * values[j * batch + sample]));
            for (feature, &value) in row.iter().enumerate() {
                values[feature * batch + sample] = value;
            }
        }
    }
}

/// How the episode went on after a transition.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
enum EpisodeEnd {
    Continues,
    Truncated,
    Terminated,
}

/// What a memory of n transitions holds, the oldest first.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReplayContents {
    /// (n, observation)
    pub observations: Vec<f32>,
    /// (n)
    pub actions: Vec<u8>,
    /// (n)
    pub rewards: Vec<f32>,
    /// (n): 0 the episode continues, 1 it was truncated, 2 it terminated.
    pub ends: Vec<u8>,
    /// The next observations of those that ended an episode, and of the newest; the others are the following observations.
    pub next_observations: Vec<f32>,
}

impl ReplayContents {
    /// Adds the contents as tensors; observations are (n, `observation_size`).
    pub(super) fn save(&self, observation_size: usize, tensors: &mut Tensors) {
        let (len, nexts) = (self.actions.len(), self.next_observations.len() / observation_size);
        tensors.put("replay.observations", &[len, observation_size], &self.observations);
        tensors.put("replay.actions", &[len], &self.actions);
        tensors.put("replay.rewards", &[len], &self.rewards);
        tensors.put("replay.ends", &[len], &self.ends);
        tensors.put("replay.next_observations", &[nexts, observation_size], &self.next_observations);
    }

    /// The inverse of [`Self::save`].
    pub(super) fn load(observation_size: usize, tensors: &Tensors) -> Result<Self, TensorError> {
        let len = tensors.shape("replay.actions")?.iter().product();
        let nexts = tensors.shape("replay.next_observations")?.first().copied().unwrap_or(0);
        Ok(Self {
            observations: tensors.get("replay.observations", &[len, observation_size])?,
            actions: tensors.get("replay.actions", &[len])?,
            rewards: tensors.get("replay.rewards", &[len])?,
            ends: tensors.get("replay.ends", &[len])?,
            next_observations: tensors.get("replay.next_observations", &[nexts, observation_size])?,
        })
    }
}

#[derive(Clone, Debug, Default)]
pub struct Replay {
    capacity: usize,
    observation_size: usize,
    /// (capacity + 1 slots, observation)
    observations: Vec<f32>,
    actions: Vec<u8>,
    rewards: Vec<f32>,
    ends: Vec<EpisodeEnd>,
    /// The slots whose transition ended an episode, the oldest first, and the observations it ended with.
    final_slots: Vec<u32>,
    final_observations: Vec<f32>,
    /// How many of them, from the front, belong to transitions that are forgotten.
    forgotten_finals: usize,
    /// Slot of the oldest transition.
    oldest: usize,
    len: usize,
    /// One bit per age: whether it is already in the minibatch being drawn.
    drawn: Vec<u64>,
}

impl Replay {
    /// An empty memory for `capacity` transitions, fewer than 2³².
    pub fn new(capacity: usize, observation_size: usize) -> Self {
        let slots = capacity + 1;
        Self {
            capacity,
            observation_size,
            observations: vec![0.0; slots * observation_size],
            actions: vec![0; slots],
            rewards: vec![0.0; slots],
            ends: vec![EpisodeEnd::Continues; slots],
            drawn: vec![0; capacity.div_ceil(64)],
            ..Self::default()
        }
    }

    pub fn len(&self) -> usize {
        self.len
    }

    /// How many of them end in termination.
    pub(crate) fn terminal_transitions(&self) -> usize {
        (0..self.len).filter(|&age| self.ends[self.slot(age)] == EpisodeEnd::Terminated).count()
    }

    /// Remembers a transition and forgets the oldest if the memory is full.
    pub fn push(&mut self, transition: Transition) {
        if self.len == self.capacity {
            // With its final observation, if it has one.
            if self.final_slots.get(self.forgotten_finals) == Some(&(self.oldest as u32)) {
                self.forgotten_finals += 1;
            }
            self.oldest = self.following(self.oldest);
            self.len -= 1;
        }
        let slot = self.slot(self.len);
        self.len += 1;
        self.actions[slot] = transition.action as u8;
        self.rewards[slot] = transition.reward;
        self.observation_mut(slot).copy_from_slice(transition.observation);
        self.ends[slot] = match (transition.terminated, transition.truncated) {
            (true, _) => EpisodeEnd::Terminated,
            (false, true) => EpisodeEnd::Truncated,
            (false, false) => EpisodeEnd::Continues,
        };
        if self.ends[slot] == EpisodeEnd::Continues {
            self.observation_mut(self.following(slot)).copy_from_slice(transition.next_observation);
        } else {
            self.make_room_for_a_final();
            self.final_slots.push(slot as u32);
            self.final_observations.extend(transition.next_observation);
        }
    }

    /// Makes room for one more final observation: in the space of forgotten ones once they are a sixteenth of all, or else by
    /// growing by a sixteenth. Doubling would cost more than 24 bytes per transition when episodes are short.
    fn make_room_for_a_final(&mut self) {
        let sixteenth = self.final_slots.len() / 16;
        if self.final_slots.len() < self.final_slots.capacity() {
            return;
        }
        if self.forgotten_finals > sixteenth {
            self.final_slots.drain(..self.forgotten_finals);
            self.final_observations.drain(..self.forgotten_finals * self.observation_size);
            self.forgotten_finals = 0;
        } else {
            self.final_slots.reserve_exact(sixteenth + 1);
            self.final_observations.reserve_exact((sixteenth + 1) * self.observation_size);
        }
    }

    /// Draws distinct transitions uniformly, as ages from 0, the oldest, one for each of `ages`; there must be enough.
    pub fn sample(&mut self, rng: &mut Rng, ages: &mut [usize]) {
        debug_assert!(ages.len() <= self.len);
        for age in &mut *ages {
            *age = loop {
                let age = rng.below(self.len as u64) as usize;
                let (word, bit) = (age / 64, 1 << (age % 64));
                if self.drawn[word] & bit == 0 {
                    self.drawn[word] |= bit;
                    break age;
                }
            };
        }
        ages.iter().for_each(|age| self.drawn[*age / 64] = 0);
    }

    /// Copies the windows that start with the transitions of these ages into a minibatch of as many.
    ///
    /// A window is `n_step` transitions (Sutton 1988; Mnih et al. 2016), or fewer where episode or memory ends: it bootstraps
    /// from there. Powers and sums are rounded after every multiplication and addition, from the first transition on.
    pub fn gather(&self, ages: &[usize], n_step: usize, gamma: f32, minibatch: &mut Minibatch) {
        let batch = ages.len();
        let observations = minibatch.observations.as_mut_slice();
        let next_observations = minibatch.next_observations.as_mut_slice();
        for (sample, &age) in ages.iter().enumerate() {
            let first = self.slot(age);
            let (mut last, mut reward, mut discount) = (first, self.rewards[first], gamma);
            for _ in 1..n_step.min(self.len - age) {
                if self.ends[last] != EpisodeEnd::Continues {
                    break;
                }
                last = self.following(last);
                reward += discount * self.rewards[last];
                discount *= gamma;
            }
            minibatch.actions[sample] = self.actions[first];
            minibatch.rewards[sample] = reward;
            minibatch.discounts[sample] = discount;
            minibatch.terminated[sample] = self.ends[last] == EpisodeEnd::Terminated;
            let values = self.observation(first).iter().zip(self.next_observation(last));
            for (feature, (&value, &next_value)) in values.enumerate() {
                observations[feature * batch + sample] = value;
                next_observations[feature * batch + sample] = next_value;
            }
        }
    }

    pub fn contents(&self) -> ReplayContents {
        let mut contents = ReplayContents::default();
        for age in 0..self.len {
            let slot = self.slot(age);
            contents.observations.extend(self.observation(slot));
            contents.actions.push(self.actions[slot]);
            contents.rewards.push(self.rewards[slot]);
            contents.ends.push(self.ends[slot] as u8);
            if self.ends[slot] != EpisodeEnd::Continues || age + 1 == self.len {
                contents.next_observations.extend(self.next_observation(slot));
            }
        }
        contents
    }

    /// Pushes `contents` in their order; returns whether they fit together and into this memory.
    #[must_use]
    pub fn restore(&mut self, contents: &ReplayContents, num_actions: usize) -> bool {
        let ReplayContents { observations, actions, rewards, ends, next_observations } = contents;
        let (size, len) = (self.observation_size, actions.len());
        let fits = len <= self.capacity
            && (observations.len(), rewards.len(), ends.len()) == (len * size, len, len)
            && actions.iter().all(|&action| usize::from(action) < num_actions)
            && ends.iter().all(|&end| end <= EpisodeEnd::Terminated as u8);
        if !fits {
            return false;
        }
        let mut nexts = next_observations.chunks_exact(size);
        for age in 0..len {
            let continues = ends[age] == EpisodeEnd::Continues as u8 && age + 1 < len;
            let following = if continues { observations.get((age + 1) * size..) } else { nexts.next() };
            let Some(next_observation) = following.and_then(|following| following.get(..size)) else {
                return false;
            };
            let (observation, action) = (&observations[age * size..][..size], usize::from(actions[age]));
            let [terminated, truncated] =
                [EpisodeEnd::Terminated, EpisodeEnd::Truncated].map(|end| ends[age] == end as u8);
            let reward = rewards[age];
            self.push(Transition { observation, action, reward, next_observation, terminated, truncated });
        }
        nexts.next().is_none() && nexts.remainder().is_empty()
    }

    fn slot(&self, age: usize) -> usize {
        let slot = self.oldest + age;
        if slot > self.capacity { slot - self.capacity - 1 } else { slot }
    }

    fn following(&self, slot: usize) -> usize {
        if slot == self.capacity { 0 } else { slot + 1 }
    }

    fn age(&self, slot: usize) -> usize {
        if slot >= self.oldest { slot - self.oldest } else { slot + self.capacity + 1 - self.oldest }
    }

    fn observation(&self, slot: usize) -> &[f32] {
        &self.observations[slot * self.observation_size..][..self.observation_size]
    }

    fn observation_mut(&mut self, slot: usize) -> &mut [f32] {
        &mut self.observations[slot * self.observation_size..][..self.observation_size]
    }

    #[inline(always)]
    fn next_observation(&self, slot: usize) -> &[f32] {
        if self.ends[slot] == EpisodeEnd::Continues {
            return self.observation(self.following(slot));
        }
        let age = self.age(slot);
        let finals = &self.final_slots[self.forgotten_finals..];
        let index = self.forgotten_finals + finals.partition_point(|&slot| self.age(slot as usize) < age);
        &self.final_observations[index * self.observation_size..][..self.observation_size]
    }
}
