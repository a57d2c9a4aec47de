//! A whole loop: what it did, what is wrong with it, and what could not be seen.
//!
//! A mistake is named only where the recorded numbers prove it: a right loop has them with a probability below 10⁻⁹, or never.
//! What is a choice is a fact. Doubt is a sentence that says what would show it.
//!
//! | file | what it judges |
//! | --- | --- |
//! | `file.rs` | a [`Trace`] from a `.safetensors` file |
//! | `ends.rs` | episodes: their starts and their ends |
//! | `rows.rs` | where each row of a minibatch comes from |
//! | `memory.rs` | the rows themselves, and which are sampled |
//! | `exploration.rs` | ε, Q-values and actions |
//! | `target.rs` | how the target network moves |
//! | `updates.rs` | when the network learns, and how; whole updates |

mod ends;
mod exploration;
mod file;
mod memory;
mod rows;
mod target;
mod updates;

use serde::Serialize;

use super::mistakes::{Found, Stage};
use file::Trace;
pub(crate) use file::{MAX_FILE_SIZE, is_trace};

/// What is said of a loop.
#[derive(Debug, Default, Serialize)]
pub struct Judgement {
    /// What the loop is, and what it does.
    pub facts: Vec<String>,
    pub mistakes: Vec<Found>,
    /// What could not be seen, and what would show it.
    pub unseen: Vec<String>,
}

impl Judgement {
    fn fact(&mut self, fact: String) {
        self.facts.push(fact);
    }

    /// Names a mistake, if it is not known yet.
    fn name(&mut self, id: &str, evidence: String) {
        if !self.has(&[id]) {
            self.mistakes.extend(Found::new(id, evidence));
        }
    }

    fn doubt(&mut self, sentence: impl Into<String>) {
        self.unseen.push(sentence.into());
    }

    fn has(&self, ids: &[&str]) -> bool {
        self.mistakes.iter().any(|found| ids.contains(&found.mistake.id))
    }
}

/// Judges the bytes of a trace. `progress` is told how many candidates for a quantity of a whole update have been tried.
///
/// # Errors
///
/// Why they are no trace.
pub fn judge(bytes: &[u8], progress: &(dyn Fn(Stage, usize, usize) + Sync)) -> Result<Judgement, String> {
    let trace = Trace::from_bytes(bytes)?;
    let mut judgement = Judgement::default();
    if let Some(cut) = &trace.cut {
        judgement.doubt(format!("{cut}; it is judged as far as it goes"));
    } else if !trace.header.closed {
        let steps = trace.steps.action.len();
        judgement
            .doubt(format!("the recorder was not closed: what came after step {steps} is not in the file"));
    }
    let episodes = ends::judge(&trace, &mut judgement);
    memory::judge(&trace, &rows::origins(&trace), &episodes, &mut judgement);
    exploration::judge(&trace, &episodes, &mut judgement);
    target::judge(&trace, &mut judgement);
    updates::judge(&trace, &episodes, &mut judgement);
    updates::judge_whole(&trace, &mut judgement, progress);
    judgement.unseen.extend(trace.header.not_recorded.iter().map(|text| format!("not recorded: {text}")));
    Ok(judgement)
}

/// A number of things, and its name: "1 step", "1500 steps".
fn counted(number: usize, name: &str) -> String {
    format!("{number} {name}{}", if number == 1 { "" } else { "s" })
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    values.retain(|value| value.is_finite());
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}
