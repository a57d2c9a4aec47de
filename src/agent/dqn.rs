//! Deep Q-learning (Mnih et al. 2015, "Human-level control through deep reinforcement learning", algorithm 1).

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use super::statistics::{Probes, Statistics};
use super::{
    Exploration, Minibatch, Policy, PolicyWeights, Replay, ReplayConfig, TargetUpdate, Transition,
    UpdateMode, argmax, td,
};
use crate::mirror::Mirror;
use crate::nn::{Activations, Adam, Loss, Mlp, NetworkConfig, OptimizerConfig, clip_norm};
use crate::rng::{Rng, Stream};

/// When to learn.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LearnConfig {
    /// Environment steps between learning steps, at least 1.
    pub every_steps: u64,
    /// Minibatches per learning step, at least 1.
    pub updates: u32,
}

/// Settings of [`Dqn`]; each is a key of the config.
#[derive(Clone, Debug, PartialEq)]
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

/// The agent.
#[derive(Clone, Debug)]
pub struct Dqn {
    config: DqnConfig,
    /// What each coordinate of an observation is divided by before anything else sees it.
    observation_divisors: Vec<f32>,
    /// With which samples of a minibatch are reflected, if they are.
    mirror: Option<Mirror>,
    /// Chooses the actions and learns.
    pub online: Mlp<f32>,
    /// Bootstraps the targets: an older copy or a running mean of `online`. Without a target network it is copied at
    /// each update.
    pub target: Mlp<f32>,
    /// The optimiser of `online`.
    pub adam: Adam<f32>,
    /// What has happened.
    pub replay: Replay,
    /// Probability of a random action.
    pub epsilon: f64,
    /// Draws exploration.
    pub explore_rng: Rng,
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
    observation: Vec<f32>,
    next_observation: Vec<f32>,
}

/// A loss, a gradient or a weight became NaN or infinite.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NotFinite {
    /// The loss of a minibatch.
    #[error("the loss")]
    Loss,
    /// The gradient of a minibatch. Adam's step makes a weight of it that is not finite either.
    #[error("the gradient")]
    Gradient,
    /// A weight after Adam's step.
    #[error("a weight")]
    Weight,
}

impl Dqn {
    /// An agent that knows nothing yet, its streams spawned from `seed`.
    pub fn new(config: DqnConfig, observation_size: usize, num_actions: usize, seed: u64) -> Self {
        let online =
            Mlp::new(&config.network, observation_size, num_actions, &mut Rng::spawn(seed, Stream::Init));
        let (batch_size, updates) = match config.replay.update {
            UpdateMode::Minibatch => (config.replay.batch_size, 1),
            UpdateMode::PerSample => (1, config.replay.batch_size),
        };
        let buffers = Buffers::new(batch_size, updates, online.sizes());
        let observation_divisors = match &config.observation_divisors {
            Some(scale) => scale.iter().map(|&scale| scale as f32).collect(),
            None => vec![1.0; observation_size],
        };
        Self {
            target: online.clone(),
            adam: Adam::new(config.optimizer.adam(), online.parameters().len()),
            replay: Replay::new(config.replay.capacity, observation_size),
            epsilon: config.exploration.initial_epsilon(),
            explore_rng: Rng::spawn(seed, Stream::Explore),
            replay_rng: Rng::spawn(seed, Stream::Replay),
            observation_divisors,
            mirror: None,
            online,
            buffers,
            config,
        }
    }

    /// The same agent, which reflects half of its samples: the task is its own mirror image.
    #[must_use]
    pub fn with_mirror(mut self, mirror: Mirror) -> Self {
        self.mirror = Some(mirror.of_divided(&self.observation_divisors));
        self
    }

    /// Gives the agent the schedules of another config after `env_steps` environment steps.
    pub fn set_schedules(&mut self, config: &DqnConfig, env_steps: u64) {
        self.config.optimizer = config.optimizer;
        self.config.exploration = config.exploration;
        self.adam.learning_rate = config.optimizer.learning_rate_after(env_steps);
        self.epsilon = config.exploration.after_step(self.epsilon, env_steps);
    }

    /// Remembers what an action brought.
    pub fn observe(&mut self, transition: Transition) {
        let terminated =
            transition.terminated || (transition.truncated && self.config.truncation_is_terminal);
        let Buffers { observation, next_observation, .. } = &mut self.buffers;
        scale(transition.observation, &self.observation_divisors, observation);
        scale(transition.next_observation, &self.observation_divisors, next_observation);
        let reward = transition.reward * self.config.reward_scale as f32;
        self.replay.push(Transition { observation, next_observation, reward, terminated, ..transition });
    }

    /// Whether the agent learns after environment step `env_steps`.
    pub fn learns_at(&self, env_steps: u64) -> bool {
        env_steps.is_multiple_of(self.config.learn.every_steps)
            && env_steps >= self.config.replay.warmup_steps
            && self.replay.len() >= self.config.replay.batch_size
    }

    /// The minibatch of the latest update, its targets, and its gradient as Adam got it.
    pub fn latest_update(&self) -> (&Minibatch, &[f32], &Mlp<f32>) {
        (&self.buffers.minibatch, &self.buffers.targets, &self.buffers.gradient)
    }

    /// One learning step; returns its mean loss.
    pub fn learn(&mut self) -> Result<f32, NotFinite> {
        let (mut sum, mut count) = (0.0, 0.0);
        for _ in 0..self.config.learn.updates {
            let mut ages = std::mem::take(&mut self.buffers.ages);
            self.replay.sample(&mut self.replay_rng, &mut ages);
            for ages in ages.chunks_exact(self.buffers.targets.len()) {
                sum += self.update(ages)?;
                count += 1.0;
            }
            self.buffers.ages = ages;
        }
        if let TargetUpdate::Soft { tau } = self.config.target {
            self.target.move_towards(&self.online, tau as f32);
        }
        Ok(sum / count)
    }

    /// Replaces every sample of the minibatch by its mirror image with probability ½.
    fn reflect(&mut self) {
        let (Some(mirror), Buffers { minibatch, row, .. }) = (&self.mirror, &mut self.buffers) else {
            return;
        };
        for sample in 0..minibatch.actions.len() {
            if self.replay_rng.below(2) == 1 {
                minibatch.reflect(sample, mirror, row);
            }
        }
    }

    /// One gradient step on the minibatch of the transitions with these ages; returns its loss.
    ///
    /// # Errors
    /// When the numbers leave the finite.
    pub fn update(&mut self, ages: &[usize]) -> Result<f32, NotFinite> {
        let DqnConfig { n_step, gamma, .. } = self.config;
        self.replay.gather(ages, n_step, gamma as f32, &mut self.buffers.minibatch);
        self.reflect();
        if self.config.target == TargetUpdate::None {
            self.target.copy_from(&self.online);
        }
        let loss = self.buffers.backpropagate(&self.config, &self.online, &self.target);
        let gradient = &mut self.buffers.gradient;
        if let Some(max_norm) = self.config.optimizer.max_gradient_norm {
            clip_norm(gradient.parameters_mut(), max_norm);
        }
        let finite = self.adam.step(self.online.parameters_mut(), gradient.parameters());

        match (loss.is_finite(), finite) {
            (false, _) => Err(NotFinite::Loss),
            (true, false) if !gradient.parameters().iter().all(|g| g.is_finite()) => Err(NotFinite::Gradient),
            (true, false) => Err(NotFinite::Weight),
            (true, true) => Ok(loss),
        }
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

    /// The loss of the minibatch, and into `gradient` its gradient by the online network's parameters.
    fn backpropagate(
        &mut self,
        config: &DqnConfig,
        online_network: &Mlp<f32>,
        target_network: &Mlp<f32>,
    ) -> f32 {
        let Self { minibatch, targets, next_q, activations, gradient, .. } = self;
        let Minibatch { observations, actions, rewards, discounts, next_observations, terminated, .. } =
            minibatch;

        activations.set_input(next_observations);
        if config.double {
            online_network.forward(activations);
            next_q.copy_from(activations.output());
        }
        target_network.forward(activations);
        if config.double {
            td::double_targets(discounts, rewards, terminated, next_q, activations.output(), targets);
        } else {
            td::targets(discounts, rewards, terminated, activations.output(), targets);
        }

        activations.set_input(observations);
        online_network.forward(activations);
        let (q, q_gradient) = activations.output_and_gradient_mut();
        let loss = td::loss(config.loss, q, actions, targets, q_gradient);

        online_network.backward(activations, gradient);
        loss
    }
}

impl Dqn {
    /// Follows the schedules of ε, of the learning rate and of the target network after environment step `env_steps`.
    pub fn after_step(&mut self, env_steps: u64) {
        self.adam.learning_rate = self.config.optimizer.learning_rate_after(env_steps);
        self.epsilon = self.config.exploration.after_step(self.epsilon, env_steps);
        if let TargetUpdate::EverySteps(period) = self.config.target
            && env_steps.is_multiple_of(period)
        {
            self.target.copy_from(&self.online);
        }
    }

    /// Follows the schedules after episode `episode`, counted from 0.
    pub fn after_episode(&mut self, episode: u64) {
        self.epsilon = self.config.exploration.after_episode(self.epsilon);
        if let TargetUpdate::EveryEpisodes(period) = self.config.target
            && episode.is_multiple_of(period)
        {
            self.target.copy_from(&self.online);
        }
    }
}

impl Policy for Dqn {
    /// ε-greedy: a random action if a uniform draw is at most ε, else the one with the largest Q-value.
    fn act(&mut self, observation: &[f32]) -> usize {
        if self.explore_rng.unit() <= self.epsilon {
            return self.explore_rng.below(self.buffers.acting.output().ncols() as u64) as usize;
        }
        scale(observation, &self.observation_divisors, self.buffers.acting.input_mut().as_mut_slice());
        self.online.forward(&mut self.buffers.acting);
        argmax(self.buffers.acting.output(), 0)
    }

    fn q_values(&self) -> Vec<f32> {
        let q = self.buffers.acting.output().iter();
        q.map(|&q| (f64::from(q) / self.config.reward_scale) as f32).collect()
    }
}

impl Dqn {
    /// The network to be evaluated and saved, for observations as the environment gives them: their scale is folded
    /// into the first layer, W x / scale = (W / scale) x.
    pub fn policy(&self) -> Mlp<f32> {
        let mut policy = match self.config.policy_weights {
            PolicyWeights::Online => self.online.clone(),
            PolicyWeights::Target => self.target.clone(),
        };
        let outputs = policy.sizes()[1];
        for (weights, scale) in policy.layer_mut(0).chunks_exact_mut(outputs).zip(&self.observation_divisors)
        {
            weights.iter_mut().for_each(|weight| *weight /= scale);
        }
        policy
    }
}

impl Dqn {
    /// The inverse of [`Self::policy`]: makes both networks a policy for observations as the environment gives them,
    /// of the same layer sizes. False if a weight leaves the finite under the agent's observation scale.
    #[must_use]
    pub fn set_policy(&mut self, policy: &Mlp<f32>) -> bool {
        self.online.copy_from(policy);
        let outputs = policy.sizes()[1];
        let columns = self.online.layer_mut(0).chunks_exact_mut(outputs);
        for (weights, scale) in columns.zip(&self.observation_divisors) {
            weights.iter_mut().for_each(|weight| *weight *= scale);
        }
        self.target.copy_from(&self.online);
        self.online.parameters().iter().all(|parameter| parameter.is_finite())
    }
}

impl Dqn {
    /// What learning looks like from inside; see [`Statistics`].
    pub fn statistics(&self, probes: &Probes) -> Statistics {
        let batch_size = self.replay.len().min(Statistics::TRANSITIONS);
        let mut buffers = Buffers::new(batch_size, 1, self.online.sizes());
        for (index, age) in buffers.ages.iter_mut().enumerate() {
            *age = index * self.replay.len() / batch_size;
        }
        let DqnConfig { n_step, gamma, reward_scale, .. } = self.config;
        self.replay.gather(&buffers.ages, n_step, gamma as f32, &mut buffers.minibatch);
        buffers.backpropagate(&self.config, &self.online, &self.target);
        let (q, actions) = (buffers.activations.output(), &buffers.minibatch.actions);
        let td_errors = buffers.targets.iter().enumerate().map(|(sample, target)| {
            f64::from(q[(sample, usize::from(actions[sample]))] - target).abs() / reward_scale
        });
        let terminal = self.replay.terminal_transitions() as f64 / self.replay.len() as f64;
        Statistics::new(
            &self.policy(),
            probes,
            reward_scale,
            terminal,
            td_errors.collect(),
            &buffers.gradient,
        )
    }
}

fn scale(observation: &[f32], scale: &[f32], scaled: &mut [f32]) {
    debug_assert_eq!(observation.len(), scale.len());
    for ((scaled, value), scale) in scaled.iter_mut().zip(observation).zip(scale) {
        *scaled = value / scale;
    }
}
