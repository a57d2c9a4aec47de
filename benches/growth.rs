//! How the time of an update grows with width, batch and depth, and the replay memory with its capacity, as CSV.
//! benches/growth.py plots it.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::hint::black_box;

use cartpole_dqn::agent::{Replay, Transition};
use cartpole_dqn::env::{CartPole, Environment};
use cartpole_dqn::rng::Rng;
use common::{agent, flop, median, seconds_of_one};

const ROUNDS: usize = 15;

fn update(series: &str, hidden: &[usize], batch: usize) {
    let mut agent = agent(hidden, batch);
    let flop = flop(hidden, batch);
    let repeats = (4e7 / flop) as u32 + 1;
    let mut learn = || {
        black_box(agent.learn().unwrap());
    };
    learn();
    let seconds = (0..ROUNDS).map(|_| seconds_of_one(repeats, &mut learn)).collect();
    let (width, depth) = (hidden.first().unwrap_or(&0), hidden.len());
    let parameters = agent.online.parameters().len();
    println!("{series},{width},{depth},{batch},{flop},{parameters},{:.3}", median(seconds) * 1e6);
}

/// Resident memory of this process in bytes; Linux only.
fn resident() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|line| line.starts_with("VmRSS:")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse::<f64>().unwrap() * 1024.0
}

/// Bytes of a transition in a memory that has been filled one and a half times with the episodes of a policy that is
/// random with probability `epsilon` and else balances. Small memories are measured by the hundred.
fn bytes_per_transition(capacity: usize, epsilon: f64) -> f64 {
    let copies = (10_000_000 / capacity).clamp(1, 500);
    let before = resident();
    let mut memories: Vec<_> = (0..copies).map(|_| Replay::new(capacity, 4)).collect();
    let mut rng = Rng::from_seed(0);
    for memory in &mut memories {
        let mut environment = CartPole::v1();
        let mut observation = environment.reset(&mut rng);
        for _ in 0..capacity + capacity / 2 {
            let [x, x_dot, theta, theta_dot] = observation;
            let balancing = usize::from(0.05 * x + 0.2 * x_dot + theta + 0.5 * theta_dot > 0.0);
            let action = if rng.unit() <= epsilon { rng.below(2) as usize } else { balancing };
            let step = environment.step(action);
            memory.push(Transition {
                observation: &observation,
                action,
                reward: step.reward,
                next_observation: &step.observation,
                terminated: step.terminated,
                truncated: step.truncated,
            });
            observation = if step.ended() { environment.reset(&mut rng) } else { step.observation };
        }
    }
    let bytes = resident() - before;
    black_box(&memories);
    bytes / (copies * capacity) as f64
}

fn main() {
    println!("series,width,depth,batch,flop,parameters,us_per_update");
    for width in [16, 32, 64, 128, 256, 512, 1024] {
        update("width", &[width; 2], 64);
    }
    for batch in [8, 16, 32, 64, 128, 256, 512, 1024] {
        update("batch", &[64; 2], batch);
    }
    for depth in 1..=6 {
        update("depth", &vec![64; depth], 64);
    }
    println!("\nseries,capacity,bytes_per_transition_trained,bytes_per_transition_random");
    for capacity in [1_000, 10_000, 100_000, 1_000_000, 10_000_000] {
        let (trained, random) = (bytes_per_transition(capacity, 0.05), bytes_per_transition(capacity, 1.0));
        println!("replay,{capacity},{trained:.2},{random:.2}");
    }
}
