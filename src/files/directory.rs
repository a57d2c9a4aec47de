//! A directory in which this program writes: below it names are reached one by one, and never through a link, even a new one.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

use crate::os::{directory as system, not_ordinary};
use system::Handle;

/// A directory of the user's choice, reached through links too. It is held open, and so stays the same one.
#[derive(Clone, Debug)]
pub struct Directory {
    path: PathBuf,
    handle: Handle,
}

impl Directory {
    pub fn open(path: &Path) -> io::Result<Self> {
        let name = if path.as_os_str().is_empty() { Path::new(".") } else { path };
        Ok(Self { path: path.into(), handle: system::open(name)? })
    }

    /// The directory that holds `path`, which is somewhere below this one.
    fn parent_of(&self, path: &Path) -> io::Result<Self> {
        let directories = path.strip_prefix(&self.path).ok().and_then(Path::parent);
        let directories = directories.ok_or_else(|| {
            let message = format!("{} is not in {}", path.display(), self.path.display());
            io::Error::new(io::ErrorKind::InvalidInput, message)
        })?;
        let mut parent = self.clone();
        for directory in directories {
            let path = parent.path.join(directory);
            let opened = system::open_inner(&parent.handle, &path);
            parent = Self { handle: opened.map_err(|error| parent.explained(&path, error))?, path };
        }
        Ok(parent)
    }

    /// The error of something that was tried with `path` in this directory: if that is a link, that is the reason.
    fn explained(&self, path: &Path, error: io::Error) -> io::Error {
        if system::is_link(&self.handle, path) { is_a_link(path) } else { error }
    }

    /// Fails where a path is a link, or is reached through one. What is missing is no link.
    pub(crate) fn refuse_link(&self, path: &Path) -> io::Result<()> {
        let parent = match self.parent_of(path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
            found => found?,
        };
        if system::is_link(&parent.handle, path) { Err(is_a_link(path)) } else { Ok(()) }
    }

    /// Makes a directory; false if it was there. Fails where something else has its name.
    pub(crate) fn create_dir(&self, path: &Path) -> io::Result<bool> {
        let parent = self.parent_of(path)?;
        match system::create_dir(&parent.handle, path) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
                let opened = system::open_inner(&parent.handle, path);
                opened.map(|_| false).map_err(|error| parent.explained(path, error))
            }
            made => made.map(|()| true),
        }
    }

    /// Opens an ordinary file, to read and to write it.
    pub(crate) fn open_file(&self, path: &Path) -> io::Result<File> {
        let parent = self.parent_of(path)?;
        let file = system::open_file(&parent.handle, path).map_err(|error| parent.explained(path, error))?;
        if file.metadata()?.is_file() { Ok(file) } else { Err(not_ordinary()) }
    }

    /// Makes a file. Fails where something has its name.
    pub fn create_file(&self, path: &Path) -> io::Result<File> {
        let parent = self.parent_of(path)?;
        system::create_file(&parent.handle, path).map_err(|error| parent.explained(path, error))
    }

    pub(crate) fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        system::rename(&self.parent_of(to)?.handle, from, to)
    }

    pub(crate) fn hard_link(&self, from: &Path, to: &Path) -> io::Result<()> {
        system::hard_link(&self.parent_of(to)?.handle, from, to)
    }

    /// Removes a file; of a link the link.
    pub fn remove_file(&self, path: &Path) -> io::Result<()> {
        system::remove(&self.parent_of(path)?.handle, path, false)
    }

    pub(crate) fn remove_dir(&self, path: &Path) -> io::Result<()> {
        system::remove(&self.parent_of(path)?.handle, path, true)
    }

    /// Makes the names in the directory of a file last.
    pub(crate) fn sync_names(&self, path: &Path) -> io::Result<()> {
        system::sync(&self.parent_of(path)?.handle)
    }

    /// Whether an open file is still the one at that path: before this process had locked it, another may have replaced it.
    pub(crate) fn is_at(&self, file: &File, path: &Path) -> bool {
        self.parent_of(path).is_ok_and(|parent| system::is_at(&parent.handle, file, path))
    }
}

fn is_a_link(path: &Path) -> io::Error {
    let message = format!(
        "{} is a link, and nothing is written or removed through a link here; remove the link, or put what it leads to in \
         its place",
        path.display()
    );
    io::Error::new(io::ErrorKind::InvalidInput, message)
}
