//! What differs between operating systems, one file for each: directories and locks, signals, and how a program is started
//! and ended with all that it has started. No other room asks which system it is.

use std::io;

#[cfg_attr(unix, path = "unix.rs")]
#[cfg_attr(windows, path = "windows.rs")]
#[cfg_attr(target_family = "wasm", path = "wasm.rs")]
mod system;
pub(crate) use system::*;

/// Systems on which nothing can be reached relative to an open directory.
#[cfg(not(unix))]
mod by_path;

/// The exit code after Ctrl-C: 128 + SIGINT, as shells have it.
pub(crate) const INTERRUPTED: u8 = 130;
/// The exit code after the wish of another process: 128 + SIGTERM.
pub(crate) const TERMINATED: u8 = 143;

#[cfg(all(feature = "files", not(target_family = "wasm")))]
pub(crate) fn host_name() -> String {
    gethostname::gethostname().to_string_lossy().into_owned()
}

pub(crate) fn not_ordinary() -> io::Error {
    io::Error::new(io::ErrorKind::InvalidInput, "not an ordinary file")
}
