//! Support vector regression with Gaussian kernels.

use crate::{Baseline, BaselineError, Fitted, StandardizedRows, for_each_output};
use metafmu_core::study::baselines::Svr;
use metafmu_runtime::graph::{Graph, KernelMachine};
use serde::Deserialize;
use smartcore::{
    linalg::basic::matrix::DenseMatrix,
    svm::{
        Kernels,
        svr::{SVR, SVRParameters},
    },
};

/// Fields of smartcore's serialized support vector machine.
#[derive(Deserialize)]
struct Serialized {
    instances: Vec<Vec<f64>>,
    w: Vec<f64>,
    b: f64,
}

impl Baseline for Svr {
    fn most_rows(&self) -> Option<usize> {
        Some(self.rows)
    }

    fn fit(&self, rows: &StandardizedRows, _: u64) -> Result<Fitted, BaselineError> {
        let x = matrix(rows.len(), rows.inputs, rows.x.clone())?;
        let machines = for_each_output(rows, |output| machine(self, &x, &rows.output(output)))?;
        Ok(Fitted::Formula(Graph::of_kernels(&rows.scaling, &machines)))
    }
}

fn parameters(model: &Svr) -> SVRParameters<f64> {
    let kernel = Kernels::rbf().with_gamma(model.gamma);
    SVRParameters::default().with_c(model.c).with_eps(model.epsilon).with_kernel(kernel)
}

fn machine(model: &Svr, x: &DenseMatrix<f64>, y: &Vec<f64>) -> Result<KernelMachine, BaselineError> {
    let parameters = parameters(model);
    let fitted = SVR::fit(x, y, &parameters).map_err(BaselineError::library)?;
    let text = serde_json::to_value(&fitted).map_err(BaselineError::library)?;
    let Serialized { instances, w, b } = serde_json::from_value(text).map_err(BaselineError::library)?;
    let inputs = instances.first().map_or(0, Vec::len);
    // exp(-gamma d^2) = exp(-1/2 (d / length)^2)
    let lengths = vec![(0.5 / model.gamma).sqrt(); inputs];
    Ok(KernelMachine { lengths, centres: instances.concat(), weights: w, bias: b, deviation: None })
}

/// Rows as smartcore takes them.
pub(super) fn matrix(rows: usize, columns: usize, values: Vec<f64>) -> Result<DenseMatrix<f64>, BaselineError> {
    DenseMatrix::new(rows, columns, values, false).map_err(BaselineError::library)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{formula_at, r2, wavy_rows};

    #[test]
    fn the_formula_is_the_librarys_own_prediction() {
        let rows = wavy_rows(200);
        let model = Svr { epsilon: 0.05, ..Svr::default() };
        let fitted = model.fit(&rows, 1).unwrap();
        let x = matrix(rows.len(), rows.inputs, rows.x.clone()).unwrap();
        for output in 0..rows.outputs {
            let (y, parameters) = (rows.output(output), parameters(&model));
            let predicted = SVR::fit(&x, &y, &parameters).unwrap().predict(&x).unwrap();
            for (row, predicted) in predicted.iter().enumerate() {
                assert!((formula_at(&fitted, &rows, row)[output] - predicted).abs() < 1e-9);
            }
            assert!(r2(&fitted, &rows, output) > 0.99);
        }
    }
}
