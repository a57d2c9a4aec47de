//! The known mistakes. One more is an entry here, and where no field of [`Variant`] can say it, a branch beside the
//! equation in reference.rs.

use serde::Serialize;

use super::reference::{
    Clipping, Decay, Mask, NextValue, Optimizer, Penalty, Predicted, Reached, Reduction, Reward, Variant,
};
use crate::nn::Loss;

/// The quantities of an update, in the order in which they are computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    Targets,
    Loss,
    Gradients,
    Weights,
}

impl Stage {
    pub const ALL: [Self; 4] = [Self::Targets, Self::Loss, Self::Gradients, Self::Weights];

    /// As it is written.
    pub fn name(self) -> &'static str {
        ["targets", "loss", "gradients", "weights"][self as usize]
    }
}

type Note = &'static str;

/// A mistake that people make.
#[derive(Debug, Serialize)]
pub struct Mistake {
    /// Its name for programs.
    pub id: Note,
    /// The first quantity that it changes.
    #[serde(skip)]
    pub stage: Stage,
    /// What they compute, and what is right.
    pub(crate) what: Note,
    pub(crate) why: Note,
    /// How to mend it in PyTorch, Keras or JAX.
    pub(crate) mend: Note,
    /// Makes it; leaves a variant alone that cannot have it.
    #[serde(skip)]
    pub(crate) make: fn(&mut Variant),
}

impl Mistake {
    const fn new(stage: Stage, id: Note, make: fn(&mut Variant), what: Note, why: Note, mend: Note) -> Self {
        Self { id, stage, what, why, mend, make }
    }

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

/// Every mistake: the quantity, the name and how it is made; then what is computed, why it matters and how to mend it.
#[rustfmt::skip]
pub static CATALOGUE: &[Mistake] = &[
    // y = r + γ (1 − d) max_a Q⁻(s′, a)
    Mistake::new(Stage::Targets, "terminal_bootstrapped", |v| v.mask = Mask::Nowhere,
        "terminal states are bootstrapped: y = r + γ max Q⁻(s′, ·) also where the episode terminated; right is y = r",
        "the value of falling becomes that of a state to go on from, and values grow without end",
        "multiply the next value by (1 - terminated), as float: y = r + gamma * (1 - terminated) * next_q"),
    Mistake::new(Stage::Targets, "truncation_not_bootstrapped", |v| v.mask = Mask::TerminatedOrTruncated,
        "truncated episodes are not bootstrapped: y = r at the time limit; right is y = r + γ max Q⁻(s′, ·)",
        "a time limit is not the task's end; good states get the value of bad ones, and nothing in s tells why",
        "store `terminated` of env.step, not `terminated or truncated`, and s' before the reset (vector environments: final_observation)"),
    Mistake::new(Stage::Targets, "mask_inverted", |v| v.mask = Mask::NotTerminated,
        "the mask is inverted: only terminal states are bootstrapped",
        "every other target is the reward alone, so nothing is learned about what follows",
        "the factor of the next value is (1 - terminated), not terminated"),
    Mistake::new(Stage::Targets, "terminal_reward_lost", |v| v.reward_is_masked = true,
        "the whole target is masked: y = 0 where the episode terminated; right is y = r",
        "the reward of the last step, often the one that matters, is never learned",
        "mask the next value only: r + gamma * (1 - terminated) * next_q, not (1 - terminated) * (r + gamma * next_q)"),
    Mistake::new(Stage::Targets, "bootstrap_from_online", |v| v.from_online = v.bootstrap != NextValue::DoubleExchanged,
        "the online network values s′ in place of the target network",
        "the targets move with every step, which is what the target network is there to prevent",
        "next_q = target_net(next_obs), not q_net(next_obs); in Keras target_model(next_obs), in JAX apply(target_params, next_obs)"),
    Mistake::new(Stage::Targets, "double_exchanged", |v| if v.bootstrap == NextValue::Double { v.bootstrap = NextValue::DoubleExchanged },
        "double Q-learning with the roles exchanged: the target network chooses, the online network values",
        "the target's stale choice is valued by the network that moves with every step",
        "a = q_net(next_obs).argmax(1); next_q = target_net(next_obs).gather(1, a[:, None])"),
    Mistake::new(Stage::Targets, "double_left_out", |v| if v.bootstrap == NextValue::Double { v.bootstrap = NextValue::Max },
        "the target is max Q⁻(s′, ·), though the settings say double Q-learning",
        "the maximum over noisy estimates is too large on average",
        "let the online network choose: a = q_net(next_obs).argmax(1); next_q = target_net(next_obs).gather(1, a[:, None])"),
    Mistake::new(Stage::Targets, "double_unasked", |v| if v.bootstrap == NextValue::Max { v.bootstrap = NextValue::Double },
        "the targets are those of double Q-learning, though the settings do not say so",
        "it is another algorithm, if a good one",
        "say \"double\": true in the settings if it is meant; else next_q = target_net(next_obs).max(1).values"),
    Mistake::new(Stage::Targets, "current_observation", |v| v.from_current = true,
        "the maximum is over the current observation: y = r + γ max Q⁻(s, ·); right is Q⁻(s′, ·)",
        "a state is valued by itself; what an action leads to is never looked at",
        "feed next_obs, not obs, to the target network; look at the order in which the replay memory returns them"),
    Mistake::new(Stage::Targets, "next_value_of_taken_action", |v| v.bootstrap = NextValue::Taken,
        "the next value is Q⁻(s′, a) of the action taken in s; right is the maximum over actions",
        "it is the value of repeating an action, not of acting well",
        "target_net(next_obs).max(1).values, not .gather(1, actions); in JAX and Keras max(axis=1)"),
    Mistake::new(Stage::Targets, "next_value_mean", |v| v.bootstrap = NextValue::Mean,
        "the next value is the mean over actions; right is the maximum",
        "it is the value of acting at random",
        "max over the axis of actions: .max(1).values in PyTorch, max(axis=1) in Keras and JAX"),
    Mistake::new(Stage::Targets, "next_value_minimum", |v| v.bootstrap = NextValue::Min,
        "the next value is the minimum over actions; right is the maximum",
        "it is the value of acting as badly as possible",
        "max over the axis of actions: .max(1).values in PyTorch, max(axis=1) in Keras and JAX"),
    Mistake::new(Stage::Targets, "index_in_place_of_value", |v| v.bootstrap = NextValue::Index,
        "the next value is the number of the best action; right is its Q-value",
        "the targets do not depend on what was learned",
        ".max(1) returns (values, indices) in PyTorch: take [0] or .values; in Keras and JAX max, not argmax"),
    Mistake::new(Stage::Targets, "maximum_of_batch", |v| v.bootstrap = NextValue::MaxOfBatch,
        "the next value is the largest of the whole batch; right is the largest of each sample",
        "every state gets the value of the best one",
        "give the axis of actions: .max(1).values in PyTorch, max(axis=1) in Keras and JAX"),
    Mistake::new(Stage::Targets, "discount_forgotten", |v| v.discounted = 0,
        "γ is forgotten: y = r + max Q⁻(s′, ·)",
        "without discount the values of a long task have no bound",
        "y = r + gamma * (1 - terminated) * next_q"),
    Mistake::new(Stage::Targets, "discount_twice", |v| v.discounted = 2,
        "γ is applied twice: y = r + γ² max Q⁻(s′, ·)",
        "the agent looks half as far ahead as it should",
        "multiply by gamma once; look whether the replay memory or a wrapper has done so already"),
    Mistake::new(Stage::Targets, "reward_discounted", |v| v.reward = Reward::Discounted,
        "the reward is discounted as well: y = γ r + γ max Q⁻(s′, ·)",
        "all values are γ times what they should be; with n steps or other rewards the best action can change",
        "y = r + gamma * (1 - terminated) * next_q, not gamma * (r + next_q)"),
    Mistake::new(Stage::Targets, "reward_forgotten", |v| v.reward = Reward::Forgotten,
        "the reward is forgotten: y = γ max Q⁻(s′, ·)",
        "nothing tells a good state from a bad one, and all values fall to 0",
        "y = r + gamma * (1 - terminated) * next_q"),
    Mistake::new(Stage::Targets, "reward_clipped", |v| v.reward = Reward::Clipped,
        "the reward is clipped to -1…1, as for Atari games",
        "rewards of 1 and of 100 are worth the same",
        "leave out the clipping, or put clipped rewards into batch.rewards if it is meant"),

    // L = 1/B Σ ℓ(Q(s, a) − y)
    Mistake::new(Stage::Loss, "sum", |v| v.reduction = Reduction::Sum,
        "the losses are summed; right is their mean over the batch",
        "gradient and clipping grow with the batch size; with SGD so does the step",
        "reduction='mean' in PyTorch; tf.reduce_mean and jnp.mean, not sum"),
    Mistake::new(Stage::Loss, "mean_over_outputs", |v| v.reduction = Reduction::MeanOverOutputs,
        "the mean is over all outputs, as of Keras' full target vector: divided by batch times actions",
        "the gradient is smaller by the number of actions; Adam hides it, clipping and ε do not",
        "take the loss of Q(s, a) alone: gather in PyTorch, tf.reduce_sum(q * one_hot, 1), q[arange, a] in JAX; or multiply by the number of actions"),
    Mistake::new(Stage::Loss, "half_square", |v| if v.loss == MSE { v.is_halved = true },
        "the loss is half of the square, ½ δ²; right for \"mse\" is δ²",
        "the gradient is half as large; Adam hides it, SGD and clipping do not",
        "F.mse_loss in PyTorch and MeanSquaredError in Keras have no ½, optax.l2_loss in JAX has: use optax.squared_error"),
    Mistake::new(Stage::Loss, "huber_for_mse", |v| if v.loss == MSE { v.loss = HUBER },
        "the loss is Huber's, the settings say \"mse\"",
        "large errors count less",
        "F.mse_loss, not F.smooth_l1_loss; or say \"loss\": \"huber\" in the settings if it is meant"),
    Mistake::new(Stage::Loss, "mse_for_huber", |v| if v.loss == HUBER { v.loss = MSE },
        "the loss is the square, the settings say \"huber\"",
        "large errors count without limit",
        "F.smooth_l1_loss in PyTorch, tf.keras.losses.Huber(), optax.huber_loss; or say \"loss\": \"mse\" if it is meant"),
    Mistake::new(Stage::Loss, "absolute_error", |v| v.loss = Penalty::Absolute,
        "the loss is the absolute error |δ|",
        "the values go to the median of the targets, and steps stay large near the optimum",
        "F.mse_loss or F.smooth_l1_loss in PyTorch, not F.l1_loss"),
    Mistake::new(Stage::Loss, "every_pair", |v| v.predicted = Predicted::EveryPair,
        "every Q(s, a) is compared with the target of every sample: shapes [B, 1] and [B] broadcast to [B, B]",
        "every prediction is drawn to the mean of all targets",
        "give both the shape [B]: q.gather(1, a[:, None]).squeeze(1); the framework's warning about shapes is right"),
    Mistake::new(Stage::Loss, "every_output", |v| v.predicted = Predicted::EveryOutput,
        "every output is compared with the target, not that of the action taken alone",
        "all actions learn the same value",
        "take Q(s, a) first: q.gather(1, a[:, None]).squeeze(1); q[arange(B), a] in JAX"),
    Mistake::new(Stage::Loss, "largest_predicted", |v| v.predicted = Predicted::Largest,
        "the prediction is max Q(s, ·); right is Q(s, a) of the action taken",
        "what an exploring action brought is credited to the greedy one",
        "q.gather(1, actions[:, None]).squeeze(1), not q.max(1).values"),
    Mistake::new(Stage::Loss, "other_action_predicted", |v| v.predicted = Predicted::Shifted(1),
        "the prediction is Q(s, ·) of another action than the one taken: the next in order",
        "every action learns the value of another one",
        "store the action that went into env.step; count actions from 0"),

    // g = ∂L/∂Q(s, a) · ∂Q(s, a)/∂θ, then clipped
    Mistake::new(Stage::Gradients, "gradient_through_target", |v| if v.from_online { v.through_target = true },
        "the gradient goes through the target as well: it is not detached",
        "the network is also pushed to make the next state fit its past (residual gradient), which learns slower and elsewhere",
        "compute the target under torch.no_grad(); tf.stop_gradient(y); jax.lax.stop_gradient(y)"),
    Mistake::new(Stage::Gradients, "gradient_of_wrong_action", |v| v.reached = Reached::Shifted(1),
        "the gradient goes to another action than the one taken: the next in order",
        "every action learns the error of another one",
        "index the gradient with the actions of the batch: dq[arange(B), actions]"),
    Mistake::new(Stage::Gradients, "gradient_of_all_actions", |v| v.reached = Reached::All,
        "the gradient of a sample goes to all actions",
        "actions that were not tried learn what another one brought",
        "the gradient is 0 for actions not taken: dq = zeros; dq[arange(B), actions] = ..."),
    Mistake::new(Stage::Gradients, "gradient_accumulated", |v| if v.step == 2 { v.is_accumulated = true },
        "the gradient of the update before is added (seen at the second update only)",
        "every step is that of all minibatches so far",
        "optimizer.zero_grad() before loss.backward()"),
    Mistake::new(Stage::Gradients, "gradient_not_clipped", |v| v.clipping = Clipping::Nothing,
        "the gradient is not shortened to max_gradient_norm",
        "one odd minibatch can throw the weights far away",
        "clip_grad_norm_(net.parameters(), max_norm) between backward() and step(); global_clipnorm in Keras; optax.clip_by_global_norm"),
    Mistake::new(Stage::Gradients, "gradient_clipped_by_value", |v| v.clipping = Clipping::Value(v.max_gradient_norm.unwrap_or(1.0)),
        "every element of the gradient is clipped (to max_gradient_norm, or to 1 where there is none); right is its norm",
        "the direction of the step changes",
        "clip_grad_norm_, not clip_grad_value_; global_clipnorm, not clipvalue, in Keras; optax.clip_by_global_norm, not optax.clip"),
    Mistake::new(Stage::Gradients, "gradient_clipped_by_tensor", |v| if v.max_gradient_norm.is_some() { v.clipping = Clipping::EveryTensor },
        "the norm of every tensor is clipped on its own; right is the norm of all together",
        "the direction of the step changes, and the whole may be longer than asked for",
        "global_clipnorm, not clipnorm, in Keras; clip_grad_norm_(net.parameters(), ...) once, not per parameter"),

    // m ← β₁ m + (1 − β₁) g    v ← β₂ v + (1 − β₂) g²    θ ← θ − α m̂ / (√v̂ + ε)
    Mistake::new(Stage::Weights, "adam_uncorrected", |v| v.optimizer = Optimizer::AdamUncorrected,
        "Adam without bias correction: θ − α m / (√v + ε)",
        "the first steps are about three times too long, for a thousand steps",
        "divide m by 1 - beta1**t and v by 1 - beta2**t, t from 1"),
    Mistake::new(Stage::Weights, "adam_epsilon_of_keras", |v| v.optimizer = Optimizer::AdamOfKeras,
        "Adam's ε stands beside the uncorrected √v, as in TensorFlow and Keras",
        "the first steps of small gradients are shorter: ε counts 32 times at the first step",
        "in Keras nothing: say \"epsilon_place\": \"tensorflow\" in the settings; elsewhere add ε to the root of the corrected v"),
    Mistake::new(Stage::Weights, "adam_epsilon_1e-7", |v| v.epsilon = 1e-7,
        "Adam's ε is 1e-7, Keras' default, not that of the settings",
        "steps of very small gradients are shorter",
        "Adam(epsilon=1e-8) in Keras; or say \"epsilon\": 1e-7 in the settings"),
    Mistake::new(Stage::Weights, "weight_decay", |v| v.decay = Decay::Decoupled(0.01),
        "the weights decay by 0.01 α, AdamW's default",
        "Q-values are pulled to 0 whatever the rewards say",
        "torch.optim.Adam or AdamW(weight_decay=0); optax.adam, not optax.adamw (its default is 0.0001)"),
    Mistake::new(Stage::Weights, "weight_decay_of_optax", |v| v.decay = Decay::Decoupled(0.0001),
        "the weights decay by 0.0001 α, the default of optax.adamw",
        "Q-values are pulled to 0 whatever the rewards say",
        "optax.adam, not optax.adamw"),
    Mistake::new(Stage::Weights, "weight_decay_in_gradient", |v| v.decay = Decay::Squared(0.01),
        "0.01 times the weights is added to the gradient: Adam(weight_decay=0.01)",
        "Q-values are pulled to 0 whatever the rewards say",
        "torch.optim.Adam(weight_decay=0), the default"),
    Mistake::new(Stage::Weights, "sgd", |v| v.optimizer = Optimizer::Sgd,
        "the step is that of plain gradient descent: θ − α g",
        "at Adam's step size it hardly learns",
        "torch.optim.Adam, keras.optimizers.Adam, optax.adam"),
    Mistake::new(Stage::Weights, "rmsprop", |v| v.optimizer = Optimizer::RmsProp,
        "the step is RMSprop's (PyTorch's defaults): no momentum, no bias correction",
        "it is another optimiser; its first steps are ten times longer",
        "torch.optim.Adam, keras.optimizers.Adam, optax.adam"),
    Mistake::new(Stage::Weights, "step_count_behind", |v| if v.step > 1 { v.step -= 1 },
        "Adam's step count is one too small: t counts from 0, or is raised after the step",
        "the bias correction is too large; at the very first step it divides by 0",
        "t += 1 before the step; the first step has t = 1"),
    Mistake::new(Stage::Weights, "step_count_ahead", |v| v.step += 1,
        "Adam's step count is one too large",
        "the bias correction is too small: the first step is half as long",
        "the first step has t = 1; raise t once per step"),
    Mistake::new(Stage::Weights, "ascent", |v| v.optimizer = Optimizer::Ascent,
        "the step goes up the gradient: θ + α m̂ / (√v̂ + ε)",
        "the loss grows",
        "subtract the step; optax.apply_updates adds what optax.adam has negated already"),
    Mistake::new(Stage::Weights, "no_step", |v| v.optimizer = Optimizer::Nothing,
        "the weights do not move",
        "nothing is learned",
        "optimizer.step(); keep the params that optax.apply_updates returns; give the optimizer this network's parameters"),
];
