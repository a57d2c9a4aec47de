//! `metrics.jsonl`: one event a line.

use std::fs::File;
use std::io::{self, Write};
use std::path::Path;

use crate::trainer::event::{Event, EventSink};

/// Appends events to a file, each at once, so that a full disk is noticed with the first line that it cannot take.
#[derive(Debug)]
pub struct JsonLines {
    file: File,
}

impl JsonLines {
    /// Creates the file, which must not be there.
    ///
    /// # Errors
    /// When that fails.
    pub fn create(path: &Path) -> io::Result<Self> {
        Ok(Self { file: File::create_new(path)? })
    }
}

impl EventSink for JsonLines {
    fn emit(&mut self, event: &Event) -> io::Result<()> {
        let mut line = serde_json::to_vec(event)?;
        line.push(b'\n');
        self.file.write_all(&line)
    }
}
