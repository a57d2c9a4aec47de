//! Ctrl-C and its kin: the first stops a run at its next step, the second ends the process at once. Where a view is open
//! it is the view that ends the process, after it has given the terminal back.

use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread;
use std::time::{Duration, Instant};

use super::ui::Failure;
use crate::os::{INTERRUPTED, TERMINATED, signals};
use crate::view::Interrupts;

/// The run to stop on the first signal; most commands have none.
static LISTENER: OnceLock<Signals> = OnceLock::new();
/// How soon a signal is noticed, and how long a step may take before that is said.
const POLL_INTERVAL: Duration = Duration::from_millis(200);
/// How much later than its programs this process may take a signal to all of them.
const GROUP_INTERVAL: Duration = Duration::from_secs(1);

#[derive(Clone, Debug, Default)]
pub(super) struct Signals {
    /// Set by the first signal.
    pub(super) stop: Arc<AtomicBool>,
    /// The same flag and others, for a view.
    pub(super) interrupts: Interrupts,
    exit_code: Arc<AtomicU8>,
}

/// Takes the signals from now on. One that ends the process removes the files that it has not finished.
pub(super) fn watch() -> std::io::Result<()> {
    signals::watch(|exit_code| match LISTENER.get() {
        Some(listener) if !listener.interrupts.at_once.load(Ordering::Relaxed) => {
            listener.exit_code.store(exit_code, Ordering::Relaxed);
            listener.interrupts.arrived.store(true, Ordering::Relaxed);
            listener.stop.store(true, Ordering::Release);
        }
        _ => end(exit_code),
    })
}

/// The exit code of the signal that asks this process to stop. Waits for a moment: a signal to a group of processes can end
/// the program of an environment before this process has taken its own. Where nobody listens, that ends this process here.
pub(super) fn asked() -> Option<u8> {
    let start = Instant::now();
    loop {
        let exit_code = LISTENER.get().map_or(0, |listener| listener.exit_code.load(Ordering::Relaxed));
        if exit_code != 0 || start.elapsed() > GROUP_INTERVAL {
            return (exit_code != 0).then_some(exit_code);
        }
        thread::sleep(Duration::from_millis(10));
    }
}

fn end(exit_code: u8) {
    let _no_more = crate::files::remove_own_unfinished();
    signals::exit(exit_code.into());
}

impl Signals {
    /// Has the first signal set [`Self::stop`]. The second ends the process at once, but not before a view has closed.
    pub(super) fn listen(has_view: bool) -> Self {
        let stop = Arc::<AtomicBool>::default();
        let at_once = if has_view { Arc::default() } else { Arc::clone(&stop) };
        let interrupts = Interrupts { stop: Arc::clone(&stop), at_once, ..Interrupts::default() };
        LISTENER.get_or_init(|| Self { stop, interrupts, exit_code: Arc::default() }).clone()
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

    /// Does after this time what SIGTERM does.
    pub(super) fn stop_after(&self, time: Duration) -> Result<(), Failure> {
        let signals = self.clone();
        let wait = move || {
            thread::sleep(time);
            signals.exit_code.store(TERMINATED, Ordering::Relaxed);
            signals.stop.store(true, Ordering::Release);
        };
        let waiting = thread::Builder::new().name("time limit".into()).spawn(wait).map(drop);
        waiting.map_err(|error| Failure::Failed(format!("cannot wait for --time-limit: {error}")))
    }

    pub(super) fn exit_code(&self) -> u8 {
        match self.exit_code.load(Ordering::Relaxed) {
            0 => INTERRUPTED,
            code => code,
        }
    }

    pub(super) fn end_process(&self) -> impl FnOnce() + Send + use<> {
        let signals = self.clone();
        move || end(signals.exit_code())
    }
}
