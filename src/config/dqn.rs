//! What is particular to the config of a DQN.

use serde_json::json;

use super::keys::SCALE;
use super::layer::invalid;
use super::{AgentMemory, AgentRules, Config, ConfigError, MAX_MEMORY};
use crate::agent::{DqnConfig, PolicyWeights, ReplayConfig, TargetUpdate};
use crate::env::Spec;
use crate::trainer::Budget;

impl AgentRules for DqnConfig {
    fn check(&self, config: &Config, origin: &str) -> Result<(), ConfigError> {
        check(config, self, origin)
    }

    fn check_task(&self, origin: &str, task: &Spec) -> Result<(), ConfigError> {
        let size = task.observation_size;
        match &self.observation_divisors {
            Some(divisors) if divisors.len() != size => {
                let allowed = format!(
                    "null or a list with {SCALE} for each of the {size} observation coordinates of {}; each task has a config \
                     of its own in configs/",
                    task.id
                );
                Err(invalid(origin, "observation_divisors", &json!(divisors), allowed))
            }
            _ => Ok(()),
        }
    }

    fn mirrored(&self) -> Option<&'static str> {
        self.replay.mirror.then_some("replay.mirror")
    }

    fn memory(&self, observation_size: usize, num_actions: usize) -> AgentMemory {
        let sizes = self.network.sizes(observation_size, num_actions);
        let parameters: usize = sizes.windows(2).map(|pair| (pair[0] + 1) * pair[1]).sum();
        let units: usize = sizes.iter().sum();
        let transition = 4 * observation_size as u64 + 8;
        AgentMemory {
            replay: transition * self.replay.capacity as u64,
            transition,
            learned: 32 * parameters as u64,
            batch: 16 * (self.replay.batch_size * units) as u64,
        }
    }

    fn sizes(&self) -> String {
        let Self { network, replay, .. } = self;
        format!(
            "`replay.capacity` {}, `replay.batch_size` {} and `network.hidden` {:?}",
            replay.capacity, replay.batch_size, network.hidden
        )
    }
}

fn check(config: &Config, dqn: &DqnConfig, origin: &str) -> Result<(), ConfigError> {
    let AgentMemory { replay, learned, batch, .. } = config.memory();
    let memory = replay + learned + batch;
    let ReplayConfig { capacity, batch_size, warmup_steps, .. } = dqn.replay;
    let every = dqn.learn.every_steps;
    // The learning step in which the memory holds enough; the warm-up alone would leave nothing to train.
    let first_update = warmup_steps.max(batch_size as u64).checked_next_multiple_of(every);
    let least_steps = first_update.unwrap_or(u64::MAX).max(warmup_steps.saturating_add(1));
    let steps = if let Budget::Steps(steps) = config.budget { steps } else { u64::MAX };

    let enough = format!(
        "at least {least_steps}, or nothing is learned (`replay.warmup_steps` is {warmup_steps}, \
         `replay.batch_size` {batch_size}, `learn.every_steps` {every})"
    );
    let rules = [
        (
            batch_size <= capacity,
            "replay.batch_size",
            json!(batch_size),
            format!("at most `replay.capacity`, which is {capacity}"),
        ),
        (steps >= least_steps, "budget.steps", json!(steps), enough),
        (
            dqn.policy_weights == PolicyWeights::Online || matches!(dqn.target, TargetUpdate::Soft { .. }),
            "policy_weights",
            json!(dqn.policy_weights),
            format!(
                "\"online\"; \"target\" only if `target.kind` is \"soft\", and `target` is {}",
                json!(dqn.target)
            ),
        ),
        (
            memory <= MAX_MEMORY,
            "network.hidden",
            json!(dqn.network.hidden),
            format!(
                "smaller layers: with `replay.batch_size` {batch_size} and `replay.capacity` {capacity} the run \
                 would take about {} GiB of memory; at most {} are allowed",
                memory.div_ceil(1 << 30),
                MAX_MEMORY >> 30
            ),
        ),
    ];
    match rules.into_iter().find(|(holds, ..)| !holds) {
        Some((_, key, value, allowed)) => Err(invalid(origin, key, &value, allowed)),
        None => Ok(()),
    }
}
