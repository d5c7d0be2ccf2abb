//! Polynomials in several variables.

use crate::{
    FormatError,
    map::{expect_finite, expect_shape, jet::Number},
};

/// `y_o = sum_t coefficients[o, t] * prod_i P_degrees[t, i](z_i)`, with Legendre polynomials `P_k`: on `[-1, 1]` they stay
/// of order one and hardly depend on each other, whatever the degree.
#[derive(Clone, Debug, PartialEq)]
pub struct Polynomial {
    /// Degree of each term in each input: shape `[terms, inputs]`.
    pub degrees: Vec<u8>,
    /// Shape `[outputs, terms]`.
    pub coefficients: Vec<f64>,
}

impl Polynomial {
    /// Number of terms, of which there must be some.
    pub fn terms(&self, inputs: usize) -> usize {
        self.degrees.len() / inputs
    }

    pub(super) fn check(&self, inputs: usize, outputs: usize) -> Result<(), FormatError> {
        let terms = self.terms(inputs);
        expect_shape("polynomial.degrees", &[self.degrees.len()], &[terms.max(1) * inputs])?;
        expect_shape("polynomial.coefficients", &[self.coefficients.len()], &[terms * outputs])?;
        expect_finite("polynomial.coefficients", self.coefficients.iter().copied())
    }

    /// Numbers that an evaluation notes down.
    pub(super) fn table_size(&self, inputs: usize) -> usize {
        inputs * (self.degree() + 1)
    }

    /// Highest degree in one input.
    fn degree(&self) -> usize {
        self.degrees.iter().copied().max().unwrap_or(0).into()
    }

    /// # Panics
    /// If the table is smaller than [`Polynomial::table_size`].
    pub(super) fn evaluate<N: Number>(&self, inputs: &[N], outputs: &mut [N], table: &mut [N]) {
        outputs.fill(N::from(0.0));
        let terms = self.terms(inputs.len());
        self.for_each_term(inputs, table, |term, value| {
            for (y, coefficients) in outputs.iter_mut().zip(self.coefficients.chunks_exact(terms)) {
                *y = *y + value * N::from(coefficients[term]);
            }
        });
    }

    /// The products of Legendre polynomials by themselves, whatever the coefficients: what a fit is made to.
    ///
    /// # Panics
    /// If there are no inputs or fewer `values` than terms.
    pub fn values_of_terms(&self, inputs: &[f64], values: &mut [f64]) {
        let mut table = vec![0.0; self.table_size(inputs.len())];
        self.for_each_term(inputs, &mut table, |term, value| values[term] = value);
    }

    fn for_each_term<N: Number>(&self, inputs: &[N], table: &mut [N], mut act: impl FnMut(usize, N)) {
        let width = self.degree() + 1;
        for (z, values) in inputs.iter().zip(table.chunks_exact_mut(width)) {
            legendre(*z, values);
        }
        for (term, degrees) in self.degrees.chunks_exact(inputs.len()).enumerate() {
            let factors = degrees.iter().enumerate().filter(|&(_, &degree)| degree > 0);
            let product = factors
                .fold(N::from(1.0), |product, (column, &degree)| product * table[column * width + usize::from(degree)]);
            act(term, product);
        }
    }
}

/// `P_0(z), P_1(z), ...` by Bonnet's recursion, `(k + 1) P_(k+1) = (2k + 1) z P_k - k P_(k-1)`.
fn legendre<N: Number>(z: N, values: &mut [N]) {
    values[0] = N::from(1.0);
    if let Some(first) = values.get_mut(1) {
        *first = z;
    }
    for k in 1..values.len().saturating_sub(1) {
        let next = k as f64 + 1.0;
        let by_z = N::from((2.0 * k as f64 + 1.0) / next) * z * values[k];
        values[k + 1] = by_z - N::from(k as f64 / next) * values[k - 1];
    }
}
