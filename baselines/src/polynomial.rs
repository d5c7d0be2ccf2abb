//! Polynomials of all inputs together.

use crate::{Baseline, BaselineCause, BaselineError, Fitted, StandardizedRows};
use metafmu_core::study::baselines::{MAX_TERMS, Polynomial};
use metafmu_runtime::{
    Scaling,
    graph::{Graph, Products},
};
use nalgebra::DMatrix;
use rayon::prelude::*;

/// Rows of a product of matrices, and of a partial sum: the same whatever the number of threads.
const BLOCK: usize = 1024;
const PART: usize = 64 * BLOCK;

/// Maximum number of terms if the study gives no degree.
const USUAL_TERMS: usize = 1000;
const USUAL_DEGREE: u8 = 6;

impl Baseline for Polynomial {
    fn most_rows(&self) -> Option<usize> {
        Some(self.rows)
    }

    fn fit(&self, rows: &StandardizedRows, _: u64) -> Result<Fitted, BaselineError> {
        let inputs = rows.inputs;
        let degrees = match self.degree {
            Some(degree) => degrees(inputs, degree, MAX_TERMS)?,
            None => usual_degrees(inputs)?,
        };
        let products = Products { inputs, degrees };
        let (middle, half) = ranges(rows);
        let parts: Vec<(DMatrix<f64>, DMatrix<f64>)> = rows
            .x
            .par_chunks(PART * inputs)
            .zip(rows.y.par_chunks(PART * rows.outputs))
            .map(|(x, y)| normal_equations(&products, x, y, &middle, &half))
            .collect();
        let (mut matrix, mut right) = parts
            .into_iter()
            .reduce(|a, b| (a.0 + b.0, a.1 + b.1))
            .ok_or_else(|| BaselineError::new(BaselineCause::Rows, "no rows"))?;
        matrix /= rows.len() as f64;
        right /= rows.len() as f64;
        (0..matrix.nrows()).for_each(|term| matrix[(term, term)] += self.alpha);
        let singular = "the terms depend on each other in these rows: lower `degree` or raise `alpha`";
        let factors = matrix.cholesky().ok_or_else(|| BaselineError::new(BaselineCause::Rows, singular))?;
        let weights = factors.solve(&right);
        // column by column: the coefficients of each output
        let scaling = scaled_to(&rows.scaling, &middle, &half);
        Ok(Fitted::Formula(Graph::of_polynomial(&scaling, products, weights.as_slice())))
    }
}

/// `X^T X` and `X^T y` of some rows.
fn normal_equations(
    products: &Products,
    x: &[f64],
    y: &[f64],
    middle: &[f64],
    half: &[f64],
) -> (DMatrix<f64>, DMatrix<f64>) {
    let inputs = middle.len();
    let (terms, outputs) = (products.terms(), y.len() * inputs / x.len());
    let (mut matrix, mut right) = (DMatrix::zeros(terms, terms), DMatrix::zeros(terms, outputs));
    let mut z = vec![0.0; inputs];
    for (x, y) in x.chunks(BLOCK * inputs).zip(y.chunks(BLOCK * outputs)) {
        let count = x.len() / inputs;
        // a column a row, which is how the terms are made
        let mut values = DMatrix::zeros(terms, count);
        for (x, values) in x.chunks(inputs).zip(values.as_mut_slice().chunks_mut(terms)) {
            let columns = x.iter().zip(middle).zip(half);
            z.iter_mut().zip(columns).for_each(|(z, ((x, middle), half))| *z = (x - middle) / half);
            products.evaluate(&z, values);
        }
        let y = DMatrix::from_column_slice(outputs, count, y);
        matrix.gemm(1.0, &values, &values.transpose(), 1.0);
        right.gemm(1.0, &values, &y.transpose(), 1.0);
    }
    (matrix, right)
}

/// [`degrees`] up to the highest usual degree that makes no more than the usual number of terms; else up to 1.
fn usual_degrees(inputs: usize) -> Result<Vec<u8>, BaselineError> {
    let usual = (2..=USUAL_DEGREE).rev().find_map(|degree| degrees(inputs, degree, USUAL_TERMS).ok());
    usual.map_or_else(|| degrees(inputs, 1, MAX_TERMS), Ok)
}

/// Every combination of powers with a sum of at most `degree`, row by row.
///
/// # Errors
/// [`BaselineCause::TooLarge`] if there are more than `most` of them, with the option to change.
pub fn degrees(inputs: usize, degree: u8, most: usize) -> Result<Vec<u8>, BaselineError> {
    let all = Products::up_to(inputs, degree, most).map(|all| all.concat());
    all.ok_or_else(|| {
        let message = format!("more than {most} terms of degree {degree} in {inputs} inputs: lower `degree`");
        BaselineError::new(BaselineCause::TooLarge, message)
    })
}

/// Middle and half width of the range of each standardized input.
fn ranges(rows: &StandardizedRows) -> (Vec<f64>, Vec<f64>) {
    let ranges = (0..rows.inputs).map(|column| {
        let values = rows.x.iter().skip(column).step_by(rows.inputs);
        let (min, max) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(min, max), &z| (min.min(z), max.max(z)));
        (0.5 * (min + max), if max > min { 0.5 * (max - min) } else { 1.0 })
    });
    ranges.unzip()
}

/// The scaling that maps the ranges of the inputs to `[-1, 1]`.
fn scaled_to(scaling: &Scaling, middle: &[f64], half: &[f64]) -> Scaling {
    let Scaling { input_mean, input_scale, .. } = scaling;
    let columns = input_mean.iter().zip(input_scale).zip(middle.iter().zip(half));
    let (input_mean, input_scale) =
        columns.map(|((mean, scale), (middle, half))| (mean + scale * middle, scale * half)).unzip();
    Scaling { input_mean, input_scale, ..scaling.clone() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{formula_at, least_squares, wavy_rows};

    #[test]
    fn of_degree_one_it_is_linear_least_squares() {
        let rows = wavy_rows(400);
        let fitted = Polynomial { degree: Some(1), alpha: 0.0, ..Polynomial::default() }.fit(&rows, 1).unwrap();
        let expected = least_squares(&rows, 0, 0.0);
        for row in 0..40 {
            let z = &rows.x[row * 3..][..3];
            let by_hand = expected[0] + z.iter().zip(&expected[1..]).map(|(z, w)| z * w).sum::<f64>();
            assert!((formula_at(&fitted, &rows, row)[0] - by_hand).abs() < 1e-10);
        }
    }

    #[test]
    fn a_polynomial_is_found_again_at_points_between_the_rows() {
        // the second output is a polynomial of degree 2
        let rows = wavy_rows(800);
        let fitted = Polynomial { degree: Some(4), alpha: 0.0, ..Polynomial::default() };
        let fitted = fitted.fit(&rows.choose(&(0..400).collect::<Vec<_>>()), 1).unwrap();
        for row in 400..800 {
            let error = formula_at(&fitted, &rows, row)[1] - rows.y[row * 2 + 1];
            assert!(error.abs() < 1e-9, "row {row}: {error:e}");
        }
    }

    #[test]
    fn many_rows_are_summed_in_parts_and_too_many_terms_are_refused() {
        assert_eq!(degrees(2, 2, MAX_TERMS).unwrap(), [0, 0, 0, 1, 0, 2, 1, 0, 1, 1, 2, 0]);
        assert_eq!(degrees(4, 6, MAX_TERMS).unwrap().len() / 4, 210);
        let error = degrees(100, 6, MAX_TERMS).unwrap_err();
        assert_eq!(error.cause, BaselineCause::TooLarge);
        assert!(error.message.starts_with("more than 5000 terms"), "{error}");
    }

    #[test]
    fn the_usual_degree_falls_with_the_number_of_inputs() {
        let usual = |inputs| usual_degrees(inputs).unwrap().iter().copied().max().unwrap();
        assert_eq!([1, 4, 6, 7, 9, 16, 100].map(usual), [6, 6, 6, 5, 4, 3, 1]);
    }
}
