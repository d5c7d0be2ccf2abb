//! Gaussian process regression (kriging).

use crate::{Baseline, Fitted, StandardizedRows, for_each_output};
use friedrich::{gaussian_process::GaussianProcess as Process, kernel::Kernel, prior::ConstantPrior};
use metafmu_core::study::baselines::GaussianProcess;
use metafmu_runtime::graph::{Graph, KernelMachine};
use nalgebra::{Const, DMatrix, DVector, Dyn, Matrix, Storage};

impl Baseline for GaussianProcess {
    fn most_rows(&self) -> Option<usize> {
        Some(self.rows)
    }

    fn fit(&self, rows: &StandardizedRows, _: u64) -> Result<Fitted, String> {
        let machines = for_each_output(rows, |output| machine(&process(self, rows, output), rows, output))?;
        Ok(Fitted::Formula(Graph::of_kernels(&rows.scaling, &machines)))
    }
}

/// Outputs are given to friedrich in thousandths of a standard deviation: its search changes the logarithm of the noise by a
/// share of itself, which goes the right way only as long as that is positive. The noise is never below one of these.
const UNIT: f64 = 1e-3;

fn process(
    model: &GaussianProcess,
    rows: &StandardizedRows,
    output: usize,
) -> Process<SquaredExponential, ConstantPrior> {
    let amplitude_and_lengths = [1.0 / UNIT].into_iter().chain(vec![1.0; rows.inputs]).collect();
    let few = model.kernel_rows.min(rows.len());
    let (x, y) = (inputs(rows, few), outputs(rows, output));
    let first = Process::builder(x, y.rows(0, few).into_owned())
        .set_kernel(SquaredExponential(amplitude_and_lengths))
        .set_noise(model.noise / UNIT)
        .set_prior(ConstantPrior::new(0.0))
        // no early end: the first steps of the search are often small
        .set_fit_parameters(model.steps, 0.0)
        .fit_kernel()
        .train();
    Process::new(ConstantPrior::new(0.0), first.kernel, first.noise, None, inputs(rows, rows.len()), y)
}

fn inputs(rows: &StandardizedRows, count: usize) -> DMatrix<f64> {
    DMatrix::from_row_slice(count, rows.inputs, &rows.x[..count * rows.inputs])
}

fn outputs(rows: &StandardizedRows, output: usize) -> DVector<f64> {
    DVector::from_vec(rows.output(output)) / UNIT
}

/// The mean of the process as a sum of kernels around the rows, with weights `(K + noise^2 I)^-1 y`.
fn machine(
    process: &Process<SquaredExponential, ConstantPrior>,
    rows: &StandardizedRows,
    output: usize,
) -> Result<KernelMachine, String> {
    let (kernel, count) = (&process.kernel, rows.len());
    let x = inputs(rows, count);
    let noise = process.noise * process.noise;
    let covariance =
        DMatrix::from_fn(count, count, |a, b| kernel.kernel(&x.row(a), &x.row(b)) + if a == b { noise } else { 0.0 });
    let singular = "the covariance of the rows is singular: raise `noise`";
    let weights = covariance.cholesky().ok_or(singular)?.solve(&outputs(rows, output));
    let (amplitude, lengths) = kernel.0.split_first().ok_or("a kernel without parameters")?;
    Ok(KernelMachine {
        lengths: lengths.iter().map(|length| length.abs()).collect(),
        centres: rows.x.clone(),
        weights: weights.iter().map(|weight| weight * amplitude * amplitude * UNIT).collect(),
        bias: 0.0,
    })
}

/// `a^2 exp(-1/2 sum_i ((x_i - y_i) / l_i)^2)` with the parameters `a, l_1, l_2, ...`: those of friedrich have one length
/// for all inputs.
#[derive(Clone, Debug, Default)]
struct SquaredExponential(Vec<f64>);

type MatrixRow<S> = Matrix<f64, Const<1>, Dyn, S>;

impl Kernel for SquaredExponential {
    fn nb_parameters(&self) -> usize {
        self.0.len()
    }

    fn kernel<A, B>(&self, x: &MatrixRow<A>, y: &MatrixRow<B>) -> f64
    where
        A: Storage<f64, Const<1>, Dyn>,
        B: Storage<f64, Const<1>, Dyn>,
    {
        let differences = x.iter().zip(y.iter()).zip(&self.0[1..]);
        let square: f64 = differences.map(|((x, y), length)| ((x - y) / length).powi(2)).sum();
        self.0[0] * self.0[0] * (-0.5 * square).exp()
    }

    fn gradient<A, B>(&self, x: &MatrixRow<A>, y: &MatrixRow<B>) -> Vec<f64>
    where
        A: Storage<f64, Const<1>, Dyn>,
        B: Storage<f64, Const<1>, Dyn>,
    {
        let value = self.kernel(x, y);
        let differences = x.iter().zip(y.iter()).zip(&self.0[1..]);
        let by_lengths = differences.map(|((x, y), length)| value * (x - y).powi(2) / length.powi(3));
        [2.0 * value / self.0[0]].into_iter().chain(by_lengths).collect()
    }

    fn get_parameters(&self) -> Vec<f64> {
        self.0.clone()
    }

    fn set_parameters(&mut self, parameters: &[f64]) {
        // the noise stands behind them
        let count = self.0.len();
        self.0.clone_from_slice(&parameters[..count]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{formula_at, r2, wavy_rows};

    #[test]
    fn the_formula_is_the_librarys_own_prediction_and_fits_a_smooth_function() {
        let rows = wavy_rows(120);
        let model = GaussianProcess { steps: 60, kernel_rows: 60, ..GaussianProcess::default() };
        let fitted = model.fit(&rows, 1).unwrap();
        for output in 0..rows.outputs {
            let points: Vec<Vec<f64>> = rows.x.chunks(3).map(<[f64]>::to_vec).collect();
            for (row, predicted) in process(&model, &rows, output).predict(&points).iter().enumerate() {
                assert!((formula_at(&fitted, &rows, row)[output] - predicted * UNIT).abs() < 1e-9, "row {row}");
            }
            assert!(r2(&fitted, &rows, output) > 0.99);
        }
    }

    #[test]
    fn the_gradient_of_the_kernel_is_that_of_differences() {
        let (x, y) = (DMatrix::from_row_slice(1, 2, &[0.3, -0.7]), DMatrix::from_row_slice(1, 2, &[0.1, 0.4]));
        let value = |parameters: &[f64]| SquaredExponential(parameters.to_vec()).kernel(&x.row(0), &y.row(0));
        let parameters = [1.3, 0.6, 0.9];
        let gradient = SquaredExponential(parameters.to_vec()).gradient(&x.row(0), &y.row(0));
        for (index, slope) in gradient.iter().enumerate() {
            let at = |step: f64| {
                let mut parameters = parameters;
                parameters[index] += step;
                value(&parameters)
            };
            assert!((slope - (at(1e-6) - at(-1e-6)) / 2e-6).abs() < 1e-9);
        }
    }
}
