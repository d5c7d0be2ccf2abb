//! Lasso: least squares with a penalty on the sizes of the weights, which makes some of them zero.

use crate::{Baseline, BaselineError, Fitted, StandardizedRows};
use metafmu_core::study::baselines::{ElasticNet, Lasso};

impl Baseline for Lasso {
    fn fit(&self, rows: &StandardizedRows, seed: u64) -> Result<Fitted, BaselineError> {
        ElasticNet { alpha: self.alpha, l1_ratio: 1.0 }.fit(rows, seed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{formula_weights, wavy_rows};

    #[test]
    fn a_strong_penalty_leaves_the_mean() {
        let rows = wavy_rows(400);
        let fitted = Lasso { alpha: 10.0 }.fit(&rows, 1).unwrap();
        let weights = formula_weights(&fitted, &rows, 0);
        let mean = rows.output(0).iter().sum::<f64>() / 400.0;
        assert!(weights[1..].iter().all(|&weight| weight == 0.0), "{weights:?}");
        assert!((weights[0] - mean).abs() < 1e-12);
    }
}
