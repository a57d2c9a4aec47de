//! What the benchmarks share.
#![allow(dead_code)]

use std::time::Instant;

use cartpole_dqn::agent::{Agent, Dqn, Minibatch, Policy, Transition, td};
use cartpole_dqn::config::Config;
use cartpole_dqn::nn::kernels::reference;
use cartpole_dqn::nn::{Loss, Mlp};
use cartpole_dqn::rng::Rng;
use nalgebra::DMatrix;

/// The tutorial's.
const CAPACITY: usize = 2000;

/// An agent of these hidden layers with a full replay memory, its update checked.
pub fn agent(hidden: &[usize], batch: usize) -> Dqn {
    let sets = [
        format!("network.hidden={hidden:?}"),
        format!("replay.batch_size={batch}"),
        format!("replay.capacity={CAPACITY}"),
    ];
    let mut agent = Dqn::new(
        Config::from_layers(Some(("plain_dqn.json", include_str!("../../tests/data/plain_dqn.json"))), &sets)
            .unwrap()
            .agent
            .as_dqn()
            .unwrap()
            .clone(),
        4,
        2,
        None,
        0,
    );
    let mut rng = Rng::from_seed(1);
    let mut observation = [0.0; 4];
    for step in 0..5 * CAPACITY {
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
    check(&mut agent, batch);
    agent
}

/// The first update by the naive reference: the same loss and the same weights, bit for bit.
fn check(agent: &mut Dqn, batch: usize) {
    let (mut ages, mut minibatch) = (vec![0; batch], Minibatch::new(batch, 4));
    agent.replay.clone().sample(&mut agent.replay_rng.clone(), &mut ages);
    agent.replay.gather(&ages, 1, 0.99, &mut minibatch);
    let Minibatch { observations, actions, rewards, discounts, next_observations, terminated, .. } =
        minibatch;
    let (mut online, mut adam) = (agent.online.mlp.clone(), agent.adam.clone());
    let mut targets = vec![0.0; batch];
    let next = naive_forward(&agent.target.mlp, next_observations);
    td::targets(&discounts, &rewards, &terminated, &next[next.len() - 1], &mut targets);
    let layers = naive_forward(&online, observations);
    let mut dy = DMatrix::zeros(batch, 2);
    let loss = td::loss(Loss::Mse, &layers[layers.len() - 1], &actions, &targets, &mut dy);
    let mut gradient = Mlp::zeros(online.sizes().to_vec());
    for layer in (0..online.num_layers()).rev() {
        let x = &layers[layer];
        reference::layer_gradient(&dy, x, gradient.layer_mut(layer));
        let mut dx = x.clone();
        reference::input_gradient(&dy, online.layer(layer), x, &mut dx);
        dy = dx;
    }
    adam.step(online.parameters_mut(), gradient.parameters());
    assert_eq!(agent.learn().unwrap().to_bits(), loss.to_bits(), "not the reference's loss");
    let bits = |mlp: &Mlp<f32>| mlp.parameters().iter().map(|x| x.to_bits()).collect::<Vec<_>>();
    assert!(bits(&agent.online.mlp) == bits(&online), "not the reference's weights");
}

/// The outputs of all layers, the input first.
pub fn naive_forward(network: &Mlp<f32>, input: DMatrix<f32>) -> Vec<DMatrix<f32>> {
    let mut layers = vec![input];
    for layer in 0..network.num_layers() {
        let mut y = DMatrix::zeros(layers[layer].nrows(), network.sizes()[layer + 1]);
        let relu = layer + 1 < network.num_layers();
        reference::affine(&layers[layer], network.layer(layer), relu, &mut y);
        layers.push(y);
    }
    layers
}

/// A 4-24-24-2 that pushes towards where the pole falls, and so keeps it up for the 500 steps of every episode: no
/// evaluation is longer.
pub fn balancer() -> Policy {
    let mut network = Mlp::zeros(vec![4, 24, 24, 2]);
    for (input, weight) in [0.05, 0.2, 1.0, 0.5].into_iter().enumerate() {
        network.layer_mut(0)[24 * input] = weight;
    }
    network.layer_mut(1)[0] = 1.0;
    network.layer_mut(2)[1] = 1.0;
    Policy::Network(network)
}

/// Multiplications and additions of an update: the products of two forwards and a backward.
pub fn flop(hidden: &[usize], batch: usize) -> f64 {
    let sizes = [&[4], hidden, &[2]].concat();
    let products: usize = sizes.windows(2).map(|pair| pair[0] * pair[1]).sum();
    (2 * (4 * products - sizes[0] * sizes[1]) * batch) as f64
}

/// Seconds of one of `repeats` runs.
pub fn seconds_of_one(repeats: u32, mut run: impl FnMut()) -> f64 {
    let start = Instant::now();
    for _ in 0..repeats {
        run();
    }
    start.elapsed().as_secs_f64() / f64::from(repeats)
}

pub fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
