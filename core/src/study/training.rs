//! `[training]`: how the network is trained.

use crate::diagnostics::Problems;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `[training]`: how the network is trained.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct TrainingOptions {
    /// Loss function that the training minimizes.
    pub loss: Loss,
    /// Loss "huber": error, in standard deviations, above which it grows linearly.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub huber_delta: f64,
    /// Weights of the outputs in the loss, in the order of the outputs; empty: all 1.
    #[schemars(inner(range(min = 0)))]
    pub output_weights: Vec<f64>,
    /// Rule that turns gradients into parameter updates.
    pub optimizer: Optimizer,
    /// Share of the mean gradient that is kept from step to step: SGD's momentum, β1 of the others. Without it, the
    /// optimizer's own: 0.9, of SOAP 0.95, of RMSprop none.
    #[schemars(range(min = 0), extend("exclusiveMaximum" = 1))]
    pub momentum: Option<f64>,
    /// Share of the mean squared gradient that is kept from step to step: RMSprop's α, β2 of the others. Without it,
    /// the optimizer's own: 0.99 of RMSprop, 0.999 of Adam and AdamW, 0.95 of SOAP.
    #[schemars(range(min = 0), extend("exclusiveMaximum" = 1))]
    pub beta2: Option<f64>,
    /// Optimizer "soap": steps between two refreshes of its eigenbases.
    #[schemars(range(min = 1))]
    pub refresh: u64,
    /// Highest learning rate.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub learning_rate: f64,
    /// How the learning rate changes over the training. Of the structure "static" "cosine" unless given.
    pub schedule: Schedule,
    /// Share of the training in which the learning rate rises linearly from nearly zero (of the one-cycle schedule:
    /// along half a cosine). Without it, the schedule's own: 0.03 of the cosine, 0.3 of one-cycle, 0 of the others.
    #[schemars(range(min = 0), extend("exclusiveMaximum" = 1))]
    pub warm_up: Option<f64>,
    /// Rows per optimizer step. Of the structure "static" 256 unless given.
    #[schemars(range(min = 1))]
    pub batch: usize,
    /// Largest number of passes over the training rows, 1 to 1,000,000. Of the structure "static" unless given as many as make 2000
    /// optimizer steps, at least 150.
    #[schemars(range(min = 1, max = MAX_EPOCHS))]
    pub epochs: usize,
    /// Share of the training runs, of the structure "static" of the rows, that is held out to choose the best epoch, between 0 and 1.
    #[schemars(extend("exclusiveMinimum" = 0, "exclusiveMaximum" = 1))]
    pub validation: f64,
    /// Schedules other than "restarts": stop after this many epochs without a better validation loss; 0: never.
    pub patience: usize,
    /// Schedule "restarts": validation loss, about 1 - R², at which a cycle is the last; 1e-7 unless given. A cycle is
    /// also the last if it hardly improves on the one before: by less than a quarter, if it was twice as long. This
    /// applies from the third cycle on, to cycles of at least 100 optimizer steps. The training also ends when, for 5
    /// epochs and 50 steps, the loss on held-out runs stays above 1.5 times the best one while the training loss falls.
    #[schemars(range(min = 0))]
    pub enough: Option<f64>,
    /// Weight of the sum of all parameters' magnitudes in the loss.
    #[schemars(range(min = 0))]
    pub l1: f64,
    /// Weight of half the sum of all parameters' squares in the loss.
    #[schemars(range(min = 0))]
    pub l2: f64,
    /// Optimizers "adamw" and "soap": decay of a parameter in a step, relative to itself and to the learning rate.
    #[schemars(range(min = 0))]
    pub weight_decay: f64,
    /// Share of the hidden nodes that is left out in a step, others in each row; at least 0 and below 1.
    #[schemars(range(min = 0), extend("exclusiveMaximum" = 1))]
    pub dropout: f64,
    /// `true` if hidden layers are normalized over the rows of a block. In the FMU, weights and biases contain the
    /// normalization.
    pub batch_norm: bool,
    /// Longer gradients are shortened to this length; 0: none is. Of the structure "discrete" 1 unless given.
    #[schemars(range(min = 0))]
    pub clip_norm: f64,
}

/// Loss function: the mean over rows and outputs of a function of the error `e` of the standardized output.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Loss {
    /// `e²`
    Mse,
    /// `|e|`
    Mae,
    /// `e² / 2` up to `|e| = δ`, `δ (|e| - δ / 2)` above.
    Huber,
}

/// Rule that turns gradients into parameter updates.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Optimizer {
    /// Gradient descent with momentum: `m = μ m + g`, `p -= rate m`.
    Sgd,
    /// Tieleman and Hinton 2012: `v = α v + (1 - α) g²`, `p -= rate g / (√v + ε)`.
    RmsProp,
    /// Kingma and Ba, arXiv:1412.6980.
    Adam,
    /// Loshchilov and Hutter, arXiv:1711.05101: Adam with a weight decay beside the gradient.
    AdamW,
    /// Vyas and others, arXiv:2409.11321: Adam in the eigenbasis of Shampoo's preconditioner.
    Soap,
}

/// How the learning rate changes over the training.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Schedule {
    /// Always the same.
    Constant,
    /// A tenth after each third of the training.
    Step,
    /// Half a cosine down to (nearly) zero.
    Cosine,
    /// Loshchilov and Hutter, arXiv:1608.03983 (SGDR): half a cosine down to (nearly) zero in each cycle. The first
    /// cycle takes a thirtieth of the epochs, the second a fifteenth. Each later cycle is twice as long as the one
    /// before, or as long as the losses so far predict for `enough`, if that is longer. The training ends at that
    /// validation loss, when a cycle gains nothing any more, or with the epochs.
    Restarts,
    /// Smith and Topin, arXiv:1708.07120: half a cosine up from a 25th of the learning rate, then half a cosine down to (nearly) zero.
    OneCycle,
}

impl Default for TrainingOptions {
    fn default() -> Self {
        Self {
            loss: Loss::Mse,
            huber_delta: 1.0,
            output_weights: Vec::new(),
            optimizer: Optimizer::Soap,
            momentum: None,
            beta2: None,
            refresh: 10,
            learning_rate: 5e-3,
            schedule: Schedule::Restarts,
            warm_up: None,
            batch: 1024,
            epochs: 150,
            validation: 0.1,
            patience: 0,
            enough: None,
            l1: 0.0,
            l2: 0.0,
            weight_decay: 0.0,
            dropout: 0.0,
            batch_norm: false,
            clip_norm: 0.0,
        }
    }
}

/// Epochs of a training, all of which are in its history.
pub(super) const MAX_EPOCHS: usize = 1_000_000;

impl TrainingOptions {
    /// Options for networks in the equations of motion of a mechanism. Their samples are exact, and errors add up along
    /// a motion, so that the last digits count.
    pub fn of_equations() -> Self {
        Self { learning_rate: 1e-2, schedule: Schedule::Cosine, batch: 256, epochs: 600, ..Self::default() }
    }

    /// Options for networks of static maps: with few rows, the losses of restarts rise and fall too much to judge by.
    pub(super) fn of_rows() -> Self {
        Self { schedule: Schedule::Cosine, batch: 256, ..Self::default() }
    }

    /// Every mistake, by key within the section.
    pub fn problems(&self) -> Problems {
        let mut problems = Problems::default();
        self.add_limits(&mut problems);
        self.add_idle(&mut problems);
        problems
    }

    /// Problems with this number of outputs, by key within the section.
    pub fn problems_beside(&self, outputs: usize) -> Problems {
        let mut problems = Problems::default();
        let weights = self.output_weights.len();
        let fits = weights == 0 || weights == outputs;
        problems.expect(fits, "output_weights", format!("{weights} weights"), "one for each output or none");
        problems
    }

    /// Values beyond their limits.
    fn add_limits(&self, problems: &mut Problems) {
        let not_negative = |value: f64| value >= 0.0 && value.is_finite();
        let is_share = |value: f64| (0.0..1.0).contains(&value);
        let share = "a share of at least 0 and below 1";
        problems.expect_positive("learning_rate", self.learning_rate);
        problems.expect_positive("huber_delta", self.huber_delta);
        let Self { l1, l2, weight_decay, clip_norm, .. } = *self;
        for (key, value) in [("l1", l1), ("l2", l2), ("weight_decay", weight_decay), ("clip_norm", clip_norm)] {
            problems.expect(not_negative(value), key, value, "0 or a positive number");
        }
        problems.expect(is_share(self.dropout), "dropout", self.dropout, share);
        for (key, value) in [("momentum", self.momentum), ("beta2", self.beta2), ("warm_up", self.warm_up)] {
            let value = value.unwrap_or(0.0);
            problems.expect(is_share(value), key, value, share);
        }
        let held_out = self.validation > 0.0 && self.validation < 1.0;
        problems.expect(held_out, "validation", self.validation, "a share between 0 and 1");
        problems.expect(self.batch > 0, "batch", self.batch, "at least 1 row");
        let norm = !self.batch_norm || self.batch != 1;
        problems.expect(
            norm,
            "batch",
            self.batch,
            "at least 2 rows with `batch_norm`, which is over the rows of a batch",
        );
        let epochs = format!("1 to {MAX_EPOCHS}");
        problems.expect((1..=MAX_EPOCHS).contains(&self.epochs), "epochs", self.epochs, &epochs);
        problems.expect(self.refresh > 0, "refresh", self.refresh, "at least 1 step");
        let enough = self.enough.unwrap_or(0.0);
        problems.expect(not_negative(enough), "enough", enough, "0 or a positive number");

        let weights = &self.output_weights;
        let good = weights.iter().all(|&weight| not_negative(weight));
        let some = weights.is_empty() || weights.iter().any(|&weight| weight > 0.0);
        let found = format!("{weights:?}");
        problems.expect(good && some, "output_weights", found, "no negative numbers, and not only zeros");
    }

    /// Options that other choices have no use for.
    fn add_idle(&self, problems: &mut Problems) {
        let (optimizer, defaults) = (self.optimizer, Self::default());
        let restarts = self.schedule == Schedule::Restarts;
        problems.expect_absent(
            self.weight_decay > 0.0 && !matches!(optimizer, Optimizer::AdamW | Optimizer::Soap),
            "weight_decay",
            "belongs to the optimizers \"adamw\" and \"soap\"; the others have `l2`",
        );
        problems.expect_absent(self.enough.is_some() && !restarts, "enough", "belongs to the schedule \"restarts\"");
        problems.expect_absent(
            self.patience > 0 && restarts,
            "patience",
            "belongs to the other schedules: one with restarts ends when its cycles gain nothing any more",
        );
        problems.expect_absent(
            self.beta2.is_some() && optimizer == Optimizer::Sgd,
            "beta2",
            "belongs to the other optimizers: \"sgd\" has `momentum` only",
        );
        problems.expect_absent(
            self.refresh != defaults.refresh && optimizer != Optimizer::Soap,
            "refresh",
            "belongs to the optimizer \"soap\"",
        );
        problems.expect_absent(
            self.huber_delta != defaults.huber_delta && self.loss != Loss::Huber,
            "huber_delta",
            "belongs to the loss \"huber\"",
        );
    }

    /// Number of training runs that are held out for validation out of `runs`: at least one, and not all.
    pub fn held_out(&self, runs: usize) -> usize {
        ((self.validation * runs as f64).round() as usize).clamp(1, runs.saturating_sub(1).max(1))
    }

    /// The others.
    pub(super) fn held_in(&self, runs: usize) -> usize {
        runs - self.held_out(runs).min(runs)
    }
}
