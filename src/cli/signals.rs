//! Ctrl-C and its kin: the first stops a run at its next step, the second ends the process at once.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;

/// 128 + SIGINT, as shells have it.
const INTERRUPTED: u8 = 130;
/// 128 + SIGTERM.
const TERMINATED: u8 = 143;

/// What signals have asked for.
#[derive(Debug, Default)]
pub(super) struct Signals {
    /// Set by the first signal.
    pub(super) stop: Arc<AtomicBool>,
    exit_code: Arc<AtomicUsize>,
}

impl Signals {
    /// Takes the signals from now on.
    ///
    /// # Errors
    /// When the system refuses.
    pub(super) fn listen() -> io::Result<Self> {
        let signals = Self::default();
        for (signal, exit_code) in [(SIGINT, INTERRUPTED), (SIGTERM, TERMINATED)] {
            signals.take(signal, exit_code)?;
        }
        #[cfg(unix)]
        if !hangup_is_ignored() {
            signals.take(signal_hook::consts::SIGHUP, TERMINATED)?;
        }
        Ok(signals)
    }

    fn take(&self, signal: i32, exit_code: u8) -> io::Result<()> {
        // First of the three, so that the signal that sets `stop` does not end the process.
        flag::register_conditional_shutdown(signal, exit_code.into(), Arc::clone(&self.stop))?;
        flag::register_usize(signal, Arc::clone(&self.exit_code), exit_code.into())?;
        flag::register(signal, Arc::clone(&self.stop))?;
        Ok(())
    }

    /// The exit code of a process that a signal has stopped.
    pub(super) fn exit_code(&self) -> u8 {
        u8::try_from(self.exit_code.load(Ordering::Relaxed))
            .ok()
            .filter(|&code| code > 0)
            .unwrap_or(INTERRUPTED)
    }
}

/// Whether the process was started to outlive its terminal: `nohup` sets SIGHUP, the lowest bit, to be ignored.
#[cfg(unix)]
fn hangup_is_ignored() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_some_and(|mask| mask & 1 == 1)
}
