//! Windows.

#[cfg(feature = "cli")]
pub(crate) fn cpu_seconds() -> Option<f64> {
    None
}

/// A lock of Windows keeps others from reading a run that is training. So who opens a file says what others may do with it.
#[cfg(feature = "files")]
pub(crate) mod directory {
    use std::fs::{File, OpenOptions};
    use std::io;
    use std::os::windows::fs::OpenOptionsExt;
    use std::path::Path;
    use std::thread;
    use std::time::Duration;

    use crate::os::by_path;

    pub(crate) use by_path::{Handle, create_dir, hard_link, is_at, is_link, open, open_inner, remove, sync};

    const FILE_SHARE_READ: u32 = 1;
    const FILE_SHARE_DELETE: u32 = 4;
    const FILE_FLAG_OPEN_REPARSE_POINT: u32 = 0x0020_0000;
    const ERROR_SHARING_VIOLATION: i32 = 32;
    /// How often a file is renamed, and the pause between.
    const ATTEMPTS: u32 = 200;
    const PAUSE: Duration = Duration::from_millis(10);

    fn unless_in_use(opened: io::Result<File>) -> io::Result<File> {
        opened.map_err(|error| match error.raw_os_error() {
            Some(ERROR_SHARING_VIOLATION) => io::ErrorKind::WouldBlock.into(),
            _ => error,
        })
    }

    /// Others may read, rename and remove the file, and not write it.
    fn options() -> OpenOptions {
        let mut options = File::options();
        options.share_mode(FILE_SHARE_READ | FILE_SHARE_DELETE);
        options
    }

    pub(crate) fn open_file(directory: &Handle, path: &Path) -> io::Result<File> {
        let mut options = options();
        options.custom_flags(FILE_FLAG_OPEN_REPARSE_POINT);
        unless_in_use(by_path::open_file(&mut options, directory, path))
    }

    pub(crate) fn create_file(directory: &Handle, path: &Path) -> io::Result<File> {
        unless_in_use(by_path::create_file(&mut options(), directory, path))
    }

    /// A file that somebody has open, be it a report or a virus scanner, may not be replaced until it is closed.
    pub(crate) fn rename(directory: &Handle, from: &Path, to: &Path) -> io::Result<()> {
        for _ in 1..ATTEMPTS {
            match by_path::rename(directory, from, to) {
                Err(error)
                    if error.kind() == io::ErrorKind::PermissionDenied
                        || error.raw_os_error() == Some(ERROR_SHARING_VIOLATION) =>
                {
                    thread::sleep(PAUSE);
                }
                renamed => return renamed,
            }
        }
        by_path::rename(directory, from, to)
    }

    /// A file that is open for writing has no other writer.
    pub(crate) fn lock(_: &File) -> io::Result<()> {
        Ok(())
    }

    /// Opens a file that others may only read while the result lives; [`io::ErrorKind::WouldBlock`] where one writes it.
    pub(crate) fn open_shared(path: &Path) -> io::Result<File> {
        unless_in_use(options().read(true).open(path))
    }
}

#[cfg(feature = "cli")]
pub(crate) mod signals {
    use std::io;

    use crate::os::INTERRUPTED;

    pub(crate) use std::process::exit;

    /// Calls `handle` from now on for Ctrl-C, Ctrl-Break and a window that is closed, with the exit code of Ctrl-C.
    pub(crate) fn watch(mut handle: impl FnMut(u8) + Send + 'static) -> io::Result<()> {
        ctrlc::set_handler(move || handle(INTERRUPTED)).map_err(io::Error::other)
    }
}

/// Windows has no process groups that end with all that a program has started, so none is started.
#[cfg(feature = "program")]
pub(crate) mod programs {
    use std::io;
    use std::process::{Child, ChildStdin, ChildStdout, Command};
    use std::time::Duration;

    pub(crate) fn start(_: &mut Command) -> io::Result<Child> {
        let message = "programs as environments run on Linux and macOS and not on Windows; train this one in the Windows \
                       Subsystem for Linux";
        Err(io::Error::new(io::ErrorKind::Unsupported, message))
    }

    pub(crate) fn guard(_: &Child) -> Option<Child> {
        None
    }

    pub(crate) fn terminate(_: &Child) {}

    pub(crate) fn kill(_: &Child) {}

    pub(crate) fn is_readable(_: &ChildStdout, _: Duration) -> bool {
        true
    }

    pub(crate) fn is_writable(_: &ChildStdin, _: Duration) -> bool {
        true
    }
}
