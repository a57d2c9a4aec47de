//! The file that a command writes for the user, or standard output.

use std::io::{self, BufWriter, Read, Write};
use std::path::Path;

use super::ui::Failure;

const START: u64 = 512;

#[derive(Debug, thiserror::Error)]
pub(super) enum WriteError {
    #[error(transparent)]
    Io(#[from] io::Error),
    #[error(transparent)]
    Environment(#[from] crate::env::EnvironmentError),
    #[error("the program draws nothing: it answered `render` with `no frame`")]
    NoFrame,
}

impl From<WriteError> for Failure {
    fn from(error: WriteError) -> Self {
        match error {
            WriteError::Io(error) => Self::Failed(error.to_string()),
            WriteError::Environment(error) => error.into(),
            WriteError::NoFrame => Self::BadInput(error.to_string()),
        }
    }
}

pub(super) struct Output<'a> {
    pub(crate) option: &'a str,
    pub path: &'a Path,
    /// What it is, such as "a trace", and how such a file begins.
    pub(crate) what: &'a str,
    pub(crate) is_own: fn(&[u8]) -> bool,
}

impl Output<'_> {
    pub(super) fn is_standard(&self) -> bool {
        self.path == Path::new(super::policy::STANDARD)
    }

    /// Refuses a directory, and a file that is not empty and holds something else, which would be lost. Nothing is touched.
    pub(super) fn check(&self) -> Result<(), Failure> {
        let path = self.path;
        if self.is_standard() {
            return Ok(());
        }
        let is_own = || start_of(path).is_ok_and(|start| start.is_empty() || (self.is_own)(&start));
        let problem = match path {
            _ if path.is_dir() => "it is a directory; give a file".into(),
            // A pipe or a device holds nothing that could be lost.
            _ if path.is_file() && !is_own() => {
                format!("the file that is there is not {}, and would be lost; choose another name", self.what)
            }
            _ => return Ok(()),
        };
        Err(Failure::BadInput(self.message(&problem)))
    }

    /// Writes the output. False if the reader of standard output has gone away (`| head`), which is no failure.
    pub(super) fn write<E: From<io::Error> + Into<WriteError>>(
        &self, write: impl FnOnce(&mut dyn Write) -> Result<(), E>,
    ) -> Result<bool, Failure> {
        let written = if self.is_standard() {
            let mut stdout = BufWriter::new(io::stdout().lock());
            write(&mut stdout).and_then(|()| Ok(stdout.flush()?))
        } else {
            crate::files::write_whole(self.path, write)
        };
        match written.map_err(Into::into) {
            Err(WriteError::Io(error)) if self.is_standard() && error.kind() == io::ErrorKind::BrokenPipe => {
                Ok(false)
            }
            Err(WriteError::Io(error)) => Err(Failure::unwritten(self.message(&error.to_string()), &error)),
            other => Ok(other.map(|()| true)?),
        }
    }

    pub(super) fn message(&self, problem: &str) -> String {
        format!("cannot write {} {}: {problem}", self.option, crate::text::shown(self.path))
    }
}

fn start_of(path: &Path) -> io::Result<Vec<u8>> {
    let mut start = Vec::new();
    crate::files::open_ordinary(path)?.take(START).read_to_end(&mut start)?;
    Ok(start)
}
