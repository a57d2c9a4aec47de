//! The rows of a batch against the physics of their task: s′ = step(s, a), its reward, and whether the episode ended there.

use nalgebra::DMatrix;
use serde::Serialize;

use super::file::Update;
use super::mistakes::Found;
use super::rounding::short;
use crate::env::catalogue::EnvironmentId;
use crate::env::{CartPole, Outcome};

/// Fewest rows of which anything is said that one row alone does not prove.
const FEW: usize = 8;
/// Most sequences of actions that are tried between s and s′ of a sample of several steps.
const MAX_SEQUENCES: usize = 128;

#[derive(Debug, Default, Serialize)]
pub struct BatchVerdict {
    /// The task whose physics the rows have, or that the settings name.
    pub environment: Option<EnvironmentId>,
    pub mistakes: Vec<Found>,
    pub facts: Vec<String>,
    /// What could not be seen, and why.
    pub unseen: Vec<String>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Row {
    Step,
    /// A step with this action, which is not the stored one.
    StepWith(usize),
    /// s′ is s.
    Same,
    /// s follows from s′.
    Reversed,
    /// s′ is a start.
    Reset,
    /// s′ follows from another row.
    OfAnother,
    /// s′ of an end, which no target uses, is the same numbers in all of them.
    Blank,
    /// Of so many steps that not all sequences of actions are tried.
    Untried,
    Unknown,
}

pub(super) fn judge(update: &Update) -> BatchVerdict {
    let rows = Rows::of(update);
    let mut judged = BatchVerdict::default();
    let sizes = update.online.sizes();
    let has_sizes = |id: &EnvironmentId| {
        let spec = id.spec();
        [spec.observation_size, spec.num_actions] == [sizes[0], sizes[sizes.len() - 1]]
    };
    let named = update.settings.environment;
    let candidate = named.or_else(|| {
        EnvironmentId::NAMES.iter().filter_map(|name| EnvironmentId::from_name(name)).find(has_sizes)
    });
    if rows.is_one_transition() {
        judged.found("one_transition_repeated", format!("all {} rows are equal", rows.size()));
        return judged;
    }
    let Some(id) = candidate.filter(has_sizes) else {
        rows.judge_without_physics(&mut judged);
        let doubt = |id: &str| format!("whether the rows are steps of {id}: the network has other sizes");
        judged.unseen.extend(named.map(|id| doubt(&id.spec().id)));
        return judged;
    };
    let physics = Physics { id, rounding: update.rounding_unit.max(f64::from(f32::EPSILON) / 2.0) };
    if rows.judge_rounding(&physics, named.is_some(), &mut judged) {
        judged.environment = Some(id);
        return judged;
    }
    let kinds = rows.kinds(&physics);
    let is_known = |kind: &&Row| !matches!(kind, Row::Same | Row::Reset | Row::Unknown | Row::Untried);
    let known = kinds.iter().filter(is_known).count();
    if known == 0 || (named.is_none() && 2 * known < rows.size()) {
        rows.judge_start(&physics, &mut judged);
        if judged.mistakes.is_empty() {
            rows.judge_without_physics(&mut judged);
        }
        if named.is_some() && judged.mistakes.is_empty() {
            judged.unseen.push(format!(
                "whether the rows are steps of {}: none is one as it stands. Scaled observations look so; store them as the \
                 environment gives them",
                id.spec().id
            ));
        }
        return judged;
    }
    judged.environment = Some(id);
    rows.judge_kinds(&physics, &kinds, &mut judged);
    rows.judge_ends(&physics, &kinds, named.is_some(), &mut judged);
    judged
}

impl BatchVerdict {
    fn found(&mut self, id: &str, evidence: String) {
        self.mistakes.extend(Found::new(id, evidence));
    }
}

/// A task's steps, as they are seen.
struct Physics {
    id: EnvironmentId,
    /// Relative rounding of the observations.
    rounding: f64,
}

impl Physics {
    /// Whether a step leads from `seen` to `next`, where each number of both may be off by so much.
    fn leads(&self, seen: &[f64], action: usize, next: &[f64], off: impl Fn(f64) -> f64) -> bool {
        let Some((expected, _)) = self.id.step_from(seen, action) else { return false };
        // Most rows need no derivative: none is above 10.
        let far = |(i, x): (usize, &f64)| {
            (x - next[i]).abs() > off(next[i]) + 20.0 * seen.iter().map(|&x| off(x)).sum::<f64>()
        };
        if expected.iter().enumerate().any(far) {
            return false;
        }
        let mut allowed: Vec<f64> = next.iter().map(|&x| off(x)).collect();
        for (i, &x) in seen.iter().enumerate() {
            let mut moved = seen.to_vec();
            let by = off(x).max(1e-7);
            moved[i] += by;
            let Some((other, _)) = self.id.step_from(&moved, action) else { return false };
            let carried = other.iter().zip(&expected).map(|(other, x)| (other - x).abs() * off(seen[i]) / by);
            allowed.iter_mut().zip(carried).for_each(|(allowed, carried)| *allowed += carried);
        }
        expected.iter().zip(next).zip(&allowed).all(|((x, next), allowed)| (x - next).abs() <= *allowed)
    }

    /// What rounding leaves of a number: a few units in its last place, since some programs step in f32, and as much of the
    /// numbers around 0.01 that make it.
    fn off(&self, x: f64) -> f64 {
        self.rounding * (4.0 * x.abs() + 0.1)
    }
}

struct Rows<'a> {
    update: &'a Update,
    s: Vec<Vec<f64>>,
    next: Vec<Vec<f64>>,
}

impl<'a> Rows<'a> {
    fn of(update: &'a Update) -> Self {
        let rows = |all: &DMatrix<f64>| all.row_iter().map(|row| row.iter().copied().collect()).collect();
        Self { update, s: rows(&update.batch.observations), next: rows(&update.batch.next_observations) }
    }

    fn size(&self) -> usize {
        self.s.len()
    }

    fn actions(&self) -> usize {
        self.update.online.sizes()[self.update.online.num_layers()]
    }

    fn is_one_transition(&self) -> bool {
        let batch = &self.update.batch;
        let is_first = |i: usize| {
            self.s[i] == self.s[0] && self.next[i] == self.next[0] && batch.actions[i] == batch.actions[0]
        };
        self.size() >= FEW && (1..self.size()).all(is_first)
    }

    /// What is wrong in every task.
    fn judge_without_physics(&self, judged: &mut BatchVerdict) {
        let size = self.size();
        let [starts, nexts] = [&self.s, &self.next].map(|rows| {
            let mut rows: Vec<_> = rows.iter().collect();
            rows.sort_by(|a, b| a.partial_cmp(b).unwrap_or(std::cmp::Ordering::Equal));
            rows.dedup();
            rows.len()
        });
        if size >= FEW && self.s == self.next {
            judged.found("next_is_current", format!("in all {size} rows s′ equals s"));
        } else if size >= FEW
            && (starts == 1 && nexts > size / 2)
            && !self.update.batch.terminated.iter().all(|&end| end)
        {
            let evidence = format!("s is the same in all {size} rows, s′ takes {nexts} values");
            judged.found("state_not_advanced", evidence);
        }
    }

    /// Rows that all begin in a start, while they end elsewhere.
    fn judge_start(&self, physics: &Physics, judged: &mut BatchVerdict) {
        let count = |rows: &[Vec<f64>]| rows.iter().filter(|row| physics.id.can_start_with(row)).count();
        let (size, started, back) = (self.size(), count(&self.s), count(&self.next));
        if size >= FEW && started == size && 2 * back < size && self.s != self.next {
            let (name, away) = (physics.id.spec().id, size - back);
            judged.environment = Some(physics.id);
            let evidence = format!("s of all {size} rows is a start of {name}, s′ of {away} rows is not");
            judged.found("state_not_advanced", evidence);
        }
    }

    /// Observations on a grid of powers of ten, between which the task's steps lie.
    fn judge_rounding(&self, physics: &Physics, is_named: bool, judged: &mut BatchVerdict) -> bool {
        let all = || self.s.iter().chain(&self.next).flatten();
        let on_grid = |grid: f64| all().all(|x| (x / grid - (x / grid).round()).abs() < 1e-4);
        let Some(grid) = [1.0, 0.1, 0.01, 1e-3].into_iter().find(|&grid| on_grid(grid)) else {
            return false;
        };
        let leads = |i: usize, off: &dyn Fn(f64) -> f64| {
            (0..self.actions()).any(|action| physics.leads(&self.s[i], action, &self.next[i], off))
        };
        let fit = (0..self.size()).filter(|&i| leads(i, &|_| grid)).count();
        // A coarse grid holds much: then the rewards, which are those of every step, must be the task's too.
        let rewards = &self.update.batch.rewards;
        let is_reward = |reward: &f64| {
            physics.id.step_from(&self.s[0], 0).is_some_and(|(_, outcome)| outcome.reward == *reward)
        };
        let is_task = is_named || grid < 0.05 || rewards.iter().all(is_reward);
        let is_exact = (0..self.size()).any(|i| leads(i, &|x| physics.off(x)));
        if self.size() < FEW || fit < self.size() || !is_task || is_exact {
            return false;
        }
        let name = physics.id.spec().id;
        let evidence = format!(
            "every number is a multiple of {grid}; no step of {name} leads from these s to these s′, and within {grid} steps \
             do in all {fit} rows"
        );
        judged.found("observations_rounded", evidence);
        true
    }

    /// Whether somebody stores no s′ of ends: zeros, or another constant.
    fn has_blank_ends(&self) -> bool {
        let ends = self.next.iter().zip(&self.update.batch.terminated).filter(|(_, ended)| **ended);
        let ends: Vec<_> = ends.map(|(next, _)| next).collect();
        let is_zero = |next: &&Vec<f64>| next.iter().all(|x| *x == 0.0);
        ends.first()
            .is_some_and(|first| ends.iter().all(|next| next == first) && (ends.len() > 2 || is_zero(first)))
    }

    fn kinds(&self, physics: &Physics) -> Vec<Row> {
        let has_blank_ends = self.has_blank_ends();
        let exact = |s: &[f64], action, next: &[f64]| physics.leads(s, action, next, |x| physics.off(x));
        let actions = &self.update.batch.actions;
        let any = |from: &[f64], to: &[f64]| (0..self.actions()).find(|&action| exact(from, action, to));
        let kind = |i: usize| {
            let (s, next) = (&self.s[i], &self.next[i]);
            match self.several_steps_lead(physics, i) {
                _ if exact(s, actions[i], next) => return Row::Step,
                _ if has_blank_ends && self.update.batch.terminated[i] => return Row::Blank,
                Some(true) => return Row::Step,
                None => return Row::Untried,
                Some(false) => {}
            }
            match any(s, next) {
                Some(other) => Row::StepWith(other),
                None if s == next => Row::Same,
                None if any(next, s).is_some() => Row::Reversed,
                None if physics.id.can_start_with(next) => Row::Reset,
                None => Row::Unknown,
            }
        };
        let mut kinds: Vec<Row> = (0..self.size()).map(kind).collect();
        let steps: Vec<_> = (0..self.size()).map(|i| physics.id.step_from(&self.s[i], actions[i])).collect();
        for (kind, next) in kinds.iter_mut().zip(&self.next) {
            let is_near = |step: &[f64]| step.iter().zip(next).all(|(x, next)| (x - next).abs() < 1e-4);
            let leads = |j: usize| {
                steps[j].as_ref().is_some_and(|(step, _)| is_near(step))
                    && exact(&self.s[j], actions[j], next)
            };
            if matches!(kind, Row::Unknown | Row::Reset) && (0..self.size()).any(leads) {
                *kind = Row::OfAnother;
            }
        }
        kinds
    }

    /// Whether s′ of a sample with a discount of its own is reached in several steps; none if these are too many to try.
    fn several_steps_lead(&self, physics: &Physics, i: usize) -> Option<bool> {
        let steps = (self.update.batch.discounts[i].ln() / self.update.settings.gamma.ln()).round();
        if steps < 1.5 || !steps.is_finite() {
            return Some(false);
        }
        let (mut reached, stored) = (vec![self.s[i].clone()], self.update.batch.actions[i]);
        for step in 1..=steps as i32 {
            let actions = if step == 1 { stored..stored + 1 } else { 0..self.actions() };
            if reached.len() * actions.len() > MAX_SEQUENCES {
                return None;
            }
            let stepped = |state| actions.clone().filter_map(move |one| physics.id.step_from(state, one));
            reached = reached.iter().flat_map(|state| stepped(state)).map(|(next, _)| next).collect();
            // An error grows by less than two with every step.
            let off = |x: f64| physics.off(x) * 2.0_f64.powi(step + 2);
            let is_there = |state: &Vec<f64>| {
                state.iter().zip(&self.next[i]).all(|(x, next)| (x - next).abs() <= off(*next))
            };
            if step > 1 && reached.iter().any(is_there) {
                return Some(true);
            }
        }
        Some(false)
    }

    fn judge_kinds(&self, physics: &Physics, kinds: &[Row], judged: &mut BatchVerdict) {
        let (size, name) = (self.size(), physics.id.spec().id);
        let actions = &self.update.batch.actions;
        let which = |of: Row| (0..size).filter(|&i| kinds[i] == of).collect::<Vec<_>>();
        let steps = which(Row::Step).len();
        let others: Vec<_> = (0..size).filter(|&i| matches!(kinds[i], Row::StepWith(_))).collect();
        if steps == size {
            judged.facts.push(format!("all {size} rows are steps of {name}"));
            return;
        }
        judged.facts.push(format!("{steps} of {size} rows are steps of {name}"));
        let untried = which(Row::Untried).len();
        if untried > 0 {
            judged.facts.push(format!("{untried} of them are of too many steps to say whether they are"));
        }
        let blank = which(Row::Blank).len();
        if blank > 0 {
            judged.facts.push(format!("s′ of {blank} ends is a constant, which no target uses"));
        }
        // A wrapper may number the actions otherwise.
        let renumbered = |i: usize| {
            matches!(kinds[i], Row::Step | Row::StepWith(_))
                && (0..size).all(|j| actions[j] != actions[i] || kinds[j] == kinds[i])
        };
        let used = (0..self.actions()).filter(|action| actions.contains(action)).count();
        if !others.is_empty() && used == self.actions() && (0..size).all(renumbered) {
            judged.facts.push("the actions are numbered otherwise than the task's: every row is a step with another action, always the same for each".into());
        } else if let Some(&first) = others.first() {
            let only =
                if used == 1 { format!("; every stored action is {}", actions[0]) } else { String::new() };
            let count = others.len();
            let which = format!("row {first} for example{only}");
            let evidence = format!(
                "{count} of {size} rows are steps of {name} with another action than the stored one, {which}"
            );
            judged.found("stored_action_is_another", evidence);
        }
        let batch = &self.update.batch;
        for (id, kind, what) in [
            ("next_is_current", Row::Same, "s′ equals s"),
            ("observations_exchanged_in_batch", Row::Reversed, "a step leads from s′ to s"),
            ("next_is_reset", Row::Reset, "s′ is a start, to which no step leads from s"),
            ("next_of_another_row", Row::OfAnother, "s′ follows from s and action of another row"),
            ("row_that_never_happened", Row::Unknown, "no step leads from s to s′, with any action"),
        ] {
            let rows = which(kind);
            let Some(first) = rows.first() else { continue };
            let ends = rows.iter().filter(|&&i| batch.terminated[i] || batch.is_truncated(i)).count();
            let ends = if ends == 0 { String::new() } else { format!("; {ends} of them ended the episode") };
            let evidence = format!("in {} of {size} rows, row {first} for example, {what}{ends}", rows.len());
            judged.found(id, evidence);
        }
    }

    /// Rewards and ends of the rows that are single steps.
    fn judge_ends(&self, physics: &Physics, kinds: &[Row], is_named: bool, judged: &mut BatchVerdict) {
        let batch = &self.update.batch;
        let name = physics.id.spec().id;
        let stored_with = |i: usize| match kinds[i] {
            Row::Step => Some(batch.actions[i]),
            Row::StepWith(other) => Some(other),
            _ => None,
        };
        let is_single = |i: usize| (batch.discounts[i] - self.update.settings.gamma).abs() < 1e-6;
        let outcome = |i: usize| Some((i, physics.id.step_from(&self.s[i], stored_with(i)?)?.1));
        let steps: Vec<_> = (0..self.size()).filter(|&i| is_single(i)).filter_map(outcome).collect();
        if steps.is_empty() {
            return;
        }
        let which = |is: &dyn Fn(usize, Outcome) -> bool| -> Vec<usize> {
            steps.iter().filter(|&&(i, outcome)| is(i, outcome)).map(|&(i, _)| i).collect()
        };
        let ends = which(&|_, outcome| outcome.terminated);
        let lost = which(&|i, outcome| outcome.terminated && !batch.terminated[i]);
        let early = which(&|i, outcome| !outcome.terminated && batch.terminated[i]);
        let is_exchanged = |counts_limit: bool| {
            steps.iter().all(|&(i, outcome)| {
                let end = outcome.terminated || (counts_limit && batch.is_truncated(i));
                batch.terminated[i] == (outcome.reward != 0.0) && batch.rewards[i] == f64::from(end)
            })
        };
        // Of ends alone, as the single steps of an n-step batch are, the two are equal.
        let has_both = !ends.is_empty() && ends.len() < steps.len();
        if has_both && (is_exchanged(false) || is_exchanged(true)) {
            let count = steps.len();
            let reward = "the reward is 1 in the rows that end an episode and 0 elsewhere";
            judged.found("reward_and_end_exchanged", format!("{reward}, `terminated` is 1 in all {count}"));
            return;
        }
        let beyond = self.beyond(physics, &steps);
        if !beyond.is_empty() {
            let (count, first) = (beyond.len(), beyond[0]);
            let evidence = format!("s of {count} rows, row {first} for example, is where {name} has ended");
            if is_named {
                judged.found("steps_after_the_end", evidence);
            } else {
                judged.facts.push(format!("{evidence}: episodes do not end as those of {name}"));
            }
        } else if !lost.is_empty() && !early.is_empty() {
            let (lost, early) = (lost.len(), early.len());
            let those = format!("{lost} rows end in a state where {name} ends and have `terminated` 0");
            judged.found("end_of_another_step", format!("{those}, {early} that do not have 1"));
        } else if let Some(first) = lost.first() {
            let (lost, ends) = (lost.len(), ends.len());
            let rows = format!("{lost} of {ends} rows that end {name}, row {first} for example");
            judged.found("terminated_never_stored", format!("{rows}, have `terminated` 0"));
        } else if let Some(first) = early.first() {
            let count = early.len();
            let evidence = format!(
                "{count} rows, row {first} for example, have `terminated` 1 though {name} goes on from s′"
            );
            let at_limit = early.iter().filter(|&&i| batch.is_truncated(i)).count();
            if at_limit > 0 || !self.has_threshold(&early) {
                let evidence = format!("{evidence}; {at_limit} of them have `truncated` 1");
                judged.found("time_limit_stored_as_terminated", evidence);
            } else {
                judged.unseen.push(format!(
                    "{evidence}: a time limit stored as an end, or an end of your own (they are the farthest in one \
                     coordinate). `batch.truncated` would show which"
                ));
            }
        }
        self.judge_rewards(physics, &steps, judged);
    }

    /// Rows that start where the task has ended.
    fn beyond(&self, physics: &Physics, steps: &[(usize, Outcome)]) -> Vec<usize> {
        let limits = [(0, CartPole::MAX_POSITION), (2, CartPole::MAX_ANGLE)];
        let is_beyond = |i: &usize| limits.iter().any(|(axis, limit)| self.s[*i][*axis].abs() > limit + 1e-6);
        let has_limits = physics.id == EnvironmentId::CartPoleV1;
        steps.iter().map(|&(i, _)| i).filter(|i| has_limits && is_beyond(i)).collect()
    }

    /// Whether one number of s′ parts these rows from all others, as an end of somebody's own would.
    fn has_threshold(&self, rows: &[usize]) -> bool {
        (0..self.s[0].len()).any(|coordinate| {
            [|x: f64| x, |x: f64| -x, f64::abs].into_iter().any(|of| {
                let value = |i: usize| of(self.next[i][coordinate]);
                let least = rows.iter().map(|&i| value(i)).fold(f64::INFINITY, f64::min);
                let others = (0..self.size()).filter(|&i| !self.update.batch.terminated[i]);
                others.map(value).fold(f64::NEG_INFINITY, f64::max) < least
            })
        })
    }

    fn judge_rewards(&self, physics: &Physics, steps: &[(usize, Outcome)], judged: &mut BatchVerdict) {
        let rewards = &self.update.batch.rewards;
        let name = physics.id.spec().id;
        let differing: Vec<_> = steps.iter().filter(|(i, step)| !is_near(rewards[*i], step.reward)).collect();
        let Some(&&(first, outcome)) = differing.first() else { return };
        let (count, factor) = (differing.len(), rewards[first] / outcome.reward);
        let is_of_task = |reward: f64| steps.iter().any(|(_, outcome)| outcome.reward == reward);
        let is_way = |end: bool| differing.iter().any(|(_, outcome)| outcome.terminated == end);
        if factor.is_finite()
            && steps.iter().all(|(i, outcome)| is_near(rewards[*i], factor * outcome.reward))
        {
            judged.facts.push(format!("the rewards are {} times those of {name}", short(factor)));
        } else if steps.iter().all(|(i, _)| is_of_task(rewards[*i])) && is_way(true) && is_way(false) {
            let rows = format!("{count} rows, row {first} for example");
            let evidence = format!("{rows}, have another reward than their step of {name}");
            judged.found("reward_of_another_step", evidence);
        } else {
            let value = rewards[first];
            let is_one = differing.iter().all(|(i, _)| rewards[*i] == value);
            let ends = differing.iter().filter(|(_, outcome)| outcome.terminated).count();
            let what = if is_one { format!("is {}", short(value)) } else { "differs".into() };
            let right = short(outcome.reward);
            judged.facts.push(format!(
                "the reward of {count} rows {what}, where {name} gives {right}; {ends} of them end the episode"
            ));
        }
    }
}

fn is_near(a: f64, b: f64) -> bool {
    (a - b).abs() <= 1e-6 * b.abs().max(1e-6)
}
