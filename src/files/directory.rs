//! A directory in which this program writes. What is below it is reached from there name by name, and never through a link,
//! also if the link appears while the program runs.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

use system::Handle;

/// A directory of the user's choice: links on the way to it are followed. It is held open, so that it stays the same one
/// whatever takes its name meanwhile.
#[derive(Clone, Debug)]
pub struct Directory {
    path: PathBuf,
    handle: Handle,
}

impl Directory {
    /// Opens a directory.
    pub fn open(path: &Path) -> io::Result<Self> {
        let name = if path.as_os_str().is_empty() { Path::new(".") } else { path };
        Ok(Self { path: path.into(), handle: system::open(name)? })
    }

    /// The directory that holds `path`, which is somewhere below this one.
    fn parent_of(&self, path: &Path) -> io::Result<Self> {
        let folders = path.strip_prefix(&self.path).ok().and_then(Path::parent);
        let folders = folders.ok_or_else(|| {
            let message = format!("{} is not in {}", path.display(), self.path.display());
            io::Error::new(io::ErrorKind::InvalidInput, message)
        })?;
        let mut parent = self.clone();
        for folder in folders {
            let path = parent.path.join(folder);
            let opened = system::open_inner(&parent.handle, &path);
            parent = Self { handle: opened.map_err(|error| parent.explained(&path, error))?, path };
        }
        Ok(parent)
    }

    /// The error of something that was tried with what has the name of `path` in this directory: if that is a link, that
    /// is the reason.
    fn explained(&self, path: &Path, error: io::Error) -> io::Error {
        if system::is_link(&self.handle, path) { is_a_link(path) } else { error }
    }

    /// Fails where a path is a link, or is reached through one.
    ///
    /// # Errors
    /// Then, and when the way to it cannot be searched. What is missing is no link.
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
        let opened = system::open_file(&parent.handle, path);
        let file = opened.map_err(|error| parent.explained(path, error))?;
        if file.metadata()?.is_file() { Ok(file) } else { Err(super::not_ordinary()) }
    }

    /// Makes a file. Fails where something has its name.
    pub fn create_file(&self, path: &Path) -> io::Result<File> {
        let parent = self.parent_of(path)?;
        system::create_file(&parent.handle, path).map_err(|error| parent.explained(path, error))
    }

    /// Gives a file another name in its directory.
    pub(crate) fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        let parent = self.parent_of(to)?;
        system::rename(&parent.handle, from, to)
    }

    /// Gives a file one more name in its directory.
    pub(crate) fn hard_link(&self, from: &Path, to: &Path) -> io::Result<()> {
        let parent = self.parent_of(to)?;
        system::hard_link(&parent.handle, from, to)
    }

    /// Removes a file; of a link the link.
    pub fn remove_file(&self, path: &Path) -> io::Result<()> {
        let parent = self.parent_of(path)?;
        system::remove(&parent.handle, path, false)
    }

    /// Removes an empty directory.
    pub(crate) fn remove_dir(&self, path: &Path) -> io::Result<()> {
        let parent = self.parent_of(path)?;
        system::remove(&parent.handle, path, true)
    }

    /// Makes the names in the directory of a file last.
    pub(crate) fn sync_names(&self, path: &Path) -> io::Result<()> {
        let parent = self.parent_of(path)?;
        system::sync(&parent.handle)
    }

    /// Whether an open file is still the one at that path: another process may have removed or replaced it before this one
    /// had locked it.
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

/// Relative to an open directory, no call follows a link: each takes one name, and opens nothing that is a link.
#[cfg(unix)]
mod system {
    use std::fs::File;
    use std::io;
    use std::os::fd::OwnedFd;
    use std::path::Path;
    use std::sync::Arc;

    use rustix::fs::{self, AtFlags, CWD, FileType, Mode, OFlags, Stat};

    pub(crate) type Handle = Arc<OwnedFd>;

    const DIRECTORY: OFlags = OFlags::RDONLY.union(OFlags::DIRECTORY).union(OFlags::CLOEXEC);
    /// A pipe that takes the name of a file meanwhile is not waited for.
    const FILE: OFlags = OFlags::RDWR.union(OFlags::NOFOLLOW).union(OFlags::NONBLOCK).union(OFlags::CLOEXEC);

    fn name(path: &Path) -> &Path {
        path.file_name().map_or(path, Path::new)
    }

    fn found(directory: &Handle, path: &Path) -> io::Result<Stat> {
        Ok(fs::statat(directory, name(path), AtFlags::SYMLINK_NOFOLLOW)?)
    }

    fn kind(found: &Stat) -> FileType {
        FileType::from_raw_mode(found.st_mode)
    }

    pub fn open(path: &Path) -> io::Result<Handle> {
        Ok(Arc::new(fs::openat(CWD, path, DIRECTORY, Mode::empty())?))
    }

    pub(crate) fn open_inner(directory: &Handle, path: &Path) -> io::Result<Handle> {
        Ok(Arc::new(fs::openat(directory, name(path), DIRECTORY | OFlags::NOFOLLOW, Mode::empty())?))
    }

    pub(crate) fn is_link(directory: &Handle, path: &Path) -> bool {
        found(directory, path).is_ok_and(|found| kind(&found) == FileType::Symlink)
    }

    pub(crate) fn create_dir(directory: &Handle, path: &Path) -> io::Result<()> {
        // The umask of the process takes bits away, here and below.
        Ok(fs::mkdirat(directory, name(path), Mode::from_raw_mode(0o777))?)
    }

    pub(crate) fn open_file(directory: &Handle, path: &Path) -> io::Result<File> {
        // The opening of a device alone can change something.
        match kind(&found(directory, path)?) {
            FileType::RegularFile | FileType::Symlink => {
                Ok(fs::openat(directory, name(path), FILE, Mode::empty())?.into())
            }
            _ => Err(super::super::not_ordinary()),
        }
    }

    pub fn create_file(directory: &Handle, path: &Path) -> io::Result<File> {
        let flags = FILE | OFlags::CREATE | OFlags::EXCL;
        Ok(fs::openat(directory, name(path), flags, Mode::from_raw_mode(0o666))?.into())
    }

    pub(crate) fn rename(directory: &Handle, from: &Path, to: &Path) -> io::Result<()> {
        Ok(fs::renameat(directory, name(from), directory, name(to))?)
    }

    pub(crate) fn hard_link(directory: &Handle, from: &Path, to: &Path) -> io::Result<()> {
        Ok(fs::linkat(directory, name(from), directory, name(to), AtFlags::empty())?)
    }

    pub(crate) fn remove(directory: &Handle, path: &Path, is_directory: bool) -> io::Result<()> {
        let flags = if is_directory { AtFlags::REMOVEDIR } else { AtFlags::empty() };
        Ok(fs::unlinkat(directory, name(path), flags)?)
    }

    pub(crate) fn sync(directory: &Handle) -> io::Result<()> {
        Ok(fs::fsync(directory)?)
    }

    pub(crate) fn is_at(directory: &Handle, file: &File, path: &Path) -> bool {
        let open = fs::fstat(file);
        found(directory, path).is_ok_and(|found| {
            open.is_ok_and(|open| (open.st_dev, open.st_ino) == (found.st_dev, found.st_ino))
        })
    }
}

/// Where nothing can be reached relative to an open directory, what is on the way is looked at before each call. A link that
/// appears between the two is followed.
#[cfg(not(unix))]
mod system {
    use std::fs::{self, File};
    use std::io;
    use std::path::{Path, PathBuf};

    pub(crate) type Handle = PathBuf;

    fn checked<'a>(directory: &Handle, path: &'a Path) -> io::Result<&'a Path> {
        if is_link(directory, path) { Err(super::is_a_link(path)) } else { Ok(path) }
    }

    pub fn open(path: &Path) -> io::Result<Handle> {
        fs::read_dir(path).map(|_| path.to_owned())
    }

    pub(crate) fn open_inner(directory: &Handle, path: &Path) -> io::Result<Handle> {
        open(checked(directory, path)?)
    }

    pub(crate) fn is_link(_: &Handle, path: &Path) -> bool {
        path.is_symlink()
    }

    pub(crate) fn create_dir(_: &Handle, path: &Path) -> io::Result<()> {
        fs::create_dir(path)
    }

    pub(crate) fn open_file(directory: &Handle, path: &Path) -> io::Result<File> {
        if !fs::metadata(path)?.is_file() {
            return Err(super::super::not_ordinary());
        }
        File::options().read(true).write(true).open(checked(directory, path)?)
    }

    pub fn create_file(directory: &Handle, path: &Path) -> io::Result<File> {
        File::options().read(true).write(true).create_new(true).open(checked(directory, path)?)
    }

    pub(crate) fn rename(_: &Handle, from: &Path, to: &Path) -> io::Result<()> {
        fs::rename(from, to)
    }

    pub(crate) fn hard_link(_: &Handle, from: &Path, to: &Path) -> io::Result<()> {
        fs::hard_link(from, to)
    }

    pub(crate) fn remove(_: &Handle, path: &Path, is_directory: bool) -> io::Result<()> {
        if is_directory { fs::remove_dir(path) } else { fs::remove_file(path) }
    }

    /// Windows opens no directories.
    pub(crate) fn sync(_: &Handle) -> io::Result<()> {
        Ok(())
    }

    pub(crate) fn is_at(_: &Handle, _: &File, path: &Path) -> bool {
        path.exists()
    }
}
