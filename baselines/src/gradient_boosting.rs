//! Gradient boosting: trees that each correct the sum of those before.

use crate::{Baseline, Fitted, LibraryModel, Rows, for_each_output, svr::matrix};
use metafmu_core::study::baselines::GradientBoosting;
use smartcore::{
    linalg::basic::matrix::DenseMatrix,
    xgboost::xgb_regressor::{XGRegressor, XGRegressorParameters},
};

impl Baseline for GradientBoosting {
    fn most_rows(&self) -> Option<usize> {
        Some(self.rows)
    }

    fn fit(&self, rows: &Rows, seed: u64) -> Result<Fitted, String> {
        let inputs = rows.inputs;
        let x = matrix(rows.len(), inputs, rows.x.clone())?;
        let fitted: Vec<XGRegressor<f64, f64, DenseMatrix<f64>, Vec<f64>>> = for_each_output(rows, |output| {
            let parameters = XGRegressorParameters::default()
                .with_n_estimators(self.trees)
                .with_max_depth(self.depth)
                .with_learning_rate(self.learning_rate)
                .with_base_score(0.0)
                .with_seed(seed);
            XGRegressor::fit(&x, &rows.output(output), parameters).map_err(|error| error.to_string())
        })?;
        let predict = move |x: &[f64]| {
            let x = matrix(x.len() / inputs, inputs, x.to_vec())?;
            let outputs: Result<Vec<Vec<f64>>, _> = fitted.iter().map(|regressor| regressor.predict(&x)).collect();
            Ok(interleave(&outputs.map_err(|error| error.to_string())?))
        };
        // full trees, each node with two numbers, a column and two links: the library does not tell how many it has
        let nodes = rows.outputs * self.trees * ((2 << self.depth.min(20)) - 1).min(2 * rows.len());
        Ok(Fitted::Library(LibraryModel {
            predict: Box::new(predict),
            memory_bytes: (nodes * 5 * size_of::<f64>()) as u64,
            not_exportable: "smartcore gives no access to its trees",
        }))
    }
}

/// Columns as rows.
fn interleave(columns: &[Vec<f64>]) -> Vec<f64> {
    let rows = columns.first().map_or(0, Vec::len);
    (0..rows).flat_map(|row| columns.iter().map(move |column| column[row])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{r2, wavy_rows};

    #[test]
    fn more_trees_fit_the_rows_better() {
        let rows = wavy_rows(300);
        let quality =
            |trees| r2(&GradientBoosting { trees, ..GradientBoosting::default() }.fit(&rows, 1).unwrap(), &rows, 0);
        let (one, ten, hundred) = (quality(1), quality(10), quality(100));
        assert!(one < ten && ten < hundred && hundred > 0.99, "{one} {ten} {hundred}");
    }
}
