//! Why a baseline cannot be fitted or evaluated.

use serde::{Deserialize, Serialize};
use std::fmt;

/// Reason why a baseline cannot be fitted or evaluated; a worker process sends it as JSON.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct BaselineError {
    /// Kind of the reason.
    pub cause: BaselineCause,
    /// A sentence for people.
    pub message: String,
}

/// Kinds of reasons why there is no baseline.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BaselineCause {
    /// Rows that do not determine the model: none, of other lengths, or with dependent columns.
    Rows,
    /// A library that failed or panicked, or whose model cannot be evaluated.
    Library,
    /// Predictions that are not finite.
    NotFinite,
    /// More terms or nodes than a model may have.
    TooLarge,
    /// A predicted standard deviation of a model that has none.
    NoDeviation,
}

impl BaselineError {
    /// An error of a cause.
    pub fn new(cause: BaselineCause, message: impl Into<String>) -> Self {
        Self { cause, message: message.into() }
    }

    /// Error of a library, in its words.
    pub(crate) fn library(error: impl fmt::Display) -> Self {
        Self::new(BaselineCause::Library, error.to_string())
    }

    /// Error of a forest whose nodes cannot be numbered.
    pub(crate) fn too_many_nodes(_: std::num::TryFromIntError) -> Self {
        Self::new(BaselineCause::TooLarge, "more than 4 billion nodes")
    }
}

impl fmt::Display for BaselineError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for BaselineError {}
