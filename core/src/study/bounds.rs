//! `[bounds]`: error bounds of the outputs.

use super::limits::MAX_RUNS;
use crate::diagnostics::{Problems, numbers::counted};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `[bounds]`: error bounds of the outputs, measured on separate runs; without this section there are none. The bounds
/// of a surrogate with a state grow with the time since the start.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct BoundsOptions {
    /// Share of points that are to lie within the bounds, between 0 and 1.
    #[schemars(extend("exclusiveMinimum" = 0, "exclusiveMaximum" = 1))]
    pub coverage: f64,
    /// Number of runs the bounds are measured on: random, from the same ranges, part of neither training nor tests. At least
    /// `coverage / (1 - coverage)`.
    #[schemars(range(min = 1, max = MAX_RUNS))]
    pub runs: usize,
}

impl Default for BoundsOptions {
    fn default() -> Self {
        Self { coverage: 0.95, runs: 200 }
    }
}

impl BoundsOptions {
    /// Fewest runs that bounds of this coverage can be measured on.
    pub fn least_runs(coverage: f64) -> usize {
        let least = coverage / (1.0 - coverage);
        // 0.9 / (1 - 0.9) is 9 and its rounding, which is no tenth run
        (least * (1.0 - 1e-12)).ceil() as usize
    }

    /// Every mistake, by key within the section.
    pub(super) fn problems(&self) -> Problems {
        let Self { coverage, runs } = *self;
        let mut problems = Problems::default();
        if !(coverage > 0.0 && coverage < 1.0) {
            problems.add("coverage", format!("{coverage}, expected a share between 0 and 1"));
            return problems;
        }
        let least = Self::least_runs(coverage);
        if runs < least {
            problems.add(
                "runs",
                format!("{}, expected at least {least} for a coverage of {coverage}", counted(runs, "run")),
            );
        }
        problems
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coverages_need_as_many_runs_as_the_quotient_says_without_its_rounding() {
        for (coverage, least) in [(0.9, 9), (0.95, 19), (0.8, 4), (0.5, 1), (0.99, 99), (0.999, 999), (0.91, 11)] {
            assert_eq!(BoundsOptions::least_runs(coverage), least, "{coverage}");
            assert!(BoundsOptions { coverage, runs: least }.problems().is_empty(), "{coverage}");
            assert!(!BoundsOptions { coverage, runs: least - 1 }.problems().is_empty(), "{coverage}");
        }
    }
}
