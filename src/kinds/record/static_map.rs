//! Record of the fit of a static map.

use super::{Candidate, list};
use crate::evaluation::TestRows;
use serde::{Deserialize, Serialize};

/// Result of a fit to the rows of a table.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct StaticRecord {
    /// The kinds of model that were measured on unseen rows, each with the square root of the mean over outputs of `1 - R²`.
    pub candidates: Vec<Candidate>,
    /// The kind that is exported.
    pub exported: String,
    /// Rows of the table, without those that repeat others.
    pub rows: usize,
    /// Wall time of reading them.
    pub read_seconds: f64,
    /// Method by which the unseen rows were chosen.
    pub unseen: TestRows,
    /// Number of the unseen rows.
    pub unseen_rows: usize,
    /// SHA-256 of their table.
    pub unseen_digest: String,
}

impl StaticRecord {
    /// Description of the fit as text.
    pub(crate) fn describe(&self) -> String {
        let exported = &self.exported;
        format!("relative errors on unseen rows: {}; exported: {exported}", list(&self.candidates))
    }
}
