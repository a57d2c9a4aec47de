//! The fast kernels against the naive reference, bit for bit, on every instruction set that this CPU has.

use std::cmp::Ordering;

use cartpole_dqn::nn::kernels::{
    AdamCoefficients, InstructionSet, Kernels, fast, mul_add_in_f64, reference, scratch_len,
};
use cartpole_dqn::rng::Rng;
use nalgebra::DMatrix;

/// Mostly ordinary numbers, some zeros of both signs.
fn number(rng: &mut Rng) -> f32 {
    match rng.below(12) {
        0 => 0.0,
        1 => -0.0,
        _ => rng.uniform(-2.0, 2.0) as f32,
    }
}

fn matrix(rng: &mut Rng, rows: usize, columns: usize) -> DMatrix<f32> {
    DMatrix::from_fn(rows, columns, |_, _| number(rng))
}

fn assert_same_bits(ours: &[f32], reference: &[f32], what: &str) {
    for (index, (ours, reference)) in ours.iter().zip(reference).enumerate() {
        let same = ours.to_bits() == reference.to_bits() || (ours.is_nan() && reference.is_nan());
        assert!(same, "{what}: element {index} is {ours:e}, the reference says {reference:e}");
    }
}

/// Compares the three products of one layer. The outputs start as NaN, so that a number that is not written is found.
/// `spoil` is put into x, and its negative into the layer.
fn compare(batch: usize, inputs: usize, outputs: usize, rng: &mut Rng, spoil: Option<f32>) {
    let nan = |rows, columns| DMatrix::from_element(rows, columns, f32::NAN);
    let mut x = matrix(rng, batch, inputs);
    let mut layer: Vec<f32> = (0..(inputs + 1) * outputs).map(|_| number(rng)).collect();
    let dy = matrix(rng, batch, outputs);
    if let Some(value) = spoil {
        x[(batch / 2, inputs / 2)] = value;
        layer[outputs / 2] = -value;
    }
    let scratch = &mut vec![f32::NAN; scratch_len(batch, inputs.max(outputs))];
    for set in InstructionSet::available() {
        let name = set.name();
        let what = format!("{name}, batch {batch}, {inputs} -> {outputs}");
        for relu in [false, true] {
            let (mut ours, mut expected) = (nan(batch, outputs), nan(batch, outputs));
            fast::affine(set, &x, &layer, relu, scratch, &mut ours);
            reference::affine(&x, &layer, relu, &mut expected);
            assert_same_bits(ours.as_slice(), expected.as_slice(), &format!("affine, {what}"));
        }
        let (mut ours, mut expected) = (nan(batch, inputs), nan(batch, inputs));
        fast::input_gradient(set, &dy, &layer, &x, scratch, &mut ours);
        reference::input_gradient(&dy, &layer, &x, &mut expected);
        assert_same_bits(ours.as_slice(), expected.as_slice(), &format!("input_gradient, {what}"));

        let (mut ours, mut expected) = (vec![f32::NAN; layer.len()], vec![f32::NAN; layer.len()]);
        fast::layer_gradient(set, &dy, &x, scratch, &mut ours);
        reference::layer_gradient(&dy, &x, &mut expected);
        assert_same_bits(&ours, &expected, &format!("layer_gradient, {what}"));
    }
}

#[test]
fn every_small_size_has_the_references_bits() {
    let mut rng = Rng::from_seed(7);
    for size in 1..=40 {
        for other in 1..=40 {
            compare(size, other, 1 + (size * 7 + other * 3) % 40, &mut rng, None);
        }
    }
}

#[test]
fn every_number_of_outputs_has_the_references_bits() {
    let mut rng = Rng::from_seed(8);
    for outputs in 1..=40 {
        for batch in [1, 2, 7, 8, 9, 16, 31, 32, 33, 40] {
            compare(batch, 1 + (outputs * 5) % 13, outputs, &mut rng, None);
        }
    }
}

#[test]
fn odd_large_sizes_have_the_references_bits() {
    let mut rng = Rng::from_seed(9);
    for (batch, inputs, outputs) in
        [(1, 129, 67), (67, 65, 257), (128, 120, 84), (64, 256, 256), (100, 48, 48), (257, 3, 131)]
    {
        compare(batch, inputs, outputs, &mut rng, None);
    }
}

#[test]
fn nan_and_infinity_go_where_the_reference_lets_them() {
    let mut rng = Rng::from_seed(10);
    for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MIN_POSITIVE / 4.0] {
        for batch in [1, 5, 8, 32] {
            compare(batch, 9, 11, &mut rng, Some(value));
        }
    }
}

#[test]
fn soft_updates_have_the_references_bits() {
    let mut rng = Rng::from_seed(12);
    for len in (1..=40).chain([770, 1001]) {
        let [online, target] =
            std::array::from_fn(|_| (0..len).map(|_| number(&mut rng)).collect::<Vec<_>>());
        for tau in [0.005, 0.3, 1.0] {
            let mut expected = target.clone();
            reference::soft_update(tau, &online, &mut expected);
            for set in InstructionSet::available() {
                let mut ours = target.clone();
                fast::soft_update(set, tau, &online, &mut ours);
                assert_same_bits(&ours, &expected, &format!("soft update, {}, {len} parameters", set.name()));
            }
        }
    }
}

/// The coefficients halve both moments, because the gradient is 0. Without the flush they would become subnormal.
#[test]
fn moments_that_would_become_subnormal_become_zero_on_every_instruction_set() {
    let coefficients = AdamCoefficients {
        beta1: 0.5_f32,
        one_minus_beta1: 0.5,
        beta2: 0.5,
        one_minus_beta2: 0.5,
        step_size: 0.01,
        second_moment_scale: 1.0,
        epsilon: 1e-8,
    };
    let start = [f32::MIN_POSITIVE * 2.0, f32::MIN_POSITIVE * 1.5, -f32::MIN_POSITIVE, 1.0];
    let expected = [f32::MIN_POSITIVE, 0.0, 0.0, 0.5];
    for len in [1, 4, 7, 8, 16, 19] {
        let gradient = vec![0.0; len];
        let first: Vec<f32> = (0..len).map(|index| start[index % 4]).collect();
        let second: Vec<f32> = first.iter().map(|value| value.abs()).collect();
        let check = |m: &[f32], v: &[f32], what: &str| {
            for index in 0..len {
                assert_eq!(m[index].to_bits(), expected[index % 4].to_bits(), "{what}");
                assert_eq!(v[index].to_bits(), expected[index % 4].to_bits(), "{what}");
            }
        };
        let [mut p, mut m, mut v] = [vec![1.0; len], first.clone(), second.clone()];
        reference::adam(&coefficients, &mut p, &gradient, &mut m, &mut v);
        check(&m, &v, "reference");
        for set in InstructionSet::available() {
            let [mut p, mut m, mut v] = [vec![1.0; len], first.clone(), second.clone()];
            fast::adam(set, &coefficients, &mut p, &gradient, &mut m, &mut v);
            check(&m, &v, set.name());
        }
    }
}

#[test]
fn adam_has_the_references_bits() {
    let mut rng = Rng::from_seed(11);
    let coefficients = AdamCoefficients {
        beta1: 0.9_f32,
        one_minus_beta1: 0.1,
        beta2: 0.999,
        one_minus_beta2: 0.001,
        step_size: 0.01,
        second_moment_scale: 3.0,
        epsilon: 1e-8,
    };
    for len in (1..=40).chain([770, 1001]) {
        let [parameters, gradient, first] =
            std::array::from_fn(|_| (0..len).map(|_| number(&mut rng)).collect::<Vec<_>>());
        let second: Vec<f32> = (0..len).map(|_| number(&mut rng).abs()).collect();
        let mut expected = [parameters.clone(), first.clone(), second.clone()];
        let [p, m, v] = &mut expected;
        assert!(reference::adam(&coefficients, p, &gradient, m, v));
        for set in InstructionSet::available() {
            let mut ours = [parameters.clone(), first.clone(), second.clone()];
            let [p, m, v] = &mut ours;
            assert!(fast::adam(set, &coefficients, p, &gradient, m, v));
            for (ours, expected) in ours.iter().zip(&expected) {
                assert_same_bits(ours, expected, &format!("adam, {}, {len} parameters", set.name()));
            }
            for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
                let mut gradient = gradient.clone();
                gradient[len - 1] = bad;
                let [mut p, mut m, mut v] = [parameters.clone(), first.clone(), second.clone()];
                let finite = fast::adam(set, &coefficients, &mut p, &gradient, &mut m, &mut v);
                assert!(!finite, "{} overlooked the gradient {bad}", set.name());
            }
        }
    }
}

/// 2⁶³ · 2 is 0 in 64 bits, the length of an empty layer.
#[test]
#[should_panic(expected = "fits_layer")]
fn refuses_a_layer_whose_length_overflows() {
    let (x, dy) = (DMatrix::zeros(0, usize::MAX / 2), DMatrix::zeros(0, 2));
    let scratch = &mut vec![0.0; scratch_len(0, 2)];
    fast::input_gradient(InstructionSet::SCALAR, &dy, &[], &x, scratch, &mut x.clone());
}

/// The reference's multiply-add: a layer of one weight and its bias.
fn fused<T: Kernels>(x: T, y: T, z: T) -> T {
    let mut sum = DMatrix::from_element(1, 1, z);
    reference::affine(&DMatrix::from_element(1, 1, x), &[y, z], false, &mut sum);
    sum[(0, 0)]
}

/// In integers: m · 2ᵉ where m has at most `bits` bits, rounded to the even one of two that are equally near.
fn rounded(m: i128, bits: u32) -> i128 {
    let dropped = (128 - m.unsigned_abs().leading_zeros()).saturating_sub(bits);
    let (unit, below) = (1 << dropped, m.rem_euclid(1 << dropped));
    let floor = m - below;
    match (2 * below).cmp(&unit) {
        Ordering::Less => floor,
        Ordering::Equal if (floor >> dropped) % 2 == 0 => floor,
        _ => floor + unit,
    }
}

/// On every target, whatever its C library does: sums of integers that are too long for the float, many of them halfway between
/// two floats.
#[test]
fn the_references_multiply_add_rounds_once() {
    let mut rng = Rng::from_seed(14);
    let mut rounded_twice_differ = [0, 0];
    for _ in 0..1_000_000 {
        let mut whole = |most: u64| {
            let bits = 1 + rng.below(most);
            rng.below(1 << bits) as i128 * if rng.below(2) == 0 { -1 } else { 1 }
        };
        let [x, y, z] = [whole(24), whole(24), whole(24) << (whole(6).unsigned_abs() % 50)];
        let expected = rounded(x * y + z, 24);
        assert_eq!(fused(x as f32, y as f32, z as f32) as i128, expected, "{x} · {y} + {z} in f32");
        rounded_twice_differ[0] += u32::from((x as f32 * y as f32 + z as f32) as i128 != expected);

        let [x, y, z] = [whole(53), whole(53), whole(53) << (whole(6).unsigned_abs() % 60)];
        let expected = rounded(x * y + z, 53);
        assert_eq!(fused(x as f64, y as f64, z as f64) as i128, expected, "{x} · {y} + {z} in f64");
        rounded_twice_differ[1] += u32::from((x as f64 * y as f64 + z as f64) as i128 != expected);
    }
    assert!(rounded_twice_differ.iter().all(|&count| count > 1000), "{rounded_twice_differ:?}");
}

/// Numbers of few bits, whose sums are often halfway between two f32.
#[test]
fn a_multiply_add_in_f64_has_the_bits_of_the_fused_one() {
    let mut rng = Rng::from_seed(13);
    let mut rounded_twice_differ = 0;
    let mut check = |x: f32, y: f32, z: f32| {
        let expected = fused(x, y, z);
        // The C library of Linux and of macOS, or the instruction.
        let system = if cfg!(windows) { expected } else { x.mul_add(y, z) };
        for ours in [mul_add_in_f64(x, y, z), system] {
            assert_eq!(
                ours.to_bits(),
                expected.to_bits(),
                "{x:e} · {y:e} + {z:e}: {ours:e}, expected {expected:e}"
            );
        }
        rounded_twice_differ += u32::from((f64::from(x) * f64::from(y) + f64::from(z)) as f32 != expected);
    };
    for _ in 0..1_000_000 {
        let [x, y, z] = std::array::from_fn(|_| {
            let bits = [6, 12, 13, 24][rng.below(4) as usize];
            let mantissa = rng.below(1 << bits) as f64 * if rng.below(2) == 0 { -1.0 } else { 1.0 };
            (mantissa * 2.0_f64.powi(rng.below(60) as i32 - 30)) as f32
        });
        check(x, y, z);
    }
    // A subnormal z, and a product that is a little less than half of its last place: (2ⁿ + 1) (2ⁿ − 1) < 2²ⁿ.
    for n in 16..=23 {
        for _ in 0..100 {
            let z = f32::from_bits((1 << 21) + rng.below(6 << 20) as u32);
            let (more, less) = ((1 << n) as f32 + 1.0, (1 << n) as f32 - 1.0);
            check(more * 2.0_f32.powi(-90), less * 2.0_f32.powi(-60 - 2 * n), z);
            check(-more * 2.0_f32.powi(-90), less * 2.0_f32.powi(-60 - 2 * n), z);
        }
    }
    for special in [f32::NAN, f32::INFINITY, f32::MAX, -0.0, f32::MIN_POSITIVE] {
        let bits = (mul_add_in_f64(special, -2.0, 1.0), fused(special, -2.0, 1.0));
        assert!(bits.0.to_bits() == bits.1.to_bits() || (bits.0.is_nan() && bits.1.is_nan()), "{bits:?}");
    }
    assert!(rounded_twice_differ > 1000, "{rounded_twice_differ} sums would be wrong if rounded twice");
}
