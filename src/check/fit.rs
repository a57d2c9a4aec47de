//! What somebody's numbers say where the settings say otherwise, and what the differing ones have in common. A fit is a proposal:
//! only a mistake that then reproduces every number is named.

use super::mistakes::Stage;
use super::rounding::{Number, agrees, rounded, short, square};
use super::variant::{Decay, Discount, Fitted, Optimizer, Penalty, Predicted, Variant};
use super::verdict::{Hypothesis, Search};

impl Search<'_> {
    /// The numbers that explain the most of one quantity, as far as it has enough of them.
    pub(super) fn fitted(&self, base: &Hypothesis, stage: Stage) -> Fitted {
        let mut fitted = base.variant.fitted;
        let Some(theirs) = self.theirs(stage) else { return fitted };
        match stage {
            Stage::Batch | Stage::Q => {}
            Stage::Targets if theirs.len() > self.update.batch.rewards.len() => {
                // Most likely first: reward and mask have the same shape.
                let forms = [3, 4, 1, 6, 2, 5].map(|bits| [bits & 1 != 0, bits & 2 != 0, bits & 4 != 0]);
                let mut forms = forms.into_iter().filter(|&form| {
                    self.reproduces(&base.computing(Variant { square: Some(form), ..base.variant }), stage)
                });
                fitted.square = forms.next().unwrap_or(fitted.square);
            }
            Stage::Targets => self.fit_discount(base, theirs, &mut fitted),
            Stage::Loss => self.fit_penalty(base, theirs[0], &mut fitted),
            Stage::Gradients => {
                let largest = theirs.iter().fold(0.0_f64, |largest, value| largest.max(value.abs()));
                if theirs.iter().filter(|value| value.abs() >= largest * (1.0 - 1e-6)).count() > 1 {
                    fitted.clip_value = snapped(largest, 1e-6);
                }
            }
            Stage::Weights => self.fit_step(base, theirs, &mut fitted),
        }
        fitted
    }

    fn fit_discount(&self, base: &Hypothesis, theirs: &[f64], fitted: &mut Fitted) {
        let (gamma, rewards) = (base.variant.settings.gamma, &self.update.batch.rewards);
        let ours = self.compute(base, Stage::Targets);
        let ratio = |i: usize| {
            let (ours, theirs) = (ours[i].value - rewards[i], theirs[i] - rewards[i]);
            (ours.abs() > 1e-3 && theirs.is_finite()).then_some(theirs / ours)
        };
        let mut ratios: Vec<f64> = (0..ours.len()).filter_map(ratio).collect();
        // One row fits any γ.
        if ratios.len() > 2 && !base.variant.given.n_step && base.variant.discount == Discount::Own {
            ratios.sort_by(f64::total_cmp);
            let found = snapped(gamma * ratios[ratios.len() / 2], 1e-5);
            if (0.0..=1.0).contains(&found) {
                fitted.gamma = found;
            }
        }
    }

    /// A loss is one number, which some δ always gives: only a δ of at most two digits counts.
    fn fit_penalty(&self, base: &Hypothesis, loss: f64, fitted: &mut Fitted) {
        if base.variant.predicted != Predicted::Taken || base.variant.square.is_some() {
            return;
        }
        for (form, grows) in [(Penalty::Huber as fn(f64) -> Penalty, true), (Penalty::SmoothL1, false)] {
            let of = |log: f64| {
                let variant = Variant { loss: form(log.exp()), ..base.variant };
                self.targets_and_loss(&base.computing(variant)).1.value.value
            };
            let (mut low, mut high) = (-7.0, 7.0);
            for _ in 0..50 {
                let middle = 0.5 * (low + high);
                if (of(middle) < loss) == grows { low = middle } else { high = middle }
            }
            let delta = low.exp();
            let round = rounded(delta, 1);
            if (round - delta).abs() > 1e-3 * delta {
                continue;
            }
            let to = if grows { &mut fitted.delta } else { &mut fitted.smooth_l1_beta };
            *to = round;
        }
    }

    fn fit_step(&self, base: &Hypothesis, theirs: &[f64], fitted: &mut Fitted) {
        let update = self.update;
        let variant = &base.variant;
        let ours = self.compute(base, Stage::Weights);
        let weights = update.online.parameters();
        let moved = |i: usize| theirs[i] - weights[i];
        let step = |i: usize| ours[i].value - weights[i];
        // The factor of y that is nearest to x.
        let share = |x: &dyn Fn(usize) -> f64, y: &dyn Fn(usize) -> f64| {
            let products = (0..theirs.len()).map(|i| (x(i) * y(i), square(y(i))));
            let (product, squares) = products.fold((0.0, 0.0), |sum, one| (sum.0 + one.0, sum.1 + one.1));
            Some(product / squares).filter(|share| share.is_finite())
        };
        if let Some(factor) = share(&moved, &step).filter(|&factor| factor > 0.0) {
            fitted.learning_rate = snapped(variant.settings.learning_rate * factor, 1e-4);
        }
        let plain = Variant { decay: Decay::None, ..*variant };
        let undecayed = self.compute(&base.computing(plain), Stage::Weights);
        let shrinks =
            share(&|i| undecayed[i].value - theirs[i], &|i| weights[i] * variant.settings.learning_rate);
        if let Some(decay) = shrinks.filter(|&decay| decay > 0.0) {
            fitted.weight_decay = snapped(decay, 1e-3);
        }
        if let Some(target) = &update.target {
            let target = target.parameters();
            let way = share(&|i| theirs[i] - ours[i].value, &|i| target[i] - ours[i].value);
            if let Some(way) = way.map(|way| snapped(way, 1e-4)).filter(|way| (0.0..=1.0).contains(way)) {
                fitted.overwritten = way;
            }
        }
        let gradients = self.taken_gradients(base, Stage::Weights);
        let gradients = gradients.unwrap_or_else(|| self.compute(base, Stage::Gradients));
        let first = update.adam.first.parameters();
        let rest = |i: usize| -moved(i) / variant.settings.learning_rate - gradients[i].value;
        if let Some(factor) = share(&rest, &|i| first[i]).filter(|&factor| factor > 0.0) {
            // μ b, or of a mean as Adam's m is one, μ m / (1 − μ).
            let is_mean = factor > 1.0;
            fitted.momentum = snapped(if is_mean { factor / (1.0 + factor) } else { factor }, 1e-4);
            fitted.buffer_scale = if is_mean { 1.0 / (1.0 - fitted.momentum) } else { 1.0 };
        }
    }

    /// What the differing numbers of a quantity have in common.
    pub(super) fn common(&self, stage: Stage, ours: &[Number], theirs: &[f64]) -> Option<String> {
        let differing: Vec<usize> =
            (0..theirs.len().min(ours.len())).filter(|&i| !agrees(&ours[i], theirs[i])).collect();
        let mut said = Vec::new();
        if stage == Stage::Targets {
            said.extend(self.rows(&differing));
        }
        if stage >= Stage::Gradients {
            said.extend(self.layers(stage, &differing, theirs));
        }
        if let [one, _, ..] = differing[..] {
            let (value, ours_of_one) = (theirs[one], ours[one].value);
            let unit = self.update.rounding_unit;
            let all = |fits: &dyn Fn(usize) -> bool| differing.iter().all(|&i| fits(i));
            let is_same = |x: f64| (x - value).abs() <= 4.0 * unit * value.abs();
            let shift = value - ours_of_one;
            let shifted = |i: usize| Number { value: ours[i].value + shift, ..ours[i] };
            let factor = value / ours_of_one;
            if all(&|i| is_same(theirs[i])) {
                said.push(format!("yours is {} in each", short(value)));
            } else if value != 0.0 && all(&|i| is_same(theirs[i]) || is_same(-theirs[i])) {
                said.push(format!("yours is {0} or −{0} in each", short(value.abs())));
            } else if all(&|i| agrees(&shifted(i), theirs[i])) {
                let sign = if shift < 0.0 { "−" } else { "+" };
                said.push(format!("yours is the right one {sign} {} in each", short(shift.abs())));
            } else if factor.is_finite() && all(&|i| agrees(&ours[i].scaled(factor), theirs[i])) {
                said.push(format!("yours is {} times the right one in each", short(factor)));
            }
        }
        (!said.is_empty()).then(|| said.join("; "))
    }

    /// Which rows differ, if they are all of a kind.
    fn rows(&self, differing: &[usize]) -> Option<String> {
        let batch = &self.update.batch;
        let size = batch.rewards.len();
        let is = |fits: &dyn Fn(usize) -> bool| (0..size).filter(|&i| fits(i)).eq(differing.iter().copied());
        let has_ended = |i: usize| batch.terminated[i] || batch.is_truncated(i);
        let kinds: [(&str, &dyn Fn(usize) -> bool); 5] = [
            ("that terminated", &|i| batch.terminated[i]),
            ("that were truncated", &|i| batch.is_truncated(i)),
            ("that terminated or were truncated", &has_ended),
            ("that did not terminate", &|i| !batch.terminated[i]),
            ("that neither terminated nor were truncated", &|i| !has_ended(i)),
        ];
        let kind = kinds.iter().find(|(_, fits)| is(fits)).map(|(kind, _)| (*kind).to_owned());
        let actions = 0..self.update.online.sizes()[self.update.online.num_layers()];
        let of_action = actions.into_iter().find(|&action| is(&|i| batch.actions[i] == action));
        let kind = kind.or_else(|| Some(format!("with action {}", of_action?)))?;
        Some(format!("the {} rows that differ are exactly those {kind}", differing.len()))
    }

    /// Which layers differ, or stand still.
    fn layers(&self, stage: Stage, differing: &[usize], theirs: &[f64]) -> Option<String> {
        let online = &self.update.online;
        let still = |i: usize| if stage == Stage::Weights { online.parameters()[i] } else { 0.0 };
        let (mut start, mut concerned, mut dead) = (0, Vec::new(), Vec::new());
        for layer in 0..online.num_layers() {
            let range = start..start + online.layer(layer).len();
            start = range.end;
            if differing.iter().any(|i| range.contains(i)) {
                concerned.push((layer + 1).to_string());
                if range.clone().all(|i| theirs[i] == still(i)) {
                    dead.push((layer + 1).to_string());
                }
            }
        }
        let what = if stage == Stage::Weights { "does not move" } else { "has no gradient" };
        match (dead.is_empty(), concerned.len() < online.num_layers()) {
            (false, _) => Some(format!("layer {} {what}", dead.join(", "))),
            (true, true) => Some(format!("only layer {} differs", concerned.join(", "))),
            _ => None,
        }
    }

    /// Whether an unknown largest v would explain a step: every weight moves in Adam's direction, and by no more.
    pub(super) fn could_be_amsgrad(
        &self, base: &Hypothesis, ours: &[Number], theirs: &[f64],
    ) -> Option<String> {
        if base.variant.optimizer != Optimizer::Adam || base.variant.settings.amsgrad {
            return None;
        }
        let weights = self.update.online.parameters();
        let (mut least, mut most) = (f64::INFINITY, 0.0_f64);
        for ((ours, &theirs), &weight) in ours.iter().zip(theirs).zip(weights) {
            let (step, moved) = (ours.value - weight, theirs - weight);
            let is_within = moved.abs() <= step.abs() + ours.tolerance();
            if !is_within || (moved * step < 0.0 && moved.abs() > ours.tolerance()) {
                return None;
            }
            if step.abs() > 100.0 * ours.tolerance() {
                (least, most) = (least.min(moved / step), most.max(moved / step));
            }
        }
        (least < most).then(|| {
            format!(
                "amsgrad: every weight moves in Adam's direction, by {least:.2} to {most:.2} of Adam's step. With `amsgrad` in the \
                 settings and `adam.vmax.*` in the file it can be judged"
            )
        })
    }

    /// Whether Q-values differ as with a dueling mean over the batch: by a number per row and one per action, which sum to 0.
    pub(super) fn is_dueling_over_batch(&self, ours: &[Number], theirs: &[f64]) -> bool {
        let rows = self.update.batch.rewards.len();
        let columns = ours.len() / rows;
        let differences: Vec<_> = ours.iter().zip(theirs).map(|(ours, theirs)| theirs - ours.value).collect();
        let scale = differences.iter().fold(0.0_f64, |most, difference| most.max(difference.abs()));
        let tolerance =
            ours.iter().map(Number::tolerance).fold(8.0 * self.update.rounding_unit * scale, f64::max);
        let at = |row: usize, column: usize| differences[column * rows + row];
        let of_row = |row: usize| (0..columns).map(|column| at(row, column)).sum::<f64>() / columns as f64;
        let of_row: Vec<f64> = (0..rows).map(of_row).collect();
        let of_column = |column: usize| (0..rows).map(|row| at(row, column)).sum::<f64>() / rows as f64;
        let mean = of_row.iter().sum::<f64>() / rows as f64;
        let is_sum = |column: usize| {
            let of_column = of_column(column);
            (0..rows).all(|row| (at(row, column) - of_row[row] - of_column + mean).abs() <= 4.0 * tolerance)
        };
        let varies = of_row.iter().any(|of_row| (of_row - mean).abs() > 8.0 * tolerance);
        rows > 3 && columns > 1 && mean.abs() <= tolerance && varies && (0..columns).all(is_sum)
    }
}

/// The roundest number within a share of x.
fn snapped(x: f64, tolerance: f64) -> f64 {
    let candidates = (0..6).map(|digits| rounded(x, digits));
    candidates.into_iter().find(|round| (round - x).abs() <= tolerance * x.abs()).unwrap_or(x)
}
