//! The fast kernels against the naive reference, bit for bit, where they run: in Node and in browsers.

use cartpole_dqn::nn::kernels::{
    AdamCoefficients, InstructionSet, fast, mul_add_in_f64, reference, scratch_len,
};
use cartpole_dqn::rng::Rng;
use nalgebra::DMatrix;

/// Mostly ordinary numbers; zeros of both signs, numbers of few bits, whose sums are often halfway between two f32, and
/// numbers whose products are subnormal.
fn number(rng: &mut Rng) -> f32 {
    let few_bits = rng.uniform(-4096.0, 4096.0).trunc();
    match rng.below(12) {
        0 => 0.0,
        1 => -0.0,
        2..=4 => (few_bits / 1024.0) as f32,
        5 => (few_bits * 1e-20) as f32,
        6 => (few_bits * 8192.0) as f32,
        _ => rng.uniform(-2.0, 2.0) as f32,
    }
}

fn matrix(rng: &mut Rng, rows: usize, columns: usize) -> DMatrix<f32> {
    DMatrix::from_fn(rows, columns, |_, _| number(rng))
}

fn differing(ours: &[f32], expected: &[f32]) -> u32 {
    let differs = |(a, b): &(&f32, &f32)| a.to_bits() != b.to_bits() && !(a.is_nan() && b.is_nan());
    ours.iter().zip(expected).filter(differs).count() as u32
}

/// See [`super::differing_numbers`].
pub fn differing_numbers(seed: u32) -> u32 {
    let rng = &mut Rng::from_seed(seed.into());
    let [batch, inputs, outputs] = std::array::from_fn(|_| 1 + rng.below(70) as usize);
    let (x, dy) = (matrix(rng, batch, inputs), matrix(rng, batch, outputs));
    let layer: Vec<f32> = (0..(inputs + 1) * outputs).map(|_| number(rng)).collect();
    let scratch = &mut vec![f32::NAN; scratch_len(batch, inputs.max(outputs))];
    let mut count = 0;
    for set in InstructionSet::available() {
        let (mut ours, mut expected) = (dy.clone(), dy.clone());
        fast::affine(set, &x, &layer, seed.is_multiple_of(2), scratch, &mut ours);
        reference::affine(&x, &layer, seed.is_multiple_of(2), &mut expected);
        count += differing(ours.as_slice(), expected.as_slice());

        let (mut ours, mut expected) = (x.clone(), x.clone());
        fast::input_gradient(set, &dy, &layer, &x, scratch, &mut ours);
        reference::input_gradient(&dy, &layer, &x, &mut expected);
        count += differing(ours.as_slice(), expected.as_slice());

        let (mut ours, mut expected) = (layer.clone(), layer.clone());
        fast::layer_gradient(set, &dy, &x, scratch, &mut ours);
        reference::layer_gradient(&dy, &x, &mut expected);
        count += differing(&ours, &expected);
        count += differing_adam(set, rng, &layer) + differing_soft_update(set, &layer);
    }
    for _ in 0..100 {
        let [x, y, z] = std::array::from_fn(|_| number(rng));
        count += differing(&[mul_add_in_f64(x, y, z)], &[x.mul_add(y, z)]);
    }
    count
}

fn differing_adam(set: InstructionSet, rng: &mut Rng, parameters: &[f32]) -> u32 {
    let coefficients = AdamCoefficients {
        beta1: 0.9_f32,
        one_minus_beta1: 0.1,
        beta2: 0.999,
        one_minus_beta2: 0.001,
        step_size: 0.01,
        second_moment_scale: 1.5,
        epsilon: 1e-8,
    };
    let gradient: Vec<f32> = parameters.iter().map(|_| number(rng)).collect();
    let moments: Vec<f32> = parameters.iter().map(|_| number(rng).abs()).collect();
    let [mut ours, mut expected] =
        std::array::from_fn(|_| [parameters.to_vec(), moments.clone(), moments.clone()]);
    let [p, m, v] = &mut ours;
    fast::adam(set, &coefficients, p, &gradient, m, v);
    let [p, m, v] = &mut expected;
    reference::adam(&coefficients, p, &gradient, m, v);
    ours.iter().zip(&expected).map(|(ours, expected)| differing(ours, expected)).sum()
}

fn differing_soft_update(set: InstructionSet, online: &[f32]) -> u32 {
    let target: Vec<f32> = online.iter().rev().copied().collect();
    let (mut ours, mut expected) = (target.clone(), target);
    fast::soft_update(set, 0.02, online, &mut ours);
    reference::soft_update(0.02, online, &mut expected);
    differing(&ours, &expected)
}
