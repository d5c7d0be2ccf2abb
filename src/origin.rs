//! Where a study or mechanism comes from: finds the line of a dotted key, so that mistakes can be located.

use crate::{Error, Result};
use serde::de::DeserializeOwned;
use std::{
    fmt,
    path::{Path, PathBuf},
};
use toml::{Spanned, de::DeTable, de::DeValue};

/// One mistake in a study or mechanism file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Problem {
    /// The file.
    pub path: PathBuf,
    /// Line, counted from 1.
    pub line: usize,
    /// Dotted key, for instance `parameters.L.max`; empty if the text is no TOML.
    pub key: String,
    /// What was found and what was expected.
    pub message: String,
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { path, line, key, message } = self;
        let key = if key.is_empty() { String::new() } else { format!("{key}: ") };
        write!(f, "{}:{line}: {key}{message}", path.display())
    }
}

/// The file a study or mechanism was read from.
#[derive(Clone, Debug, Default)]
pub(crate) struct Origin {
    path: PathBuf,
    text: String,
}

impl Origin {
    pub(crate) fn new(path: &Path, text: &str) -> Self {
        Self { path: path.to_owned(), text: text.to_owned() }
    }

    /// The folder of the file.
    pub(crate) fn folder(&self) -> &Path {
        self.path.parent().unwrap_or(Path::new(""))
    }

    /// Reads the text as a `T`; syntax errors, unknown keys and wrong types are located.
    pub(crate) fn deserialize<T: DeserializeOwned>(&self) -> Result<T> {
        let deserializer = toml::Deserializer::parse(&self.text).map_err(|error| self.toml_error(&error, ""))?;
        serde_path_to_error::deserialize(deserializer).map_err(|error| {
            let key = match error.path().to_string() {
                root if root == "." => String::new(),
                key => key,
            };
            self.toml_error(error.inner(), &key)
        })
    }

    /// Fails if there are problems, each a dotted key and what is wrong with it.
    pub(crate) fn refuse(&self, problems: Vec<(String, String)>) -> Result<()> {
        if problems.is_empty() {
            return Ok(());
        }
        let locate = |(key, message): (String, String)| {
            let line = self.line_at(self.offset_of(&key));
            Problem { path: self.path.clone(), line, key, message }
        };
        Err(Error::Study { problems: problems.into_iter().map(locate).collect() })
    }

    fn toml_error(&self, error: &toml::de::Error, key: &str) -> Error {
        let span = error.span().unwrap_or(0..0);
        // for an unknown key the path ends at its table; the span is the key itself
        let unknown = error.message().starts_with("unknown field");
        let last = self.text.get(span.clone()).filter(|_| unknown).map(str::trim);
        let key = match last {
            Some(last) if key.split('.').next_back() != Some(last) => {
                if key.is_empty() {
                    last.to_owned()
                } else {
                    format!("{key}.{last}")
                }
            }
            _ => key.to_owned(),
        };
        let message = error.message().replace('\n', ", ");
        let problem = Problem { path: self.path.clone(), line: self.line_at(span.start), key, message };
        Error::Study { problems: vec![problem] }
    }

    /// Byte offset of the longest part of a dotted key that is in the text.
    fn offset_of(&self, key: &str) -> usize {
        let Ok(root) = DeTable::parse(&self.text) else { return 0 };
        let (mut table, mut rest, mut offset) = (root.get_ref(), key, 0);
        // variable names may contain dots, so whole names are tried instead of splitting
        loop {
            let names = table.iter().filter(|(name, _)| begins_with(rest, name.get_ref()));
            let Some((name, value)) = names.max_by_key(|(name, _)| name.get_ref().len()) else { break };
            offset = name.span().start;
            rest = rest[name.get_ref().len()..].trim_start_matches('.');
            match Spanned::get_ref(value) {
                DeValue::Table(inner) if !rest.is_empty() => table = inner,
                _ => break,
            }
        }
        offset
    }

    fn line_at(&self, offset: usize) -> usize {
        self.text.get(..offset).map_or(1, |before| before.matches('\n').count() + 1)
    }
}

/// Whether `key` is `name` or goes on with a dot after it.
fn begins_with(key: &str, name: &str) -> bool {
    key.strip_prefix(name).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
}
