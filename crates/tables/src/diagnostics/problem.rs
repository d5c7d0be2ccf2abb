//! A mistake in a file, with the place where it is.

use std::{fmt, path::PathBuf};

/// One mistake in a study or mechanism file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Problem {
    /// The file; empty if it is of none.
    pub path: PathBuf,
    /// Line, counted from 1; 0 if the file has no lines.
    pub line: usize,
    /// Dotted key, for instance `parameters.L.max`; empty if the text is not TOML.
    pub key: String,
    /// Message: the value found and the value expected.
    pub message: String,
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { path, line, key, message } = self;
        let key = if key.is_empty() { String::new() } else { format!("{key}: ") };
        if path.as_os_str().is_empty() {
            return write!(f, "{key}{message}");
        }
        let line = if *line == 0 { String::new() } else { format!("{line}:") };
        write!(f, "{}:{line} {key}{message}", path.display())
    }
}
