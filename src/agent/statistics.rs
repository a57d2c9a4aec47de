//! What learning looks like from inside: the numbers that move before the returns do.

use nalgebra::DMatrix;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::nn::{Activations, Mlp, norm};

/// Observations on which a policy is asked for its Q-values, the same ones during a whole run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Probes {
    pub ordinary: Vec<Vec<f32>>,
    /// Observations after which no action keeps an episode alive for more than a few steps.
    pub doomed: Vec<Vec<f32>>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Played {
    /// Undiscounted return of as many steps as scores count.
    pub total: f64,
    /// Σ γᵗ rₜ
    pub discounted: f64,
    /// max_a Q of the first observation.
    pub expected: f64,
    pub steps: u64,
    pub terminated: bool,
}

/// What is known of a statistic: the one place for its name, its titles and its axis.
#[derive(Clone, Copy, Debug)]
pub struct Statistic {
    /// Its name in `metrics.jsonl`.
    pub name: &'static str,
    /// Its title where there is little room; empty if the terminal does not show the statistic.
    pub(crate) label: &'static str,
    /// Its title over a plot; empty if no plot shows the statistic.
    pub(crate) title: &'static str,
    pub meaning: &'static str,
    pub(crate) is_logarithmic: bool,
}

type Label = &'static str;

const fn statistic(name: Label, label: Label, title: Label, meaning: Label) -> Statistic {
    Statistic { name, label, title, meaning, is_logarithmic: false }
}

/// Every statistic of every agent, the most telling first. Values and errors are in units of the environment's rewards.
#[rustfmt::skip]
pub const STATISTICS: &[Statistic] = &[
    statistic("max_q", "max Q", "Q-value: the return that the agent expects in ordinary states", "mean over 128 fixed observations of random play of the largest Q-value"),
    statistic("overestimation", "overestimation", "Overestimation: expected less obtained return", "mean over the evaluation's episodes of max Q at the start minus the discounted return that the episode gave. An episode cut off by the time limit gives a little less than it is worth"),
    statistic("action_gap", "action gap", "Action gap: Q-value of the best action less that of the second best", "mean over the same observations of the distance of the largest Q-value to the second largest"),
    statistic("doomed_max_q", "doomed max Q", "Q-value one step before an episode terminates (in CartPole the true value is about 1)", "mean of max Q on observations of random play one step before an episode terminates. In CartPole only one more reward follows, so the true value is about 1. Left out where random play terminates no episode, as in MountainCar"),
    Statistic { is_logarithmic: true, ..statistic("gradient_norm", "gradient norm", "Norm of the gradient", "norm of the gradient of the loss over 256 transitions spread evenly over the replay memory") },
    statistic("terminal_share", "terminal share", "Share of terminations in the replay memory", "share of the replay memory's transitions that terminated. A good policy makes them rare, and then the network forgets what ends an episode"),
    statistic("dead_relu_share", "dead ReLU share", "Share of hidden units that are always 0", "share of hidden units whose output is 0 on all observations of `max_q` and `doomed_max_q`"),
    statistic("td_error_q10", "", "", "10 % quantile of the absolute TD errors of the transitions of `gradient_norm`"),
    statistic("td_error_q50", "TD error, median", "", "their median"),
    statistic("td_error_q90", "", "", "their 90 % quantile"),
    statistic("visited_share", "visited share", "Share of the table's cells that were ever visited", "share of the table's cells in which a value was ever updated"),
    Statistic { is_logarithmic: true, ..statistic("visits_per_cell", "visits per cell", "Visits: updates for each visited cell", "number of updates so far for each visited cell") },
    Statistic { is_logarithmic: true, ..statistic("largest_update", "largest update", "Largest change of a Q-value in an episode", "largest change of a Q-value, α times the TD error, in the latest complete episode") },
];

/// Numbers with names, in an order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NamedNumbers(pub Vec<(String, f64)>);

impl NamedNumbers {
    /// Numbers of these names; what is NaN is not known and left out.
    pub(super) fn new<'a>(numbers: impl IntoIterator<Item = (&'a str, f64)>) -> Self {
        let known = numbers.into_iter().filter(|(_, number)| !number.is_nan());
        Self(known.map(|(name, number)| (name.to_owned(), number)).collect())
    }

    pub fn get(&self, name: &str) -> Option<f64> {
        self.0.iter().find(|(other, _)| other == name).map(|&(_, number)| number)
    }
}

impl Serialize for NamedNumbers {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.0.iter().map(|(name, number)| (name, number)))
    }
}

impl<'de> Deserialize<'de> for NamedNumbers {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let members = serde_json::Map::deserialize(deserializer)?;
        let number = |(name, value): (String, serde_json::Value)| Some((name, value.as_f64()?));
        Ok(Self(members.into_iter().filter_map(number).collect()))
    }
}

/// Transitions that gradient and TD errors are taken over, if there are as many.
pub(super) const TRANSITIONS: usize = 256;

/// What a Q-network has. `td_errors` are the absolute TD errors of some transitions, and `gradient` is the loss's over them.
pub(super) fn network_statistics(
    network: &Mlp<f32>, reward_scale: f64, terminal_share: f64, mut td_errors: Vec<f64>, gradient: &Mlp<f32>,
    probes: &Probes, played: &[Played],
) -> NamedNumbers {
    td_errors.sort_by(f64::total_cmp);
    let quantile = |share: f64| td_errors[((td_errors.len() - 1) as f64 * share) as usize];
    let [ordinary, doomed] = [&probes.ordinary, &probes.doomed].map(|probes| forward(network, probes));
    let [overestimation, max_q, action_gap, doomed_max_q] =
        value_statistics(ordinary.output(), doomed.output(), reward_scale, played);
    NamedNumbers::new([
        overestimation,
        ("terminal_share", terminal_share),
        max_q,
        action_gap,
        doomed_max_q,
        ("gradient_norm", norm(gradient.parameters())),
        ("td_error_q10", quantile(0.1)),
        ("td_error_q50", quantile(0.5)),
        ("td_error_q90", quantile(0.9)),
        ("dead_relu_share", dead_share(&[ordinary, doomed])),
    ])
}

/// What all tables of Q-values have: those of ordinary and doomed probes, (batch, actions), for rewards times `scale`.
pub(super) fn value_statistics(
    ordinary: &DMatrix<f32>, doomed: &DMatrix<f32>, scale: f64, played: &[Played],
) -> [(&'static str, f64); 4] {
    let (max_q, action_gap) = values(ordinary);
    let overestimated = played.iter().map(|episode| episode.expected / scale - episode.discounted);
    [
        ("overestimation", overestimated.sum::<f64>() / played.len() as f64),
        ("max_q", max_q / scale),
        ("action_gap", action_gap / scale),
        ("doomed_max_q", values(doomed).0 / scale),
    ]
}

fn forward(policy: &Mlp<f32>, observations: &[Vec<f32>]) -> Activations<f32> {
    let mut activations = Activations::new(policy.sizes(), observations.len());
    activations.set_rows(observations.iter().map(Vec::as_slice));
    policy.forward(&mut activations);
    activations
}

/// Means of the largest Q-value and of its distance to the second largest; NaN without observations.
fn values(q: &DMatrix<f32>) -> (f64, f64) {
    let (mut largest_sum, mut gap_sum) = (0.0, 0.0);
    for row in q.row_iter() {
        let (mut largest, mut second) = (f32::NEG_INFINITY, f32::NEG_INFINITY);
        for &value in &row {
            (largest, second) = if value > largest { (value, largest) } else { (largest, second.max(value)) };
        }
        largest_sum += f64::from(largest);
        gap_sum += f64::from(largest) - f64::from(second);
    }
    let count = q.nrows() as f64;
    (largest_sum / count, gap_sum / count)
}

/// Share of the hidden units whose output is 0 in all of these passes.
fn dead_share(passes: &[Activations<f32>]) -> f64 {
    let alive = |layer: usize, unit: usize| {
        passes.iter().any(|pass| pass.hidden()[layer].column(unit).iter().any(|&value| value > 0.0))
    };
    let units = || {
        let hidden = passes[0].hidden().iter().enumerate();
        hidden.flat_map(|(layer, outputs)| (0..outputs.ncols()).map(move |unit| (layer, unit)))
    };
    units().filter(|&(layer, unit)| !alive(layer, unit)).count() as f64 / units().count().max(1) as f64
}
