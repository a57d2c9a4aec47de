//! The target network: how it follows the online network, and whether it is the policy.

use serde::{Deserialize, Serialize};

/// How the target network follows the online network.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum TargetUpdate {
    /// `{"kind": "hard", "every_steps": N}`, or `every_episodes`: copied from time to time.
    Hard(Period),
    /// `{"kind": "soft", "tau": τ}`: after every learning step θ⁻ ← θ⁻ + τ (θ − θ⁻), 0 < τ ≤ 1 (Lillicrap et al. 2016).
    Soft { tau: f64 },
    /// `{"kind": "none"}`: no target network, the online network bootstraps itself.
    None,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Period {
    /// After every N-th episode, the very first one included.
    EveryEpisodes(u64),
    /// After every N-th environment step.
    EverySteps(u64),
}

/// Which network is evaluated and saved as the policy. With a soft target network its weights are a running mean
/// of the online network's, which is steadier than any of them (Polyak and Juditsky 1992).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum PolicyWeights {
    /// The network that acts and learns.
    Online,
    /// The target network; only with [`TargetUpdate::Soft`].
    Target,
}
