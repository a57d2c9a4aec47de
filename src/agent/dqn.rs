//! Deep Q-learning (Mnih et al. 2015, "Human-level control through deep reinforcement learning", algorithm 1).

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use super::statistics::{Inside, TRANSITIONS};
use super::{
    Agent, Counters, EpsilonGreedy, Exploration, Minibatch, NamedNumbers, NotFinite, Played, Policy,
    PolicyWeights, Probes, Replay, ReplayConfig, ReplayContents, TargetUpdate, Transition, UpdateMode,
    argmax, td,
};
use crate::mirror::Mirror;
use crate::nn::{Activations, Adam, Loss, Mlp, NetworkConfig, OptimizerConfig, Symmetry, clip_norm};
use crate::rng::{Rng, Stream};
use crate::tensors::{TensorError, Tensors, weights_sha256};

/// When to learn.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LearnConfig {
    /// Environment steps between learning steps.
    pub every_steps: u64,
    /// Minibatches per learning step.
    pub updates: u32,
}

/// Settings of [`Dqn`]. Each is a key of the config, see `config::keys`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct DqnConfig {
    pub network: NetworkConfig,
    pub optimizer: OptimizerConfig,
    pub loss: Loss,
    pub gamma: f64,
    pub n_step: usize,
    pub double: bool,
    pub replay: ReplayConfig,
    pub learn: LearnConfig,
    pub exploration: Exploration,
    pub target: TargetUpdate,
    pub truncation_is_terminal: bool,
    pub observation_divisors: Option<Vec<f64>>,
    pub reward_scale: f64,
    pub policy_weights: PolicyWeights,
}

impl DqnConfig {
    /// What each of `observation_size` coordinates is divided by.
    pub fn divisors(&self, observation_size: usize) -> Vec<f32> {
        match &self.observation_divisors {
            Some(divisors) => divisors.iter().map(|&divisor| divisor as f32).collect(),
            None => vec![1.0; observation_size],
        }
    }
}

/// The agent.
#[derive(Clone, Debug)]
pub struct Dqn {
    config: DqnConfig,
    /// What each coordinate of an observation is divided by before anything else sees it.
    observation_divisors: Vec<f32>,
    /// In which the agent sees mirror images, if it does.
    mirror: Option<Mirror>,
    /// What both networks keep, if they are to be symmetric.
    symmetry: Option<Symmetry>,
    /// Chooses the actions and learns.
    pub online: Mlp<f32>,
    /// Bootstraps the targets: an older copy or a running mean of `online`. Without a target network it is copied at
    /// each update.
    pub target: Mlp<f32>,
    /// The optimiser of `online`.
    pub adam: Adam<f32>,
    /// What has happened.
    pub replay: Replay,
    /// Chooses random actions.
    pub exploration: EpsilonGreedy,
    /// Draws minibatches.
    pub replay_rng: Rng,
    buffers: Buffers,
}

/// Memory of an update and of acting, allocated once; nothing in it outlives a call.
#[derive(Clone, Debug)]
struct Buffers {
    ages: Vec<usize>,
    minibatch: Minibatch,
    targets: Vec<f32>,
    /// What the online network makes of the next observations, for double Q-learning.
    next_q: DMatrix<f32>,
    activations: Activations<f32>,
    gradient: Mlp<f32>,
    acting: Activations<f32>,
    row: Vec<f32>,
    /// Scaled observations.
    observation: Vec<f32>,
    next_observation: Vec<f32>,
}

impl Dqn {
    /// An agent that knows nothing yet, its streams spawned from `seed`. With `replay.mirror` it reflects half of its samples
    /// in `mirror`, the mirror image of the task; with `network.symmetric` its networks are their own image in it.
    pub fn new(
        config: DqnConfig,
        observation_size: usize,
        num_actions: usize,
        mirror: Option<&Mirror>,
        seed: u64,
    ) -> Self {
        let mut online =
            Mlp::new(&config.network, observation_size, num_actions, &mut Rng::spawn(seed, Stream::Init));
        let symmetry =
            mirror.filter(|_| config.network.symmetric).map(|mirror| Symmetry::new(online.sizes(), mirror));
        if let Some(symmetry) = &symmetry {
            symmetry.impose(online.parameters_mut());
        }
        let (batch_size, updates) = match config.replay.update {
            UpdateMode::Minibatch => (config.replay.batch_size, 1),
            UpdateMode::PerSample => (1, config.replay.batch_size),
        };
        let buffers = Buffers::new(batch_size, updates, online.sizes());
        let observation_divisors = config.divisors(observation_size);
        Self {
            target: online.clone(),
            adam: Adam::new(config.optimizer.adam(), online.parameters().len()),
            replay: Replay::new(config.replay.capacity, observation_size),
            exploration: EpsilonGreedy::new(config.exploration, Rng::spawn(seed, Stream::Explore)),
            replay_rng: Rng::spawn(seed, Stream::Replay),
            mirror: mirror
                .filter(|_| config.replay.mirror || config.network.symmetric)
                .map(|mirror| mirror.of_divided(&observation_divisors)),
            symmetry,
            observation_divisors,
            online,
            buffers,
            config,
        }
    }

    /// The minibatch of the latest update, its targets, and its gradient as Adam got it. A symmetric network has learned from
    /// the mirror images too, so they follow the samples.
    pub fn latest_update(&self) -> (Minibatch, Vec<f32>, &Mlp<f32>) {
        let Buffers { minibatch, targets, gradient, .. } = &self.buffers;
        let (mut minibatch, mut targets) = (minibatch.clone(), targets.clone());
        if let Some(mirror) = &self.mirror
            && self.symmetry.is_some()
        {
            minibatch.append_images(mirror);
            targets.extend_from_within(..);
        }
        (minibatch, targets, gradient)
    }

    /// One learning step: `learn.updates` minibatches. Returns their mean loss.
    ///
    /// # Errors
    /// When the numbers leave the finite.
    pub fn learn(&mut self) -> Result<f32, NotFinite> {
        let mut ages = std::mem::take(&mut self.buffers.ages);
        let (mut sum, mut count) = (0.0, 0.0);
        for _ in 0..self.config.learn.updates {
            self.replay.sample(&mut self.replay_rng, &mut ages);
            for ages in ages.chunks_exact(self.buffers.targets.len()) {
                sum += self.update(ages)?;
                count += 1.0;
            }
        }
        self.buffers.ages = ages;
        if let TargetUpdate::Soft { tau } = self.config.target {
            self.target.move_towards(&self.online, tau as f32);
        }
        Ok(sum / count)
    }

    /// One gradient step on the minibatch of the transitions with these ages (algorithm 1, the inner loop). Returns its loss.
    ///
    /// # Errors
    /// When the numbers leave the finite.
    pub fn update(&mut self, ages: &[usize]) -> Result<f32, NotFinite> {
        let Self { config, mirror, symmetry, online, target, adam, replay, replay_rng, buffers, .. } = self;
        let Buffers { minibatch, targets, activations, next_q, gradient, row, .. } = buffers;
        replay.gather(ages, config.n_step, config.gamma as f32, minibatch);
        if let Some(mirror) = mirror
            && config.replay.mirror
        {
            minibatch.reflect_half(mirror, replay_rng, row);
        }
        if config.target == TargetUpdate::None {
            target.copy_from(online);
        }

        td_targets(config.double, online, target, minibatch, activations, next_q, targets);
        activations.set_input(&minibatch.observations);
        online.forward(activations);
        let (q, q_gradient) = activations.output_and_gradient_mut();
        let loss = td::loss(config.loss, q, &minibatch.actions, targets, q_gradient);
        online.backward(activations, gradient);
        if let Some(symmetry) = symmetry {
            symmetry.average(gradient.parameters_mut());
        }
        if let Some(max_norm) = config.optimizer.max_gradient_norm {
            clip_norm(gradient.parameters_mut(), max_norm);
        }
        let finite = adam.step(online.parameters_mut(), gradient.parameters());

        match (loss.is_finite(), finite) {
            (false, _) => Err(NotFinite::Loss),
            (true, false) if !gradient.parameters().iter().all(|g| g.is_finite()) => Err(NotFinite::Gradient),
            (true, false) => Err(NotFinite::Weight),
            (true, true) => Ok(loss),
        }
    }
}

/// What the Q-values of a minibatch should be: y = r + γᵏ max_a Q_target(s′, a), see [`td::targets`] and
/// [`td::double_targets`]. `activations` and `next_q` are scratch.
fn td_targets(
    double: bool,
    online: &Mlp<f32>,
    target: &Mlp<f32>,
    minibatch: &Minibatch,
    activations: &mut Activations<f32>,
    next_q: &mut DMatrix<f32>,
    targets: &mut [f32],
) {
    let Minibatch { rewards, discounts, next_observations, terminated, .. } = minibatch;
    activations.set_input(next_observations);
    if double {
        online.forward(activations);
        next_q.copy_from(activations.output());
    }
    target.forward(activations);
    if double {
        td::double_targets(discounts, rewards, terminated, next_q, activations.output(), targets);
    } else {
        td::targets(discounts, rewards, terminated, activations.output(), targets);
    }
}

impl Buffers {
    fn new(batch_size: usize, updates: usize, sizes: &[usize]) -> Self {
        let observation_size = sizes[0];
        Self {
            ages: vec![0; batch_size * updates],
            minibatch: Minibatch::new(batch_size, observation_size),
            targets: vec![0.0; batch_size],
            next_q: DMatrix::zeros(batch_size, sizes[sizes.len() - 1]),
            activations: Activations::new(sizes, batch_size),
            gradient: Mlp::zeros(sizes.to_vec()),
            acting: Activations::new(sizes, 1),
            row: Vec::with_capacity(observation_size),
            observation: vec![0.0; observation_size],
            next_observation: vec![0.0; observation_size],
        }
    }
}

impl Agent for Dqn {
    /// ε-greedy: a random action, or else the one with the largest Q-value.
    fn act(&mut self, observation: &[f32]) -> usize {
        if let Some(action) = self.exploration.explore(self.buffers.acting.output().ncols()) {
            return action;
        }
        scale(observation, &self.observation_divisors, self.buffers.acting.input_mut().as_mut_slice());
        self.online.forward(&mut self.buffers.acting);
        argmax(self.buffers.acting.output(), 0)
    }

    fn observe(&mut self, transition: Transition<'_>) {
        let terminated =
            transition.terminated || (transition.truncated && self.config.truncation_is_terminal);
        let Buffers { observation, next_observation, .. } = &mut self.buffers;
        scale(transition.observation, &self.observation_divisors, observation);
        scale(transition.next_observation, &self.observation_divisors, next_observation);
        let reward = transition.reward * self.config.reward_scale as f32;
        self.replay.push(Transition { observation, next_observation, reward, terminated, ..transition });
    }

    fn learn_if_due(&mut self, env_steps: u64) -> Result<Option<f32>, NotFinite> {
        let is_due = env_steps.is_multiple_of(self.config.learn.every_steps)
            && env_steps >= self.config.replay.warmup_steps
            && self.replay.len() >= self.config.replay.batch_size;
        let loss = if is_due { Some(self.learn()?) } else { None };
        self.apply_schedules(env_steps);
        if let TargetUpdate::EverySteps(period) = self.config.target
            && env_steps.is_multiple_of(period)
        {
            self.target.copy_from(&self.online);
        }
        Ok(loss)
    }

    fn end_episode(&mut self, episode: u64) {
        self.exploration.after_episode();
        if let TargetUpdate::EveryEpisodes(period) = self.config.target
            && episode.is_multiple_of(period)
        {
            self.target.copy_from(&self.online);
        }
    }

    fn policy(&self) -> Policy {
        Policy::Network(self.policy_network())
    }

    /// The inverse of [`Self::policy`], for both networks.
    fn start_from(&mut self, policy: &Policy) -> bool {
        let Policy::Network(network) = policy else { return false };
        if network.sizes() != self.online.sizes() {
            return false;
        }
        self.online.copy_from(network);
        let outputs = network.sizes()[1];
        let columns = self.online.layer_mut(0).chunks_exact_mut(outputs);
        for (weights, divisor) in columns.zip(&self.observation_divisors) {
            weights.iter_mut().for_each(|weight| *weight *= divisor);
        }
        self.target.copy_from(&self.online);
        let parameters = self.online.parameters();
        parameters.iter().all(|parameter| parameter.is_finite()) && self.is_symmetric(parameters)
    }

    fn gamma(&self) -> f64 {
        self.config.gamma
    }

    fn counters(&self) -> Counters {
        let Adam { steps, learning_rate, .. } = self.adam;
        Counters { updates: steps, epsilon: self.exploration.epsilon, learning_rate }
    }

    fn statistics(&self, probes: &Probes, played: &[Played]) -> Option<NamedNumbers> {
        let batch_size = self.replay.len().min(TRANSITIONS);
        if batch_size == 0 {
            return None;
        }
        let DqnConfig { n_step, gamma, double, loss, reward_scale, .. } = self.config;
        let ages: Vec<usize> = (0..batch_size).map(|i| i * self.replay.len() / batch_size).collect();
        let mut buffers = Buffers::new(batch_size, 1, self.online.sizes());
        let Buffers { minibatch, targets, activations, next_q, gradient, .. } = &mut buffers;
        self.replay.gather(&ages, n_step, gamma as f32, minibatch);
        td_targets(double, &self.online, &self.target, minibatch, activations, next_q, targets);
        activations.set_input(&minibatch.observations);
        self.online.forward(activations);
        let (q, q_gradient) = activations.output_and_gradient_mut();
        td::loss(loss, q, &minibatch.actions, targets, q_gradient);
        let td_errors = targets.iter().enumerate().map(|(sample, target)| {
            f64::from(q[(sample, usize::from(minibatch.actions[sample]))] - target).abs() / reward_scale
        });
        let td_errors = td_errors.collect();
        self.online.backward(activations, gradient);
        let terminal_share = self.replay.terminal_transitions() as f64 / self.replay.len() as f64;
        let network = &self.policy_network();
        let inside = Inside { network, reward_scale, terminal_share, td_errors, gradient };
        Some(inside.statistics(probes, played))
    }

    fn weights_sha256(&self) -> String {
        weights_sha256(&self.online)
    }

    fn save(&self, tensors: &mut Tensors) {
        let Self { online, target, adam, replay, .. } = self;
        tensors.put_network("online.", online);
        tensors.put_network("target.", target);
        tensors.put("adam.steps", &[1], &[adam.steps]);
        tensors.put("adam.first_moment", &[adam.first_moment.len()], &adam.first_moment);
        tensors.put("adam.second_moment", &[adam.second_moment.len()], &adam.second_moment);
        self.exploration.save(tensors);
        tensors.put_rng("replay_rng", &self.replay_rng);
        replay.contents().save(online.sizes()[0], tensors);
    }

    fn load(&mut self, tensors: &Tensors, env_steps: u64) -> Result<(), TensorError> {
        tensors.get_network("online.", &mut self.online)?;
        tensors.get_network("target.", &mut self.target)?;
        let parameters = self.online.parameters().len();
        self.adam.steps = tensors.get_one("adam.steps")?;
        if self.adam.steps >= 1 << 62 {
            return Err(TensorError::Inconsistent("number of updates"));
        }
        self.adam.first_moment = tensors.get("adam.first_moment", &[parameters])?;
        self.adam.second_moment = tensors.get("adam.second_moment", &[parameters])?;
        let Self { online, target, adam, .. } = &*self;
        let mirrored = [online.parameters(), target.parameters(), &adam.first_moment];
        if !mirrored.into_iter().all(|parameters| self.is_symmetric(parameters)) {
            return Err(TensorError::Inconsistent("symmetric network"));
        }
        self.replay_rng = tensors.get_rng("replay_rng")?;
        let (inputs, outputs) = (self.online.sizes()[0], self.buffers.acting.output().ncols());
        self.exploration.load(tensors, outputs)?;
        if !self.replay.restore(&ReplayContents::load(inputs, tensors)?, outputs) {
            return Err(TensorError::Inconsistent("replay memory"));
        }
        self.apply_schedules(env_steps);
        Ok(())
    }
}

impl Dqn {
    /// Whether a network, or a gradient by it, has the symmetry that is asked for.
    fn is_symmetric(&self, parameters: &[f32]) -> bool {
        self.symmetry.as_ref().is_none_or(|symmetry| symmetry.holds(parameters))
    }

    /// The observations' divisors are folded into the first layer: W x / d = (W / d) x.
    fn policy_network(&self) -> Mlp<f32> {
        let mut policy = match self.config.policy_weights {
            PolicyWeights::Online => self.online.clone(),
            PolicyWeights::Target => self.target.clone(),
        };
        let outputs = policy.sizes()[1];
        let columns = policy.layer_mut(0).chunks_exact_mut(outputs);
        for (weights, divisor) in columns.zip(&self.observation_divisors) {
            weights.iter_mut().for_each(|weight| *weight /= divisor);
        }
        policy
    }

    /// ε and the learning rate after `env_steps` environment steps.
    fn apply_schedules(&mut self, env_steps: u64) {
        self.adam.learning_rate = self.config.optimizer.learning_rate().after(env_steps);
        self.exploration.after_step(env_steps);
    }
}

fn scale(observation: &[f32], divisors: &[f32], scaled: &mut [f32]) {
    debug_assert_eq!(observation.len(), divisors.len());
    for ((scaled, value), divisor) in scaled.iter_mut().zip(observation).zip(divisors) {
        *scaled = value / divisor;
    }
}
