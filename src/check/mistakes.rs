//! Everything that `check` can name. docs/mistakes.md has the texts: one more mistake is a row of that page. One that changes
//! an update is an entry in [`CHANGES`] too, and where no field of [`Variant`] says it, a branch in reference.rs.

use std::sync::LazyLock;

use serde::Serialize;

use super::activation::Activation;
use super::file::EpsilonPlace;
use super::variant::{
    Clipping, Decay, Discount, Mask, NextValue, Optimizer, Penalty, Predicted, QValues, Reached, Reduction,
    Reward, Variant,
};

/// The quantities of an update, in the order in which they are computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    Batch,
    Q,
    Targets,
    Loss,
    Gradients,
    Weights,
}

impl Stage {
    /// Those that follow from one another.
    pub const ALL: [Self; 4] = [Self::Targets, Self::Loss, Self::Gradients, Self::Weights];

    /// As it is written.
    pub fn name(self) -> &'static str {
        ["batch", "q", "targets", "loss", "gradients", "weights"][self as usize]
    }
}

/// A mistake that people make, as docs/mistakes.md describes it.
#[derive(Debug, Serialize)]
pub struct Mistake {
    /// Its name for programs.
    pub id: &'static str,
    /// What they do, and what is right.
    pub what: String,
    pub why: String,
    /// How to mend it in PyTorch, Keras or JAX.
    pub mend: String,
    /// The first quantity that it changes; the batch if it is seen without computing the update again.
    #[serde(skip)]
    pub stage: Stage,
    #[serde(skip)]
    make: fn(&mut Variant),
}

/// A mistake, and the numbers that prove it.
#[derive(Debug, Serialize)]
pub struct Found {
    #[serde(flatten)]
    pub mistake: &'static Mistake,
    pub evidence: String,
}

impl Found {
    pub(super) fn new(id: &str, evidence: String) -> Option<Self> {
        Some(Self { mistake: Mistake::named(id)?, evidence })
    }
}

/// Every mistake of the page. Those that change an update stand in the order in which they are tried.
pub static MISTAKES: LazyLock<Vec<Mistake>> = LazyLock::new(|| {
    let page = include_str!("../../docs/mistakes.md");
    let mut mistakes: Vec<_> = page.lines().filter_map(Mistake::from_row).collect();
    mistakes.sort_by_key(|mistake| CHANGES.iter().position(|(id, ..)| *id == mistake.id));
    mistakes
});

impl Mistake {
    /// A row of the page's tables. A backslash there is for Markdown alone.
    fn from_row(row: &'static str) -> Option<Self> {
        let mut cells = row.strip_prefix("| `")?.split(" | ");
        let id = cells.next()?.strip_suffix('`')?;
        let mut text = || Some(cells.next()?.replace('\\', ""));
        let change = CHANGES.iter().find(|(changed, ..)| *changed == id);
        let (_, stage, make) = change.copied().unwrap_or((id, Stage::Batch, |_| ()));
        Some(Self { id, what: text()?, why: text()?, mend: text()?, stage, make })
    }

    pub fn named(id: &str) -> Option<&'static Self> {
        let found = MISTAKES.iter().find(|mistake| mistake.id == id);
        debug_assert!(found.is_some(), "docs/mistakes.md has no `{id}`");
        found
    }

    /// Those that change an update.
    pub fn of_updates() -> impl Iterator<Item = &'static Self> {
        MISTAKES.iter().filter(|mistake| mistake.stage > Stage::Batch)
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

    /// The number that was found of a mistake with a number in it.
    pub(super) fn measured(&self, variant: &Variant) -> Option<String> {
        let fitted = &variant.fitted;
        Some(match self.id {
            "another_discount" => format!("γ is {}", fitted.gamma),
            "another_huber_delta" => format!("δ is {}", fitted.delta),
            "smooth_l1_beta" => format!("β is {}", fitted.smooth_l1_beta),
            "gradient_clipped_by_value" => format!("no element is beyond ±{}", fitted.clip_value),
            "another_learning_rate" => format!("α is {}", fitted.learning_rate),
            "another_weight_decay" => format!("the decay is {} α", fitted.weight_decay),
            "sgd_with_momentum" => format!("the momentum is {}", fitted.momentum),
            "online_overwritten_by_target" => {
                format!("the step is followed by θ ← θ + {} (θ⁻ − θ)", fitted.overwritten)
            }
            "targets_of_every_pair" => {
                let of = |of_row| if of_row { "i" } else { "j" };
                let [reward, mask, next] = fitted.square.map(of);
                format!("element [i, j] is r_{reward} + γ (1 − d_{mask}) max Q⁻(s′_{next}, ·)")
            }
            _ => return None,
        })
    }
}

fn optimize(variant: &mut Variant, optimizer: Optimizer, momentum: f64) {
    (variant.optimizer, variant.settings.momentum, variant.buffer_scale) = (optimizer, momentum, 1.0);
}

/// A mistake's name, the first quantity that it changes, and how it is made: a variant that cannot have it stays as it is.
type Change = (&'static str, Stage, fn(&mut Variant));

#[rustfmt::skip]
pub const CHANGES: &[Change] = &[
    // Q(s, ·) = W₃ ReLU(W₂ ReLU(W₁ s + b₁) + b₂) + b₃
    ("output_relu", Stage::Q, |v| v.activations.output = Activation::Relu),
    ("output_softmax", Stage::Q, |v| v.activations.output = Activation::Softmax),
    ("output_sigmoid", Stage::Q, |v| v.activations.output = Activation::Sigmoid),
    ("output_tanh", Stage::Q, |v| v.activations.output = Activation::Tanh),
    ("hidden_linear", Stage::Q, |v| v.activations.hidden = Activation::Nothing),
    ("hidden_tanh", Stage::Q, |v| v.activations.hidden = Activation::Tanh),
    ("hidden_sigmoid", Stage::Q, |v| v.activations.hidden = Activation::Sigmoid),
    ("hidden_leaky_relu", Stage::Q, |v| v.activations.hidden = Activation::LeakyRelu),
    ("hidden_elu", Stage::Q, |v| v.activations.hidden = Activation::Elu),
    ("hidden_gelu", Stage::Q, |v| v.activations.hidden = Activation::Gelu),
    ("hidden_silu", Stage::Q, |v| v.activations.hidden = Activation::Silu),
    ("q_of_target_network", Stage::Q, |v| if v.given.target { v.queried = QValues::Target }),
    ("q_of_next_observations", Stage::Q, |v| v.queried = QValues::Next),
    ("q_after_the_update", Stage::Q, |v| v.queried = QValues::After),
    // y = r + γ (1 − d) max_a Q⁻(s′, a)
    ("terminal_bootstrapped", Stage::Targets, |v| v.mask = Mask::Nowhere),
    ("truncation_not_bootstrapped", Stage::Targets, |v| v.mask = Mask::TerminatedOrTruncated),
    ("mask_inverted", Stage::Targets, |v| v.mask = Mask::NotTerminated),
    ("terminal_reward_lost", Stage::Targets, |v| v.reward_is_masked = true),
    ("bootstrap_from_online", Stage::Targets, |v| v.from_online = v.bootstrap != NextValue::DoubleExchanged),
    ("double_exchanged", Stage::Targets, |v| if v.bootstrap == NextValue::Double { v.bootstrap = NextValue::DoubleExchanged }),
    ("double_left_out", Stage::Targets, |v| if v.bootstrap == NextValue::Double { v.bootstrap = NextValue::Max }),
    ("double_unasked", Stage::Targets, |v| if v.bootstrap == NextValue::Max { v.bootstrap = NextValue::Double }),
    ("current_observation", Stage::Targets, |v| v.from_current = true),
    ("observations_exchanged", Stage::Targets, |v| (v.from_current, v.predicted_from) = (true, QValues::Next)),
    ("next_value_of_taken_action", Stage::Targets, |v| v.bootstrap = NextValue::Taken),
    ("next_value_mean", Stage::Targets, |v| v.bootstrap = NextValue::Mean),
    ("next_value_minimum", Stage::Targets, |v| v.bootstrap = NextValue::Min),
    ("index_in_place_of_value", Stage::Targets, |v| v.bootstrap = NextValue::Index),
    ("maximum_of_batch", Stage::Targets, |v| v.bootstrap = NextValue::MaxOfBatch),
    ("discount_forgotten", Stage::Targets, |v| v.discount = Discount::Forgotten),
    ("discount_twice", Stage::Targets, |v| v.discount = Discount::Twice),
    ("another_discount", Stage::Targets, |v| v.discount = Discount::Other(v.fitted.gamma)),
    ("discount_of_one_step", Stage::Targets, |v| if v.given.n_step { v.discount = Discount::Gamma }),
    ("discount_of_one_step_more", Stage::Targets, |v| if v.given.n_step { v.discount = Discount::OneMore }),
    ("discount_of_one_step_less", Stage::Targets, |v| if v.given.n_step { v.discount = Discount::OneLess }),
    ("full_n_at_the_end", Stage::Targets, |v| if v.given.n_step { v.discount = Discount::Longest }),
    ("targets_of_every_pair", Stage::Targets, |v| v.square = Some(v.fitted.square)),
    ("reward_negated", Stage::Targets, |v| v.reward = Reward::Negated),
    ("reward_discounted", Stage::Targets, |v| v.reward = Reward::Discounted),
    ("reward_forgotten", Stage::Targets, |v| v.reward = Reward::Forgotten),
    ("reward_clipped", Stage::Targets, |v| v.reward = Reward::Clipped),
    // L = 1/B Σ ℓ(Q(s, a) − y)
    ("sum", Stage::Loss, |v| v.reduction = Reduction::Sum),
    ("mean_over_outputs", Stage::Loss, |v| v.reduction = Reduction::MeanOverOutputs),
    ("half_square", Stage::Loss, |v| if v.loss == Penalty::Square { v.is_halved = true }),
    ("huber_for_mse", Stage::Loss, |v| if v.loss == Penalty::Square { v.loss = Penalty::Huber(1.0) }),
    ("mse_for_huber", Stage::Loss, |v| if matches!(v.loss, Penalty::Huber(_) | Penalty::SmoothL1(_)) { v.loss = Penalty::Square }),
    ("another_huber_delta", Stage::Loss, |v| v.loss = Penalty::Huber(v.fitted.delta)),
    ("smooth_l1_beta", Stage::Loss, |v| v.loss = Penalty::SmoothL1(v.fitted.smooth_l1_beta)),
    ("clipped_square", Stage::Loss, |v| v.loss = Penalty::ClippedSquare),
    ("weights_forgotten", Stage::Loss, |v| v.is_weighted = false),
    ("full_target_zeros", Stage::Loss, |v| v.predicted = Predicted::FullZeros),
    ("full_target_of_target_network", Stage::Loss, |v| if v.given.target { v.predicted = Predicted::FullOfTarget }),
    ("every_column", Stage::Loss, |v| v.predicted = Predicted::EveryColumn),
    ("every_column_by_row", Stage::Loss, |v| v.predicted = Predicted::EveryColumnByRow),
    ("sum_of_batch_predicted", Stage::Loss, |v| v.predicted = Predicted::SumOfBatch),
    ("predicted_from_next", Stage::Loss, |v| v.predicted_from = QValues::Next),
    ("predicted_by_target", Stage::Loss, |v| if v.given.target { v.predicted_from = QValues::Target }),
    ("absolute_error", Stage::Loss, |v| v.loss = Penalty::Absolute),
    ("every_pair", Stage::Loss, |v| v.predicted = Predicted::EveryPair),
    ("every_output", Stage::Loss, |v| v.predicted = Predicted::EveryOutput),
    ("largest_predicted", Stage::Loss, |v| v.predicted = Predicted::Largest),
    ("other_action_predicted", Stage::Loss, |v| v.predicted = Predicted::Shifted(1)),
    // g = ∂L/∂Q(s, a) · ∂Q(s, a)/∂θ, then clipped
    ("gradient_through_target", Stage::Gradients, |v| if v.from_online || v.given.target_is_online { v.through_target = true }),
    ("gradient_of_wrong_action", Stage::Gradients, |v| v.reached = Reached::Shifted(1)),
    ("gradient_of_all_actions", Stage::Gradients, |v| v.reached = Reached::All),
    ("gradient_accumulated", Stage::Gradients, |v| if v.given.gradient_before { v.is_accumulated = true }),
    ("gradient_not_clipped", Stage::Gradients, |v| v.clipping = Clipping::Nothing),
    ("gradient_clipped_by_value", Stage::Gradients, |v| v.clipping = Clipping::Value(v.fitted.clip_value)),
    ("gradient_clipped_by_tensor", Stage::Gradients, |v| if v.settings.max_gradient_norm.is_some() { v.clipping = Clipping::EveryTensor }),
    // m ← β₁ m + (1 − β₁) g    v ← β₂ v + (1 − β₂) g²    θ ← θ − α m̂ / (√v̂ + ε)
    ("adam_uncorrected", Stage::Weights, |v| if v.is_adam() { v.optimizer = Optimizer::AdamUncorrected }),
    ("adam_epsilon_of_keras", Stage::Weights, |v| if v.optimizer == Optimizer::Adam { v.settings.epsilon_place = EpsilonPlace::TensorFlow }),
    ("adam_epsilon_1e-7", Stage::Weights, |v| if v.is_adam() { v.settings.epsilon = 1e-7 }),
    ("weight_decay", Stage::Weights, |v| v.decay = Decay::Decoupled(0.01)),
    ("weight_decay_of_optax", Stage::Weights, |v| v.decay = Decay::Decoupled(0.0001)),
    ("weight_decay_in_gradient", Stage::Weights, |v| v.decay = Decay::Squared(0.01)),
    ("another_weight_decay", Stage::Weights, |v| v.decay = Decay::Decoupled(v.fitted.weight_decay)),
    ("weight_decay_forgotten", Stage::Weights, |v| v.decay = Decay::None),
    ("amsgrad_left_out", Stage::Weights, |v| v.settings.amsgrad = false),
    ("another_learning_rate", Stage::Weights, |v| v.settings.learning_rate = v.fitted.learning_rate),
    ("adam", Stage::Weights, |v| if !v.is_adam() { optimize(v, Optimizer::Adam, 0.0) }),
    ("sgd", Stage::Weights, |v| optimize(v, Optimizer::Sgd, 0.0)),
    ("sgd_with_momentum", Stage::Weights, |v| (v.optimizer, v.settings.momentum, v.buffer_scale) = (Optimizer::Sgd, v.fitted.momentum, v.fitted.buffer_scale)),
    ("rmsprop", Stage::Weights, |v| optimize(v, Optimizer::RmsProp, 0.0)),
    ("step_count_behind", Stage::Weights, |v| if v.is_adam() && v.step > 1 { v.step -= 1 }),
    ("step_count_ahead", Stage::Weights, |v| if v.is_adam() { v.step += 1 }),
    ("ascent", Stage::Weights, |v| v.is_ascent = !v.is_ascent),
    ("no_step", Stage::Weights, |v| v.optimizer = Optimizer::Nothing),
    ("online_overwritten_by_target", Stage::Weights, |v| if v.given.target { v.overwritten = v.fitted.overwritten }),
];
