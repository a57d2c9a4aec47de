//! ε, Q-values and actions.

use nalgebra::DMatrix;

use super::super::activation::LayerKinds;
use super::super::pass::forward;
use super::ends::Episodes;
use super::file::{Steps, Trace, Whole};
use super::{Judgement, counted};
use crate::nn::Mlp;

/// Steps that are enough to speak of all of them.
const ENOUGH: usize = 500;
/// A natural logarithm by which one explanation must be likelier than another.
const CLEAR: f64 = 25.0;
/// An ε of most steps at random.
const LARGE: f64 = 0.5;
/// Steps and episodes within which ε falls at once.
const AT_ONCE: (usize, usize) = (100, 15);

/// A step with Q-values: its ε, and whether its action has the largest of them.
struct Acted {
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
    let is_noisy = trace.header.tensors.iter().any(|name| name.contains("sigma"));
    if !is_told || !steps.epsilon.iter().any(|value| value.is_finite()) {
        judgement.doubt(
            "how actions are chosen: recorder.acting(q_values=q, epsilon=epsilon) before env.step shows it",
        );
    }
    if is_told && told * 100 < steps.action.len() * 99 {
        judgement.doubt(
            "whether ε is applied: the Q-values of some steps were not told; tell them also where the action is random",
        );
    } else if is_told && learns_from.is_some() && !is_noisy {
        behaviour(trace, &choices, judgement);
    }
    missed(trace, &choices, judgement);
    old_observations(trace, judgement);
}

fn schedule(trace: &Trace, episodes: &Episodes, judgement: &mut Judgement) {
    let told = trace.steps.epsilon.iter().copied().enumerate();
    let told: Vec<(usize, f64)> = told.filter(|(_, value)| value.is_finite()).collect();
    let (Some(&(_, first)), Some(&(end, last))) = (told.first(), told.last()) else { return };
    let least = told.iter().map(|(_, value)| *value).fold(f64::INFINITY, f64::min);
    let most = told.iter().map(|(_, value)| *value).fold(f64::NEG_INFINITY, f64::max);
    if most - least < 1e-6 {
        judgement.fact(format!("ε is {first:.2} at every step"));
        let updates = trace.updates.step.len();
        if first >= LARGE && updates >= ENOUGH {
            let numbers = format!("it is {first:.2} at all of {} steps, with {updates} updates", told.len());
            judgement.name("epsilon_never_falls", numbers);
        }
        return;
    }
    let near_end = least + 0.02 * (first - least);
    let reached = told.iter().find(|(_, value)| *value <= near_end).map_or(end, |(row, _)| *row);
    let over = counted(reached + 1, "step");
    judgement.fact(format!("ε {first:.2} to {least:.2} over {over}, {last:.2} at the end"));
    let steps = || told.windows(2).map(|pair| pair[1].1 - pair[0].1);
    let rises = steps().filter(|step| *step > 1e-9).count();
    if rises >= 10 && !steps().any(|step| step < -1e-9) && last - first > 0.05 {
        judgement.name("epsilon_grows", format!("from {first:.2} to {last:.2}, {rises} rises and no fall"));
    }
    let low = least + 0.1 * (first - least);
    let Some(at) = told.iter().position(|(_, value)| *value <= low) else { return };
    let from = told[..at].iter().rposition(|(_, value)| *value >= least + 0.98 * (first - least));
    let from = from.unwrap_or(0);
    let stays = told[at..].iter().all(|(_, value)| *value <= low);
    let began = episodes.starts.iter().filter(|start| (told[from].0..told[at].0).contains(*start)).count();
    if first >= LARGE && stays && at - from < AT_ONCE.0 && began < AT_ONCE.1 && told.len() - at >= ENOUGH {
        let within = format!("{} and {}", counted(at - from, "step"), counted(began, "new episode"));
        let numbers = format!("from {first:.2} to {:.2} within {within}", told[at].1);
        judgement.name("epsilon_falls_at_once", numbers);
    }
}

/// The steps from the first update on whose Q-values are told.
fn choices(steps: &Steps, from: usize) -> Vec<Acted> {
    if steps.q_values.width < 2 {
        return Vec::new();
    }
    let choice = |row: usize| {
        let q = steps.q_values.row(row);
        let taken = *q.get(steps.action[row])?;
        let is_largest = q.iter().all(|value| *value <= taken);
        let epsilon = steps.epsilon.get(row).copied().unwrap_or(f64::NAN);
        q.iter().all(|value| value.is_finite()).then_some(Acted { row, epsilon, is_largest })
    };
    (from..steps.action.len()).filter_map(choice).collect()
}

/// Whether the actions are those of an ε-greedy policy.
fn behaviour(trace: &Trace, choices: &[Acted], judgement: &mut Judgement) {
    let actions = trace.steps.q_values.width as f64;
    let largest = choices.iter().filter(|choice| choice.is_largest).count();
    let all = choices.len();
    if all < ENOUGH {
        return;
    }
    let shown = format!("{largest} of {all} actions have the largest Q-value");
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
    type Wrong = (&'static str, fn(f64, f64) -> f64);
    const RIGHT: fn(f64, f64) -> f64 = |epsilon, other| epsilon * other;
    const WRONG: [Wrong; 3] = [
        ("epsilon_not_applied", |_, _| 0.0),
        ("epsilon_inverted", |epsilon, other| (1.0 - epsilon) * other),
        ("greedy_is_not_the_largest", |epsilon, other| 1.0 - epsilon * (1.0 - other)),
    ];
    let likelihood = |another: fn(f64, f64) -> f64| -> f64 {
        let of = |choice: &Acted| {
            let probability = another(choice.epsilon, other).clamp(1e-3, 1.0 - 1e-3);
            if choice.is_largest { (1.0 - probability).ln() } else { probability.ln() }
        };
        choices.iter().map(of).sum()
    };
    let expected: f64 = choices.iter().map(|choice| 1.0 - choice.epsilon * other).sum();
    let shown = format!("{shown}, by ε it would be about {expected:.0}");
    let wrong = WRONG.map(|(id, another)| (id, likelihood(another) - likelihood(RIGHT)));
    let best = wrong.into_iter().max_by(|a, b| a.1.total_cmp(&b.1));
    if choices.iter().all(|choice| choice.epsilon == 0.0 && choice.is_largest) {
        judgement.name("never_explores", format!("{shown}, and ε is 0"));
    } else if let Some((id, _)) =
        best.filter(|(id, likelier)| *likelier > CLEAR && (*id != "epsilon_not_applied" || largest == all))
    {
        judgement.name(id, shown);
    } else if (largest as f64 - expected).abs() > 0.1 * all as f64 {
        judgement.doubt(format!("how actions are chosen: {shown}"));
    }
}

/// Actions that exploration never takes.
fn missed(trace: &Trace, choices: &[Acted], judgement: &mut Judgement) {
    let steps = &trace.steps;
    let actions = trace.header.actions.max(steps.q_values.width);
    if judgement.has(&["never_explores", "epsilon_not_applied"]) || actions < 2 {
        return;
    }
    // Where the largest Q-value is not that of an action, only exploration takes it.
    let is_below = |row: usize, action: usize| {
        let q = steps.q_values.row(row);
        q.get(action).is_some_and(|value| q.iter().any(|other| other > value))
    };
    let epsilon = |row: usize| steps.epsilon.get(row).copied().filter(|value| value.is_finite());
    for action in 0..actions {
        let rows: Vec<usize> = match choices.is_empty() {
            true => (0..steps.action.len()).collect(),
            false => choices.iter().map(|choice| choice.row).filter(|&row| is_below(row, action)).collect(),
        };
        let expected: f64 = rows.iter().map(|&row| epsilon(row).unwrap_or(0.0) / actions as f64).sum();
        if expected > CLEAR && !rows.iter().any(|&row| steps.action[row] == action) {
            let numbers =
                format!("action {action} is never drawn, where by ε it would be about {expected:.0} times");
            judgement.name("exploration_misses_an_action", numbers);
            return;
        }
        let is_told = (0..steps.epsilon.len()).any(|row| epsilon(row).is_some());
        if !is_told && steps.action.len() >= 2 * ENOUGH && !steps.action.contains(&action) {
            judgement.doubt(format!(
                "why action {action} is never taken: recorder.acting(q_values=q, epsilon=epsilon) shows it"
            ));
        }
    }
}

/// Whether the Q-values that were told are those of the observation, by the weights of whole updates just before and after.
fn old_observations(trace: &Trace, judgement: &mut Judgement) {
    if trace.steps.q_values.width < 2 {
        return;
    }
    let compared: Vec<_> = trace.whole.iter().flat_map(|whole| compared(trace, whole)).collect();
    let rows = compared.len();
    let now = compared.iter().filter(|(now, _)| *now).count();
    let before = compared.iter().filter(|(_, before)| *before).count();
    if rows < 5 || now * 10 >= rows * 9 {
        return;
    }
    if before * 10 >= rows * 9 && now * 2 < rows {
        let numbers =
            format!("{before} of {rows} are those of the observation before, {now} those of the current one");
        judgement.name("acts_on_an_old_observation", numbers);
    } else {
        judgement.doubt(format!(
            "the forward pass: {now} of {rows} recorded Q-values are those of dense layers with ReLU between them. A scaled \
             observation, another activation or another network would do this"
        ));
    }
}

/// Steps after a whole update: whether their Q-values are of their observation, and of the one before, by its networks.
fn compared(trace: &Trace, whole: &Whole) -> Vec<(bool, bool)> {
    let (steps, place) = (&trace.steps, |number: usize| trace.updates.step.get(number).copied());
    let (Some(update), Some(from), Some(until)) =
        (whole.without_optimizer(), place(whole.number), place(whole.number + 1))
    else {
        return Vec::new();
    };
    let sizes = (update.online.sizes()[0], update.online.sizes().last());
    let Some(after) = &update.results.online else { return Vec::new() };
    if sizes != (steps.observation.width, Some(&steps.q_values.width)) {
        return Vec::new();
    }
    let is_q = |row: usize, network: &Mlp<f64>, observation: usize| {
        let observation = steps.observation.row(observation);
        let input = DMatrix::from_fn(1, observation.len(), |_, column| f64::from(observation[column]));
        let pass = forward(network, &input, LayerKinds::RIGHT, update.rounding_unit);
        let (told, ours) = (steps.q_values.row(row), &pass.q.value);
        let scale = ours.amax().max(1.0);
        told.iter().zip(ours.iter()).all(|(told, ours)| (f64::from(*told) - ours).abs() <= 1e-4 * scale)
    };
    let is_told = |row: &usize| steps.q_values.row(*row).iter().all(|value| value.is_finite());
    // Three are enough: with a vector of environments there may be many.
    let rows = (from..until).filter(is_told).filter_map(|row| Some((row, steps.previous[row]?))).take(3);
    let fits = |(row, before)| {
        (is_q(row, after, row), is_q(row, after, before) || is_q(row, &update.online, before))
    };
    rows.map(fits).collect()
}
