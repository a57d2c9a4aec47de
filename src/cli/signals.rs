//! Ctrl-C and its kin: the first stops a run at its next step, the second ends the process at once.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread;
use std::time::Duration;

use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;

use super::Failure;

/// 128 + SIGINT, as shells have it.
const INTERRUPTED: u8 = 130;
/// 128 + SIGTERM.
const TERMINATED: u8 = 143;

/// How soon a signal is noticed, and how long a step may take before that is said.
const POLL_INTERVAL: Duration = Duration::from_millis(200);

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
    pub(super) fn listen() -> Result<Self, Failure> {
        Self::try_listen()
            .map_err(|error| Failure::Failed(format!("cannot listen to signals such as Ctrl-C: {error}")))
    }

    fn try_listen() -> io::Result<Self> {
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

    /// Says that a signal has been noticed if the step that the run is in takes so long that nobody would see it.
    pub(super) fn tell_if_slow(&self) {
        let stop = Arc::clone(&self.stop);
        // The thread ends with the process. Without a thread the signal works all the same.
        let _ = thread::Builder::new().spawn(move || {
            while !stop.load(Ordering::Relaxed) {
                thread::sleep(POLL_INTERVAL);
            }
            thread::sleep(POLL_INTERVAL);
            super::say(
                "\nstopping after the step that the run is in, with a checkpoint; press Ctrl-C again to end at\n\
                 once, which loses what was trained since the last checkpoint",
            );
        });
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
