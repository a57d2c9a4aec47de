//! Temporal-difference targets and the gradient of the loss by the Q-values: pure functions over one batch.

use nalgebra::DMatrix;

use super::argmax;
use crate::nn::{Float, Loss};

/// Deep Q-learning's targets (Mnih et al. 2015, algorithm 1): y = r + γ max_a Q(s′, a), and y = r where s′ is
/// terminal. `next_q` is (batch, actions), the rest (batch).
pub fn targets<T: Float>(
    gamma: T,
    rewards: &[T],
    terminated: &[bool],
    next_q: &DMatrix<T>,
    targets: &mut [T],
) {
    double_targets(gamma, rewards, terminated, next_q, next_q, targets);
}

/// Double Q-learning's targets (van Hasselt, Guez and Silver 2016, eq. 4): the online network chooses the next
/// action, the target network values it: y = r + γ Q_target(s′, argmax_a Q_online(s′, a)).
pub fn double_targets<T: Float>(
    gamma: T,
    rewards: &[T],
    terminated: &[bool],
    next_q_online: &DMatrix<T>,
    next_q_target: &DMatrix<T>,
    targets: &mut [T],
) {
    for (sample, target) in targets.iter_mut().enumerate() {
        let next_value = next_q_target[(sample, argmax(next_q_online, sample))];
        *target =
            if terminated[sample] { rewards[sample] } else { gamma.mul_add(next_value, rewards[sample]) };
    }
}

/// The loss of the TD errors δ = Q(s, a) − y, averaged over the batch, and its gradient by every Q-value, which
/// is 0 for the actions not taken. `q` and `q_gradient` are (batch, actions), the rest (batch).
pub fn loss<T: Float>(
    loss: Loss,
    q: &DMatrix<T>,
    actions: &[u8],
    targets: &[T],
    q_gradient: &mut DMatrix<T>,
) -> T {
    let scale = T::ONE / T::from_f64(targets.len() as f64);
    let mut sum = T::ZERO;
    q_gradient.fill(T::ZERO);
    for (sample, (&action, &target)) in actions.iter().zip(targets).enumerate() {
        let td_error = q[(sample, usize::from(action))] - target;
        sum += loss.value(td_error);
        q_gradient[(sample, usize::from(action))] = loss.derivative(td_error) * scale;
    }
    sum * scale
}
