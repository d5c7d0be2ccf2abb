//! `[accept]`: when a surrogate may be used.

use crate::diagnostics::Problems;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// `[accept]`: when a surrogate may be used. One that is not as good is rejected: `build`, `train` and `evaluate` say why and end
/// with exit code 1. It decides nothing else: results stay valid when it is changed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct AcceptOptions {
    /// Smallest R² of an output, below 1; at 0 it is as good as its mean. Of a surrogate with states also that of the median run up to a
    /// sixth of the runs' length, which alone counts if the motion is chaotic.
    #[schemars(extend("exclusiveMaximum" = 1))]
    pub r2: f64,
    /// R² from which on an output is good, below 1. Between `r2` and this one the surrogate is usable, and the verdict has advice.
    #[schemars(extend("exclusiveMaximum" = 1))]
    pub good: f64,
    /// Largest root mean square error of an output, in multiples of that of the best baseline of the build, at least 1 or `inf`.
    /// Not asked of an output whose R² is above 0.9999.
    #[schemars(range(min = 1))]
    pub baseline_factor: f64,
    /// Largest error of an output, as a share of its range in training; without it, it may have any.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub largest_error: Option<f64>,
    /// Largest error of an angle that winds up, more than a turn in training; half a turn unless given, or `inf`.
    #[schemars(extend("x-unit" = "rad", "exclusiveMinimum" = 0))]
    pub angle_error: f64,
}

impl Default for AcceptOptions {
    fn default() -> Self {
        Self { r2: 0.9, good: 0.99, baseline_factor: 1.0, largest_error: None, angle_error: PI }
    }
}

impl AcceptOptions {
    /// R² from which on an output is not compared with baselines: its root mean square error is a hundredth of its standard
    /// deviation, and a polynomial may be exact where the truth is one.
    pub const EXCELLENT: f64 = 0.9999;

    /// Every mistake, by key within the section.
    pub(super) fn problems(&self) -> Problems {
        let Self { r2, good, baseline_factor, largest_error, angle_error } = *self;
        let mut problems = Problems::default();
        problems.expect(r2 < 1.0, "r2", r2, "a number below 1");
        problems.expect(good < 1.0, "good", good, "a number below 1");
        problems.expect(baseline_factor >= 1.0, "baseline_factor", baseline_factor, "a number of at least 1, or inf");
        if let Some(share) = largest_error {
            problems.expect(share > 0.0, "largest_error", share, "a positive number");
        }
        problems.expect(angle_error > 0.0, "angle_error", angle_error, "a positive number, or inf");
        problems
    }
}
