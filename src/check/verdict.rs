//! Which mistakes reproduce somebody's numbers.

use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::thread;

use serde::Serialize;

use super::batch;
use super::file::Update;
use super::mistakes::{Mistake, Stage};
use super::reference::{LossOf, NORM_MARGIN, Reference, Targets};
use super::rounding::{Matrix, Number, SAFETY, agrees, short};
use super::variant::{Clipping, Predicted, QValues, Variant};

/// Most explanations that are followed at once.
const MAX_EXPLANATIONS: usize = 8;
/// Most products that are spent on mistakes, a few seconds: no time is counted, so that every machine gives one verdict.
const MAX_WORK: u64 = 20_000_000_000;
/// Gradients that are kept because many candidates share them.
const KEPT: usize = 3;
/// Most parameters of which several threads have gradients at the same time.
const MAX_PARALLEL: usize = 1 << 22;

#[derive(Debug, Default, Serialize)]
pub struct Verdict {
    pub equal: bool,
    /// What the batch shows by itself.
    pub batch: batch::BatchVerdict,
    /// The quantities, in the order in which they are computed.
    pub quantities: Vec<Judged>,
    /// The mistakes that reproduce the numbers together. Where several sets of mistakes do, each is one of these.
    pub explanations: Vec<Vec<Explained>>,
    /// What is a choice, or may be one.
    pub facts: Vec<String>,
    /// What could not be seen, and what would show it.
    pub unseen: Vec<String>,
    /// Mistakes that would have given the same numbers, in this update.
    pub not_visible: Vec<String>,
    /// How the norm of the gradient was shortened, where the two right ways differ.
    pub norm_clipping: Option<&'static str>,
    /// Mistakes that were not tried everywhere because that would take too long.
    pub(crate) mistakes_left_out: Vec<&'static str>,
    /// Whether pairs of mistakes were left out for that reason.
    pub pairs_left_out: bool,
}

#[derive(Debug, Serialize)]
pub struct Judged {
    pub name: Stage,
    /// How it compares, given the mistakes of the quantities before it.
    pub state: QuantityState,
    /// Its largest difference as a share of its largest number; none if it is absent.
    pub(crate) largest_relative_difference: Option<f64>,
    /// How many of its numbers differ.
    pub(crate) differing: usize,
    /// How many there are.
    pub(crate) numbers: usize,
    /// What those that differ have in common, where no mistake explains them.
    pub common: Option<String>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum QuantityState {
    /// The file does not hold it.
    Absent,
    Equal,
    /// It differs, and known mistakes reproduce it.
    Explained,
    /// It differs, and none do.
    Different,
}

#[derive(Clone, Debug, Serialize)]
pub struct Explained {
    #[serde(flatten)]
    pub mistake: &'static Mistake,
    /// The quantity by which it was found.
    pub(crate) quantity: Stage,
    /// Whether only that quantity has it: what was computed from there on does not.
    pub reported_only: bool,
    /// The number in it, or the numbers that prove it.
    pub measured: Option<String>,
}

/// What somebody may have computed.
#[derive(Clone)]
pub(super) struct Hypothesis {
    pub variant: Variant,
    /// The mistakes in it, the latest last.
    mistakes: Vec<Explained>,
    /// What follows is computed from their targets or gradients as they are: nothing explains them, or the targets are equal.
    takes_their_targets: bool,
    takes_their_gradients: bool,
}

impl Hypothesis {
    /// The same with another variant.
    pub(super) fn computing(&self, variant: Variant) -> Self {
        Self { variant, ..self.clone() }
    }

    fn with(&self, mistake: &'static Mistake, quantity: Stage) -> Self {
        let mut with = self.clone();
        with.variant = mistake.on(&self.variant);
        let measured = mistake.measured(&with.variant);
        with.mistakes.push(Explained { mistake, quantity, reported_only: false, measured });
        with
    }

    /// What it has is a finding, of which nothing follows for the rest.
    fn found(&mut self, id: &str, quantity: Stage, measured: Option<String>) {
        let explained = |mistake| Explained { mistake, quantity, reported_only: true, measured };
        self.mistakes.extend(Mistake::named(id).map(explained));
    }
}

/// Judges targets, loss, gradients and weights, each given what explains the ones before it.
pub fn check(update: &Update) -> Verdict {
    check_with(update, &|_, _, _| ())
}

/// As [`check`], and tells `progress` how many of the candidates for a quantity have been tried, and how many there are.
pub(crate) fn check_with(update: &Update, progress: &(dyn Fn(Stage, usize, usize) + Sync)) -> Verdict {
    let (reference, right) = (Reference::new(update), Variant::right(update));
    let (raw_gradients, work, untried) = (Mutex::default(), AtomicU64::new(0), Mutex::default());
    let search = Search { update, reference, right, raw_gradients, work, untried, progress };
    let right = |variant| Hypothesis {
        variant,
        mistakes: Vec::new(),
        takes_their_targets: false,
        takes_their_gradients: false,
    };
    let mut hypotheses: Vec<_> = Variant::all_right(update).into_iter().map(right).collect();
    let mut verdict = Verdict { batch: batch::judge(update), facts: search.facts(), ..Verdict::default() };
    for stage in update.results.q.as_ref().map(|_| Stage::Q).into_iter().chain(Stage::ALL) {
        let judged = search.judge(stage, &mut hypotheses, &mut verdict);
        verdict.quantities.push(judged);
    }
    search.judge_target_after(&mut hypotheses);
    if verdict.quantities.iter().all(|judged| judged.state != QuantityState::Different) {
        verdict.not_visible = search.not_visible(&hypotheses[0]);
    }
    for Hypothesis { mut mistakes, .. } in hypotheses {
        mistakes.sort_by_key(|explained| explained.quantity);
        verdict.explanations.extend(Some(mistakes).filter(|mistakes| !mistakes.is_empty()));
    }
    let is_equal = |judged: &Judged| matches!(judged.state, QuantityState::Absent | QuantityState::Equal);
    verdict.equal = verdict.quantities.iter().all(is_equal)
        && verdict.batch.mistakes.is_empty()
        && verdict.explanations.is_empty();
    let untried = search.untried.into_inner().unwrap_or_else(PoisonError::into_inner);
    (verdict.mistakes_left_out, verdict.pairs_left_out) = (untried.mistakes, untried.pairs);
    verdict
}

#[derive(Default)]
struct Untried {
    mistakes: Vec<&'static str>,
    pairs: bool,
}

pub(super) struct Search<'a> {
    pub update: &'a Update,
    reference: Reference<'a>,
    right: Variant,
    /// Gradients before they are clipped, and the ∂L/∂Q that each belongs to.
    raw_gradients: Mutex<Vec<(Matrix, Arc<Vec<Number>>)>>,
    /// Products so far.
    work: AtomicU64,
    untried: Mutex<Untried>,
    progress: &'a (dyn Fn(Stage, usize, usize) + Sync),
}

impl Search<'_> {
    /// Judges one quantity. The hypotheses that remain give its numbers as well, where any do.
    fn judge(&self, stage: Stage, hypotheses: &mut Vec<Hypothesis>, verdict: &mut Verdict) -> Judged {
        let Some(theirs) = self.theirs(stage) else {
            return Judged::new(stage, QuantityState::Absent, &[], &[]);
        };
        let ours = self.compute(&hypotheses[0], stage);
        let mut judged = Judged::new(stage, QuantityState::Different, &ours, theirs);
        let mut following = self.still_reproducing(hypotheses, &ours, stage);
        if let Some(place) = theirs.iter().position(|value| !value.is_finite()) {
            if hypotheses[0].mistakes.iter().any(|explained| explained.mistake.id == "not_finite") {
                judged.common = Some("as follows from the numbers above that are not finite".into());
                return judged;
            }
            following = hypotheses[..1].to_vec();
            following[0].found("not_finite", stage, Some(not_finite(place, theirs, &ours)));
        }
        if following.is_empty() {
            following = self.explain(hypotheses, stage);
        }
        if following.is_empty() && stage == Stage::Q {
            let is_dueling = self.is_dueling_over_batch(&ours, theirs);
            let id = if is_dueling { "dueling_mean_over_batch" } else { "another_network" };
            following = hypotheses[..1].to_vec();
            following[0].found(id, stage, None);
        }
        if let Some(first) = following.first() {
            if first.mistakes.iter().any(|explained| explained.quantity == stage) {
                judged.state = QuantityState::Explained;
            } else {
                judged = Judged::new(stage, QuantityState::Equal, &self.compute(first, stage), theirs);
            }
            *hypotheses = following;
        } else {
            judged.common = self.common(stage, &ours, theirs);
            verdict.unseen.extend(self.unseen(&hypotheses[0], stage, &ours, theirs));
        }
        for hypothesis in hypotheses.iter_mut() {
            // Also of equal targets: where two actions are equally good, theirs may have the value of the other one.
            hypothesis.takes_their_targets |=
                stage == Stage::Targets && judged.state != QuantityState::Explained;
            hypothesis.takes_their_gradients |=
                stage == Stage::Gradients && judged.state == QuantityState::Different;
        }
        if stage >= Stage::Gradients && judged.state != QuantityState::Different {
            let norm_clipping = || self.norm_clipping(&hypotheses[0], stage);
            verdict.norm_clipping = verdict.norm_clipping.or_else(norm_clipping);
        }
        judged
    }

    pub(super) fn theirs(&self, stage: Stage) -> Option<&[f64]> {
        let results = &self.update.results;
        match stage {
            Stage::Batch => None,
            Stage::Q => results.q.as_ref().map(|q| q.as_slice()),
            Stage::Targets => results.targets.as_deref(),
            Stage::Loss => results.loss.as_ref().map(std::slice::from_ref),
            Stage::Gradients => results.gradients.as_ref().map(|network| network.parameters()),
            Stage::Weights => results.online.as_ref().map(|network| network.parameters()),
        }
    }

    /// Their gradients, where the weights are computed from them as they are.
    pub(super) fn taken_gradients(&self, hypothesis: &Hypothesis, stage: Stage) -> Option<Vec<Number>> {
        let takes = stage == Stage::Weights && hypothesis.takes_their_gradients;
        let gradients = self.theirs(Stage::Gradients).filter(|_| takes)?;
        Some(gradients.iter().copied().map(Number::exact).collect())
    }

    pub(super) fn targets_and_loss(&self, hypothesis: &Hypothesis) -> (Targets, LossOf) {
        let mut targets = self.reference.targets(&hypothesis.variant);
        if hypothesis.takes_their_targets
            && let Some(theirs) = self.theirs(Stage::Targets)
        {
            targets.values = theirs.iter().copied().map(Number::exact).collect();
        }
        let loss = self.reference.loss(&hypothesis.variant, &targets);
        (targets, loss)
    }

    pub(super) fn compute(&self, hypothesis: &Hypothesis, stage: Stage) -> Vec<Number> {
        let variant = &hypothesis.variant;
        if let Some(gradients) = self.taken_gradients(hypothesis, stage) {
            return self.reference.weights(variant, &gradients, 0);
        }
        match stage {
            Stage::Batch => Vec::new(),
            Stage::Q => self.reference.q(variant),
            Stage::Targets => self.reference.targets(variant).values,
            Stage::Loss => vec![self.targets_and_loss(hypothesis).1.value],
            Stage::Gradients | Stage::Weights => {
                let (targets, loss) = self.targets_and_loss(hypothesis);
                let raw = self.raw_gradients(variant, &targets, &loss);
                let gradients = self.reference.changed(variant, raw.to_vec());
                if stage == Stage::Gradients {
                    gradients
                } else {
                    self.reference.weights(variant, &gradients, 0)
                }
            }
        }
    }

    /// Whether the gradient follows from ∂L/∂Q and the right network's pass.
    fn depends_on_q_alone(&self, variant: &Variant) -> bool {
        let is_right = variant.activations == self.right.activations;
        is_right && variant.predicted_from == QValues::Current && !variant.through_target
    }

    fn known_gradients(&self, variant: &Variant, loss: &LossOf) -> Option<Arc<Vec<Number>>> {
        if !self.depends_on_q_alone(variant) {
            return None;
        }
        let known = locked(&self.raw_gradients);
        known.iter().find(|(by_q, _)| *by_q == loss.by_q).map(|(_, gradients)| Arc::clone(gradients))
    }

    fn raw_gradients(&self, variant: &Variant, targets: &Targets, loss: &LossOf) -> Arc<Vec<Number>> {
        if let Some(known) = self.known_gradients(variant, loss) {
            return known;
        }
        let gradients = Arc::new(self.reference.raw_gradients(variant, targets, loss, 0));
        if self.depends_on_q_alone(variant) {
            let mut known = locked(&self.raw_gradients);
            // The first stays: it is that of most candidates.
            if known.len() == KEPT {
                known.remove(1);
            }
            known.push((loss.by_q.clone(), Arc::clone(&gradients)));
        }
        gradients
    }

    /// Which of the two right ways of shortening a norm they have taken, if the numbers tell.
    fn norm_clipping(&self, hypothesis: &Hypothesis, stage: Stage) -> Option<&'static str> {
        if hypothesis.variant.clipping != Clipping::Norm {
            return None;
        }
        let forms = [
            (NORM_MARGIN, "g c / (‖g‖ + 1e-6), as in PyTorch"),
            (0.0, "g c / ‖g‖, as in TensorFlow and Optax"),
        ];
        let mut fitting = forms.into_iter().filter(|(margin, _)| {
            let variant = Variant { norm_margin: Some(*margin), ..hypothesis.variant };
            self.reproduces(&hypothesis.computing(variant), stage)
        });
        let (first, second) = (fitting.next(), fitting.next());
        first.filter(|_| second.is_none()).map(|(_, name)| name)
    }

    pub(super) fn reproduces(&self, hypothesis: &Hypothesis, stage: Stage) -> bool {
        self.theirs(stage).is_none_or(|theirs| all_agree(&self.compute(hypothesis, stage), theirs))
    }

    /// Whether a candidate gives their numbers, as far as the last layer tells; or else how many products all layers take.
    fn first_look(&self, hypothesis: &Hypothesis, stage: Stage) -> Result<bool, u64> {
        let Some(theirs) = self.theirs(stage) else { return Ok(true) };
        if stage < Stage::Gradients || self.taken_gradients(hypothesis, stage).is_some() {
            return Ok(self.reproduces(hypothesis, stage));
        }
        let variant = &hypothesis.variant;
        let (targets, loss) = self.targets_and_loss(hypothesis);
        let last = self.update.online.num_layers() - 1;
        let first = (0..last).map(|layer| self.update.online.layer(layer).len()).sum();
        let is_norm = variant.clipping == Clipping::Norm;
        if !is_norm || stage == Stage::Gradients {
            let raw = self.reference.raw_gradients(variant, &targets, &loss, last);
            // The norm is that of all layers.
            let clipping = if is_norm { Clipping::Nothing } else { variant.clipping };
            let gradients = self.reference.changed(&Variant { clipping, ..*variant }, raw);
            let theirs = &theirs[first..];
            let agrees = match stage {
                Stage::Weights => all_agree(&self.reference.weights(variant, &gradients, first), theirs),
                _ if is_norm => self.could_be_shortened(&gradients[first..], theirs),
                _ => all_agree(&gradients[first..], theirs),
            };
            if !agrees || (last == 0 && !is_norm) {
                return Ok(agrees);
            }
        }
        let is_known = self.known_gradients(variant, &loss).is_some();
        Err(if is_known { self.step_work() } else { self.gradient_work(variant) })
    }

    /// Whether one factor of at most 1 could make theirs of ours. The error of the norm is allowed for with more than it has.
    fn could_be_shortened(&self, ours: &[Number], theirs: &[f64]) -> bool {
        let parameters = self.update.online.parameters().len() as f64;
        let rounding = SAFETY * self.update.rounding_unit * parameters.sqrt();
        let norm_error =
            0.02 + rounding + 2.0 * NORM_MARGIN / self.right.settings.max_gradient_norm.unwrap_or(1.0);
        let (mut least, mut most) = (0.0_f64, 1.0 + norm_error);
        for (ours, &theirs) in ours.iter().zip(theirs) {
            let tolerance = ours.tolerance() + norm_error * ours.value.abs();
            // theirs ≤ factor (ours + tolerance), and as much for −theirs.
            for (bound, theirs) in [(tolerance + ours.value, theirs), (tolerance - ours.value, -theirs)] {
                match bound {
                    bound if bound > 0.0 => least = least.max(theirs / bound),
                    bound if bound < 0.0 => most = most.min(theirs / bound),
                    _ if theirs > 0.0 => return false,
                    _ => {}
                }
            }
        }
        least <= most
    }

    /// Products of a first look at a candidate. What takes longer than a product counts as several.
    fn look_work(&self, candidate: &Hypothesis, stage: Stage) -> u64 {
        let (batch, sizes) = (self.update.batch.rewards.len(), self.update.online.sizes());
        let outputs = sizes[sizes.len() - 1];
        let is_square = candidate.variant.square.is_some()
            || matches!(
                candidate.variant.predicted,
                Predicted::EveryPair | Predicted::EveryColumn | Predicted::EveryColumnByRow
            );
        let pairs = if is_square { batch * batch } else { batch };
        let is_other = candidate.variant.activations != self.right.activations;
        let passes = if is_other { 8 * batch * self.update.online.parameters().len() } else { 0 };
        let layer = if stage >= Stage::Gradients { (sizes[sizes.len() - 2] + 1) * outputs } else { 0 };
        // A step from gradients as they are is computed as a whole.
        let takes = stage == Stage::Weights && candidate.takes_their_gradients;
        let step = if takes { self.step_work() } else { 64 * layer as u64 };
        (passes + 32 * (batch * outputs + pairs) + 3 * batch * layer) as u64 + step
    }

    /// Products of a step of all parameters.
    fn step_work(&self) -> u64 {
        64 * self.update.online.parameters().len() as u64
    }

    /// Products of the gradients of all layers.
    fn gradient_work(&self, variant: &Variant) -> u64 {
        let passes = if variant.through_target { 2 } else { 1 };
        let products = self.update.online.parameters().len() * self.update.batch.rewards.len();
        self.step_work() + 5 * passes * products as u64
    }

    /// Spends work, if there is enough left.
    fn affords(&self, work: u64) -> bool {
        let spend = |spent: u64| Some(spent.saturating_add(work)).filter(|spent| *spent <= MAX_WORK);
        self.work.fetch_update(Ordering::Relaxed, Ordering::Relaxed, spend).is_ok()
    }

    /// The candidates that give their numbers, in their order.
    fn reproducing(&self, candidates: Vec<Hypothesis>, stage: Stage) -> Vec<Hypothesis> {
        let (found, untried) = self.tried(candidates, stage);
        let mut known = locked(&self.untried);
        for id in untried.iter().filter_map(|candidate| Some(candidate.mistakes.last()?.mistake.id)) {
            if !known.mistakes.contains(&id) {
                known.mistakes.push(id);
            }
        }
        found
    }

    /// The candidates that give their numbers, in their order, and those that were not tried.
    fn tried(&self, candidates: Vec<Hypothesis>, stage: Stage) -> (Vec<Hypothesis>, Vec<Hypothesis>) {
        let (looked_at, mut untried): (Vec<_>, Vec<_>) =
            candidates.into_iter().partition(|candidate| self.affords(self.look_work(candidate, stage)));
        let looks = self.in_parallel(&looked_at, stage, |candidate| self.first_look(candidate, stage));
        let mut open = Vec::new();
        for (candidate, look) in looked_at.into_iter().zip(looks) {
            match look {
                Ok(false) => {}
                Ok(true) => open.push((candidate, true)),
                Err(work) if self.affords(work) => open.push((candidate, false)),
                Err(_) => untried.push(candidate),
            }
        }
        let verdicts = self.in_parallel(&open, stage, |(candidate, is_decided)| {
            *is_decided || self.reproduces(candidate, stage)
        });
        let found = open.into_iter().zip(verdicts).filter(|(_, reproduces)| *reproduces);
        (found.map(|((candidate, _), _)| candidate).collect(), untried)
    }

    /// The results of a function, in the order of the items, which several threads compute.
    fn in_parallel<T: Sync, R: Send + Sync>(
        &self, items: &[T], stage: Stage, function: impl Fn(&T) -> R + Sync,
    ) -> Vec<R> {
        let is_large = self.update.online.parameters().len() > MAX_PARALLEL;
        let cores = thread::available_parallelism().map_or(1, usize::from);
        let threads = if is_large { 1 } else { cores.min(items.len()) };
        let results: Vec<OnceLock<R>> = items.iter().map(|_| OnceLock::new()).collect();
        let (next, done) = (AtomicUsize::new(0), AtomicUsize::new(0));
        let work = || {
            while let index = next.fetch_add(1, Ordering::Relaxed)
                && let Some(item) = items.get(index)
            {
                let _ = results[index].set(function(item));
                (self.progress)(stage, done.fetch_add(1, Ordering::Relaxed) + 1, items.len());
            }
        };
        thread::scope(|scope| {
            (1..threads).for_each(|_| drop(scope.spawn(work)));
            work();
        });
        results.into_iter().filter_map(OnceLock::into_inner).collect()
    }

    /// The hypotheses that give the numbers of one more quantity as well; `ours` are those of the first.
    fn still_reproducing(&self, hypotheses: &[Hypothesis], ours: &[Number], stage: Stage) -> Vec<Hypothesis> {
        let first = self.theirs(stage).is_none_or(|theirs| all_agree(ours, theirs));
        let others = self.reproducing(hypotheses[1..].to_vec(), stage);
        hypotheses[..1].iter().filter(|_| first).cloned().chain(others).collect()
    }

    /// The hypotheses with the fewest changes that give their numbers.
    fn explain(&self, hypotheses: &[Hypothesis], stage: Stage) -> Vec<Hypothesis> {
        let fitted = |base| Variant { fitted: self.fitted(base, stage), ..base.variant };
        let hypotheses: Vec<_> = hypotheses.iter().map(|base| base.computing(fitted(base))).collect();
        let without: Vec<_> = hypotheses.iter().flat_map(|one| self.without_one(one, stage)).collect();
        let with_one = |all: &[Hypothesis]| all.iter().flat_map(|base| self.with_one(base, stage)).collect();
        for candidates in [without.clone(), with_one(&hypotheses), with_one(&without)] {
            let mut found = self.reproducing(candidates, stage);
            if !found.is_empty() {
                found.truncate(MAX_EXPLANATIONS);
                return found;
            }
        }
        let pairs = hypotheses.iter().flat_map(|base| self.with_two(base, stage)).collect();
        let (mut found, untried) = self.tried(pairs, stage);
        locked(&self.untried).pairs |= !untried.is_empty();
        found.truncate(MAX_EXPLANATIONS);
        found
    }

    /// The mistakes that can show in a quantity: those that no quantity before it has ruled out.
    fn candidates(&self, stage: Stage) -> impl Iterator<Item = &'static Mistake> {
        let is_judged = |of: Stage| stage > of && self.theirs(of).is_some();
        let least = match () {
            () if is_judged(Stage::Targets) => Stage::Loss,
            () if is_judged(Stage::Q) => Stage::Targets,
            () => Stage::Q,
        };
        let mut mistakes: Vec<_> =
            Mistake::of_updates().filter(|mistake| (least..=stage).contains(&mistake.stage)).collect();
        mistakes.sort_by_key(|mistake| std::cmp::Reverse(mistake.stage));
        mistakes.into_iter()
    }

    /// Without one of the mistakes in the loss or the gradient: what was reported may not be what was used.
    fn without_one(&self, hypothesis: &Hypothesis, stage: Stage) -> Vec<Hypothesis> {
        let is_removable = |explained: &Explained| {
            let is_reported =
                explained.mistake.stage > Stage::Targets || explained.mistake.id == "targets_of_every_pair";
            !explained.reported_only && is_reported && explained.quantity < stage
        };
        let without = |index: usize| {
            let mut without = hypothesis.clone();
            let removed = without.mistakes.remove(index);
            let computed = without.mistakes.iter().filter(|explained| !explained.reported_only);
            let right = Variant { fitted: hypothesis.variant.fitted, ..self.right };
            without.variant = computed.fold(right, |variant, explained| explained.mistake.on(&variant));
            without.mistakes.push(Explained { reported_only: true, ..removed });
            without
        };
        let all = 0..hypothesis.mistakes.len();
        all.filter(|&index| is_removable(&hypothesis.mistakes[index])).map(without).collect()
    }

    fn with_one(&self, base: &Hypothesis, stage: Stage) -> Vec<Hypothesis> {
        let mut found: Vec<Hypothesis> = Vec::new();
        for candidate in self.candidates(stage).map(|mistake| base.with(mistake, stage)) {
            let is_known = found.iter().any(|known| known.variant == candidate.variant);
            if candidate.variant != base.variant && !is_known {
                found.push(candidate);
            }
        }
        found
    }

    /// Both mistakes of each pair are applied in the order of the catalogue.
    fn with_two(&self, base: &Hypothesis, stage: Stage) -> Vec<Hypothesis> {
        let mut ordered: Vec<_> = self.candidates(stage).collect();
        ordered.sort_by_key(|mistake| mistake.stage);
        let singles: Vec<Variant> = ordered.iter().map(|mistake| mistake.on(&base.variant)).collect();
        let mut pairs = Vec::new();
        for (index, first) in ordered.iter().enumerate() {
            for second in &ordered[index + 1..] {
                let pair = base.with(first, stage).with(second, stage);
                if pair.variant != base.variant && !singles.contains(&pair.variant) {
                    pairs.push(pair);
                }
            }
        }
        pairs
    }

    /// The mistakes that would change none of the quantities given.
    fn not_visible(&self, hypothesis: &Hypothesis) -> Vec<String> {
        let given = |stage: &Stage| self.theirs(*stage).is_some();
        let Some(last) = Stage::ALL.into_iter().rfind(given) else { return Vec::new() };
        let is_judged = |mistake: &Mistake| mistake.stage > Stage::Q || self.theirs(Stage::Q).is_some();
        let is_fixed = |mistake: &Mistake| mistake.measured(&hypothesis.variant).is_none();
        // Without Q-values an activation that changes nothing shows in none of the quantities: that of the output is said.
        let is_said = |mistake: &Mistake| is_judged(mistake) || mistake.id.starts_with("output");
        let mistakes = Mistake::of_updates()
            .filter(|mistake| mistake.stage <= last && is_fixed(mistake) && is_said(mistake));
        let mut hidden: Vec<_> = mistakes.map(|mistake| hypothesis.with(mistake, mistake.stage)).collect();
        hidden.retain(|with| with.variant != hypothesis.variant);
        for stage in [Stage::Q].into_iter().chain(Stage::ALL).filter(given) {
            let shows = |with: &Hypothesis| with.mistakes.last().is_some_and(|last| last.quantity <= stage);
            let (concerned, others): (Vec<_>, Vec<_>) = hidden.into_iter().partition(shows);
            hidden = self.reproducing(concerned, stage).into_iter().chain(others).collect();
        }
        hidden.iter().filter_map(|with| with.mistakes.last()).map(|last| last.mistake.name()).collect()
    }

    /// What would explain numbers that nothing does, as far as something speaks for it.
    fn unseen(&self, base: &Hypothesis, stage: Stage, ours: &[Number], theirs: &[f64]) -> Option<String> {
        match stage {
            Stage::Gradients if self.update.before.is_none() => Some(
                "gradients of the updates before, where zero_grad is missing: `before.gradients.*` would show them".into(),
            ),
            Stage::Weights => self.could_be_amsgrad(base, ours, theirs),
            _ => None,
        }
    }

    /// What became of the target network.
    fn judge_target_after(&self, hypotheses: &mut [Hypothesis]) {
        let Update { results, target, .. } = self.update;
        let (Some(before), Some(after), Some(online)) = (target, &results.target, &results.online) else {
            return;
        };
        let moved = self.moved_to_online();
        let is_online = self.right.given.target_is_online && after == online && after != before;
        let reversed = moved.filter(|tau| (0.9..1.0).contains(tau));
        let way = |tau| format!("θ⁻ moves by {} of the way", short(tau));
        for hypothesis in hypotheses {
            match reversed {
                _ if is_online => hypothesis.found("target_is_online", Stage::Weights, None),
                Some(tau) => hypothesis.found("tau_reversed", Stage::Weights, Some(way(tau))),
                None => {}
            }
        }
    }

    /// The share of the way to the new online network that the target network has moved, if it is one for all weights.
    fn moved_to_online(&self) -> Option<f64> {
        let Update { results, target, rounding_unit: unit, .. } = self.update;
        let networks = [target.as_ref()?, results.target.as_ref()?, results.online.as_ref()?];
        let [before, after, online] = networks.map(|network| network.parameters());
        let ways = || (0..before.len()).map(|i| (after[i] - before[i], online[i] - before[i]));
        let (product, squares) =
            ways().fold((0.0, 0.0), |sum, (moved, way)| (sum.0 + moved * way, sum.1 + way * way));
        let tau = if squares > 0.0 { product / squares } else { 0.0 };
        let fits = |(i, (moved, way)): (usize, (f64, f64))| {
            (moved - tau * way).abs() <= 16.0 * unit * (before[i].abs() + online[i].abs())
        };
        ways().enumerate().all(fits).then_some(tau)
    }

    fn facts(&self) -> Vec<String> {
        let Update { results, adam, .. } = self.update;
        let is_online = self.right.given.target_is_online.then(|| {
            "your target network equals your online network: it was just copied, or is the same object".into()
        });
        let is_first = (adam.steps == 0 && self.right.is_adam()).then(|| {
            "Adam is at its first step: right for the first update of a training; an optimiser that is made anew before \
             every update is always there"
                .into()
        });
        let moves = results.target.as_ref().map(|_| match self.moved_to_online() {
            Some(tau) if tau.abs() < 1e-9 => "stays as it is".into(),
            Some(tau) if (tau - 1.0).abs() < 1e-6 => "is copied from the online network".into(),
            Some(tau) => format!("moves by {} of the way to the online network", short(tau)),
            None => "changes, and not towards the online network".into(),
        });
        let moves = moves.map(|what: String| format!("the target network {what}"));
        [is_online, is_first, moves].into_iter().flatten().collect()
    }
}

fn not_finite(place: usize, theirs: &[f64], ours: &[Number]) -> String {
    let count = theirs.iter().filter(|value| !value.is_finite()).count();
    let ours = ours.get(place).map_or(f64::NAN, |ours| ours.value);
    format!(
        "{count} of {} are not finite. The first, at position {place}, is {}; the finite numbers before it give {}",
        theirs.len(),
        theirs[place],
        short(ours)
    )
}

fn locked<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

fn all_agree(ours: &[Number], theirs: &[f64]) -> bool {
    ours.len() == theirs.len() && ours.iter().zip(theirs).all(|(ours, &theirs)| agrees(ours, theirs))
}

impl Judged {
    fn new(name: Stage, state: QuantityState, ours: &[Number], theirs: &[f64]) -> Self {
        let pairs = || ours.iter().zip(theirs);
        let difference = pairs().map(|(ours, theirs)| (ours.value - theirs).abs()).fold(0.0, f64::max);
        let scale = ours.iter().map(|ours| ours.value.abs()).fold(0.0, f64::max);
        let relative = if difference == 0.0 { 0.0 } else { difference / scale };
        let agreeing = pairs().filter(|(ours, theirs)| agrees(ours, **theirs)).count();
        let largest_relative_difference = (state != QuantityState::Absent).then_some(relative);
        let numbers = theirs.len();
        // Of another shape all of them differ.
        let differing = numbers - if ours.len() == numbers { agreeing } else { 0 };
        Self { name, state, largest_relative_difference, differing, numbers, common: None }
    }
}
