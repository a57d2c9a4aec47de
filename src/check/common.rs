//! What numbers that no known mistake reproduces have in common.

use super::catalogue::Stage;
use super::file::Update;
use super::rounding::{Number, agrees};

/// How well a factor or an offset must fit, beside the tolerance.
const FIT: f64 = 1e-5;

/// One sentence for each thing that the differing numbers have in common.
pub(super) fn in_common(update: &Update, stage: Stage, ours: &[Number], theirs: &[f64]) -> Vec<String> {
    let differing: Vec<usize> = (0..theirs.len()).filter(|&i| !agrees(&ours[i], theirs[i])).collect();
    let mut found = match stage {
        Stage::Targets => samples(update, &differing),
        Stage::Loss => None,
        Stage::Gradients | Stage::Weights => tensors(update, &differing),
    }
    .into_iter()
    .collect::<Vec<_>>();
    let before = |index: usize| match stage {
        Stage::Targets => update.batch.rewards[index],
        Stage::Weights => update.online.parameters()[index],
        Stage::Loss | Stage::Gradients => 0.0,
    };
    let pairs = |from: &dyn Fn(usize) -> f64| -> Vec<(f64, f64, f64)> {
        let pair = |&i: &usize| (ours[i].value - from(i), theirs[i] - from(i), ours[i].tolerance());
        differing.iter().map(pair).collect()
    };
    let whole = pairs(&|_| 0.0);
    if let Some(factor) = factor(&whole)
        && stage != Stage::Weights
    {
        found.push(format!("they are ours times {factor:.6}"));
    }
    if let Some(factor) = factor(&pairs(&before)) {
        match stage {
            Stage::Targets if update.batch.discounts.windows(2).all(|pair| pair[0] == pair[1]) => {
                let discount = factor * update.batch.discounts[0];
                found.push(format!(
                    "without the reward they are ours times {factor:.6}, as with γ = {discount:.6}"
                ));
            }
            Stage::Targets => found.push(format!("without the reward they are ours times {factor:.6}")),
            Stage::Weights => found.push(format!("their step is ours times {factor:.6}")),
            Stage::Loss | Stage::Gradients => {}
        }
    }
    if let Some(offset) = offset(&whole)
        && stage == Stage::Targets
    {
        found.push(format!("theirs minus ours is always {offset:.6}"));
    }
    if stage == Stage::Gradients && found.is_empty() {
        found.push("a forgotten zero_grad adds the gradients of all updates before".into());
    }
    found
}

/// Which samples differ.
fn samples(update: &Update, differing: &[usize]) -> Option<String> {
    let batch = &update.batch;
    let size = batch.rewards.len();
    if differing.len() == size {
        return Some("every sample differs".into());
    }
    let truncated = batch.truncated.clone().unwrap_or_else(|| vec![false; size]);
    let mut kinds: Vec<(String, Vec<bool>)> = vec![
        ("terminated".into(), batch.terminated.clone()),
        ("truncated".into(), truncated),
        ("not terminated".into(), batch.terminated.iter().map(|terminated| !terminated).collect()),
    ];
    for action in 0..update.online.sizes().last().copied().unwrap_or(0) {
        let is_action = batch.actions.iter().map(|&taken| taken == action).collect();
        kinds.push((format!("of action {action}"), is_action));
    }
    let all = |members: &[bool]| differing.iter().all(|&sample| members[sample]);
    let exactly = kinds.iter().find(|(_, members)| {
        all(members) && members.iter().filter(|&&member| member).count() == differing.len()
    });
    let name = |kind: &(String, Vec<bool>)| kind.0.clone();
    match (exactly, kinds.iter().find(|(_, members)| differing.len() > 1 && all(members))) {
        (Some(kind), _) => Some(format!("the samples that differ are exactly those {}", name(kind))),
        (None, Some(kind)) => Some(format!("the samples that differ are all {}", name(kind))),
        (None, None) => None,
    }
}

/// Which tensors differ.
fn tensors(update: &Update, differing: &[usize]) -> Option<String> {
    let mut names = Vec::new();
    let (mut start, mut tensors) = (0, 0);
    for (index, pair) in update.online.sizes().windows(2).enumerate() {
        for (kind, length) in [("weight", pair[0] * pair[1]), ("bias", pair[1])] {
            if differing.iter().any(|position| (start..start + length).contains(position)) {
                names.push(format!("{}.{kind}", 2 * index));
            }
            start += length;
            tensors += 1;
        }
    }
    (names.len() < tensors).then(|| format!("only {} differ", names.join(", ")))
}

/// The factor between pairs (ours, theirs, tolerance), if it is always the same.
fn factor(pairs: &[(f64, f64, f64)]) -> Option<f64> {
    let products: f64 = pairs.iter().map(|(ours, theirs, _)| ours * theirs).sum();
    let squares: f64 = pairs.iter().map(|(ours, ..)| ours * ours).sum();
    let factor = products / squares;
    let fits = |(ours, theirs, tolerance): &(f64, f64, f64)| {
        (theirs - factor * ours).abs() <= 2.0 * tolerance * factor.abs().max(1.0) + FIT * theirs.abs()
    };
    (factor.is_finite() && factor != 0.0 && pairs.iter().all(fits)).then_some(factor)
}

/// The difference between pairs (ours, theirs, tolerance), if it is always the same.
fn offset(pairs: &[(f64, f64, f64)]) -> Option<f64> {
    let offset = pairs.iter().map(|(ours, theirs, _)| theirs - ours).sum::<f64>() / pairs.len() as f64;
    let fits = |(ours, theirs, tolerance): &(f64, f64, f64)| {
        (theirs - ours - offset).abs() <= 2.0 * tolerance + FIT * offset.abs()
    };
    (pairs.len() > 1 && pairs.iter().all(fits)).then_some(offset)
}
