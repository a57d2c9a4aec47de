//! One update of a training run, with everything that went into it and came of it.

use crate::agent::{Dqn, DqnConfig, Minibatch, NotFinite, TargetUpdate};
use crate::check::Settings;
use crate::nn::Mlp;
use crate::tensors::Tensors;

#[derive(Clone, Debug)]
pub struct ExplainedUpdate {
    pub seed: u64,
    pub config: DqnConfig,
    /// The environment step after which it was done.
    pub env_steps: u64,
    /// Complete episodes before it.
    pub episodes: u64,
    pub before: Dqn,
    pub after: Dqn,
    pub(crate) minibatch: Minibatch,
    pub targets: Vec<f32>,
    pub loss: f32,
    pub(crate) gradient: Mlp<f32>,
}

#[derive(Debug, thiserror::Error)]
pub enum ExplainError {
    #[error(
        "the run ends after update {0}; give --update a number from 1 to that, or let the run be longer: a larger \
         budget.steps, or stop_when_lasting_steps=null where a policy that lasts ends it"
    )]
    TooFar(u64),
    #[error(transparent)]
    Environment(#[from] crate::env::EnvironmentError),
    #[error(
        "an update of a network can be explained, and this config trains a table; docs/q_learning.md has its update"
    )]
    NoDqn,
    #[error(transparent)]
    Train(#[from] crate::trainer::TrainError),
    #[error("in this update {0} becomes NaN or infinite")]
    NotFinite(#[from] NotFinite),
}

/// Trains to update `number`, counted from 1, and does it.
pub fn explain(config: &crate::config::Config, number: u64) -> Result<ExplainedUpdate, ExplainError> {
    let mut unevaluated = config.clone();
    if !config.stop_when_solved && config.stop_when_lasting_steps.is_none() {
        // Evaluations change nothing in a run.
        unevaluated.evaluation.every_steps = u64::MAX;
    }
    let dqn = config.agent.as_dqn().ok_or(ExplainError::NoDqn)?;
    let samples = dqn.replay.batch_size;
    let update_size = dqn.replay.update_size();
    let updates_of_a_step = u64::from(dqn.learn.updates).saturating_mul((samples / update_size) as u64);
    let mut trainer = unevaluated.make_trainer()?;
    while trainer.end_reason().is_none() {
        let before = trainer.agent().as_dqn().ok_or(ExplainError::NoDqn)?;
        let is_near = before.adam.steps.saturating_add(updates_of_a_step) >= number;
        let learned =
            |dqn: &Dqn| (dqn.online.clone(), dqn.target.clone(), dqn.adam.clone(), dqn.replay_rng.clone());
        let state = is_near.then(|| learned(before));
        let (env_steps, episodes) = (trainer.progress().env_steps + 1, trainer.progress().episodes);
        let steps = before.adam.steps;
        let result = trainer.step(&mut Vec::<crate::trainer::Event>::new());
        let after = trainer.agent().as_dqn().ok_or(ExplainError::NoDqn)?;
        let Some((online, target, adam, replay_rng)) = state.filter(|_| after.adam.steps > steps) else {
            result?;
            continue;
        };
        // The replay memory is still that which this learning step has drawn from.
        let mut agent = trainer.agent().as_dqn().ok_or(ExplainError::NoDqn)?.clone();
        (agent.online, agent.target, agent.adam, agent.replay_rng) = (online, target, adam, replay_rng);
        let mut ages = vec![0; samples];
        loop {
            agent.replay.sample(&mut agent.replay_rng, &mut ages);
            for ages in ages.chunks_exact(update_size) {
                let before = (agent.adam.steps + 1 == number).then(|| agent.clone());
                let loss = agent.update(ages)?;
                let Some(before) = before else { continue };
                let (minibatch, targets, gradient) = agent.latest_update();
                return Ok(ExplainedUpdate {
                    seed: config.seed,
                    config: dqn.clone(),
                    env_steps,
                    episodes,
                    minibatch: minibatch.clone(),
                    targets: targets.to_vec(),
                    gradient: gradient.clone(),
                    loss,
                    before,
                    after: agent,
                });
            }
        }
    }
    Err(ExplainError::TooFar(trainer.agent().counters().updates))
}

impl ExplainedUpdate {
    /// The network that values the next observations.
    pub(crate) fn target(&self) -> &Mlp<f32> {
        if self.has_target() { &self.before.target.mlp } else { &self.before.online.mlp }
    }

    /// Whether that is another one than the one that learns.
    pub(crate) fn has_target(&self) -> bool {
        self.config.target != TargetUpdate::None
    }

    pub fn settings(&self) -> Settings {
        let DqnConfig { gamma, loss, double, optimizer, .. } = &self.config;
        Settings {
            gamma: *gamma,
            loss: *loss,
            double: *double,
            learning_rate: self.before.adam.learning_rate,
            beta1: optimizer.beta1,
            beta2: optimizer.beta2,
            epsilon: optimizer.epsilon,
            max_gradient_norm: optimizer.max_gradient_norm,
            ..Settings::default()
        }
    }

    pub fn tensors(&self) -> Tensors {
        let mut file = Tensors::default();
        file.put_network("online.", &self.before.online.mlp);
        if self.has_target() {
            file.put_network("target.", &self.before.target.mlp);
        }
        let adam = &self.before.adam;
        if adam.steps > 0 {
            let moments = |values: &[f32]| {
                let mut network = self.before.online.mlp.clone();
                network.parameters_mut().copy_from_slice(values);
                network
            };
            file.put("adam.steps", &[1], &[adam.steps]);
            file.put_network("adam.m.", &moments(&adam.first_moment));
            file.put_network("adam.v.", &moments(&adam.second_moment));
        }
        let Minibatch { observations, actions, rewards, discounts, next_observations, terminated } =
            &self.minibatch;
        let (batch, inputs) = observations.shape();
        for (name, values) in [("observations", observations), ("next_observations", next_observations)] {
            file.put(&format!("batch.{name}"), &[batch, inputs], values.transpose().as_slice());
        }
        let flags: Vec<u8> = terminated.iter().copied().map(u8::from).collect();
        file.put("batch.actions", &[batch], actions);
        file.put("batch.terminated", &[batch], &flags);
        file.put("batch.rewards", &[batch], rewards);
        file.put("batch.discounts", &[batch], discounts);
        file.put("result.targets", &[batch], &self.targets);
        file.put("result.loss", &[1], &[self.loss]);
        file.put_network("result.gradients.", &self.gradient);
        file.put_network("result.online.", &self.after.online.mlp);
        file
    }
}
