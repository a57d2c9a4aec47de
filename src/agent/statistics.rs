//! What learning looks like from inside: the numbers that move before the returns do.

use serde::{Deserialize, Serialize};

use crate::nn::{Activations, Mlp};

/// Observations on which a policy is asked for its Q-values, the same ones during a whole run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Probes {
    /// Ordinary observations.
    pub ordinary: Vec<Vec<f32>>,
    /// Observations after which no action keeps an episode alive for more than a few steps.
    pub doomed: Vec<Vec<f32>>,
}

/// Statistics of an agent. Values and errors are in units of the environment's rewards.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Statistics {
    /// Share of the transitions in the replay memory that terminated, 0…1. A good policy makes them rare, and then
    /// the network forgets what ends an episode.
    pub terminal_share: f64,
    /// Mean of max_a Q over the ordinary probes.
    pub max_q: f64,
    /// Mean difference between the largest and the second largest Q-value over the ordinary probes.
    pub action_gap: f64,
    /// Mean of max_a Q over the doomed probes; the true value is that of a few steps.
    pub doomed_max_q: f64,
    /// Norm of the loss's gradient over transitions spread evenly over the replay memory.
    pub gradient_norm: f64,
    /// Of the absolute TD errors of the same transitions the 10, 50 and 90 % quantiles.
    pub td_error_quantiles: [f64; 3],
    /// Share of the hidden units that are 0 on every probe, 0…1.
    pub dead_relu_share: f64,
}

impl Statistics {
    /// Transitions that gradient and TD errors are taken over, if there are as many.
    pub(super) const TRANSITIONS: usize = 256;

    pub(super) fn new(
        policy: &Mlp<f32>,
        probes: &Probes,
        reward_scale: f64,
        terminal_share: f64,
        mut td_errors: Vec<f64>,
        gradient: &Mlp<f32>,
    ) -> Self {
        td_errors.sort_by(f64::total_cmp);
        let quantile = |share: f64| td_errors[((td_errors.len() - 1) as f64 * share) as usize];
        let ordinary = forward(policy, &probes.ordinary);
        let doomed = forward(policy, &probes.doomed);
        let (max_q, action_gap) = values(&ordinary);
        let squares = gradient.parameters().iter().map(|&g| f64::from(g) * f64::from(g));
        Self {
            terminal_share,
            max_q: max_q / reward_scale,
            action_gap: action_gap / reward_scale,
            doomed_max_q: values(&doomed).0 / reward_scale,
            gradient_norm: squares.sum::<f64>().sqrt(),
            td_error_quantiles: [0.1, 0.5, 0.9].map(quantile),
            dead_relu_share: dead_share(&[ordinary, doomed]),
        }
    }
}

fn forward(policy: &Mlp<f32>, observations: &[Vec<f32>]) -> Activations<f32> {
    let mut activations = Activations::new(policy.sizes(), observations.len());
    for (sample, observation) in observations.iter().enumerate() {
        for (feature, &value) in observation.iter().enumerate() {
            activations.input_mut()[(sample, feature)] = value;
        }
    }
    policy.forward(&mut activations);
    activations
}

/// Means of the largest Q-value and of its distance to the second largest; 0 without observations.
fn values(activations: &Activations<f32>) -> (f64, f64) {
    let q = activations.output();
    let (mut largest_sum, mut gap_sum) = (0.0, 0.0);
    for row in q.row_iter() {
        let (mut largest, mut second) = (f32::NEG_INFINITY, f32::NEG_INFINITY);
        for &value in &row {
            (largest, second) = if value > largest { (value, largest) } else { (largest, second.max(value)) };
        }
        largest_sum += f64::from(largest);
        gap_sum += f64::from(largest) - f64::from(second);
    }
    let count = q.nrows().max(1) as f64;
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
    let dead = units().filter(|&(layer, unit)| !alive(layer, unit)).count();
    dead as f64 / units().count().max(1) as f64
}
