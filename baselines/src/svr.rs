//! Support vector regression with Gaussian kernels.

use crate::{Baseline, Fitted, OptionProblem, Rows, at_least, for_each_output, not_negative, positive};
use metafmu_runtime::regression::{Function, KernelMachine, KernelMachines, Regression};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use smartcore::{
    linalg::basic::matrix::DenseMatrix,
    svm::{
        Kernels,
        svr::{SVR, SVRParameters},
    },
};

/// `[baselines.svr]`: the kernel is `exp(-gamma |z - c|^2)` over standardised inputs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Svr {
    /// At most so many rows: the time grows with their square.
    #[schemars(range(min = 2))]
    pub rows: usize,
    /// How much an error counts beside the flatness of the model.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub c: f64,
    /// Errors up to this one, in standard deviations, count nothing.
    #[schemars(range(min = 0))]
    pub epsilon: f64,
    /// Narrowness of the kernel.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub gamma: f64,
}

impl Default for Svr {
    fn default() -> Self {
        Self { rows: 2000, c: 100.0, epsilon: 0.01, gamma: 1.0 }
    }
}

/// What smartcore's machine says of itself when it is serialized.
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

    fn fit(&self, rows: &Rows, _: u64) -> Result<Fitted, String> {
        let x = matrix(rows.len(), rows.inputs, rows.x.clone())?;
        let machines = for_each_output(rows, |output| self.machine(&x, &rows.output(output)))?;
        let function = Function::Kernel(KernelMachines { machines });
        Ok(Fitted::Formula(Regression { scaling: rows.scaling.clone(), function }))
    }

    fn problems(&self) -> Vec<OptionProblem> {
        let kernel = positive("c", self.c).into_iter().chain(positive("gamma", self.gamma));
        kernel.chain(not_negative("epsilon", self.epsilon)).chain(at_least("rows", self.rows, 2)).collect()
    }
}

impl Svr {
    fn parameters(&self) -> SVRParameters<f64> {
        let kernel = Kernels::rbf().with_gamma(self.gamma);
        SVRParameters::default().with_c(self.c).with_eps(self.epsilon).with_kernel(kernel)
    }

    fn machine(&self, x: &DenseMatrix<f64>, y: &Vec<f64>) -> Result<KernelMachine, String> {
        let parameters = self.parameters();
        let fitted = SVR::fit(x, y, &parameters).map_err(|error| error.to_string())?;
        let text = serde_json::to_value(&fitted).map_err(|error| error.to_string())?;
        let Serialized { instances, w, b } = serde_json::from_value(text).map_err(|error| error.to_string())?;
        let inputs = instances.first().map_or(0, Vec::len);
        // exp(-gamma d^2) = exp(-1/2 (d / length)^2)
        let lengths = vec![(0.5 / self.gamma).sqrt(); inputs];
        Ok(KernelMachine { lengths, centres: instances.concat(), weights: w, bias: b })
    }
}

/// Rows as smartcore takes them.
pub(super) fn matrix(rows: usize, columns: usize, values: Vec<f64>) -> Result<DenseMatrix<f64>, String> {
    DenseMatrix::new(rows, columns, values, false).map_err(|error| error.to_string())
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
            let (y, parameters) = (rows.output(output), model.parameters());
            let predicted = SVR::fit(&x, &y, &parameters).unwrap().predict(&x).unwrap();
            for (row, predicted) in predicted.iter().enumerate() {
                assert!((formula_at(&fitted, &rows, row)[output] - predicted).abs() < 1e-9);
            }
            assert!(r2(&fitted, &rows, output) > 0.99);
        }
    }
}
