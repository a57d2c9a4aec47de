//! Deep Q-learning (Mnih et al. 2015, "Human-level control through deep reinforcement learning", algorithm 1).

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use super::statistics::{TRANSITIONS, network_statistics};
use super::{
    Agent, Counters, EpsilonGreedy, Exploration, Minibatch, NamedNumbers, NotFinite, Period, Played, Policy,
    PolicyWeights, Probes, QNetwork, Replay, ReplayConfig, ReplayContents, TargetUpdate, Transition, argmax,
    td,
};
use crate::mirror::Mirror;
use crate::nn::{Activations, Adam, Loss, Mlp, NetworkConfig, OptimizerConfig, clip_norm};
use crate::rng::{Rng, Stream};
use crate::tensors::{TensorError, Tensors, weights_sha256};

#[derive(Clone, Debug)]
pub struct Dqn {
    config: DqnConfig,
    /// Chooses the actions and learns.
    pub online: QNetwork,
    /// Bootstraps the targets: an older copy or a running mean of `online`. Without a target network it is copied at
    /// each update.
    pub target: QNetwork,
    pub adam: Adam<f32>,
    /// What has happened, in divided observations and scaled rewards.
    pub replay: Replay,
    /// Draws minibatches.
    pub replay_rng: Rng,
    /// In which half of the samples are reflected, if they are.
    mirror: Option<Mirror>,
    pub exploration: EpsilonGreedy,
    buffers: Buffers,
}

impl Dqn {
    /// One learning step: `learn.updates` minibatches. Returns their mean loss.
    pub fn learn(&mut self) -> Result<f32, NotFinite> {
        let ReplayConfig { batch_size, .. } = self.config.replay;
        let (mut ages, mut sum, mut count) = (vec![0; batch_size], 0.0, 0.0);
        for _ in 0..self.config.learn.updates {
            self.replay.sample(&mut self.replay_rng, &mut ages);
            for ages in ages.chunks_exact(self.config.replay.update_size()) {
                sum += self.update(ages)?;
                count += 1.0;
            }
        }
        if let TargetUpdate::Soft { tau } = self.config.target {
            self.target.move_towards(&self.online, tau);
        }
        Ok(sum / count)
    }

    /// One gradient step on the minibatch of the transitions with these ages (algorithm 1, the inner loop). Returns its loss.
    pub fn update(&mut self, ages: &[usize]) -> Result<f32, NotFinite> {
        let Self { config, online, target, adam, replay, replay_rng, mirror, buffers, .. } = self;
        let Buffers { minibatch, targets, next_q, activations, gradient, row, .. } = buffers;
        replay.gather(ages, config.n_step, config.gamma as f32, minibatch);
        if let Some(mirror) = mirror {
            minibatch.reflect_half(mirror, replay_rng, row);
        }
        if config.target == TargetUpdate::None {
            target.copy_from(online);
        }
        td_targets(config.double, online, target, minibatch, activations, next_q, targets);
        online.forward(&minibatch.observations, activations);
        let (q, q_gradient) = activations.output_and_gradient_mut();
        let loss = td::loss(config.loss, q, &minibatch.actions, targets, q_gradient);
        online.mlp.backward(activations, gradient);
        if let Some(max_norm) = config.optimizer.max_gradient_norm {
            clip_norm(gradient.parameters_mut(), max_norm);
        }
        let weights_are_finite = adam.step(online.mlp.parameters_mut(), gradient.parameters());
        finite(loss, gradient, weights_are_finite)
    }
}

/// What the Q-values of a minibatch should be: y = r + γᵏ max_a Q_target(s′, a), see [`td::targets`] and
/// [`td::double_targets`]. `activations` and `next_q` are scratch.
fn td_targets(
    double: bool, online: &QNetwork, target: &QNetwork, minibatch: &Minibatch,
    activations: &mut Activations<f32>, next_q: &mut DMatrix<f32>, targets: &mut [f32],
) {
    let Minibatch { rewards, discounts, next_observations, terminated, .. } = minibatch;
    if double {
        online.forward(next_observations, activations);
        next_q.copy_from(activations.output());
        target.forward(next_observations, activations);
        td::double_targets(discounts, rewards, terminated, next_q, activations.output(), targets);
    } else {
        target.forward(next_observations, activations);
        td::targets(discounts, rewards, terminated, activations.output(), targets);
    }
}

/// The loss, or else what left the finite first.
fn finite(loss: f32, gradient: &Mlp<f32>, weights_are_finite: bool) -> Result<f32, NotFinite> {
    match (loss.is_finite(), weights_are_finite) {
        (false, _) => Err(NotFinite::Loss),
        (true, false) if !gradient.parameters().iter().all(|g| g.is_finite()) => Err(NotFinite::Gradient),
        (true, false) => Err(NotFinite::Weight),
        (true, true) => Ok(loss),
    }
}

/// Settings of [`Dqn`]. Each is a key of the config, see `config::keys`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DqnConfig {
    pub network: NetworkConfig,
    pub optimizer: OptimizerConfig,
    pub loss: Loss,
    pub gamma: f64,
    pub(crate) n_step: usize,
    pub double: bool,
    pub replay: ReplayConfig,
    pub learn: LearnConfig,
    pub exploration: Exploration,
    pub target: TargetUpdate,
    pub(crate) truncation_is_terminal: bool,
    pub observation_divisors: Option<Vec<f64>>,
    pub(crate) reward_scale: f64,
    pub(crate) policy_weights: PolicyWeights,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LearnConfig {
    /// Environment steps between learning steps.
    pub every_steps: u64,
    /// Minibatches per learning step.
    pub updates: u32,
}

/// Memory of an update and of acting, allocated once; nothing in it outlives a call.
#[derive(Clone, Debug)]
struct Buffers {
    minibatch: Minibatch,
    targets: Vec<f32>,
    /// What the online network makes of the next observations, for double Q-learning.
    next_q: DMatrix<f32>,
    activations: Activations<f32>,
    gradient: Mlp<f32>,
    /// Of a sample that is being reflected.
    row: Vec<f32>,
    acting: Activations<f32>,
    /// Divided observations.
    observation: Vec<f32>,
    next_observation: Vec<f32>,
}

impl Buffers {
    fn new(batch_size: usize, sizes: &[usize]) -> Self {
        let observation_size = sizes[0];
        Self {
            minibatch: Minibatch::new(batch_size, observation_size),
            targets: vec![0.0; batch_size],
            next_q: DMatrix::zeros(batch_size, sizes[sizes.len() - 1]),
            activations: Activations::new(sizes, batch_size),
            gradient: Mlp::zeros(sizes.to_vec()),
            row: Vec::with_capacity(observation_size),
            acting: Activations::new(sizes, 1),
            observation: vec![0.0; observation_size],
            next_observation: vec![0.0; observation_size],
        }
    }
}

impl Dqn {
    /// An agent that knows nothing yet, its streams spawned from `seed`. With `replay.mirror` it reflects half of its samples
    /// in `mirror`, the mirror image of the task.
    pub fn new(
        config: DqnConfig, observation_size: usize, num_actions: usize, mirror: Option<&Mirror>, seed: u64,
    ) -> Self {
        let divisors = config.observation_divisors.as_deref();
        let mut init = Rng::spawn(seed, Stream::Init);
        let online = QNetwork::new(&config.network, divisors, observation_size, num_actions, &mut init);
        let mirror = mirror.filter(|_| config.replay.mirror);
        Self {
            target: online.clone(),
            adam: Adam::new(config.optimizer, online.mlp.parameters().len()),
            replay: Replay::new(config.replay.capacity, observation_size),
            replay_rng: Rng::spawn(seed, Stream::Replay),
            mirror: mirror.map(|mirror| mirror.of_divided(&online.divisors)),
            exploration: EpsilonGreedy::new(config.exploration, Rng::spawn(seed, Stream::Explore)),
            buffers: Buffers::new(config.replay.update_size(), online.mlp.sizes()),
            online,
            config,
        }
    }

    /// The minibatch of the latest update, its targets, and its gradient as Adam got it.
    pub(crate) fn latest_update(&self) -> (&Minibatch, &[f32], &Mlp<f32>) {
        let Buffers { minibatch, targets, gradient, .. } = &self.buffers;
        (minibatch, targets, gradient)
    }

    fn apply_schedules(&mut self, env_steps: u64) {
        self.adam.learning_rate = self.config.optimizer.learning_rate().after(env_steps);
        self.exploration.after_step(env_steps);
    }

    fn policy_network(&self) -> Mlp<f32> {
        match self.config.policy_weights {
            PolicyWeights::Online => self.online.as_policy(),
            PolicyWeights::Target => self.target.as_policy(),
        }
    }
}

impl Agent for Dqn {
    /// ε-greedy: a random action, or else the one with the largest Q-value.
    fn act(&mut self, observation: &[f32]) -> usize {
        let Self { exploration, online, buffers: Buffers { acting, .. }, .. } = self;
        exploration.explore(acting.output().ncols()).unwrap_or_else(|| {
            online.divide(observation, acting.input_mut().as_mut_slice());
            online.mlp.forward(acting);
            argmax(acting.output(), 0)
        })
    }

    fn observe(&mut self, transition: Transition<'_>) {
        let terminated =
            transition.terminated || (transition.truncated && self.config.truncation_is_terminal);
        let Buffers { observation, next_observation, .. } = &mut self.buffers;
        self.online.divide(transition.observation, observation);
        self.online.divide(transition.next_observation, next_observation);
        let reward = transition.reward * self.config.reward_scale as f32;
        self.replay.push(Transition { observation, next_observation, reward, terminated, ..transition });
    }

    fn learn_if_due(&mut self, env_steps: u64) -> Result<Option<f32>, NotFinite> {
        let is_due = env_steps.is_multiple_of(self.config.learn.every_steps)
            && env_steps >= self.config.replay.warmup_steps
            && self.replay.len() >= self.config.replay.batch_size;
        let loss = if is_due { Some(self.learn()?) } else { None };
        self.apply_schedules(env_steps);
        if let TargetUpdate::Hard(Period::EverySteps(period)) = self.config.target
            && env_steps.is_multiple_of(period)
        {
            self.target.copy_from(&self.online);
        }
        Ok(loss)
    }

    fn end_episode(&mut self, episode: u64) {
        self.exploration.after_episode();
        if let TargetUpdate::Hard(Period::EveryEpisodes(period)) = self.config.target
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
        let Some(online) = QNetwork::from_policy(network, &self.online) else { return false };
        self.online = online;
        self.target.copy_from(&self.online);
        true
    }

    fn gamma(&self) -> f64 {
        self.config.gamma
    }

    fn counters(&self) -> Counters {
        let Adam { steps, learning_rate, .. } = self.adam;
        Counters { updates: steps, epsilon: self.exploration.epsilon, learning_rate }
    }

    /// Of transitions spread evenly over the replay memory, none of them reflected.
    fn statistics(&self, probes: &Probes, played: &[Played]) -> Option<NamedNumbers> {
        let Self { online, target, replay, .. } = self;
        let batch_size = replay.len().min(TRANSITIONS);
        if batch_size == 0 {
            return None;
        }
        let DqnConfig { n_step, gamma, double, loss, reward_scale, .. } = self.config;
        let ages: Vec<usize> = (0..batch_size).map(|i| i * replay.len() / batch_size).collect();
        let mut buffers = Buffers::new(batch_size, online.mlp.sizes());
        let Buffers { minibatch, targets, activations, next_q, gradient, .. } = &mut buffers;
        replay.gather(&ages, n_step, gamma as f32, minibatch);
        td_targets(double, online, target, minibatch, activations, next_q, targets);
        online.forward(&minibatch.observations, activations);
        let (q, q_gradient) = activations.output_and_gradient_mut();
        td::loss(loss, q, &minibatch.actions, targets, q_gradient);
        let td_errors = targets.iter().enumerate().map(|(sample, target)| {
            f64::from(q[(sample, usize::from(minibatch.actions[sample]))] - target).abs() / reward_scale
        });
        let td_errors = td_errors.collect();
        online.mlp.backward(activations, gradient);
        let terminal_share = replay.terminal_transitions() as f64 / replay.len() as f64;
        let network = &self.policy_network();
        Some(network_statistics(network, reward_scale, terminal_share, td_errors, gradient, probes, played))
    }

    fn weights_sha256(&self) -> String {
        weights_sha256(&self.online.mlp)
    }

    fn save(&self, tensors: &mut Tensors) {
        let Self { online, target, adam, replay, .. } = self;
        tensors.put_network("online.", &online.mlp);
        tensors.put_network("target.", &target.mlp);
        tensors.put("adam.steps", &[1], &[adam.steps]);
        tensors.put("adam.first_moment", &[adam.first_moment.len()], &adam.first_moment);
        tensors.put("adam.second_moment", &[adam.second_moment.len()], &adam.second_moment);
        self.exploration.save(tensors);
        tensors.put_rng("replay_rng", &self.replay_rng);
        replay.contents().save(online.mlp.sizes()[0], tensors);
    }

    fn load(&mut self, tensors: &Tensors, env_steps: u64) -> Result<(), TensorError> {
        tensors.get_network("online.", &mut self.online.mlp)?;
        tensors.get_network("target.", &mut self.target.mlp)?;
        let parameters = self.online.mlp.parameters().len();
        self.adam.steps = tensors.get_one("adam.steps")?;
        if self.adam.steps >= 1 << 62 {
            return Err(TensorError::Inconsistent("number of updates"));
        }
        self.adam.first_moment = tensors.get("adam.first_moment", &[parameters])?;
        self.adam.second_moment = tensors.get("adam.second_moment", &[parameters])?;
        self.replay_rng = tensors.get_rng("replay_rng")?;
        let (inputs, outputs) = (self.online.mlp.sizes()[0], self.buffers.acting.output().ncols());
        self.exploration.load(tensors, outputs)?;
        if !self.replay.restore(&ReplayContents::load(inputs, tensors)?, outputs) {
            return Err(TensorError::Inconsistent("replay memory"));
        }
        self.apply_schedules(env_steps);
        Ok(())
    }
}
