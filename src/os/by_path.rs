//! Directories of systems where nothing can be reached relative to an open one: what is on the way is looked at before each
//! call. A link that appears between the two is followed.

use std::fs::{self, File, OpenOptions};
use std::io;
use std::path::{Path, PathBuf};

pub(crate) type Handle = PathBuf;

fn checked<'a>(directory: &Handle, path: &'a Path) -> io::Result<&'a Path> {
    if is_link(directory, path) { Err(super::not_ordinary()) } else { Ok(path) }
}

pub(crate) fn open(path: &Path) -> io::Result<Handle> {
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

pub(super) fn open_file(options: &mut OpenOptions, directory: &Handle, path: &Path) -> io::Result<File> {
    if !fs::metadata(path)?.is_file() {
        return Err(super::not_ordinary());
    }
    options.read(true).write(true).open(checked(directory, path)?)
}

pub(super) fn create_file(options: &mut OpenOptions, directory: &Handle, path: &Path) -> io::Result<File> {
    options.read(true).write(true).create_new(true).open(checked(directory, path)?)
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

pub(crate) fn sync(_: &Handle) -> io::Result<()> {
    Ok(())
}

pub(crate) fn is_at(_: &Handle, _: &File, path: &Path) -> bool {
    path.exists()
}
