//! The one error type: every message says where, what was found and what was expected.

use crate::study::Problem;
use std::path::{Path, PathBuf};

/// Everything that can go wrong in the tool.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file or folder could not be read or written.
    #[error("{}: cannot {action}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What was tried, for instance `read`.
        action: &'static str,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A study file is wrong.
    #[error("{}", problems.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n"))]
    Study {
        /// Every problem found.
        problems: Vec<Problem>,
    },
    /// A simulation failed.
    #[error("{system} with {values}: {message}")]
    Run {
        /// The source.
        system: &'static str,
        /// The parameter values.
        values: String,
        /// What happened.
        message: String,
    },
    /// Stopped by the user.
    #[error("stopped")]
    Interrupted,
    /// A table is wrong.
    #[error("{}:{line}: {message}", path.display())]
    Table {
        /// The table's file.
        path: PathBuf,
        /// Line, counted from 1.
        line: u64,
        /// What was found and what was expected.
        message: String,
    },
    /// A JSON file is wrong.
    #[error("{}: {source}", path.display())]
    Json {
        /// The file.
        path: PathBuf,
        /// How it is wrong.
        source: serde_json::Error,
    },
    /// The result of an earlier stage is missing or belongs to another study.
    #[error("{}: {message}", path.display())]
    Stale {
        /// The file.
        path: PathBuf,
        /// What to do about it.
        message: String,
    },
    /// A plot could not be made.
    #[error("{}: {message}", path.display())]
    Plot {
        /// The plot's file.
        path: PathBuf,
        /// Why.
        message: String,
    },
    /// A model file is wrong.
    #[error("{}: {source}", path.display())]
    Model {
        /// The model file.
        path: PathBuf,
        /// How it is wrong.
        source: metafmu_runtime::FormatError,
    },
    /// The network cannot be built.
    #[error(transparent)]
    Network(#[from] crate::network::NetworkError),
    /// The network cannot be trained.
    #[error(transparent)]
    Training(#[from] crate::training::TrainingError),
}

/// Result with the tool's error.
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// For `map_err`: wraps an I/O error with what was tried on which file.
    pub fn io(path: &Path, action: &'static str) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { path, action, source }
    }
}
