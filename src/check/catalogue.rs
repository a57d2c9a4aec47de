//! The known mistakes. One more is an entry here, and where no field of [`Variant`] can say it, a branch beside the
//! equation in reference.rs.

use super::reference::{
    Bootstrap, Clipping, Decay, Mask, Optimizer, Penalty, Predicted, Reached, Reduction, Reward, Variant,
};
use crate::nn::Loss;

/// The quantities of an update, in the order in which they are computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, serde::Serialize)]
#[serde(rename_all = "snake_case")]
#[allow(missing_docs)]
pub enum Stage {
    Targets,
    Loss,
    Gradients,
    Weights,
}

impl Stage {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Targets, Self::Loss, Self::Gradients, Self::Weights];

    /// As it is written.
    pub fn name(self) -> &'static str {
        match self {
            Self::Targets => "targets",
            Self::Loss => "loss",
            Self::Gradients => "gradients",
            Self::Weights => "weights",
        }
    }
}

/// A mistake that people make.
#[derive(Debug)]
pub struct Mistake {
    /// Its name for programs.
    pub id: &'static str,
    /// The first quantity that it changes.
    pub stage: Stage,
    /// What they compute, and what is right.
    pub what: &'static str,
    /// Why it matters.
    pub why: &'static str,
    /// How to mend it in PyTorch, Keras or JAX.
    pub mend: &'static str,
    /// Makes it; leaves a variant alone that cannot have it.
    pub make: fn(&mut Variant),
}

impl Mistake {
    /// Its name for people.
    pub fn name(&self) -> String {
        self.id.replace('_', " ")
    }

    /// A variant with this mistake as well.
    pub fn on(&self, variant: &Variant) -> Variant {
        let mut with = *variant;
        (self.make)(&mut with);
        with
    }
}

const HUBER: Penalty = Penalty::Known(Loss::Huber);
const MSE: Penalty = Penalty::Known(Loss::Mse);

#[rustfmt::skip]
#[allow(missing_docs)]
pub static CATALOGUE: &[Mistake] = &[
    // y = r + γ (1 − d) max_a Q⁻(s′, a)
    Mistake {
        id: "terminal_bootstrapped", stage: Stage::Targets,
        what: "terminal states are bootstrapped: y = r + γ max Q⁻(s′, ·) also where the episode terminated; right is y = r",
        why: "the value of falling becomes that of a state to go on from, and values grow without end",
        mend: "multiply the next value by (1 - terminated), as float: y = r + gamma * (1 - terminated) * next_q",
        make: |v| v.mask = Mask::Nowhere,
    },
    Mistake {
        id: "truncation_not_bootstrapped", stage: Stage::Targets,
        what: "truncated episodes are not bootstrapped: y = r at the time limit; right is y = r + γ max Q⁻(s′, ·)",
        why: "a time limit is not the task's end; good states get the value of bad ones, and nothing in s tells why",
        mend: "store `terminated` of env.step, not `terminated or truncated`, and s' before the reset (vector environments: final_observation)",
        make: |v| v.mask = Mask::TerminatedOrTruncated,
    },
    Mistake {
        id: "mask_inverted", stage: Stage::Targets,
        what: "the mask is inverted: only terminal states are bootstrapped",
        why: "every other target is the reward alone, so nothing is learned about what follows",
        mend: "the factor of the next value is (1 - terminated), not terminated",
        make: |v| v.mask = Mask::NotTerminated,
    },
    Mistake {
        id: "terminal_reward_lost", stage: Stage::Targets,
        what: "the whole target is masked: y = 0 where the episode terminated; right is y = r",
        why: "the reward of the last step, often the one that matters, is never learned",
        mend: "mask the next value only: r + gamma * (1 - terminated) * next_q, not (1 - terminated) * (r + gamma * next_q)",
        make: |v| v.reward_is_masked = true,
    },
    Mistake {
        id: "bootstrap_from_online", stage: Stage::Targets,
        what: "the online network values s′ in place of the target network",
        why: "the targets move with every step, which is what the target network is there to prevent",
        mend: "next_q = target_net(next_obs), not q_net(next_obs); in Keras target_model(next_obs), in JAX apply(target_params, next_obs)",
        make: |v| v.from_online = v.bootstrap != Bootstrap::DoubleExchanged,
    },
    Mistake {
        id: "double_exchanged", stage: Stage::Targets,
        what: "double Q-learning with the roles exchanged: the target network chooses, the online network values",
        why: "the target's stale choice is valued by the network that moves with every step",
        mend: "a = q_net(next_obs).argmax(1); next_q = target_net(next_obs).gather(1, a[:, None])",
        make: |v| if v.bootstrap == Bootstrap::Double { v.bootstrap = Bootstrap::DoubleExchanged },
    },
    Mistake {
        id: "double_left_out", stage: Stage::Targets,
        what: "the target is max Q⁻(s′, ·), though the settings say double Q-learning",
        why: "the maximum over noisy estimates is too large on average",
        mend: "let the online network choose: a = q_net(next_obs).argmax(1); next_q = target_net(next_obs).gather(1, a[:, None])",
        make: |v| if v.bootstrap == Bootstrap::Double { v.bootstrap = Bootstrap::Max },
    },
    Mistake {
        id: "double_unasked", stage: Stage::Targets,
        what: "the targets are those of double Q-learning, though the settings do not say so",
        why: "it is another algorithm, if a good one",
        mend: "say \"double\": true in the settings if it is meant; else next_q = target_net(next_obs).max(1).values",
        make: |v| if v.bootstrap == Bootstrap::Max { v.bootstrap = Bootstrap::Double },
    },
    Mistake {
        id: "current_observation", stage: Stage::Targets,
        what: "the maximum is over the current observation: y = r + γ max Q⁻(s, ·); right is Q⁻(s′, ·)",
        why: "a state is valued by itself; what an action leads to is never looked at",
        mend: "feed next_obs, not obs, to the target network; look at the order in which the replay memory returns them",
        make: |v| v.from_current = true,
    },
    Mistake {
        id: "next_value_of_taken_action", stage: Stage::Targets,
        what: "the next value is Q⁻(s′, a) of the action taken in s; right is the maximum over actions",
        why: "it is the value of repeating an action, not of acting well",
        mend: "target_net(next_obs).max(1).values, not .gather(1, actions); in JAX and Keras max(axis=1)",
        make: |v| v.bootstrap = Bootstrap::Taken,
    },
    Mistake {
        id: "next_value_mean", stage: Stage::Targets,
        what: "the next value is the mean over actions; right is the maximum",
        why: "it is the value of acting at random",
        mend: "max over the axis of actions: .max(1).values in PyTorch, max(axis=1) in Keras and JAX",
        make: |v| v.bootstrap = Bootstrap::Mean,
    },
    Mistake {
        id: "next_value_minimum", stage: Stage::Targets,
        what: "the next value is the minimum over actions; right is the maximum",
        why: "it is the value of acting as badly as possible",
        mend: "max over the axis of actions: .max(1).values in PyTorch, max(axis=1) in Keras and JAX",
        make: |v| v.bootstrap = Bootstrap::Min,
    },
    Mistake {
        id: "index_in_place_of_value", stage: Stage::Targets,
        what: "the next value is the number of the best action; right is its Q-value",
        why: "the targets do not depend on what was learned",
        mend: ".max(1) returns (values, indices) in PyTorch: take [0] or .values; in Keras and JAX max, not argmax",
        make: |v| v.bootstrap = Bootstrap::Index,
    },
    Mistake {
        id: "maximum_of_batch", stage: Stage::Targets,
        what: "the next value is the largest of the whole batch; right is the largest of each sample",
        why: "every state gets the value of the best one",
        mend: "give the axis of actions: .max(1).values in PyTorch, max(axis=1) in Keras and JAX",
        make: |v| v.bootstrap = Bootstrap::MaxOfBatch,
    },
    Mistake {
        id: "discount_forgotten", stage: Stage::Targets,
        what: "γ is forgotten: y = r + max Q⁻(s′, ·)",
        why: "without discount the values of a long task have no bound",
        mend: "y = r + gamma * (1 - terminated) * next_q",
        make: |v| v.discounted = 0,
    },
    Mistake {
        id: "discount_twice", stage: Stage::Targets,
        what: "γ is applied twice: y = r + γ² max Q⁻(s′, ·)",
        why: "the agent looks half as far ahead as it should",
        mend: "multiply by gamma once; look whether the replay memory or a wrapper has done so already",
        make: |v| v.discounted = 2,
    },
    Mistake {
        id: "reward_discounted", stage: Stage::Targets,
        what: "the reward is discounted as well: y = γ r + γ max Q⁻(s′, ·)",
        why: "all values are γ times what they should be; with n steps or other rewards the best action can change",
        mend: "y = r + gamma * (1 - terminated) * next_q, not gamma * (r + next_q)",
        make: |v| v.reward = Reward::Discounted,
    },
    Mistake {
        id: "reward_forgotten", stage: Stage::Targets,
        what: "the reward is forgotten: y = γ max Q⁻(s′, ·)",
        why: "nothing tells a good state from a bad one, and all values fall to 0",
        mend: "y = r + gamma * (1 - terminated) * next_q",
        make: |v| v.reward = Reward::Forgotten,
    },
    Mistake {
        id: "reward_clipped", stage: Stage::Targets,
        what: "the reward is clipped to -1…1, as for Atari games",
        why: "rewards of 1 and of 100 are worth the same",
        mend: "leave out the clipping, or put clipped rewards into batch.rewards if it is meant",
        make: |v| v.reward = Reward::Clipped,
    },

    // L = 1/B Σ ℓ(Q(s, a) − y)
    Mistake {
        id: "sum", stage: Stage::Loss,
        what: "the losses are summed; right is their mean over the batch",
        why: "gradient and clipping grow with the batch size; with SGD so does the step",
        mend: "reduction='mean' in PyTorch; tf.reduce_mean and jnp.mean, not sum",
        make: |v| v.reduction = Reduction::Sum,
    },
    Mistake {
        id: "mean_over_outputs", stage: Stage::Loss,
        what: "the mean is over all outputs, as of Keras' full target vector: divided by batch times actions",
        why: "the gradient is smaller by the number of actions; Adam hides it, clipping and ε do not",
        mend: "take the loss of Q(s, a) alone: gather in PyTorch, tf.reduce_sum(q * one_hot, 1), q[arange, a] in JAX; or multiply by the number of actions",
        make: |v| v.reduction = Reduction::MeanOverOutputs,
    },
    Mistake {
        id: "half_square", stage: Stage::Loss,
        what: "the loss is half of the square, ½ δ²; right for \"mse\" is δ²",
        why: "the gradient is half as large; Adam hides it, SGD and clipping do not",
        mend: "F.mse_loss in PyTorch and MeanSquaredError in Keras have no ½, optax.l2_loss in JAX has: use optax.squared_error",
        make: |v| if v.loss == MSE { v.is_halved = true },
    },
    Mistake {
        id: "huber_for_mse", stage: Stage::Loss,
        what: "the loss is Huber's, the settings say \"mse\"",
        why: "large errors count less",
        mend: "F.mse_loss, not F.smooth_l1_loss; or say \"loss\": \"huber\" in the settings if it is meant",
        make: |v| if v.loss == MSE { v.loss = HUBER },
    },
    Mistake {
        id: "mse_for_huber", stage: Stage::Loss,
        what: "the loss is the square, the settings say \"huber\"",
        why: "large errors count without limit",
        mend: "F.smooth_l1_loss in PyTorch, tf.keras.losses.Huber(), optax.huber_loss; or say \"loss\": \"mse\" if it is meant",
        make: |v| if v.loss == HUBER { v.loss = MSE },
    },
    Mistake {
        id: "absolute_error", stage: Stage::Loss,
        what: "the loss is the absolute error |δ|",
        why: "the values go to the median of the targets, and steps stay large near the optimum",
        mend: "F.mse_loss or F.smooth_l1_loss in PyTorch, not F.l1_loss",
        make: |v| v.loss = Penalty::Absolute,
    },
    Mistake {
        id: "every_pair", stage: Stage::Loss,
        what: "every Q(s, a) is compared with the target of every sample: shapes [B, 1] and [B] broadcast to [B, B]",
        why: "every prediction is drawn to the mean of all targets",
        mend: "give both the shape [B]: q.gather(1, a[:, None]).squeeze(1); the framework's warning about shapes is right",
        make: |v| v.predicted = Predicted::EveryPair,
    },
    Mistake {
        id: "every_output", stage: Stage::Loss,
        what: "every output is compared with the target, not that of the action taken alone",
        why: "all actions learn the same value",
        mend: "take Q(s, a) first: q.gather(1, a[:, None]).squeeze(1); q[arange(B), a] in JAX",
        make: |v| v.predicted = Predicted::EveryOutput,
    },
    Mistake {
        id: "largest_predicted", stage: Stage::Loss,
        what: "the prediction is max Q(s, ·); right is Q(s, a) of the action taken",
        why: "what an exploring action brought is credited to the greedy one",
        mend: "q.gather(1, actions[:, None]).squeeze(1), not q.max(1).values",
        make: |v| v.predicted = Predicted::Largest,
    },
    Mistake {
        id: "other_action_predicted", stage: Stage::Loss,
        what: "the prediction is Q(s, ·) of another action than the one taken: the next in order",
        why: "every action learns the value of another one",
        mend: "store the action that went into env.step; count actions from 0",
        make: |v| v.predicted = Predicted::Shifted(1),
    },

    // g = ∂L/∂Q(s, a) · ∂Q(s, a)/∂θ, then clipped
    Mistake {
        id: "gradient_through_target", stage: Stage::Gradients,
        what: "the gradient goes through the target as well: it is not detached",
        why: "the network is also pushed to make the next state fit its past (residual gradient), which learns slower and elsewhere",
        mend: "compute the target under torch.no_grad(); tf.stop_gradient(y); jax.lax.stop_gradient(y)",
        make: |v| if v.from_online { v.through_target = true },
    },
    Mistake {
        id: "gradient_of_wrong_action", stage: Stage::Gradients,
        what: "the gradient goes to another action than the one taken: the next in order",
        why: "every action learns the error of another one",
        mend: "index the gradient with the actions of the batch: dq[arange(B), actions]",
        make: |v| v.reached = Reached::Shifted(1),
    },
    Mistake {
        id: "gradient_of_all_actions", stage: Stage::Gradients,
        what: "the gradient of a sample goes to all actions",
        why: "actions that were not tried learn what another one brought",
        mend: "the gradient is 0 for actions not taken: dq = zeros; dq[arange(B), actions] = ...",
        make: |v| v.reached = Reached::All,
    },
    Mistake {
        id: "gradient_accumulated", stage: Stage::Gradients,
        what: "the gradient of the update before is added (seen at the second update only)",
        why: "every step is that of all minibatches so far",
        mend: "optimizer.zero_grad() before loss.backward()",
        make: |v| if v.step == 2 { v.is_accumulated = true },
    },
    Mistake {
        id: "gradient_not_clipped", stage: Stage::Gradients,
        what: "the gradient is not shortened to max_gradient_norm",
        why: "one odd minibatch can throw the weights far away",
        mend: "clip_grad_norm_(net.parameters(), max_norm) between backward() and step(); global_clipnorm in Keras; optax.clip_by_global_norm",
        make: |v| v.clipping = Clipping::Nothing,
    },
    Mistake {
        id: "gradient_clipped_by_value", stage: Stage::Gradients,
        what: "every element of the gradient is clipped (to max_gradient_norm, or to 1 where there is none); right is its norm",
        why: "the direction of the step changes",
        mend: "clip_grad_norm_, not clip_grad_value_; global_clipnorm, not clipvalue, in Keras; optax.clip_by_global_norm, not optax.clip",
        make: |v| v.clipping = Clipping::Value(v.max_gradient_norm.unwrap_or(1.0)),
    },
    Mistake {
        id: "gradient_clipped_by_tensor", stage: Stage::Gradients,
        what: "the norm of every tensor is clipped on its own; right is the norm of all together",
        why: "the direction of the step changes, and the whole may be longer than asked for",
        mend: "global_clipnorm, not clipnorm, in Keras; clip_grad_norm_(net.parameters(), ...) once, not per parameter",
        make: |v| if v.max_gradient_norm.is_some() { v.clipping = Clipping::EveryTensor },
    },

    // m ← β₁ m + (1 − β₁) g    v ← β₂ v + (1 − β₂) g²    θ ← θ − α m̂ / (√v̂ + ε)
    Mistake {
        id: "adam_uncorrected", stage: Stage::Weights,
        what: "Adam without bias correction: θ − α m / (√v + ε)",
        why: "the first steps are about three times too long, for a thousand steps",
        mend: "divide m by 1 - beta1**t and v by 1 - beta2**t, t from 1",
        make: |v| v.optimizer = Optimizer::AdamUncorrected,
    },
    Mistake {
        id: "adam_epsilon_of_keras", stage: Stage::Weights,
        what: "Adam's ε stands beside the uncorrected √v, as in TensorFlow and Keras",
        why: "the first steps of small gradients are shorter: ε counts 32 times at the first step",
        mend: "in Keras nothing: say \"epsilon_place\": \"tensorflow\" in the settings; elsewhere add ε to the root of the corrected v",
        make: |v| v.optimizer = Optimizer::AdamOfKeras,
    },
    Mistake {
        id: "adam_epsilon_1e-7", stage: Stage::Weights,
        what: "Adam's ε is 1e-7, Keras' default, not that of the settings",
        why: "steps of very small gradients are shorter",
        mend: "Adam(epsilon=1e-8) in Keras; or say \"epsilon\": 1e-7 in the settings",
        make: |v| v.epsilon = 1e-7,
    },
    Mistake {
        id: "weight_decay", stage: Stage::Weights,
        what: "the weights decay by 0.01 α, AdamW's default",
        why: "Q-values are pulled to 0 whatever the rewards say",
        mend: "torch.optim.Adam or AdamW(weight_decay=0); optax.adam, not optax.adamw (its default is 0.0001)",
        make: |v| v.decay = Decay::Decoupled(0.01),
    },
    Mistake {
        id: "weight_decay_of_optax", stage: Stage::Weights,
        what: "the weights decay by 0.0001 α, the default of optax.adamw",
        why: "Q-values are pulled to 0 whatever the rewards say",
        mend: "optax.adam, not optax.adamw",
        make: |v| v.decay = Decay::Decoupled(0.0001),
    },
    Mistake {
        id: "weight_decay_in_gradient", stage: Stage::Weights,
        what: "0.01 times the weights is added to the gradient: Adam(weight_decay=0.01)",
        why: "Q-values are pulled to 0 whatever the rewards say",
        mend: "torch.optim.Adam(weight_decay=0), the default",
        make: |v| v.decay = Decay::Squared(0.01),
    },
    Mistake {
        id: "sgd", stage: Stage::Weights,
        what: "the step is that of plain gradient descent: θ − α g",
        why: "at Adam's step size it hardly learns",
        mend: "torch.optim.Adam, keras.optimizers.Adam, optax.adam",
        make: |v| v.optimizer = Optimizer::Sgd,
    },
    Mistake {
        id: "rmsprop", stage: Stage::Weights,
        what: "the step is RMSprop's (PyTorch's defaults): no momentum, no bias correction",
        why: "it is another optimiser; its first steps are ten times longer",
        mend: "torch.optim.Adam, keras.optimizers.Adam, optax.adam",
        make: |v| v.optimizer = Optimizer::RmsProp,
    },
    Mistake {
        id: "step_count_behind", stage: Stage::Weights,
        what: "Adam's step count is one too small: t counts from 0, or is raised after the step",
        why: "the bias correction is too large; at the very first step it divides by 0",
        mend: "t += 1 before the step; the first step has t = 1",
        make: |v| if v.step > 1 { v.step -= 1 },
    },
    Mistake {
        id: "step_count_ahead", stage: Stage::Weights,
        what: "Adam's step count is one too large",
        why: "the bias correction is too small: the first step is half as long",
        mend: "the first step has t = 1; raise t once per step",
        make: |v| v.step += 1,
    },
    Mistake {
        id: "ascent", stage: Stage::Weights,
        what: "the step goes up the gradient: θ + α m̂ / (√v̂ + ε)",
        why: "the loss grows",
        mend: "subtract the step; optax.apply_updates adds what optax.adam has negated already",
        make: |v| v.optimizer = Optimizer::Ascent,
    },
    Mistake {
        id: "no_step", stage: Stage::Weights,
        what: "the weights do not move",
        why: "nothing is learned",
        mend: "optimizer.step(); keep the params that optax.apply_updates returns; give the optimizer this network's parameters",
        make: |v| v.optimizer = Optimizer::Nothing,
    },
];
