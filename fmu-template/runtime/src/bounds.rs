//! How far outputs may be from the truth.

use crate::FormatError;
use serde::{Deserialize, Serialize};

/// Split-conformal error bounds. Of a run that is drawn like those the bounds were measured on, the share `coverage` of the
/// rows is expected to have `|y - prediction| <= half_width`, for each output by itself.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Bounds {
    /// Stated share of rows, between 0 and 1.
    pub coverage: f64,
    /// Number of runs the bounds were measured on, seen neither in training nor in tests.
    pub runs: u64,
    /// The bound of each output, in its unit; not negative.
    pub half_widths: Vec<f64>,
}

impl Bounds {
    /// Makes sure that there is a bound for each of `outputs` outputs, and that they make sense.
    ///
    /// # Errors
    /// [`FormatError::BoundCount`] or [`FormatError::Bound`].
    pub(crate) fn check(&self, outputs: usize) -> Result<(), FormatError> {
        if self.half_widths.len() != outputs {
            return Err(FormatError::BoundCount { found: self.half_widths.len(), expected: outputs });
        }
        if !(self.coverage > 0.0 && self.coverage < 1.0) {
            return Err(FormatError::Bound { what: "coverage", found: self.coverage });
        }
        match self.half_widths.iter().find(|&&width| !(width.is_finite() && width >= 0.0)) {
            Some(&found) => Err(FormatError::Bound { what: "half-width", found }),
            None => Ok(()),
        }
    }
}
