//! Why a motion, or the equations of one, cannot be computed.

use crate::integrate::{BudgetError, StopCause};
use metafmu_runtime::FormatError;
use std::fmt;

/// Reason why a motion, or the equations of one, cannot be computed, and where in the mechanism it lies.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MotionError {
    /// Kind of the reason.
    pub cause: MotionCause,
    /// Key in the mechanism file of the part that it lies in, such as `forces.wind`; none if it is no single part's.
    pub part: Option<String>,
    /// A sentence for people.
    pub message: String,
}

/// Kinds of reasons.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MotionCause {
    /// A position in which constraints depend on each other, or in which the independent coordinates do not decide the others.
    Singular,
    /// Constraints or conditions that no position or velocity meets, or that are decided twice.
    Inconsistent,
    /// A force, motion, direction or output that is not a finite number.
    Undefined,
    /// A part, name or number of coordinates that equations in independent coordinates do not allow.
    Unsuitable,
    /// The solver failed, or has no solution to find.
    Unsolved,
    /// The run needs too many evaluations, or was stopped.
    GivenUp,
    /// The run took longer than the study's `source.time_limit`.
    TimeLimit,
}

impl MotionError {
    /// A reason that lies in no single part.
    pub fn new(cause: MotionCause, message: impl Into<String>) -> Self {
        Self { cause, part: None, message: message.into() }
    }

    /// A reason that lies in a part.
    pub fn of(part: &str, cause: MotionCause, message: impl Into<String>) -> Self {
        Self { cause, part: Some(part.to_owned()), message: message.into() }
    }

    /// Error of the same cause and part in other words.
    #[must_use]
    pub fn with_message(self, message: impl Into<String>) -> Self {
        Self { message: message.into(), ..self }
    }

    /// Section of the mechanism file that the reason lies in, such as `forces`.
    pub fn section(&self) -> Option<&str> {
        self.part.as_deref().map(|part| part.split_once('.').map_or(part, |(section, _)| section))
    }
}

impl fmt::Display for MotionError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for MotionError {}

/// Functions of which no equations can be made.
impl From<FormatError> for MotionError {
    fn from(error: FormatError) -> Self {
        Self::new(MotionCause::Unsuitable, error.to_string())
    }
}

impl From<BudgetError> for MotionError {
    fn from(error: BudgetError) -> Self {
        let cause = match error.cause {
            StopCause::TimeLimit => MotionCause::TimeLimit,
            StopCause::Stopped | StopCause::Evaluations => MotionCause::GivenUp,
        };
        Self::new(cause, error.message)
    }
}

impl From<MotionError> for String {
    fn from(error: MotionError) -> Self {
        error.message
    }
}
