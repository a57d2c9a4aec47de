//! An agent at play, step by step.

use std::time::Duration;

use ratatui::text::Line;
use ratatui::widgets::{Block, Paragraph};

use crate::agent::{Actor, Greedy};
use crate::env::{Answer, Environment, Outcome, Spec, Start};

pub(super) const PUSH_STEPS: u32 = 3;

/// An episode that a greedy policy plays, and the returns of those before it.
pub(super) struct Player {
    policy: Greedy,
    environment: Box<dyn Environment>,
    observation: Vec<f32>,
    pub(super) seed: u64,
    pub(super) steps: u64,
    pub(super) total: f64,
    pub(super) action: usize,
    /// What it expects of each action, in units of the environment's rewards.
    pub(super) q_values: Vec<f32>,
    /// An action that somebody else has chosen, for as many steps.
    pub(super) push: Option<(usize, u32)>,
    pub(super) pushed: bool,
    pub(super) end: Option<Outcome>,
    /// The returns of the episodes that have ended, and whether there was a push.
    pub(super) returns: Vec<(f64, bool)>,
    pub(super) q_range: (f32, f32),
    /// Steps that are due, and how long the end of the episode has stayed.
    due: f64,
    rested: Duration,
}

impl Player {
    pub(super) fn new(policy: Greedy, environment: Box<dyn Environment>, seed: u64) -> Answer<Self> {
        let mut player = Self {
            policy,
            observation: vec![0.0; environment.spec().observation_size],
            environment,
            seed,
            steps: 0,
            total: 0.0,
            action: 0,
            q_values: Vec::new(),
            push: None,
            pushed: false,
            end: None,
            returns: Vec::new(),
            q_range: (0.0, 0.0),
            due: 0.0,
            rested: Duration::ZERO,
        };
        player.start(seed)?;
        Ok(player)
    }

    pub(super) fn spec(&self) -> &Spec {
        self.environment.spec()
    }

    pub(super) fn start(&mut self, seed: u64) -> Answer<()> {
        self.environment.reset(Start::Seed(seed), &mut self.observation)?;
        (self.seed, self.steps, self.total) = (seed, 0, 0.0);
        (self.push, self.pushed, self.end) = (None, false, None);
        (self.due, self.rested) = (0.0, Duration::ZERO);
        self.q_range = (f32::INFINITY, f32::NEG_INFINITY);
        self.see();
        Ok(())
    }

    pub(super) fn set_policy(&mut self, policy: Greedy) {
        self.policy = policy;
        self.see();
    }

    fn see(&mut self) {
        self.action = self.policy.act(&self.observation);
        self.q_values = self.policy.q_values();
        let widened = |(low, high): (f32, f32), q: &f32| (low.min(*q), high.max(*q));
        self.q_range = self.q_values.iter().fold(self.q_range, widened);
    }

    /// Lets time pass, at a multiple of the environment's speed. The end of an episode stays for `rest`.
    pub(super) fn advance(&mut self, time: Duration, speed: f64, rest: Duration) -> Answer<()> {
        if self.end.is_some() {
            self.rested += time;
            return if self.rested >= rest { self.start(self.seed.wrapping_add(1)) } else { Ok(()) };
        }
        self.due += time.as_secs_f64() * speed * self.spec().steps_per_second;
        while self.due >= 1.0 {
            self.due -= 1.0;
            self.step()?;
        }
        Ok(())
    }

    /// Replaces the policy's action by this one for the next [`PUSH_STEPS`] steps.
    pub(super) fn push(&mut self, action: usize) {
        self.push = Some((action, PUSH_STEPS));
        self.pushed = true;
    }

    pub(super) fn step(&mut self) -> Answer<()> {
        if self.end.is_some() {
            return Ok(());
        }
        let action = self.push.map_or(self.action, |(action, _)| action);
        self.push = self.push.filter(|&(_, left)| left > 1).map(|(action, left)| (action, left - 1));
        let outcome = self.environment.step(action, &mut self.observation)?;
        self.steps += 1;
        self.total += outcome.reward;
        self.see();
        if outcome.ended() {
            self.returns.push((self.total, self.pushed));
            self.end = Some(outcome);
        }
        Ok(())
    }

    /// Draws the environment, or its numbers if it has no picture, framed by `block`.
    pub(super) fn draw(&self, frame: &mut ratatui::Frame<'_>, area: ratatui::layout::Rect, block: Block<'_>) {
        if let Some(scene) = self.environment.scene() {
            crate::draw::draw_braille(frame, area, block, &scene);
            return;
        }
        let numbers = self.spec().observations.iter().zip(self.state());
        let lines: Vec<_> = numbers.map(|(name, value)| Line::from(format!(" {name} {value:.4}"))).collect();
        frame.render_widget(Paragraph::new(lines).block(block), area);
    }

    pub(super) fn name_of(&self, action: usize) -> &str {
        self.spec().actions.get(action).map_or("", String::as_str)
    }

    /// How the episode has ended, in words; none before its end.
    pub(super) fn ending(&self) -> Option<&'static str> {
        Some(if self.end?.terminated { self.environment.ending() } else { "time limit" })
    }

    pub(super) fn state(&self) -> Vec<f64> {
        self.observation.iter().copied().map(f64::from).collect()
    }
}

#[cfg(test)]
#[path = "../../tests/unit/view_player.rs"]
mod tests;
