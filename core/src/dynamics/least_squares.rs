//! Coefficients of a dictionary from labels.

use super::{
    EquationSamples,
    terms::{self, FactorSet},
};
use crate::multibody::{MotionCause, MotionError};
use metafmu_runtime::{
    FormatError,
    dictionary::{Dictionary, Term},
};
use nalgebra::DMatrix;
use std::{fmt, ops::Range};

/// Reason why a dictionary's coefficients are not found.
#[derive(Debug)]
pub enum DictionaryError {
    /// There are more terms than this even at the lowest order.
    TooManyTerms(usize),
    /// There are too many terms of the lowest order for the samples, or too many at all.
    TooFewSamples,
    /// The samples do not determine the coefficients.
    Dependent,
    /// Coefficients of which no dictionary can be made.
    Format(FormatError),
}

impl fmt::Display for DictionaryError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooManyTerms(most) => {
                write!(f, "more than {most} terms even at the lowest order: fewer coordinates or parameters are needed")
            }
            Self::TooFewSamples => f.write_str("too many states, inputs and parameters, or too few samples"),
            Self::Dependent => f.write_str("the terms depend on each other in these configurations"),
            Self::Format(error) => error.fmt(f),
        }
    }
}

impl std::error::Error for DictionaryError {}

impl From<DictionaryError> for String {
    fn from(error: DictionaryError) -> Self {
        error.to_string()
    }
}

impl From<DictionaryError> for MotionError {
    fn from(error: DictionaryError) -> Self {
        Self::new(MotionCause::Unsuitable, error.to_string())
    }
}

/// Contribution of a product, relative to a function's scale, below which it may be dropped.
const LITTLE: f64 = 1e-9;

/// Error that rounding makes, relative to a function's scale.
const ROUNDING: f64 = 1e-13;

/// The coefficients of least squares, shape `[products, functions]`, and the largest error of any function at unseen points, relative
/// to its scale.
///
/// Splines are nearly sums of harmonics, so rounding causes large coefficients of products that cancel each other.
/// Products with small contributions are dropped if the error does not grow.
///
/// # Errors
/// [`DictionaryError`]: the points do not determine the coefficients.
pub(super) fn solve(
    set: FactorSet,
    exponents: &[Vec<i16>],
    samples: &EquationSamples,
    unseen: &EquationSamples,
    scales: &[f64],
) -> Result<(DMatrix<f64>, f64), DictionaryError> {
    let Solved { coefficients, sizes, error } = solve_for(set, exponents, samples, unseen, scales)?;
    if set.splines.is_empty() {
        return Ok((coefficients, error));
    }
    let kept = (0..exponents.len()).filter(|term| {
        let row = coefficients.row(*term);
        row.iter().zip(scales).any(|(value, scale)| value.abs() * sizes[*term] > LITTLE * scale)
    });
    let kept: Vec<usize> = kept.collect();
    let fewer: Vec<Vec<i16>> = kept.iter().map(|term| exponents[*term].clone()).collect();
    match solve_for(set, &fewer, samples, unseen, scales) {
        Ok(found) if found.error <= 2.0 * error.max(ROUNDING) => {
            let mut all = DMatrix::zeros(exponents.len(), scales.len());
            kept.iter().zip(found.coefficients.row_iter()).for_each(|(term, row)| all.set_row(*term, &row));
            Ok((all, found.error))
        }
        _ => Ok((coefficients, error)),
    }
}

/// The coefficients of [`solve`] with products of the `used` columns alone; the others are zero.
///
/// # Errors
/// As [`solve`].
pub(super) fn solve_with(
    (set, used): (FactorSet, &[bool]),
    exponents: &[Vec<i16>],
    samples: &EquationSamples,
    unseen: &EquationSamples,
    scales: &[f64],
) -> Result<(DMatrix<f64>, f64), DictionaryError> {
    let kept: Vec<usize> = (0..exponents.len()).filter(|term| terms::uses_only(&exponents[*term], used)).collect();
    let of_used: Vec<Vec<i16>> = kept.iter().map(|term| exponents[*term].clone()).collect();
    let (coefficients, error) = solve(set, &of_used, samples, unseen, scales)?;
    let mut all = DMatrix::zeros(exponents.len(), scales.len());
    kept.iter().zip(coefficients.row_iter()).for_each(|(term, row)| all.set_row(*term, &row));
    Ok((all, error))
}

/// Coefficients of products, shape `[products, functions]`, largest magnitudes of the products, and the error.
struct Solved {
    coefficients: DMatrix<f64>,
    sizes: Vec<f64>,
    error: f64,
}

fn solve_for(
    set: FactorSet,
    exponents: &[Vec<i16>],
    samples: &EquationSamples,
    unseen: &EquationSamples,
    scales: &[f64],
) -> Result<Solved, DictionaryError> {
    let (rows, functions) = (samples.points.len(), scales.len());
    let matrix = terms::values(set, exponents, &samples.points).map_err(DictionaryError::Format)?;
    // powers of splines may be small or large; sines, cosines and other powers are one at most
    let sizes = exponents.iter().zip(matrix.column_iter()).map(|(exponents, column)| {
        let has_splines = exponents[set.factors.len()..].iter().any(|power| *power != 0);
        if has_splines { column.amax() } else { 1.0 }
    });
    let sizes: Vec<f64> = sizes.collect();
    let mut sides = DMatrix::from_fn(rows, functions, |row, function| samples.labels[row][function]);
    let decomposition = matrix.qr();
    decomposition.q_tr_mul(&mut sides);
    let sides = sides.rows(0, exponents.len()).into_owned();
    let mut coefficients = decomposition
        .r()
        .solve_upper_triangular(&sides)
        .filter(|solution| solution.iter().all(|value| value.is_finite()))
        .ok_or(DictionaryError::Dependent)?;
    // coefficients that together are far below the error cost time and are worth nothing
    let error = error_of(&dictionary(set, exponents, &coefficients, 0..functions)?, unseen, scales);
    let negligible = (0.1 * error / exponents.len() as f64).max(1e-14);
    for (mut column, scale) in coefficients.column_iter_mut().zip(scales) {
        let small = column.iter_mut().zip(&sizes).filter(|(value, size)| value.abs() * **size < negligible * scale);
        small.for_each(|(value, _)| *value = 0.0);
    }
    let error = error_of(&dictionary(set, exponents, &coefficients, 0..functions)?, unseen, scales);
    Ok(Solved { coefficients, sizes, error })
}

/// The functions of some columns of the coefficients.
pub(super) fn dictionary(
    set: FactorSet,
    exponents: &[Vec<i16>],
    coefficients: &DMatrix<f64>,
    columns: Range<usize>,
) -> Result<Dictionary, DictionaryError> {
    let rows = exponents.iter().zip(coefficients.row_iter());
    let terms: Vec<Term> = rows
        .map(|(exponents, row)| Term {
            exponents: exponents.clone(),
            coefficients: row.columns_range(columns.clone()).iter().copied().collect(),
        })
        .collect();
    Dictionary::with_splines(set.factors, set.splines, columns.len(), &terms).map_err(DictionaryError::Format)
}

/// Largest error of any function at unseen points, relative to its scale.
fn error_of(function_set: &Dictionary, unseen: &EquationSamples, scales: &[f64]) -> f64 {
    let mut found = vec![0.0; scales.len()];
    let mut error = 0.0f64;
    for (point, expected) in unseen.points.iter().zip(&unseen.labels) {
        function_set.evaluate(point, &mut found);
        for ((found, expected), scale) in found.iter().zip(expected).zip(scales) {
            error = error.max((found - expected).abs() / scale);
        }
    }
    error
}
