//! Scalar formulas as mechanism files have them: numbers, columns, `+ - * / ^`, `min`, `max`, functions of one variable and lookup tables,
//! with exact derivatives.
//!
//! Derivatives are second-order Taylor coefficients (forward automatic differentiation; Griewank, Walther: *Evaluating Derivatives*,
//! chapter 13).

use super::tape::{Register, TapeBuilder};
use crate::{
    FormatError,
    check::expect_finite,
    numbers::jet::{Jet, Number},
};
use std::sync::Arc;

pub use super::lookup::{Extrapolation, Interpolation, LookupTable};
pub use crate::numbers::{combination::Combination, elementary::ElementaryFunction};

/// A step of a formula in postfix notation: operands are taken from a stack, and the result is put there.
#[derive(Clone, Debug, PartialEq)]
pub enum FormulaStep {
    /// Puts a number on the stack.
    Constant(f64),
    /// Puts the value of a column there.
    Column(usize),
    /// A function of the last value.
    Call(ElementaryFunction),
    /// Minus the last value.
    Negate,
    /// A combination of the last two values.
    Combine(Combination),
    /// A table at the last value, or the last two.
    Lookup(Arc<LookupTable>),
}

/// A step with its operands.
#[derive(Clone, Copy, Debug)]
enum Applied<'a, T> {
    /// A number.
    Constant(f64),
    /// The value of a column.
    Column(usize),
    /// Minus a value.
    Negate(&'a T),
    /// A function of a value.
    Call(ElementaryFunction, &'a T),
    /// A combination of two values.
    Combine(Combination, &'a T, &'a T),
    /// A table at one or two values.
    Lookup(&'a Arc<LookupTable>, &'a [T]),
}

fn applied<T: Number>(step: &Applied<T>, column: &impl Fn(usize) -> T) -> T {
    match *step {
        Applied::Constant(value) => T::from(value),
        Applied::Column(index) => column(index),
        Applied::Negate(x) => x.scaled(-1.0),
        Applied::Call(function, x) => x.apply(function),
        Applied::Combine(combination, a, b) => combination.of(*a, *b),
        Applied::Lookup(table, at) => table.at(at),
    }
}

/// A scalar formula of some columns.
#[derive(Clone, Debug, PartialEq)]
pub struct Formula {
    steps: Vec<FormulaStep>,
}

impl Formula {
    /// A formula from its steps.
    ///
    /// # Errors
    /// [`FormatError`] if a step has no operands, more than one value is left, or a number is not finite.
    pub fn new(steps: Vec<FormulaStep>) -> Result<Self, FormatError> {
        let constants = steps.iter().map(|step| if let FormulaStep::Constant(value) = step { *value } else { 0.0 });
        expect_finite("formulas", constants)?;
        let mut left = 0usize;
        for (index, step) in steps.iter().enumerate() {
            let operands = step.operands();
            left =
                left.checked_sub(operands).ok_or(FormatError::Formula { index, found: left, expected: operands })? + 1;
        }
        match left {
            1 => Ok(Self { steps }),
            found => Err(FormatError::Formula { index: steps.len(), found, expected: 1 }),
        }
    }

    /// Formulas whose steps stand one after the other.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn one_after_the_other(steps: &[FormulaStep]) -> Result<Vec<Self>, FormatError> {
        // where each value on the stack begins
        let mut begins: Vec<usize> = Vec::new();
        for (index, step) in steps.iter().enumerate() {
            let (found, expected) = (begins.len(), step.operands());
            if found < expected {
                return Err(FormatError::Formula { index, found, expected });
            }
            begins.truncate(found - expected + usize::from(expected > 0));
            if expected == 0 {
                begins.push(index);
            }
        }
        let ends = begins.iter().skip(1).copied().chain([steps.len()]);
        begins.iter().zip(ends).map(|(begin, end)| Self::new(steps[*begin..end].to_vec())).collect()
    }

    /// A formula that is a number.
    pub fn number(value: f64) -> Self {
        Self { steps: vec![FormulaStep::Constant(value)] }
    }

    /// A formula that is the value of a column.
    pub fn column(column: usize) -> Self {
        Self { steps: vec![FormulaStep::Column(column)] }
    }

    /// The steps.
    pub fn steps(&self) -> &[FormulaStep] {
        &self.steps
    }

    /// The columns that occur, each as often as it does.
    pub fn columns(&self) -> impl Iterator<Item = usize> + '_ {
        self.steps.iter().filter_map(|step| if let FormulaStep::Column(column) = step { Some(*column) } else { None })
    }

    /// Replaces the columns of the formula by other steps.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn with_columns(&self, leaf: impl Fn(usize) -> FormulaStep) -> Result<Self, FormatError> {
        let steps = self.steps.iter().map(|step| match step {
            FormulaStep::Column(column) => leaf(*column),
            other => other.clone(),
        });
        Self::new(steps.collect())
    }

    /// Value at these columns.
    pub fn value(&self, column: impl Fn(usize) -> f64) -> f64 {
        self.evaluate(column)
    }

    /// Value with derivatives along a curve of the columns.
    pub fn series(&self, column: impl Fn(usize) -> Jet) -> Jet {
        self.evaluate(column)
    }

    fn evaluate<T: Number>(&self, column: impl Fn(usize) -> T) -> T {
        self.walk(|step: Applied<T>| applied(&step, &column))
    }

    /// Writes the value on a tape; `columns` has a register for each column.
    pub(crate) fn write(&self, columns: &[Register], tape: &mut TapeBuilder) -> Register {
        self.walk(|step: Applied<Register>| match step {
            Applied::Constant(value) => tape.constant(value),
            Applied::Column(index) => columns[index],
            Applied::Negate(x) => tape.negative(*x),
            Applied::Call(function, x) => tape.call(function, *x),
            Applied::Combine(combination, a, b) => tape.combine(combination, *a, *b),
            Applied::Lookup(table, at) => tape.lookup(table, at),
        })
    }

    /// Result of the formula, if `compute` gives the result of a step from those of its operands.
    ///
    /// # Panics
    /// Never: the constructor counts the operands.
    fn walk<T>(&self, mut compute: impl FnMut(Applied<T>) -> T) -> T {
        let mut stack: Vec<T> = Vec::with_capacity(self.steps.len());
        for step in &self.steps {
            let value = match step {
                FormulaStep::Constant(value) => compute(Applied::Constant(*value)),
                FormulaStep::Column(column) => compute(Applied::Column(*column)),
                FormulaStep::Negate => compute(Applied::Negate(&pop(&mut stack))),
                FormulaStep::Call(function) => compute(Applied::Call(*function, &pop(&mut stack))),
                FormulaStep::Combine(combination) => {
                    let b = pop(&mut stack);
                    compute(Applied::Combine(*combination, &pop(&mut stack), &b))
                }
                FormulaStep::Lookup(table) => {
                    let first = stack.len() - step.operands();
                    let value = compute(Applied::Lookup(table, &stack[first..]));
                    stack.truncate(first);
                    value
                }
            };
            stack.push(value);
        }
        pop(&mut stack)
    }
}

/// The last operand of a step.
#[inline]
fn pop<T>(stack: &mut Vec<T>) -> T {
    stack.pop().expect("the constructor counts the operands")
}

impl FormulaStep {
    /// Number of values that the step takes from the stack.
    pub fn operands(&self) -> usize {
        match self {
            Self::Constant(_) | Self::Column(_) => 0,
            Self::Call(_) | Self::Negate => 1,
            Self::Combine(_) => 2,
            Self::Lookup(table) => table.arguments(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use Combination::{Add, Angle, Divide, Maximum, Minimum, Multiply, Power, Subtract};
    use FormulaStep::{Call, Column, Combine, Constant, Negate};

    /// Every function and operation, of two columns.
    fn formulas() -> Vec<Formula> {
        let with =
            |function| vec![Column(0), Constant(0.4), Combine(Multiply), Call(function), Column(1), Combine(Multiply)];
        let more = [
            vec![Column(0), Column(1), Combine(Divide), Negate],
            vec![Column(0), Constant(3.0), Combine(Power), Constant(2.0), Column(1), Combine(Power), Combine(Subtract)],
            vec![Column(0), Constant(-2.0), Combine(Power), Column(1), Constant(0.5), Combine(Power), Combine(Add)],
            vec![Column(0), Column(1), Combine(Power), Column(1), Constant(1.7), Combine(Power), Combine(Add)],
            vec![
                Column(0),
                Column(1),
                Combine(Minimum),
                Column(0),
                Constant(-0.5),
                Combine(Maximum),
                Combine(Multiply),
            ],
            vec![Column(0), Column(1), Negate, Combine(Angle), Column(0), Combine(Multiply)],
            vec![Column(1), Column(0), Combine(Minimum), Constant(2.0), Column(1), Combine(Maximum), Combine(Subtract)],
        ];
        let formulas = ElementaryFunction::ALL.into_iter().map(with).chain(more).chain(lookups());
        formulas.map(|steps| Formula::new(steps).unwrap()).collect()
    }

    /// Tables of one and of two columns, linear and cubic.
    fn lookups() -> Vec<Vec<FormulaStep>> {
        let knots = || vec![-1.0, 0.25, 0.5, 1.5, 2.0];
        let of_one =
            LookupTable::new(vec![knots()], vec![0.3, 1.2, -0.4, 2.0, 1.0], Interpolation::Linear, Extrapolation::Hold);
        let values = (0..25).map(|k| f64::from(k * k % 7) - 2.0).collect();
        let of_two = LookupTable::new(vec![knots(), knots()], values, Interpolation::Cubic, Extrapolation::Linear);
        let [of_one, of_two] = [of_one, of_two].map(|table| FormulaStep::Lookup(Arc::new(table.unwrap())));
        vec![
            vec![Column(0), Constant(1.1), Combine(Multiply), of_one, Column(1), Combine(Multiply)],
            vec![Column(0), Column(1), of_two, Negate],
        ]
    }

    #[test]
    fn series_are_those_of_finite_differences() {
        let (x, rate, change) = ([0.7, 1.3], [0.9, -0.4], [-0.3, 0.8]);
        for formula in formulas() {
            let jet = formula.series(|k| Jet { value: x[k], first: rate[k], second: change[k] });
            let at = |h: f64| formula.value(|k| x[k] + h * rate[k] + 0.5 * h * h * change[k]);
            let h = 1e-3;
            let [near, far] = [h, 2.0 * h].map(|h| [at(h), at(-h)]);
            let first = (8.0 * (near[0] - near[1]) - far[0] + far[1]) / (12.0 * h);
            let second = (16.0 * (near[0] + near[1]) - far[0] - far[1] - 30.0 * at(0.0)) / (12.0 * h * h);
            assert_eq!(jet.value, at(0.0), "{formula:?}");
            assert!((jet.first - first).abs() < 1e-9, "{formula:?}: {jet:?} {first}");
            assert!((jet.second - second).abs() < 1e-6, "{formula:?}: {jet:?} {second}");
        }
    }

    /// Formulas with a kink at zero, and their slopes below and above.
    fn kinks() -> [(Vec<FormulaStep>, [f64; 2]); 3] {
        use ElementaryFunction::{Abs, Sign};
        let column = Column(0);
        // Coulomb's friction, `-8 sign(v) min(1, |v| / 0.01)`, and `1e4 max(0, F) + 300 |F|`
        let friction = vec![
            Constant(-8.0),
            column.clone(),
            Call(Sign),
            Combine(Multiply),
            Constant(1.0),
            column.clone(),
            Call(Abs),
            Constant(0.01),
            Combine(Divide),
            Combine(Minimum),
            Combine(Multiply),
        ];
        let rope = vec![
            Constant(0.0),
            column.clone(),
            Combine(Maximum),
            Constant(1e4),
            Combine(Multiply),
            column.clone(),
            Call(Abs),
            Constant(300.0),
            Combine(Multiply),
            Combine(Add),
        ];
        // `min(x, 0) - max(-x, 0)`
        let slack = vec![
            column.clone(),
            Constant(0.0),
            Combine(Minimum),
            column,
            Negate,
            Constant(0.0),
            Combine(Maximum),
            Combine(Subtract),
        ];
        [(friction, [-800.0; 2]), (rope, [-300.0, 10300.0]), (slack, [2.0, 0.0])]
    }

    #[test]
    fn derivatives_at_a_kink_are_those_of_the_piece_that_is_entered() {
        for (steps, [below, above]) in kinks() {
            let formula = Formula::new(steps).unwrap();
            for (rate, slope) in [(-2.0, below), (3.0, above)] {
                let jet = formula.series(|_| Jet { value: 0.0, first: rate, second: 0.0 });
                assert!((jet.first - slope * rate).abs() < 1e-9, "{formula:?}: {jet:?}, expected {slope}");
            }
            // at rest the second derivative decides
            let jet = formula.series(|_| Jet { value: 0.0, first: 0.0, second: 1.0 });
            assert!((jet.second - above).abs() < 1e-9, "{formula:?}: {jet:?}");
        }
    }

    #[test]
    fn a_power_of_zero_does_not_change_with_its_exponent() {
        let formula = Formula::new(vec![Column(0), Call(ElementaryFunction::Abs), Column(1), Combine(Power)]).unwrap();
        let jet = formula.series(|k| Jet { value: [0.0, 1.5][k], first: [0.0, 1.0][k], second: 0.0 });
        assert_eq!(jet, Jet::from(0.0));
    }

    #[test]
    fn a_tape_computes_the_same() {
        for formula in formulas() {
            let mut builder = TapeBuilder::new(2, 0..1);
            let columns = [0, 1].map(Register::input);
            let found = formula.write(&columns, &mut builder);
            let tape = builder.finish();
            let mut work = tape.work::<Jet<Jet>>();
            let nested = |value: f64, first: f64| Jet { value: Jet { value, first, second: 0.5 }, ..Jet::from(first) };
            for x in [[0.7, 1.3], [0.7, 0.2], [0.3, 0.9]] {
                work.set_inputs([nested(x[0], 0.9), nested(x[1], -0.4)].into_iter());
                tape.run(&mut work);
                let expected = formula.evaluate(|k| nested(x[k], [0.9, -0.4][k]));
                let numbers = |jet: Jet<Jet>| {
                    [jet.value, jet.first, jet.second].map(|jet| [jet.value, jet.first, jet.second]).concat()
                };
                for (found, expected) in numbers(work.get(found)).into_iter().zip(numbers(expected)) {
                    let bound = 1e-13 * (1.0 + expected.abs());
                    assert!((found - expected).abs() < bound, "{formula:?} at {x:?}: {found} {expected}");
                }
            }
        }
    }

    #[test]
    fn constants_are_folded() {
        let mut builder = TapeBuilder::new(1, 0..0);
        let formula = Formula::new(vec![
            Constant(2.0),
            Constant(8.0),
            Constant(3.0),
            Combine(Power),
            Combine(Divide),
            Call(ElementaryFunction::Ln),
        ]);
        let register = formula.unwrap().write(&[Register::input(0)], &mut builder);
        assert!(!builder.varies(register));
        let tape = builder.finish();
        let mut work = tape.work::<f64>();
        tape.run(&mut work);
        assert_eq!(work.get(register), (2.0f64 / 512.0).ln());
    }

    #[test]
    fn formulas_without_operands_or_with_too_many_values_are_refused() {
        for steps in
            [vec![], vec![Combine(Add)], vec![Constant(1.0), Combine(Multiply)], vec![Constant(1.0), Column(0)]]
        {
            assert!(matches!(Formula::new(steps), Err(FormatError::Formula { .. })));
        }
        let all: Vec<FormulaStep> = formulas().iter().flat_map(|formula| formula.steps().to_vec()).collect();
        assert_eq!(Formula::one_after_the_other(&all).unwrap(), formulas());
        assert_eq!(Formula::one_after_the_other(&[]).unwrap(), []);
        assert!(Formula::one_after_the_other(&[Column(0), Negate, Combine(Add)]).is_err());
        let message = Formula::new(vec![Constant(f64::NAN)]).unwrap_err().to_string();
        assert!(message.contains("not finite"), "{message}");
    }
}
