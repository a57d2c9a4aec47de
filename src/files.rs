//! Files that are either whole or not there, and reading what anybody may have written.

use std::ffi::OsStr;
use std::fs::{self, File, TryLockError};
use std::io::{self, BufWriter, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use tempfile::NamedTempFile;

const PREFIX: &str = ".writing-";
const SUFFIX: &str = ".tmp";

/// Writes a file whole: a temporary file in the same directory, fsync, rename, fsync of the directory. A symbolic link's
/// target is written, and a pipe or a device (`/dev/null`) directly.
///
/// # Errors
/// Any failure on the way, that of `write` included; a file that was there before then still is.
pub fn write_whole(path: &Path, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<()> {
    write_whole_keeping(path, None, write)
}

/// Like [`write_whole`], but the existing file survives under the name `kept` and replaces what had that name. At any
/// moment at least one of the two is there and complete.
///
/// # Errors
/// See [`write_whole`].
pub fn write_whole_keeping(
    path: &Path,
    kept: Option<&Path>,
    write: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> io::Result<()> {
    if path.metadata().is_ok_and(|found| !found.is_file()) {
        let mut device = BufWriter::new(File::options().write(true).open(path)?);
        write(&mut device)?;
        return device.flush();
    }
    let path = &path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let folder = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    // A missing directory is told here: the error of the next line names a file that nobody knows.
    folder.read_dir()?;
    let mut unfinished = Unfinished::new(folder)?;
    let mut buffer = BufWriter::new(unfinished.file.as_file_mut());
    write(&mut buffer)?;
    buffer.flush()?;
    drop(buffer);
    unfinished.file.as_file().sync_all()?;
    match kept {
        Some(kept) if path.exists() => keep(path, kept)?,
        _ => {}
    }
    unfinished.persist(path)?;
    sync_folder(folder)
}

/// The paths of the files that this process is writing. [`remove_own_unfinished`] removes them.
static UNFINISHED: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

fn own_unfinished() -> MutexGuard<'static, Vec<PathBuf>> {
    UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Removes every file that this process has not finished. No new one is made while the result lives, and no thread gets
/// past the end of a write: the process is about to end.
pub fn remove_own_unfinished() -> impl Drop {
    let paths = own_unfinished();
    paths.iter().for_each(|path| drop(fs::remove_file(path)));
    paths
}

/// A temporary file, locked as long as the process that writes it lives.
struct Unfinished {
    file: NamedTempFile,
    listed: PathBuf,
}

impl Unfinished {
    fn new(folder: &Path) -> io::Result<Self> {
        let mut builder = tempfile::Builder::new();
        builder.prefix(PREFIX).suffix(SUFFIX);
        // The umask of the process takes bits away, as from every new file.
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
        let mut paths = own_unfinished();
        loop {
            // The error would name the temporary file, which nobody knows.
            let file = builder.tempfile_in(folder).map_err(|error| match error.kind() {
                kind @ (io::ErrorKind::PermissionDenied
                | io::ErrorKind::ReadOnlyFilesystem
                | io::ErrorKind::NotFound) => {
                    io::Error::new(kind, format!("no file can be made in {}: {kind}", folder.display()))
                }
                _ => error,
            })?;
            // A file system without locks is no reason to refuse.
            let _ = file.as_file().lock();
            // Before it was locked another process may have taken it for abandoned.
            if file.path().exists() {
                let listed = file.path().to_owned();
                paths.push(listed.clone());
                return Ok(Self { file, listed });
            }
        }
    }

    fn persist(mut self, path: &Path) -> io::Result<()> {
        fs::rename(self.file.path(), path)?;
        self.file.disable_cleanup(true);
        Ok(())
    }
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        own_unfinished().retain(|path| *path != self.listed);
    }
}

/// Gives a file a second name, which is never missing once it was there; where a file system has no hard links, another one.
fn keep(path: &Path, kept: &Path) -> io::Result<()> {
    let link = kept.with_file_name(format!("{PREFIX}kept{SUFFIX}"));
    let _ = fs::remove_file(&link);
    match fs::hard_link(path, &link) {
        Err(_) => fs::rename(path, kept),
        Ok(()) => {
            fs::rename(&link, kept)?;
            // A file that is renamed to another name of itself keeps both.
            let _ = fs::remove_file(&link);
            Ok(())
        }
    }
}

/// Makes a rename in a directory last; Windows does not open directories.
fn sync_folder(folder: &Path) -> io::Result<()> {
    if cfg!(unix) { File::open(folder)?.sync_all() } else { Ok(()) }
}

/// Writes a value whole as indented JSON.
///
/// # Errors
/// See [`write_whole`].
pub fn write_json(path: &Path, value: &impl serde::Serialize) -> io::Result<()> {
    write_whole(path, |file| {
        serde_json::to_writer_pretty(&mut *file, value)?;
        file.write_all(b"\n")
    })
}

/// As [`write_json`], where there is no file yet.
///
/// # Errors
/// See [`write_whole`], and [`io::ErrorKind::AlreadyExists`].
pub fn write_json_new(path: &Path, value: &impl serde::Serialize) -> io::Result<()> {
    let folder = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut unfinished = Unfinished::new(folder)?;
    let mut text = serde_json::to_vec_pretty(value)?;
    text.push(b'\n');
    unfinished.file.write_all(&text)?;
    unfinished.file.as_file().sync_all()?;
    // A link takes no name that is there, as a rename does.
    match fs::hard_link(unfinished.file.path(), path) {
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists && !path.exists() => {
            // A file system without hard links.
            unfinished.persist(path)?;
        }
        linked => linked?,
    }
    sync_folder(folder)
}

/// Opens an ordinary file: a pipe could wait for ever, a device have no end.
///
/// # Errors
/// When it is something else or cannot be opened.
pub fn open_ordinary(options: &fs::OpenOptions, path: &Path) -> io::Result<File> {
    if !fs::metadata(path)?.is_file() {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, "not an ordinary file"));
    }
    options.open(path)
}

/// Reads an ordinary file of at most `max_bytes`. A file that is larger is refused before anything of it is read.
///
/// # Errors
/// When it is larger, or not an ordinary file, or cannot be read, or the memory does not suffice.
pub fn read_limited(path: &Path, max_bytes: u64) -> io::Result<Vec<u8>> {
    let file = open_ordinary(File::options().read(true), path)?;
    let size = file.metadata()?.len();
    let too_large = || {
        let message = format!("larger than {max_bytes} bytes");
        io::Error::new(io::ErrorKind::FileTooLarge, message)
    };
    if size > max_bytes {
        return Err(too_large());
    }
    let mut bytes = Vec::new();
    bytes.try_reserve_exact(usize::try_from(size).map_err(|_| too_large())?)?;
    file.take(max_bytes.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > max_bytes { Err(too_large()) } else { Ok(bytes) }
}

/// As [`read_limited`], as text.
///
/// # Errors
/// See there, and when it is not UTF-8.
pub fn read_text_limited(path: &Path, max_bytes: u64) -> io::Result<String> {
    let text = String::from_utf8(read_limited(path, max_bytes)?);
    text.map_err(|error| io::Error::new(io::ErrorKind::InvalidData, error))
}

/// Removes what killed processes have left half-written in a directory. What a process still writes there stays.
///
/// # Errors
/// When the directory cannot be read or a file in it not removed.
pub fn remove_unfinished(folder: &Path) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        if is_unfinished(&entry.file_name()) {
            remove_abandoned(&entry.path())?;
        }
    }
    Ok(())
}

/// Removes an unfinished file, unless a process still writes it.
///
/// # Errors
/// When it cannot be removed.
pub fn remove_abandoned(path: &Path) -> io::Result<()> {
    let is_link = path.symlink_metadata().is_ok_and(|found| found.is_symlink());
    let removed = match open_ordinary(File::options().read(true), path) {
        Ok(file) if !is_link && matches!(file.try_lock(), Err(TryLockError::WouldBlock)) => Ok(()),
        Err(error) if !is_link && error.kind() == io::ErrorKind::NotFound => Ok(()),
        // The lock is held until the file is gone.
        _file => fs::remove_file(path),
    };
    match removed {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        removed => removed,
    }
}

/// Whether a file's name is that of an unfinished one, which a killed process leaves behind.
pub fn is_unfinished(name: &OsStr) -> bool {
    name.to_str().is_some_and(|name| name.starts_with(PREFIX) && name.ends_with(SUFFIX))
}

/// Whether an open file is still the one at that path: another process may have removed or replaced it before this one
/// had locked it.
///
/// # Errors
/// When the open file cannot be asked.
pub fn is_at(file: &File, path: &Path) -> io::Result<bool> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        let id = |found: fs::Metadata| (found.dev(), found.ino());
        let open = id(file.metadata()?);
        Ok(path.metadata().is_ok_and(|found| id(found) == open))
    }
    #[cfg(not(unix))]
    {
        let _ = file;
        Ok(path.exists())
    }
}

/// Makes a directory and those above it; returns those that it made, the innermost first. On an error it removes them
/// again.
///
/// # Errors
/// When one cannot be made.
pub fn create_folders(path: &Path) -> io::Result<Vec<PathBuf>> {
    let is_missing = |path: &&Path| !path.as_os_str().is_empty() && !path.exists();
    let mut missing: Vec<PathBuf> = path.ancestors().take_while(is_missing).map(Path::to_owned).collect();
    let mut made = Vec::new();
    while let Some(folder) = missing.pop() {
        match fs::create_dir(&folder) {
            Ok(()) => made.insert(0, folder),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists && folder.is_dir() => {}
            Err(error) => {
                remove_empty(&made);
                return Err(error);
            }
        }
    }
    Ok(made)
}

/// Removes those directories that are empty, the innermost first.
pub fn remove_empty(folders: &[PathBuf]) {
    folders.iter().for_each(|folder| drop(fs::remove_dir(folder)));
}
