//! ε, Q-values and actions.

use nalgebra::DMatrix;

use super::super::activation::LayerKinds;
use super::super::pass::forward;
use super::ends::Episodes;
use super::file::{Steps, Trace, Whole};
use super::{Judgement, count, counted};
use crate::nn::Mlp;

/// Steps that are enough to speak of all of them.
const ENOUGH: usize = 500;
/// A natural logarithm by which one explanation must be likelier than another.
const CLEAR: f64 = 25.0;
/// An ε of most steps at random.
const LARGE: f64 = 0.5;
/// Steps and episodes within which ε falls at once.
const AT_ONCE: (usize, usize) = (100, 15);

/// A step with Q-values: its ε, whether its action is the largest, and the smallest.
struct Choice {
    row: usize,
    epsilon: f64,
    is_largest: bool,
}

pub(super) fn judge(trace: &Trace, episodes: &Episodes, judgement: &mut Judgement) {
    let steps = &trace.steps;
    if steps.action.is_empty() {
        return;
    }
    schedule(trace, episodes, judgement);
    let learns_from = trace.updates.step.first().copied();
    let choices = choices(steps, learns_from.unwrap_or(0));
    let told = choices.len() + learns_from.unwrap_or(0);
    let is_told = steps.q_values.width >= 2;
    if !is_told || !steps.epsilon.iter().any(|value| value.is_finite()) {
        judgement.doubt(
            "how actions are chosen: recorder.acting(q_values=q, epsilon=epsilon) before env.step shows it"
                .into(),
        );
    }
    if is_told && told * 100 < steps.action.len() * 99 {
        judgement.doubt("whether ε is applied: the Q-values of some steps were not told; tell them also where the action is random".into());
    } else if is_told
        && learns_from.is_some()
        && !trace.header.tensors.iter().any(|name| name.contains("sigma"))
    {
        behaviour(trace, &choices, judgement);
    }
    missed(trace, &choices, judgement);
    old_observations(trace, judgement);
}

/// What ε does.
fn schedule(trace: &Trace, episodes: &Episodes, judgement: &mut Judgement) {
    let epsilon = &trace.steps.epsilon;
    let told: Vec<(usize, f64)> =
        epsilon.iter().copied().enumerate().filter(|(_, value)| value.is_finite()).collect();
    let (Some(&(_, first)), Some(&(end, last))) = (told.first(), told.last()) else {
        return;
    };
    let least = told.iter().map(|(_, value)| *value).fold(f64::INFINITY, f64::min);
    let most = told.iter().map(|(_, value)| *value).fold(f64::NEG_INFINITY, f64::max);
    if most - least < 1e-6 {
        judgement.fact(format!("ε is {first:.2} at every step"));
        if first >= LARGE && trace.updates.step.len() >= ENOUGH {
            let updates = counted(trace.updates.step.len(), "update");
            judgement.name(
                "epsilon_never_falls",
                format!("it is {first:.2} at all of {}, with {updates}", counted(told.len(), "step")),
            );
        }
        return;
    }
    let near_end = least + 0.02 * (first - least);
    let reached = told.iter().find(|(_, value)| *value <= near_end).map_or(end, |(row, _)| *row);
    judgement.fact(format!(
        "ε {first:.2} to {least:.2} over {}, {last:.2} at the end",
        counted(reached + 1, "step")
    ));
    let steps = || told.windows(2).map(|pair| pair[1].1 - pair[0].1);
    let (rises, falls) =
        (steps().filter(|step| *step > 1e-9).count(), steps().filter(|step| *step < -1e-9).count());
    if rises >= 10 && falls == 0 && last - first > 0.05 {
        judgement.name(
            "epsilon_grows",
            format!("from {first:.2} to {last:.2}, {} rises and no fall", count(rises)),
        );
    }
    let low = least + 0.1 * (first - least);
    let Some(at) = told.iter().position(|(_, value)| *value <= low) else { return };
    let from =
        told[..at].iter().rposition(|(_, value)| *value >= least + 0.98 * (first - least)).unwrap_or(0);
    let stays = told[at..].iter().all(|(_, value)| *value <= low);
    let began = episodes.starts.iter().filter(|start| (told[from].0..told[at].0).contains(*start)).count();
    if first >= LARGE && stays && at - from < AT_ONCE.0 && began < AT_ONCE.1 && told.len() - at >= ENOUGH {
        judgement.name(
            "epsilon_falls_at_once",
            format!(
                "from {first:.2} to {:.2} within {} and {}",
                told[at].1,
                counted(at - from, "step"),
                counted(began, "new episode")
            ),
        );
    }
}

/// The steps from the first update on whose Q-values are told.
fn choices(steps: &Steps, from: usize) -> Vec<Choice> {
    if steps.q_values.width < 2 {
        return Vec::new();
    }
    let choice = |row: usize| {
        let q = steps.q_values.row(row);
        let taken = *q.get(steps.action[row])?;
        let largest = q.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let epsilon = steps.epsilon.get(row).copied().unwrap_or(f64::NAN);
        q.iter().all(|value| value.is_finite()).then_some(Choice {
            row,
            epsilon,
            is_largest: taken >= largest,
        })
    };
    (from..steps.action.len()).filter_map(choice).collect()
}

/// Whether the actions are those of an ε-greedy policy.
fn behaviour(trace: &Trace, choices: &[Choice], judgement: &mut Judgement) {
    let actions = trace.steps.q_values.width as f64;
    let largest = choices.iter().filter(|choice| choice.is_largest).count();
    let (all, share) = (choices.len(), largest as f64 / choices.len().max(1) as f64);
    if all < ENOUGH {
        return;
    }
    let shown = format!("{} of {} actions have the largest Q-value", count(largest), count(all));
    if choices.iter().any(|choice| !choice.epsilon.is_finite()) {
        let spread = (all as f64 / actions * (1.0 - 1.0 / actions)).sqrt();
        if largest == all {
            judgement.name("never_explores", shown);
        } else if (largest as f64) < all as f64 / actions - 8.0 * spread {
            judgement.name("greedy_is_not_the_largest", shown);
        }
        return;
    }
    let other = (actions - 1.0) / actions;
    // The probability of another action than that of the largest Q-value, by ε.
    type Hypothesis = (&'static str, fn(f64, f64) -> f64);
    const HYPOTHESES: [Hypothesis; 4] = [
        ("", |epsilon, other| epsilon * other),
        ("epsilon_not_applied", |_, _| 0.0),
        ("epsilon_inverted", |epsilon, other| (1.0 - epsilon) * other),
        ("greedy_is_not_the_largest", |epsilon, other| 1.0 - epsilon * (1.0 - other)),
    ];
    let likelihood = |(_, another): &Hypothesis| -> f64 {
        let of = |choice: &Choice| {
            let probability = another(choice.epsilon, other).clamp(1e-3, 1.0 - 1e-3);
            if choice.is_largest { (1.0 - probability).ln() } else { probability.ln() }
        };
        choices.iter().map(of).sum()
    };
    let right = likelihood(&HYPOTHESES[0]);
    let expected: f64 = choices.iter().map(|choice| 1.0 - choice.epsilon * other).sum();
    let shown = format!("{shown}, by ε it would be about {}", count(expected.max(0.0).round() as usize));
    let best = HYPOTHESES[1..].iter().map(|one| (one.0, likelihood(one))).max_by(|a, b| a.1.total_cmp(&b.1));
    let greedy_from_the_start = choices.iter().all(|choice| choice.epsilon == 0.0 && choice.is_largest);
    match best {
        _ if greedy_from_the_start => judgement.name("never_explores", format!("{shown}, and ε is 0")),
        Some((id, likelihood))
            if likelihood - right > CLEAR && (id != "epsilon_not_applied" || largest == all) =>
        {
            judgement.name(id, shown);
        }
        _ if (share - expected / all as f64).abs() > 0.1 => {
            judgement.doubt(format!("how actions are chosen: {shown}"));
        }
        _ => {}
    }
}

/// Actions that exploration never takes.
fn missed(trace: &Trace, choices: &[Choice], judgement: &mut Judgement) {
    let steps = &trace.steps;
    let actions = trace.header.actions.max(steps.q_values.width);
    if judgement.has(&["never_explores", "epsilon_not_applied"]) || actions < 2 {
        return;
    }
    let mut missing: Vec<(usize, f64)> = Vec::new();
    for action in 0..actions {
        // Where the largest Q-value is not that of this action, only exploration takes it.
        let rows: Vec<usize> = if choices.is_empty() {
            (0..steps.action.len()).collect()
        } else {
            let is_below = |row: &usize| {
                let q = steps.q_values.row(*row);
                q.get(action).is_some_and(|value| q.iter().any(|other| other > value))
            };
            choices.iter().map(|choice| choice.row).filter(is_below).collect()
        };
        let taken = rows.iter().filter(|&&row| steps.action[row] == action).count();
        let epsilon =
            |row: &usize| steps.epsilon.get(*row).copied().filter(|value| value.is_finite()).unwrap_or(0.0);
        let expected: f64 = rows.iter().map(|row| epsilon(row) / actions as f64).sum();
        let is_never_taken = !steps.action.contains(&action);
        if taken == 0 && expected > CLEAR {
            missing.push((action, expected));
        } else if is_never_taken
            && steps.action.len() >= 2 * ENOUGH
            && !steps.epsilon.iter().any(|value| value.is_finite())
        {
            judgement.doubt(format!(
                "why action {action} is never taken: recorder.acting(q_values=q, epsilon=epsilon) shows it"
            ));
        }
    }
    if let Some((action, expected)) = missing.first() {
        let times = count(expected.round() as usize);
        let numbers = format!("action {action} is never drawn, where by ε it would be about {times} times");
        judgement.name("exploration_misses_an_action", numbers);
    }
}

/// Whether the Q-values that were told are those of the observation: the weights of whole updates are those by which the agent
/// acts just before and after.
fn old_observations(trace: &Trace, judgement: &mut Judgement) {
    let steps = &trace.steps;
    if steps.q_values.width < 2 {
        return;
    }
    let (mut rows, mut now, mut before) = (0, 0, 0);
    for whole in &trace.whole {
        for (fits_now, fits_before) in compared(trace, whole) {
            rows += 1;
            now += usize::from(fits_now);
            before += usize::from(fits_before);
        }
    }
    if rows < 5 || now * 10 >= rows * 9 {
        return;
    }
    if before * 10 >= rows * 9 && now * 2 < rows {
        let numbers = format!(
            "{} of {} are those of the observation before, {} those of the current one",
            count(before),
            count(rows),
            count(now)
        );
        judgement.name("acts_on_an_old_observation", numbers);
    } else {
        judgement.doubt(format!(
            "the forward pass: {} of {} recorded Q-values are those of dense layers with ReLU between them. A scaled \
             observation, another activation or another network would do this",
            count(now), count(rows)
        ));
    }
}

/// Steps after a whole update: whether their Q-values are those of their observation, and whether of the one before, by the
/// network of now or of before the update.
fn compared(trace: &Trace, whole: &Whole) -> Vec<(bool, bool)> {
    let (steps, updates) = (&trace.steps, &trace.updates.step);
    let Some(update) = whole.without_optimizer() else { return Vec::new() };
    let place = |number: usize| updates.get(number).copied();
    let (Some(from), Some(until), Some(after)) =
        (place(whole.number), place(whole.number + 1), &update.results.online)
    else {
        return Vec::new();
    };
    if after.sizes()[0] != steps.observation.width || after.sizes().last() != Some(&steps.q_values.width) {
        return Vec::new();
    }
    let is_q = |row: usize, network: &Mlp<f64>, observation: usize| {
        let observation = steps.observation.row(observation);
        let input = DMatrix::from_fn(1, observation.len(), |_, column| f64::from(observation[column]));
        let pass = forward(network, &input, LayerKinds::RIGHT, update.rounding_unit);
        let told = steps.q_values.row(row).iter().map(|&value| f64::from(value));
        let scale = pass.q().value.amax().max(1.0);
        told.zip(pass.q().value.iter()).all(|(told, ours)| (told - ours).abs() <= 1e-4 * scale)
    };
    let is_told = |row: &usize| steps.q_values.row(*row).iter().all(|value| value.is_finite());
    // Three are enough: with a vector of environments there may be many.
    let rows = (from..until).filter(is_told).filter_map(|row| Some((row, steps.previous[row]?))).take(3);
    rows.map(|(row, before)| {
        (is_q(row, after, row), is_q(row, after, before) || is_q(row, &update.online, before))
    })
    .collect()
}
