//! Elastic net: least squares with penalties on the sizes and the squares of the weights.

use crate::{Baseline, Fitted, OptionProblem, Rows, expect, for_each_output, linear, not_negative};
use linfa::traits::Fit;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `[baselines.elastic-net]`: the smallest
/// `1/(2 rows) |y - b - X w|^2 + alpha (l1_ratio |w|_1 + (1 - l1_ratio)/2 |w|_2^2)` over standardised columns.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ElasticNet {
    /// Strength of the penalties.
    #[schemars(range(min = 0))]
    pub alpha: f64,
    /// Share of the penalty on the sizes, above 0: 1 is lasso.
    #[schemars(range(max = 1), extend("exclusiveMinimum" = 0))]
    pub l1_ratio: f64,
}

impl Default for ElasticNet {
    fn default() -> Self {
        Self { alpha: 1e-3, l1_ratio: 0.5 }
    }
}

impl Baseline for ElasticNet {
    fn fit(&self, rows: &Rows, _: u64) -> Result<Fitted, String> {
        let model = linfa_elasticnet::ElasticNet::<f64>::params()
            .penalty(self.alpha)
            .l1_ratio(self.l1_ratio)
            .tolerance(TOLERANCE)
            .max_iterations(MOST_STEPS);
        let fits = for_each_output(rows, |output| {
            let fitted = model.fit(&linear::dataset(rows, output)).map_err(|error| error.to_string())?;
            Ok((fitted.intercept(), fitted.hyperplane().to_vec()))
        })?;
        Ok(linear::formula(rows, &fits))
    }

    fn problems(&self) -> Vec<OptionProblem> {
        // without any penalty on sizes linfa's search does not end
        let share = self.l1_ratio > 0.0 && self.l1_ratio <= 1.0;
        let share = expect(share, "l1_ratio", &self.l1_ratio, "a share above 0, at most 1");
        not_negative("alpha", self.alpha).into_iter().chain(share).collect()
    }
}

/// Of the duality gap, relative to the outputs' squares.
const TOLERANCE: f64 = 1e-9;
const MOST_STEPS: u32 = 1000;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{formula_weights, wavy_rows};

    #[test]
    fn no_small_change_of_a_weight_makes_the_penalised_error_smaller() {
        let rows = wavy_rows(400);
        for model in [ElasticNet { alpha: 0.05, l1_ratio: 0.5 }, ElasticNet { alpha: 0.2, l1_ratio: 1.0 }] {
            let fitted = model.fit(&rows, 1).unwrap();
            for output in 0..rows.outputs {
                let y = rows.output(output);
                let error = |weights: &[f64]| {
                    let residuals = rows.x.chunks(rows.inputs).zip(&y).map(|(z, y)| {
                        let fit = weights[0] + z.iter().zip(&weights[1..]).map(|(z, w)| z * w).sum::<f64>();
                        (y - fit).powi(2)
                    });
                    let size: f64 = weights[1..].iter().map(|w| w.abs()).sum();
                    let squares: f64 = weights[1..].iter().map(|w| w * w).sum();
                    residuals.sum::<f64>() / (2.0 * y.len() as f64)
                        + model.alpha * (model.l1_ratio * size + 0.5 * (1.0 - model.l1_ratio) * squares)
                };
                let weights = formula_weights(&fitted, output);
                let best = error(&weights);
                for index in 0..weights.len() {
                    for step in [-1e-3, 1e-3] {
                        let mut other = weights.clone();
                        other[index] += step;
                        assert!(error(&other) > best, "{weights:?}, weight {index}");
                    }
                }
            }
        }
    }
}
