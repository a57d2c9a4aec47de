//! When the network learns, and how; whole updates.

use std::borrow::Cow;
use std::collections::BTreeSet;

use super::super::activation::LayerKinds;
use super::super::file::{Settings, Update};
use super::super::mistakes::Stage;
use super::super::pass::forward;
use super::super::reference::Reference;
use super::super::rounding::agrees;
use super::super::variant::Variant;
use super::super::verdict::{Explained, QuantityState, Verdict, check_with};
use super::ends::Episodes;
use super::file::{Told, Trace, Whole};
use super::{Judgement, counted, median};
use crate::nn::Loss;

/// Updates that are enough to speak of all of them.
const ENOUGH: usize = 20;
/// By how much a target may be above the largest return that the rewards allow.
const BEYOND: f64 = 5.0;
/// Whole updates that are judged.
const JUDGED: usize = 3;
/// Weights times transitions up to which so many are judged; of larger ones one.
const MAX_PRODUCTS: usize = 1 << 24;
/// What γ may be where it was not told.
const GAMMAS: [f64; 8] = [0.99, 0.95, 0.9, 0.98, 0.999, 0.995, 0.97, 1.0];

pub(super) fn judge(trace: &Trace, episodes: &Episodes, judgement: &mut Judgement) {
    let (updates, steps) = (&trace.updates, trace.steps.action.len());
    let all = updates.step.len();
    let Some(&first) = updates.step.first() else {
        judgement.doubt(
            "no update was recorded, so nothing is said of learning: call recorder.learned after each",
        );
        return;
    };
    let size = updates.batch_size.last().filter(|size| **size > 0);
    let size = size.map_or(String::new(), |size| format!(" with minibatches of {size}"));
    let rate = all as f64 / (steps - first.min(steps)).max(1) as f64;
    judgement.fact(format!(
        "{}{size}, the first after {}, {rate:.2} per step since",
        counted(all, "update"),
        counted(first, "step")
    ));
    if all >= ENOUGH && updates.online.iter().all(|checksums| *checksums == updates.online[0]) {
        judgement.name("online_never_changes", format!("its checksums are the same at all of {all} updates"));
    }
    at_ends_only(trace, judgement);
    while_evaluating(trace, episodes, judgement);
    diverges(trace, judgement);
    let done = &updates.optimizer_steps;
    if all >= ENOUGH && done.len() == all && done[0] >= 0.0 && done.iter().all(|steps| *steps <= 1.0) {
        let numbers = format!("its step count is at most {} at all of {all} updates", done[all - 1]);
        judgement.name("optimizer_made_anew", numbers);
    }
}

fn at_ends_only(trace: &Trace, judgement: &mut Judgement) {
    let (updates, steps) = (&trace.updates.step, trace.steps.action.len());
    let places: BTreeSet<usize> = updates.iter().copied().collect();
    let is_end = |place: &usize| place.checked_sub(1).is_some_and(|row| row < steps && trace.ended(row));
    if trace.header.environments > 1 || places.len() < 10 || !places.iter().all(is_end) {
        return;
    }
    let updates = updates.len();
    let numbers = format!("{updates} updates in {steps} steps, all of them at the ends of episodes");
    match updates * 8 <= steps {
        true => judgement.name("learns_at_episode_ends_only", numbers),
        false => judgement.fact(numbers),
    }
}

/// Whole episodes with ε = 0 between others, during which there are updates.
fn while_evaluating(trace: &Trace, episodes: &Episodes, judgement: &mut Judgement) {
    let epsilon = &trace.steps.epsilon;
    if epsilon.is_empty() || trace.header.environments > 1 {
        return;
    }
    let ends = episodes.starts.iter().skip(1).copied().chain([epsilon.len()]);
    let place = |end: usize| trace.updates.step.partition_point(|step| *step < end);
    // Whether each episode is greedy, and how many updates it has.
    let played = episodes.starts.iter().zip(ends).map(|(&start, end)| {
        (epsilon[start..end].iter().all(|value| *value == 0.0), place(end) - place(start + 1))
    });
    let played: Vec<(bool, usize)> = played.collect();
    let blocks = played.windows(2).filter(|pair| !pair[0].0 && pair[1].0).count();
    let returns = played.windows(2).filter(|pair| pair[0].0 && !pair[1].0).count();
    let greedy = played.iter().filter(|(is_greedy, learned)| *is_greedy && *learned > 0);
    let greedy: Vec<usize> = greedy.map(|(_, learned)| *learned).collect();
    if blocks >= 2 && returns >= 2 && greedy.len() >= 2 {
        let (episodes, updates) = (greedy.len(), greedy.iter().sum::<usize>());
        let numbers = format!("{episodes} episodes with ε = 0 between others have {updates} updates");
        judgement.name("learns_while_evaluating", numbers);
    }
}

fn diverges(trace: &Trace, judgement: &mut Judgement) {
    let (updates, batches) = (&trace.updates, &trace.batches);
    let first_infinite = |values: &[f64]| values.iter().position(|value| value.is_infinite());
    let infinite = [&updates.loss, &updates.largest_target].into_iter().filter_map(|all| first_infinite(all));
    if let Some(at) = infinite.min() {
        judgement.name("diverges", format!("loss or targets of update {} are not finite", at + 1));
        return;
    }
    let discount = batches.discounts.iter().copied().reduce(f64::max);
    let is_known = discount.is_some() || trace.told.has("gamma");
    let discount = discount.unwrap_or(trace.told.settings.gamma);
    let rewards = batches.rewards.iter().chain(&trace.steps.reward);
    let bound = rewards.map(|reward| reward.abs()).fold(0.0, f64::max) / (1.0 - discount);
    let last = &updates.largest_target[updates.largest_target.len() * 9 / 10..];
    let Some(largest) = median(last.to_vec()).filter(|_| bound > 0.0 && bound.is_finite()) else { return };
    if is_known && last.len() >= ENOUGH && largest > BEYOND * bound {
        let updates = last.len();
        let numbers = format!(
            "targets of the last {updates} updates reach {largest:.3e}, and no return is above {bound:.1}"
        );
        judgement.name("diverges", numbers);
    } else {
        judgement
            .fact(format!("the largest targets are {largest:.3} at the end; no return is above {bound:.1}"));
    }
}

pub(super) fn judge_whole(
    trace: &Trace, judgement: &mut Judgement, progress: &(dyn Fn(Stage, usize, usize) + Sync),
) {
    let updates = trace.whole.iter().filter_map(|whole| Some((whole, whole.without_optimizer()?)));
    let updates: Vec<(&Whole, &Update)> = updates.collect();
    let Some((_, first)) = updates.first() else {
        if trace.updates.step.len() > ENOUGH {
            judgement.doubt(
                "the updates themselves: none was recorded whole, which needs dense layers with ReLU between them, and the \
                 batch. save_update of one update shows as much",
            );
        }
        return;
    };
    dead(&updates, judgement);
    unchanged_layers(&updates, judgement);
    if trace.updates.optimizer_steps.last().is_none_or(|steps| *steps < 1.5) {
        first_steps(&updates, judgement);
    }
    let mut order = vec![updates.len() - 1, 0, updates.len() / 2];
    order.dedup();
    let is_large = first.online.parameters().len() * first.batch.rewards.len() > MAX_PRODUCTS;
    let mut equal = Vec::new();
    for &index in order.iter().take(if is_large { 1 } else { JUDGED }) {
        let whole = updates[index].0;
        let forward = whole.forward().map(|update| (Variant::right(&update), check_with(&update, progress)));
        let activations = forward.as_ref().map_or(LayerKinds::RIGHT, |(right, verdict)| {
            let mistakes = verdict.explanations.first().into_iter().flatten();
            mistakes.fold(*right, |variant, explained| explained.mistake.on(&variant)).activations
        });
        let mut verdicts = Vec::new();
        for update in as_told(whole, activations) {
            verdicts.push(check_with(&update, progress));
            if verdicts.last().is_some_and(|verdict| verdict.equal) {
                verdicts.drain(..verdicts.len() - 1);
                equal.push(update.settings);
                break;
            }
        }
        let Some(verdict) = verdicts.first() else { continue };
        for verdict in forward.iter().map(|(_, verdict)| verdict).chain([verdict]) {
            explain(whole, verdict, judgement);
        }
        if !verdict.equal {
            break;
        }
    }
    if let Some(settings) = equal.last() {
        let loss = if settings.loss == Loss::Mse { "mse" } else { "huber" };
        let double = if settings.double { ", double" } else { "" };
        let (updates, gamma) = (counted(equal.len(), "update"), settings.gamma);
        judgement
            .fact(format!("{updates} computed again and equal, with gamma {gamma}, loss {loss}{double}"));
    }
}

/// Tensors that are the same in the first whole update and after the last.
fn unchanged_layers(updates: &[(&Whole, &Update)], judgement: &mut Judgement) {
    let [(from, first), .., (to, last)] = updates else { return };
    let Some(after) = &last.results.online else { return };
    let apart = to.number - from.number;
    if apart < 5 * ENOUGH || judgement.has(&["online_never_changes", "units_die"]) {
        return;
    }
    let still = (0..after.num_layers()).flat_map(|layer| {
        let weights = after.sizes()[layer] * after.sizes()[layer + 1];
        let (before, after) = (first.online.layer(layer), after.layer(layer));
        let weight = (before[..weights] == after[..weights]).then(|| format!("{}.weight", 2 * layer));
        let bias = (before[weights..] == after[weights..]).then(|| format!("{}.bias", 2 * layer));
        [weight, bias].into_iter().flatten()
    });
    let still = still.collect::<Vec<_>>().join(", ");
    if !still.is_empty() {
        judgement.name("layer_never_changes", format!("{still} is the same {apart} updates later"));
    }
}

/// Hidden layers that are 0 for every observation.
fn dead(updates: &[(&Whole, &Update)], judgement: &mut Judgement) {
    // Only of a network whose targets are those of dense layers with ReLU between them.
    let is_known = |update: &Update| {
        update.results.targets.is_some() && equal_in_targets_and_loss(update, LayerKinds::RIGHT)
    };
    let Some((whole, _)) = updates.last() else { return };
    let Some(update) = as_told(whole, LayerKinds::RIGHT).into_iter().find(is_known) else { return };
    let pass = forward(&update.online, &update.batch.observations, LayerKinds::RIGHT, update.rounding_unit);
    let (mut all, mut silent) = (0, 0);
    for layer in 1..update.online.num_layers() {
        let outputs = &pass.outputs[layer - 1].value;
        let (rows, units) = outputs.shape();
        let dead = outputs.column_iter().filter(|unit| unit.iter().all(|value| *value <= 0.0)).count();
        if dead == units {
            // That nothing else changes follows.
            judgement.mistakes.retain(|found| found.mistake.id != "online_never_changes");
            let at = whole.number + 1;
            let numbers = format!(
                "at update {at} all {units} units of hidden layer {layer} are 0 for {rows} observations"
            );
            judgement.name("units_die", numbers);
            return;
        }
        all += units;
        silent += dead;
    }
    if silent > 0 {
        judgement.fact(format!("{silent} of {all} hidden units are 0 for all observations of a minibatch"));
    }
}

/// The first step of Adam is the learning rate for every weight with a gradient.
fn first_steps(updates: &[(&Whole, &Update)], judgement: &mut Judgement) {
    let is_first = |(whole, update): &&(&Whole, &Update)| {
        let Some(after) = &update.results.online else { return false };
        let pairs = after.parameters().iter().zip(update.online.parameters());
        let steps: Vec<f64> =
            pairs.map(|(after, before)| (after - before).abs()).filter(|step| *step > 0.0).collect();
        let longest = steps.iter().copied().fold(0.0, f64::max);
        let alike = steps.iter().filter(|step| **step > 0.98 * longest).count();
        whole.number > 0 && steps.len() >= 50 && alike * 100 >= steps.len() * 90
    };
    let (found, all) = (updates.iter().filter(is_first).count(), updates.len());
    if found >= 3 && found * 10 >= all * 8 && !judgement.has(&["optimizer_made_anew"]) {
        let numbers = format!(
            "in {found} of {all} whole updates nearly all weights move by the same amount, as in Adam's first step"
        );
        judgement.name("optimizer_made_anew", numbers);
    }
}

/// An update under the settings that were told, with the target network of before it and of after it: a soft update may come
/// before or after the targets. What was not told is as it makes targets and loss equal; then only what is equal is given.
fn as_told(whole: &Whole, activations: LayerKinds) -> Vec<Update> {
    let told = &whole.told;
    let remembers = |update: &Update| update.adam.steps > 0 || told.has("optimizer");
    let has_optimizer =
        told.has("learning_rate") && whole.update(told.settings, before).as_ref().is_some_and(remembers);
    let is_kept =
        |name: &str| has_optimizer || !["adam.", "result.online."].iter().any(|of| name.starts_with(of));
    let losses = if told.has("loss") { vec![told.settings.loss] } else { vec![Loss::Mse, Loss::Huber] };
    let doubles = if told.has("double") { vec![told.settings.double] } else { vec![false, true] };
    let gammas = if told.has("gamma") { vec![told.settings.gamma] } else { GAMMAS.to_vec() };
    let all = gammas.iter().flat_map(|&gamma| doubles.iter().map(move |&double| (gamma, double)));
    let all = all.flat_map(|(gamma, double)| losses.iter().map(move |&loss| (gamma, double, loss)));
    let mut first = Vec::new();
    for (gamma, double, loss) in all {
        let settings = Settings { gamma, double, loss, ..told.settings };
        let named = |name: fn(&str) -> Option<Cow<str>>| {
            whole.update(settings, |old| name(old).filter(|_| is_kept(old)))
        };
        let updates: Vec<Update> = [before, after].into_iter().filter_map(named).collect();
        let is_equal = |update: &&Update| equal_in_targets_and_loss(update, activations);
        let equal: Vec<Update> = updates.iter().filter(is_equal).cloned().collect();
        if !equal.is_empty() {
            return equal;
        }
        if first.is_empty() {
            first = updates;
        }
    }
    first
}

/// The names of an update with the target network from before it.
fn before(name: &str) -> Option<Cow<'_, str>> {
    (name != "result.q").then(|| name.into())
}

/// The names of an update with the target network from after it.
fn after(name: &str) -> Option<Cow<'_, str>> {
    match name.strip_prefix("result.target.") {
        Some(rest) => Some(format!("target.{rest}").into()),
        None => before(name).filter(|_| !name.starts_with("target.")),
    }
}

fn equal_in_targets_and_loss(update: &Update, activations: LayerKinds) -> bool {
    let (reference, right) = (Reference::new(update), Variant { activations, ..Variant::right(update) });
    let targets = reference.targets(&right);
    let loss = reference.loss(&right, &targets);
    let results = &update.results;
    let are_theirs = |all: &Vec<f64>| targets.values.iter().zip(all).all(|(ours, y)| agrees(ours, *y));
    results.targets.as_ref().is_none_or(are_theirs)
        && results.loss.is_none_or(|theirs| agrees(&loss.value, theirs))
}

/// What is wrong with an update, as far as the recorder was told how it should be.
fn explain(whole: &Whole, verdict: &Verdict, judgement: &mut Judgement) {
    let place = format!("update {}", whole.number + 1);
    for found in &verdict.batch.mistakes {
        judgement.name(found.mistake.id, format!("{place}: {}", found.evidence));
    }
    let unexplained = verdict.quantities.iter().find(|quantity| quantity.state == QuantityState::Different);
    if let Some(quantity) = unexplained {
        let (name, differing, numbers) = (quantity.name.name(), quantity.differing, quantity.numbers);
        judgement.doubt(format!(
            "why the {name} of {place} differ in {differing} of {numbers} numbers: a setting that the recorder was not told \
             would do this, or a mistake that is not known. save_update of one update shows more"
        ));
        return;
    }
    for explained in verdict.explanations.first().into_iter().flatten() {
        let mistake = explained.mistake;
        let quantity = verdict.quantities.iter().find(|quantity| quantity.name == explained.quantity);
        let numbers = match (&explained.measured, quantity) {
            (Some(measured), _) => format!("{place}: {measured}"),
            (None, Some(quantity)) => format!(
                "{} of the {} {} of {place} differ from the right ones, and this gives theirs",
                quantity.differing,
                quantity.numbers,
                quantity.name.name()
            ),
            (None, None) => place.clone(),
        };
        if mistake.id == "another_network" {
            judgement.doubt(format!(
                "the forward pass at {place}: it is not that of dense layers with an activation between them. A scaled \
                 observation or another layer would do this"
            ));
        } else if is_choice(explained, &whole.told) {
            judgement.fact(format!("in {place}, {}", mistake.what));
        } else {
            judgement.name(mistake.id, numbers);
        }
    }
}

/// Whether nobody has said that it should be otherwise.
fn is_choice(explained: &Explained, told: &Told) -> bool {
    let (id, quantity) = (explained.mistake.id, explained.mistake.stage);
    id.starts_with("hidden_") && id != "hidden_linear"
        || (id.contains("clipped") && !told.has("max_gradient_norm") && !told.has("clip_value"))
        || (id.contains("discount") && !told.has("gamma"))
        || (id.starts_with("double") && !told.has("double"))
        || (quantity == Stage::Loss && !told.has("loss"))
        || (quantity == Stage::Weights && !told.has("learning_rate"))
}
