//! Ridge regression: least squares with a penalty on the squares of the weights.

use crate::{Baseline, BaselineError, Fitted, StandardizedRows, for_each_output, linear};
use linfa::{DatasetBase, traits::Fit};
use linfa_linear::LinearRegression;
use metafmu_core::study::baselines::Ridge;
use ndarray::{Array1, Array2, ShapeBuilder};

impl Baseline for Ridge {
    fn fit(&self, rows: &StandardizedRows, _: u64) -> Result<Fitted, BaselineError> {
        let (count, inputs) = (rows.len(), rows.inputs);
        let x_means = (0..inputs).map(|index| rows.x.iter().skip(index).step_by(inputs).sum::<f64>() / count as f64);
        let x_means: Vec<f64> = x_means.collect();
        let penalty = (count as f64 * self.alpha).sqrt();
        let columns = (0..inputs).flat_map(|index| {
            let added = (0..inputs).map(move |row| if row == index { penalty } else { 0.0 });
            let column = rows.x.iter().skip(index).step_by(inputs);
            let mean = x_means[index];
            column.map(move |z| z - mean).chain(added)
        });
        let x = Array2::from_shape_vec((count + inputs, inputs).f(), columns.collect());
        let x = x.map_err(BaselineError::library)?;
        let fits = for_each_output(rows, |output| {
            let y = rows.output(output);
            let y_mean = y.iter().sum::<f64>() / count as f64;
            let y = y.iter().map(|y| y - y_mean).chain(std::iter::repeat_n(0.0, inputs));
            let data = DatasetBase::new(x.view(), y.collect::<Array1<f64>>());
            let fitted = LinearRegression::new().with_intercept(false).fit(&data).map_err(BaselineError::library)?;
            let weights = fitted.params().to_vec();
            let intercept = y_mean - x_means.iter().zip(&weights).map(|(mean, weight)| mean * weight).sum::<f64>();
            Ok((intercept, weights))
        })?;
        Ok(linear::formula(rows, &fits))
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
                for (found, expected) in formula_weights(&fitted, &rows, output).iter().zip(&expected) {
                    assert!((found - expected).abs() < 1e-12, "{found} {expected}");
                }
            }
        }
    }
}
