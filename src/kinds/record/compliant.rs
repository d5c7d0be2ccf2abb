//! Record of the fit of a compliant element.

use super::{Candidate, list};
use serde::{Deserialize, Serialize};

/// Result of a fit to the rows of runs.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct CompliantRecord {
    /// Degrees of the potential and of the dissipation that were compared, each with the error on held-out runs.
    pub candidates: Vec<Candidate>,
    /// The degrees that are exported.
    pub exported: String,
    /// Number of coefficients of the potential and of the dissipation.
    pub coefficients: usize,
}

impl CompliantRecord {
    /// Description of the fit as text.
    pub(crate) fn describe(&self) -> String {
        let Self { candidates, exported, coefficients } = self;
        format!(
            "relative errors on held-out runs: {}; exported: {exported}, {coefficients} coefficients",
            list(candidates)
        )
    }
}
