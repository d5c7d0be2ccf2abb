//! Elastic net: least squares with penalties on the sizes and the squares of the weights.

use crate::{Baseline, BaselineError, Fitted, StandardizedRows, for_each_output, linear};
use linfa::traits::Fit;
use metafmu_core::study::baselines::ElasticNet;

impl Baseline for ElasticNet {
    fn fit(&self, rows: &StandardizedRows, _: u64) -> Result<Fitted, BaselineError> {
        let model = linfa_elasticnet::ElasticNet::<f64>::params()
            .penalty(self.alpha)
            .l1_ratio(self.l1_ratio)
            .tolerance(TOLERANCE)
            .max_iterations(MOST_STEPS);
        let fits = for_each_output(rows, |output| {
            let fitted = model.fit(&linear::dataset(rows, output)).map_err(BaselineError::library)?;
            Ok((fitted.intercept(), fitted.hyperplane().to_vec()))
        })?;
        Ok(linear::formula(rows, &fits))
    }
}

/// Tolerance of the duality gap, relative to the squares of the outputs.
const TOLERANCE: f64 = 1e-9;
const MOST_STEPS: u32 = 1000;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{formula_weights, wavy_rows};

    #[test]
    fn no_small_change_of_a_weight_makes_the_penalized_error_smaller() {
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
                let weights = formula_weights(&fitted, &rows, output);
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
