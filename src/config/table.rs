//! The config of a table: its default, its size, and whether it fits a task.

use serde_json::json;

use super::{AgentMemory, AgentRules, Rule, mirror_rule};
use crate::agent::{AgentConfig, Bins, DqnConfig, QTableConfig, TableConfig};
use crate::env::Spec;
use crate::nn::LearningRate;

/// Most memory of a table, in bytes.
const MAX_BYTES: u64 = 1 << 30;

/// A few cells; where the cart is does not count. The rest is as in a DQN, but for the learning rate, Adam's being too small.
pub(super) fn default(dqn: &DqnConfig) -> AgentConfig {
    AgentConfig::QTable(QTableConfig {
        table: TableConfig {
            bins: vec![Bins::Equal(1), Bins::Equal(1), Bins::Equal(6), Bins::Equal(3)],
            low: vec![-2.4, -3.0, -0.2095, -2.0],
            high: vec![2.4, 3.0, 0.2095, 2.0],
            initial: 0.0,
            mirror: false,
        },
        optimizer: LearningRate { learning_rate: 0.1, schedule: None },
        gamma: dqn.gamma,
        exploration: dqn.exploration,
    })
}

impl AgentRules for QTableConfig {
    fn task_rules(&self, task: &Spec) -> Vec<Rule> {
        let TableConfig { bins, low, high, mirror, .. } = &self.table;
        let size = task.observation_size;
        let names = task.observations.join(", ");
        let each = format!("a list with one entry for each of the {size} observation coordinates ({names})");
        let mut rules = vec![
            (bins.len() == size, "table.bins", json!(bins), each.clone()),
            (low.len() == size, "table.low", json!(low), each.clone()),
            (high.len() == size, "table.high", json!(high), each),
        ];
        if rules.iter().any(|(fits, ..)| !fits) {
            return rules;
        }
        let fewer = format!("fewer cells: the table would take more than {} GiB of memory", MAX_BYTES >> 30);
        let is_small = self.memory(size, task.num_actions).learned <= MAX_BYTES;
        rules.push((is_small, "table.bins", json!(bins), fewer));
        for (k, edges) in self.table.edges().iter().enumerate().filter(|_| is_small) {
            let (key, value, allowed) = match bins[k] {
                Bins::Edges(_) => ("table.bins", json!(bins), format!("edges of coordinate {k} that ascend")),
                Bins::Equal(count) => {
                    let room =
                        format!("below `table.high` in coordinate {k}, with room for {count} cells in f32");
                    ("table.low", json!(low), room)
                }
            };
            rules.push((edges.is_sorted_by(|a, b| a < b), key, value, allowed));
        }
        rules.push(mirror_rule("table.mirror", *mirror, task));
        rules
    }

    /// About: the values and visits of the table, in the agent and in the best policy.
    fn memory(&self, _: usize, num_actions: usize) -> AgentMemory {
        let count = |cells: u64, bins: &Bins| cells.saturating_mul(bins.count() as u64);
        let cells = self.table.bins.iter().fold(1, count);
        AgentMemory { learned: cells.saturating_mul(24 * num_actions as u64), ..AgentMemory::default() }
    }

    fn sizes(&self) -> String {
        format!("`table.bins` {}", json!(self.table.bins))
    }
}
