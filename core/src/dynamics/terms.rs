//! Which products a dictionary has.

use metafmu_runtime::{
    FormatError,
    dictionary::{Dictionary, Factor, Term},
};
use nalgebra::DMatrix;

/// The exponents of all products whose harmonics have at most the first order in sum, and whose powers at most the second.
pub(super) fn exponents(factors: &[Factor], [harmonics, powers]: [usize; 2]) -> Vec<Vec<i16>> {
    let mut all = vec![(Vec::new(), harmonics, powers)];
    for factor in factors {
        let mut next = Vec::new();
        for (exponents, harmonics, powers) in all {
            let mut add = |exponent: i16, harmonics: usize, powers: usize| {
                let mut exponents: Vec<i16> = exponents.clone();
                exponents.push(exponent);
                next.push((exponents, harmonics, powers));
            };
            add(0, harmonics, powers);
            match factor {
                Factor::Angle => {
                    for order in 1..=harmonics {
                        add(order as i16, harmonics - order, powers);
                        add(-(order as i16), harmonics - order, powers);
                    }
                }
                Factor::Power { .. } => (1..=powers).for_each(|order| add(order as i16, harmonics, powers - order)),
            }
        }
        all = next;
    }
    all.into_iter().map(|(exponents, ..)| exponents).collect()
}

/// The products at some points, shape `[points, products]`: the outputs of a dictionary that has each product once.
///
/// # Errors
/// What [`Dictionary::new`] says.
pub(super) fn values(
    factors: &[Factor],
    exponents: &[Vec<i16>],
    points: &[Vec<f64>],
) -> Result<DMatrix<f64>, FormatError> {
    let count = exponents.len();
    let unit = |term: usize| (0..count).map(|output| f64::from(u8::from(output == term))).collect();
    let terms = exponents.iter().enumerate();
    let terms: Vec<Term> =
        terms.map(|(term, exponents)| Term { exponents: exponents.clone(), coefficients: unit(term) }).collect();
    let dictionary = Dictionary::new(factors, count, &terms)?;
    let mut transposed = DMatrix::zeros(count, points.len());
    for (point, mut column) in points.iter().zip(transposed.column_iter_mut()) {
        dictionary.evaluate(point, column.as_mut_slice());
    }
    Ok(transposed.transpose())
}
