//! Linear combinations of products of sines, cosines and powers: the functions of a mechanism's configuration.
//!
//! ```text
//! y_j = sum over terms t of c_tj  product over columns i of f(e_ti, x_i)
//! angle: f(e, x) = cos(e x) for e >= 0, sin(-e x) for e < 0
//! power: f(e, x) = ((x - middle) / half)^e
//! ```
//!
//! Splines `s` of columns, such as lifts of cams, may be factors, too: powers of `s(x)`, `s'(x)` and `s''(x)`.
//!
//! The entries of a mass matrix of revolute and prismatic joints are exactly such sums, with harmonics of order two at
//! most. The entries of a closed loop are analytic and periodic, so their series converge geometrically.

use super::{
    lookup::LookupTable,
    tape::{Register, SumTerm, TapeBuilder},
};
use crate::{
    FormatError,
    check::{expect_below, expect_finite, expect_positive, expect_shape},
    numbers::jet::Jet,
};
use std::{ops::Range, sync::Arc};

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

/// A spline whose powers are factors, together with powers of its first two derivatives.
#[derive(Clone, Debug, PartialEq)]
pub struct SplineFactor {
    /// Position of the column that is its argument.
    pub column: usize,
    /// The spline, of one argument.
    pub table: Arc<LookupTable>,
}

/// Exponents of a [`SplineFactor`] in a term: of the value and of two derivatives.
pub const SPLINE_POWERS: usize = 3;

/// A product and its coefficient in each output.
#[derive(Clone, Debug, PartialEq)]
pub struct Term {
    /// `e_ti`, one for each column: a harmonic, negative for a sine, or a power. Then three powers for each spline.
    pub exponents: Vec<i16>,
    /// `c_tj`, one for each output.
    pub coefficients: Vec<f64>,
}

/// A linear combination of products.
#[derive(Clone, Debug, PartialEq)]
pub struct Dictionary {
    /// Columns of the arguments, then three of each spline.
    columns: Vec<Column>,
    splines: Vec<SplineFactor>,
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
    /// Position of its argument.
    of: usize,
    factor: ColumnFactor,
    /// Positions of the atoms. Those of an angle are cos and sin of 1, cos and sin of 2, ...; those of a power are 1,
    /// 2, ...
    atoms: Range<usize>,
}

/// Functions whose values are the atoms of a column.
#[derive(Clone, Debug, PartialEq)]
enum ColumnFactor {
    Own(Factor),
    /// Powers of a spline or of a derivative of one.
    Spline(Arc<LookupTable>),
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
        Self::with_splines(factors, &[], outputs, terms)
    }

    /// A dictionary with splines: the exponents of a term are those of the columns, then those of the splines.
    ///
    /// # Errors
    /// [`FormatError`] as from [`new`](Self::new), and if a table is not a spline of one argument or its column does not
    /// exist.
    pub fn with_splines(
        factors: &[Factor],
        splines: &[SplineFactor],
        outputs: usize,
        terms: &[Term],
    ) -> Result<Self, FormatError> {
        let rows = terms.iter().map(|term| (term.exponents.as_slice(), term.coefficients.as_slice()));
        Self::from_rows((factors, splines), outputs, rows)
    }

    /// A dictionary from the exponents and coefficients of each term.
    pub(crate) fn from_rows<'a>(
        (factors, splines): (&[Factor], &[SplineFactor]),
        outputs: usize,
        terms: impl Iterator<Item = (&'a [i16], &'a [f64])> + Clone,
    ) -> Result<Self, FormatError> {
        let count = terms.size_hint().0;
        let mut all: Vec<(usize, ColumnFactor)> =
            factors.iter().enumerate().map(|(of, factor)| (of, ColumnFactor::Own(*factor))).collect();
        for (index, SplineFactor { column, table }) in splines.iter().enumerate() {
            expect_below(&"splines.columns", index, *column, factors.len())?;
            let [first, second] = table.derivatives()?.map(Arc::new);
            all.extend([Arc::clone(table), first, second].map(|table| (*column, ColumnFactor::Spline(table))));
        }
        let mut columns: Vec<Column> = Vec::with_capacity(all.len());
        for (index, (of, factor)) in all.into_iter().enumerate() {
            let largest = terms.clone().filter_map(|(exponents, _)| exponents.get(index)).map(|e| e.unsigned_abs());
            let largest = usize::from(largest.max().unwrap_or(0));
            let first = columns.last().map_or(0, |column| column.atoms.end);
            let atoms = if factor == ColumnFactor::Own(Factor::Angle) { 2 * largest } else { largest };
            if let ColumnFactor::Own(Factor::Power { middle, half }) = factor {
                expect_finite("middle", [middle].into_iter())?;
                expect_positive("half", &[half])?;
            }
            columns.push(Column { of, factor, atoms: first..first + atoms });
        }
        let mut dictionary = Self {
            atoms: columns.last().map_or(0, |column| column.atoms.end),
            columns,
            splines: splines.to_vec(),
            outputs,
            products: Vec::with_capacity(count),
            factors: Vec::with_capacity(2 * count),
            coefficients: Vec::with_capacity(2 * count),
        };
        for (exponents, coefficients) in terms {
            expect_shape("exponents", &[exponents.len()], &[dictionary.columns.len()])?;
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
                ColumnFactor::Own(Factor::Angle) if exponent == i16::MIN => {
                    let limit = u64::from(i16::MIN.unsigned_abs());
                    return Err(FormatError::Index { name: "exponents".into(), index, found: order as u64, limit });
                }
                ColumnFactor::Own(Factor::Angle) => 2 * (order - 1) + usize::from(exponent < 0),
                _ if exponent < 0 => {
                    return Err(FormatError::NotPositive { name: "exponents".into(), index, value: exponent.into() });
                }
                _ => order - 1,
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

    /// Number of columns: arguments.
    pub fn columns(&self) -> usize {
        self.columns.len() - SPLINE_POWERS * self.splines.len()
    }

    /// Number of exponents of a term: one for each column, and three for each spline.
    pub fn exponents(&self) -> usize {
        self.columns.len()
    }

    /// Splines that are factors.
    pub fn splines(&self) -> &[SplineFactor] {
        &self.splines
    }

    /// Checks that no product has the second derivative of a spline, whose slope jumps.
    pub(crate) fn expect_differentiable(&self) -> Result<(), FormatError> {
        let first = self.columns();
        for (index, &(column, _)) in self.factors.iter().enumerate().filter(|(_, (column, _))| *column >= first) {
            expect_below(&"exponents", index, (column - first) % SPLINE_POWERS, SPLINE_POWERS - 1)?;
        }
        Ok(())
    }

    /// Returns true if any output depends on a column.
    pub fn depends_on(&self, column: usize) -> bool {
        self.has_column(0..self.factors.len(), column)
    }

    /// Returns true if an output depends on a column.
    pub fn output_depends_on(&self, output: usize, column: usize) -> bool {
        let is_in =
            |term: &&PreparedTerm| self.coefficients[term.coefficients.clone()].iter().any(|(of, _)| *of == output);
        self.products.iter().filter(is_in).any(|term| self.has_column(term.factors.clone(), column))
    }

    /// Returns true if an output is a straight line along a column, or does not depend on it.
    pub fn output_is_straight(&self, output: usize, column: usize) -> bool {
        let is_in =
            |term: &&PreparedTerm| self.coefficients[term.coefficients.clone()].iter().any(|(of, _)| *of == output);
        self.products.iter().filter(is_in).all(|term| self.is_straight(term.factors.clone(), column))
    }

    /// Returns true if a product has a column as a factor of the first power at most.
    fn is_straight(&self, factors: Range<usize>, column: usize) -> bool {
        let mut of_column = self.factors[factors].iter().filter(|(of, _)| self.columns[*of].of == column);
        let is_first_power = of_column.next().is_none_or(|(of, atom)| {
            let Column { factor, atoms, .. } = &self.columns[*of];
            matches!(factor, ColumnFactor::Own(Factor::Power { .. })) && *atom == atoms.start
        });
        is_first_power && of_column.next().is_none()
    }

    /// Returns true if some of the factors are functions of a column.
    fn has_column(&self, factors: Range<usize>, column: usize) -> bool {
        self.factors[factors].iter().any(|(of, _)| self.columns[*of].of == column)
    }

    /// Number of outputs.
    pub fn outputs(&self) -> usize {
        self.outputs
    }

    /// Contribution of each column.
    pub fn factors(&self) -> impl Iterator<Item = Factor> + '_ {
        self.columns.iter().filter_map(|column| match column.factor {
            ColumnFactor::Own(factor) => Some(factor),
            ColumnFactor::Spline(_) => None,
        })
    }

    /// The products with their coefficients, as [`Dictionary::new`] takes them.
    pub fn terms(&self) -> impl Iterator<Item = Term> + '_ {
        self.products.iter().map(|product| {
            let mut term = Term { exponents: vec![0; self.exponents()], coefficients: vec![0.0; self.outputs] };
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
        assert_eq!(x.len(), self.columns(), "number of columns");
        assert_eq!(y.len(), self.outputs, "number of outputs");
        y.fill(0.0);
        let mut atoms = vec![Atom { value: 0.0, slope: 0.0 }; self.atoms];
        for column in &self.columns {
            column.compute(x[column.of], &mut atoms[column.atoms.clone()]);
        }
        for product in &self.products {
            let (factors, coefficients) =
                (&self.factors[product.factors.clone()], &self.coefficients[product.coefficients.clone()]);
            let value: f64 = factors.iter().map(|(_, atom)| atoms[*atom].value).product();
            for (output, coefficient) in coefficients {
                y[*output] += coefficient * value;
            }
            for (index, &(column, atom)) in factors.iter().enumerate() {
                let column = self.columns[column].of;
                if column >= first {
                    continue;
                }
                let others = factors.iter().enumerate().filter(|(other, _)| *other != index);
                let others: f64 = others.map(|(_, (_, atom))| atoms[*atom].value).product();
                for (output, coefficient) in coefficients {
                    gradient[output * first + column] += coefficient * atoms[atom].slope * others;
                }
            }
        }
    }

    /// Returns true if a product has a function of this column as a factor.
    fn uses(&self, index: usize) -> bool {
        self.factors.iter().any(|(column, _)| *column == index)
    }

    /// Writes the factors of these columns on a tape.
    pub(crate) fn write(&self, columns: &[Register], tape: &mut TapeBuilder) -> WrittenDictionary<'_> {
        // the derivative of the last one is not needed
        let mut slope = tape.zero;
        let mut written: Vec<WrittenColumn> = Vec::with_capacity(self.columns.len());
        for (index, column) in self.columns.iter().enumerate().rev() {
            let register = columns[column.of];
            written.push(match &column.factor {
                ColumnFactor::Own(Factor::Angle) => {
                    WrittenColumn::Angle(tape.harmonics(register, column.atoms.len() / 2))
                }
                ColumnFactor::Own(Factor::Power { middle, half }) => {
                    let (middle, scale) = (tape.constant(-middle), half.recip());
                    let shifted = tape.add_product(middle, register, tape.one);
                    let by = tape.constant(scale);
                    WrittenColumn::Power(tape.product(shifted, by), scale)
                }
                ColumnFactor::Spline(table) => {
                    let order = (index - self.columns()) % SPLINE_POWERS;
                    let is_needed = self.uses(index) || order > 0 && self.uses(index - 1);
                    let of_next = if order + 1 == SPLINE_POWERS { tape.zero } else { slope };
                    slope = if is_needed { tape.lookup(table, &[register]) } else { tape.zero };
                    WrittenColumn::Spline(slope, of_next)
                }
            });
        }
        written.reverse();
        WrittenDictionary { columns: written, dictionary: self }
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
    /// A spline or a derivative of one, and its derivative. The derivative of a second derivative is zero: functions
    /// that are differentiated have no second derivatives.
    Spline(Register, Register),
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
        let Dictionary { columns, products, factors, coefficients, .. } = self.dictionary;
        let mut terms: Vec<SumTerm> = Vec::new();
        for product in products {
            let coefficients = &coefficients[product.coefficients.clone()];
            let factors = &factors[product.factors.clone()];
            let Some((_, coefficient)) = coefficients.iter().find(|(of, _)| *of == output) else { continue };
            let coefficient = factor * coefficient;
            match along {
                None => self.add_product(&mut terms, factors, None, coefficient, tape),
                Some(along) => {
                    let changing = (0..factors.len()).filter(|&index| columns[factors[index].0].of == along);
                    changing.for_each(|index| self.add_product(&mut terms, factors, Some(index), coefficient, tape));
                }
            }
        }
        tape.sum(to, &terms)
    }

    /// Adds a product of factors, one of which may be replaced by its derivative.
    fn add_product(
        &self,
        terms: &mut Vec<SumTerm>,
        factors: &[(usize, usize)],
        differentiated: Option<usize>,
        mut coefficient: f64,
        tape: &mut TapeBuilder,
    ) {
        let mut product = SplitProduct { of_fixed: tape.one, of_others: tape.one };
        for (index, &(column, atom)) in factors.iter().enumerate() {
            let mut exponent = self.dictionary.columns[column].exponent(atom);
            let written = &self.columns[column];
            if differentiated == Some(index) {
                coefficient *= written.differentiate(&mut exponent);
                if let WrittenColumn::Spline(_, slope) = written {
                    product.multiply(*slope, tape);
                }
            }
            product.multiply(written.factor(exponent, tape), tape);
        }
        let SplitProduct { of_fixed, of_others } = product;
        let place = terms.binary_search_by_key(&of_others, |term| term.of).unwrap_or_else(|place| {
            terms.insert(place, SumTerm { of: of_others, constant: 0.0, fixed: tape.zero });
            place
        });
        let SumTerm { constant, fixed, .. } = &mut terms[place];
        if of_fixed == tape.one {
            *constant += coefficient;
            return;
        }
        if tape.is_zero(*fixed) {
            *fixed = tape.constant(std::mem::take(constant));
        }
        *fixed = tape.add_scaled(*fixed, of_fixed, coefficient);
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
            // times the spline's derivative
            Self::Spline(..) => {
                *exponent -= 1;
                f64::from(*exponent + 1)
            }
        }
    }

    fn factor(&self, exponent: i16, tape: &mut TapeBuilder) -> Register {
        let order = usize::from(exponent.unsigned_abs());
        match self {
            _ if exponent == 0 => tape.one,
            Self::Angle(block) if exponent < 0 => block[block.len() / 2 + order - 1],
            Self::Angle(block) => block[order - 1],
            Self::Power(x, _) | Self::Spline(x, _) => (1..order).fold(*x, |power, _| tape.product(power, *x)),
        }
    }
}

/// A product of factors that follow from fixed inputs, and one of the others.
struct SplitProduct {
    of_fixed: Register,
    of_others: Register,
}

impl SplitProduct {
    fn multiply(&mut self, factor: Register, tape: &mut TapeBuilder) {
        let product = if tape.varies(factor) { &mut self.of_others } else { &mut self.of_fixed };
        *product = tape.product(*product, factor);
    }
}

impl Column {
    /// Exponent of one of its atoms.
    fn exponent(&self, atom: usize) -> i16 {
        let within = atom - self.atoms.start;
        // each was made from an exponent, so it fits
        match self.factor {
            ColumnFactor::Own(Factor::Angle) if within.is_multiple_of(2) => (within / 2 + 1) as i16,
            ColumnFactor::Own(Factor::Angle) => -((within / 2 + 1) as i16),
            _ => (within + 1) as i16,
        }
    }

    fn compute(&self, x: f64, atoms: &mut [Atom]) {
        match &self.factor {
            ColumnFactor::Own(Factor::Angle) => {
                let pairs = atoms.as_chunks_mut::<2>().0;
                if pairs.is_empty() {
                    return;
                }
                let (sine, cosine) = x.sin_cos();
                pairs[0] = harmonic(1.0, sine, cosine);
                for order in 2..=pairs.len() {
                    // of the two halves, so that few rounding errors add up
                    let half = order / 2;
                    let ([c, s], [other_c, other_s]) =
                        (pairs[half - 1].map(|atom| atom.value), pairs[order - half - 1].map(|atom| atom.value));
                    pairs[order - 1] = harmonic(order as f64, s * other_c + c * other_s, c * other_c - s * other_s);
                }
            }
            ColumnFactor::Own(Factor::Power { middle, half }) => {
                let scale = half.recip();
                fill_powers((x - middle) * scale, scale, atoms);
            }
            ColumnFactor::Spline(_) if atoms.is_empty() => {}
            ColumnFactor::Spline(table) => {
                let Jet { value, first, .. } = table.series(&[Jet { value: x, first: 1.0, second: 0.0 }]);
                fill_powers(value, first, atoms);
            }
        }
    }
}

/// Cosine and sine of `order` times an angle, with their derivatives with respect to the angle.
#[inline]
fn harmonic(order: f64, sine: f64, cosine: f64) -> [Atom; 2] {
    [Atom { value: cosine, slope: -order * sine }, Atom { value: sine, slope: order * cosine }]
}

/// Writes the powers of `z` from the first one on, and their derivatives; `scale` is the derivative of `z`.
#[inline]
fn fill_powers(z: f64, scale: f64, atoms: &mut [Atom]) {
    let mut power = 1.0;
    for (order, atom) in (1u32..).zip(atoms) {
        let slope = power * f64::from(order) * scale;
        power *= z;
        *atom = Atom { value: power, slope };
    }
}

#[cfg(test)]
mod tests;
