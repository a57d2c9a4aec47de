//! How fast a run may go.

use std::fmt;
use std::str::FromStr;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Speed as a multiple of simulated time (1 is real time), or unlimited.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Pace(f64);

impl Pace {
    pub(crate) const FULL: Self = Self(f64::INFINITY);
    const SLOWEST: f64 = 0.01;
    const FASTEST: f64 = 1000.0;

    pub(super) fn faster(self) -> Self {
        if self.0 * 2.0 > Self::FASTEST { Self::FULL } else { Self(self.0 * 2.0) }
    }

    pub(super) fn slower(self) -> Self {
        if self == Self::FULL { Self(512.0) } else { Self((self.0 / 2.0).max(Self::SLOWEST)) }
    }
}

/// `5x` or `5`.
impl FromStr for Pace {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let allowed = Self::SLOWEST..=Self::FASTEST;
        let factor = text.strip_suffix('x').unwrap_or(text).parse().ok();
        let factor = factor.filter(|factor| allowed.contains(factor)).map(Self);
        factor.ok_or_else(|| format!("expected a factor from {}x to {}x", Self::SLOWEST, Self::FASTEST))
    }
}

impl fmt::Display for Pace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::FULL => f.write_str("full speed"),
            Self(factor) => write!(f, "{factor}x"),
        }
    }
}

/// What the view and the run tell each other beside the events.
pub(super) struct Shared {
    /// Bits of the [`Pace`], negative while it pauses.
    pace: AtomicU64,
    /// Environment steps that the pace has allowed.
    pub(super) allowed_steps: AtomicU64,
    pub(super) closing: AtomicBool,
    steps_per_second: f64,
}

impl Shared {
    pub(super) fn new(pace: Pace, steps_per_second: f64, env_steps: u64) -> Self {
        let [pace, allowed_steps] = [pace.0.to_bits(), env_steps].map(AtomicU64::new);
        Self { pace, allowed_steps, closing: AtomicBool::new(false), steps_per_second }
    }

    pub(super) fn pace(&self) -> (Pace, bool) {
        let pace = f64::from_bits(self.pace.load(Ordering::Relaxed));
        (Pace(pace.abs()), pace < 0.0)
    }

    pub(super) fn set_pace(&self, pace: Pace, paused: bool) {
        let pace = if paused { -pace.0 } else { pace.0 };
        self.pace.store(pace.to_bits(), Ordering::Relaxed);
    }
}

pub(super) struct Pacer {
    /// Environment steps that the pace has allowed, a share of a step included.
    allowed: f64,
    last: Instant,
}

impl Pacer {
    pub(super) fn new(env_steps: u64) -> Self {
        Self { allowed: env_steps as f64, last: Instant::now() }
    }

    /// Waits until the pace allows `env_steps`, or `stop` is set.
    pub(super) fn wait(&mut self, env_steps: u64, shared: &Shared, stop: &AtomicBool) {
        const SLICE: Duration = Duration::from_millis(10);
        let goal = env_steps as f64;
        loop {
            let (pace, paused) = shared.pace();
            let rate = if paused { 0.0 } else { pace.0 * shared.steps_per_second };
            // A run that falls behind does not catch up later.
            self.allowed = (self.allowed + rate * self.last.elapsed().as_secs_f64()).min(goal);
            self.last = Instant::now();
            shared.allowed_steps.store(self.allowed as u64, Ordering::Relaxed);
            if self.allowed >= goal || stop.load(Ordering::Relaxed) {
                return;
            }
            std::thread::sleep(SLICE.min(Duration::from_secs_f64(((goal - self.allowed) / rate).min(1.0))));
        }
    }
}

#[cfg(test)]
#[path = "../../tests/unit/view_pace.rs"]
mod tests;
