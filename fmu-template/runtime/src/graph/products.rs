//! Products of Legendre polynomials.

use super::{cell::Cell, series::Series};
use crate::{
    FormatError,
    check::expect_shape,
    numbers::jet::Number,
    simd::{Lanes, Real, flat, flat_mut},
};

/// `y_t = prod_i P_degrees[t, i](x_i)`, with Legendre polynomials `P_k`: on `[-1, 1]` they stay of order one and hardly depend on each
/// other, whatever the degree.
#[derive(Clone, Debug, PartialEq)]
pub struct Products {
    /// Number of `x_i`.
    pub inputs: usize,
    /// Degree of each term in each input: shape `[terms, inputs]`.
    pub degrees: Vec<u8>,
}

impl Products {
    /// Degrees of every term of `inputs` polynomials whose total degree is at most `degree`; none if there are more than `most`.
    pub fn up_to(inputs: usize, degree: u8, most: usize) -> Option<Vec<Vec<u8>>> {
        let mut all = vec![Vec::new()];
        for _ in 0..inputs {
            let longer = all.iter().flat_map(|degrees: &Vec<u8>| {
                let rest = degree - degrees.iter().sum::<u8>();
                (0..=rest).map(move |next| [degrees.as_slice(), &[next]].concat())
            });
            all = longer.collect();
            if all.len() > most {
                return None;
            }
        }
        Some(all)
    }

    /// Number of terms.
    pub fn terms(&self) -> usize {
        self.degrees.len() / self.inputs.max(1)
    }

    /// Number of polynomials of an input: degrees 0, 1, ... up to the highest of all inputs.
    pub fn orders(&self) -> usize {
        usize::from(self.degrees.iter().copied().max().unwrap_or(0)) + 1
    }

    /// Number of polynomials of all inputs, which an evaluation computes first.
    pub fn polynomials(&self) -> usize {
        self.inputs.saturating_mul(self.orders())
    }

    pub(super) fn check(&self, name: &str, inputs: usize) -> Result<(), FormatError> {
        expect_shape(name, &[self.terms(), self.inputs], &[self.terms(), inputs])?;
        expect_shape(name, &[self.degrees.len()], &[self.terms() * inputs])
    }

    /// Values of the terms, to which the coefficients of a polynomial are fitted.
    ///
    /// # Panics
    /// If there are fewer `values` than terms.
    pub fn evaluate(&self, inputs: &[f64], values: &mut [f64]) {
        let orders = self.orders();
        let mut polynomials = vec![0.0; self.polynomials()];
        for (x, polynomials) in inputs.iter().zip(polynomials.chunks_exact_mut(orders)) {
            legendre(*x, orders, |order, value: f64| polynomials[order] = value);
        }
        for (value, degrees) in values.iter_mut().zip(self.degrees.chunks_exact(self.inputs)) {
            let places = degrees.iter().enumerate().filter(|(_, degree)| **degree > 0);
            *value = places.map(|(input, degree)| polynomials[input * orders + usize::from(*degree)]).product();
        }
    }
}

/// Calls back with `P_0(x), P_1(x), ...` by Bonnet's recursion, `(k + 1) P_(k+1) = (2k + 1) x P_k - k P_(k-1)`.
fn legendre<N: Number>(x: N, orders: usize, mut act: impl FnMut(usize, N)) {
    let (mut before, mut last) = (N::from(1.0), x);
    act(0, before);
    for order in 1..orders {
        act(order, last);
        let k = order as f64;
        let by_x = x.scaled((2.0 * k + 1.0) / (k + 1.0)) * last;
        (before, last) = (last, by_x - before.scaled(k / (k + 1.0)));
    }
}

/// The products as a walk over numbers: those of the step are the terms, from the next whole vector on the polynomials of each input.
#[derive(Clone, Debug)]
pub(super) struct PreparedProducts {
    inputs: usize,
    orders: usize,
    /// Position of the first polynomial.
    polynomials: usize,
    /// Positions of the factors of each term: polynomials, or an earlier term that has all factors but the last.
    factors: Vec<u32>,
    /// End of the factors of each term.
    ends: Vec<u32>,
}

impl PreparedProducts {
    /// For vectors of `width` numbers.
    pub(super) fn new(products: &Products, width: usize) -> Self {
        let orders = products.orders();
        let polynomials = products.terms().next_multiple_of(width);
        let (mut factors, mut ends) = (Vec::new(), Vec::with_capacity(products.terms()));
        // for each input, the last term without factors of it and of those after it. In the order of `up_to` it is the one that a longer
        // term continues; in another order fewer terms are shared
        let mut shorter = vec![None; products.inputs];
        for (term, degrees) in products.degrees.chunks_exact(products.inputs).enumerate() {
            let begin = factors.len();
            for (input, degree) in degrees.iter().enumerate().filter(|(_, degree)| **degree > 0) {
                factors.push((polynomials + input * orders + usize::from(*degree)) as u32);
            }
            let end = degrees.iter().rposition(|degree| *degree > 0).map_or(0, |last| last + 1);
            if let [_, _, .., last] = factors[begin..]
                && let Some(earlier) = shorter[end - 1]
                && products.degrees[earlier * products.inputs..].starts_with(&degrees[..end - 1])
            {
                factors.truncate(begin);
                factors.extend([earlier as u32, last]);
            }
            shorter[end..].fill(Some(term));
            ends.push(factors.len() as u32);
        }
        Self { inputs: products.inputs, orders, polynomials, factors, ends }
    }

    /// Number of numbers: terms and polynomials.
    pub(super) fn numbers(&self) -> usize {
        self.polynomials + self.inputs * self.orders
    }

    /// Terms with the positions of their factors.
    fn terms(&self) -> impl DoubleEndedIterator<Item = (usize, &[u32])> + ExactSizeIterator {
        self.ends.iter().enumerate().map(|(term, end)| {
            let begin = if term == 0 { 0 } else { self.ends[term - 1] as usize };
            (term, &self.factors[begin..*end as usize])
        })
    }

    pub(super) fn run<N: Cell, T: Real, const WIDTH: usize>(&self, from: &Series<T, WIDTH>, to: &mut Series<T, WIDTH>) {
        for input in 0..self.inputs {
            let first = self.polynomials + input * self.orders;
            legendre(N::load(from, input), self.orders, |order, value| value.store(to, first + order));
        }
        for (term, factors) in self.terms() {
            let product = factors.split_first().map_or(N::from(1.0), |(first, rest)| {
                rest.iter().fold(N::load(to, *first as usize), |product, at| product * N::load(to, *at as usize))
            });
            product.store(to, term);
        }
    }

    /// Adds to the cotangents `sums` of the inputs. `y` are the numbers of the step, `change` their cotangents, of which those of the
    /// polynomials are zero at first.
    pub(super) fn adjoint<T: Real, const WIDTH: usize>(
        &self,
        y: &[Lanes<T, WIDTH>],
        change: &mut [Lanes<T, WIDTH>],
        sums: &mut [Lanes<T, WIDTH>],
    ) {
        let (y, change, sums) = (flat(y), flat_mut(change), flat_mut(sums));
        for (term, factors) in self.terms().rev() {
            let of_term = change[term];
            if of_term == T::ZERO {
                continue;
            }
            for (index, factor) in factors.iter().enumerate() {
                let others = factors.iter().enumerate().filter(|(other, _)| *other != index);
                let slope = others.fold(of_term, |slope, (_, other)| slope * y[*other as usize]);
                change[*factor as usize] = change[*factor as usize] + slope;
            }
        }
        let polynomials = self.polynomials..self.numbers();
        let values = y[polynomials.clone()].chunks_exact(self.orders);
        for ((values, change), sum) in values.zip(change[polynomials].chunks_exact(self.orders)).zip(sums) {
            // P'_(k+1) = P'_(k-1) + (2k + 1) P_k
            let (mut before, mut slope) = (0.0, 1.0);
            let mut total = 0.0;
            for (order, change) in change.iter().enumerate().skip(1) {
                total += slope * (*change).into();
                (before, slope) = (slope, before + (2.0 * order as f64 + 1.0) * values[order].into());
            }
            *sum = *sum + T::narrow(total);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Positions of the polynomials of a term.
    fn expanded(prepared: &PreparedProducts, term: usize) -> Vec<u32> {
        let factors = prepared.terms().nth(term).unwrap().1;
        let of = |factor: &u32| match (*factor as usize) < prepared.polynomials {
            true => expanded(prepared, *factor as usize),
            false => vec![*factor],
        };
        factors.iter().flat_map(of).collect()
    }

    #[test]
    fn terms_continue_shorter_ones_in_any_order() {
        let ordered = Products::up_to(4, 6, 1000).unwrap();
        let reversed: Vec<_> = ordered.iter().rev().cloned().collect();
        let repeated = [ordered.clone(), reversed.clone(), ordered.clone()].concat();
        for rows in [&ordered, &reversed, &repeated] {
            let products = Products { inputs: 4, degrees: rows.concat() };
            let prepared = PreparedProducts::new(&products, 8);
            for (term, degrees) in rows.iter().enumerate() {
                let place =
                    |(input, degree): (usize, &u8)| (prepared.polynomials + 7 * input) as u32 + u32::from(*degree);
                let expected: Vec<u32> = degrees.iter().enumerate().filter(|(_, of)| **of > 0).map(place).collect();
                assert_eq!(expanded(&prepared, term), expected, "{degrees:?}");
            }
            assert!(rows != &ordered || prepared.terms().all(|(_, factors)| factors.len() <= 2));
        }
    }
}
