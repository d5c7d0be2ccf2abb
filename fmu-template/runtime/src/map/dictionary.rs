//! Linear combinations of products of sines, cosines and powers: what the functions of a mechanism's configuration are made of.
//!
//! ```text
//! y_j = sum over terms t of c_tj  product over columns i of f(e_ti, x_i)
//! angle: f(e, x) = cos(e x) for e >= 0, sin(-e x) for e < 0
//! power: f(e, x) = ((x - middle) / half)^e
//! ```
//!
//! The entries of a mass matrix of revolute and prismatic joints are such sums exactly, with harmonics of order two at most; those of
//! a closed loop are analytic and periodic, so that their series converge geometrically.

use super::{expect_finite, expect_shape, jet::Number};
use crate::FormatError;
use std::{collections::BTreeMap, ops::Range};

/// What a column contributes to the products.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Factor {
    /// Sines and cosines of its multiples; in rad.
    Angle,
    /// Powers of `(x - middle) / half`.
    Power {
        /// Middle of its range.
        middle: f64,
        /// Half of its range.
        half: f64,
    },
}

impl Factor {
    /// `f(e, x)`.
    fn value(self, exponent: i16, x: f64) -> f64 {
        match self {
            Self::Angle if exponent < 0 => (-f64::from(exponent) * x).sin(),
            Self::Angle => (f64::from(exponent) * x).cos(),
            Self::Power { middle, half } => ((x - middle) / half).powi(i32::from(exponent)),
        }
    }
}

/// A product and what each output has of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Term {
    /// `e_ti`, one for each column: a harmonic, negative for a sine, or a power.
    pub exponents: Vec<i16>,
    /// `c_tj`, one for each output.
    pub coefficients: Vec<f64>,
}

/// A linear combination of products.
#[derive(Clone, Debug, PartialEq)]
pub struct Dictionary {
    columns: Vec<Column>,
    outputs: usize,
    /// Of all columns one after the other.
    atoms: usize,
    products: Vec<Product>,
    /// Column and atom of each factor other than 1, product by product.
    factors: Vec<(usize, usize)>,
    /// Output and coefficient, product by product.
    coefficients: Vec<(usize, f64)>,
    /// The same output by output: product and coefficient.
    of_outputs: Sums,
    /// Of the derivatives, output by output and, in an output, column by column: position among `factors` and coefficient.
    of_slopes: Sums,
}

/// Sums of some numbers with coefficients, as they are computed: one after the other, so that each stays in a register.
#[derive(Clone, Debug, Default, PartialEq)]
struct Sums {
    /// Position of a number, and its coefficient.
    parts: Vec<(usize, f64)>,
    /// Of each sum.
    ranges: Vec<Range<usize>>,
}

/// Working memory of an evaluation of a [`Dictionary`].
#[derive(Clone, Debug)]
pub(crate) struct DictionaryWork<T> {
    atoms: Vec<Atom<T>>,
    /// Values of the products and, after them, for each factor the product with its derivative in its place.
    products: Vec<T>,
}

/// A column and the functions of it that are computed.
#[derive(Clone, Debug, PartialEq)]
struct Column {
    factor: Factor,
    /// Of an angle: cos and sin of 1, cos and sin of 2, ...; of a power: 1, 2, ...
    atoms: Range<usize>,
}

#[derive(Clone, Debug, PartialEq)]
struct Product {
    factors: Range<usize>,
    coefficients: Range<usize>,
}

/// A function of a column and its derivative.
#[derive(Clone, Copy, Debug)]
struct Atom<T> {
    value: T,
    slope: T,
}

impl Dictionary {
    /// Lays the terms out for evaluation. Coefficients of zero cost nothing.
    ///
    /// # Errors
    /// [`FormatError`] if a term has not an exponent for each column and a coefficient for each output, or a number is not finite.
    pub fn new(factors: &[Factor], outputs: usize, terms: &[Term]) -> Result<Self, FormatError> {
        let mut columns: Vec<Column> = Vec::with_capacity(factors.len());
        for (index, factor) in factors.iter().enumerate() {
            let largest = terms.iter().filter_map(|term| term.exponents.get(index)).map(|e| e.unsigned_abs());
            let largest = usize::from(largest.max().unwrap_or(0));
            let first = columns.last().map_or(0, |column| column.atoms.end);
            let atoms = if *factor == Factor::Angle { 2 * largest } else { largest };
            columns.push(Column { factor: *factor, atoms: first..first + atoms });
            if let Factor::Power { middle, half } = factor {
                expect_finite("middle", [*middle].into_iter())?;
                super::expect_positive("half", &[*half])?;
            }
        }
        let mut dictionary = Self {
            atoms: columns.last().map_or(0, |column| column.atoms.end),
            columns,
            outputs,
            products: Vec::new(),
            factors: Vec::new(),
            coefficients: Vec::new(),
            of_outputs: Sums::default(),
            of_slopes: Sums::default(),
        };
        for term in terms {
            expect_shape("exponents", &[term.exponents.len()], &[factors.len()])?;
            expect_shape("coefficients", &[term.coefficients.len()], &[outputs])?;
            expect_finite("coefficients", term.coefficients.iter().copied())?;
            dictionary.add(term)?;
        }
        dictionary.lay_sums_out();
        Ok(dictionary)
    }

    fn lay_sums_out(&mut self) {
        let columns = self.columns.len();
        let mut of_outputs = vec![Vec::new(); self.outputs];
        let mut of_slopes = vec![Vec::new(); self.outputs * columns];
        for (index, product) in self.products.iter().enumerate() {
            for &(output, coefficient) in &self.coefficients[product.coefficients.clone()] {
                of_outputs[output].push((index, coefficient));
                for factor in product.factors.clone() {
                    of_slopes[output * columns + self.factors[factor].0].push((factor, coefficient));
                }
            }
        }
        (self.of_outputs, self.of_slopes) = (Sums::new(of_outputs), Sums::new(of_slopes));
    }

    fn add(&mut self, term: &Term) -> Result<(), FormatError> {
        let begin = (self.factors.len(), self.coefficients.len());
        for (index, (&exponent, column)) in term.exponents.iter().zip(&self.columns).enumerate() {
            let order = usize::from(exponent.unsigned_abs());
            let within = match column.factor {
                _ if exponent == 0 => continue,
                Factor::Angle => 2 * (order - 1) + usize::from(exponent < 0),
                Factor::Power { .. } if exponent < 0 => {
                    return Err(FormatError::NotPositive { name: "exponents".into(), index, value: exponent.into() });
                }
                Factor::Power { .. } => order - 1,
            };
            self.factors.push((index, column.atoms.start + within));
        }
        let present = term.coefficients.iter().copied().enumerate().filter(|(_, coefficient)| *coefficient != 0.0);
        self.coefficients.extend(present);
        if self.coefficients.len() == begin.1 {
            self.factors.truncate(begin.0);
        } else {
            let (factors, coefficients) = (begin.0..self.factors.len(), begin.1..self.coefficients.len());
            self.products.push(Product { factors, coefficients });
        }
        Ok(())
    }

    /// The same with the columns from `first` on held at some values: they stay, and no term depends on them.
    ///
    /// # Errors
    /// [`FormatError`] if a coefficient is too large for a number.
    ///
    /// # Panics
    /// If there are not as many values as columns from `first` on.
    pub fn held(&self, first: usize, values: &[f64]) -> Result<Self, FormatError> {
        let factors: Vec<Factor> = self.factors().collect();
        assert_eq!(values.len(), factors.len() - first, "number of values");
        let mut sums: BTreeMap<Vec<i16>, Vec<f64>> = BTreeMap::new();
        for Term { mut exponents, coefficients } in self.terms() {
            let held = exponents[first..].iter_mut().zip(&factors[first..]).zip(values);
            let factor = held.fold(1.0, |product, ((exponent, factor), value)| {
                product * factor.value(std::mem::take(exponent), *value)
            });
            let sum = sums.entry(exponents).or_insert_with(|| vec![0.0; self.outputs]);
            sum.iter_mut().zip(coefficients).for_each(|(sum, coefficient)| *sum += factor * coefficient);
        }
        let terms: Vec<Term> =
            sums.into_iter().map(|(exponents, coefficients)| Term { exponents, coefficients }).collect();
        Self::new(&factors, self.outputs, &terms)
    }

    /// Number of columns.
    pub fn columns(&self) -> usize {
        self.columns.len()
    }

    /// Number of outputs.
    pub fn outputs(&self) -> usize {
        self.outputs
    }

    /// What each column contributes.
    pub fn factors(&self) -> impl Iterator<Item = Factor> + '_ {
        self.columns.iter().map(|column| column.factor)
    }

    /// The products with their coefficients, as [`Dictionary::new`] takes them.
    pub fn terms(&self) -> impl Iterator<Item = Term> + '_ {
        self.products.iter().map(|product| {
            let mut term = Term { exponents: vec![0; self.columns.len()], coefficients: vec![0.0; self.outputs] };
            for &(column, atom) in &self.factors[product.factors.clone()] {
                let Column { factor, atoms } = &self.columns[column];
                let within = atom - atoms.start;
                // each was made from an exponent, so it fits
                term.exponents[column] = match factor {
                    Factor::Angle if within % 2 == 0 => (within / 2 + 1) as i16,
                    Factor::Angle => -((within / 2 + 1) as i16),
                    Factor::Power { .. } => (within + 1) as i16,
                };
            }
            for &(output, coefficient) in &self.coefficients[product.coefficients.clone()] {
                term.coefficients[output] = coefficient;
            }
            term
        })
    }

    /// Number of products with a coefficient other than zero.
    pub fn products(&self) -> usize {
        self.products.len()
    }

    /// `y` at `x`.
    ///
    /// # Panics
    /// If a slice has the wrong length.
    pub fn evaluate(&self, x: &[f64], y: &mut [f64]) {
        self.compute(x, y, &mut [], 0, &mut self.work());
    }

    /// `y` at `x` and its derivatives with respect to the first columns, shape `[outputs, first]`.
    ///
    /// # Panics
    /// If `x` has the wrong length.
    pub fn with_gradient(&self, x: &[f64], first: usize) -> (Vec<f64>, Vec<f64>) {
        let (mut y, mut gradient) = (vec![0.0; self.outputs], vec![0.0; self.outputs * first]);
        self.compute(x, &mut y, &mut gradient, first, &mut self.work());
        (y, gradient)
    }

    /// Working memory of an evaluation.
    pub(crate) fn work<T: Number>(&self) -> DictionaryWork<T> {
        let zero = T::from(0.0);
        DictionaryWork {
            atoms: vec![Atom { value: zero, slope: zero }; self.atoms],
            products: vec![zero; self.products.len() + self.factors.len()],
        }
    }

    /// `y` at `x`, and in `gradient`, shape `[outputs, first]`, derivatives with respect to the first columns, of as many outputs as it
    /// has. Does not allocate.
    ///
    /// # Panics
    /// If a slice has the wrong length.
    pub(crate) fn compute<T: Number>(
        &self,
        x: &[T],
        y: &mut [T],
        gradient: &mut [T],
        first: usize,
        work: &mut DictionaryWork<T>,
    ) {
        assert_eq!(x.len(), self.columns.len(), "number of columns");
        assert_eq!(y.len(), self.outputs, "number of outputs");
        assert!(gradient.len() <= first * self.outputs, "shape of the gradient");
        let DictionaryWork { atoms, products } = work;
        let (values, slopes) = products.split_at_mut(self.products.len());
        for (column, &x) in self.columns.iter().zip(x) {
            column.compute(x, &mut atoms[column.atoms.clone()]);
        }
        for (product, value) in self.products.iter().zip(values.iter_mut()) {
            let factors = &self.factors[product.factors.clone()];
            // most products of a closed loop with fixed parameters
            if let [(_, atom)] = factors {
                *value = atoms[*atom].value;
                slopes[product.factors.start] = atoms[*atom].slope;
                continue;
            }
            *value = factors.iter().fold(T::from(1.0), |product, (_, atom)| product * atoms[*atom].value);
            for (index, (column, atom)) in factors.iter().enumerate() {
                if *column < first {
                    let others = factors.iter().enumerate().filter(|(other, _)| *other != index);
                    slopes[product.factors.start + index] =
                        others.fold(atoms[*atom].slope, |product, (_, (_, atom))| product * atoms[*atom].value);
                }
            }
        }
        for (y, range) in y.iter_mut().zip(&self.of_outputs.ranges) {
            *y = self.of_outputs.sum(range, values);
        }
        if first > 0 {
            let of_outputs = self.of_slopes.ranges.chunks_exact(self.columns.len());
            for (gradient, ranges) in gradient.chunks_exact_mut(first).zip(of_outputs) {
                for (to, range) in gradient.iter_mut().zip(ranges) {
                    *to = self.of_slopes.sum(range, slopes);
                }
            }
        }
    }
}

impl Sums {
    fn new(sums: Vec<Vec<(usize, f64)>>) -> Self {
        let mut end = 0;
        let ranges = sums.iter().map(|parts| {
            end += parts.len();
            end - parts.len()..end
        });
        Self { ranges: ranges.collect(), parts: sums.concat() }
    }

    #[inline]
    fn sum<T: Number>(&self, range: &Range<usize>, values: &[T]) -> T {
        // four sums, so that an addition need not wait for the one before
        let mut sums = [T::from(0.0); 4];
        let (fours, rest) = self.parts[range.clone()].as_chunks::<4>();
        for four in fours {
            for (sum, (index, coefficient)) in sums.iter_mut().zip(four) {
                *sum = *sum + values[*index].scaled(*coefficient);
            }
        }
        for (sum, (index, coefficient)) in sums.iter_mut().zip(rest) {
            *sum = *sum + values[*index].scaled(*coefficient);
        }
        (sums[0] + sums[2]) + (sums[1] + sums[3])
    }
}

impl Column {
    fn compute<T: Number>(&self, x: T, atoms: &mut [Atom<T>]) {
        match self.factor {
            Factor::Angle => {
                let pairs = atoms.as_chunks_mut::<2>().0;
                if pairs.is_empty() {
                    return;
                }
                let (sine, cosine) = x.sin_cos();
                let pair = |k: f64, (s, c): (T, T)| {
                    [Atom { value: c, slope: s.scaled(-k) }, Atom { value: s, slope: c.scaled(k) }]
                };
                pairs[0] = pair(1.0, (sine, cosine));
                for order in 2..=pairs.len() {
                    // of the two halves, so that few wait for one another, and few rounding errors add up
                    let half = order / 2;
                    let ([c, s], [other_c, other_s]) =
                        (pairs[half - 1].map(|atom| atom.value), pairs[order - half - 1].map(|atom| atom.value));
                    pairs[order - 1] = pair(order as f64, (s * other_c + c * other_s, c * other_c - s * other_s));
                }
            }
            Factor::Power { middle, half } => {
                let scale = half.recip();
                let z = (x - T::from(middle)).scaled(scale);
                let mut power = T::from(1.0);
                for (order, atom) in (1u32..).zip(atoms) {
                    let slope = power.scaled(f64::from(order) * scale);
                    power = power * z;
                    *atom = Atom { value: power, slope };
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::map::jet::Jet;

    fn term(exponents: &[i16], coefficients: &[f64]) -> Term {
        Term { exponents: exponents.to_vec(), coefficients: coefficients.to_vec() }
    }

    fn example() -> Dictionary {
        let factors = [Factor::Angle, Factor::Power { middle: 1.0, half: 2.0 }, Factor::Angle];
        let terms = [
            term(&[0, 0, 0], &[0.5, -1.0]),
            term(&[2, 1, 0], &[1.5, 0.0]),
            term(&[-3, 2, 1], &[-0.7, 0.2]),
            term(&[1, 3, -1], &[0.0, 2.0]),
        ];
        Dictionary::new(&factors, 2, &terms).unwrap()
    }

    fn formula([a, b, c]: [f64; 3]) -> [f64; 2] {
        let z = (b - 1.0) / 2.0;
        let (third, fourth) = ((3.0 * a).sin() * z * z * c.cos(), a.cos() * z.powi(3) * c.sin());
        [0.5 + 1.5 * (2.0 * a).cos() * z - 0.7 * third, -1.0 + 0.2 * third + 2.0 * fourth]
    }

    const POINT: [f64; 3] = [0.8, 2.3, -1.1];

    #[test]
    fn values_are_those_of_the_formula() {
        let mut y = [0.0; 2];
        example().evaluate(&POINT, &mut y);
        for (found, expected) in y.iter().zip(formula(POINT)) {
            assert!((found - expected).abs() < 1e-15, "{found} {expected}");
        }
    }

    #[test]
    fn held_columns_are_constants() {
        for first in 0..=3 {
            let held = example().held(first, &POINT[first..]).unwrap();
            // what is held has no effect any more
            let mut point = POINT;
            point[first..].fill(0.1);
            let (mut y, mut gradient, mut expected) = ([0.0; 2], vec![0.0; 2 * first], vec![0.0; 2 * first]);
            held.compute(&point, &mut y, &mut gradient, first, &mut held.work());
            for (found, expected) in y.iter().zip(formula(POINT)) {
                assert!((found - expected).abs() < 1e-15, "{found} {expected}");
            }
            example().compute(&POINT, &mut y, &mut expected, first, &mut example().work());
            for (found, expected) in gradient.iter().zip(&expected) {
                assert!((found - expected).abs() < 1e-14, "{found} {expected}");
            }
        }
        assert_eq!(example().held(1, &POINT[1..]).unwrap().products(), 4);
    }

    #[test]
    fn gradients_and_series_are_those_of_finite_differences() {
        let dictionary = example();
        let (mut y, mut gradient) = ([0.0; 2], [0.0; 6]);
        dictionary.compute(&POINT, &mut y, &mut gradient, 3, &mut dictionary.work());
        let step = 1e-4;
        for column in 0..3 {
            let moved = |by: f64| {
                let mut point = POINT;
                point[column] += by;
                formula(point)
            };
            let [far, near] = [2.0, 1.0].map(|k| [moved(k * step), moved(-k * step)]);
            for output in 0..2 {
                let expected =
                    (8.0 * (near[0][output] - near[1][output]) - far[0][output] + far[1][output]) / (12.0 * step);
                let found = gradient[3 * output + column];
                assert!((found - expected).abs() < 1e-11, "{output} {column}: {found} {expected}");
            }
        }
        // along a curve the series has the gradient, and the gradient's own series
        let direction = [0.3, -0.4, 1.2];
        let along: [Jet; 3] = std::array::from_fn(|i| Jet { value: POINT[i], first: direction[i], second: 0.0 });
        let (mut series, mut of_gradient) = ([Jet::default(); 2], [Jet::default(); 6]);
        dictionary.compute(&along, &mut series, &mut of_gradient, 3, &mut dictionary.work());
        for output in 0..2 {
            let expected: f64 = (0..3).map(|i| gradient[3 * output + i] * direction[i]).sum();
            assert!((series[output].first - expected).abs() < 1e-14);
            let second: f64 = (0..3).map(|i| of_gradient[3 * output + i].first * direction[i]).sum();
            assert!((series[output].second - second).abs() < 1e-13, "{} {second}", series[output].second);
        }
    }

    #[test]
    fn terms_that_do_not_fit_are_refused_and_those_without_coefficients_dropped() {
        let factors = [Factor::Angle, Factor::Power { middle: 0.0, half: 1.0 }];
        for (factor, wrong) in [
            (factors, term(&[1], &[1.0])),
            (factors, term(&[1, 1], &[1.0, 2.0])),
            (factors, term(&[1, -1], &[1.0])),
            (factors, term(&[1, 1], &[f64::NAN])),
            ([Factor::Angle, Factor::Power { middle: 0.0, half: 0.0 }], term(&[1, 1], &[1.0])),
        ] {
            assert!(Dictionary::new(&factor, 1, std::slice::from_ref(&wrong)).is_err(), "{wrong:?}");
        }
        let dictionary = Dictionary::new(&factors, 1, &[term(&[4, 2], &[0.0]), term(&[1, 0], &[2.0])]).unwrap();
        assert_eq!(dictionary.products(), 1);
    }

    #[test]
    fn terms_give_the_dictionary_back() {
        let dictionary = example();
        let factors: Vec<Factor> = dictionary.factors().collect();
        let terms: Vec<Term> = dictionary.terms().collect();
        assert_eq!(terms[2], term(&[-3, 2, 1], &[-0.7, 0.2]));
        assert_eq!(Dictionary::new(&factors, 2, &terms).unwrap(), dictionary);
    }
}
