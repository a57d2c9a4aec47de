//! `metrics.jsonl`: one event a line.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Seek, SeekFrom, Write};
use std::path::Path;
use std::time::Duration;

use crate::files::{Directory, lock};
use crate::trainer::{Event, Observer};

/// How often the lock is tried, and the pause between. `runs` holds it for microseconds, a process that trains until it ends.
const ATTEMPTS: u32 = 5;
const PAUSE: Duration = Duration::from_millis(10);

/// Appends events, each at once, so that a full disk is noticed at the first line that does not fit. Holds the file's lock.
#[derive(Debug)]
pub struct JsonLines {
    file: File,
}

/// Tries again what another process is in the way of.
fn patiently<T>(attempt: impl Fn() -> io::Result<T>) -> io::Result<T> {
    for _ in 1..ATTEMPTS {
        match attempt() {
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => std::thread::sleep(PAUSE),
            done => return done,
        }
    }
    attempt()
}

impl JsonLines {
    /// Opens an existing file, to be [`Self::cut`]. [`io::ErrorKind::WouldBlock`] where another process has it, here and below.
    pub fn open(directory: &Directory, path: &Path) -> io::Result<Self> {
        Self::lock(patiently(|| directory.open_file(path))?, directory, path)
    }

    pub fn create(directory: &Directory, path: &Path) -> io::Result<Self> {
        Self::lock(directory.create_file(path)?, directory, path)
    }

    fn lock(file: File, directory: &Directory, path: &Path) -> io::Result<Self> {
        patiently(|| lock(&file))?;
        if directory.is_at(&file, path) { Ok(Self { file }) } else { Err(io::ErrorKind::WouldBlock.into()) }
    }

    /// Keeps only the first `lines` lines; changes nothing and returns false if there are fewer whole lines.
    pub(crate) fn cut(&mut self, lines: u64) -> io::Result<bool> {
        self.file.rewind()?;
        let (mut reader, mut found, mut length) = (BufReader::new(&self.file), 0, 0);
        while found < lines {
            let buffer = reader.fill_buf()?;
            if buffer.is_empty() {
                return Ok(false);
            }
            let newline = buffer.iter().position(|&byte| byte == b'\n');
            let taken = newline.map_or(buffer.len(), |newline| newline + 1);
            found += u64::from(newline.is_some());
            length += taken as u64;
            reader.consume(taken);
        }
        self.file.set_len(length)?;
        self.file.seek(SeekFrom::End(0))?;
        Ok(true)
    }

    pub(crate) fn sync(&mut self) -> io::Result<()> {
        self.file.sync_data()
    }
}

impl Observer for JsonLines {
    fn event(&mut self, event: &Event) -> io::Result<()> {
        let mut line = serde_json::to_vec(event)?;
        line.push(b'\n');
        self.file.write_all(&line)
    }
}
