//! How an update is computed: the right way, or with mistakes.
// The names of the variants say what they are.
#![allow(missing_docs)]

use super::activation::LayerKinds;
use super::file::{OptimizerName, Settings, Update};
use crate::nn::Loss;

/// How an update is computed: the right way ([`Variant::right`]), or with some of the catalogue's mistakes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Variant {
    /// Those of the update, but for what a mistake changes in them.
    pub settings: Settings,
    pub activations: LayerKinds,
    /// What `result.q` is.
    pub queried: QValues,

    pub reward: Reward,
    pub discount: Discount,
    pub mask: Mask,
    /// Where the mask is 0 the reward is lost as well.
    pub reward_is_masked: bool,
    pub bootstrap: NextValue,
    /// The online network values s′; right only where there is no target network.
    pub from_online: bool,
    /// s takes the place of s′.
    pub from_current: bool,
    /// Targets [B, B]: whether the reward, the mask and the next value are those of the row (else of the column).
    pub square: Option<[bool; 3]>,

    pub loss: Penalty,
    pub predicted: Predicted,
    /// What is compared with the targets.
    pub predicted_from: QValues,
    pub reduction: Reduction,
    pub is_halved: bool,
    /// Whether the losses are multiplied by the weights of the samples.
    pub is_weighted: bool,

    /// The target is no constant.
    pub through_target: bool,
    pub reached: Reached,
    /// The gradient before the update is still there.
    pub is_accumulated: bool,
    pub clipping: Clipping,
    /// What is added to ‖g‖ where the norm is shortened; none if either form will do.
    pub norm_margin: Option<f64>,

    pub optimizer: Optimizer,
    pub is_ascent: bool,
    /// The momentum's buffer is the first moment times this.
    pub buffer_scale: f64,
    /// The number of this step, from 1.
    pub step: u64,
    pub decay: Decay,
    /// After the step the weights are moved by this share of the way to the target network.
    pub overwritten: f64,

    pub given: Given,
    pub fitted: Fitted,
}

/// What an update must have so that some mistakes can be made in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Given {
    pub target: bool,
    /// The target network has the weights of the online network.
    pub target_is_online: bool,
    /// Discounts that differ from γ.
    pub n_step: bool,
    pub gradient_before: bool,
}

/// Numbers that the settings say otherwise: those that explain the most of somebody's results. The defaults serve tests.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fitted {
    pub gamma: f64,
    pub square: [bool; 3],
    pub delta: f64,
    pub smooth_l1_beta: f64,
    pub clip_value: f64,
    pub learning_rate: f64,
    pub weight_decay: f64,
    pub momentum: f64,
    pub buffer_scale: f64,
    pub overwritten: f64,
}

impl Default for Fitted {
    fn default() -> Self {
        Self {
            gamma: 0.8,
            square: [true, true, false],
            delta: 0.5,
            smooth_l1_beta: 0.5,
            clip_value: 1.0,
            learning_rate: 0.0025,
            weight_decay: 0.3,
            momentum: 0.9,
            buffer_scale: 1.0,
            overwritten: 0.1,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Discount {
    /// That of the sample.
    Own,
    Forgotten,
    Twice,
    /// γ for γᵏ.
    Gamma,
    /// γᵏ⁺¹ and γᵏ⁻¹ for γᵏ.
    OneMore,
    OneLess,
    /// γⁿ for samples of fewer steps too.
    Longest,
    Other(f64),
}

/// The part of the reward that is in the target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reward {
    Whole,
    Forgotten,
    Discounted,
    /// To −1…1.
    Clipped,
    Negated,
}

/// Where the target is the reward alone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Mask {
    Terminated,
    Nowhere,
    TerminatedOrTruncated,
    NotTerminated,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum NextValue {
    Max,
    Double,
    DoubleExchanged,
    /// Of the action that was taken in s.
    Taken,
    Mean,
    Min,
    /// The number of the best action, in place of its value.
    Index,
    /// The largest value of the whole batch.
    MaxOfBatch,
}

/// The loss of one TD error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Penalty {
    Square,
    /// ½ δ² up to Δ, then Δ (|δ| − ½ Δ); the whole divided by Δ in smooth L1's scale.
    Huber(f64),
    SmoothL1(f64),
    Absolute,
    /// The square of δ clipped to −1…1.
    ClippedSquare,
}

/// What is compared with the targets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Predicted {
    Taken,
    Largest,
    /// The action behind the one taken, by so many.
    Shifted(usize),
    /// Every output, each with its sample's target.
    EveryOutput,
    /// Every output: that of the action taken with the target, the others with 0 or with the target network's.
    FullZeros,
    FullOfTarget,
    /// Q(s, a) of every sample with the target of every sample.
    EveryPair,
    /// Q(s, ·) of every sample and of the action of every sample, with the target of the latter or of the former.
    EveryColumn,
    EveryColumnByRow,
    /// Σ Q(s, a) over the batch with every target.
    SumOfBatch,
}

/// Whose Q-values these are: Q(s, ·), Q(s′, ·) or Q⁻(s, ·), or Q(s, ·) after the update.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum QValues {
    Current,
    Next,
    Target,
    After,
}

/// What the losses are divided by.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reduction {
    Mean,
    Sum,
    MeanOverOutputs,
}

/// The outputs that get a sample's gradient.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reached {
    Compared,
    /// The one behind it, by so many.
    Shifted(usize),
    All,
}

/// How a long gradient is shortened.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Clipping {
    Norm,
    Nothing,
    /// Every element to this size.
    Value(f64),
    /// Every tensor on its own.
    EveryTensor,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Optimizer {
    Adam,
    /// Without the divisions by 1 − βᵗ.
    AdamUncorrected,
    RmsProp,
    Sgd,
    Nothing,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Decay {
    None,
    /// θ ← θ − α d θ, beside Adam's step (Loshchilov and Hutter 2019).
    Decoupled(f64),
    /// g ← g + d θ
    Squared(f64),
}

impl Variant {
    pub fn right(update: &Update) -> Self {
        let settings = update.settings;
        let decay = settings.weight_decay();
        let Update { batch, before, target, online, adam, .. } = update;
        Self {
            settings,
            activations: LayerKinds::RIGHT,
            queried: QValues::Current,
            reward: Reward::Whole,
            discount: Discount::Own,
            mask: Mask::Terminated,
            reward_is_masked: false,
            bootstrap: if settings.double { NextValue::Double } else { NextValue::Max },
            from_online: target.is_none(),
            from_current: false,
            square: None,
            loss: match settings.loss {
                Loss::Mse => Penalty::Square,
                Loss::Huber => Penalty::Huber(settings.huber_delta),
            },
            predicted: Predicted::Taken,
            predicted_from: QValues::Current,
            reduction: Reduction::Mean,
            is_halved: false,
            is_weighted: batch.weights.is_some(),
            through_target: false,
            reached: Reached::Compared,
            is_accumulated: false,
            clipping: match (settings.max_gradient_norm, settings.clip_value) {
                (Some(_), _) => Clipping::Norm,
                (None, Some(limit)) => Clipping::Value(limit),
                (None, None) => Clipping::Nothing,
            },
            norm_margin: None,
            optimizer: match settings.optimizer {
                OptimizerName::Adam | OptimizerName::AdamW => Optimizer::Adam,
                OptimizerName::RmsProp => Optimizer::RmsProp,
                OptimizerName::Sgd => Optimizer::Sgd,
            },
            is_ascent: false,
            buffer_scale: 1.0,
            step: adam.steps + 1,
            decay: match settings.optimizer {
                _ if decay == 0.0 => Decay::None,
                OptimizerName::AdamW => Decay::Decoupled(decay),
                _ => Decay::Squared(decay),
            },
            overwritten: 0.0,
            given: Given {
                target: target.is_some(),
                target_is_online: target.as_ref() == Some(online),
                n_step: batch.discounts.iter().any(|&discount| (discount - settings.gamma).abs() > 1e-6),
                gradient_before: before.is_some() || adam.steps == 1,
            },
            fitted: Fitted { clip_value: settings.max_gradient_norm.unwrap_or(1.0), ..Fitted::default() },
        }
    }

    /// The ways of computing an update that are right: where frameworks differ, and the settings do not say it.
    pub(super) fn all_right(update: &Update) -> Vec<Self> {
        let right = Self::right(update);
        let mut all = vec![right];
        if let Penalty::Huber(delta) = right.loss
            && delta != 1.0
        {
            all.push(Self { loss: Penalty::SmoothL1(delta), ..right });
        }
        if right.settings.momentum > 0.0 {
            let scaled = |one: &Self| Self { buffer_scale: 1.0 / (1.0 - one.settings.momentum), ..*one };
            all.extend(all.iter().map(scaled).collect::<Vec<_>>());
        }
        all
    }

    pub(super) fn is_adam(&self) -> bool {
        matches!(self.optimizer, Optimizer::Adam | Optimizer::AdamUncorrected)
    }
}
