//! The one error type: every message says where, what was found and what was expected.

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
