//! Progress on stderr: a bar on a terminal, elsewhere a plain line now and then.

use std::io::{self, Write};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

use crate::trainer::Budget;
use crate::trainer::event::{Event, EventSink};

/// Shortest time between two plain lines.
const LINE_INTERVAL: Duration = Duration::from_secs(2);

/// Shows how a run goes.
#[derive(Debug)]
pub struct Console {
    bar: ProgressBar,
    budget: Budget,
    start: Instant,
    /// Environment steps before it.
    start_steps: u64,
    last_line: Option<Instant>,
    episode: String,
    evaluation: String,
}

impl Console {
    /// A display for a run with this budget that goes on after `start_steps` environment steps.
    pub fn new(budget: Budget, start_steps: u64) -> Self {
        let (length, unit) = match budget {
            Budget::Steps(steps) => (steps, "step"),
            Budget::Episodes(episodes) => (episodes, "episode"),
        };
        // Two lines, so that 40 columns are enough; `wide_msg` is cut where the terminal is narrower.
        let template =
            format!("{unit} {{pos}}/{{len}} {{wide_bar}} {{prefix}} steps/s eta {{eta}}\n{{wide_msg}}");
        let bar = ProgressBar::new(length).with_prefix("0");
        if let Ok(style) = ProgressStyle::with_template(&template) {
            bar.set_style(style);
        }
        Self {
            bar,
            budget,
            start: Instant::now(),
            start_steps,
            last_line: None,
            episode: String::new(),
            evaluation: String::new(),
        }
    }

    fn show(&mut self, env_steps: u64, episodes: Option<u64>, line_is_due: bool) {
        let steps = env_steps.saturating_sub(self.start_steps);
        let steps_per_second = steps as f64 / self.start.elapsed().as_secs_f64().max(1e-9);
        let message = format!("{}{}", self.evaluation, self.episode);
        if self.bar.is_hidden() {
            if line_is_due && self.last_line.is_none_or(|last| last.elapsed() >= LINE_INTERVAL) {
                self.last_line = Some(Instant::now());
                // A closed stderr is no reason to stop a run.
                let _ =
                    writeln!(io::stderr(), "step {env_steps} | {message} | {steps_per_second:.0} steps/s");
            }
            return;
        }
        match self.budget {
            Budget::Steps(_) => self.bar.set_position(env_steps),
            Budget::Episodes(_) => episodes.into_iter().for_each(|episodes| self.bar.set_position(episodes)),
        }
        self.bar.set_prefix(format!("{steps_per_second:.0}"));
        self.bar.set_message(message);
    }
}

impl EventSink for Console {
    fn emit(&mut self, event: &Event) -> io::Result<()> {
        match *event {
            Event::Episode { env_steps, episode, mean_return_100, epsilon, loss, .. } => {
                let loss = loss.map_or_else(|| "-".to_owned(), |loss| format!("{loss:.3}"));
                self.episode = format!("return {mean_return_100:.1} ε {epsilon:.2} loss {loss}");
                self.show(env_steps, Some(episode + 1), false);
            }
            Event::Evaluation { env_steps, mean, .. } => {
                self.evaluation = format!("eval {mean:.0} ");
                self.show(env_steps, None, true);
            }
            Event::Statistics { .. } => {}
            Event::End { .. } => self.bar.finish_and_clear(),
        }
        Ok(())
    }
}

/// A run that fails sends no end: the bar must not stay behind.
impl Drop for Console {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
