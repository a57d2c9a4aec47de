//! The events of one run, from its file.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Deserialize;
use serde_json::Value;

use super::{ReportError, read};
use crate::trainer::{EndReason, Evaluation};

/// A statistic's name → (environment steps, value).
pub(super) type Series = BTreeMap<String, Vec<(u64, f64)>>;

/// What the events of a run hold.
#[derive(Default)]
pub(super) struct History {
    pub(super) evaluations: Vec<Evaluation>,
    /// That of the best policy, where the events say it.
    pub(super) best: Option<Evaluation>,
    /// Environment steps of an evaluation, its smallest and its largest return.
    pub(super) extremes: Vec<(f64, f64, f64)>,
    /// Environment steps, mean return of the last 100 training episodes.
    pub(super) training: Vec<(f64, f64)>,
    /// Environment steps, ε after an episode.
    pub(super) epsilon: Vec<(f64, f64)>,
    /// Environment steps, mean loss of an episode.
    pub(super) loss: Vec<(f64, f64)>,
    pub(super) statistics: Series,
    pub(super) ended: bool,
    pub(super) end_reason: Option<EndReason>,
}

impl History {
    pub(super) fn read(path: &Path) -> Result<Self, ReportError> {
        let text = read(path)?;
        let (mut history, mut last_step) = (Self::default(), 0);
        let lines: Vec<&str> = text.lines().collect();
        for (i, line) in lines.iter().enumerate() {
            match serde_json::from_str(line) {
                Ok::<Value, _>(event) => {
                    let step = event["env_steps"].as_u64().unwrap_or(last_step);
                    if step < last_step {
                        let problem = format!("line {}: `env_steps` goes back to {step}", i + 1);
                        return Err(ReportError::new(path, problem));
                    }
                    last_step = step;
                    history.take(&event);
                }
                // A run that was killed can leave half a line at the end.
                Err(_) if i + 1 == lines.len() && !text.ends_with('\n') => {}
                Err(error) => return Err(ReportError::new(path, format!("line {}: {error}", i + 1))),
            }
        }
        Ok(history)
    }

    fn take(&mut self, event: &Value) {
        let Some(env_steps) = event["env_steps"].as_u64() else { return };
        let x = env_steps as f64;
        let number = |field: &str| event[field].as_f64();
        match event["event"].as_str() {
            Some("evaluation") => {
                let evaluation = number("mean").map(|mean| Evaluation { env_steps, mean });
                self.evaluations.extend(evaluation);
                if event["best"] == true {
                    self.best = evaluation;
                }
                self.extremes.extend(number("min").zip(number("max")).map(|(min, max)| (x, min, max)));
            }
            Some("episode") => {
                self.training.extend(number("mean_return_100").map(|mean| (x, mean)));
                self.epsilon.extend(number("epsilon").map(|epsilon| (x, epsilon)));
                self.loss.extend(number("loss").map(|loss| (x, loss)));
            }
            Some("end") => {
                self.ended = true;
                self.end_reason = EndReason::deserialize(&event["reason"]).ok();
            }
            _ => self.take_statistics("", env_steps, event),
        }
    }

    /// Every number in an event of another kind is a statistic, under the path of its key.
    fn take_statistics(&mut self, path: &str, env_steps: u64, value: &Value) {
        const COUNTERS: [&str; 4] = ["env_steps", "episodes", "episode", "updates"];
        if let Some(number) = value.as_f64() {
            self.statistics.entry(path.to_owned()).or_default().push((env_steps, number));
        }
        for (key, member) in value.as_object().into_iter().flatten() {
            if !COUNTERS.contains(&key.as_str()) {
                let path = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
                self.take_statistics(&path, env_steps, member);
            }
        }
    }
}
