//! Training: turns rows into a network.
//!
//! The loss is a mean over rows and outputs of a function of the standardized outputs' errors, their square by default.
//! Each epoch passes once through all training rows in a new random order, in batches of (nearly) equal size with one
//! optimizer step each. It ends with the loss on the held-out validation rows. The network with the smallest validation
//! loss is the result.
//!
//! Rows with a [`Recurrence`] are trained by stretches: what the network gives at one row is an input of the rows that follow.
//!
//! Few rows are learned by small networks in double precision, by Levenberg-Marquardt steps: [`train_small`].
//!
//! The same rows, options, seed and processor give the same bits for any number of threads.

mod bayesian;
mod checkpoint;
mod damping;
pub mod drawn;
mod gradient;
mod history;
mod loss;
mod optimizer;
mod pace;
mod recurrence;
mod rows;
mod run;
mod schedule;
mod team;
mod trainer;

pub use bayesian::{FewRows, IterationFollower, SmallNetwork, train_small};
pub use damping::Damping;
pub use history::{joined, read_history, write_history};
pub use rows::{Recurrence, Tangents, TrainingRows, without_constants};
pub use run::{resume, train};
pub use trainer::Trainer;

use crate::network::Network;
use serde::{Deserialize, Serialize};
use std::{fmt, ops::ControlFlow};

/// Follows a training, and may end it.
pub trait Observer: Send {
    /// Called after every optimizer step, thus often and from within the loop: to be quick about it. The training ends
    /// with [`StopReason::Interrupted`] if it breaks.
    fn step(&mut self, progress: &Progress) -> ControlFlow<()>;

    /// Called before the first step of a training that continues from a checkpoint, with the epochs before it.
    fn resumed(&mut self, history: &[EpochRecord]) {
        let _ = history;
    }

    /// Called at the end of every epoch.
    fn epoch(&mut self, record: &EpochRecord);

    /// Called after every epoch. [`resume`] continues from what `make` returns; it costs a copy of the network and of the
    /// optimizer's memory.
    fn checkpoint(&mut self, epoch: usize, make: &mut dyn FnMut() -> Result<Vec<u8>, TrainingError>) {
        let _ = (epoch, make);
    }
}

/// Follows nothing and never ends the training.
impl Observer for () {
    fn step(&mut self, _: &Progress) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }

    fn epoch(&mut self, _: &EpochRecord) {}
}

/// The state of a training.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Epoch under way, counted from 1.
    pub epoch: usize,
    /// Requested epochs.
    pub epochs: usize,
    /// Steps done in this epoch.
    pub step: usize,
    /// Steps of an epoch.
    pub steps: usize,
    /// Training loss, the mean over the steps done in this epoch.
    pub loss: f64,
}

/// One epoch: a row of the history.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EpochRecord {
    /// Counted from 1.
    pub epoch: usize,
    /// Mean over the epoch's rows, each with the parameters of its step.
    pub train_loss: f64,
    /// Mean over the validation rows with the parameters at the end of the epoch.
    pub validation_loss: f64,
    /// Learning rate of the epoch's last step.
    pub learning_rate: f64,
    /// Wall time since the training began, in seconds.
    pub seconds: f64,
    /// `true` if no earlier epoch had a validation loss as small.
    pub best: bool,
}

/// Reason for the end of a training.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum StopReason {
    /// All epochs are done.
    #[serde(rename = "all epochs done")]
    Finished,
    /// Too many epochs without a better validation loss, or a cycle that gained little.
    #[serde(rename = "no more improvement")]
    Patience,
    /// The validation loss stayed far above the best one while the training loss was below that of the best epoch.
    #[serde(rename = "overfitting: the loss on held-out runs rose")]
    Overfitted,
    /// The validation loss at the end of a cycle is as small as requested.
    #[serde(rename = "good enough")]
    Enough,
    /// Too few epochs are left for another cycle.
    #[serde(rename = "too few epochs left to gain anything")]
    TooFewLeft,
    /// The observer requested it.
    #[serde(rename = "stopped by Ctrl-C")]
    Interrupted,
    /// The coefficients of a dictionary have no epochs: they are the solution of one least-squares problem.
    #[serde(rename = "least squares solved")]
    Solved,
    /// A loss was infinite or NaN.
    #[serde(rename = "the loss became infinite: lower the learning rate")]
    Diverged,
}

impl fmt::Display for StopReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// Result of a training.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// The network with the smallest validation loss. If there was no validation yet: the current network after an
    /// interruption, the given one after a divergence.
    pub network: Network,
    /// The epochs that were completed.
    pub history: Vec<EpochRecord>,
    /// The epoch that `network` is from; 0 if there was no validation yet.
    pub best_epoch: usize,
    /// Processor time of this process during the training in seconds, before an interruption included.
    pub processor_seconds: f64,
    /// Reason for the end of the training.
    pub reason: StopReason,
}

impl Outcome {
    /// The outcome, if an epoch was completed.
    ///
    /// # Errors
    /// [`TrainingError::NoEpoch`]: the network is not trained.
    pub fn completed(self) -> Result<Self, TrainingError> {
        if self.history.is_empty() { Err(TrainingError::NoEpoch { reason: self.reason }) } else { Ok(self) }
    }
}

/// Reason why a network cannot be trained.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum TrainingError {
    /// Input and output values that do not form the same number of whole rows.
    #[error("{inputs} input and {outputs} output values are not the same number of rows of {n_inputs} and {n_outputs}")]
    Shape {
        /// Input columns.
        n_inputs: usize,
        /// Output columns.
        n_outputs: usize,
        /// Input values.
        inputs: usize,
        /// Output values.
        outputs: usize,
    },
    /// A NaN or an infinity in the rows.
    #[error("row {row}, {what} column {column}: {value} is not finite")]
    NotFinite {
        /// `input` or `output`.
        what: &'static str,
        /// Counted from 0.
        row: usize,
        /// Counted from 0.
        column: usize,
        /// The value found.
        value: f32,
    },
    /// Nothing to train on, or nothing to validate with.
    #[error("there are no {set} rows")]
    NoRows {
        /// `training` or `validation`.
        set: &'static str,
    },
    /// More rows than can be numbered.
    #[error("{rows} training rows are too many, expected fewer than 2^32")]
    TooManyRows {
        /// Their number.
        rows: usize,
    },
    /// Rows that do not fit the network.
    #[error("the {set} rows have {found} {what} columns, the network has {expected}")]
    Columns {
        /// `training` or `validation`.
        set: &'static str,
        /// `input` or `output`.
        what: &'static str,
        /// In the rows.
        found: usize,
        /// In the network.
        expected: usize,
    },
    /// A checkpoint that cannot be written or resumed.
    #[error("the checkpoint cannot be used: {problem}")]
    Checkpoint {
        /// The problem.
        problem: String,
    },
    /// A training that ended before its first epoch was complete.
    #[error("no epoch was completed: {reason}")]
    NoEpoch {
        /// Reason for the end.
        reason: StopReason,
    },
    /// An option that makes no sense.
    #[error("training option `{name}`: {problem}")]
    Option {
        /// The option's key in the study file.
        name: String,
        /// Given and expected values.
        problem: String,
    },
}

impl From<TrainingError> for crate::Error {
    fn from(error: TrainingError) -> Self {
        match error {
            TrainingError::NoEpoch { reason: StopReason::Interrupted } => Self::Interrupted,
            error => Self::Training(Box::new(error)),
        }
    }
}
