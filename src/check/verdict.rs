//! Which mistakes reproduce somebody's numbers.

use std::cell::RefCell;

use serde::Serialize;

use super::catalogue::{CATALOGUE, Mistake, Stage};
use super::common::in_common;
use super::file::Update;
use super::reference::{Clipping, LossOf, Reference, Targets, Variant};
use super::rounding::{Number, agrees};

/// Most explanations that are followed at once.
const MAX_EXPLANATIONS: usize = 8;
/// Most products that are spent on pairs of mistakes in one quantity.
const MAX_PAIR_PRODUCTS: u64 = 1 << 32;

/// What is to be said of an update.
#[derive(Debug, Serialize)]
pub struct Verdict {
    /// Whether everything given is equal.
    pub equal: bool,
    /// The quantities, in the order in which they are computed.
    pub quantities: Vec<Judged>,
    /// The mistakes that reproduce the numbers together. Where several sets of mistakes do, each is one of these.
    pub explanations: Vec<Vec<Explained>>,
    /// Mistakes that would have given the same numbers, in this update.
    pub not_visible: Vec<String>,
    /// Whether pairs of mistakes were left out because they would take too long.
    pub pairs_left_out: bool,
}

/// One quantity.
#[derive(Debug, Serialize)]
pub struct Judged {
    /// Which.
    pub name: Stage,
    /// What it is, given the mistakes of the quantities before it.
    pub state: State,
    /// Its largest difference as a share of its largest number; none if it is absent.
    pub largest_relative_difference: Option<f64>,
    /// How many of its numbers differ.
    pub differing: usize,
    /// How many there are.
    pub numbers: usize,
    /// What the differing numbers have in common, if no known mistake reproduces them.
    pub in_common: Vec<String>,
}

/// See [`Judged`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// The file does not hold it.
    Absent,
    /// It agrees.
    Equal,
    /// It differs, and known mistakes reproduce it.
    Explained,
    /// It differs, and none do.
    Different,
}

/// A mistake in an explanation.
#[derive(Debug, Serialize)]
pub struct Explained {
    /// Its name.
    pub id: &'static str,
    /// The quantity by which it was found.
    pub quantity: Stage,
    /// Whether only that quantity has it: what was computed from there on does not.
    pub reported_only: bool,
    #[allow(missing_docs)]
    pub what: &'static str,
    #[allow(missing_docs)]
    pub why: &'static str,
    #[allow(missing_docs)]
    pub mend: &'static str,
}

/// What somebody may have computed.
#[derive(Clone)]
struct Hypothesis {
    variant: Variant,
    /// The mistakes in it, and by which quantity each was found.
    found: Vec<(&'static Mistake, Stage)>,
    /// Mistakes that one quantity has and the next have not.
    reported_only: Vec<(&'static Mistake, Stage)>,
    /// What follows is computed from their targets or gradients as they are: nothing explains them, or the targets are equal.
    takes_their_targets: bool,
    takes_their_gradients: bool,
}

impl Hypothesis {
    fn with(&self, mistake: &'static Mistake, stage: Stage) -> Self {
        let mut with = self.clone();
        with.variant = mistake.on(&self.variant);
        with.found.push((mistake, stage));
        with
    }
}

/// Judges targets, loss, gradients and weights, each given what explains the ones before it.
pub fn check(update: &Update) -> Verdict {
    let search = Search {
        update,
        reference: Reference::new(update),
        right: Variant::right(update),
        gradients: RefCell::new(None),
    };
    let mut hypotheses = vec![Hypothesis {
        variant: search.right,
        found: Vec::new(),
        reported_only: Vec::new(),
        takes_their_targets: false,
        takes_their_gradients: false,
    }];
    let mut quantities = Vec::new();
    let mut pairs_left_out = false;
    for stage in Stage::ALL {
        let Some(theirs) = search.theirs(stage) else {
            quantities.push(Judged::absent(stage));
            continue;
        };
        let ours = search.compute(&hypotheses[0], stage, 0);
        let mut judged = Judged::new(stage, &ours, theirs);
        let mut following: Vec<_> =
            hypotheses.iter().filter(|hypothesis| search.reproduces(hypothesis, stage)).cloned().collect();
        if following.is_empty() {
            let (explaining, left_out) = search.explain(&hypotheses, stage);
            following = explaining;
            pairs_left_out |= left_out;
        }
        match following.first() {
            None => {
                judged.in_common = in_common(update, stage, &ours, theirs);
                for hypothesis in &mut hypotheses {
                    hypothesis.takes_their_targets |= stage == Stage::Targets;
                    hypothesis.takes_their_gradients |= stage == Stage::Gradients;
                }
            }
            Some(first) if first.found.iter().any(|(_, quantity)| *quantity == stage) => {
                judged.state = State::Explained;
                hypotheses = following;
            }
            Some(first) => {
                judged = Judged::new(stage, &search.compute(first, stage, 0), theirs);
                judged.state = State::Equal;
                hypotheses = following;
                // Where two actions are equally good, theirs may have the value of the other one.
                for hypothesis in &mut hypotheses {
                    hypothesis.takes_their_targets |= stage == Stage::Targets;
                }
            }
        }
        quantities.push(judged);
    }
    let is_unexplained = quantities.iter().any(|quantity| quantity.state == State::Different);
    Verdict {
        equal: quantities.iter().all(|quantity| matches!(quantity.state, State::Absent | State::Equal)),
        not_visible: if is_unexplained { Vec::new() } else { search.not_visible(&hypotheses[0]) },
        explanations: hypotheses.iter().map(Hypothesis::explained).filter(|list| !list.is_empty()).collect(),
        quantities,
        pairs_left_out,
    }
}

struct Search<'a> {
    update: &'a Update,
    reference: Reference<'a>,
    right: Variant,
    /// The last gradients computed: many variants differ in the step alone.
    gradients: RefCell<Option<(Variant, usize, Vec<Number>)>>,
}

impl Search<'_> {
    fn theirs(&self, stage: Stage) -> Option<&[f64]> {
        let results = &self.update.results;
        match stage {
            Stage::Targets => results.targets.as_deref(),
            Stage::Loss => results.loss.as_ref().map(std::slice::from_ref),
            Stage::Gradients => results.gradients.as_ref().map(|network| network.parameters()),
            Stage::Weights => results.online.as_ref().map(|network| network.parameters()),
        }
    }

    /// A quantity; of gradients and weights those of the layers from `first` on.
    fn compute(&self, hypothesis: &Hypothesis, stage: Stage, first: usize) -> Vec<Number> {
        let Hypothesis { variant, takes_their_targets, takes_their_gradients, .. } = hypothesis;
        let parameters = self.first_parameter(first);
        if stage == Stage::Weights
            && *takes_their_gradients
            && let Some(gradients) = self.theirs(Stage::Gradients)
        {
            let gradients: Vec<_> = gradients.iter().copied().map(Number::exact).collect();
            return self.reference.weights(variant, &gradients, parameters);
        }
        let upstream = || -> (Targets, LossOf) {
            let mut targets = self.reference.targets(variant);
            if *takes_their_targets && let Some(theirs) = self.theirs(Stage::Targets) {
                targets.values = theirs.iter().copied().map(Number::exact).collect();
            }
            let loss = self.reference.loss(variant, &targets);
            (targets, loss)
        };
        match stage {
            Stage::Targets => self.reference.targets(variant).values,
            Stage::Loss => vec![upstream().1.value],
            Stage::Gradients | Stage::Weights => {
                // The step decides nothing before it.
                let key = Variant {
                    optimizer: self.right.optimizer,
                    epsilon: self.right.epsilon,
                    step: self.right.step,
                    decay: self.right.decay,
                    ..*variant
                };
                let mut cached = self.gradients.borrow_mut();
                if !cached.as_ref().is_some_and(|(of, from, _)| *of == key && *from == first) {
                    let (targets, loss) = upstream();
                    let gradients = self.reference.gradients(variant, &targets, &loss, first);
                    *cached = Some((key, first, gradients));
                }
                let gradients = cached.as_ref().map_or(&[][..], |(.., gradients)| gradients);
                match stage {
                    Stage::Weights => self.reference.weights(variant, gradients, parameters),
                    _ => gradients[parameters..].to_vec(),
                }
            }
        }
    }

    fn first_parameter(&self, layer: usize) -> usize {
        (0..layer).map(|layer| self.update.online.layer(layer).len()).sum()
    }

    /// Whether a hypothesis gives their numbers; the last layer alone says it for most that do not.
    fn reproduces(&self, hypothesis: &Hypothesis, stage: Stage) -> bool {
        let Some(theirs) = self.theirs(stage) else { return true };
        let last = self.update.online.num_layers() - 1;
        let is_split = stage >= Stage::Gradients && last > 0 && hypothesis.variant.clipping != Clipping::Norm;
        let first_layers = if is_split { &[last, 0][..] } else { &[0] };
        first_layers.iter().all(|&first| {
            let ours = self.compute(hypothesis, stage, first);
            let theirs =
                if stage >= Stage::Gradients { &theirs[self.first_parameter(first)..] } else { theirs };
            ours.iter().zip(theirs).all(|(ours, &theirs)| agrees(ours, theirs))
        })
    }

    /// The hypotheses with the fewest changes that give their numbers, and whether pairs were left out.
    fn explain(&self, hypotheses: &[Hypothesis], stage: Stage) -> (Vec<Hypothesis>, bool) {
        let reproducing = |candidates: Vec<Hypothesis>| -> Vec<Hypothesis> {
            let reproduce = candidates.into_iter().filter(|candidate| self.reproduces(candidate, stage));
            reproduce.take(MAX_EXPLANATIONS).collect()
        };
        let without: Vec<_> =
            hypotheses.iter().flat_map(|hypothesis| self.without_one(hypothesis, stage)).collect();
        let found = reproducing(without.clone());
        if !found.is_empty() {
            return (found, false);
        }
        for bases in [hypotheses, &without] {
            let found = reproducing(bases.iter().flat_map(|base| self.with_one(base, stage)).collect());
            if !found.is_empty() {
                return (found, false);
            }
        }
        let pairs: Vec<_> = hypotheses.iter().flat_map(|base| self.with_two(base, stage)).collect();
        let sizes = self.update.online.sizes();
        let outputs = sizes[sizes.len() - 2] * sizes[sizes.len() - 1];
        let is_whole = self.right.clipping != Clipping::Nothing;
        let parameters = if is_whole { self.update.online.parameters().len() } else { outputs };
        let products = if stage >= Stage::Gradients { parameters } else { 1 };
        let factors = [products, self.update.batch.rewards.len(), pairs.len()];
        if factors.into_iter().fold(1, |product: u64, factor| product.saturating_mul(factor as u64))
            > MAX_PAIR_PRODUCTS
        {
            return (Vec::new(), true);
        }
        (reproducing(pairs), false)
    }

    /// The mistakes that can show in a quantity: those that no quantity before it has ruled out.
    fn candidates(&self, stage: Stage) -> impl Iterator<Item = &'static Mistake> {
        let targets_are_judged = stage > Stage::Targets && self.theirs(Stage::Targets).is_some();
        let least = if targets_are_judged { Stage::Loss } else { Stage::Targets };
        let mut mistakes: Vec<_> =
            CATALOGUE.iter().filter(|mistake| (least..=stage).contains(&mistake.stage)).collect();
        mistakes.sort_by_key(|mistake| std::cmp::Reverse(mistake.stage));
        mistakes.into_iter()
    }

    /// Without one of the mistakes in the loss or the gradient: what was reported may not be what was used.
    fn without_one(&self, hypothesis: &Hypothesis, stage: Stage) -> Vec<Hypothesis> {
        let removable = |(mistake, found_by): &(&'static Mistake, Stage)| {
            mistake.stage > Stage::Targets && *found_by < stage
        };
        let without = |index: usize| {
            let mut without = hypothesis.clone();
            let removed = without.found.remove(index);
            without.reported_only.push(removed);
            without.variant =
                without.found.iter().fold(self.right, |variant, (mistake, _)| mistake.on(&variant));
            without
        };
        (0..hypothesis.found.len())
            .filter(|&index| removable(&hypothesis.found[index]))
            .map(without)
            .collect()
    }

    fn with_one(&self, base: &Hypothesis, stage: Stage) -> Vec<Hypothesis> {
        let candidates = self.candidates(stage).map(|mistake| base.with(mistake, stage));
        candidates.filter(|candidate| candidate.variant != base.variant).collect()
    }

    /// The first of the two is the one that is made first, so the catalogue's order decides.
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
        let last = Stage::ALL.into_iter().rfind(given);
        let hides = |mistake: &&'static Mistake| {
            let with = hypothesis.with(mistake, mistake.stage);
            let later = Stage::ALL.into_iter().filter(|stage| *stage >= mistake.stage);
            last.is_some_and(|last| mistake.stage <= last)
                && with.variant != hypothesis.variant
                && later.filter(given).all(|stage| self.reproduces(&with, stage))
        };
        CATALOGUE.iter().filter(hides).map(Mistake::name).collect()
    }
}

impl Hypothesis {
    fn explained(&self) -> Vec<Explained> {
        let explain = |(mistake, quantity): &(&'static Mistake, Stage), reported_only| {
            let Mistake { id, what, why, mend, .. } = *mistake;
            Explained { id, quantity: *quantity, reported_only, what, why, mend }
        };
        let mut all: Vec<_> = self.found.iter().map(|found| explain(found, false)).collect();
        all.extend(self.reported_only.iter().map(|found| explain(found, true)));
        all.sort_by_key(|explained| explained.quantity);
        all
    }
}

impl Judged {
    fn absent(name: Stage) -> Self {
        let (state, in_common) = (State::Absent, Vec::new());
        Self { name, state, largest_relative_difference: None, differing: 0, numbers: 0, in_common }
    }

    fn new(name: Stage, ours: &[Number], theirs: &[f64]) -> Self {
        let largest = |values: &mut dyn Iterator<Item = f64>| values.fold(0.0, f64::max);
        let difference =
            largest(&mut ours.iter().zip(theirs).map(|(ours, theirs)| (ours.value - theirs).abs()));
        let scale = largest(&mut ours.iter().map(|ours| ours.value.abs()));
        Self {
            name,
            state: State::Different,
            largest_relative_difference: Some(if difference == 0.0 { 0.0 } else { difference / scale }),
            differing: ours.iter().zip(theirs).filter(|(ours, theirs)| !agrees(ours, **theirs)).count(),
            numbers: theirs.len(),
            in_common: Vec::new(),
        }
    }
}
