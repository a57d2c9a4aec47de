//! How the target network moves, by checksums and some of the weights of both networks after each update.

use super::file::{Trace, Updates, Vectors};
use super::{Judgement, counted, median};

/// Updates that are enough to speak of all of them.
const ENOUGH: usize = 50;
/// Tasks that a network learns within some ten thousand steps.
const SMALL_TASKS: [&str; 3] = ["CartPole", "Acrobot", "MountainCar"];
/// Updates without a new target network that no right loop has: for small tasks, and for others, where every 10,000 is usual.
const UNCHANGED: (usize, usize) = (1000, 12_000);
/// Updates after which the target network has got most of what was learned, at most, in a small task.
const SLOWEST: f64 = 10_000.0;

struct TargetMove {
    update: usize,
    /// Whether it is a copy of the online network before or after that update.
    is_copy: bool,
    /// τ, where it went a part of the way to the online network.
    tau: Option<f64>,
}

pub(super) fn judge(trace: &Trace, judgement: &mut Judgement) {
    let updates = &trace.updates;
    let all = updates.step.len();
    if all == 0 {
        return;
    }
    if updates.target_sample.width == 0 || updates.target.len() != all || updates.online.len() != all {
        judgement.fact("no target network".into());
        return;
    }
    let learned = (1..all).filter(|&update| updates.online[update] != updates.online[update - 1]).count();
    let equal = (0..all).filter(|&update| is_copy(updates, update)).count();
    let is_one = trace.header.same_object;
    if is_one || (all >= ENOUGH && learned * 2 > all && equal * 100 >= all * 98) {
        let object = if is_one { "; they are one object" } else { "" };
        judgement.name("target_is_online", format!("at {equal} of {all} updates{object}"));
        return;
    }
    let changed = (1..all).filter(|&update| updates.target[update] != updates.target[update - 1]);
    let change = |update| TargetMove { update, is_copy: is_copy(updates, update), tau: tau(updates, update) };
    let changes: Vec<TargetMove> = changed.map(change).collect();
    overwritten(updates, judgement);
    match &changes[..] {
        [] => unchanged(trace, learned, judgement),
        changes => moves(trace, changes, judgement),
    }
    not_initialised(trace, &changes, judgement);
}

/// Whether the target network is the online network before or after an update.
fn is_copy(updates: &Updates, update: usize) -> bool {
    updates.online[update.saturating_sub(1)..=update].contains(&updates.target[update])
}

/// τ of Δθ⁻ = τ (θ − θ⁻), where θ is the online network before or after the update; none where neither fits.
fn tau(updates: &Updates, update: usize) -> Option<f64> {
    let sample = |rows: &Vectors, update: usize| -> Vec<f64> {
        rows.row(update).iter().map(|&value| f64::from(value)).collect()
    };
    let (old, new) = (sample(&updates.target_sample, update - 1), sample(&updates.target_sample, update));
    let fit = |online: Vec<f64>| {
        let (mut product, mut square, mut moved) = (0.0, 0.0, 0.0);
        for ((old, new), online) in old.iter().zip(&new).zip(&online) {
            product += (new - old) * (online - old);
            square += (online - old) * (online - old);
            moved += (new - old) * (new - old);
        }
        let tau = product / square;
        // What is left when the move is explained.
        (tau, (moved - tau * product) / moved)
    };
    let fits = [update, update - 1].map(|at| fit(sample(&updates.online_sample, at)));
    let fits = fits.into_iter().filter(|(tau, left)| tau.is_finite() && *left < 0.01);
    fits.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(tau, _)| tau)
}

fn is_small(trace: &Trace) -> bool {
    SMALL_TASKS.iter().any(|task| trace.header.environment.starts_with(task))
}

fn unchanged(trace: &Trace, learned: usize, judgement: &mut Judgement) {
    let updates = trace.updates.step.len();
    let limit = if is_small(trace) { UNCHANGED.0 } else { UNCHANGED.1 };
    if judgement.has(&["online_overwritten_by_target"]) {
        return;
    }
    if learned >= limit {
        let numbers = format!("it has the same checksums at all of {updates} updates");
        judgement.name("target_never_updated", numbers);
    } else {
        judgement.fact(format!("the target network did not change in {}", counted(updates, "update")));
        judgement.doubt(format!(
            "whether the target network is ever updated: a record of more than {limit} updates shows it"
        ));
    }
}

fn moves(trace: &Trace, changes: &[TargetMove], judgement: &mut Judgement) {
    let (updates, all) = (&trace.updates, trace.updates.step.len());
    let gap = |column: &dyn Fn(usize) -> usize| {
        let gaps = changes.windows(2).map(|pair| column(pair[1].update) - column(pair[0].update));
        median(gaps.map(|gap| gap as f64).collect())
    };
    let every = |gap: f64, name: &str| match gap {
        1.0 => format!("every {name}"),
        gap => format!("every {gap} {name}s"),
    };
    let (wait, steps) = (gap(&|update| update), gap(&|update| updates.step[update]));
    let when = match (wait, steps) {
        (Some(updates), Some(steps)) => format!("{} ({})", every(updates, "update"), every(steps, "step")),
        _ => format!("once in {}", counted(all, "update")),
    };
    let copies = changes.iter().filter(|change| change.is_copy).count();
    let taus: Vec<f64> = changes.iter().filter_map(|change| change.tau).collect();
    let is_soft = copies * 10 < changes.len() && taus.len() * 2 > changes.len();
    let soft = median(taus).filter(|_| is_soft);
    judgement.fact(match soft {
        _ if copies * 10 >= changes.len() * 9 => format!("target network copied {when}"),
        Some(tau) => format!("target network moves by τ = {tau:.2e} of the way {when}"),
        None => format!("target network changes {when}"),
    });
    // Without a second change, the time since the first is what is known of the period.
    let wait = wait.unwrap_or_else(|| changes.last().map_or(0, |change| all - change.update) as f64);
    let nearly_all = soft.filter(|tau| (0.85..0.999_999).contains(tau));
    if let Some(tau) = nearly_all.filter(|_| wait <= 2.0 && changes.len() >= ENOUGH) {
        let times = changes.len();
        let numbers = format!("at {times} updates it went {tau:.4} of the way to the online network");
        judgement.name("tau_reversed", numbers);
    }
    let horizon = wait / soft.unwrap_or(1.0).clamp(1e-9, 1.0);
    if is_small(trace) && wait >= ENOUGH as f64 && horizon > SLOWEST {
        let numbers =
            format!("at this pace it takes about {horizon:.0} updates to get most of what was learned");
        judgement.name("target_updated_too_rarely", numbers);
    }
}

/// Updates at which the online network became what the target network had been before.
fn overwritten(updates: &Updates, judgement: &mut Judgement) {
    let width = updates.online_sample.width;
    if width != updates.target_sample.width || width == 0 {
        return;
    }
    let distance =
        |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from((a - b).abs())).fold(0.0, f64::max);
    let online = |update: usize| updates.online_sample.row(update);
    let moved = |update: usize| distance(online(update), online(update - 1));
    let steps = (1..updates.step.len()).map(moved).collect();
    let Some(step) = median(steps).filter(|step| *step > 0.0) else { return };
    let is_overwritten = |&update: &usize| {
        let target = &updates.target[update];
        let is_near = || distance(online(update), updates.target_sample.row(update)) < 3.0 * step;
        // Right after a copy the two are near each other anyway.
        update.checked_sub(ENOUGH).is_some_and(|before| updates.target[before] == *target)
            && updates.target[update - 1] == *target
            && updates.online[update - 1] != *target
            && (updates.online[update] == *target || (moved(update) > 20.0 * step && is_near()))
    };
    let found: Vec<usize> = (1..updates.step.len()).filter(is_overwritten).collect();
    if found.len() >= 2 {
        let (times, first) = (found.len(), found[0] + 1);
        let numbers = format!(
            "at {times} updates it became the target network, which had not changed; first at update {first}"
        );
        judgement.name("online_overwritten_by_target", numbers);
    }
}

/// Two networks that were never copied from each other have weights without correlation.
fn not_initialised(trace: &Trace, changes: &[TargetMove], judgement: &mut Judgement) {
    let Some(first) = trace.whole.first().filter(|whole| whole.number == 1) else { return };
    if changes.first().is_some_and(|change| change.update <= 1) || judgement.has(&["target_never_updated"]) {
        return;
    }
    let Some(update) = first.without_optimizer() else { return };
    let (Some(target), Some(after)) = (&update.target, &update.results.online) else { return };
    let (online, target) = (update.online.parameters(), target.parameters());
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let square = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>();
    let cosine = product(online, target) / (product(online, online) * product(target, target)).sqrt();
    // A high learning rate leads far from a copy, but not in one step.
    let is_far = square(online, target) > 25.0 * square(after.parameters(), online);
    if online.len() >= 200 && is_far && cosine.abs() < 0.3 {
        let weights = online.len();
        let numbers = format!(
            "at the second update the cosine of their {weights} weights is {cosine:.2}; that of a copy is near 1"
        );
        judgement.name("target_not_initialised", numbers);
    }
}
