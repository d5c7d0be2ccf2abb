//! Linear least squares: `y = b + w z`.

use crate::{Baseline, BaselineError, Fitted, StandardizedRows, for_each_output};
use linfa::{Dataset, traits::Fit};
use linfa_linear::LinearRegression;
use metafmu_core::study::baselines::Linear;
use metafmu_runtime::graph::Graph;
use ndarray::{Array1, Array2, ShapeBuilder};

impl Baseline for Linear {
    fn fit(&self, rows: &StandardizedRows, _: u64) -> Result<Fitted, BaselineError> {
        let fits = for_each_output(rows, |output| {
            let fitted = LinearRegression::new().fit(&dataset(rows, output)).map_err(BaselineError::library)?;
            Ok((fitted.intercept(), fitted.params().to_vec()))
        })?;
        Ok(formula(rows, &fits))
    }
}

/// Rows with one output, as linfa takes them; columns one after the other, which is how its solvers go through them.
pub(super) fn dataset(rows: &StandardizedRows, output: usize) -> Dataset<f64, f64, ndarray::Ix1> {
    let columns = (0..rows.inputs).flat_map(|column| rows.x.iter().skip(column).step_by(rows.inputs).copied());
    let x = Array2::from_shape_vec((rows.len(), rows.inputs).f(), columns.collect());
    Dataset::new(x.expect("as many numbers as the shape says"), Array1::from_vec(rows.output(output)))
}

/// The formula of an intercept and weights for each output.
pub(super) fn formula(rows: &StandardizedRows, fits: &[(f64, Vec<f64>)]) -> Fitted {
    let weights: Vec<f64> = fits.iter().flat_map(|(_, weights)| weights).copied().collect();
    let intercepts: Vec<f64> = fits.iter().map(|(intercept, _)| *intercept).collect();
    Fitted::Formula(Graph::of_linear(&rows.scaling, &weights, &intercepts))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{formula_at, least_squares, wavy_rows};

    #[test]
    fn it_is_the_solution_of_the_normal_equations() {
        let rows = wavy_rows(400);
        let fitted = Linear {}.fit(&rows, 1).unwrap();
        for output in 0..rows.outputs {
            let expected = least_squares(&rows, output, 0.0);
            for row in 0..20 {
                let z = &rows.x[row * rows.inputs..][..rows.inputs];
                let by_hand = expected[0] + z.iter().zip(&expected[1..]).map(|(z, w)| z * w).sum::<f64>();
                let found = formula_at(&fitted, &rows, row)[output];
                assert!((found - by_hand).abs() < 1e-12, "{found} {by_hand}");
            }
        }
    }

    #[test]
    fn the_formula_is_the_librarys_own_prediction() {
        use linfa::traits::Predict;
        let rows = wavy_rows(400);
        let fitted = Linear {}.fit(&rows, 1).unwrap();
        for output in 0..rows.outputs {
            let data = dataset(&rows, output);
            let predicted = LinearRegression::new().fit(&data).unwrap().predict(data.records());
            for (row, predicted) in predicted.iter().enumerate() {
                assert!((formula_at(&fitted, &rows, row)[output] - predicted).abs() < 1e-12);
            }
        }
    }
}
