//! The update in f64: one function for each quantity, of a [`Variant`] that says how it is computed.

use std::sync::OnceLock;

use super::activation::LayerKinds;
use super::file::{Batch, EpsilonPlace, Settings, Update};
use super::pass::{Pass, backward, forward};
use super::rounding::{Matrix, Number, square};
use super::variant::{
    Clipping, Decay, Discount, Mask, NextValue, Optimizer, Penalty, Predicted, QValues, Reached, Reduction,
    Reward, Variant,
};
use crate::agent::argmax;
use crate::nn::Mlp;

/// An update with the passes that all variants share.
pub struct Reference<'a> {
    update: &'a Update,
    passes: [OnceLock<Passes>; LayerKinds::COUNT],
}

struct Passes {
    /// Q(s, ·), Q(s′, ·), Q⁻(s, ·) and Q⁻(s′, ·).
    current: Pass,
    next: Pass,
    target_of_next: Option<Pass>,
    /// Few mistakes need it.
    target_of_current: OnceLock<Option<Pass>>,
}

/// What PyTorch adds to ‖g‖ before it divides by it.
pub(crate) const NORM_MARGIN: f64 = 1e-6;

/// The targets; the next Q-values of each, places (sample, action) whose mean is the value of s′; and what multiplies it.
pub struct Targets {
    /// y, (batch), or [batch, batch] row by row
    pub values: Vec<Number>,
    places: Vec<Vec<(usize, usize)>>,
    slopes: Vec<f64>,
}

pub struct LossOf {
    pub value: Number,
    /// ∂L/∂Q(s, ·)
    pub(super) by_q: Matrix,
    /// ∂L/∂y
    by_target: Vec<f64>,
}

impl<'a> Reference<'a> {
    pub fn new(update: &'a Update) -> Self {
        Self { update, passes: [const { OnceLock::new() }; LayerKinds::COUNT] }
    }

    fn passes(&self, variant: &Variant) -> &Passes {
        let Update { online, target, batch, rounding_unit: unit, .. } = self.update;
        let pass = |network, observations| forward(network, observations, variant.activations, *unit);
        self.passes[variant.activations.index()].get_or_init(|| Passes {
            current: pass(online, &batch.observations),
            next: pass(online, &batch.next_observations),
            target_of_next: target.as_ref().map(|target| pass(target, &batch.next_observations)),
            target_of_current: OnceLock::new(),
        })
    }

    fn target_of_current(&self, variant: &Variant) -> Option<&Pass> {
        let Update { target, batch, rounding_unit, .. } = self.update;
        let pass = |target| forward(target, &batch.observations, variant.activations, *rounding_unit);
        self.passes(variant).target_of_current.get_or_init(|| target.as_ref().map(pass)).as_ref()
    }

    /// The online network's pass on what the targets bootstrap from.
    fn online_pass(&self, variant: &Variant) -> &Pass {
        let passes = self.passes(variant);
        if variant.from_current { &passes.current } else { &passes.next }
    }

    /// The pass that gives these Q-values; of those after the update the one before it.
    fn pass_of(&self, q: QValues, variant: &Variant) -> &Pass {
        let passes = self.passes(variant);
        match q {
            QValues::Current | QValues::After => &passes.current,
            QValues::Next => &passes.next,
            QValues::Target => self.target_of_current(variant).unwrap_or(&passes.current),
        }
    }

    /// `result.q`
    pub fn q(&self, variant: &Variant) -> Vec<Number> {
        let Update { results, batch, rounding_unit, .. } = self.update;
        let after = results.online.as_ref().filter(|_| variant.queried == QValues::After);
        let pass = |online| forward(online, &batch.observations, variant.activations, *rounding_unit);
        let after = after.map(pass);
        let q = &after.as_ref().unwrap_or_else(|| self.pass_of(variant.queried, variant)).q;
        q.value.iter().zip(q.variance.iter()).map(|(&value, &variance)| Number { value, variance }).collect()
    }

    /// y = R + γᵏ max_a Q⁻(s′, a), and y = R where s′ is terminal.
    pub fn targets(&self, variant: &Variant) -> Targets {
        let batch = &self.update.batch;
        let q_online = &self.online_pass(variant).q;
        let of_target = if variant.from_current {
            self.target_of_current(variant)
        } else {
            self.passes(variant).target_of_next.as_ref()
        };
        let q_target = of_target.map_or(q_online, |pass| &pass.q);
        let q = if variant.from_online { q_online } else { q_target };
        let largest = (0..batch.rewards.len()).map(|row| (row, argmax(&q.value, row)));
        let largest = largest.reduce(|best, place| if q.value[place] > q.value[best] { place } else { best });
        let (mut nexts, mut places, mut slopes) = (Vec::new(), Vec::new(), Vec::new());
        for sample in 0..batch.rewards.len() {
            let best = |q: &Matrix| vec![(sample, argmax(&q.value, sample))];
            let (chosen, chooser) = match variant.bootstrap {
                NextValue::Max | NextValue::Index => (best(q), None),
                NextValue::Double => (best(q_online), Some(q_online)),
                NextValue::DoubleExchanged => (best(q_target), Some(q_target)),
                NextValue::Taken => (vec![(sample, batch.actions[sample])], None),
                NextValue::Mean => ((0..q.value.ncols()).map(|action| (sample, action)).collect(), None),
                NextValue::Min => (vec![(sample, argmin(q, sample))], None),
                NextValue::MaxOfBatch => (largest.into_iter().collect(), None),
            };
            let valued = if variant.bootstrap == NextValue::DoubleExchanged { q_online } else { q };
            let mut next = Number::exact(0.0);
            for &(row, action) in &chosen {
                next += valued.get(row, action).scaled(1.0 / chosen.len() as f64);
            }
            if let Some(chooser) = chooser {
                next.may_be_off_by(choice_doubt(chooser, valued, sample));
            }
            let mut slope = self.slope(variant, sample);
            if variant.bootstrap == NextValue::Index {
                (next, slope) = (Number::exact(chosen[0].1 as f64), 0.0);
            }
            nexts.push(next);
            slopes.push(slope);
            places.push(chosen);
        }
        let (size, is_square) = (nexts.len(), variant.square.is_some());
        let value = |place: usize| {
            let of = |of_row: bool| if of_row && is_square { place / size } else { place % size };
            let [reward, mask, next] = variant.square.unwrap_or_default().map(of);
            self.target(variant, reward, self.slope(variant, mask), nexts[next])
        };
        let values = (0..if is_square { size * size } else { size }).map(value).collect();
        Targets { values, places, slopes }
    }

    /// What multiplies the value of s′: 0 where the target is the reward alone.
    fn slope(&self, variant: &Variant, sample: usize) -> f64 {
        let (discounts, gamma) = (&self.update.batch.discounts, variant.settings.gamma);
        let discount = match variant.discount {
            Discount::Own => discounts[sample],
            Discount::Forgotten => 1.0,
            Discount::Twice => square(discounts[sample]),
            Discount::Gamma => gamma,
            Discount::OneMore => discounts[sample] * gamma,
            Discount::OneLess => discounts[sample] / gamma,
            Discount::Longest => discounts.iter().copied().fold(f64::INFINITY, f64::min),
            Discount::Other(gamma) => gamma,
        };
        if self.is_masked(variant, sample) { 0.0 } else { discount }
    }

    fn target(&self, variant: &Variant, sample: usize, slope: f64, next: Number) -> Number {
        let batch = &self.update.batch;
        let reward = match variant.reward {
            Reward::Whole => batch.rewards[sample],
            Reward::Forgotten => 0.0,
            Reward::Discounted => batch.rewards[sample] * batch.discounts[sample],
            Reward::Clipped => batch.rewards[sample].clamp(-1.0, 1.0),
            Reward::Negated => -batch.rewards[sample],
        };
        let reward = if variant.reward_is_masked && self.is_masked(variant, sample) { 0.0 } else { reward };
        let mut target = next.scaled(slope);
        let rounded = square(reward) + 4.0 * square(target.value);
        target.value += reward;
        target.variance += square(self.update.rounding_unit) * (rounded + square(target.value));
        target
    }

    fn is_masked(&self, variant: &Variant, sample: usize) -> bool {
        let batch = &self.update.batch;
        let terminated = batch.terminated[sample];
        match variant.mask {
            Mask::Terminated => terminated,
            Mask::Nowhere => false,
            Mask::TerminatedOrTruncated => terminated || batch.is_truncated(sample),
            Mask::NotTerminated => !terminated,
        }
    }

    /// L = 1/B Σ ℓ(Q(s, a) − y)
    pub fn loss(&self, variant: &Variant, targets: &Targets) -> LossOf {
        let q = &self.pass_of(variant.predicted_from, variant).q;
        let (batch, outputs) = q.value.shape();
        let Update { rounding_unit: unit, batch: Batch { actions, weights, .. }, .. } = self.update;
        let weights = weights.as_ref().filter(|_| variant.is_weighted);
        let others = match variant.predicted {
            Predicted::FullOfTarget => self.target_of_current(variant).map(|pass| &pass.q),
            _ => None,
        };
        let count = match variant.predicted {
            Predicted::EveryOutput | Predicted::FullZeros | Predicted::FullOfTarget => batch * outputs,
            Predicted::EveryPair | Predicted::EveryColumn | Predicted::EveryColumnByRow => batch * batch,
            _ if targets.values.len() > batch => batch * batch,
            _ => batch,
        } as f64;
        let half = if variant.is_halved { 0.5 } else { 1.0 };
        let scale = match variant.reduction {
            Reduction::Mean => half / count,
            Reduction::Sum => half,
            Reduction::MeanOverOutputs => half / count / outputs as f64,
        };
        let mut value = Number::exact(0.0);
        let mut by_q = Matrix::zeros(batch, outputs);
        let mut by_target = vec![0.0; batch];
        let mut total = Number::exact(0.0);
        (0..batch).for_each(|sample| total += q.get(sample, actions[sample]));
        self.compare(variant, q, targets.values.len(), |sample, output, of| {
            let is_sum = variant.predicted == Predicted::SumOfBatch;
            let predicted = if is_sum { total } else { q.get(sample, output) };
            let target = match (of, others) {
                (Some(of), _) => targets.values[of],
                (None, Some(others)) => others.get(sample, output),
                (None, None) => Number::exact(0.0),
            };
            let td_error = Number {
                value: predicted.value - target.value,
                variance: predicted.variance
                    + target.variance
                    + square(*unit) * (square(predicted.value) + square(target.value)),
            };
            let (loss, derivative) = variant.loss.of(td_error);
            let scale = scale * weights.map_or(1.0, |weights| weights[sample]);
            let (loss, mut derivative) = (loss.scaled(scale), derivative.scaled(scale));
            value += loss;
            value.variance += square(*unit) * count * square(loss.value);
            derivative.variance += square(2.0 * unit * derivative.value);
            if let Some(of) = of {
                by_target[of % batch] -= derivative.value;
            }
            match variant.reached {
                Reached::Compared if is_sum => {
                    (0..batch).for_each(|sample| by_q.add(sample, actions[sample], derivative));
                }
                Reached::Compared => by_q.add(sample, output, derivative),
                Reached::Shifted(by) => by_q.add(sample, (output + by) % outputs, derivative),
                Reached::All => (0..outputs).for_each(|output| by_q.add(sample, output, derivative)),
            }
        });
        value.variance += square(*unit) * count.max(16.0) * square(value.value);
        LossOf { value, by_q, by_target }
    }

    /// Visits sample and output of what is compared, and its target; none where a full target vector has another number.
    fn compare(
        &self, variant: &Variant, q: &Matrix, targets: usize,
        mut visit: impl FnMut(usize, usize, Option<usize>),
    ) {
        let (batch, outputs) = q.value.shape();
        let actions = &self.update.batch.actions;
        let is_square = targets > batch;
        for i in 0..batch {
            let mut put = |output, of| visit(i, output, of);
            let action = actions[i];
            match variant.predicted {
                Predicted::Taken if is_square => (0..batch).for_each(|j| put(action, Some(i * batch + j))),
                Predicted::EveryPair if is_square => {
                    (0..batch).for_each(|j| put(action, Some(j * batch + i)))
                }
                Predicted::Taken | Predicted::SumOfBatch => put(action, Some(i)),
                Predicted::Largest => put(argmax(&q.value, i), Some(i)),
                Predicted::Shifted(by) => put((action + by) % outputs, Some(i)),
                Predicted::EveryOutput => (0..outputs).for_each(|output| put(output, Some(i))),
                Predicted::FullZeros | Predicted::FullOfTarget => {
                    (0..outputs).for_each(|output| put(output, (output == action).then_some(i)));
                }
                Predicted::EveryPair => (0..batch).for_each(|j| put(action, Some(j))),
                Predicted::EveryColumn => (0..batch).for_each(|j| put(actions[j], Some(j))),
                Predicted::EveryColumnByRow => (0..batch).for_each(|j| put(actions[j], Some(i))),
            }
        }
    }

    /// ∂L/∂θ before anything is done to it, in the order of the network's parameters: from layer `first` on, 0 before.
    pub fn raw_gradients(
        &self, variant: &Variant, targets: &Targets, loss: &LossOf, first: usize,
    ) -> Vec<Number> {
        let Update { online, rounding_unit: unit, .. } = self.update;
        let mut gradient = vec![Number::exact(0.0); online.parameters().len()];
        // Where the target network predicts, nothing of it reaches the online network.
        if variant.predicted_from != QValues::Target {
            let pass = self.pass_of(variant.predicted_from, variant);
            backward(online, pass, loss.by_q.clone(), *unit, first, &mut gradient);
        }
        if variant.through_target {
            let pass = self.online_pass(variant);
            let mut by_q = Matrix::zeros(pass.q.value.nrows(), pass.q.value.ncols());
            for (sample, places) in targets.places.iter().enumerate() {
                let share = loss.by_target[sample] * targets.slopes[sample] / places.len() as f64;
                for &(row, action) in places {
                    let variance = square(8.0 * unit * share);
                    by_q.add(row, action, Number { value: share, variance });
                }
            }
            backward(online, pass, by_q, *unit, first, &mut gradient);
        }
        gradient
    }

    /// ∂L/∂θ as the optimiser gets it: with the gradient of the update before if that stayed, and clipped. A norm needs all layers.
    pub fn changed(&self, variant: &Variant, mut gradient: Vec<Number>) -> Vec<Number> {
        let Update { rounding_unit: unit, adam, before, .. } = self.update;
        if variant.is_accumulated {
            // m = (1 − β₁) g after the first update.
            let (before, scale) = match before {
                Some(before) => (before, 1.0),
                None => (&adam.first, 1.0 / (1.0 - self.update.settings.beta1)),
            };
            for (number, &before) in gradient.iter_mut().zip(before.parameters()) {
                let before = before * scale;
                *number += Number { value: before, variance: square(4.0 * unit * before) };
            }
        }
        let max_norm = variant.settings.max_gradient_norm.unwrap_or(f64::INFINITY);
        match variant.clipping {
            Clipping::Nothing => {}
            Clipping::Value(limit) => {
                gradient.iter_mut().for_each(|number| number.value = number.value.clamp(-limit, limit));
            }
            Clipping::Norm => self.shorten(variant, &mut gradient, max_norm),
            Clipping::EveryTensor => {
                let mut rest = &mut gradient[..];
                for pair in self.update.online.sizes().windows(2) {
                    for length in [pair[0] * pair[1], pair[1]] {
                        let (tensor, others) = rest.split_at_mut(length);
                        self.shorten(variant, tensor, max_norm);
                        rest = others;
                    }
                }
            }
        }
        gradient
    }

    /// g ← g · min(1, c / (‖g‖ + 1e-6)) as in PyTorch, or g · min(1, c / ‖g‖) as in TensorFlow and Optax: both are right, so
    /// the number between them may be off by as much.
    fn shorten(&self, variant: &Variant, gradient: &mut [Number], max_norm: f64) {
        let squared: f64 = gradient.iter().map(|number| square(number.value)).sum();
        let norm = squared.sqrt();
        let factor = max_norm / (norm + variant.norm_margin.unwrap_or(NORM_MARGIN / 2.0));
        if factor >= 1.0 && (variant.norm_margin.is_some() || norm + NORM_MARGIN <= max_norm) {
            return;
        }
        let factor = factor.min(1.0);
        let carried: f64 = gradient.iter().map(|number| square(number.value) * number.variance).sum();
        let rounded = square(self.update.rounding_unit) * gradient.len() as f64;
        let relative_variance = carried / square(squared) + rounded;
        for number in gradient {
            *number = number.scaled(factor);
            number.variance += relative_variance * square(number.value);
            if variant.norm_margin.is_none() {
                // More than the distance to either form: distances add up as variances do.
                number.may_be_off_by(1.5 * number.value * NORM_MARGIN / norm);
            }
        }
    }

    /// The optimiser's step from the gradients, of the parameters from `first` on. Adam's is θ − α m̂ / (√v̂ + ε).
    pub fn weights(&self, variant: &Variant, gradients: &[Number], first: usize) -> Vec<Number> {
        let Update { online, adam, target, rounding_unit: unit, .. } = self.update;
        let rounding = step_rounding(variant, *unit);
        let step = variant.step as f64;
        let corrections = [variant.settings.beta1, variant.settings.beta2].map(|beta| 1.0 - beta.powf(step));
        let all = [&adam.first, &adam.second, adam.largest.as_ref().unwrap_or(&adam.second)];
        let (weights, target) = (online.parameters(), target.as_ref().map(Mlp::parameters));
        let number = |(index, gradient): (usize, &Number)| {
            let (weight, moments) = (weights[index], all.map(|moment| moment.parameters()[index]));
            let at = |gradient| stepped(variant, corrections, weight, gradient, moments);
            let value = at(gradient.value);
            let doubt = |gradient| (at(gradient) - value).abs();
            // A decay is rounded with the weight, whatever comes of it.
            let (decayed, added) = match variant.decay {
                Decay::None => (0.0, 0.0),
                Decay::Decoupled(_) => (2.0 * unit * weight.abs(), 0.0),
                Decay::Squared(decay) => (0.0, 2.0 * unit * decay * weight.abs()),
            };
            let tolerance = gradient.tolerance() + added;
            let rounded = rounding * (value - weight).abs() + 2.0 * unit * weight.abs().max(value.abs());
            let mut number = Number::exact(value);
            number.may_be_off_by(doubt(gradient.value - tolerance).max(doubt(gradient.value + tolerance)));
            number.may_be_off_by(rounded + decayed);
            if let Some(target) = target
                && variant.overwritten > 0.0
            {
                let share = variant.overwritten;
                number = number.scaled(1.0 - share);
                number.value += share * target[index];
                number.may_be_off_by(2.0 * unit * (target[index].abs() + weight.abs()));
            }
            number
        };
        gradients.iter().enumerate().skip(first).map(number).collect()
    }
}

/// Relative rounding of a step: in f32 the powers of β₂ = 0.999 and 1 − β₂ have few digits.
fn step_rounding(variant: &Variant, unit: f64) -> f64 {
    let of = |beta: f64| {
        let power = beta.powf(variant.step as f64);
        (1.0 + variant.step as f64 * power) / (1.0 - power) + 1.0 / (1.0 - beta)
    };
    let averaged = match variant.optimizer {
        Optimizer::RmsProp => 1.0 / (1.0 - variant.settings.alpha),
        Optimizer::Sgd | Optimizer::Nothing => 0.0,
        _ => of(variant.settings.beta1) + of(variant.settings.beta2),
    };
    unit * (16.0 + averaged + 2.0 * variant.buffer_scale)
}

/// A parameter after one step; `corrections` are 1 − β₁ᵗ and 1 − β₂ᵗ, `moments` m, v and the largest v.
fn stepped(variant: &Variant, corrections: [f64; 2], weight: f64, gradient: f64, moments: [f64; 3]) -> f64 {
    let Settings { learning_rate, beta1, beta2, epsilon, alpha, .. } = variant.settings;
    let [first, second, largest] = moments;
    let (decayed, gradient) = match variant.decay {
        Decay::None => (weight, gradient),
        Decay::Decoupled(decay) => (weight - learning_rate * decay * weight, gradient),
        Decay::Squared(decay) => (weight, gradient + decay * weight),
    };
    let m = beta1 * first + (1.0 - beta1) * gradient;
    let v = beta2 * second + (1.0 - beta2) * square(gradient);
    let v = if variant.settings.amsgrad { v.max(largest) } else { v };
    let [correction1, correction2] = corrections;
    let is_keras = variant.settings.epsilon_place == EpsilonPlace::TensorFlow;
    let direction = match variant.optimizer {
        Optimizer::Adam if is_keras => correction2.sqrt() / correction1 * m / (v.sqrt() + epsilon),
        Optimizer::Adam => m / correction1 / ((v / correction2).sqrt() + epsilon),
        Optimizer::AdamUncorrected => m / (v.sqrt() + epsilon),
        Optimizer::RmsProp => {
            let v = alpha * second + (1.0 - alpha) * square(gradient);
            gradient / if is_keras { (v + epsilon).sqrt() } else { v.sqrt() + epsilon }
        }
        Optimizer::Sgd => gradient,
        Optimizer::Nothing => 0.0,
    };
    let has_buffer = matches!(variant.optimizer, Optimizer::RmsProp | Optimizer::Sgd);
    let buffer = if has_buffer { variant.settings.momentum * variant.buffer_scale * first } else { 0.0 };
    // With ε = 0 the step of a gradient that was always 0 is 0 / 0.
    let direction = if direction.is_nan() { 0.0 } else { direction + buffer };
    decayed - learning_rate * if variant.is_ascent { -direction } else { direction }
}

impl Penalty {
    /// ℓ(δ) and ℓ′(δ).
    pub(super) fn of(self, td_error: Number) -> (Number, Number) {
        let Number { value: x, variance } = td_error;
        let rounded =
            |value, slope| Number { value, variance: square(slope) * variance + 2.0 * square(variance) };
        match self {
            Self::Square => (rounded(x * x, 2.0 * x), td_error.scaled(2.0)),
            Self::Huber(delta) => {
                let size = x.abs();
                let value = if size < delta { 0.5 * x * x } else { delta * (size - 0.5 * delta) };
                let slope = x.clamp(-delta, delta);
                (rounded(value, slope), Number { value: slope, variance })
            }
            Self::SmoothL1(beta) => {
                let (value, slope) = Self::Huber(beta).of(td_error);
                (value.scaled(1.0 / beta), slope.scaled(1.0 / beta))
            }
            Self::Absolute => {
                let mut sign = Number::exact(if x == 0.0 { 0.0 } else { x.signum() });
                if x.abs() < td_error.tolerance() {
                    sign.may_be_off_by(2.0);
                }
                (Number { value: x.abs(), variance }, sign)
            }
            Self::ClippedSquare => {
                let clipped = x.clamp(-1.0, 1.0);
                let mut slope = td_error.scaled(if x.abs() < 1.0 { 2.0 } else { 0.0 });
                if (x.abs() - 1.0).abs() < td_error.tolerance() {
                    slope.may_be_off_by(2.0);
                }
                (rounded(square(clipped), 2.0 * clipped), slope)
            }
        }
    }
}

fn argmin(q: &Matrix, sample: usize) -> usize {
    (1..q.value.ncols()).fold(0, |best, action| {
        if q.value[(sample, action)] < q.value[(sample, best)] { action } else { best }
    })
}

/// How far the value of the chosen action may be off because another action is as good, but for rounding.
fn choice_doubt(chooser: &Matrix, valued: &Matrix, sample: usize) -> f64 {
    let best = argmax(&chooser.value, sample);
    let best_q = chooser.get(sample, best);
    let doubts = (0..chooser.value.ncols()).map(|action| {
        let other = chooser.get(sample, action);
        let is_as_good = best_q.value - other.value <= best_q.tolerance() + other.tolerance();
        let distance = (valued.value[(sample, action)] - valued.value[(sample, best)]).abs();
        if is_as_good { distance } else { 0.0 }
    });
    doubts.fold(0.0, f64::max)
}
