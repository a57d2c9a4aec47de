//! The events of one run, as its report needs them.

use std::collections::BTreeMap;
use std::path::Path;

use super::ReportError;
use crate::run::read_events;
use crate::trainer::{EndReason, Evaluation, Event};

/// A statistic's name → (environment steps, value).
pub(super) type StatisticSeries = BTreeMap<String, Vec<(u64, f64)>>;

#[derive(Default)]
pub(super) struct History {
    pub(super) evaluations: Vec<Evaluation>,
    pub(super) best: Option<Evaluation>,
    /// Environment steps of an evaluation, its smallest and its largest return.
    pub(super) extremes: Vec<(f64, f64, f64)>,
    /// Environment steps, mean return of the last 100 training episodes.
    pub(super) training: Vec<(f64, f64)>,
    /// Environment steps, ε after an episode.
    pub(super) epsilon: Vec<(f64, f64)>,
    /// Environment steps, mean loss of an episode.
    pub(super) loss: Vec<(f64, f64)>,
    pub(super) statistics: StatisticSeries,
    pub(super) end_reason: Option<EndReason>,
}

impl History {
    pub(super) fn read(path: &Path) -> Result<Self, ReportError> {
        let mut history = Self::default();
        read_events(path, |event| history.take(event)).map_err(|error| ReportError::new(path, error))?;
        Ok(history)
    }

    fn take(&mut self, event: Event) {
        let env_steps = event.env_steps();
        let x = env_steps as f64;
        match event {
            Event::Evaluation { mean, min, max, best, .. } => {
                self.evaluations.push(Evaluation { env_steps, mean });
                if best {
                    self.best = Some(Evaluation { env_steps, mean });
                }
                self.extremes.push((x, min, max));
            }
            Event::Episode { mean_return_100, epsilon, loss, .. } => {
                self.training.push((x, mean_return_100));
                self.epsilon.push((x, epsilon));
                self.loss.extend(loss.map(|loss| (x, loss)));
            }
            Event::Statistics { numbers, .. } => {
                for (name, number) in numbers.0 {
                    self.statistics.entry(name).or_default().push((env_steps, number));
                }
            }
            Event::End { reason, .. } => self.end_reason = Some(reason),
        }
    }
}
