//! One DQN update as a share of the machine's peak, both measured in turns in the same run; and what a training step
//! and an evaluation cost beside it. The update is checked against the naive reference first. Given are medians; the best
//! share is the fastest round's, as a share of the highest peak of all rounds.
//!
//! `cargo bench --bench update -- 4-24-24-2` measures the update of that network alone.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::hint::black_box;
use std::time::Instant;

use cartpole_dqn::config::Config;
use cartpole_dqn::env::catalogue::EnvironmentId;
use cartpole_dqn::nn::kernels::{InstructionSet, fast};
use cartpole_dqn::trainer::{EVALUATION_SEED, Event, evaluate};
use common::{agent, balancer, flop, median, seconds_of_one};

/// Hidden layers and batch size.
const SIZES: [([usize; 2], usize); 4] = [([24, 24], 32), ([64, 64], 64), ([120, 84], 128), ([256, 256], 64)];
const ROUNDS: usize = 31;

/// Multiply-add rate of the machine in FLOP/s.
fn peak(instruction_set: InstructionSet) -> f64 {
    let start = Instant::now();
    let (multiply_adds, sum) =
        fast::peak(instruction_set, black_box(50_000), black_box(0.999), black_box(0.001));
    black_box(sum);
    2.0 * multiply_adds as f64 / start.elapsed().as_secs_f64()
}

fn update(name: &str, hidden: [usize; 2], batch: usize) {
    let instruction_set = InstructionSet::current();
    let mut agent = agent(&hidden, batch);
    let flop = flop(&hidden, batch);
    let repeats = (4e7 / flop) as u32 + 1;
    let (mut seconds, mut peaks, mut shares) = (vec![], vec![], vec![]);
    for round in 0..=ROUNDS {
        let peak = peak(instruction_set);
        let update = seconds_of_one(repeats, || {
            black_box(agent.learn().unwrap());
        });
        // The first round warms up.
        if round > 0 {
            seconds.push(update);
            peaks.push(peak);
            shares.push(flop / update / peak);
        }
    }
    let fastest = seconds.iter().copied().fold(f64::INFINITY, f64::min);
    let highest_peak = peaks.iter().copied().fold(0.0, f64::max);
    let best = flop / fastest / highest_peak;
    let (update, peak, share) = (median(seconds), median(peaks), median(shares));
    println!(
        "{name:>12} {batch:>6} {:>10.3} {:>10.1} {:>10.1} {:>6.1}% {:>6.1}%",
        update * 1e6,
        flop / update / 1e9,
        peak / 1e9,
        share * 100.0,
        best * 100.0
    );
}

/// A training step and an evaluation of 100 episodes of 500 steps, at 4-24-24-2, batch 32 and one update a step, in
/// turns with the update of a copy of the same agent.
fn beside_the_update() {
    const NEVER: u64 = u64::MAX;
    let sets = [
        "replay.capacity=2000".into(),
        format!("budget.steps={NEVER}"),
        format!("evaluation.every_steps={NEVER}"),
        format!("checkpoint.every_steps={NEVER}"),
    ];
    let mut trainer =
        Config::from_layers(Some(("plain_dqn.json", include_str!("../tests/data/plain_dqn.json"))), &sets)
            .unwrap()
            .make_trainer()
            .unwrap();
    // The events of a step are taken and dropped, as a sink does.
    let mut events: Vec<Event> = Vec::new();
    // ε has reached its end after 10,000 steps.
    for _ in 0..12_000 {
        trainer.step(&mut events).unwrap();
    }
    let mut agent = trainer.agent().as_dqn().unwrap().clone();
    let balancer = balancer();
    let make = |max_steps| EnvironmentId::CartPoleV1.make(max_steps);
    let (mut updates, mut steps, mut outside, mut evaluations) = (vec![], vec![], vec![], vec![]);
    for _ in 0..ROUNDS {
        let update = seconds_of_one(2000, || {
            black_box(agent.learn().unwrap());
        });
        let step = seconds_of_one(2000, || trainer.step(&mut events).unwrap());
        events.clear();
        let evaluation = seconds_of_one(1, || {
            let played = evaluate(&balancer, &make, 500, EVALUATION_SEED, 100, 1.0).unwrap();
            assert!(played.iter().all(|episode| episode.total == 500.0));
        });
        updates.push(update);
        steps.push(step);
        outside.push(1.0 - update / step);
        evaluations.push(evaluation / update);
    }
    println!(
        "training step {:.3} us, its update {:.3} us: {:.1}% outside the update",
        median(steps) * 1e6,
        median(updates) * 1e6,
        median(outside) * 100.0
    );
    println!("evaluation of 100 episodes of 500 steps: as long as {:.0} updates", median(evaluations));
}

fn main() {
    // `cargo bench` passes --bench.
    let only = std::env::args().skip(1).find(|argument| argument != "--bench");
    println!("instruction set {}", InstructionSet::current().name());
    println!(
        "{:>12} {:>6} {:>10} {:>10} {:>10} {:>7} {:>7}",
        "network", "batch", "us/update", "GFLOP/s", "peak", "share", "best"
    );
    for (hidden, batch) in SIZES {
        let name = format!("4-{}-{}-2", hidden[0], hidden[1]);
        if only.as_ref().is_none_or(|only| *only == name) {
            update(&name, hidden, batch);
        }
    }
    if only.is_none() {
        beside_the_update();
    }
}
