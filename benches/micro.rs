//! The parts of an update and what surrounds it. Each result is checked before it is timed: kernels against the naive
//! reference and evaluation against single episodes bit for bit, the physics against Gymnasium's recordings, the replay
//! memory against a plain list, a whole run against its recorded hash.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::fmt;
use std::sync::atomic::AtomicBool;

use cartpole_dqn::agent::{Agent, Dqn, Minibatch, Replay, Transition};
use cartpole_dqn::config::Config;
use cartpole_dqn::env::catalogue::EnvironmentId;
use cartpole_dqn::env::{Acrobot, CartPole, Environment, MountainCar, Start};
use cartpole_dqn::nn::kernels::{AdamCoefficients, InstructionSet, Kernels, reference, scratch_len};
use cartpole_dqn::nn::{Activations, Mlp};
use cartpole_dqn::rng::Rng;
use cartpole_dqn::trainer::{EVALUATION_SEED, Event, evaluate, record};
use common::{balancer, naive_forward};
use divan::counter::ItemsCount;
use divan::{Bencher, black_box};
use nalgebra::DMatrix;

fn main() {
    println!("instruction set {}", InstructionSet::current().name());
    divan::main();
}

/// A hidden layer and its batch, that of each network of benches/update.rs.
#[derive(Clone, Copy)]
struct Layer {
    inputs: usize,
    outputs: usize,
    batch: usize,
}

const LAYERS: [Layer; 4] = [
    Layer { inputs: 24, outputs: 24, batch: 32 },
    Layer { inputs: 64, outputs: 64, batch: 64 },
    Layer { inputs: 120, outputs: 84, batch: 128 },
    Layer { inputs: 256, outputs: 256, batch: 64 },
];

impl fmt::Display for Layer {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{}x{} batch {}", self.inputs, self.outputs, self.batch)
    }
}

impl Layer {
    fn parameters(self) -> usize {
        (self.inputs + 1) * self.outputs
    }

    /// Multiplications and additions of one product; divan's items per second are FLOP/s then.
    fn flop(self) -> usize {
        2 * self.inputs * self.outputs * self.batch
    }

    fn scratch(self) -> Vec<f32> {
        vec![0.0; scratch_len(self.batch, self.inputs.max(self.outputs))]
    }
}

fn random(rows: usize, columns: usize, seed: u64) -> DMatrix<f32> {
    let mut rng = Rng::from_seed(seed);
    DMatrix::from_fn(rows, columns, |_, _| rng.uniform(-1.0, 1.0) as f32)
}

/// Times `fast` once it has written the same bits as `naive`.
fn compare(
    bencher: Bencher, count: usize, mut output: DMatrix<f32>, naive: impl FnOnce(&mut DMatrix<f32>),
    mut fast: impl FnMut(&mut DMatrix<f32>),
) {
    let mut expected = output.clone();
    naive(&mut expected);
    fast(&mut output);
    let bits = |matrix: &DMatrix<f32>| matrix.map(f32::to_bits);
    assert!(bits(&output) == bits(&expected), "not the reference's bits");
    bencher.counter(ItemsCount::new(count)).bench_local(|| fast(black_box(&mut output)));
}

#[divan::bench_group]
mod kernels {
    use super::*;

    fn nan(rows: usize, columns: usize) -> DMatrix<f32> {
        DMatrix::from_element(rows, columns, f32::NAN)
    }

    #[divan::bench(args = LAYERS)]
    fn affine(bencher: Bencher, layer: Layer) {
        let x = random(layer.batch, layer.inputs, 1);
        let weights = random(layer.parameters(), 1, 2);
        let (weights, mut scratch) = (weights.as_slice(), layer.scratch());
        compare(
            bencher,
            layer.flop(),
            nan(layer.batch, layer.outputs),
            |y| reference::affine(&x, weights, true, y),
            |y| Kernels::affine(&x, weights, true, &mut scratch, y),
        );
    }

    /// The baseline: the same product, without bias and ReLU, by nalgebra.
    #[divan::bench(args = LAYERS)]
    fn affine_by_nalgebra(bencher: Bencher, layer: Layer) {
        let x = random(layer.batch, layer.inputs, 1);
        let weight = random(layer.inputs, layer.outputs, 2);
        let mut y = DMatrix::zeros(layer.batch, layer.outputs);
        let count = ItemsCount::new(layer.flop());
        bencher.counter(count).bench_local(|| black_box(&mut y).gemm(1.0, &x, &weight, 0.0));
    }

    #[divan::bench(args = LAYERS)]
    fn input_gradient(bencher: Bencher, layer: Layer) {
        let x = random(layer.batch, layer.inputs, 1);
        let weights = random(layer.parameters(), 1, 2);
        let dy = random(layer.batch, layer.outputs, 3);
        let (weights, mut scratch) = (weights.as_slice(), layer.scratch());
        compare(
            bencher,
            layer.flop(),
            nan(layer.batch, layer.inputs),
            |dx| reference::input_gradient(&dy, weights, &x, dx),
            |dx| Kernels::input_gradient(&dy, weights, &x, &mut scratch, dx),
        );
    }

    #[divan::bench(args = LAYERS)]
    fn layer_gradient(bencher: Bencher, layer: Layer) {
        let x = random(layer.batch, layer.inputs, 1);
        let dy = random(layer.batch, layer.outputs, 3);
        let mut scratch = layer.scratch();
        compare(
            bencher,
            layer.flop(),
            nan(layer.parameters(), 1),
            |gradient| reference::layer_gradient(&dy, &x, gradient.as_mut_slice()),
            |gradient| Kernels::layer_gradient(&dy, &x, &mut scratch, gradient.as_mut_slice()),
        );
    }

    /// Items are parameters.
    #[divan::bench(args = LAYERS)]
    fn adam(bencher: Bencher, layer: Layer) {
        adam_step(bencher, layer, random(layer.parameters(), 1, 1), random(layer.parameters(), 3, 2).abs());
    }

    /// The weights of a dead unit: no gradient, and a first moment that has decayed into the denormal numbers.
    #[divan::bench(args = LAYERS)]
    fn adam_of_dead_units(bencher: Bencher, layer: Layer) {
        let mut state = random(layer.parameters(), 3, 2).abs();
        state.column_mut(1).fill(f32::from_bits(1));
        adam_step(bencher, layer, DMatrix::zeros(layer.parameters(), 1), state);
    }

    /// `state` is (parameters, 3): the parameters and both moments.
    fn adam_step(bencher: Bencher, layer: Layer, gradient: DMatrix<f32>, state: DMatrix<f32>) {
        let coefficients = AdamCoefficients {
            beta1: 0.9,
            one_minus_beta1: 0.1,
            beta2: 0.999,
            one_minus_beta2: 0.001,
            step_size: 0.001,
            second_moment_scale: 1.0,
            epsilon: 1e-8,
        };
        type Kernel = fn(&AdamCoefficients<f32>, &mut [f32], &[f32], &mut [f32], &mut [f32]) -> bool;
        let step = |kernel: Kernel, state: &mut DMatrix<f32>| {
            let (parameters, moments) = state.as_mut_slice().split_at_mut(gradient.len());
            let (first, second) = moments.split_at_mut(gradient.len());
            assert!(kernel(&coefficients, parameters, gradient.as_slice(), first, second));
        };
        compare(
            bencher,
            layer.parameters(),
            state,
            |state| step(reference::adam, state),
            |state| step(Kernels::adam, state),
        );
    }
}

/// 4-24-24-2 with the greedy policy.
fn agent() -> Dqn {
    let sets =
        ["network.hidden=[24,24]".into(), "exploration.initial=0".into(), "exploration.final=0".into()];
    Dqn::new(
        Config::from_layers(Some(("plain_dqn.json", include_str!("../tests/data/plain_dqn.json"))), &sets)
            .unwrap()
            .agent
            .as_dqn()
            .unwrap()
            .clone(),
        4,
        2,
        None,
        0,
    )
}

const OBSERVATION: [f32; 4] = [0.3, -0.4, 0.05, 0.2];

fn naive_q_values(network: &Mlp<f32>) -> [f32; 2] {
    let layers = naive_forward(network, DMatrix::from_row_slice(1, 4, &OBSERVATION));
    [layers[3][0], layers[3][1]]
}

/// One observation through 4-24-24-2.
#[divan::bench]
fn forward(bencher: Bencher) {
    let network = agent().online.mlp;
    let mut activations = Activations::new(network.sizes(), 1);
    let mut run = || {
        activations.input_mut().as_mut_slice().copy_from_slice(&black_box(OBSERVATION));
        network.forward(&mut activations);
        [activations.output()[0], activations.output()[1]]
    };
    assert_eq!(run(), naive_q_values(&network));
    bencher.bench_local(run);
}

/// The draw for ε, the forward and the choice.
#[divan::bench]
fn act(bencher: Bencher) {
    let mut agent = agent();
    let action = agent.act(&OBSERVATION);
    let expected = naive_q_values(&agent.online.mlp);
    assert_eq!(action, usize::from(expected[1] > expected[0]));
    bencher.bench_local(|| agent.act(&black_box(OBSERVATION)));
}

fn assert_physics_of_gymnasium() {
    let recording = include_str!("../tests/data/gymnasium_cartpole_v1.json");
    let recording: serde_json::Value = serde_json::from_str(recording).unwrap();
    for episode in recording["episodes"].as_array().unwrap() {
        let mut state: [f64; 4] = serde_json::from_value(episode["initial_state"].clone()).unwrap();
        let actions = episode["actions"].as_array().unwrap();
        for (action, next) in actions.iter().zip(episode["states"].as_array().unwrap()) {
            let mut environment = CartPole::at(state);
            environment.step(action.as_u64().unwrap() as usize, &mut [0.0; 4]).unwrap();
            state = serde_json::from_value(next.clone()).unwrap();
            let close = environment
                .state()
                .unwrap()
                .iter()
                .zip(state)
                .all(|(ours, theirs)| (ours - theirs).abs() < 1e-14);
            assert!(close, "{:?} is not {state:?}", environment.state());
        }
    }
}

/// With the resets of a random policy's episodes.
#[divan::bench]
fn environment_step(bencher: Bencher) {
    assert_physics_of_gymnasium();
    random_play(bencher, CartPole::default());
}

/// tests/it/golden_tasks.rs compares these two with Gymnasium.
#[divan::bench]
fn environment_step_acrobot(bencher: Bencher) {
    random_play(bencher, Acrobot::default());
}

#[divan::bench]
fn environment_step_mountain_car(bencher: Bencher) {
    random_play(bencher, MountainCar::default());
}

fn random_play(bencher: Bencher, mut environment: impl Environment) {
    let mut rng = Rng::from_seed(0);
    let actions = environment.spec().num_actions as u64;
    let mut observation = vec![0.0; environment.spec().observation_size];
    environment.reset(Start::Stream(&mut rng), &mut observation).unwrap();
    bencher.bench_local(|| {
        let outcome = environment.step(rng.below(actions) as usize, &mut observation).unwrap();
        if outcome.terminated {
            environment.reset(Start::Stream(&mut rng), &mut observation).unwrap();
        }
        outcome
    });
}

/// A minibatch of 32 out of 50,000.
#[divan::bench]
fn replay_sample_and_gather(bencher: Bencher) {
    const CAPACITY: usize = 50_000;
    let (mut replay, mut rng) = (Replay::new(CAPACITY, 4), Rng::from_seed(0));
    let seen: Vec<[f32; 4]> = (0..=2 * CAPACITY).map(|i| [0, 1, 2, 3].map(|k| (4 * i + k) as f32)).collect();
    for (observation, next_observation) in seen.iter().zip(&seen[1..]) {
        replay.push(Transition {
            observation,
            action: 1,
            reward: 1.0,
            next_observation,
            terminated: observation[0] % 50.0 == 0.0,
            truncated: false,
        });
    }
    let (mut ages, mut drawn) = ([0; 32], Minibatch::new(32, 4));
    let mut run = |ages: &mut [usize; 32], drawn: &mut Minibatch| {
        replay.sample(&mut rng, ages);
        replay.gather(ages, 1, 0.99, drawn);
    };
    run(&mut ages, &mut drawn);
    for (sample, age) in ages.into_iter().enumerate() {
        let index = CAPACITY + age;
        assert!(drawn.observations.row(sample).iter().eq(&seen[index]));
        assert!(drawn.next_observations.row(sample).iter().eq(&seen[index + 1]));
        assert_eq!(drawn.terminated[sample], seen[index][0] % 50.0 == 0.0);
    }
    bencher.bench_local(|| run(&mut ages, black_box(&mut drawn)));
}

/// Each episode is of 500 steps: no evaluation is longer.
#[divan::bench]
fn evaluate_100_episodes(bencher: Bencher) {
    let policy = balancer();
    let make = |max_steps| EnvironmentId::CartPoleV1.make(max_steps);
    let run = || {
        let played = evaluate(black_box(&policy), &make, 500, EVALUATION_SEED, 100, 1.0).unwrap();
        played.iter().map(|episode| episode.total).collect::<Vec<_>>()
    };
    let mut greedy = policy.greedy(1);
    let one_by_one = (0..100)
        .map(|episode| record(&mut greedy, &mut CartPole::v1(), EVALUATION_SEED + episode).unwrap().total);
    let returns = run();
    assert!(one_by_one.eq(returns.iter().copied()));
    assert_eq!(returns, [500.0; 100]);
    bencher.bench_local(run);
}

/// configs/smoke.json, without files: 2000 steps, 1801 updates, 5 evaluations.
#[divan::bench]
fn train_smoke(bencher: Bencher) {
    let config =
        Config::from_layers(Some(("smoke.json", include_str!("../configs/smoke.json"))), &[]).unwrap();
    let run = || {
        let mut trainer = config.make_trainer().unwrap();
        let reason = trainer.run(&mut Vec::<Event>::new(), &AtomicBool::new(false)).unwrap();
        trainer.summary(reason, 0.0).weights_sha256
    };
    assert_eq!(run(), include_str!("../tests/data/smoke_weights.sha256").trim());
    bencher.bench_local(run);
}
