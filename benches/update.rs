//! One DQN update as a share of the machine's peak, both measured in turns in the same run.
#![allow(clippy::unwrap_used, missing_docs)]

use std::hint::black_box;
use std::time::Instant;

use cartpole_dqn::agent::{Dqn, Transition};
use cartpole_dqn::config::Config;
use cartpole_dqn::nn::kernels::{Path, fast};
use cartpole_dqn::rng::Rng;

/// Hidden layers and batch size.
const SIZES: [([usize; 2], usize); 4] = [([24, 24], 32), ([64, 64], 64), ([120, 84], 128), ([256, 256], 64)];
const ROUNDS: usize = 31;

fn agent(hidden: [usize; 2], batch: usize) -> Dqn {
    let sets = [
        format!("network.hidden={hidden:?}"),
        format!("replay.batch_size={batch}"),
        "replay.capacity=2000".into(),
    ];
    let mut agent = Dqn::new(Config::from_layers(None, &sets).unwrap().dqn(), 4, 2, 0);
    let mut rng = Rng::from_seed(1);
    let mut observation = [0.0; 4];
    for step in 0..10_000 {
        let next_observation = std::array::from_fn(|_| rng.uniform(-1.0, 1.0) as f32);
        agent.observe(Transition {
            observation: &observation,
            action: rng.below(2) as usize,
            reward: 1.0,
            next_observation: &next_observation,
            terminated: step % 50 == 0,
            truncated: false,
        });
        observation = next_observation;
    }
    agent
}

/// Multiplications and additions of an update: the products of two forwards and a backward.
fn flop(hidden: [usize; 2], batch: usize) -> f64 {
    let sizes = [4, hidden[0], hidden[1], 2];
    let products: usize = sizes.windows(2).map(|pair| pair[0] * pair[1]).sum();
    (2 * (4 * products - sizes[0] * sizes[1]) * batch) as f64
}

/// Multiply-add rate of the machine in FLOP/s.
fn peak(path: Path) -> f64 {
    let start = Instant::now();
    let (multiply_adds, sum) = fast::peak(path, black_box(50_000), black_box(0.999), black_box(0.001));
    black_box(sum);
    2.0 * multiply_adds as f64 / start.elapsed().as_secs_f64()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn main() {
    let path = Path::current();
    println!("path {path:?}");
    println!(
        "{:>12} {:>6} {:>10} {:>10} {:>10} {:>7}",
        "network", "batch", "us/update", "GFLOP/s", "peak", "share"
    );
    let only = std::env::var("ONLY").ok().and_then(|n| n.parse().ok());
    for (hidden, batch) in SIZES.into_iter().take(only.unwrap_or(4)) {
        let mut agent = agent(hidden, batch);
        let flop = flop(hidden, batch);
        let repeats = (4e7 / flop) as u32 + 1;
        let (mut seconds, mut peaks, mut shares) = (vec![], vec![], vec![]);
        for round in 0..=ROUNDS {
            let peak = peak(path);
            let start = Instant::now();
            for _ in 0..repeats {
                black_box(agent.learn().unwrap());
            }
            let update = start.elapsed().as_secs_f64() / f64::from(repeats);
            // The first round warms up.
            if round > 0 {
                seconds.push(update);
                peaks.push(peak);
                shares.push(flop / update / peak);
            }
        }
        let (update, peak, share) = (median(seconds), median(peaks), median(shares));
        println!(
            "{:>12} {batch:>6} {:>10.3} {:>10.1} {:>10.1} {:>6.1}%",
            format!("4-{}-{}-2", hidden[0], hidden[1]),
            update * 1e6,
            flop / update / 1e9,
            peak / 1e9,
            share * 100.0
        );
    }
}
