//! The update in f64: one function for each quantity, of a [`Variant`] that says how it is computed.
// The names of the variants say what they are.
#![allow(missing_docs)]

use std::sync::OnceLock;

use super::file::{EpsilonPlace, Update};
use super::rounding::{Matrix, Number, Pass, backward, forward, square};
use crate::agent::argmax;
use crate::nn::Loss;

/// How an update is computed: the right way ([`Variant::right`]), or with some of the catalogue's mistakes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Variant {
    pub reward: Reward,
    /// γ is multiplied this many times.
    pub discounted: i32,
    pub mask: Mask,
    /// Where the mask is 0 the reward is lost as well.
    pub reward_is_masked: bool,
    pub bootstrap: NextValue,
    /// The online network values s′; right only where there is no target network.
    pub from_online: bool,
    /// s takes the place of s′.
    pub from_current: bool,

    pub loss: Penalty,
    pub predicted: Predicted,
    pub reduction: Reduction,
    pub is_halved: bool,

    /// The target is no constant.
    pub through_target: bool,
    pub reached: Reached,
    /// The first update's gradient is still there.
    pub is_accumulated: bool,
    pub max_gradient_norm: Option<f64>,
    pub clipping: Clipping,
    /// What is added to ‖g‖ where the norm is shortened; none if either form will do.
    pub norm_margin: Option<f64>,

    pub optimizer: Optimizer,
    pub learning_rate: f64,
    pub beta1: f64,
    pub beta2: f64,
    pub epsilon: f64,
    /// The number of this step, from 1.
    pub step: u64,
    pub decay: Decay,
}

/// The part of the reward that is in the target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reward {
    Whole,
    Forgotten,
    Discounted,
    /// To −1…1.
    Clipped,
}

/// Where the target is the reward alone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Mask {
    Terminated,
    Nowhere,
    TerminatedOrTruncated,
    NotTerminated,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum NextValue {
    Max,
    Double,
    DoubleExchanged,
    /// Of the action that was taken in s.
    Taken,
    Mean,
    Min,
    /// The number of the best action, in place of its value.
    Index,
    /// The largest value of the whole batch.
    MaxOfBatch,
}

/// The loss of one TD error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Penalty {
    Known(Loss),
    Absolute,
}

/// What is compared with the targets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Predicted {
    Taken,
    Largest,
    /// The action behind the one taken, by so many.
    Shifted(usize),
    /// Every output, each with its sample's target.
    EveryOutput,
    /// Q(s, a) of every sample with the target of every sample.
    EveryPair,
}

/// What the losses are divided by.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reduction {
    Mean,
    Sum,
    MeanOverOutputs,
}

/// The outputs that get a sample's gradient.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reached {
    Compared,
    /// The one behind it, by so many.
    Shifted(usize),
    All,
}

/// How a long gradient is shortened.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Clipping {
    Norm,
    Nothing,
    /// Every element to this size.
    Value(f64),
    /// Every tensor on its own.
    EveryTensor,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Optimizer {
    Adam,
    /// Without the divisions by 1 − βᵗ.
    AdamUncorrected,
    /// With ε beside the uncorrected √v.
    AdamOfKeras,
    RmsProp,
    Sgd,
    /// Adam's step in the other direction.
    Ascent,
    Nothing,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Decay {
    None,
    /// θ ← θ − α d θ, beside Adam's step (Loshchilov and Hutter 2019).
    Decoupled(f64),
    /// g ← g + d θ
    Squared(f64),
}

impl Variant {
    pub fn right(update: &Update) -> Self {
        let settings = &update.settings;
        Self {
            reward: Reward::Whole,
            discounted: 1,
            mask: Mask::Terminated,
            reward_is_masked: false,
            bootstrap: if settings.double { NextValue::Double } else { NextValue::Max },
            from_online: update.target.is_none(),
            from_current: false,
            loss: Penalty::Known(settings.loss),
            predicted: Predicted::Taken,
            reduction: Reduction::Mean,
            is_halved: false,
            through_target: false,
            reached: Reached::Compared,
            is_accumulated: false,
            max_gradient_norm: settings.max_gradient_norm,
            clipping: if settings.max_gradient_norm.is_some() { Clipping::Norm } else { Clipping::Nothing },
            norm_margin: None,
            optimizer: match settings.epsilon_place {
                EpsilonPlace::PyTorch => Optimizer::Adam,
                EpsilonPlace::TensorFlow => Optimizer::AdamOfKeras,
            },
            learning_rate: settings.learning_rate,
            beta1: settings.beta1,
            beta2: settings.beta2,
            epsilon: settings.epsilon,
            step: update.adam.steps + 1,
            decay: Decay::None,
        }
    }
}

/// An update with the passes that all variants share.
pub struct Reference<'a> {
    update: &'a Update,
    /// Q(s, ·), Q(s′, ·), Q⁻(s, ·) and Q⁻(s′, ·).
    current: Pass,
    next: Pass,
    target_of_next: Option<Pass>,
    /// One mistake alone needs it.
    target_of_current: OnceLock<Pass>,
}

/// What PyTorch adds to ‖g‖ before it divides by it.
pub(crate) const NORM_MARGIN: f64 = 1e-6;

/// The targets, and the next Q-values that each is made of: places (sample, action) whose mean is the value of s′, and
/// what multiplies it.
pub struct Targets {
    /// y, (batch)
    pub values: Vec<Number>,
    places: Vec<Vec<(usize, usize)>>,
    slopes: Vec<f64>,
}

/// The loss and its derivatives.
pub struct LossOf {
    pub value: Number,
    /// ∂L/∂Q(s, ·)
    pub(super) by_q: Matrix,
    /// ∂L/∂y
    by_target: Vec<f64>,
}

impl<'a> Reference<'a> {
    pub fn new(update: &'a Update) -> Self {
        let Update { online, target, batch, rounding_unit: unit, .. } = update;
        Self {
            update,
            current: forward(online, &batch.observations, *unit),
            next: forward(online, &batch.next_observations, *unit),
            target_of_next: target.as_ref().map(|target| forward(target, &batch.next_observations, *unit)),
            target_of_current: OnceLock::new(),
        }
    }

    fn target_of_current(&self) -> Option<&Pass> {
        let Update { target, batch, rounding_unit, .. } = self.update;
        let target = target.as_ref()?;
        Some(self.target_of_current.get_or_init(|| forward(target, &batch.observations, *rounding_unit)))
    }

    /// The online network's pass on what the targets bootstrap from.
    fn online_pass(&self, variant: &Variant) -> &Pass {
        if variant.from_current { &self.current } else { &self.next }
    }

    /// y = R + γᵏ max_a Q⁻(s′, a), and y = R where s′ is terminal.
    pub fn targets(&self, variant: &Variant) -> Targets {
        let batch = &self.update.batch;
        let q_online = self.online_pass(variant).q();
        let of_target =
            if variant.from_current { self.target_of_current() } else { self.target_of_next.as_ref() };
        let q_target = of_target.map_or(q_online, Pass::q);
        let q = if variant.from_online { q_online } else { q_target };
        let largest = (0..batch.rewards.len()).map(|row| (row, argmax(&q.value, row)));
        let largest = largest.reduce(|best, place| if q.value[place] > q.value[best] { place } else { best });
        let (mut values, mut places, mut slopes) = (Vec::new(), Vec::new(), Vec::new());
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
            if variant.bootstrap == NextValue::Index {
                next = Number::exact(chosen[0].1 as f64);
            }
            let slope = batch.discounts[sample].powi(variant.discounted) * self.mask(variant, sample);
            values.push(self.target(variant, sample, slope, next));
            slopes.push(if variant.bootstrap == NextValue::Index { 0.0 } else { slope });
            places.push(chosen);
        }
        Targets { values, places, slopes }
    }

    fn target(&self, variant: &Variant, sample: usize, slope: f64, next: Number) -> Number {
        let batch = &self.update.batch;
        let reward = match variant.reward {
            Reward::Whole => batch.rewards[sample],
            Reward::Forgotten => 0.0,
            Reward::Discounted => batch.rewards[sample] * batch.discounts[sample],
            Reward::Clipped => batch.rewards[sample].clamp(-1.0, 1.0),
        };
        let is_lost = variant.reward_is_masked && self.mask(variant, sample) == 0.0;
        let reward = if is_lost { 0.0 } else { reward };
        let mut target = next.scaled(slope);
        let rounded = square(reward) + 4.0 * square(target.value);
        target.value += reward;
        target.variance += square(self.update.rounding_unit) * (rounded + square(target.value));
        target
    }

    /// What multiplies the value of s′: 0 where the target is the reward alone.
    fn mask(&self, variant: &Variant, sample: usize) -> f64 {
        let batch = &self.update.batch;
        let terminated = batch.terminated[sample];
        let truncated = batch.truncated.as_ref().is_some_and(|truncated| truncated[sample]);
        let is_masked = match variant.mask {
            Mask::Terminated => terminated,
            Mask::Nowhere => false,
            Mask::TerminatedOrTruncated => terminated || truncated,
            Mask::NotTerminated => !terminated,
        };
        f64::from(!is_masked)
    }

    /// L = 1/B Σ ℓ(Q(s, a) − y)
    pub fn loss(&self, variant: &Variant, targets: &Targets) -> LossOf {
        let q = self.current.q();
        let (batch, outputs) = q.value.shape();
        let unit = self.update.rounding_unit;
        let actions = &self.update.batch.actions;
        let one = |index: usize| index..index + 1;
        // The outputs of a sample that are compared, and the samples whose targets they are compared with.
        let compared = |i: usize| match variant.predicted {
            Predicted::Taken => (one(actions[i]), one(i)),
            Predicted::Largest => (one(argmax(&q.value, i)), one(i)),
            Predicted::Shifted(by) => (one((actions[i] + by) % outputs), one(i)),
            Predicted::EveryOutput => (0..outputs, one(i)),
            Predicted::EveryPair => (one(actions[i]), 0..batch),
        };
        let count = match variant.predicted {
            Predicted::EveryOutput => batch * outputs,
            Predicted::EveryPair => batch * batch,
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
        let pairs = (0..batch).flat_map(|sample| {
            let (compared, targets) = compared(sample);
            compared.flat_map(move |output| targets.clone().map(move |of| (sample, output, of)))
        });
        for (sample, output, of) in pairs {
            let (predicted, target) = (q.get(sample, output), targets.values[of]);
            let td_error = Number {
                value: predicted.value - target.value,
                variance: predicted.variance
                    + target.variance
                    + square(unit) * (square(predicted.value) + square(target.value)),
            };
            let (loss, derivative) = variant.loss.of(td_error);
            let (loss, mut derivative) = (loss.scaled(scale), derivative.scaled(scale));
            value += loss;
            value.variance += square(unit) * count * square(loss.value);
            derivative.variance += square(2.0 * unit * derivative.value);
            by_target[of] -= derivative.value;
            match variant.reached {
                Reached::Compared => by_q.add(sample, output, derivative),
                Reached::Shifted(by) => by_q.add(sample, (output + by) % outputs, derivative),
                Reached::All => (0..outputs).for_each(|output| by_q.add(sample, output, derivative)),
            }
        }
        value.variance += square(unit) * count.max(16.0) * square(value.value);
        LossOf { value, by_q, by_target }
    }

    /// ∂L/∂θ before anything is done to it, in the order of [`parameters`](crate::nn::Mlp::parameters): of the layers from
    /// `first` on, 0 before them.
    pub fn raw_gradients(
        &self,
        variant: &Variant,
        targets: &Targets,
        loss: &LossOf,
        first: usize,
    ) -> Vec<Number> {
        let Update { online, rounding_unit: unit, .. } = self.update;
        let mut gradient = vec![Number::exact(0.0); online.parameters().len()];
        backward(online, &self.current, loss.by_q.clone(), *unit, first, &mut gradient);
        if variant.through_target && variant.from_online {
            let pass = self.online_pass(variant);
            let mut by_q = Matrix::zeros(pass.q().value.nrows(), pass.q().value.ncols());
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
        let Update { rounding_unit: unit, adam, .. } = self.update;
        // m = (1 − β₁) g after the first update.
        if variant.is_accumulated && adam.steps == 1 {
            for (number, &moment) in gradient.iter_mut().zip(adam.first.parameters()) {
                let before = moment / (1.0 - self.update.settings.beta1);
                *number += Number { value: before, variance: square(4.0 * unit * before) };
            }
        }
        let max_norm = variant.max_gradient_norm.unwrap_or(f64::INFINITY);
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

    /// Adam's step from the gradients: θ − α m̂ / (√v̂ + ε); of the parameters from `first` on.
    pub fn weights(&self, variant: &Variant, gradients: &[Number], first: usize) -> Vec<Number> {
        let Update { online, adam, rounding_unit: unit, .. } = self.update;
        let rounding = step_rounding(variant, *unit);
        let step = variant.step as f64;
        let corrections = [variant.beta1, variant.beta2].map(|beta| 1.0 - beta.powf(step));
        let moments = adam.first.parameters().iter().zip(adam.second.parameters());
        let parameters = online.parameters().iter().zip(moments).zip(gradients).skip(first);
        parameters
            .map(|((&weight, (&first, &second)), gradient)| {
                let at = |gradient| stepped(variant, corrections, weight, gradient, [first, second]);
                let value = at(gradient.value);
                let doubt = |gradient| (at(gradient) - value).abs();
                let tolerance = gradient.tolerance();
                let rounded = rounding * (value - weight).abs() + 2.0 * unit * weight.abs().max(value.abs());
                let mut number = Number::exact(value);
                number
                    .may_be_off_by(doubt(gradient.value - tolerance).max(doubt(gradient.value + tolerance)));
                number.may_be_off_by(rounded);
                number
            })
            .collect()
    }
}

/// Relative rounding of a step: in f32 the powers of β₂ = 0.999 and 1 − β₂ have few digits.
fn step_rounding(variant: &Variant, unit: f64) -> f64 {
    let of = |beta: f64| {
        let power = beta.powf(variant.step as f64);
        (1.0 + variant.step as f64 * power) / (1.0 - power) + 1.0 / (1.0 - beta)
    };
    unit * (16.0 + of(variant.beta1) + of(variant.beta2))
}

/// A parameter after one step; `corrections` are 1 − β₁ᵗ and 1 − β₂ᵗ.
fn stepped(variant: &Variant, corrections: [f64; 2], weight: f64, gradient: f64, moments: [f64; 2]) -> f64 {
    let Variant { learning_rate, beta1, beta2, epsilon, .. } = *variant;
    let [first, second] = moments;
    let (decayed, gradient) = match variant.decay {
        Decay::None => (weight, gradient),
        Decay::Decoupled(decay) => (weight - learning_rate * decay * weight, gradient),
        Decay::Squared(decay) => (weight, gradient + decay * weight),
    };
    let m = beta1 * first + (1.0 - beta1) * gradient;
    let v = beta2 * second + (1.0 - beta2) * square(gradient);
    let [correction1, correction2] = corrections;
    let adam = m / correction1 / ((v / correction2).sqrt() + epsilon);
    let direction = match variant.optimizer {
        Optimizer::Adam => adam,
        Optimizer::AdamUncorrected => m / (v.sqrt() + epsilon),
        Optimizer::AdamOfKeras => correction2.sqrt() / correction1 * m / (v.sqrt() + epsilon),
        Optimizer::RmsProp => gradient / ((0.99 * second + 0.01 * square(gradient)).sqrt() + epsilon),
        Optimizer::Sgd => gradient,
        Optimizer::Ascent => -adam,
        Optimizer::Nothing => 0.0,
    };
    // With ε = 0 the step of a gradient that was always 0 is 0 / 0.
    let direction = if direction.is_nan() { 0.0 } else { direction };
    decayed - learning_rate * direction
}

impl Penalty {
    /// ℓ(δ) and ℓ′(δ).
    fn of(self, td_error: Number) -> (Number, Number) {
        let Number { value: x, variance } = td_error;
        let Self::Known(loss) = self else {
            let mut sign = Number::exact(if x == 0.0 { 0.0 } else { x.signum() });
            if x.abs() < td_error.tolerance() {
                sign.may_be_off_by(2.0);
            }
            return (Number { value: x.abs(), variance }, sign);
        };
        let slope = loss.derivative(x);
        let value =
            Number { value: loss.value(x), variance: square(slope) * variance + 2.0 * square(variance) };
        let derivative = match loss {
            Loss::Mse => td_error.scaled(2.0),
            Loss::Huber => Number { value: slope, variance },
        };
        (value, derivative)
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
