//! How fast a run may go.

use std::fmt;
use std::str::FromStr;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Speed as a multiple of simulated time (1 is real time), or unlimited.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pace(f64);

impl Pace {
    /// As fast as it goes.
    pub const FULL: Self = Self(f64::INFINITY);
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
        factor
            .filter(|factor| allowed.contains(factor))
            .map(Self)
            .ok_or_else(|| format!("expected a factor from {}x to {}x", Self::SLOWEST, Self::FASTEST))
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
#[derive(Debug)]
pub(super) struct Shared {
    /// Bits of the [`Pace`], negative while it pauses.
    pace: AtomicU64,
    /// Environment steps that the pace has allowed.
    pub(super) allowed_steps: AtomicU64,
    /// The view is to close.
    pub(super) closing: AtomicBool,
    /// Steps in a second of simulated time.
    steps_per_second: f64,
}

impl Shared {
    pub(super) fn new(pace: Pace, steps_per_second: f64, env_steps: u64) -> Self {
        Self {
            pace: AtomicU64::new(pace.0.to_bits()),
            allowed_steps: AtomicU64::new(env_steps),
            closing: AtomicBool::new(false),
            steps_per_second,
        }
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

/// Holds a run back.
#[derive(Debug)]
pub(super) struct Brake {
    /// Environment steps that the pace has allowed, a share of a step included.
    allowed: f64,
    last: Instant,
}

impl Brake {
    /// A brake for a run that has done so many steps.
    pub(super) fn new(env_steps: u64) -> Self {
        Self { allowed: env_steps as f64, last: Instant::now() }
    }

    /// Waits until the pace allows `env_steps`, or `stop` is set.
    pub(super) fn wait(&mut self, env_steps: u64, shared: &Shared, stop: &AtomicBool) {
        /// How soon a change is noticed.
        const SLICE: Duration = Duration::from_millis(10);
        let goal = env_steps as f64;
        loop {
            let (pace, paused) = shared.pace();
            let rate = if paused { 0.0 } else { pace.0 * shared.steps_per_second };
            // A run that is slower than its pace saves nothing up.
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
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn a_pace_is_a_factor_within_limits() {
        assert_eq!("5x".parse(), Ok(Pace(5.0)));
        assert_eq!("0.5".parse(), Ok(Pace(0.5)));
        for wrong in ["", "x", "0x", "-5x", "5xx", "nan", "inf", "1e9x"] {
            let refused = wrong.parse::<Pace>().unwrap_err();
            assert!(refused.contains("0.01x to 1000x"), "{refused}");
        }
    }

    #[test]
    fn the_keys_reach_full_speed_and_come_back() {
        let mut pace = Pace(1.0);
        (0..10).for_each(|_| pace = pace.faster());
        assert_eq!((pace, pace.faster()), (Pace::FULL, Pace::FULL));
        (0..10).for_each(|_| pace = pace.slower());
        assert_eq!(pace, Pace(1.0));
        (0..20).for_each(|_| pace = pace.slower());
        assert_eq!(pace, Pace(Pace::SLOWEST));
    }

    fn waited(pace: Pace, paused: bool, stop: bool, env_steps: u64) -> Duration {
        let shared = Shared::new(pace, 50.0, 0);
        shared.set_pace(pace, paused);
        let start = Instant::now();
        Brake::new(0).wait(env_steps, &shared, &AtomicBool::new(stop));
        start.elapsed()
    }

    #[test]
    fn the_brake_holds_a_run_back_to_its_pace_unless_it_is_stopped() {
        assert!(waited(Pace(10.0), false, false, 100) >= Duration::from_millis(199), "100 steps at 500/s");
        // A day of steps: would never end.
        for (pace, paused, stop) in
            [(Pace::FULL, false, false), (Pace(1.0), false, true), (Pace(1.0), true, true)]
        {
            waited(pace, paused, stop, 50 * 86_400);
        }
    }

    #[test]
    fn a_resumed_run_is_held_back_from_its_own_step_on() {
        let shared = Shared::new(Pace(1.0), 50.0, 1_000_000);
        assert_eq!(shared.allowed_steps.load(Ordering::Relaxed), 1_000_000);
        let start = Instant::now();
        // From step 0 on it would be six hours.
        Brake::new(1_000_000).wait(1_000_010, &shared, &AtomicBool::new(false));
        assert!(start.elapsed() >= Duration::from_millis(199));
    }

    #[test]
    fn a_pause_ends_when_the_pace_is_full() {
        let shared = Shared::new(Pace(1.0), 50.0, 0);
        shared.set_pace(Pace(1.0), true);
        std::thread::scope(|scope| {
            let waiting = scope.spawn(|| Brake::new(0).wait(1000, &shared, &AtomicBool::new(false)));
            std::thread::sleep(Duration::from_millis(50));
            assert!(!waiting.is_finished());
            shared.set_pace(Pace::FULL, false);
        });
    }
}
