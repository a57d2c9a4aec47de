//! Files that are either whole or not there, and reading what anybody may have written.

use std::ffi::OsStr;
use std::fs::{self, File};
use std::io::{self, BufWriter, Read, Write};
use std::path::Path;

const PREFIX: &str = ".writing-";
const SUFFIX: &str = ".tmp";

/// Writes a file whole: a temporary file in the same folder, fsync, rename, fsync of the folder. A symbolic link's
/// target is written, and a pipe or a device (`/dev/null`) directly.
///
/// # Errors
/// Any failure on the way, that of `write` included; a file that was there before then still is.
pub fn write_whole(path: &Path, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<()> {
    write_whole_keeping(path, None, write)
}

/// As [`write_whole`], with the file that was there before under the name `kept`, whose own file goes. At any moment at
/// least one of the two is there, whole.
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
    // A missing folder is told here: the error of the next line names a file that nobody knows.
    folder.read_dir()?;
    let mut file = tempfile::Builder::new().prefix(PREFIX).suffix(SUFFIX).tempfile_in(folder)?;
    let mut buffer = BufWriter::new(file.as_file_mut());
    write(&mut buffer)?;
    buffer.flush()?;
    drop(buffer);
    set_usual_permissions(file.as_file())?;
    file.as_file().sync_all()?;
    match kept {
        Some(kept) if path.exists() => keep(path, kept)?,
        _ => {}
    }
    file.persist(path)?;
    sync_folder(folder)
}

/// Gives a file a second name; where a file system has no hard links, another one.
fn keep(path: &Path, kept: &Path) -> io::Result<()> {
    match fs::remove_file(kept) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    fs::hard_link(path, kept).or_else(|_| fs::rename(path, kept))
}

/// Makes a rename in a folder last; Windows does not open folders.
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

/// Reads an ordinary file of at most `max_bytes`.
///
/// # Errors
/// When it is larger, or not an ordinary file, or cannot be read.
pub fn read_limited(path: &Path, max_bytes: u64) -> io::Result<Vec<u8>> {
    let file = open_ordinary(File::options().read(true), path)?;
    let mut bytes = Vec::new();
    file.take(max_bytes.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > max_bytes {
        let message = format!("larger than {max_bytes} bytes");
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, message));
    }
    Ok(bytes)
}

/// As [`read_limited`], as text.
///
/// # Errors
/// See there, and when it is not UTF-8.
pub fn read_text_limited(path: &Path, max_bytes: u64) -> io::Result<String> {
    let text = String::from_utf8(read_limited(path, max_bytes)?);
    text.map_err(|error| io::Error::new(io::ErrorKind::InvalidData, error))
}

/// Removes what a killed process has left half-written in a folder.
///
/// # Errors
/// When the folder cannot be read or a file in it not removed.
pub fn remove_unfinished(folder: &Path) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        if is_unfinished(&entry.file_name()) {
            fs::remove_file(entry.path())?;
        }
    }
    Ok(())
}

/// Whether a file's name is that of an unfinished one, which a killed process leaves behind.
pub fn is_unfinished(name: &OsStr) -> bool {
    name.to_str().is_some_and(|name| name.starts_with(PREFIX) && name.ends_with(SUFFIX))
}

/// Temporary files are private; what takes their place should be as readable as any other new file.
#[cfg(unix)]
fn set_usual_permissions(file: &File) -> io::Result<()> {
    use std::os::unix::fs::PermissionsExt;
    file.set_permissions(std::fs::Permissions::from_mode(0o644))
}

#[cfg(not(unix))]
fn set_usual_permissions(_file: &File) -> io::Result<()> {
    Ok(())
}
