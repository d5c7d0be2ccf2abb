//! Which products a dictionary has.

use metafmu_runtime::{
    FormatError, Rows,
    dictionary::{Dictionary, Factor, SPLINE_POWERS, SplineFactor, Term},
};
use nalgebra::DMatrix;

/// Factors of products.
#[derive(Clone, Copy)]
pub(super) struct FactorSet<'a> {
    /// Contribution of each column.
    pub(super) factors: &'a [Factor],
    /// Splines of columns.
    pub(super) splines: &'a [SplineFactor],
    /// Highest power of each column in a product; empty if none is limited.
    pub(super) highest: &'a [i16],
}

impl<'a> From<&'a [Factor]> for FactorSet<'a> {
    fn from(factors: &'a [Factor]) -> Self {
        Self { factors, splines: &[], highest: &[] }
    }
}

/// Largest sum of the powers of splines and their derivatives in a product: a mass matrix is quadratic in velocities of
/// bodies.
const SPLINE_ORDER: usize = 2;

/// Exponents of the products of [`exponents`] with powers of splines and of their derivatives up to the order
/// `derivatives`.
pub(super) fn exponents_with_splines(set: FactorSet, order: [usize; 2], derivatives: usize) -> Vec<Vec<i16>> {
    let mut powers = vec![(Vec::new(), SPLINE_ORDER)];
    for position in 0..SPLINE_POWERS * set.splines.len() {
        let most = if position % SPLINE_POWERS <= derivatives { SPLINE_ORDER } else { 0 };
        let mut next = Vec::new();
        for (before, rest) in &powers {
            let own = 0..=most.min(*rest);
            next.extend(own.map(|power| ([&before[..], &[power as i16]].concat(), rest - power)));
        }
        powers = next;
    }
    let mut of_columns = exponents(set.factors, order);
    of_columns.retain(|own| own.iter().zip(set.highest).all(|(exponent, highest)| exponent <= highest));
    of_columns.iter().flat_map(|own| powers.iter().map(|(powers, _)| [&own[..], powers].concat())).collect()
}

/// Returns true if a product has factors of the `used` columns alone.
pub(super) fn uses_only(exponents: &[i16], used: &[bool]) -> bool {
    exponents.iter().zip(used).all(|(exponent, used)| *exponent == 0 || *used)
}

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
pub(super) fn values(set: FactorSet, exponents: &[Vec<i16>], points: &Rows) -> Result<DMatrix<f64>, FormatError> {
    let count = exponents.len();
    // each product is a function
    let terms = exponents.iter().enumerate().map(|(term, exponents)| {
        let coefficients = (0..count).map(|output| f64::from(u8::from(output == term))).collect();
        Term { exponents: exponents.clone(), coefficients }
    });
    let terms: Vec<Term> = terms.collect();
    let dictionary = Dictionary::with_splines(set.factors, set.splines, count, &terms)?;
    let mut transposed = DMatrix::zeros(count, points.len());
    for (point, mut column) in points.iter().zip(transposed.column_iter_mut()) {
        dictionary.evaluate(point, column.as_mut_slice());
    }
    Ok(transposed.transpose())
}
