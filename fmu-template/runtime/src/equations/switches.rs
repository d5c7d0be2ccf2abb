//! Values of arguments at which [formulas](Formula) switch from one branch to another, or have the narrowest part of a pulse.
//!
//! `300*max(0, 1 - abs(x - 0.3)/2e-3)` has three along `x`: 0.298, 0.3 and 0.302. They follow from the formula alone: an operation such as
//! `max` switches where its argument has a level. The operations in the argument are inverted one by one, until a column remains, or a sum or
//! product of columns.

use super::{
    bends::Bends,
    formula::{Formula, FormulaStep},
};
use crate::numbers::{
    combination::Combination::{self, Add, Angle, Divide, Maximum, Minimum, Multiply, Power, Subtract},
    elementary::ElementaryFunction::{Abs, Acos, Asin, Atan, Cos, Exp, Floor, Ln, Sign, Sin, Smooth, Sqrt, Tan, Tanh},
};
use FormulaStep::{Call, Combine, Constant, Negate};
use std::{
    f64::consts::{PI, TAU},
    ops::Range,
};

/// Values at which an operation switches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Levels {
    /// These.
    Some(&'static [f64]),
    /// All whole numbers.
    Whole,
}

/// An argument of a formula with bends.
#[derive(Clone, Debug, PartialEq)]
pub struct FormulaArgument {
    /// The argument, a function of the columns of the formula.
    pub formula: Formula,
    /// Its bends.
    pub bends: Bends,
}

/// Arguments of a formula, operations that switch, and inverted operations, at most.
const MOST: usize = 64;
/// Branches of an argument, at most.
const MOST_BRANCHES: usize = 16;

/// The argument that decides for a branch of an operation with these operands, and its levels there.
pub fn switching(step: &FormulaStep, operands: &[&[FormulaStep]]) -> Option<(Vec<FormulaStep>, Levels)> {
    let first = operands.first()?.to_vec();
    match step {
        Call(Abs | Sign) => Some((first, Levels::Some(&[0.0]))),
        Call(Smooth) => Some((first, Levels::Some(&[0.0, 1.0]))),
        Call(Floor) => Some((first, Levels::Whole)),
        // smooth, but they may be as narrow as a jump or a pulse
        Call(Tanh | Atan) => Some((first, Levels::Some(&[-1.0, 1.0]))),
        Call(Exp) => Some((first, Levels::Some(&[-1.0]))),
        Combine(Minimum | Maximum) => {
            Some((binary(Subtract, operands.first()?, operands.get(1)?), Levels::Some(&[0.0])))
        }
        // the angle jumps where y passes zero
        Combine(Angle) => Some((first, Levels::Some(&[0.0]))),
        _ => None,
    }
}

/// The arguments of a formula with the bends over which a solver may step unawares; `varies` returns true for columns that change during a
/// run.
///
/// None for a formula that bends once, or is a single ramp: its value after the step differs from that before it.
pub fn bent_arguments(formula: &Formula, varies: &dyn Fn(usize) -> bool) -> Vec<FormulaArgument> {
    let mut search = ArgumentSearch { varies, found: Vec::new(), inversions: 0 };
    let mut count = 0;
    let mut has_ramps_only = true;
    let all = operations(formula.steps(), varies);
    for FormulaOperation { index, operands, is_linear, .. } in all.into_iter().filter(|operation| operation.changes()) {
        let step = &formula.steps()[index];
        let operands: Vec<&[FormulaStep]> =
            operands.into_iter().map(|operand| &formula.steps()[operand.range]).collect();
        let before = search.found.len();
        if let Some((argument, levels)) = switching(step, &operands) {
            match levels {
                Levels::Some(levels) => levels.iter().for_each(|level| search.visit(&argument, Level::number(*level))),
                Levels::Whole => {
                    search.visit(&argument, Level { at: vec![Constant(0.0)], period: Some(vec![Constant(1.0)]) });
                }
            }
        }
        match (step, operands.as_slice()) {
            (Combine(Divide), [_, divisor]) => search.visit_pole(divisor),
            (Combine(Power), [base, exponent]) if number(exponent).is_some_and(|power| power < 0.0) => {
                search.visit_pole(base);
            }
            _ => {}
        }
        if search.found.len() > before {
            count += 1;
            has_ramps_only &= is_linear && matches!(step, Call(Tanh | Atan | Smooth));
        }
        if count >= MOST || search.found.len() >= MOST {
            break;
        }
    }
    if count == 1 && has_ramps_only { Vec::new() } else { search.arguments() }
}

/// The arguments of the tables in a formula that have bends; `varies` returns true for columns that change during a run.
pub fn table_arguments(formula: &Formula, varies: &dyn Fn(usize) -> bool) -> Vec<FormulaArgument> {
    let mut arguments = Vec::new();
    for FormulaOperation { index, operands, .. } in operations(formula.steps(), varies) {
        let FormulaStep::Lookup(table) = &formula.steps()[index] else { continue };
        for (axis, operand) in operands.into_iter().enumerate().filter(|(_, operand)| operand.changes) {
            let of_operand = Formula::new(formula.steps()[operand.range].to_vec());
            let bends = Bends::clone(table.bends(axis));
            arguments.extend(of_operand.map(|formula| FormulaArgument { formula, bends }));
        }
    }
    arguments.retain(|argument| !argument.bends.is_empty());
    arguments
}

/// An operation of a formula.
struct FormulaOperation {
    index: usize,
    operands: Vec<Operand>,
    /// `true` if the formula is a sum of its products with others.
    is_linear: bool,
}

/// Steps of an operand.
struct Operand {
    range: Range<usize>,
    /// `true` if a column in it changes during a run.
    changes: bool,
}

impl FormulaOperation {
    fn changes(&self) -> bool {
        self.operands.iter().any(|operand| operand.changes)
    }
}

/// The operations with operands, the last one first.
fn operations(steps: &[FormulaStep], varies: &dyn Fn(usize) -> bool) -> Vec<FormulaOperation> {
    let mut begins: Vec<usize> = Vec::with_capacity(steps.len());
    let mut changes: Vec<bool> = Vec::with_capacity(steps.len());
    for (index, step) in steps.iter().enumerate() {
        let (mut begin, mut is_changing) = (index, matches!(step, FormulaStep::Column(column) if varies(*column)));
        for _ in 0..step.operands() {
            is_changing |= changes[begin - 1];
            begin = begins[begin - 1];
        }
        begins.push(begin);
        changes.push(is_changing);
    }
    let mut is_linear = vec![true; steps.len()];
    let mut found = Vec::new();
    for (index, step) in steps.iter().enumerate().rev().filter(|(_, step)| step.operands() > 0) {
        let mut end = index;
        let mut operands: Vec<Operand> = Vec::new();
        for number in (0..step.operands()).rev() {
            let begin = begins[end - 1];
            let is_sum = matches!(step, Negate | Combine(Add | Subtract | Multiply));
            is_linear[end - 1] = is_linear[index] && (is_sum || (*step == Combine(Divide) && number == 0));
            operands.push(Operand { range: begin..end, changes: changes[end - 1] });
            end = begin;
        }
        operands.reverse();
        found.push(FormulaOperation { index, operands, is_linear: is_linear[index] });
    }
    found
}

/// The last operation of an expression, and its operands.
fn split(expression: &[FormulaStep]) -> Option<(&FormulaStep, Vec<&[FormulaStep]>)> {
    let (step, mut rest) = expression.split_last()?;
    let mut operands = Vec::new();
    for _ in 0..step.operands() {
        let mut missing = 1;
        let mut begin = rest.len();
        while missing > 0 {
            begin = begin.checked_sub(1)?;
            missing = missing - 1 + rest[begin].operands();
        }
        operands.push(&rest[begin..]);
        rest = &rest[..begin];
    }
    operands.reverse();
    Some((step, operands))
}

fn unary(step: FormulaStep, of: &[FormulaStep]) -> Vec<FormulaStep> {
    [of, &[step]].concat()
}

fn binary(combination: Combination, a: &[FormulaStep], b: &[FormulaStep]) -> Vec<FormulaStep> {
    [a, b, &[Combine(combination)]].concat()
}

/// The value of an expression without columns.
fn number(expression: &[FormulaStep]) -> Option<f64> {
    let formula = Formula::new(expression.to_vec()).ok()?;
    formula.columns().next().is_none().then(|| formula.value(|_| f64::NAN))
}

/// Value of an argument, and where it recurs; expressions of columns that do not change.
#[derive(Clone)]
struct Level {
    at: Vec<FormulaStep>,
    period: Option<Vec<FormulaStep>>,
}

impl Level {
    fn number(at: f64) -> Self {
        Self { at: vec![Constant(at)], period: None }
    }

    fn once(at: Vec<FormulaStep>) -> Self {
        Self { at, period: None }
    }

    /// Level and period with other units.
    fn scaled(&self, combination: Combination, by: &[FormulaStep]) -> Self {
        let period = self.period.as_ref().map(|period| binary(combination, period, by));
        Self { at: binary(combination, &self.at, by), period }
    }

    fn moved(&self, at: Vec<FormulaStep>) -> Self {
        Self { at, period: self.period.clone() }
    }
}

/// An argument, and a value at which the formula bends.
struct Passage {
    argument: Vec<FormulaStep>,
    at: f64,
    period: Option<f64>,
}

/// The search for the arguments of a formula.
struct ArgumentSearch<'a> {
    varies: &'a dyn Fn(usize) -> bool,
    found: Vec<Passage>,
    inversions: usize,
}

impl ArgumentSearch<'_> {
    fn changes(&self, expression: &[FormulaStep]) -> bool {
        expression.iter().any(|step| matches!(step, FormulaStep::Column(column) if (self.varies)(*column)))
    }

    /// Finds where an expression has a level: inverts its last operation.
    fn visit(&mut self, expression: &[FormulaStep], level: Level) {
        self.inversions += 1;
        if !self.changes(expression) || self.found.len() >= MOST {
            return;
        }
        let Some((step, operands)) = split(expression).filter(|_| self.inversions < 16 * MOST) else { return };
        let Level { at, period } = &level;
        let (is_periodic, negative) = (period.is_some(), unary(Negate, at));
        match (step, operands.as_slice()) {
            (Negate, [a]) => self.visit(a, level.moved(negative)),
            (Combine(Add), [a, b]) if !self.changes(b) => self.visit(a, level.moved(binary(Subtract, at, b))),
            (Combine(Add), [a, b]) if !self.changes(a) => self.visit(b, level.moved(binary(Subtract, at, a))),
            (Combine(Subtract), [a, b]) if !self.changes(b) => self.visit(a, level.moved(binary(Add, at, b))),
            (Combine(Subtract), [a, b]) if !self.changes(a) => self.visit(b, level.moved(binary(Subtract, a, at))),
            (Combine(Subtract), [a, b]) if !is_periodic && self.period_of_remainder(a, b).is_some() => {
                let period = self.period_of_remainder(a, b).map(<[FormulaStep]>::to_vec);
                self.visit(a, Level { at: at.clone(), period });
            }
            (Combine(Multiply), [a, b]) if !self.changes(b) => self.visit(a, level.scaled(Divide, b)),
            (Combine(Multiply), [a, b]) if !self.changes(a) => self.visit(b, level.scaled(Divide, a)),
            (Combine(Divide), [a, b]) if !self.changes(b) => self.visit(a, level.scaled(Multiply, b)),
            _ if is_periodic => self.add(expression, &level),
            (Combine(Divide), [a, b]) if !self.changes(a) => self.visit(b, Level::once(binary(Divide, a, at))),
            (Combine(Multiply), [a, b]) if a == b => self.visit_both(a, unary(Call(Sqrt), at)),
            (Combine(Power), [a, b]) if !self.changes(b) => self.visit_power(a, b, at),
            (Combine(Minimum | Maximum), [a, b]) => {
                self.visit(a, level.clone());
                self.visit(b, level);
            }
            (Call(Abs), [a]) => self.visit_both(a, at.clone()),
            (Call(Exp), [a]) => self.visit(a, Level::once(unary(Call(Ln), at))),
            (Call(Ln), [a]) => self.visit(a, Level::once(unary(Call(Exp), at))),
            (Call(Sqrt), [a]) => self.visit(a, Level::once(binary(Multiply, at, at))),
            (Call(Atan), [a]) => self.visit(a, Level::once(unary(Call(Tan), at))),
            (Call(Tanh), [a]) => {
                let [above, below] = [Add, Subtract].map(|sign| binary(sign, &[Constant(1.0)], at));
                let twice = unary(Call(Ln), &binary(Divide, &above, &below));
                self.visit(a, Level::once(binary(Multiply, &twice, &[Constant(0.5)])));
            }
            (Call(Sin | Cos), [a]) => {
                let is_sine = *step == Call(Sin);
                let first = unary(Call(if is_sine { Asin } else { Acos }), at);
                let turned = if is_sine { PI } else { 0.0 };
                let second = binary(Subtract, &[Constant(turned)], &first);
                for at in [first, second] {
                    self.visit(a, Level { at, period: Some(vec![Constant(TAU)]) });
                }
            }
            _ => {
                let branches = branches(expression);
                match branches.len() {
                    2.. => branches.iter().for_each(|branch| self.visit(branch, level.clone())),
                    _ => self.add(expression, &level),
                }
            }
        }
    }

    fn visit_both(&mut self, expression: &[FormulaStep], level: Vec<FormulaStep>) {
        self.visit(expression, Level::once(unary(Negate, &level)));
        self.visit(expression, Level::once(level));
    }

    /// Finds where the power of a base has a level.
    fn visit_power(&mut self, base: &[FormulaStep], exponent: &[FormulaStep], level: &[FormulaStep]) {
        let root = |of: &[FormulaStep]| binary(Power, of, &binary(Divide, &[Constant(1.0)], exponent));
        match number(exponent).map(|power| power.rem_euclid(2.0)) {
            Some(0.0) => self.visit_both(base, root(level)),
            Some(1.0) => {
                let signed = binary(Multiply, &unary(Call(Sign), level), &root(&unary(Call(Abs), level)));
                self.visit(base, Level::once(signed));
            }
            _ => self.visit(base, Level::once(root(level))),
        }
    }

    /// Finds where a divisor such as `1 + (x/w)^2` is twice its smallest value.
    fn visit_pole(&mut self, divisor: &[FormulaStep]) {
        match split(divisor) {
            Some((Call(Sqrt), operands)) => self.visit_pole(operands[0]),
            Some((Combine(Power), operands)) if !self.changes(operands[1]) => self.visit_pole(operands[0]),
            Some((Combine(Multiply), operands)) if !self.changes(operands[0]) => self.visit_pole(operands[1]),
            Some((Combine(Multiply | Divide), operands)) if !self.changes(operands[1]) => self.visit_pole(operands[0]),
            Some((Combine(Add), operands)) => {
                let [a, b] = [operands[0], operands[1]];
                let (fixed, changing) = if self.changes(a) { (b, a) } else { (a, b) };
                if !self.changes(fixed) && !is_linear(changing, self.varies) {
                    self.visit(changing, Level::once(fixed.to_vec()));
                }
            }
            _ => {}
        }
    }

    /// The period `p` of `a - p floor(a / p)`, which is `mod(a, p)`.
    fn period_of_remainder<'a>(&self, a: &[FormulaStep], b: &'a [FormulaStep]) -> Option<&'a [FormulaStep]> {
        let (Combine(Multiply), product) = split(b)? else { return None };
        let (Call(Floor), turns) = split(product[1])? else { return None };
        let (Combine(Divide), quotient) = split(turns[0])? else { return None };
        let is_remainder = quotient[0] == a && quotient[1] == product[0] && !self.changes(product[0]);
        is_remainder.then_some(product[0])
    }

    fn add(&mut self, argument: &[FormulaStep], Level { at, period }: &Level) {
        let numbers = (number(at), period.as_ref().map(|period| number(period)));
        let passage = match numbers {
            (Some(at), None) => Passage { argument: argument.to_vec(), at, period: None },
            (Some(at), Some(Some(period))) => {
                let period = period.abs();
                Passage { argument: argument.to_vec(), at: at.rem_euclid(period), period: Some(period) }
            }
            _ => {
                let since = binary(Subtract, argument, at);
                let argument = period.as_ref().map_or(since.clone(), |period| binary(Divide, &since, period));
                Passage { argument, at: 0.0, period: period.is_some().then_some(1.0) }
            }
        };
        if passage.at.is_finite() && passage.period.is_none_or(|period| period.is_finite() && period > 0.0) {
            self.found.push(passage);
        }
    }

    fn arguments(self) -> Vec<FormulaArgument> {
        let Self { mut found, varies, .. } = self;
        let mut arguments: Vec<FormulaArgument> = Vec::new();
        while let Some(Passage { argument, at, period }) = found.pop() {
            let mut values = vec![at];
            found.retain(|passage| {
                let is_same = passage.argument == argument && passage.period == period;
                if is_same && !values.contains(&passage.at) {
                    values.push(passage.at);
                }
                !is_same
            });
            // few: a sort of the standard library takes kilobytes of machine code
            for end in 1..values.len() {
                (1..=end).rev().for_each(|k| {
                    if values[k] < values[k - 1] {
                        values.swap(k, k - 1);
                    }
                });
            }
            let is_single = values.len() == 1 && period.is_none() && is_linear(&argument, varies);
            if is_single && arguments.is_empty() && found.is_empty() {
                break;
            }
            let bends = Bends::at(&values, period);
            arguments.extend(Formula::new(argument).map(|formula| FormulaArgument { formula, bends }));
        }
        arguments
    }
}

/// Returns true for a sum of columns times factors that do not change.
fn is_linear(expression: &[FormulaStep], varies: &dyn Fn(usize) -> bool) -> bool {
    operations(expression, varies).iter().all(|operation| {
        match (&expression[operation.index], operation.operands.as_slice()) {
            (Negate | Combine(Add | Subtract), _) => true,
            (Combine(Multiply), [a, b]) => !(a.changes && b.changes),
            (Combine(Divide), [_, divisor]) => !divisor.changes,
            _ => !operation.changes(),
        }
    })
}

/// The smooth functions that an expression may be: each `abs`, `sign`, `min` and `max` replaced by its branches. The expression alone if
/// they are too many.
fn branches(expression: &[FormulaStep]) -> Vec<Vec<FormulaStep>> {
    let mut stack: Vec<Vec<Vec<FormulaStep>>> = Vec::new();
    for step in expression {
        let operands = stack.split_off(stack.len().saturating_sub(step.operands()));
        let next = match (step, operands.as_slice()) {
            (Call(Abs), [a]) => a.iter().flat_map(|a| [a.clone(), unary(Negate, a)]).collect(),
            (Call(Sign), _) => vec![vec![Constant(1.0)], vec![Constant(-1.0)]],
            (Combine(Minimum | Maximum), [a, b]) => [a.as_slice(), b].concat(),
            (_, [a]) => a.iter().map(|a| unary(step.clone(), a)).collect(),
            (_, [a, b]) => {
                let with =
                    |a: &Vec<FormulaStep>| b.iter().map(|b| [a, &b[..], std::slice::from_ref(step)].concat()).collect();
                a.iter().flat_map(|a| -> Vec<Vec<FormulaStep>> { with(a) }).collect()
            }
            _ => vec![vec![step.clone()]],
        };
        if next.len() > MOST_BRANCHES {
            return vec![expression.to_vec()];
        }
        stack.push(next);
    }
    stack.pop().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    const X: FormulaStep = FormulaStep::Column(0);
    const Y: FormulaStep = FormulaStep::Column(1);
    /// A parameter.
    const P: FormulaStep = FormulaStep::Column(2);

    fn number_of(value: f64) -> Vec<FormulaStep> {
        vec![Constant(value)]
    }

    /// `max(0, 1 - abs(x - at)/width)`
    fn hat(x: &[FormulaStep], at: &[FormulaStep], width: &[FormulaStep]) -> Vec<FormulaStep> {
        let distance = unary(Call(Abs), &binary(Subtract, x, at));
        binary(Maximum, &number_of(0.0), &binary(Subtract, &number_of(1.0), &binary(Divide, &distance, width)))
    }

    /// Values of the arguments at `(x, y, p)` where the formula bends: each argument's formula with its bends.
    fn found(steps: Vec<FormulaStep>) -> Vec<FormulaArgument> {
        bent_arguments(&Formula::new(steps).unwrap(), &|column| column < 2)
    }

    /// The bends of a formula of `x` alone.
    #[track_caller]
    fn assert_bends(steps: Vec<FormulaStep>, expected: &[f64]) {
        let all = found(steps);
        let [FormulaArgument { formula, bends }] = all.as_slice() else { panic!("{all:?}") };
        assert_eq!(formula.steps(), [X]);
        assert_eq!(bends.list().len(), expected.len(), "{bends:?}");
        for (bend, expected) in bends.list().iter().zip(expected) {
            assert!((bend.at - expected).abs() < 1e-12, "{bends:?} {expected}");
        }
    }

    #[test]
    fn pulses_bend_at_their_edges_and_in_their_middle() {
        assert_bends(hat(&[X], &number_of(0.3), &number_of(2e-3)), &[0.298, 0.3, 0.302]);
        // of half and of minus the column
        let half = binary(Divide, &[X, Negate], &number_of(2.0));
        assert_bends(hat(&half, &number_of(0.3), &number_of(2e-3)), &[-0.604, -0.6, -0.596]);
        let square = binary(Power, &binary(Subtract, &[X], &number_of(0.3)), &number_of(2.0));
        let share = binary(Divide, &square, &number_of(1e-6));
        assert_bends(unary(Call(Exp), &unary(Negate, &share)), &[0.299, 0.301]);
        let share = binary(Add, &number_of(1.0), &share);
        assert_bends(binary(Divide, &[P], &unary(Call(Sqrt), &share)), &[0.299, 0.301]);
        let jump = |at: f64| unary(Call(Sign), &binary(Subtract, &[X], &number_of(at)));
        assert_bends(binary(Subtract, &jump(0.1), &jump(0.2)), &[0.1, 0.2]);
        let ramp =
            |at: f64| unary(Call(Tanh), &binary(Divide, &binary(Subtract, &[X], &number_of(at)), &number_of(0.01)));
        assert_bends(binary(Subtract, &ramp(0.1), &ramp(0.2)), &[0.09, 0.11, 0.19, 0.21]);
    }

    #[test]
    fn parameters_move_the_bends() {
        let all = found(hat(&[X], &[P], &binary(Multiply, &[P], &number_of(0.1))));
        let mut at: Vec<f64> = Vec::new();
        for FormulaArgument { formula, bends } in &all {
            assert_eq!(bends.list().len(), 1);
            let since = formula.value(|column| [0.0, f64::NAN, 2.0][column]);
            at.push(bends.list()[0].at - since);
        }
        at.sort_by(f64::total_cmp);
        assert_eq!(at.len(), 3);
        for (found, expected) in at.iter().zip([1.8, 2.0, 2.2]) {
            assert!((found - expected).abs() < 1e-12, "{at:?}");
        }
    }

    #[test]
    fn sines_and_remainders_bend_in_every_period() {
        let share = binary(Divide, &[X], &number_of(0.5));
        let turns = binary(Multiply, &number_of(0.5), &unary(Call(Floor), &share));
        let remainder = binary(Subtract, &[X], &turns);
        let all = found(hat(&remainder, &number_of(0.1), &number_of(0.01)));
        let periodic: Vec<&Bends> = all.iter().map(|argument| &argument.bends).collect();
        assert!(all.iter().all(|argument| argument.formula.steps() == [X]), "{all:?}");
        let [bends] = periodic.as_slice() else { panic!("{all:?}") };
        assert_eq!(bends.period(), Some(0.5));
        for (bend, expected) in bends.list().iter().zip([0.0, 0.09, 0.1, 0.11]) {
            assert!((bend.at - expected).abs() < 1e-12, "{bends:?}");
        }
        let wave = unary(Call(Cos), &binary(Multiply, &number_of(8.0), &[X]));
        let all = found(binary(Maximum, &number_of(0.0), &binary(Subtract, &wave, &number_of(0.99))));
        let bends = &all[0].bends;
        let edge = 0.99f64.acos() / 8.0;
        assert!((bends.list()[0].at - edge).abs() < 1e-12 && (bends.list()[0].width - 2.0 * edge).abs() < 1e-12);
    }

    #[test]
    fn a_disk_is_an_argument_of_both_columns() {
        let square = |of: FormulaStep| binary(Power, &[of], &number_of(2.0));
        let distance = binary(Divide, &binary(Add, &square(X), &square(Y)), &number_of(1e-4));
        let all = found(unary(Call(Exp), &unary(Negate, &distance)));
        let [FormulaArgument { formula, bends }] = all.as_slice() else { panic!("{all:?}") };
        assert_eq!(formula.value(|column| [3.0, 4.0][column]), 25.0);
        assert!((bends.list()[0].at - 1e-4).abs() < 1e-15);
        // |x| + |y| has four branches
        let sum = binary(Add, &[X, Call(Abs)], &[Y, Call(Abs)]);
        let all = found(binary(Maximum, &number_of(0.0), &binary(Subtract, &number_of(0.1), &sum)));
        assert_eq!(all.iter().filter(|argument| argument.formula.steps().len() > 1).count(), 4, "{all:?}");
    }

    #[test]
    fn what_no_step_can_miss_is_left_out() {
        let contact = binary(Maximum, &number_of(0.0), &unary(Negate, &[X]));
        let friction = binary(Multiply, &[P], &unary(Call(Tanh), &binary(Divide, &[Y], &number_of(0.02))));
        let drag = binary(Multiply, &[Y], &unary(Call(Abs), &[Y]));
        let of_parameters = hat(&[P], &number_of(0.3), &number_of(2e-3));
        for steps in [contact, friction.clone(), drag, of_parameters, vec![X]] {
            assert_eq!(found(steps), []);
        }
        // 1 - tanh(y)^2 is a pulse
        let pulse = binary(Subtract, &number_of(1.0), &binary(Power, &friction, &number_of(2.0)));
        assert_eq!(found(pulse)[0].bends.list().len(), 2);
    }
}
