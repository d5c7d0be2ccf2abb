//! Linear combinations of products of sines, cosines and powers: the functions of a mechanism's configuration.
//!
//! ```text
//! y_j = sum over terms t of c_tj  product over columns i of f(e_ti, x_i)
//! angle: f(e, x) = cos(e x) for e >= 0, sin(-e x) for e < 0
//! power: f(e, x) = ((x - middle) / half)^e
//! ```
//!
//! The entries of a mass matrix of revolute and prismatic joints are exactly such sums, with harmonics of order two at
//! most. The entries of a closed loop are analytic and periodic, so their series converge geometrically.

use super::tape::{Register, SumTerm, TapeBuilder};
use crate::FormatError;
use crate::check::{expect_finite, expect_positive, expect_shape};
use std::ops::Range;

/// Contribution of a column to the products.
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

/// A product and its coefficient in each output.
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
    /// Number of atoms of all columns.
    atoms: usize,
    products: Vec<PreparedTerm>,
    /// Column and atom of each factor other than 1, product by product.
    factors: Vec<(usize, usize)>,
    /// Output and coefficient, product by product.
    coefficients: Vec<(usize, f64)>,
}

/// A column and the functions of it that are computed.
#[derive(Clone, Debug, PartialEq)]
struct Column {
    factor: Factor,
    /// Positions of the atoms. Those of an angle are cos and sin of 1, cos and sin of 2, ...; those of a power are 1,
    /// 2, ...
    atoms: Range<usize>,
}

#[derive(Clone, Debug, PartialEq)]
struct PreparedTerm {
    factors: Range<usize>,
    coefficients: Range<usize>,
}

/// A function of a column and its derivative.
#[derive(Clone, Copy, Debug)]
struct Atom {
    value: f64,
    slope: f64,
}

impl Dictionary {
    /// Lays the terms out for evaluation. Coefficients of zero cost nothing.
    ///
    /// # Errors
    /// [`FormatError`] if a term has not an exponent for each column and a coefficient for each output, or a number is not finite.
    pub fn new(factors: &[Factor], outputs: usize, terms: &[Term]) -> Result<Self, FormatError> {
        let rows = terms.iter().map(|term| (term.exponents.as_slice(), term.coefficients.as_slice()));
        Self::from_rows(factors, outputs, rows)
    }

    /// A dictionary from the exponents and coefficients of each term.
    pub(crate) fn from_rows<'a>(
        factors: &[Factor],
        outputs: usize,
        terms: impl Iterator<Item = (&'a [i16], &'a [f64])> + Clone,
    ) -> Result<Self, FormatError> {
        let count = terms.size_hint().0;
        let mut columns: Vec<Column> = Vec::with_capacity(factors.len());
        for (index, factor) in factors.iter().enumerate() {
            let largest = terms.clone().filter_map(|(exponents, _)| exponents.get(index)).map(|e| e.unsigned_abs());
            let largest = usize::from(largest.max().unwrap_or(0));
            let first = columns.last().map_or(0, |column| column.atoms.end);
            let atoms = if *factor == Factor::Angle { 2 * largest } else { largest };
            columns.push(Column { factor: *factor, atoms: first..first + atoms });
            if let Factor::Power { middle, half } = factor {
                expect_finite("middle", [*middle].into_iter())?;
                expect_positive("half", &[*half])?;
            }
        }
        let mut dictionary = Self {
            atoms: columns.last().map_or(0, |column| column.atoms.end),
            columns,
            outputs,
            products: Vec::with_capacity(count),
            factors: Vec::with_capacity(2 * count),
            coefficients: Vec::with_capacity(2 * count),
        };
        for (exponents, coefficients) in terms {
            expect_shape("exponents", &[exponents.len()], &[factors.len()])?;
            expect_shape("coefficients", &[coefficients.len()], &[outputs])?;
            expect_finite("coefficients", coefficients.iter().copied())?;
            dictionary.add(exponents, coefficients)?;
        }
        Ok(dictionary)
    }

    /// Returns true if an output has no product.
    pub fn is_zero(&self, output: usize) -> bool {
        self.coefficients.iter().all(|(of, _)| *of != output)
    }

    fn add(&mut self, exponents: &[i16], coefficients: &[f64]) -> Result<(), FormatError> {
        let begin = (self.factors.len(), self.coefficients.len());
        for (index, (&exponent, column)) in exponents.iter().zip(&self.columns).enumerate() {
            let order = usize::from(exponent.unsigned_abs());
            let within = match column.factor {
                _ if exponent == 0 => continue,
                // its opposite, that of its derivative, must be an exponent as well
                Factor::Angle if exponent == i16::MIN => {
                    let limit = u64::from(i16::MIN.unsigned_abs());
                    return Err(FormatError::Index { name: "exponents".into(), index, found: order as u64, limit });
                }
                Factor::Angle => 2 * (order - 1) + usize::from(exponent < 0),
                Factor::Power { .. } if exponent < 0 => {
                    return Err(FormatError::NotPositive { name: "exponents".into(), index, value: exponent.into() });
                }
                Factor::Power { .. } => order - 1,
            };
            self.factors.push((index, column.atoms.start + within));
        }
        let present = coefficients.iter().copied().enumerate().filter(|(_, coefficient)| *coefficient != 0.0);
        self.coefficients.extend(present);
        if self.coefficients.len() == begin.1 {
            self.factors.truncate(begin.0);
        } else {
            let (factors, coefficients) = (begin.0..self.factors.len(), begin.1..self.coefficients.len());
            self.products.push(PreparedTerm { factors, coefficients });
        }
        Ok(())
    }

    /// Number of columns.
    pub fn columns(&self) -> usize {
        self.columns.len()
    }

    /// Number of outputs.
    pub fn outputs(&self) -> usize {
        self.outputs
    }

    /// Contribution of each column.
    pub fn factors(&self) -> impl Iterator<Item = Factor> + '_ {
        self.columns.iter().map(|column| column.factor)
    }

    /// The products with their coefficients, as [`Dictionary::new`] takes them.
    pub fn terms(&self) -> impl Iterator<Item = Term> + '_ {
        self.products.iter().map(|product| {
            let mut term = Term { exponents: vec![0; self.columns.len()], coefficients: vec![0.0; self.outputs] };
            for &(column, atom) in &self.factors[product.factors.clone()] {
                term.exponents[column] = self.columns[column].exponent(atom);
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
        self.add_up(x, y, &mut [], 0);
    }

    /// `y` at `x` and its derivatives with respect to the first columns, shape `[outputs, first]`.
    ///
    /// # Panics
    /// If `x` has the wrong length.
    pub fn with_gradient(&self, x: &[f64], first: usize) -> (Vec<f64>, Vec<f64>) {
        let (mut y, mut gradient) = (vec![0.0; self.outputs], vec![0.0; self.outputs * first]);
        self.add_up(x, &mut y, &mut gradient, first);
        (y, gradient)
    }

    fn add_up(&self, x: &[f64], y: &mut [f64], gradient: &mut [f64], first: usize) {
        assert_eq!(x.len(), self.columns.len(), "number of columns");
        assert_eq!(y.len(), self.outputs, "number of outputs");
        y.fill(0.0);
        let mut atoms = vec![Atom { value: 0.0, slope: 0.0 }; self.atoms];
        for (column, &x) in self.columns.iter().zip(x) {
            column.compute(x, &mut atoms[column.atoms.clone()]);
        }
        for product in &self.products {
            let (factors, coefficients) =
                (&self.factors[product.factors.clone()], &self.coefficients[product.coefficients.clone()]);
            let value: f64 = factors.iter().map(|(_, atom)| atoms[*atom].value).product();
            for (output, coefficient) in coefficients {
                y[*output] += coefficient * value;
            }
            for (index, &(column, atom)) in factors.iter().enumerate().filter(|(_, (column, _))| *column < first) {
                let others = factors.iter().enumerate().filter(|(other, _)| *other != index);
                let others: f64 = others.map(|(_, (_, atom))| atoms[*atom].value).product();
                for (output, coefficient) in coefficients {
                    gradient[output * first + column] += coefficient * atoms[atom].slope * others;
                }
            }
        }
    }

    /// Writes the factors of these columns on a tape.
    pub(crate) fn write(&self, columns: &[Register], tape: &mut TapeBuilder) -> WrittenDictionary<'_> {
        let write = |(column, register): (&Column, &Register)| match column.factor {
            Factor::Angle => WrittenColumn::Angle(tape.harmonics(*register, column.atoms.len() / 2)),
            Factor::Power { middle, half } => {
                let (middle, scale) = (tape.constant(-middle), half.recip());
                let shifted = tape.add_product(middle, *register, tape.one);
                let by = tape.constant(scale);
                WrittenColumn::Power(tape.product(shifted, by), scale)
            }
        };
        WrittenDictionary { columns: self.columns.iter().zip(columns).map(write).collect(), dictionary: self }
    }
}

/// A dictionary on a tape.
#[derive(Debug)]
pub(crate) struct WrittenDictionary<'a> {
    dictionary: &'a Dictionary,
    columns: Vec<WrittenColumn>,
}

#[derive(Debug)]
enum WrittenColumn {
    /// Cosines of 1, 2, ... times the angle, and as many sines.
    Angle(Vec<Register>),
    /// `(x - middle) / half`, and its derivative.
    Power(Register, f64),
}

impl WrittenDictionary<'_> {
    /// Writes an output.
    pub(crate) fn value(&self, output: usize, tape: &mut TapeBuilder) -> Register {
        self.add(tape.zero, output, None, 1.0, tape)
    }

    /// Writes the derivative of an output with respect to a column.
    pub(crate) fn slope(&self, output: usize, column: usize, tape: &mut TapeBuilder) -> Register {
        self.add_slope(tape.zero, output, column, 1.0, tape)
    }

    /// Writes a number plus the derivative of an output with respect to a column times a factor.
    pub(crate) fn add_slope(
        &self,
        to: Register,
        output: usize,
        column: usize,
        factor: f64,
        tape: &mut TapeBuilder,
    ) -> Register {
        self.add(to, output, Some(column), factor, tape)
    }

    /// Terms share a coefficient if they differ in fixed factors only.
    fn add(&self, to: Register, output: usize, along: Option<usize>, factor: f64, tape: &mut TapeBuilder) -> Register {
        let Dictionary { products, factors, coefficients, .. } = self.dictionary;
        let mut terms: Vec<SumTerm> = Vec::new();
        for product in products {
            let coefficients = &coefficients[product.coefficients.clone()];
            let factors = &factors[product.factors.clone()];
            let Some((_, coefficient)) = coefficients.iter().find(|(of, _)| *of == output) else { continue };
            if along.is_some_and(|along| factors.iter().all(|(column, _)| *column != along)) {
                continue;
            }
            let mut coefficient = factor * coefficient;
            let (mut of_fixed, mut of_others) = (tape.one, tape.one);
            for &(column, atom) in factors {
                let mut exponent = self.dictionary.columns[column].exponent(atom);
                let written = &self.columns[column];
                if along == Some(column) {
                    coefficient *= written.differentiate(&mut exponent);
                }
                let factor = written.factor(exponent, tape);
                let product = if tape.varies(factor) { &mut of_others } else { &mut of_fixed };
                *product = tape.product(*product, factor);
            }
            let place = terms.binary_search_by_key(&of_others, |term| term.of).unwrap_or_else(|place| {
                terms.insert(place, SumTerm { of: of_others, constant: 0.0, fixed: tape.zero });
                place
            });
            let SumTerm { constant, fixed, .. } = &mut terms[place];
            if of_fixed == tape.one {
                *constant += coefficient;
                continue;
            }
            if tape.is_zero(*fixed) {
                *fixed = tape.constant(std::mem::take(constant));
            }
            *fixed = tape.add_scaled(*fixed, of_fixed, coefficient);
        }
        tape.sum(to, &terms)
    }
}

impl WrittenColumn {
    /// The function of an exponent becomes another one, times this factor.
    fn differentiate(&self, exponent: &mut i16) -> f64 {
        match self {
            // cos(e x)' = -e sin(e x), sin(e x)' = e cos(e x)
            Self::Angle(_) => {
                *exponent = -*exponent;
                f64::from(*exponent)
            }
            Self::Power(_, slope) => {
                *exponent -= 1;
                f64::from(*exponent + 1) * slope
            }
        }
    }

    fn factor(&self, exponent: i16, tape: &mut TapeBuilder) -> Register {
        let order = usize::from(exponent.unsigned_abs());
        match self {
            _ if exponent == 0 => tape.one,
            Self::Angle(block) if exponent < 0 => block[block.len() / 2 + order - 1],
            Self::Angle(block) => block[order - 1],
            Self::Power(x, _) => (1..order).fold(*x, |power, _| tape.product(power, *x)),
        }
    }
}

impl Column {
    /// That of one of its atoms.
    fn exponent(&self, atom: usize) -> i16 {
        let within = atom - self.atoms.start;
        // each was made from an exponent, so it fits
        match self.factor {
            Factor::Angle if within.is_multiple_of(2) => (within / 2 + 1) as i16,
            Factor::Angle => -((within / 2 + 1) as i16),
            Factor::Power { .. } => (within + 1) as i16,
        }
    }

    fn compute(&self, x: f64, atoms: &mut [Atom]) {
        match self.factor {
            Factor::Angle => {
                let pairs = atoms.as_chunks_mut::<2>().0;
                if pairs.is_empty() {
                    return;
                }
                let pair =
                    |k: f64, (s, c): (f64, f64)| [Atom { value: c, slope: -k * s }, Atom { value: s, slope: k * c }];
                pairs[0] = pair(1.0, x.sin_cos());
                for order in 2..=pairs.len() {
                    // of the two halves, so that few rounding errors add up
                    let half = order / 2;
                    let ([c, s], [other_c, other_s]) =
                        (pairs[half - 1].map(|atom| atom.value), pairs[order - half - 1].map(|atom| atom.value));
                    pairs[order - 1] = pair(order as f64, (s * other_c + c * other_s, c * other_c - s * other_s));
                }
            }
            Factor::Power { middle, half } => {
                let scale = half.recip();
                let z = (x - middle) * scale;
                let mut power = 1.0;
                for (order, atom) in (1u32..).zip(atoms) {
                    let slope = power * f64::from(order) * scale;
                    power *= z;
                    *atom = Atom { value: power, slope };
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Jet;

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
    fn on_a_tape_values_slopes_and_series_are_the_same() {
        let dictionary = example();
        for fixed in [0..0, 1..3, 0..1, 0..3] {
            let columns = [0, 1, 2].map(Register::input);
            let mut tape = TapeBuilder::new(3, fixed.clone());
            let written = dictionary.write(&columns, &mut tape);
            let values = [0, 1].map(|output| written.value(output, &mut tape));
            let slopes: Vec<Register> = (0..6).map(|index| written.slope(index / 3, index % 3, &mut tape)).collect();
            let tape = tape.finish();
            let (mut plain, mut series) = (tape.work(), tape.work());
            for shift in [0.0, 0.3, 0.3, -0.2] {
                // some columns keep their values while others change
                let point = [POINT[0] + shift, POINT[1] + 0.5 * shift, POINT[2] + (2.0 * shift).round()];
                let (expected, gradient) = dictionary.with_gradient(&point, 3);
                plain.inputs_mut()[..3].copy_from_slice(&point);
                tape.run(&mut plain);
                for (register, expected) in values.iter().chain(&slopes).zip(expected.iter().chain(&gradient)) {
                    let found = plain.get(*register);
                    assert!((found - expected).abs() < 1e-13, "{found} {expected}");
                }
                let direction = [0.3, -0.4, 1.2];
                for (k, column) in series.inputs_mut()[..3].iter_mut().enumerate() {
                    *column = Jet { value: point[k], first: direction[k], second: 0.0 };
                }
                tape.run(&mut series);
                for (output, value) in values.iter().enumerate() {
                    let along = |slope: &dyn Fn(usize) -> f64| (0..3).map(|k| slope(k) * direction[k]).sum::<f64>();
                    let (found, expected) = (series.get(*value), along(&|k| gradient[3 * output + k]));
                    assert!((found.first - expected).abs() < 1e-13, "{found:?} {expected}");
                    let expected = along(&|k| series.get(slopes[3 * output + k]).first);
                    assert!((found.second - expected).abs() < 1e-12, "{found:?} {expected}");
                }
            }
        }
    }

    #[test]
    fn long_sums_are_the_same_on_a_tape() {
        // harmonics of an angle, some of them missing, and a coefficient that follows from a parameter
        let factors = [Factor::Angle, Factor::Power { middle: 0.0, half: 1.0 }];
        let terms: Vec<Term> = (-40..=40)
            .filter(|k| k % 7 != 3 && !(10..20).contains(k))
            .map(|k: i16| term(&[k, k.rem_euclid(3)], &[1.0 / (1.0 + f64::from(k).abs())]))
            .collect();
        let dictionary = Dictionary::new(&factors, 1, &terms).unwrap();
        let mut tape = TapeBuilder::new(2, 1..2);
        let written = dictionary.write(&[0, 1].map(Register::input), &mut tape);
        let registers = [written.value(0, &mut tape), written.slope(0, 0, &mut tape)];
        let tape = tape.finish();
        let mut work = tape.work();
        for point in [[0.4, 0.9], [2.9, 0.9], [-1.7, 0.6]] {
            work.inputs_mut()[..2].copy_from_slice(&point);
            tape.run(&mut work);
            let (y, gradient) = dictionary.with_gradient(&point, 1);
            for (register, expected) in registers.iter().zip([y[0], gradient[0]]) {
                assert!((work.get(*register) - expected).abs() < 1e-12, "{} {expected}", work.get(*register));
            }
        }
    }

    #[test]
    fn gradients_are_those_of_finite_differences() {
        let (_, gradient) = example().with_gradient(&POINT, 3);
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
    }

    #[test]
    fn terms_that_do_not_fit_are_refused_and_those_without_coefficients_dropped() {
        let factors = [Factor::Angle, Factor::Power { middle: 0.0, half: 1.0 }];
        for (factor, wrong) in [
            (factors, term(&[1], &[1.0])),
            (factors, term(&[1, 1], &[1.0, 2.0])),
            (factors, term(&[1, -1], &[1.0])),
            (factors, term(&[i16::MIN, 1], &[1.0])),
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
