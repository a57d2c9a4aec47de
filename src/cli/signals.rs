//! Ctrl-C and its kin: the first stops a run at its next step, the second ends the process at once. Where a view is open
//! it is the view that ends the process, after it has given the terminal back.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;

use super::Failure;
use crate::view::Interrupts;

/// 128 + SIGINT, as shells have it.
const INTERRUPTED: u8 = 130;
/// 128 + SIGTERM.
const TERMINATED: u8 = 143;

/// What signals have asked for.
#[derive(Debug, Default)]
pub(super) struct Signals {
    /// Set by the first signal.
    pub(super) stop: Arc<AtomicBool>,
    /// The same flag and others, for a view.
    pub(super) interrupts: Interrupts,
    exit_code: Arc<AtomicUsize>,
}

impl Signals {
    /// Takes the signals from now on.
    ///
    /// # Errors
    /// When the system refuses.
    pub(super) fn listen() -> Result<Self, Failure> {
        let stop = Arc::<AtomicBool>::default();
        let at_once = Arc::clone(&stop);
        Self::listen_with(Interrupts { stop, at_once, ..Interrupts::default() })
    }

    /// As [`Self::listen`], but no signal ends the process before a view has closed.
    pub(super) fn listen_for_view() -> Result<Self, Failure> {
        Self::listen_with(Interrupts::default())
    }

    fn listen_with(interrupts: Interrupts) -> Result<Self, Failure> {
        let stop = Arc::clone(&interrupts.stop);
        let signals = Self { stop, interrupts, ..Self::default() };
        signals
            .try_listen()
            .map_err(|error| Failure::Failed(format!("cannot listen to signals such as Ctrl-C: {error}")))
    }

    fn try_listen(self) -> io::Result<Self> {
        for (signal, exit_code) in [(SIGINT, INTERRUPTED), (SIGTERM, TERMINATED)] {
            self.take(signal, exit_code)?;
        }
        #[cfg(unix)]
        if !hangup_is_ignored() {
            self.take(signal_hook::consts::SIGHUP, TERMINATED)?;
        }
        Ok(self)
    }

    fn take(&self, signal: i32, exit_code: u8) -> io::Result<()> {
        // First of the three, so that the signal that sets `stop` does not end the process.
        flag::register_conditional_shutdown(signal, exit_code.into(), Arc::clone(&self.interrupts.at_once))?;
        flag::register_usize(signal, Arc::clone(&self.exit_code), exit_code.into())?;
        flag::register(signal, Arc::clone(&self.interrupts.arrived))?;
        flag::register(signal, Arc::clone(&self.stop))?;
        Ok(())
    }

    /// The exit code of a process that a signal has stopped.
    pub(super) fn exit_code(&self) -> u8 {
        code(&self.exit_code)
    }

    /// Ends the process as the second signal does.
    pub(super) fn end_process(&self) -> impl FnOnce() + Send + use<> {
        let exit_code = Arc::clone(&self.exit_code);
        move || std::process::exit(code(&exit_code).into())
    }
}

fn code(exit_code: &AtomicUsize) -> u8 {
    u8::try_from(exit_code.load(Ordering::Relaxed)).ok().filter(|&code| code > 0).unwrap_or(INTERRUPTED)
}

/// Whether the process was started to outlive its terminal: `nohup` sets SIGHUP, the lowest bit, to be ignored.
#[cfg(unix)]
fn hangup_is_ignored() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_some_and(|mask| mask & 1 == 1)
}
