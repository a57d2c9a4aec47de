//! What `train --live` shows: the learning curve, the latest policy at play, and what learning looks like from inside.

use std::time::{Duration, Instant};

use ratatui::prelude::Constraint::{Fill, Length, Min};
use ratatui::prelude::{Color, Frame, Layout, Line, Rect, Stylize};
use ratatui::symbols::Marker;
use ratatui::widgets::{Axis, Block, Chart, Dataset, GraphType, LineGauge, Paragraph};

use super::player::Player;
use super::{fitting, whole};
use crate::agent::{Policy, STATISTICS, Statistic};
use crate::env::{Environment, Spec};
use crate::trainer::{Budget, EVALUATION_SEED, Event};

const KEYS: &str = "+/- pace  f full speed  space pause  q stop, with a checkpoint";
const KEYS_AT_THE_END: &str = "q close";
const REST: Duration = Duration::from_millis(500);

/// Points over environment steps; when there are many, every second one goes.
#[derive(Default)]
struct Series {
    points: Vec<(f64, f64)>,
    every: u64,
    pushed: u64,
    latest: Option<f64>,
}

impl Series {
    const MOST: usize = 2048;

    fn push(&mut self, x: u64, y: f64) {
        self.latest = Some(y);
        self.every = self.every.max(1);
        if self.pushed.is_multiple_of(self.every) {
            self.points.push((x as f64, y));
        }
        self.pushed += 1;
        if self.points.len() == Self::MOST {
            self.points = self.points.iter().copied().step_by(2).collect();
            self.every *= 2;
        }
    }

    /// The points in `width` characters, between the smallest and the largest.
    fn sparkline(&self, width: usize) -> String {
        const BARS: [char; 8] = ['▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];
        let all = || self.points.iter().map(|&(_, y)| y);
        let (low, high) = (all().fold(f64::INFINITY, f64::min), all().fold(f64::NEG_INFINITY, f64::max));
        let columns = width.min(self.points.len());
        let bar = |column: usize| {
            let range = column * self.points.len() / columns..(column + 1) * self.points.len() / columns;
            let mean = self.points[range.clone()].iter().map(|&(_, y)| y).sum::<f64>() / range.len() as f64;
            let share = if high > low { (mean - low) / (high - low) } else { 0.0 };
            BARS[(share * 7.0).round() as usize]
        };
        (0..columns).map(bar).collect()
    }
}

fn statistics() -> impl Iterator<Item = &'static Statistic> {
    STATISTICS.iter().filter(|statistic| !statistic.label.is_empty())
}

pub(super) struct Dashboard {
    name: String,
    budget: Budget,
    env_steps: u64,
    episodes: u64,
    /// Mean returns of the evaluations, and of the last 100 training episodes.
    evaluations: Series,
    training: Series,
    best: f64,
    epsilon: Series,
    loss: Series,
    /// One for each of [`statistics`].
    statistics: Vec<Series>,
    task: Spec,
    /// Until the first policy takes it.
    environment: Option<Box<dyn Environment>>,
    player: Option<Player>,
    /// When and at which step the speed was last measured, and what it was, in steps per second.
    measured: (Instant, u64),
    speed: f64,
    pub(super) ended: bool,
}

impl Dashboard {
    pub(super) fn new(name: &str, environment: Box<dyn Environment>, budget: Budget) -> Self {
        Self {
            name: name.into(),
            budget,
            env_steps: 0,
            episodes: 0,
            evaluations: Series::default(),
            training: Series::default(),
            best: f64::NEG_INFINITY,
            epsilon: Series::default(),
            loss: Series::default(),
            statistics: statistics().map(|_| Series::default()).collect(),
            task: environment.spec().clone(),
            environment: Some(environment),
            player: None,
            measured: (Instant::now(), 0),
            speed: 0.0,
            ended: false,
        }
    }

    pub(super) fn set_policy(&mut self, policy: &Policy) {
        // The dashboard shows no Q-value of the player, so its reward scale does not matter.
        let policy = policy.greedy(1);
        match (&mut self.player, self.environment.take()) {
            (Some(player), _) => player.set_policy(policy),
            // Without a player there is no picture; the run itself says what is wrong with an environment.
            (None, Some(environment)) => self.player = Player::new(policy, environment, EVALUATION_SEED).ok(),
            (None, None) => {}
        }
    }

    pub(super) fn take(&mut self, event: &Event) {
        match *event {
            Event::Episode { env_steps, episode, mean_return_100, epsilon, loss, .. } => {
                (self.env_steps, self.episodes) = (env_steps, episode + 1);
                self.training.push(env_steps, mean_return_100);
                self.epsilon.push(env_steps, epsilon);
                loss.into_iter().for_each(|loss| self.loss.push(env_steps, loss));
            }
            Event::Evaluation { env_steps, mean, .. } => {
                self.env_steps = env_steps;
                self.evaluations.push(env_steps, mean);
                self.best = self.best.max(mean);
            }
            Event::Statistics { env_steps, ref numbers } => {
                for (known, series) in statistics().zip(&mut self.statistics) {
                    numbers.get(known.name).into_iter().for_each(|number| series.push(env_steps, number));
                }
            }
            Event::End { env_steps, episodes, .. } => {
                (self.env_steps, self.episodes) = (env_steps, episodes);
                self.ended = true;
            }
        }
    }

    /// Lets time pass. `allowed_steps` is how far its pace lets the run be by now.
    pub(super) fn advance(&mut self, time: Duration, allowed_steps: u64) {
        if !self.ended {
            self.env_steps = self.env_steps.max(allowed_steps);
            self.measure();
        }
        if self.player.as_mut().is_some_and(|player| player.advance(time, 1.0, REST).is_err()) {
            self.player = None;
        }
    }

    /// The speed of the last second, or of what there is of the first.
    fn measure(&mut self) {
        let (start, steps) = self.measured;
        let seconds = start.elapsed().as_secs_f64();
        if seconds >= 1.0 || steps == 0 {
            self.speed = (self.env_steps - steps) as f64 / seconds.max(1e-3);
        }
        if seconds >= 1.0 {
            self.measured = (Instant::now(), self.env_steps);
        }
    }

    pub(super) fn draw(&self, frame: &mut Frame<'_>, status: &str) {
        let diagnostics = (self.known().count() as u16 + 2).div_ceil(2) + 2;
        let heights = [Length(1), Length(1), Min(8), Length(diagnostics), Length(1)];
        let [title, progress, pictures, diagnostics, keys] = Layout::vertical(heights).areas(frame.area());
        frame.render_widget(Line::from(vec!["train".bold(), format!(" {}", self.name).into()]), title);
        self.draw_progress(frame, progress, status);
        let [curve, cart] = Layout::horizontal([Fill(1); 2]).areas(pictures);
        self.draw_curve(frame, curve);
        self.draw_player(frame, cart);
        self.draw_diagnostics(frame, diagnostics);
        frame.render_widget(Line::from(if self.ended { KEYS_AT_THE_END } else { KEYS }).dim(), keys);
    }

    /// The statistics that the run's agent has: a network has other ones than a table.
    fn known(&self) -> impl Iterator<Item = (&'static str, &Series)> {
        let all = statistics().map(|known| known.label).zip(&self.statistics);
        all.filter(|(_, series)| series.latest.is_some())
    }

    fn draw_progress(&self, frame: &mut Frame<'_>, area: Rect, status: &str) {
        let (done, budget, unit) = match self.budget {
            Budget::Steps(steps) => (self.env_steps, steps, "step"),
            Budget::Episodes(episodes) => (self.episodes, episodes, "episode"),
        };
        let label = format!("{unit} {done} of {budget} │ {:.0} steps/s │ {status}", self.speed);
        let gauge = LineGauge::default().label(label).ratio((done as f64 / budget as f64).clamp(0.0, 1.0));
        frame.render_widget(gauge.filled_style(Color::Green).unfilled_style(Color::DarkGray), area);
    }

    fn draw_curve(&self, frame: &mut Frame<'_>, area: Rect) {
        let last = if let Budget::Steps(steps) = self.budget { steps } else { self.env_steps.max(1) };
        let title = match self.evaluations.latest {
            Some(mean) => format!(" • evaluated {mean:.1}, best {:.1} ", self.best),
            None => " learning curve ".into(),
        };
        let training = |mean| format!(" ─ mean return in training {mean:.1} ");
        let training = self.training.latest.map_or_else(String::new, training);
        let solved: Vec<_> =
            self.task.solved_return.into_iter().flat_map(|y| [(0.0, y), (last as f64, y)]).collect();
        let (low, high) = self.task.return_range;
        let middle = f64::midpoint(low, high);
        let line = |data, colour: Color| {
            Dataset::default().data(data).marker(Marker::Braille).graph_type(GraphType::Line).style(colour)
        };
        let chart = Chart::new(vec![
            line(&solved, Color::DarkGray),
            line(&self.training.points, Color::Blue),
            Dataset::default().data(&self.evaluations.points).marker(Marker::Dot).style(Color::Yellow),
        ])
        .block(Block::bordered().title(title).title_bottom(training))
        .legend_position(None)
        .x_axis(Axis::default().bounds([0.0, last as f64]).labels(["0".into(), last.to_string()]))
        .y_axis(Axis::default().bounds([low, high]).labels([low, middle, high].map(|y| y.to_string())));
        frame.render_widget(chart, area);
    }

    fn draw_player(&self, frame: &mut Frame<'_>, area: Rect) {
        let Some(player) = &self.player else {
            frame.render_widget(Block::bordered().title(" no evaluation yet "), area);
            return;
        };
        let title = format!(" latest policy │ step {} of {} ", player.steps, self.task.max_steps);
        let returns = player.returns.iter().rev().take(4).map(|(total, _)| format!(" {}", whole(*total)));
        let returns = fitting(returns, usize::from(area.width).saturating_sub(11));
        let returns = if returns.is_empty() { returns } else { format!(" returns{returns} ") };
        player.draw(frame, area, Block::bordered().title(title).title_bottom(returns));
    }

    fn draw_diagnostics(&self, frame: &mut Frame<'_>, area: Rect) {
        let block = Block::bordered().title(" from inside, at each evaluation ");
        let columns: [Rect; 2] = Layout::horizontal([Fill(1); 2]).spacing(2).areas(block.inner(area));
        frame.render_widget(block, area);
        let own = [("ε", &self.epsilon), ("loss", &self.loss)];
        let width = usize::from(columns[0].width).saturating_sub(27);
        let line = |(name, series): (&str, &Series)| {
            let latest = series.latest.map_or_else(|| "-".into(), short);
            Line::from(vec![format!("{name:<17}{latest:>8}  ").into(), series.sparkline(width).cyan()])
        };
        let lines: Vec<Line<'_>> = own.into_iter().chain(self.known()).map(line).collect();
        for (column, lines) in columns.into_iter().zip(lines.chunks(lines.len().div_ceil(2))) {
            frame.render_widget(Paragraph::new(lines.to_vec()), column);
        }
    }
}

fn short(value: f64) -> String {
    match value.abs() {
        size if size == 0.0 || (0.001..1.0).contains(&size) => format!("{value:.4}"),
        size if (1.0..10_000.0).contains(&size) => format!("{value:.2}"),
        _ => format!("{value:.1e}"),
    }
}

#[cfg(test)]
#[path = "../../tests/unit/view_dashboard.rs"]
mod tests;
