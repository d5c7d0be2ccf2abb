//! Errors of models that are imported: the place in the model, and the kind of reason.

use super::builder::GraphError;
use crate::Error;
use std::{fmt, path::Path};

/// Reason why a model cannot be imported.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ImportError {
    /// Kind of the reason.
    pub cause: ImportCause,
    /// Part of the model that it lies in; none if it is no single part's.
    pub place: Option<ImportPlace>,
    /// A sentence for people, which names the part.
    pub message: String,
}

/// Kinds of reasons.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImportCause {
    /// Against the rules of the format: other programs refuse the file, too.
    Malformed,
    /// Allowed by the format, but not supported here: another export of the model may help.
    Unsupported,
    /// More numbers, dimensions or nodes than the limits allow.
    TooLarge,
    /// A constant or a result that is NaN or infinite, or grows without bound.
    NotFinite,
    /// A file with data of the model that cannot be read, or that lies outside of the model's folder.
    Unreadable,
}

/// Parts of a model.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ImportPlace {
    /// An input by its name.
    Input(String),
    /// An output by its name.
    Output(String),
    /// Nodes with the same operator: several only if the operator is unknown.
    Nodes(Vec<NodePlace>),
    /// A constant of a graph by its name.
    Initializer(String),
    /// An array of a file that has only arrays, by its name.
    Array(String),
}

/// A node of a graph.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NodePlace {
    /// Position in the graph.
    pub number: usize,
    /// Name, which may be empty.
    pub name: String,
    /// Operator without its domain.
    pub operator: String,
}

impl ImportError {
    /// A part that is against the rules of the format.
    pub(super) fn malformed(message: impl Into<String>) -> Self {
        Self::new(ImportCause::Malformed, message)
    }

    /// A part that is not supported here.
    pub(super) fn unsupported(message: impl Into<String>) -> Self {
        Self::new(ImportCause::Unsupported, message)
    }

    /// A part that is beyond a limit.
    pub(super) fn too_large(message: impl Into<String>) -> Self {
        Self::new(ImportCause::TooLarge, message)
    }

    /// A part that has or makes NaN or infinity.
    pub(super) fn not_finite(message: impl Into<String>) -> Self {
        Self::new(ImportCause::NotFinite, message)
    }

    /// A file next to the model that is not read.
    pub(super) fn unreadable(message: impl Into<String>) -> Self {
        Self::new(ImportCause::Unreadable, message)
    }

    fn new(cause: ImportCause, message: impl Into<String>) -> Self {
        Self { cause, place: None, message: message.into() }
    }

    /// Error of a part whose message starts with the part.
    pub(super) fn at(self, place: ImportPlace) -> Self {
        self.behind(&place).naming(place)
    }

    /// Error whose message starts with something that it lies in.
    pub(super) fn behind(self, part: &impl fmt::Display) -> Self {
        Self { message: format!("{part}: {}", self.message), ..self }
    }

    /// Error of a part that the message names already.
    pub(super) fn naming(self, place: ImportPlace) -> Self {
        Self { place: Some(place), ..self }
    }

    /// For `map_err`: one or several problems become the error of a model file.
    pub fn of_file<E: Into<Vec<Self>>>(path: &Path) -> impl FnOnce(E) -> Error {
        move |problems| {
            let problems = problems.into().iter().map(Self::to_string).collect();
            Error::Import { path: path.to_owned(), problems }
        }
    }
}

impl fmt::Display for ImportError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for ImportError {}

/// The problems of a model that has a single one.
impl From<ImportError> for Vec<ImportError> {
    fn from(error: ImportError) -> Self {
        vec![error]
    }
}

/// A graph that cannot be built of a model.
impl From<GraphError> for ImportError {
    fn from(error: GraphError) -> Self {
        let cause = match error {
            GraphError::TooLarge { .. } => ImportCause::TooLarge,
            GraphError::Width { .. } | GraphError::Format(_) => ImportCause::Malformed,
            GraphError::NotFinite(_) => ImportCause::NotFinite,
        };
        Self::new(cause, error.to_string())
    }
}

impl fmt::Display for ImportPlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Input(name) => write!(f, "input `{name}`"),
            Self::Output(name) => write!(f, "output `{name}`"),
            Self::Nodes(nodes) => f.write_str(&listed(nodes)),
            Self::Initializer(name) => write!(f, "initializer `{name}`"),
            Self::Array(name) => write!(f, "`{name}`"),
        }
    }
}

/// Largest number of nodes that a message names.
const MAX_LISTED: usize = 20;

fn listed(nodes: &[NodePlace]) -> String {
    let titles: Vec<String> = nodes.iter().take(MAX_LISTED).map(NodePlace::to_string).collect();
    let titles: Vec<&str> = titles.iter().map(String::as_str).collect();
    crate::diagnostics::names::listed(&titles)
}

impl fmt::Display for NodePlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { number, name, operator } = self;
        match name.as_str() {
            "" => write!(f, "node {number} ({operator})"),
            name => write!(f, "node {number} `{name}` ({operator})"),
        }
    }
}
