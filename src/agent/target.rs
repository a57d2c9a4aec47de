//! The target network: how it follows the online network, and whether it is the policy.

use serde::{Deserialize, Serialize};

/// How the target network follows the online network.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(from = "WrittenTarget", into = "WrittenTarget")]
pub enum TargetUpdate {
    /// `{"kind": "hard", "every_episodes": N}`: copied after every N-th episode, the very first one included.
    EveryEpisodes(u64),
    /// `{"kind": "hard", "every_steps": N}`: copied after every N-th environment step.
    EverySteps(u64),
    /// `{"kind": "soft", "tau": τ}`: after every learning step θ⁻ ← θ⁻ + τ (θ − θ⁻), 0 < τ ≤ 1 (Lillicrap et al.
    /// 2016).
    Soft {
        /// τ
        tau: f64,
    },
    /// `{"kind": "none"}`: no target network, the online network bootstraps itself.
    None,
}

/// [`TargetUpdate`] as it is written.
#[derive(Clone, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
enum WrittenTarget {
    Hard(Period),
    Soft { tau: f64 },
    None,
}

#[derive(Clone, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Period {
    EveryEpisodes(u64),
    EverySteps(u64),
}

impl From<WrittenTarget> for TargetUpdate {
    fn from(target: WrittenTarget) -> Self {
        match target {
            WrittenTarget::Hard(Period::EveryEpisodes(period)) => Self::EveryEpisodes(period),
            WrittenTarget::Hard(Period::EverySteps(period)) => Self::EverySteps(period),
            WrittenTarget::Soft { tau } => Self::Soft { tau },
            WrittenTarget::None => Self::None,
        }
    }
}

impl From<TargetUpdate> for WrittenTarget {
    fn from(target: TargetUpdate) -> Self {
        match target {
            TargetUpdate::EveryEpisodes(period) => Self::Hard(Period::EveryEpisodes(period)),
            TargetUpdate::EverySteps(period) => Self::Hard(Period::EverySteps(period)),
            TargetUpdate::Soft { tau } => Self::Soft { tau },
            TargetUpdate::None => Self::None,
        }
    }
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
