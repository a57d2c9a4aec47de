//! Progress on stderr: a bar on a terminal, elsewhere a plain line now and then, or a line per episode.

use std::io::{self, Write};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

use crate::trainer::{Budget, Event, Observer};

pub(crate) const LINE_INTERVAL: Duration = Duration::from_secs(2);

/// A bar of a template and, in a line of its own, a message, for 40 columns; what is done took no time.
pub(crate) fn progress_bar(length: u64, done: u64, template: &str) -> ProgressBar {
    let bar = ProgressBar::new(length);
    if let Ok(style) = ProgressStyle::with_template(&format!("{template}\n{{wide_msg}}")) {
        bar.set_style(style);
    }
    bar.set_position(done);
    bar.reset_eta();
    bar
}

pub(crate) struct Console {
    bar: ProgressBar,
    budget: Budget,
    /// When the first episode with learning ended, and the steps until then, which are faster: the speed counts from there.
    learning: Option<(Instant, u64)>,
    last_line: Option<Instant>,
    episode: String,
    evaluation: String,
    details: String,
}

impl Console {
    pub fn new(budget: Budget, start_steps: u64) -> Self {
        let (length, unit) = match budget {
            Budget::Steps(steps) => (steps, "step"),
            Budget::Episodes(episodes) => (episodes, "episode"),
        };
        let done = if let Budget::Steps(_) = budget { start_steps } else { 0 };
        let bar =
            progress_bar(length, done, &format!("{unit} {{pos}}/{{len}} {{wide_bar}} {{prefix}}eta {{eta}}"));
        let [episode, evaluation, details] = [const { String::new() }; 3];
        Self { bar, budget, learning: None, last_line: None, episode, evaluation, details }
    }

    fn show(&mut self, env_steps: u64, episodes: Option<u64>, line_is_due: bool) {
        let speed = self.learning.filter(|(_, start)| env_steps > *start).map(|(since, start)| {
            format!("{:.0} steps/s", (env_steps - start) as f64 / since.elapsed().as_secs_f64().max(1e-9))
        });
        let Self { episode, evaluation, details, .. } = self;
        let separator = if episode.is_empty() || evaluation.is_empty() { "" } else { ", " };
        let message = format!("return: {episode}{separator}{evaluation}{details}");
        if self.bar.is_hidden() {
            if line_is_due && self.last_line.is_none_or(|last| last.elapsed() >= LINE_INTERVAL) {
                self.last_line = Some(Instant::now());
                let speed = speed.map_or(String::new(), |speed| format!(" | {speed}"));
                // A closed stderr is no reason to stop a run.
                let _ = writeln!(io::stderr(), "step {env_steps} | {message}{speed}");
            }
            return;
        }
        match self.budget {
            Budget::Steps(_) => self.bar.set_position(env_steps),
            Budget::Episodes(_) => episodes.into_iter().for_each(|episodes| self.bar.set_position(episodes)),
        }
        self.bar.set_prefix(speed.map_or(String::new(), |speed| speed + " "));
        self.bar.set_message(message);
    }
}

impl Observer for Console {
    fn event(&mut self, event: &Event) -> io::Result<()> {
        match *event {
            Event::Episode { env_steps, episode, mean_return_100, epsilon, loss, updates, .. } => {
                if updates > 0 && self.learning.is_none() {
                    self.learning = Some((Instant::now(), env_steps));
                    self.bar.reset_eta();
                }
                let loss = loss.map_or_else(String::new, |loss| format!(" | loss {loss:.3}"));
                self.episode = format!("train {mean_return_100:.1}");
                self.details = format!(" | ε {epsilon:.2}{loss}");
                self.show(env_steps, Some(episode + 1), false);
            }
            Event::Evaluation { env_steps, mean, .. } => {
                self.evaluation = format!("eval {mean:.1}");
                self.show(env_steps, None, true);
            }
            Event::Statistics { .. } => {}
            Event::End { .. } => self.bar.finish_and_clear(),
        }
        Ok(())
    }
}

/// A run that fails sends no `End`, and its bar must go too.
impl Drop for Console {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

/// Prints a line for every N-th episode, as the tutorial does.
pub(crate) struct EpisodeLog {
    of_total: String,
    every: u64,
}

impl EpisodeLog {
    pub fn new(budget: Budget, every: u64) -> Self {
        let of_total = match budget {
            Budget::Steps(_) => String::new(),
            Budget::Episodes(episodes) => format!("/{episodes}"),
        };
        Self { of_total, every }
    }
}

impl Observer for EpisodeLog {
    fn event(&mut self, event: &Event) -> io::Result<()> {
        if let Event::Episode { episode, return_, epsilon, .. } = *event
            && (episode + 1).is_multiple_of(self.every)
        {
            let (number, of_total) = (episode + 1, &self.of_total);
            let line = format!("episode {number}{of_total}  return {return_}  epsilon {epsilon:.2}");
            // A closed stderr is no reason to stop a run.
            let _ = writeln!(io::stderr(), "{line}");
        }
        Ok(())
    }
}
