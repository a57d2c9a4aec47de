//! Files that are either whole or not there, and reading what anybody may have written. But for `os`, which has the calls
//! below a held directory, no other file of this program changes anything on a disk.

mod directory;

use std::fs::{self, File};
use std::hash::{BuildHasher, RandomState};
use std::io::{self, BufWriter, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::os;

pub use directory::Directory;
pub(crate) use os::directory::lock;

const PREFIX: &str = ".writing-";
const SUFFIX: &str = ".tmp";

/// Writes a file of the user's choice whole: a temporary file in the same directory, fsync, rename, fsync of the directory.
/// A symbolic link's target is written, and a pipe or a device (`/dev/null`) directly.
///
/// # Errors
/// Any failure on the way, that of `write` included; a file that was there before then still is.
pub fn write_whole<E: From<io::Error>>(
    path: &Path, write: impl FnOnce(&mut dyn Write) -> Result<(), E>,
) -> Result<(), E> {
    if path.metadata().is_ok_and(|found| !found.is_file()) {
        let mut device = BufWriter::new(File::options().write(true).open(path)?);
        write(&mut device)?;
        return Ok(device.flush()?);
    }
    let path = &path.canonicalize().unwrap_or_else(|_| path.to_owned());
    // A missing directory is told here: the error of a file in it names one that nobody knows.
    Directory::open(path.parent().unwrap_or(Path::new("")))?.write_whole(path, None, write)
}

impl Directory {
    /// As [`write_whole`], below this directory and through no link. If there is a path `kept`, in the same directory, the
    /// existing file survives under that name and replaces what had it: at any moment at least one of the two is complete.
    ///
    /// # Errors
    /// See [`write_whole`]; and where the file is a link or reached through one.
    pub fn write_whole<E: From<io::Error>>(
        &self, path: &Path, kept: Option<&Path>, write: impl FnOnce(&mut dyn Write) -> Result<(), E>,
    ) -> Result<(), E> {
        [Some(path), kept].into_iter().flatten().try_for_each(|path| self.refuse_link(path))?;
        let unfinished = Unfinished::new(self, path)?;
        let mut buffer = BufWriter::new(&unfinished.file);
        write(&mut buffer)?;
        buffer.flush()?;
        drop(buffer);
        unfinished.file.sync_all()?;
        match kept {
            Some(kept) if path.exists() => self.keep(path, kept)?,
            _ => {}
        }
        self.rename(&unfinished.path, path)?;
        Ok(self.sync_names(path)?)
    }

    pub(crate) fn write_json(&self, path: &Path, value: &impl serde::Serialize) -> io::Result<()> {
        self.write_whole(path, None, |file| {
            serde_json::to_writer_pretty(&mut *file, value)?;
            file.write_all(b"\n")
        })
    }

    /// As [`Self::write_json`], where there is no file yet.
    pub(crate) fn write_json_new(&self, path: &Path, value: &impl serde::Serialize) -> io::Result<()> {
        let unfinished = Unfinished::new(self, path)?;
        let mut text = serde_json::to_vec_pretty(value)?;
        text.push(b'\n');
        (&unfinished.file).write_all(&text)?;
        unfinished.file.sync_all()?;
        // A second name takes none that is there, as a new one does.
        match self.hard_link(&unfinished.path, path) {
            Err(error)
                if error.kind() != io::ErrorKind::AlreadyExists && !path.is_symlink() && !path.exists() =>
            {
                // A file system without hard links.
                self.rename(&unfinished.path, path)?;
            }
            linked => linked?,
        }
        self.sync_names(path)
    }

    /// Makes `kept` a second name of `path`, in one step; a file system without hard links renames instead.
    fn keep(&self, path: &Path, kept: &Path) -> io::Result<()> {
        let link = kept.with_file_name(format!("{PREFIX}kept{SUFFIX}"));
        let _ = self.remove_file(&link);
        match self.hard_link(path, &link) {
            Err(_) => self.rename(path, kept),
            Ok(()) => {
                self.rename(&link, kept)?;
                // A file that is renamed to another name of itself keeps both.
                let _ = self.remove_file(&link);
                Ok(())
            }
        }
    }

    /// Fails where no file can be made beside `path`.
    pub(crate) fn check_writable(&self, path: &Path) -> io::Result<()> {
        Unfinished::new(self, path).map(drop)
    }

    /// Removes what killed processes have left half-written in a directory. What a process still writes there stays.
    pub(crate) fn remove_unfinished(&self, directory: &Path) -> io::Result<()> {
        for entry in fs::read_dir(directory)? {
            let entry = entry?;
            if is_unfinished(&entry.file_name()) {
                self.remove_abandoned(&entry.path())?;
            }
        }
        Ok(())
    }

    /// Removes an unfinished file, unless a process still writes it.
    pub(crate) fn remove_abandoned(&self, path: &Path) -> io::Result<()> {
        let file = if path.is_symlink() { None } else { Some(open_shared(path)) };
        match file {
            Some(Err(error)) if error.kind() == io::ErrorKind::WouldBlock => Ok(()),
            // The lock is held until the file is gone.
            _lock => self.remove_if_there(path),
        }
    }

    /// Removes a file, which may be missing.
    pub(crate) fn remove_if_there(&self, path: &Path) -> io::Result<()> {
        if_there(self.remove_file(path)).map(drop)
    }
}

/// The files that this process is writing. [`remove_own_unfinished`] removes them.
static UNFINISHED: Mutex<Vec<(Directory, PathBuf)>> = Mutex::new(Vec::new());

fn own_unfinished() -> MutexGuard<'static, Vec<(Directory, PathBuf)>> {
    UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Removes every file that this process has not finished. While the result lives none is made or finished: the process ends.
pub(crate) fn remove_own_unfinished() -> impl Drop {
    let files = own_unfinished();
    files.iter().for_each(|(directory, path)| drop(directory.remove_file(path)));
    files
}

/// A temporary file, locked as long as the process that writes it lives.
struct Unfinished<'a> {
    directory: &'a Directory,
    path: PathBuf,
    file: File,
}

impl<'a> Unfinished<'a> {
    fn new(directory: &'a Directory, path: &Path) -> io::Result<Self> {
        let mut files = own_unfinished();
        loop {
            let path = path.with_file_name(format!("{PREFIX}{}{SUFFIX}", random_name()));
            let file = match directory.create_file(&path) {
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => continue,
                made => made.map_err(|error| without_name(error, &path))?,
            };
            let _ = file.lock();
            // Before it was locked another process may have taken it for abandoned.
            if directory.is_at(&file, &path) {
                files.push((directory.clone(), path.clone()));
                return Ok(Self { directory, path, file });
            }
        }
    }
}

impl Drop for Unfinished<'_> {
    fn drop(&mut self) {
        own_unfinished().retain(|(_, path)| *path != self.path);
        // It is gone if it was renamed.
        let _ = self.directory.remove_file(&self.path);
    }
}

/// A part of a name that no other process on any machine has.
pub(crate) fn random_name() -> String {
    format!("{:016x}", RandomState::new().hash_one(std::process::id()))
}

/// The error of a temporary file, which nobody knows, with its directory instead.
fn without_name(error: io::Error, path: &Path) -> io::Error {
    use io::ErrorKind as Kind;
    let directory = path.parent().filter(|above| !above.as_os_str().is_empty()).unwrap_or(Path::new("."));
    match error.kind() {
        kind @ (Kind::PermissionDenied | Kind::ReadOnlyFilesystem | Kind::NotFound) => {
            io::Error::new(kind, format!("no file can be made in {}: {kind}", directory.display()))
        }
        _ => error,
    }
}

/// What was found; none if it is not there.
pub(crate) fn if_there<T>(found: io::Result<T>) -> io::Result<Option<T>> {
    match found {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        found => found.map(Some),
    }
}

/// Opens an ordinary file to read it: a pipe could wait for ever, a device have no end.
pub(crate) fn open_ordinary(path: &Path) -> io::Result<File> {
    if fs::metadata(path)?.is_file() { File::open(path) } else { Err(os::not_ordinary()) }
}

/// As [`open_ordinary`]. Others may only read the file as long as the result lives; [`io::ErrorKind::WouldBlock`] if one writes.
pub(crate) fn open_shared(path: &Path) -> io::Result<File> {
    if fs::metadata(path)?.is_file() { os::directory::open_shared(path) } else { Err(os::not_ordinary()) }
}

/// Reads an ordinary file of at most `max_bytes`. A file that is larger is refused before anything of it is read.
pub(crate) fn read_limited(path: &Path, max_bytes: u64) -> io::Result<Vec<u8>> {
    let file = open_ordinary(path)?;
    let size = file.metadata()?.len();
    check_size(size, max_bytes)?;
    let mut bytes = Vec::new();
    bytes.try_reserve_exact(usize::try_from(size).unwrap_or(usize::MAX))?;
    read_rest(file, &mut bytes, max_bytes)?;
    Ok(bytes)
}

/// Appends what a stream still has to `bytes`, which must not become more than `max_bytes`.
pub(crate) fn read_rest(stream: impl Read, bytes: &mut Vec<u8>, max_bytes: u64) -> io::Result<()> {
    stream.take(max_bytes.saturating_sub(bytes.len() as u64).saturating_add(1)).read_to_end(bytes)?;
    check_size(bytes.len() as u64, max_bytes)
}

/// Fails where a file of this size is too large.
pub(crate) fn check_size(size: u64, max_bytes: u64) -> io::Result<()> {
    let message = || format!("larger than {max_bytes} bytes");
    if size > max_bytes { Err(io::Error::new(io::ErrorKind::FileTooLarge, message())) } else { Ok(()) }
}

pub(crate) fn read_text_limited(path: &Path, max_bytes: u64) -> io::Result<String> {
    let text = String::from_utf8(read_limited(path, max_bytes)?);
    text.map_err(|error| io::Error::new(io::ErrorKind::InvalidData, error))
}

/// Whether a file's name is that of an unfinished one, which a killed process leaves behind.
pub(crate) fn is_unfinished(name: &std::ffi::OsStr) -> bool {
    name.to_str().is_some_and(|name| name.starts_with(PREFIX) && name.ends_with(SUFFIX))
}

/// Makes a directory and those above it; returns those that it made, the innermost first. On an error it removes them again.
pub(crate) fn create_directories(path: &Path) -> io::Result<Vec<PathBuf>> {
    let is_missing = |path: &&Path| !path.as_os_str().is_empty() && !path.exists();
    let mut missing: Vec<PathBuf> = path.ancestors().take_while(is_missing).map(Path::to_owned).collect();
    let mut made = Vec::new();
    while let Some(directory) = missing.pop() {
        match fs::create_dir(&directory) {
            Ok(()) => made.insert(0, directory),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists && directory.is_dir() => {}
            Err(error) => {
                remove_empty(&made);
                return Err(error);
            }
        }
    }
    Ok(made)
}

/// Removes those directories that are empty, the innermost first.
pub(crate) fn remove_empty(directories: &[PathBuf]) {
    directories.iter().for_each(|directory| drop(fs::remove_dir(directory)));
}

/// A directory of the system for temporary files, which goes with the result.
pub(crate) fn temporary_directory() -> io::Result<tempfile::TempDir> {
    tempfile::tempdir()
}
