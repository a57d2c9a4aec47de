//! Round trips a second with a program that is an environment, and with CartPole-v1 in this process beside it.
//!
//! `cargo bench --bench programs -- COMMAND…`, for example `./dock` or `python3 adapters/gymnasium.py LunarLander-v3`. Actions
//! are random, resets are included, and the best of five rounds counts.
#![allow(clippy::unwrap_used)]

use std::sync::Arc;
use std::time::{Duration, Instant};

use cartpole_dqn::env::program::Programs;
use cartpole_dqn::env::{CartPole, Environment, Start};
use cartpole_dqn::rng::Rng;

const ROUNDS: usize = 5;
const ROUND: Duration = Duration::from_secs(1);

/// Steps a second in the best round.
fn rate(environment: &mut dyn Environment) -> f64 {
    let (size, actions) = (environment.spec().observation_size, environment.spec().num_actions as u64);
    let (max_steps, mut rng) = (environment.spec().max_steps, Rng::from_seed(0));
    let mut observation = vec![0.0; size];
    let mut round = || {
        let (start, mut steps, mut length) = (Instant::now(), 0, 0);
        environment.reset(Start::Stream(&mut rng), &mut observation).unwrap();
        while start.elapsed() < ROUND {
            let outcome = environment.step(rng.below(actions) as usize, &mut observation).unwrap();
            (steps, length) = (steps + 1, length + 1);
            if outcome.ended() || length >= max_steps {
                length = 0;
                environment.reset(Start::Stream(&mut rng), &mut observation).unwrap();
            }
        }
        f64::from(steps) / start.elapsed().as_secs_f64()
    };
    (0..ROUNDS).map(|_| round()).fold(0.0, f64::max)
}

fn main() {
    // Cargo adds `--bench`.
    let command: Vec<String> = std::env::args().skip(1).filter(|word| word != "--bench").collect();
    println!("{:>12.0} steps/s  CartPole-v1 in this process", rate(&mut CartPole::v1()));
    if !command.is_empty() {
        let name = command.join(" ");
        let show = |program: &str, line: &str| {
            eprintln!("[{program}] {line}");
            true
        };
        let programs = Arc::new(Programs::new(command, 1, Duration::from_secs(60), None, show));
        println!("{:>12.0} steps/s  {name}", rate(&mut programs.make().unwrap()));
    }
}
