//! `metrics.jsonl`: one event a line.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use crate::trainer::event::{Event, EventSink};

/// Appends events to a file.
#[derive(Debug)]
pub struct JsonLines {
    file: BufWriter<File>,
}

impl JsonLines {
    /// Creates the file, which must not be there.
    ///
    /// # Errors
    /// When that fails.
    pub fn create(path: &Path) -> io::Result<Self> {
        Ok(Self { file: BufWriter::new(File::create_new(path)?) })
    }
}

impl EventSink for JsonLines {
    fn emit(&mut self, event: &Event) -> io::Result<()> {
        serde_json::to_writer(&mut self.file, event)?;
        self.file.write_all(b"\n")?;
        match event {
            Event::Episode { .. } => Ok(()),
            Event::Evaluation { .. } | Event::Statistics { .. } | Event::End { .. } => self.file.flush(),
        }
    }
}
