//! Temporal-difference targets and the gradient of the loss by the Q-values: pure functions over one batch.

use nalgebra::DMatrix;

use crate::nn::{Float, Loss};

/// Deep Q-learning's targets (Mnih et al. 2015, algorithm 1): y = r + γ max_a Q(s′, a), and y = r where s′ is
/// terminal. With n steps (Sutton 1988) r is their discounted sum, s′ what follows them, and `discounts` is γᵏ for a
/// sample of k steps. `next_q` is (batch, actions), the rest (batch).
pub fn targets<T: Float>(
    discounts: &[T], rewards: &[T], terminated: &[bool], next_q: &DMatrix<T>, targets: &mut [T],
) {
    let (first, others) = next_q.as_slice().split_at(targets.len());
    targets.copy_from_slice(first);
    for action_values in others.chunks_exact(targets.len()) {
        for (largest, &value) in targets.iter_mut().zip(action_values) {
            *largest = if value > *largest { value } else { *largest };
        }
    }
    bootstrap(discounts, rewards, terminated, targets);
}

/// Double Q-learning's targets (van Hasselt, Guez and Silver 2016, eq. 4): the online network chooses the next
/// action, the target network values it: y = r + γ Q_target(s′, argmax_a Q_online(s′, a)).
pub fn double_targets<T: Float>(
    discounts: &[T], rewards: &[T], terminated: &[bool], next_q_online: &DMatrix<T>,
    next_q_target: &DMatrix<T>, targets: &mut [T],
) {
    for (sample, target) in targets.iter_mut().enumerate() {
        *target = next_q_target[(sample, super::argmax(next_q_online, sample))];
    }
    bootstrap(discounts, rewards, terminated, targets);
}

/// From the next observations' values to targets, in place.
fn bootstrap<T: Float>(discounts: &[T], rewards: &[T], terminated: &[bool], targets: &mut [T]) {
    for (sample, target) in targets.iter_mut().enumerate() {
        let (discount, reward) = (discounts[sample], rewards[sample]);
        *target = if terminated[sample] { reward } else { discount * *target + reward };
    }
}

/// The loss of the TD errors δ = Q(s, a) − y, averaged over the batch, and its gradient by every Q-value, which
/// is 0 for the actions not taken. `q` and `q_gradient` are (batch, actions), the rest (batch).
pub fn loss<T: Float>(
    loss: Loss, q: &DMatrix<T>, actions: &[u8], targets: &[T], q_gradient: &mut DMatrix<T>,
) -> T {
    let batch = targets.len();
    let scale = T::ONE / T::from_f64(batch as f64);
    let (q, q_gradient) = (q.as_slice(), q_gradient.as_mut_slice());
    let mut sum = T::ZERO;
    q_gradient.fill(T::ZERO);
    for (sample, (&action, &target)) in actions.iter().zip(targets).enumerate() {
        let taken = usize::from(action) * batch + sample;
        let td_error = q[taken] - target;
        sum += loss.value(td_error);
        q_gradient[taken] = loss.derivative(td_error) * scale;
    }
    sum * scale
}
