//! What is particular to the config of a table: its default, its size, and whether it fits a task.

use serde_json::json;

use super::layer::invalid;
use super::{AgentMemory, AgentRules, ConfigError};
use crate::agent::{AgentConfig, Bins, DqnConfig, QTableConfig, TableConfig};
use crate::env::Spec;
use crate::nn::LearningRate;

/// Most memory of a table, in bytes.
const MAX_BYTES: u64 = 1 << 30;

/// A few cells for the cart and the pole: where the cart is does not count. The rest is as in the default of a DQN, apart
/// from the learning rate: Adam's would move a table's values hardly at all.
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
    fn check_task(&self, origin: &str, task: &Spec) -> Result<(), ConfigError> {
        check(&self.table, origin, task)
    }

    fn mirrored(&self) -> Option<&'static str> {
        self.table.mirror.then_some("table.mirror")
    }

    fn memory(&self, _: usize, num_actions: usize) -> AgentMemory {
        AgentMemory { learned: bytes(&self.table, num_actions), ..AgentMemory::default() }
    }

    fn sizes(&self) -> String {
        format!("`table.bins` {}", json!(self.table.bins))
    }
}

/// About how many bytes a table takes: its values and visits, in the agent and in the best policy.
fn bytes(table: &TableConfig, num_actions: usize) -> u64 {
    let cells = table.bins.iter().fold(1, |cells: u64, bins| cells.saturating_mul(bins.count() as u64));
    cells.saturating_mul(24 * num_actions as u64)
}

fn check(table: &TableConfig, origin: &str, task: &Spec) -> Result<(), ConfigError> {
    let TableConfig { bins, low, high, .. } = table;
    let size = task.observation_size;
    let names = task.observations.join(", ");
    let lists = [
        ("table.bins", bins.len(), json!(bins)),
        ("table.low", low.len(), json!(low)),
        ("table.high", high.len(), json!(high)),
    ];
    if let Some((key, _, value)) = lists.iter().find(|(_, length, _)| *length != size) {
        let allowed =
            format!("a list with one entry for each of the {size} observation coordinates ({names})");
        return Err(invalid(origin, key, value, allowed));
    }
    if bytes(table, task.num_actions) > MAX_BYTES {
        let allowed =
            format!("fewer cells: the table would take more than {} GiB of memory", MAX_BYTES >> 30);
        return Err(invalid(origin, "table.bins", &json!(bins), allowed));
    }
    for (k, edges) in table.edges().iter().enumerate() {
        if edges.is_sorted_by(|a, b| a < b) {
            continue;
        }
        let (key, value, allowed) = match bins[k] {
            Bins::Edges(_) => ("table.bins", json!(bins), format!("edges of coordinate {k} that ascend")),
            Bins::Equal(count) => {
                let allowed =
                    format!("below `table.high` in coordinate {k}, with room for {count} cells in f32");
                ("table.low", json!(low), allowed)
            }
        };
        return Err(invalid(origin, key, &value, allowed));
    }
    Ok(())
}
