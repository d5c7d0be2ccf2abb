//! Gaussian process regression (ordinary kriging): a constant mean, a squared exponential kernel with a length for each input, and noise.
//!
//! ```text
//! cov(y_a, y_b) = s^2 (exp(-1/2 sum_i ((x_ai - x_bi) / l_i)^2) + noise^2 [a = b])
//! ```
//!
//! Lengths and noise are those of the greatest likelihood, in which the mean and `s^2` have their best values (Rasmussen, Williams (2006),
//! sections 2.7 and 5.4).

mod design;
mod deviation;

use crate::{Baseline, BaselineCause, BaselineError, Fitted, StandardizedRows, bfgs, for_each_output};
pub use design::{DesignPlaces, design_points};
use metafmu_core::study::baselines::GaussianProcess;
use metafmu_runtime::graph::{Graph, KernelMachine};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

impl Baseline for GaussianProcess {
    fn most_rows(&self) -> Option<usize> {
        Some(self.rows)
    }

    fn fit(&self, rows: &StandardizedRows, _: u64) -> Result<Fitted, BaselineError> {
        let machines = for_each_output(rows, |output| machine(self, rows, output, false))?;
        Ok(Fitted::Formula(Graph::of_kernels(&rows.scaling, &machines)))
    }

    fn fit_with_std(&self, rows: &StandardizedRows, _: u64) -> Result<Graph, BaselineError> {
        let machines = for_each_output(rows, |output| machine(self, rows, output, true))?;
        Ok(Graph::of_kernels(&rows.scaling, &machines))
    }
}

/// Rows that the first searches see, which begin at different lengths.
const FIRST_ROWS: usize = 200;
/// Lengths at which they begin, in standard deviations of one input; of `d` inputs `d^(1/4)` of these, as distances grow with `d^(1/2)`.
const FIRST_LENGTHS: [f64; 3] = [2.7, 7.4, 1.0];
/// Shorter lengths: of all inputs, or of one beside the first of the others. The likeliest is a further start.
const SHORT_LENGTHS: [f64; 3] = [0.4, 0.15, 0.06];
/// Standard deviation of the noise, relative to that of the function, of a further start: few rows of many inputs can also be interpolated.
const NOISY_START: f64 = 0.1;
/// Logarithms of the lengths: from features that rows cannot show to what is linear over all rows.
const LENGTHS: [f64; 2] = [-3.0, 7.0];
/// Smallest square of the noise: a covariance is singular with less.
const LEAST_NOISE: f64 = 100.0 * f64::EPSILON;

/// The mean of the process as a sum of kernels around the rows, and its standard deviation if that is wanted.
fn machine(
    model: &GaussianProcess,
    rows: &StandardizedRows,
    output: usize,
    has_std: bool,
) -> Result<KernelMachine, BaselineError> {
    let parameters =
        parameters(model, rows, output).ok_or_else(|| unsuitable_rows("the covariance of the rows is singular"))?;
    let all = OutputRows::of(rows, output, rows.len());
    let process = Process::new(&all, &parameters).ok_or_else(|| unsuitable_rows(SINGULAR))?;
    let (noise, lengths) = parameters.split_last().ok_or_else(|| unsuitable_rows("no input"))?;
    Ok(KernelMachine {
        lengths: lengths.iter().map(|length| length.exp()).collect(),
        centres: rows.x.clone(),
        weights: process.weights.as_slice().to_vec(),
        bias: process.mean,
        deviation: has_std.then(|| deviation::of(&process, noise.exp())).transpose()?,
    })
}

/// Message of a covariance that more noise makes regular.
const SINGULAR: &str = "the covariance of the rows is singular: raise `noise`";

fn unsuitable_rows(message: &str) -> BaselineError {
    BaselineError::new(BaselineCause::Rows, message)
}

/// Logarithms of the lengths, and of the square of the noise, of the greatest likelihood of `kernel_rows` rows.
fn parameters(model: &GaussianProcess, rows: &StandardizedRows, output: usize) -> Option<Vec<f64>> {
    let few = OutputRows::of(rows, output, model.kernel_rows.min(FIRST_ROWS));
    let starts = FIRST_LENGTHS.map(|length| uniform_start(rows.inputs, length, model.noise));
    let noisy = (model.noise < NOISY_START).then(|| uniform_start(rows.inputs, FIRST_LENGTHS[0], NOISY_START));
    let first = starts.into_iter().chain(short_start(model, &few)).chain(noisy);
    let first = first.filter_map(|start| search(model, &few, start));
    let best = first.min_by(|a, b| a.value.total_cmp(&b.value))?;
    if model.kernel_rows.min(rows.len()) <= FIRST_ROWS {
        return Some(best.point);
    }
    let more = OutputRows::of(rows, output, model.kernel_rows);
    search(model, &more, best.point).map(|best| best.point)
}

/// Parameters with the same length for all inputs: a length for one input, scaled to their number.
fn uniform_start(inputs: usize, length: f64, noise: f64) -> Vec<f64> {
    let scaled = (length * (inputs as f64).powf(0.25)).ln();
    [vec![scaled; inputs], vec![2.0 * noise.ln()]].concat()
}

/// The likeliest parameters near a start; none if the covariance is singular there.
fn search(model: &GaussianProcess, rows: &OutputRows, start: Vec<f64>) -> Option<bfgs::Best> {
    let mut bounds = vec![LENGTHS; rows.inputs];
    bounds.push([LEAST_NOISE.ln(), 0.0]);
    bfgs::least(start, &bounds, model.steps, |parameters| {
        Process::new(rows, parameters).map(|process| process.unlikelihood(rows, parameters))
    })
}

/// The likeliest start with short lengths: functions that change many times within the range of an input are noise to long ones.
fn short_start(model: &GaussianProcess, rows: &OutputRows) -> Option<Vec<f64>> {
    let usual = FIRST_LENGTHS[0] * (rows.inputs as f64).powf(0.25);
    let columns = (0..rows.inputs).filter(|_| rows.inputs > 1);
    let alone = columns.flat_map(|column| {
        SHORT_LENGTHS.map(|length| {
            let mut lengths = vec![usual.ln(); rows.inputs];
            lengths[column] = length.ln();
            lengths
        })
    });
    let all = SHORT_LENGTHS.map(|length| vec![length.ln(); rows.inputs]);
    let rated = all.into_iter().chain(alone).filter_map(|lengths| {
        let start = [lengths, vec![2.0 * model.noise.ln()]].concat();
        Some((Process::new(rows, &start)?.likelihood_cost(), start))
    });
    rated.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, start)| start)
}

/// Inputs and one output of the first rows.
struct OutputRows<'a> {
    x: &'a [f64],
    inputs: usize,
    y: DVector<f64>,
}

impl<'a> OutputRows<'a> {
    fn of(rows: &'a StandardizedRows, output: usize, count: usize) -> Self {
        let count = count.min(rows.len());
        let mut y = rows.output(output);
        y.truncate(count);
        Self { x: &rows.x[..count * rows.inputs], inputs: rows.inputs, y: DVector::from_vec(y) }
    }

    fn row(&self, index: usize) -> &[f64] {
        &self.x[index * self.inputs..][..self.inputs]
    }

    fn len(&self) -> usize {
        self.y.len()
    }
}

/// The process of some parameters: its kernel at the rows, without the noise, and what follows from it.
struct Process {
    kernel: DMatrix<f64>,
    covariance: Cholesky<f64, Dyn>,
    mean: f64,
    /// `covariance^-1 (y - mean)`
    weights: DVector<f64>,
    /// Mean square of `y - mean`, each decorrelated from those before: the best `s^2`.
    variance: f64,
}

impl Process {
    /// None if the covariance is singular.
    fn new(rows: &OutputRows, parameters: &[f64]) -> Option<Self> {
        let (noise, lengths) = parameters.split_last()?;
        let inverse: Vec<f64> = lengths.iter().map(|length| (-length).exp()).collect();
        let scaled: Vec<f64> = rows.x.iter().zip(inverse.iter().cycle()).map(|(x, inverse)| x * inverse).collect();
        let points: Vec<&[f64]> = scaled.chunks_exact(rows.inputs).collect();
        let count = rows.len();
        let mut kernel = DMatrix::identity(count, count);
        for column in 0..count {
            for below in column + 1..count {
                let square: f64 = points[below].iter().zip(points[column]).map(|(a, b)| (a - b) * (a - b)).sum();
                kernel[(below, column)] = (-0.5 * square).exp();
            }
        }
        kernel.fill_upper_triangle_with_lower_triangle();
        let mut covariance = kernel.clone();
        (0..count).for_each(|row| covariance[(row, row)] += noise.exp());
        let covariance = Cholesky::new(covariance)?;
        let ones = DVector::repeat(count, 1.0);
        let (by_ones, by_y) = (covariance.solve(&ones), covariance.solve(&rows.y));
        let mean = by_y.sum() / by_ones.sum();
        let weights = by_y - by_ones * mean;
        let variance = weights.dot(&rows.y.add_scalar(-mean)) / count as f64;
        // rounding alone makes it negative
        let is_fine = variance > 0.0 && variance.is_finite() && mean.is_finite();
        is_fine.then_some(Self { kernel, covariance, mean, weights, variance })
    }

    /// The negative logarithm of the likelihood but for a constant.
    fn likelihood_cost(&self) -> f64 {
        let half_determinant: f64 = self.covariance.l_dirty().diagonal().iter().map(|pivot| pivot.ln()).sum();
        0.5 * self.kernel.nrows() as f64 * self.variance.ln() + half_determinant
    }

    /// [`Self::likelihood_cost`] and its derivatives with respect to the parameters.
    fn unlikelihood(&self, rows: &OutputRows, parameters: &[f64]) -> (f64, Vec<f64>) {
        let Self { kernel, covariance, weights, variance, .. } = self;
        let (count, inputs) = (rows.len(), rows.inputs);
        let value = self.likelihood_cost();
        // half the trace of (covariance^-1 - weights weights^T / variance) times the derivative of the covariance
        let inverse = covariance.inverse();
        let mut gradient = vec![0.0; inputs + 1];
        for column in 0..count {
            let own = inverse[(column, column)] - weights[column] * weights[column] / variance;
            gradient[inputs] += 0.5 * own * parameters[inputs].exp();
            for below in column + 1..count {
                let factor = inverse[(below, column)] - weights[below] * weights[column] / variance;
                let by_kernel = factor * kernel[(below, column)];
                let both = rows.row(below).iter().zip(rows.row(column));
                for (slope, (a, b)) in gradient.iter_mut().zip(both) {
                    *slope += by_kernel * (a - b) * (a - b);
                }
            }
        }
        gradient.iter_mut().zip(&parameters[..inputs]).for_each(|(slope, length)| *slope *= (-2.0 * length).exp());
        (value, gradient)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{formula_at, r2, wavy_rows};

    fn model() -> GaussianProcess {
        GaussianProcess::default()
    }

    #[test]
    fn the_formula_interpolates_rows_without_noise_and_fits_a_smooth_function() {
        let rows = wavy_rows(200);
        let seen: Vec<usize> = (0..120).collect();
        let fitted = model().fit(&rows.choose(&seen), 1).unwrap();
        for output in 0..rows.outputs {
            for row in seen.iter().step_by(7) {
                let error = formula_at(&fitted, &rows, *row)[output] - rows.output(output)[*row];
                assert!(error.abs() < 1e-5, "row {row}: {error}");
            }
            // rows that were not seen are among them
            assert!(1.0 - r2(&fitted, &rows, output) < 1e-6, "{}", 1.0 - r2(&fitted, &rows, output));
        }
    }

    #[test]
    fn noise_is_estimated_and_not_interpolated() {
        let mut rows = wavy_rows(300);
        let clean = rows.clone();
        let mut state = 7u64;
        for value in &mut rows.y {
            // twelve uniform numbers: nearly normal, with the standard deviation 0.1
            let sum: f64 = (0..12)
                .map(|_| {
                    state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                    (state >> 11) as f64 / (1u64 << 53) as f64 - 0.5
                })
                .sum();
            *value += 0.1 * sum;
        }
        let parameters = parameters(&model(), &rows, 0).unwrap();
        let process = Process::new(&OutputRows::of(&rows, 0, rows.len()), &parameters).unwrap();
        let noise = (parameters[rows.inputs].exp() * process.variance).sqrt();
        assert!((0.08..0.12).contains(&noise), "{noise}");
        // an error well below the noise, of what is behind it
        let fitted = model().fit(&rows, 1).unwrap();
        assert!(1.0 - r2(&fitted, &clean, 0) < 3e-3, "{}", 1.0 - r2(&fitted, &clean, 0));
    }

    #[test]
    fn noise_in_few_rows_of_many_inputs_is_not_interpolated() {
        use metafmu_runtime::Scaling;
        let (count, inputs, noise) = (50, 8, 0.2);
        for seed in [5, 6, 7, 8, 9] {
            let (mut state, mut x, mut y) = (seed, Vec::new(), Vec::new());
            let mut uniform = || {
                state =
                    u64::wrapping_add(u64::wrapping_mul(state, 6_364_136_223_846_793_005), 1_442_695_040_888_963_407);
                (state >> 11) as f64 / (1u64 << 53) as f64
            };
            for _ in 0..count {
                let row: Vec<f64> = (0..inputs).map(|_| uniform()).collect();
                let sum: f64 = (1..).zip(&row).map(|(factor, x)| 0.25 * f64::from(factor) * x).sum();
                y.push(sum + row[0] * row[1] + noise * (0..12).map(|_| uniform() - 0.5).sum::<f64>());
                x.extend(row);
            }
            let scaling = Scaling {
                input_mean: vec![0.5; inputs],
                input_scale: vec![0.29; inputs],
                output_mean: vec![4.5],
                output_scale: vec![1.0],
            };
            let rows = StandardizedRows::new(x, y, scaling);
            let parameters = parameters(&model(), &rows, 0).unwrap();
            let process = Process::new(&OutputRows::of(&rows, 0, count), &parameters).unwrap();
            let found = (parameters[inputs].exp() * process.variance).sqrt();
            assert!((0.5..1.5).contains(&(found / noise)), "{seed}: {found}");
        }
    }

    #[test]
    fn slopes_of_the_likelihood_are_those_of_differences() {
        let rows = wavy_rows(30);
        let rows = OutputRows::of(&rows, 1, 30);
        let at = |parameters: &[f64]| Process::new(&rows, parameters).unwrap().unlikelihood(&rows, parameters);
        let parameters = [0.3, -0.1, 0.6, -7.0];
        let (_, gradient) = at(&parameters);
        for (index, slope) in gradient.iter().enumerate() {
            let moved = |step: f64| {
                let mut parameters = parameters;
                parameters[index] += step;
                at(&parameters).0
            };
            let expected = (moved(1e-5) - moved(-1e-5)) / 2e-5;
            assert!((slope - expected).abs() < 1e-5 * (1.0 + expected.abs()), "{index}: {slope} {expected}");
        }
    }

    #[test]
    fn a_function_that_changes_many_times_within_a_range_is_fitted() {
        use metafmu_runtime::Scaling;
        let (mut state, mut x, mut y) = (1u64, Vec::new(), Vec::new());
        let mut uniform = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 53) as f64
        };
        for _ in 0..300 {
            let (a, b) = (uniform(), uniform());
            x.extend([a, b]);
            y.extend([(40.0 * a).sin(), (40.0 * a).sin() + b]);
        }
        let scaling = Scaling {
            input_mean: vec![0.5; 2],
            input_scale: vec![0.29; 2],
            output_mean: vec![0.0; 2],
            output_scale: vec![0.7; 2],
        };
        let rows = StandardizedRows::new(x, y, scaling);
        let fitted = model().fit(&rows.choose(&(0..200).collect::<Vec<_>>()), 1).unwrap();
        for output in 0..2 {
            assert!(1.0 - r2(&fitted, &rows, output) < 1e-4, "{output}: {}", 1.0 - r2(&fitted, &rows, output));
        }
    }

    #[test]
    fn few_rows_repeated_rows_and_constant_outputs_are_fitted_or_refused() {
        for count in [2, 3, 5] {
            let rows = wavy_rows(50).choose(&[0, 11, 22, 33, 44][..count]);
            let fitted = model().fit(&rows, 1).unwrap();
            assert!(formula_at(&fitted, &rows, 0).iter().all(|value| value.is_finite()), "{count}");
        }
        let repeated: Vec<usize> = (0..40).chain(0..40).collect();
        let rows = wavy_rows(40).choose(&repeated);
        assert!(1.0 - r2(&model().fit(&rows, 1).unwrap(), &rows, 0) < 1e-6);
        let mut constant = wavy_rows(40);
        constant.y.iter_mut().for_each(|value| *value = 0.0);
        if let Ok(fitted) = model().fit(&constant, 1) {
            assert!(formula_at(&fitted, &constant, 3).iter().all(|value| value.abs() < 1e-9));
        }
    }
}
