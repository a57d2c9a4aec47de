#![allow(clippy::unwrap_used)]

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
    Pacer::new(0).wait(env_steps, &shared, &AtomicBool::new(stop));
    start.elapsed()
}

#[test]
fn the_pacer_holds_a_run_back_to_its_pace_unless_it_is_stopped() {
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
    Pacer::new(1_000_000).wait(1_000_010, &shared, &AtomicBool::new(false));
    assert!(start.elapsed() >= Duration::from_millis(199));
}

#[test]
fn a_pause_ends_when_the_pace_is_full() {
    let shared = Shared::new(Pace(1.0), 50.0, 0);
    shared.set_pace(Pace(1.0), true);
    std::thread::scope(|scope| {
        let waiting = scope.spawn(|| Pacer::new(0).wait(1000, &shared, &AtomicBool::new(false)));
        std::thread::sleep(Duration::from_millis(50));
        assert!(!waiting.is_finished());
        shared.set_pace(Pace::FULL, false);
    });
}
