//! The config of a DQN: its default, and the rules between several keys.

use serde_json::json;

use super::keys::SCALE;
use super::{AgentMemory, AgentRules, Config, MAX_MEMORY, Rule, mirror_rule};
use crate::agent::{
    DqnConfig, Exploration, LearnConfig, PolicyWeights, ReplayConfig, TargetUpdate, UpdateMode,
};
use crate::env::Spec;
use crate::nn::{Init, Loss, NetworkConfig, OptimizerConfig};
use crate::trainer::Budget;

/// The agent of `configs/cartpole.json`.
pub(super) fn default() -> DqnConfig {
    DqnConfig {
        network: NetworkConfig { hidden: vec![24, 24], init: Init::Torch },
        optimizer: OptimizerConfig {
            learning_rate: 3e-3,
            beta1: 0.9,
            beta2: 0.999,
            epsilon: 1e-8,
            max_gradient_norm: None,
            schedule: None,
        },
        loss: Loss::Mse,
        gamma: 0.999,
        n_step: 8,
        double: false,
        replay: ReplayConfig {
            capacity: 20_000,
            batch_size: 32,
            warmup_steps: 500,
            update: UpdateMode::Minibatch,
            mirror: true,
        },
        learn: LearnConfig { every_steps: 1, updates: 1 },
        exploration: Exploration::Linear { initial: 1.0, final_: 0.2, steps: 1500, repeat: 1 },
        target: TargetUpdate::Soft { tau: 0.02 },
        truncation_is_terminal: false,
        observation_divisors: None,
        reward_scale: 0.01,
        policy_weights: PolicyWeights::Target,
    }
}

impl AgentRules for DqnConfig {
    fn rules(&self, config: &Config) -> Vec<Rule> {
        let AgentMemory { replay, learned, batch, .. } = config.memory();
        let memory = replay + learned + batch;
        let ReplayConfig { capacity, batch_size, warmup_steps, .. } = self.replay;
        let every = self.learn.every_steps;
        // The learning step in which the memory holds enough; the warm-up alone would leave nothing to train.
        let first_update = warmup_steps.max(batch_size as u64).checked_next_multiple_of(every);
        let least_steps = first_update.unwrap_or(u64::MAX).max(warmup_steps.saturating_add(1));
        let steps = if let Budget::Steps(steps) = config.budget { steps } else { u64::MAX };
        let enough = format!(
            "at least {least_steps}, or nothing is learned (`replay.warmup_steps` is {warmup_steps}, \
             `replay.batch_size` {batch_size}, `learn.every_steps` {every})"
        );
        let weights = format!(
            "\"online\"; \"target\" only if `target.kind` is \"soft\", and `target` is {}",
            json!(self.target)
        );
        let smaller = format!(
            "smaller layers: with `replay.batch_size` {batch_size} and `replay.capacity` {capacity} the run would take \
             about {} GiB of memory; at most {} are allowed",
            memory.div_ceil(1 << 30),
            MAX_MEMORY >> 30
        );
        let at_most = format!("at most `replay.capacity`, which is {capacity}");
        let is_online = self.policy_weights == PolicyWeights::Online;
        let is_soft = matches!(self.target, TargetUpdate::Soft { .. });
        vec![
            (batch_size <= capacity, "replay.batch_size", json!(batch_size), at_most),
            (steps >= least_steps, "budget.steps", json!(steps), enough),
            (is_online || is_soft, "policy_weights", json!(self.policy_weights), weights),
            (memory <= MAX_MEMORY, "network.hidden", json!(self.network.hidden), smaller),
        ]
    }

    fn task_rules(&self, task: &Spec) -> Vec<Rule> {
        let (size, divisors) = (task.observation_size, &self.observation_divisors);
        let fits = divisors.as_ref().is_none_or(|divisors| divisors.len() == size);
        let allowed = format!(
            "null or a list with {SCALE} for each of the {size} observation coordinates of {}; each task has a config of its \
             own in configs/",
            task.id
        );
        vec![
            (fits, "observation_divisors", json!(divisors), allowed),
            mirror_rule("replay.mirror", self.replay.mirror, task),
        ]
    }

    fn memory(&self, observation_size: usize, num_actions: usize) -> AgentMemory {
        let sizes = self.network.sizes(observation_size, num_actions);
        let parameters: usize = sizes.windows(2).map(|pair| (pair[0] + 1) * pair[1]).sum();
        let units: usize = sizes.iter().sum();
        let transition = 4 * observation_size as u64 + 8;
        let (replay, learned) = (transition * self.replay.capacity as u64, 32 * parameters as u64);
        let batch = 16 * (self.replay.batch_size * units) as u64;
        AgentMemory { replay, transition, learned, batch }
    }

    fn sizes(&self) -> String {
        let Self { network, replay, .. } = self;
        format!(
            "`replay.capacity` {}, `replay.batch_size` {} and `network.hidden` {:?}",
            replay.capacity, replay.batch_size, network.hidden
        )
    }
}
