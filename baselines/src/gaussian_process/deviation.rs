//! Predicted standard deviation of a further row.
//!
//! ```text
//! std(x)² = s² (1 + noise² - k^T C^-1 k + (1 - 1^T C^-1 k)² / (1^T C^-1 1))
//! ```
//!
//! with the kernels `k` between `x` and the rows and their covariance `s² C`, noise included. The last summand is the uncertainty of the constant mean
//! (Rasmussen, Williams (2006), section 2.7). Lengths, noise and `s` count as known.

use super::{BaselineError, Process, SINGULAR, unsuitable_rows};
use metafmu_runtime::graph::ProcessDeviation;
use nalgebra::{DMatrix, DVector};

/// Rounding errors between the rows relative to those at and beside the rows, at most.
const SAFETY: f64 = 4.0;

/// The standard deviation of a process; `noise`: the square of the noise relative to `s²`.
///
/// # Errors
/// If the covariance is singular.
pub(super) fn of(process: &Process, noise: f64) -> Result<ProcessDeviation, BaselineError> {
    let Process { kernel, covariance, variance, .. } = process;
    let count = kernel.nrows();
    // columns `w` are the rows of `W`: small residuals of `L^T w` are those that remain small times the kernels
    let mut whitening = DMatrix::identity(count, count);
    if !covariance.l_dirty().tr_solve_lower_triangular_mut(&mut whitening) {
        return Err(unsuitable_rows(SINGULAR));
    }
    let of_ones = whitening.tr_mul(&DVector::repeat(count, 1.0));
    let trend_origin = 1.0 / of_ones.norm();
    let trend = &whitening * of_ones * trend_origin;
    let rounding = largest_rounding(kernel, &whitening, (&trend, trend_origin), noise);
    Ok(ProcessDeviation {
        whitening: (0..count).flat_map(|row| whitening.as_slice()[row * count..][..=row].iter().copied()).collect(),
        trend: trend.as_slice().to_vec(),
        trend_origin,
        noise,
        // a further row has at least the noise
        least: noise.max(SAFETY * rounding),
        scale: variance.sqrt(),
    })
}

/// Largest rounding error of the variances relative to `s²`: at the rows, and of the prediction of a row from the others.
///
/// At row `a` the kernels are `(C - noise²) e_a`, so that the variance is also `noise² (2 - noise² (C^-1)_aa)`, and that of the mean follows from
/// `noise² (C^-1 1)_a`. From the others a row is predicted with the weights `w_b = -(C^-1)_ab / (C^-1)_aa`; rounding errors of the kernels change its
/// variance by about `epsilon (1 + |w|²)`.
fn largest_rounding(
    kernel: &DMatrix<f64>,
    whitening: &DMatrix<f64>,
    (trend, trend_origin): (&DVector<f64>, f64),
    noise: f64,
) -> f64 {
    let whitened = whitening.tr_mul(kernel);
    let inverse = whitening * whitening.transpose();
    let errors = (0..kernel.nrows()).map(|row| {
        let of_mean = trend_origin - trend.dot(&kernel.column(row));
        let found = (1.0 - whitened.column(row).norm_squared()) + (of_mean * of_mean + noise);
        let known = noise * (2.0 - noise * inverse[(row, row)]) + (noise * trend[row]).powi(2);
        let beside = f64::EPSILON * inverse.column(row).norm_squared() / inverse[(row, row)].powi(2);
        (found - known).abs().max(beside)
    });
    errors.fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::super::{Baseline, GaussianProcess, OutputRows, parameters};
    use super::*;
    use crate::{StandardizedRows, testing::wavy_rows};
    use metafmu_runtime::Scaling;

    fn uniform(state: &mut u64) -> f64 {
        *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (*state >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Sum of twelve uniform numbers: nearly normal, with a standard deviation of 1.
    fn normal(state: &mut u64) -> f64 {
        (0..12).map(|_| uniform(state) - 0.5).sum()
    }

    /// Rows of `sin(3 a) + b²` and of twice that, with noise, and standard deviations that are not 1.
    fn noisy(count: usize, noise: f64) -> StandardizedRows {
        let (mut state, mut x, mut y) = (5u64, Vec::new(), Vec::new());
        for _ in 0..count {
            let (a, b) = (uniform(&mut state), uniform(&mut state));
            x.extend([a, b]);
            let value = (3.0 * a).sin() + b * b;
            y.extend([value + noise * normal(&mut state), 2.0 * value + noise * normal(&mut state)]);
        }
        let scaling = Scaling {
            input_mean: vec![0.5; 2],
            input_scale: vec![0.29; 2],
            output_mean: vec![1.0, 2.0],
            output_scale: vec![0.4, 0.8],
        };
        StandardizedRows::new(x, y, scaling)
    }

    /// Inputs of a row.
    fn point(rows: &StandardizedRows, row: usize) -> Vec<f64> {
        let Scaling { input_mean, input_scale, .. } = &rows.scaling;
        let x = rows.x[row * rows.inputs..][..rows.inputs].iter();
        x.zip(input_mean).zip(input_scale).map(|((x, mean), scale)| mean + scale * x).collect()
    }

    /// Output of a row.
    fn label(rows: &StandardizedRows, row: usize, output: usize) -> f64 {
        rows.scaling.output_mean[output] + rows.scaling.output_scale[output] * rows.output(output)[row]
    }

    #[test]
    fn the_graph_is_the_formula_with_an_inverse_of_the_covariance() {
        for (rows, noise_of) in [(noisy(40, 0.1), 40), (noisy(150, 0.05), 150)] {
            let graph = GaussianProcess::default().fit_with_std(&rows, 1).unwrap();
            for output in 0..2 {
                let found = parameters(&GaussianProcess::default(), &rows, output).unwrap();
                let all = OutputRows::of(&rows, output, noise_of);
                let process = Process::new(&all, &found).unwrap();
                let (noise, lengths) = found.split_last().unwrap();
                let mut covariance = process.kernel.clone();
                (0..noise_of).for_each(|row| covariance[(row, row)] += noise.exp());
                let inverse = covariance.lu().try_inverse().unwrap();
                for z in [[0.1, -0.4], [-1.2, 0.7], [3.0, -5.0], [40.0, 0.0]] {
                    let kernel = DVector::from_fn(noise_of, |row, _| {
                        let squares =
                            all.row(row).iter().zip(z).zip(lengths).map(|((a, b), l)| ((a - b) / l.exp()).powi(2));
                        (-0.5 * squares.sum::<f64>()).exp()
                    });
                    let by_kernel = &inverse * &kernel;
                    let trend = (1.0 - by_kernel.sum()).powi(2) / inverse.sum();
                    let relative = 1.0 + noise.exp() - kernel.dot(&by_kernel) + trend;
                    let expected = (process.variance * relative).sqrt() * rows.scaling.output_scale[output];
                    let x: Vec<f64> = z.iter().map(|z| 0.5 + 0.29 * z).collect();
                    let values = graph.evaluate([x])[0].to_vec();
                    assert_eq!(values.len(), 4);
                    let error = (values[2 + output] / expected - 1.0).abs();
                    assert!(error < 1e-7, "{output} {z:?}: {} {expected}", values[2 + output]);
                }
            }
        }
    }

    #[test]
    fn two_standard_deviations_cover_nearly_all_further_rows_of_a_noisy_function() {
        let rows = noisy(1200, 0.1);
        let graph = GaussianProcess::default().fit_with_std(&rows.choose(&(0..200).collect::<Vec<_>>()), 1).unwrap();
        for output in 0..2 {
            let is_within = |row: &usize| {
                let values = graph.evaluate([point(&rows, *row)])[0].to_vec();
                (values[output] - label(&rows, *row, output)).abs() <= 2.0 * values[2 + output]
            };
            let share = (200..1200).filter(is_within).count() as f64 / 1000.0;
            assert!((0.92..0.98).contains(&share), "{output}: {share}");
        }
    }

    #[test]
    fn rows_without_noise_have_next_to_none_and_rounding_makes_it_never_less() {
        let rows = wavy_rows(150);
        let seen = rows.choose(&(0..100).collect::<Vec<_>>());
        let graph = GaussianProcess::default().fit_with_std(&seen, 1).unwrap();
        for output in 0..rows.outputs {
            let found = parameters(&GaussianProcess::default(), &seen, output).unwrap();
            let process = Process::new(&OutputRows::of(&seen, output, 100), &found).unwrap();
            let deviation = of(&process, found.last().unwrap().exp()).unwrap();
            let least = deviation.least.sqrt() * deviation.scale * rows.scaling.output_scale[output];
            for row in 0..100 {
                let std = graph.evaluate([point(&rows, row)])[0][rows.outputs + output];
                assert!(std >= least * (1.0 - 1e-12), "{row}: {std} {least}");
                assert!(std < 1e-4 * rows.scaling.output_scale[output], "{row}: {std}");
            }
            for row in 100..150 {
                let values = graph.evaluate([point(&rows, row)])[0].to_vec();
                let error = (values[output] - label(&rows, row, output)).abs();
                assert!(
                    error <= 10.0 * values[rows.outputs + output],
                    "{row}: {error} {}",
                    values[rows.outputs + output]
                );
            }
        }
    }
}
