//! The file that a command writes for the user, or standard output.

use std::io::{self, BufWriter, Read, Write};
use std::path::Path;

use super::policy::STANDARD;
use super::ui::Failure;
use crate::files::{open_ordinary, write_whole};
use crate::text::shown;

/// Bytes at the start of a file that tell what it is.
const START: u64 = 512;

/// An output that the user has asked for.
pub(super) struct Output<'a> {
    /// The option that names it.
    pub option: &'a str,
    pub path: &'a Path,
    /// What it is, such as "a trace", and how such a file begins.
    pub what: &'a str,
    pub is_own: fn(&[u8]) -> bool,
}

impl Output<'_> {
    pub(super) fn is_standard(&self) -> bool {
        self.path == Path::new(STANDARD)
    }

    /// Refuses what cannot be written, and what would be lost: a file that is not empty and holds something else.
    /// Nothing is touched.
    pub(super) fn check(&self) -> Result<(), Failure> {
        let path = self.path;
        if self.is_standard() {
            return Ok(());
        }
        if path.is_dir() {
            return Err(Failure::BadInput(self.message("it is a directory; give a file")));
        }
        // A pipe or a device holds nothing that could be lost.
        if path.is_file() && !start_of(path).is_ok_and(|start| start.is_empty() || (self.is_own)(&start)) {
            let problem = format!(
                "the file that is there is not {}, and would be lost; choose another name",
                self.what
            );
            return Err(Failure::BadInput(self.message(&problem)));
        }
        Ok(())
    }

    /// Writes the output. A reader of standard output that has gone away (`| head`) is no failure: the result is then
    /// false, and there is no use in going on.
    pub(super) fn write(
        &self,
        write: impl FnOnce(&mut dyn Write) -> io::Result<()>,
    ) -> Result<bool, Failure> {
        let written = if self.is_standard() {
            let mut stdout = BufWriter::new(io::stdout().lock());
            write(&mut stdout).and_then(|()| stdout.flush())
        } else {
            write_whole(self.path, write)
        };
        match written {
            Ok(()) => Ok(true),
            Err(error) if self.is_standard() && error.kind() == io::ErrorKind::BrokenPipe => Ok(false),
            Err(error) => Err(Failure::unwritten(self.message(&error.to_string()), &error)),
        }
    }

    fn message(&self, problem: &str) -> String {
        format!("cannot write {} {}: {problem}", self.option, shown(self.path))
    }
}

fn start_of(path: &Path) -> io::Result<Vec<u8>> {
    let mut start = Vec::new();
    open_ordinary(path)?.take(START).read_to_end(&mut start)?;
    Ok(start)
}
