//! Where a study or mechanism comes from: finds the line of a dotted key, so that mistakes can be located.

use crate::{Error, Result};
use serde::de::DeserializeOwned;
use std::{
    borrow::Cow,
    fmt,
    ops::Range,
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
        toml::from_str(&self.text).map_err(|error: toml::de::Error| {
            let span = error.span().unwrap_or(0..0);
            let (line, message) = (self.line_at(span.start), error.message().replace('\n', ", "));
            let problem = Problem { path: self.path.clone(), line, key: self.key_at(&span), message };
            Error::Study { problems: vec![problem] }
        })
    }

    /// Fails if there are problems, each a dotted key and what is wrong with it.
    pub(crate) fn refuse(&self, problems: Vec<(String, String)>) -> Result<()> {
        if problems.is_empty() {
            return Ok(());
        }
        Err(Error::Study { problems: self.locate(problems) })
    }

    /// Gives dotted keys, each with a message, their lines.
    pub(crate) fn locate(&self, problems: Vec<(String, String)>) -> Vec<Problem> {
        let locate = |(key, message): (String, String)| {
            let line = self.line_at(self.offset_of(&key));
            Problem { path: self.path.clone(), line, key, message }
        };
        problems.into_iter().map(locate).collect()
    }

    /// Dotted keys of all arrays that are values of keys, and how many elements they have.
    pub(crate) fn array_lengths(&self) -> Vec<(String, usize)> {
        let mut lengths = Vec::new();
        if let Ok(root) = DeTable::parse(&self.text) {
            add_array_lengths(root.get_ref(), "", &mut lengths);
        }
        lengths
    }

    /// Dotted key of the innermost name or value that the span lies in; empty if there is none, or if the text is no TOML.
    fn key_at(&self, span: &Range<usize>) -> String {
        let root = DeTable::parse(&self.text).ok();
        root.and_then(|root| innermost(root.get_ref(), "", span)).map_or(String::new(), |(_, key)| key)
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

fn add_array_lengths(table: &DeTable, prefix: &str, lengths: &mut Vec<(String, usize)>) {
    for (name, value) in table.iter() {
        let key = format!("{prefix}{}", name.get_ref());
        match Spanned::get_ref(value) {
            DeValue::Array(elements) => lengths.push((key, elements.len())),
            DeValue::Table(inner) => add_array_lengths(inner, &format!("{key}."), lengths),
            _ => {}
        }
    }
}

/// The shortest span of a name or value in the table that `span` lies in: its length and its dotted key.
fn innermost(table: &DeTable, prefix: &str, span: &Range<usize>) -> Option<(usize, String)> {
    let separator = if prefix.is_empty() { "" } else { "." };
    let of_entry = |(name, value): (&Spanned<_>, &Spanned<DeValue>)| {
        let key = format!("{prefix}{separator}{}", Spanned::<Cow<str>>::get_ref(name));
        let by_name = around(&name.span(), span).map(|length| (length, key.clone()));
        by_name.into_iter().chain(innermost_of_value(value, &key, span)).min_by_key(|(length, _)| *length)
    };
    table.iter().filter_map(of_entry).min_by_key(|(length, _)| *length)
}

fn innermost_of_value(value: &Spanned<DeValue>, key: &str, span: &Range<usize>) -> Option<(usize, String)> {
    let inner = match value.get_ref() {
        DeValue::Table(table) => innermost(table, key, span),
        DeValue::Array(elements) => {
            let elements = elements.iter().enumerate();
            let of_element = |(index, element)| innermost_of_value(element, &format!("{key}[{index}]"), span);
            elements.filter_map(of_element).min_by_key(|(length, _)| *length)
        }
        _ => None,
    };
    // tables with a heading do not enclose their entries, so both are asked; of the same span the inner one counts
    let own = around(&value.span(), span).map(|length| (length, key.to_owned()));
    inner.into_iter().chain(own).min_by_key(|(length, _)| *length)
}

/// Length of `outer` if `inner` lies in it.
fn around(outer: &Range<usize>, inner: &Range<usize>) -> Option<usize> {
    (outer.start <= inner.start && inner.end <= outer.end).then_some(outer.len())
}

/// Whether `key` is `name` or goes on with a dot after it.
fn begins_with(key: &str, name: &str) -> bool {
    key.strip_prefix(name).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
}
