//! What is particular to the config of a DQN.

use serde_json::json;

use super::layer::invalid;
use super::{Config, ConfigError, MAX_MEMORY};
use crate::agent::{DqnConfig, PolicyWeights, ReplayConfig, TargetUpdate};
use crate::nn::Symmetry;
use crate::trainer::Budget;

/// Checks the rules that concern several keys of a DQN.
pub(super) fn check(config: &Config, dqn: &DqnConfig, origin: &str) -> Result<(), ConfigError> {
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
            !dqn.network.symmetric || Symmetry::fits(&dqn.network.hidden),
            "network.hidden",
            json!(dqn.network.hidden),
            "an even number of units for each hidden layer, at least one layer, because `network.symmetric` pairs them; or set \
             that to false"
                .into(),
        ),
        (
            !(dqn.network.symmetric && dqn.replay.mirror),
            "replay.mirror",
            json!(true),
            "false where `network.symmetric` is true: each sample already teaches its mirror image".into(),
        ),
        (
            config.memory() <= MAX_MEMORY,
            "network.hidden",
            json!(dqn.network.hidden),
            format!(
                "smaller layers: with `replay.batch_size` {batch_size} and `replay.capacity` {capacity} the run \
                 would take about {} GiB of memory; at most {} are allowed",
                config.memory().div_ceil(1 << 30),
                MAX_MEMORY >> 30
            ),
        ),
    ];
    match rules.into_iter().find(|(holds, ..)| !holds) {
        Some((_, key, value, allowed)) => Err(invalid(origin, key, &value, allowed)),
        None => Ok(()),
    }
}
