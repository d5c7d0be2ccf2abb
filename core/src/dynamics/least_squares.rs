//! Coefficients of a dictionary from labels.

use super::{EquationSamples, terms};
use metafmu_runtime::dictionary::{Dictionary, Factor, Term};
use nalgebra::DMatrix;
use std::ops::Range;

/// The coefficients of least squares, shape `[products, functions]`, and the largest error of any function at unseen points, relative
/// to its scale.
///
/// # Errors
/// A sentence if the points do not determine the coefficients.
pub(super) fn solve(
    factors: &[Factor],
    exponents: &[Vec<i16>],
    samples: &EquationSamples,
    unseen: &EquationSamples,
    scales: &[f64],
) -> Result<(DMatrix<f64>, f64), String> {
    let (rows, functions) = (samples.points.len(), scales.len());
    let matrix = terms::values(factors, exponents, &samples.points).map_err(|error| error.to_string())?;
    let mut sides = DMatrix::from_fn(rows, functions, |row, function| samples.labels[row][function]);
    let decomposition = matrix.qr();
    decomposition.q_tr_mul(&mut sides);
    let sides = sides.rows(0, exponents.len()).into_owned();
    let mut coefficients = decomposition
        .r()
        .solve_upper_triangular(&sides)
        .filter(|solution| solution.iter().all(|value| value.is_finite()))
        .ok_or("the terms depend on each other in these configurations")?;
    // coefficients that together are far below the error cost time and are worth nothing
    let error = error_of(&dictionary(factors, exponents, &coefficients, 0..functions)?, unseen, scales);
    let negligible = (0.1 * error / exponents.len() as f64).max(1e-14);
    for (mut column, scale) in coefficients.column_iter_mut().zip(scales) {
        column.iter_mut().filter(|value| value.abs() < negligible * scale).for_each(|value| *value = 0.0);
    }
    let error = error_of(&dictionary(factors, exponents, &coefficients, 0..functions)?, unseen, scales);
    Ok((coefficients, error))
}

/// The functions of some columns of the coefficients.
pub(super) fn dictionary(
    factors: &[Factor],
    exponents: &[Vec<i16>],
    coefficients: &DMatrix<f64>,
    columns: Range<usize>,
) -> Result<Dictionary, String> {
    let rows = exponents.iter().zip(coefficients.row_iter());
    let terms: Vec<Term> = rows
        .map(|(exponents, row)| Term {
            exponents: exponents.clone(),
            coefficients: row.columns_range(columns.clone()).iter().copied().collect(),
        })
        .collect();
    Dictionary::new(factors, columns.len(), &terms).map_err(|error| error.to_string())
}

/// Largest error of any function at unseen points, relative to its scale.
fn error_of(law: &Dictionary, unseen: &EquationSamples, scales: &[f64]) -> f64 {
    let mut found = vec![0.0; scales.len()];
    let mut error = 0.0f64;
    for (point, expected) in unseen.points.iter().zip(&unseen.labels) {
        law.evaluate(point, &mut found);
        for ((found, expected), scale) in found.iter().zip(expected).zip(scales) {
            error = error.max((found - expected).abs() / scale);
        }
    }
    error
}
