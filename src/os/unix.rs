//! Linux, macOS and other Unixes.

/// Seconds of CPU that this process has taken; none where the system does not say.
#[cfg(feature = "cli")]
pub(crate) fn cpu_seconds() -> Option<f64> {
    let taken = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    Some(taken.tv_sec as f64 + taken.tv_nsec as f64 / 1e9)
}

/// Relative to an open directory, no call follows a link: each takes one name, and opens nothing that is a link.
#[cfg(feature = "files")]
pub(crate) mod directory {
    use std::fs::{File, TryLockError};
    use std::io;
    use std::os::fd::OwnedFd;
    use std::path::Path;
    use std::sync::Arc;

    use rustix::fs::{self, AtFlags, CWD, FileType, Mode, OFlags, Stat};

    use crate::os::not_ordinary;

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

    pub(crate) fn open(path: &Path) -> io::Result<Handle> {
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
            _ => Err(not_ordinary()),
        }
    }

    pub(crate) fn create_file(directory: &Handle, path: &Path) -> io::Result<File> {
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

    /// Locks an open file, or is [`io::ErrorKind::WouldBlock`] where another process has it. A file system may have no locks.
    pub(crate) fn lock(file: &File) -> io::Result<()> {
        match file.try_lock() {
            Err(TryLockError::WouldBlock) => Err(io::ErrorKind::WouldBlock.into()),
            Ok(()) | Err(TryLockError::Error(_)) => Ok(()),
        }
    }

    /// Opens a file that another process may only read as long as the result lives. For the error see [`lock`].
    pub(crate) fn open_shared(path: &Path) -> io::Result<File> {
        let file = File::open(path)?;
        match file.try_lock_shared() {
            Err(TryLockError::WouldBlock) => Err(io::ErrorKind::WouldBlock.into()),
            Ok(()) | Err(TryLockError::Error(_)) => Ok(file),
        }
    }
}

#[cfg(feature = "cli")]
pub(crate) mod signals {
    use std::io;
    use std::process::Command;
    use std::thread;

    use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
    use signal_hook::iterator::Signals;

    use crate::os::{INTERRUPTED, TERMINATED};

    pub(crate) use signal_hook::low_level::exit;

    /// Calls `handle` from now on for every signal that asks this process to end, with the exit code that belongs to it.
    pub(crate) fn watch(handle: impl FnMut(u8) + Send + 'static) -> io::Result<()> {
        let mut signals = vec![SIGINT, SIGTERM];
        signals.extend((!hangup_is_ignored()).then_some(SIGHUP));
        let mut signals = Signals::new(signals)?;
        let exit_code = |signal| if signal == SIGINT { INTERRUPTED } else { TERMINATED };
        let watch = move || signals.forever().map(exit_code).for_each(handle);
        thread::Builder::new().name("signals".into()).spawn(watch).map(drop)
    }

    /// Whether the process was started to outlive its terminal: `nohup` sets SIGHUP to be ignored.
    pub(super) fn hangup_is_ignored() -> bool {
        let mask = std::fs::read_to_string("/proc/self/status").ok().and_then(|status| {
            let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"))?;
            u64::from_str_radix(mask.trim(), 16).ok()
        });
        // SIGHUP is the lowest bit.
        mask.map_or_else(|| survives_hangup(Command::new("/bin/sh")), |mask| mask & 1 == 1)
    }

    /// Whether a shell outlives its own SIGHUP: it ignores what we ignore. macOS has no `/proc`, no safe code asks `sigaction`.
    pub(super) fn survives_hangup(mut shell: Command) -> bool {
        shell.args(["-c", "kill -s HUP $$"]).status().is_ok_and(|status| status.success())
    }
}

/// Programs in process groups of their own, which end with all that they have started.
#[cfg(feature = "program")]
pub(crate) mod programs {
    use std::io;
    use std::os::fd::AsFd;
    use std::os::unix::process::CommandExt;
    use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
    use std::time::{Duration, Instant};

    use rustix::event::{PollFd, PollFlags, Timespec, poll};
    use rustix::io::Errno;
    use rustix::process::{Pid, Signal, kill_process_group};

    /// A shell that waits for the end of its input, which is our end, and two seconds later ends the process group `$1`.
    const GUARD: &str = r#"read -r _; sleep 2; kill -s KILL -- "-$1""#;

    pub(crate) fn start(command: &mut Command) -> io::Result<Child> {
        command.process_group(0).spawn()
    }

    /// Starts what ends the program when we are killed. Without a shell, only the end of its standard input tells the program.
    pub(crate) fn guard(child: &Child) -> Option<Child> {
        let mut shell = Command::new("/bin/sh");
        shell.args(["-c", GUARD, "guard", &child.id().to_string()]);
        start(shell.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::null())).ok()
    }

    pub(crate) fn terminate(child: &Child) {
        let _ = kill_process_group(Pid::from_child(child), Signal::TERM);
    }

    /// Ends whatever is left of the group of a program.
    pub(crate) fn kill(child: &Child) {
        let _ = kill_process_group(Pid::from_child(child), Signal::KILL);
    }

    pub(crate) fn is_readable(pipe: &ChildStdout, timeout: Duration) -> bool {
        is_ready(pipe, PollFlags::IN, timeout)
    }

    pub(crate) fn is_writable(pipe: &ChildStdin, timeout: Duration) -> bool {
        is_ready(pipe, PollFlags::OUT, timeout)
    }

    /// Waits until a pipe can be read or written, or has no other end.
    fn is_ready(pipe: &impl AsFd, what: PollFlags, timeout: Duration) -> bool {
        let deadline = Instant::now() + timeout;
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            let left = Timespec::try_from(left).unwrap_or(Timespec { tv_sec: 1, tv_nsec: 0 });
            match poll(&mut [PollFd::new(pipe, what)], Some(&left)) {
                Err(Errno::INTR) => {}
                Ok(ready) => return ready > 0,
                Err(_) => return true,
            }
        }
    }
}

#[cfg(all(test, feature = "cli"))]
#[path = "../../tests/unit/os_unix.rs"]
mod tests;
