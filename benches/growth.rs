//! How the time of an update grows with width, batch and depth, and the replay memory with its capacity, as CSV.
//! benches/growth.py plots it.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::hint::black_box;
use std::process::Command;

use cartpole_dqn::agent::{Dqn, Replay, Transition};
use cartpole_dqn::env::{CartPole, Environment, Start};
use cartpole_dqn::rng::Rng;
use common::{agent, flop, seconds_of_one};

const ROUNDS: usize = 25;

/// A point of a series, and the fastest of the rounds: what else runs on the machine can only add to it.
struct Point {
    series: &'static str,
    hidden: Vec<usize>,
    batch: usize,
    agent: Dqn,
    seconds: f64,
}

impl Point {
    fn new(series: &'static str, hidden: Vec<usize>, batch: usize) -> Self {
        Self { agent: agent(&hidden, batch), series, hidden, batch, seconds: f64::INFINITY }
    }

    fn measure(&mut self) {
        let repeats = (4e7 / flop(&self.hidden, self.batch)) as u32 + 1;
        let seconds = seconds_of_one(repeats, || {
            black_box(self.agent.learn().unwrap());
        });
        self.seconds = self.seconds.min(seconds);
    }

    fn print(&self) {
        let Self { series, hidden, batch, agent, seconds } = self;
        let (width, depth, flop) = (hidden[0], hidden.len(), flop(hidden, *batch));
        let parameters = agent.online.mlp.parameters().len();
        println!("{series},{width},{depth},{batch},{flop},{parameters},{:.3}", seconds * 1e6);
    }
}

fn updates() {
    let widths = [16, 32, 64, 128, 256, 512, 1024].map(|width| Point::new("width", vec![width; 2], 64));
    let batches = [8, 16, 32, 64, 128, 256, 512, 1024].map(|batch| Point::new("batch", vec![64; 2], batch));
    let depths = (1..=6).map(|depth| Point::new("depth", vec![64; depth], 64));
    let mut points: Vec<Point> = widths.into_iter().chain(batches).chain(depths).collect();
    for _ in 0..ROUNDS {
        points.iter_mut().for_each(Point::measure);
    }
    println!("series,width,depth,batch,flop,parameters,us_per_update");
    points.iter().for_each(Point::print);
}

/// Resident memory of this process in bytes; Linux only.
fn resident() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|line| line.starts_with("VmRSS:")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse::<f64>().unwrap() * 1024.0
}

/// Bytes of a transition in a memory that has been filled one and a half times with the episodes of a policy that is
/// random with probability `epsilon` and else balances. Small memories are measured by the thousand, as what else the
/// process touches for the first time counts too.
fn bytes_per_transition(capacity: usize, epsilon: f64) -> f64 {
    let copies = 10_000_000 / capacity;
    let before = resident();
    let mut memories: Vec<_> = (0..copies).map(|_| Replay::new(capacity, 4)).collect();
    let mut rng = Rng::from_seed(0);
    for memory in &mut memories {
        let mut environment = CartPole::v1();
        let (mut observation, mut next_observation) = ([0.0; 4], [0.0; 4]);
        environment.reset(Start::Stream(&mut rng), &mut observation).unwrap();
        for _ in 0..capacity + capacity / 2 {
            let [x, x_dot, theta, theta_dot] = observation;
            let balancing = usize::from(0.05 * x + 0.2 * x_dot + theta + 0.5 * theta_dot > 0.0);
            let action = if rng.unit() <= epsilon { rng.below(2) as usize } else { balancing };
            let outcome = environment.step(action, &mut next_observation).unwrap();
            memory.push(Transition {
                observation: &observation,
                action,
                reward: outcome.reward as f32,
                next_observation: &next_observation,
                terminated: outcome.terminated,
                truncated: outcome.truncated,
            });
            observation = next_observation;
            if outcome.ended() {
                environment.reset(Start::Stream(&mut rng), &mut observation).unwrap();
            }
        }
    }
    let bytes = resident() - before;
    black_box(&memories);
    bytes / (copies * capacity) as f64
}

/// Each measurement in a process of its own, where no memory is left from another.
fn bytes_in_a_child(capacity: usize, epsilon: f64) -> String {
    let arguments = [capacity.to_string(), epsilon.to_string()];
    let child = Command::new(std::env::current_exe().unwrap()).args(arguments).output().unwrap();
    assert!(child.status.success());
    String::from_utf8(child.stdout).unwrap()
}

fn main() {
    // `cargo bench` passes --bench.
    let arguments: Vec<f64> = std::env::args().skip(1).filter_map(|argument| argument.parse().ok()).collect();
    if let [capacity, epsilon] = arguments[..] {
        print!("{:.2}", bytes_per_transition(capacity as usize, epsilon));
        return;
    }
    updates();
    println!("\nseries,capacity,bytes_per_transition_trained,bytes_per_transition_random");
    for capacity in [1_000, 10_000, 100_000, 1_000_000, 10_000_000] {
        println!(
            "replay,{capacity},{},{}",
            bytes_in_a_child(capacity, 0.05),
            bytes_in_a_child(capacity, 1.0)
        );
    }
}
