//! The DQN update against PyTorch's, and the gradients against finite differences.

use cartpole_dqn::agent::td;
use cartpole_dqn::nn::{Activations, Adam, Kernels, Loss, Mlp, OptimizerConfig};
use nalgebra::DMatrix;
use serde_json::Value;

use crate::{golden, members, numbers};

/// A network from the tensors of a `state_dict`.
fn network<T: Kernels>(sizes: &[usize], tensors: &Value) -> Mlp<T> {
    let mut network = Mlp::zeros(sizes.to_vec());
    for layer in 0..network.num_layers() {
        let (inputs, outputs) = (sizes[layer], sizes[layer + 1]);
        let weight = numbers(&tensors[format!("{}.weight", 2 * layer)]);
        let bias = numbers(&tensors[format!("{}.bias", 2 * layer)]);
        let ours = network.layer_mut(layer);
        for output in 0..outputs {
            for input in 0..inputs {
                ours[input * outputs + output] = T::from_f64(weight[output * inputs + input]);
            }
            ours[inputs * outputs + output] = T::from_f64(bias[output]);
        }
    }
    network
}

fn matrix<T: Kernels>(batch: usize, rows: &Value) -> DMatrix<T> {
    let values: Vec<T> = numbers(rows).into_iter().map(T::from_f64).collect();
    DMatrix::from_row_slice(batch, values.len() / batch, &values)
}

fn assert_close<T: Kernels + Into<f64>>(ours: &[T], theirs: &[T], tolerance: f64, what: &str) {
    assert_eq!(ours.len(), theirs.len(), "{what}");
    for (index, (&ours, &theirs)) in ours.iter().zip(theirs).enumerate() {
        let (ours, theirs): (f64, f64) = (ours.into(), theirs.into());
        let error = (ours - theirs).abs();
        assert!(error <= tolerance * theirs.abs().max(1.0), "{what}[{index}]: {ours} for {theirs}");
    }
}

/// Follows every recorded update with the calls that `Dqn::learn` makes.
fn follow<T: Kernels + Into<f64>>(tolerance: f64) {
    let recording = golden("torch_dqn_update.json");
    for case in members(&recording["cases"]) {
        let name = format!("{} {} double={}", case["sizes"], case["loss"], case["double"]);
        let sizes: Vec<usize> = numbers(&case["sizes"]).iter().map(|&size| size as usize).collect();
        let number = |key: &str| case[key].as_f64().unwrap();
        let batch = number("batch") as usize;
        let loss_kind: Loss = serde_json::from_value(case["loss"].clone()).unwrap();
        let mut online: Mlp<T> = network(&sizes, &case["online"]);
        let target: Mlp<T> = network(&sizes, &case["target"]);
        let mut gradient = Mlp::zeros(sizes.clone());
        let config = OptimizerConfig {
            learning_rate: number("learning_rate"),
            beta1: number("beta1"),
            beta2: number("beta2"),
            epsilon: number("epsilon"),
            max_gradient_norm: None,
            schedule: None,
        };
        let mut adam = Adam::new(config, online.parameters().len());
        let mut online_activations = Activations::new(&sizes, batch);
        let mut target_activations = Activations::new(&sizes, batch);
        for step in members(&case["steps"]) {
            let rewards: Vec<T> = numbers(&step["rewards"]).into_iter().map(T::from_f64).collect();
            let terminated: Vec<bool> = serde_json::from_value(step["terminated"].clone()).unwrap();
            let actions: Vec<u8> = serde_json::from_value(step["actions"].clone()).unwrap();
            let discounts = vec![T::from_f64(number("gamma")); batch];
            let mut targets = vec![T::ZERO; batch];

            target_activations.input_mut().copy_from(&matrix(batch, &step["next_states"]));
            target.forward(&mut target_activations);
            let next_q = target_activations.output();
            if case["double"].as_bool().unwrap() {
                online_activations.input_mut().copy_from(&matrix(batch, &step["next_states"]));
                online.forward(&mut online_activations);
                let next_q_online = online_activations.output();
                td::double_targets(&discounts, &rewards, &terminated, next_q_online, next_q, &mut targets);
            } else {
                td::targets(&discounts, &rewards, &terminated, next_q, &mut targets);
            }
            let expected: Vec<T> = numbers(&step["targets"]).into_iter().map(T::from_f64).collect();
            assert_close(&targets, &expected, tolerance, &format!("{name}: targets"));

            online_activations.input_mut().copy_from(&matrix(batch, &step["states"]));
            online.forward(&mut online_activations);
            let (q, q_gradient) = online_activations.output_and_gradient_mut();
            let loss = td::loss(loss_kind, q, &actions, &targets, q_gradient);
            assert_close(
                &[loss],
                &[T::from_f64(step["loss"].as_f64().unwrap())],
                tolerance,
                &format!("{name}: loss"),
            );

            online.backward(&mut online_activations, &mut gradient);
            let expected: Mlp<T> = network(&sizes, &step["gradients"]);
            assert_close(
                gradient.parameters(),
                expected.parameters(),
                tolerance,
                &format!("{name}: gradients"),
            );

            assert!(adam.step(online.parameters_mut(), gradient.parameters()));
            let expected: Mlp<T> = network(&sizes, &step["online_after"]);
            assert_close(online.parameters(), expected.parameters(), tolerance, &format!("{name}: weights"));
        }
    }
}

#[test]
fn golden_torch_update_in_f64() {
    follow::<f64>(1e-10);
}

#[test]
fn golden_torch_update_in_f32() {
    follow::<f32>(2e-5);
}

/// Central differences of the loss by every parameter, for both losses and networks of several depths.
#[test]
fn gradients_agree_with_finite_differences() {
    let mut rng = cartpole_dqn::rng::Rng::from_seed(3);
    for sizes in [vec![3, 2], vec![4, 5, 3], vec![2, 7, 6, 2]] {
        for loss_kind in [Loss::Mse, Loss::Huber] {
            let batch = 9;
            let mut network: Mlp<f64> = Mlp::zeros(sizes.clone());
            network.parameters_mut().fill_with(|| rng.uniform(-1.0, 1.0));
            let input = DMatrix::from_fn(batch, sizes[0], |_, _| rng.uniform(-2.0, 2.0));
            let num_actions = *sizes.last().unwrap() as u64;
            let actions: Vec<u8> = (0..batch).map(|_| rng.below(num_actions) as u8).collect();
            let targets: Vec<f64> = (0..batch).map(|_| rng.uniform(-3.0, 3.0)).collect();
            let mut activations = Activations::new(&sizes, batch);
            activations.input_mut().copy_from(&input);
            let mut loss = |network: &Mlp<f64>| {
                network.forward(&mut activations);
                let (q, q_gradient) = activations.output_and_gradient_mut();
                let loss = td::loss(loss_kind, q, &actions, &targets, q_gradient);
                let mut gradient = Mlp::zeros(sizes.clone());
                network.backward(&mut activations, &mut gradient);
                (loss, gradient)
            };
            let (_, gradient) = loss(&network);
            for index in 0..network.parameters().len() {
                let value = network.parameters()[index];
                let mut at = |value: f64| {
                    network.parameters_mut()[index] = value;
                    loss(&network).0
                };
                let difference = (at(value + 1e-6) - at(value - 1e-6)) / 2e-6;
                at(value);
                let error = (gradient.parameters()[index] - difference).abs();
                assert!(error < 1e-6, "{sizes:?} {loss_kind:?} parameter {index}: off by {error}");
            }
        }
    }
}
