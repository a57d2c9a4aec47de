//! `progress.csv`: evaluations and some of the training episodes as a table, for people with a spreadsheet.

use std::fs::File;
use std::io::{self, Write};
use std::path::Path;

use crate::files::Directory;
use crate::trainer::{Event, Observer};

/// Every so many training episodes there is a row.
const EPISODES: u64 = 10;

/// The columns; a cell is empty where a row has nothing to say.
const HEADER: &str = "event,env_steps,episodes,updates,epsilon,loss,return,mean_return_100,\
                      evaluation_mean,evaluation_std,evaluation_min,evaluation_max,evaluation_solved";

/// Writes one row for each evaluation and one for every tenth training episode. The file follows from the events
/// alone, so that a resumed run makes it anew from those in `metrics.jsonl`.
#[derive(Debug)]
pub struct ProgressCsv {
    file: File,
}

impl ProgressCsv {
    /// Starts the file anew with its header.
    ///
    /// # Errors
    /// When that fails.
    pub fn create(directory: &Directory, path: &Path) -> io::Result<Self> {
        directory.remove_if_there(path)?;
        let mut file = directory.create_file(path)?;
        writeln!(file, "{HEADER}")?;
        Ok(Self { file })
    }
}

impl ProgressCsv {
    /// Flushes all events to the disk.
    ///
    /// # Errors
    /// When that fails.
    pub fn sync(&mut self) -> io::Result<()> {
        self.file.sync_data()
    }
}

impl Observer for ProgressCsv {
    fn event(&mut self, event: &Event) -> io::Result<()> {
        let row = match *event {
            Event::Episode {
                env_steps, episode, return_, mean_return_100, epsilon, loss, updates, ..
            } if episode % EPISODES == EPISODES - 1 => {
                let loss = loss.map_or(String::new(), |loss| loss.to_string());
                // A metrics.jsonl that somebody has changed can hold any number.
                let episodes = episode.saturating_add(1);
                format!(
                    "episode,{env_steps},{episodes},{updates},{epsilon},{loss},{return_},{mean_return_100},,,,,"
                )
            }
            Event::Evaluation { env_steps, mean, std, min, max, solved, .. } => {
                format!("evaluation,{env_steps},,,,,,,{mean},{std},{min},{max},{solved}")
            }
            _ => return Ok(()),
        };
        // One call per row: a process that is killed leaves whole rows.
        self.file.write_all((row + "\n").as_bytes())
    }
}
