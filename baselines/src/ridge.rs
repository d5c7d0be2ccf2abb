//! Ridge regression: least squares with a penalty on the squares of the weights.

use crate::{Baseline, ElasticNet, Fitted, Rows, not_negative};
use serde::{Deserialize, Serialize};

/// `[baselines.ridge]`: the elastic net with `l1_ratio = 0`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Ridge {
    /// Strength of the penalty.
    pub alpha: f64,
}

impl Default for Ridge {
    fn default() -> Self {
        Self { alpha: 1e-3 }
    }
}

impl Baseline for Ridge {
    fn fit(&self, rows: &Rows, seed: u64) -> Result<Fitted, String> {
        ElasticNet { alpha: self.alpha, l1_ratio: 0.0 }.fit(rows, seed)
    }

    fn problems(&self) -> Vec<(&'static str, String)> {
        not_negative("alpha", self.alpha).into_iter().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{formula_weights, least_squares, wavy_rows};

    #[test]
    fn it_is_the_solution_of_the_normal_equations_with_a_penalty() {
        let rows = wavy_rows(400);
        for alpha in [1e-3, 0.5] {
            let fitted = Ridge { alpha }.fit(&rows, 1).unwrap();
            for output in 0..rows.outputs {
                let expected = least_squares(&rows, output, alpha);
                for (found, expected) in formula_weights(&fitted, output).iter().zip(&expected) {
                    assert!((found - expected).abs() < 1e-9, "{found} {expected}");
                }
            }
        }
    }
}
