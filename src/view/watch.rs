//! `watch`: an agent at play, with what it thinks of it.

use std::time::{Duration, Instant};

use ratatui::crossterm::event::{KeyCode, KeyEvent};
use ratatui::prelude::Constraint::{Length, Min};
use ratatui::prelude::{Frame, Layout, Line, Rect, Span, Stylize};
use ratatui::widgets::{Block, Paragraph};

use super::player::Player;
use super::{FRAME, NoView, Screen, fitting, is_quit, whole};
use crate::agent::Greedy;
use crate::env::{Answer, Environment};
use crate::text::{shortened, width};

/// Simulated time per time; 1 is the middle.
const SPEEDS: [f64; 9] = [0.05, 0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0];
const REST: Duration = Duration::from_millis(1500);
const KEYS: &str = " act  space pause  s step  n next seed  r again  +/- speed  q quit";
const MAX_VALUES: usize = 6;

/// Plays a policy's episodes from the seeds `seed`, `seed + 1`, … until somebody quits or `stop` is set.
pub(crate) fn watch(
    policy: Greedy, environment: Box<dyn Environment>, name: &str, seed: u64,
    stop: &std::sync::atomic::AtomicBool,
) -> Result<(), NoView> {
    let mut screen = Screen::open()?;
    let mut view = Watch::new(policy, environment, name, seed)?;
    let mut last = Instant::now();
    while !stop.load(std::sync::atomic::Ordering::Relaxed) {
        screen.draw(|frame| view.draw(frame))?;
        let drawn = Instant::now();
        while let Some(key) = screen.key(FRAME.saturating_sub(drawn.elapsed()))? {
            if is_quit(key) {
                return Ok(());
            }
            view.press(key)?;
        }
        view.advance(last.elapsed())?;
        last = Instant::now();
    }
    Ok(())
}

struct Watch {
    name: String,
    player: Player,
    speed: usize,
    paused: bool,
}

impl Watch {
    fn new(policy: Greedy, environment: Box<dyn Environment>, name: &str, seed: u64) -> Answer<Self> {
        let player = Player::new(policy, environment, seed)?;
        Ok(Self { name: name.into(), player, speed: SPEEDS.len() / 2, paused: false })
    }

    fn advance(&mut self, time: Duration) -> Answer<()> {
        if self.paused { Ok(()) } else { self.player.advance(time, SPEEDS[self.speed], REST) }
    }

    fn press(&mut self, key: KeyEvent) -> Answer<()> {
        match key.code {
            KeyCode::Left => self.player.push(0),
            KeyCode::Right => self.player.push(self.player.spec().num_actions - 1),
            KeyCode::Char(digit @ '0'..='9') => {
                let action = digit as usize - '0' as usize;
                if action < self.player.spec().num_actions {
                    self.player.push(action);
                }
            }
            KeyCode::Char(' ') => self.paused = !self.paused,
            KeyCode::Char('s' | '.') => {
                self.paused = true;
                self.player.step()?;
            }
            KeyCode::Char('n') => self.player.start(self.player.seed.wrapping_add(1))?,
            KeyCode::Char('r') => self.player.start(self.player.seed)?,
            KeyCode::Char('+' | '=') => self.speed = (self.speed + 1).min(SPEEDS.len() - 1),
            KeyCode::Char('-') => self.speed = self.speed.saturating_sub(1),
            _ => {}
        }
        Ok(())
    }

    fn draw(&self, frame: &mut Frame<'_>) {
        let values = 2 + self.shown_values() as u16;
        let heights = [Length(1), Min(8), Length(values), Length(2), Length(1)];
        let [title, picture, values, returns, keys] = Layout::vertical(heights).areas(frame.area());
        frame.render_widget(Line::from(vec!["watch".bold(), format!(" {}", self.name).into()]), title);
        let state = self.state(usize::from(picture.width).saturating_sub(2));
        self.player.draw(frame, picture, Block::bordered().title(self.status()).title_bottom(state));
        self.draw_values(frame, values);
        frame.render_widget(Paragraph::new(self.returns(usize::from(returns.width))), returns);
        let digits = match self.player.spec().num_actions {
            2 => String::new(),
            actions => format!("/0-{}", actions.min(10) - 1),
        };
        frame.render_widget(Line::from(format!("←/→{digits}{KEYS}")).dim(), keys);
    }

    fn status(&self) -> String {
        let Player { seed, steps, push, .. } = &self.player;
        let what = match (self.player.ending(), push, self.paused) {
            (Some(ending), ..) => ending.into(),
            (None, Some((action, _)), _) => format!("yours: {}", self.player.name_of(*action)),
            (None, None, true) => "paused".into(),
            (None, None, false) => "plays".into(),
        };
        let (most, speed) = (self.player.spec().max_steps, SPEEDS[self.speed]);
        format!(" seed {seed} │ step {steps} of {most} │ {speed}x │ {what} ")
    }

    fn state(&self, columns: usize) -> String {
        let names = &self.player.spec().observations;
        let state = |(digits, named): (usize, bool)| -> String {
            let number = |(name, value): (&String, f64)| match named {
                true => format!(" {name} {value:+.digits$} "),
                false => format!(" {value:+.digits$}"),
            };
            names.iter().zip(self.player.state()).map(number).collect()
        };
        let forms = [(3, true), (2, true), (1, true), (3, false)].into_iter().map(state);
        let whole = forms.into_iter().find(|text| width(text) <= columns);
        whole.unwrap_or_else(|| shortened(&state((1, false)), columns))
    }

    fn shown_values(&self) -> usize {
        self.player.spec().num_actions.min(MAX_VALUES)
    }

    /// A bar for each action, over the range of this episode: the difference that decides is far smaller than either.
    fn draw_values(&self, frame: &mut Frame<'_>, area: Rect) {
        let (low, high) = self.player.q_range;
        let block = Block::bordered().title(format!(" Q-values, {low:.2} to {high:.2} in this episode "));
        let names: Vec<_> = (0..self.shown_values()).map(|action| self.player.name_of(action)).collect();
        let longest = names.iter().map(|name| name.chars().count()).max().unwrap_or_default();
        let width = usize::from(area.width).saturating_sub(2 + 21 + longest);
        let lines = names.iter().zip(&self.player.q_values).enumerate().map(|(action, (name, &q))| {
            let share = if high > low { (q - low) / (high - low) } else { 1.0 };
            let chosen = action == self.player.action;
            let bar = Span::from(bar(share, width));
            Line::from(vec![
                format!(" {name:<longest$}{q:>10.2} ").into(),
                if chosen { bar.green() } else { bar.dim() },
                if chosen { " ◆ chosen".bold() } else { Span::default() },
            ])
        });
        frame.render_widget(Paragraph::new(lines.collect::<Vec<_>>()).block(block), area);
    }

    fn returns(&self, columns: usize) -> Vec<Line<'_>> {
        let returns = &self.player.returns;
        if returns.is_empty() {
            return vec![Line::from("returns: none yet")];
        }
        let mean = returns.iter().map(|(total, _)| *total).sum::<f64>() / returns.len() as f64;
        let shown =
            |(total, pushed): &(f64, bool)| format!(" {}{}", whole(*total), if *pushed { "*" } else { "" });
        let latest = fitting(returns.iter().rev().map(shown), columns.saturating_sub(22));
        let is_marked = returns.iter().any(|(_, pushed)| *pushed);
        let marked = if is_marked { "   * with actions of yours" } else { "" };
        vec![
            Line::from(format!("returns, latest first:{latest}")),
            Line::from(format!("mean {mean:.1} of {} episodes{marked}", returns.len())),
        ]
    }
}

/// A bar of `width` characters, filled to a share of 0…1 in eighths of a character.
fn bar(share: f32, width: usize) -> String {
    const EIGHTHS: [&str; 8] = ["", "▏", "▎", "▍", "▌", "▋", "▊", "▉"];
    let eighths = (share.clamp(0.0, 1.0) * 8.0 * width as f32).round() as usize;
    let filled = "█".repeat(eighths / 8) + EIGHTHS[eighths % 8];
    format!("{filled:width$}")
}

#[cfg(test)]
#[path = "../../tests/unit/view_watch.rs"]
mod tests;
