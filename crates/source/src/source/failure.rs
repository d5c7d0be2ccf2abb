//! Failures of runs.

use crate::{
    integrate::{BudgetError, IntegrationError, StopCause},
    multibody::{MotionCause, MotionError},
    systems::SystemError,
};
use serde::{Deserialize, Serialize};
use std::fmt;

/// Reason why a run of a source has no outputs.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RunFailure {
    /// Kind of the reason.
    pub cause: FailureCause,
    /// A sentence for people.
    pub message: String,
}

/// Kinds of reasons why a run fails.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FailureCause {
    /// The model has no outputs for these values: its equations, the FMU or the program reported an error, or a number was not finite.
    Model,
    /// The process of an FMU or program ended, could not be started, or sent a reply that makes no sense.
    Process,
    /// The run needs too many evaluations, or was stopped.
    GivenUp,
    /// The run took longer than `source.time_limit`.
    TimeLimit,
}

impl RunFailure {
    /// A failure of a cause.
    pub fn new(cause: FailureCause, message: impl Into<String>) -> Self {
        Self { cause, message: message.into() }
    }

    /// A reply that is none to the request.
    pub(super) fn senseless_reply() -> Self {
        Self::new(FailureCause::Process, "the worker's reply made no sense")
    }
}

impl From<MotionError> for RunFailure {
    fn from(error: MotionError) -> Self {
        let cause = match error.cause {
            MotionCause::GivenUp => FailureCause::GivenUp,
            MotionCause::TimeLimit => FailureCause::TimeLimit,
            MotionCause::Singular
            | MotionCause::Inconsistent
            | MotionCause::Undefined
            | MotionCause::Unsuitable
            | MotionCause::Unsolved => FailureCause::Model,
        };
        Self { cause, message: error.message }
    }
}

impl From<SystemError> for RunFailure {
    fn from(error: SystemError) -> Self {
        let cause = match &error {
            SystemError::Integration(IntegrationError::GivenUp(BudgetError {
                cause: StopCause::TimeLimit, ..
            })) => FailureCause::TimeLimit,
            SystemError::Integration(IntegrationError::GivenUp(_)) => FailureCause::GivenUp,
            SystemError::Integration(_)
            | SystemError::Count { .. }
            | SystemError::ShortRod { .. }
            | SystemError::NotFinite => FailureCause::Model,
        };
        Self::new(cause, error.to_string())
    }
}

impl fmt::Display for RunFailure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for RunFailure {}
