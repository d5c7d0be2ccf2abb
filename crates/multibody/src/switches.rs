//! Time points at which formulas of time switch from one branch to another, or have the narrowest part of a pulse. Runs stop there, so that no
//! step goes over a pulse, whatever its width is.
//!
//! A formula `f(t)` switches where an argument of `abs`, `sign`, `floor` or `smooth`, or the difference of those of `min` and `max`, passes a
//! level. Intervals are halved until [enclosures](Enclosure) show that an argument passes none, or that it is monotone: then bisection
//! finds where it does.

use super::{
    constraint::{BoundExpression, Slot, Target},
    enclosure::Enclosure,
    error::{MotionCause, MotionError},
    model::MultibodyModel,
};
use metafmu_runtime::{
    formula::{Formula, FormulaStep},
    switches::{Levels, switching},
};
use std::ops::Range;

/// Part of a run that is not divided any further.
const SHORTEST: f64 = 1e-10;
/// Intervals that are checked for an argument, and switches of a run, at most.
const MOST: usize = 100_000;
/// Rounding of a time, in units of its last place.
const ULPS: f64 = 16.0;

/// Rounding of times in an interval.
fn rounding([begin, end]: [f64; 2]) -> f64 {
    ULPS * f64::EPSILON * begin.abs().max(end.abs())
}

/// Time points of a run at which stretches end, with its rows or between them.
pub(super) struct Stops {
    list: Vec<f64>,
    passed: usize,
}

/// Times of the next stretch of a run.
pub(super) struct StretchTimes {
    /// Where it begins, then the times at which samples are needed.
    pub times: Vec<f64>,
    /// `true` if these are rows; else the only one is a stop.
    pub has_rows: bool,
}

impl Stops {
    /// Stops of a run with these rows: the [switches] of formulas of time.
    ///
    /// # Errors
    /// As [`switches`].
    pub fn new(model: &MultibodyModel, rows: &[f64]) -> Result<Self, MotionError> {
        let list = if let [start, .., stop] = rows { switches(model, [*start, *stop])? } else { Vec::new() };
        Ok(Self { list, passed: 0 })
    }

    /// Returns true if there are any.
    pub fn has_any(&self) -> bool {
        !self.list.is_empty()
    }

    /// The stretch from a time with `most` times at most, that of its begin included; `rows` are the rows after it.
    pub fn next(&mut self, from: f64, rows: &[f64], most: usize) -> StretchTimes {
        let near = 8.0 * rounding([from, rows[rows.len() - 1]]);
        while self.list.get(self.passed).is_some_and(|stop| *stop <= from + near) {
            self.passed += 1;
        }
        let stop = self.list.get(self.passed).copied().unwrap_or(f64::INFINITY);
        let before = rows.iter().take(most - 1).take_while(|row| **row < stop - near).count();
        // a row at the stop is no part of a longer stretch: nothing is evaluated beyond it
        let has_rows = before > 0 || rows[0] <= stop + near;
        let ahead = if has_rows { &rows[..before.max(1)] } else { &[stop] };
        StretchTimes { times: [&[from], ahead].concat(), has_rows }
    }
}

/// Times between two switches: formulas of time are on one branch.
#[derive(Clone, Copy)]
pub(super) struct Branch([f64; 2]);

impl Branch {
    /// Branch of a stretch with these times. A stretch of several rows is integrated a little beyond the last one.
    pub fn of(times: &[f64]) -> Self {
        let keep = 16.0 * rounding([times[0], times[times.len() - 1]]);
        let end = if times.len() == 2 { times[1] - keep } else { f64::INFINITY };
        Self([times[0] + keep, end])
    }

    /// The time on the branch that is nearest to a time: at a switch itself, rounding would decide for a branch.
    pub fn nearest(self, t: f64) -> f64 {
        t.max(self.0[0]).min(self.0[1])
    }
}

/// Time points in a run at which its formulas of time switch, in ascending order; none if no formula does.
///
/// # Errors
/// An error: there are too many.
pub(super) fn switches(model: &MultibodyModel, run: [f64; 2]) -> Result<Vec<f64>, MotionError> {
    let motions = model.constraints.iter().filter_map(|constraint| match &constraint.target {
        Target::Motion(motion) => Some((motion, constraint.owner.as_str())),
        _ => None,
    });
    let mut found = run.to_vec();
    for (bound, owner) in model.acting_expressions().chain(motions) {
        add_switches(bound, &mut found).map_err(|TooManySwitches([begin, end])| {
            let message = format!(
                "`{}` of `{owner}` switches at too many times from {begin} s to {end} s, expected at most {MOST}",
                bound.text
            );
            MotionError::of(owner, MotionCause::Unsolved, message)
        })?;
    }
    found.retain(|t| *t > run[0] && *t < run[1]);
    Ok(found)
}

/// More switches than [`MOST`] between two times.
#[derive(Debug)]
struct TooManySwitches([f64; 2]);

/// Adds the switches of an expression to times in ascending order, the ends of the run among them.
fn add_switches(bound: &BoundExpression, times: &mut Vec<f64>) -> Result<(), TooManySwitches> {
    for one in Switch::all(bound) {
        let (begin, end) = (times[0], times[times.len() - 1]);
        let mut search = SwitchSearch { one, bound, shortest: SHORTEST * (end - begin), checked: 0, found: Vec::new() };
        for piece in times.windows(2) {
            search.visit([piece[0] + rounding([begin, end]), piece[1] - rounding([begin, end])]);
        }
        if search.is_exhausted() {
            return Err(TooManySwitches([begin, end]));
        }
        times.append(&mut search.found);
        times.sort_by(f64::total_cmp);
        times.dedup_by(|b, a| *b - *a < 64.0 * rounding([begin, end]));
    }
    Ok(())
}

/// A function of time in a formula, and the values at which something happens.
struct Switch {
    argument: Formula,
    levels: Levels,
}

impl Switch {
    /// Switches of an expression, inner ones before those around them.
    fn all(bound: &BoundExpression) -> Vec<Self> {
        if !bound.slots.iter().any(|slot| matches!(slot, Slot::Time)) {
            return Vec::new();
        }
        let steps = bound.formula.steps();
        // operations of each value on the stack, and if it is a function of the time alone
        let mut stack: Vec<(Range<usize>, Dependence)> = Vec::new();
        let mut found = Vec::new();
        for (index, step) in steps.iter().enumerate() {
            let operands = stack.split_off(stack.len().saturating_sub(step.operands()));
            let own = match step {
                FormulaStep::Column(column) => Dependence::of(&bound.slots[*column]),
                _ => Dependence::Constant,
            };
            let depends = operands.iter().map(|(_, depends)| *depends).fold(own, Ord::max);
            let of_step: Vec<&[FormulaStep]> = operands.iter().map(|(range, _)| &steps[range.clone()]).collect();
            if depends == Dependence::Time
                && let Some((mut argument, levels)) = switching(step, &of_step)
            {
                argument.shrink_to_fit();
                found.extend(Formula::new(argument).map(|argument| Self { argument, levels }));
            }
            let begin = operands.first().map_or(index, |(range, _)| range.start);
            stack.push((begin..index + 1, depends));
        }
        found
    }
}

/// Dependence of a value.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Dependence {
    Constant,
    Time,
    State,
}

impl Dependence {
    fn of(slot: &Slot) -> Self {
        match slot {
            Slot::Parameter(..) => Self::Constant,
            Slot::Time => Self::Time,
            Slot::Input(_) | Slot::Position(_) | Slot::Velocity(_) => Self::State,
        }
    }
}

/// The search for the switches of one argument.
struct SwitchSearch<'a> {
    one: Switch,
    bound: &'a BoundExpression,
    shortest: f64,
    checked: usize,
    found: Vec<f64>,
}

impl SwitchSearch<'_> {
    fn is_exhausted(&self) -> bool {
        self.checked > MOST || self.found.len() > MOST
    }

    fn visit(&mut self, [begin, end]: [f64; 2]) {
        self.checked += 1;
        if begin >= end || self.is_exhausted() {
            return;
        }
        let argument = Enclosure::of(&self.one.argument, [begin, end], |column| self.constant(column));
        if argument.is_constant() || !has_level(self.one.levels, argument.value) {
            return;
        }
        if argument.is_monotone() {
            return self.bisect([begin, end], argument.value);
        }
        let middle = 0.5 * (begin + end);
        if end - begin <= self.shortest {
            return self.found.push(middle);
        }
        self.visit([begin, middle]);
        self.visit([middle, end]);
    }

    /// Finds where an argument that is monotone passes its levels.
    fn bisect(&mut self, interval: [f64; 2], [low, high]: [f64; 2]) {
        for level in levels_between(self.one.levels, low, high).take(MOST + 1) {
            let is_above = |t: f64| self.value(t) > level;
            let [mut before, mut behind] = interval;
            let first = is_above(before);
            if is_above(behind) == first {
                continue;
            }
            loop {
                let middle = 0.5 * (before + behind);
                if middle <= before || middle >= behind {
                    break;
                }
                if is_above(middle) == first { before = middle } else { behind = middle }
            }
            self.found.push(behind);
        }
    }

    fn value(&self, t: f64) -> f64 {
        self.one.argument.value(|column| self.constant(column).unwrap_or(t))
    }

    /// Value of a parameter, or none of the time.
    fn constant(&self, column: usize) -> Option<f64> {
        if let Slot::Parameter(_, value) = self.bound.slots[column] { Some(value) } else { None }
    }
}

/// Returns true if there is a level between two values.
fn has_level(levels: Levels, [low, high]: [f64; 2]) -> bool {
    match levels {
        Levels::Some(levels) => levels.iter().any(|level| (low..=high).contains(level)),
        Levels::Whole => low.ceil() <= high.floor(),
    }
}

/// The levels between two values.
fn levels_between(levels: Levels, low: f64, high: f64) -> Box<dyn Iterator<Item = f64>> {
    match levels {
        Levels::Some(levels) => Box::new(levels.iter().copied().filter(move |level| (low..=high).contains(level))),
        Levels::Whole => {
            let first = low.ceil();
            Box::new((0..).map(move |k| first + f64::from(k)).take_while(move |level| *level <= high))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::expression::{Expression, Tables};

    fn of(text: &str, run: [f64; 2]) -> Vec<f64> {
        let expression = Expression::parse(text).unwrap();
        let slots = expression.names().iter().map(|name| if name == "time" { Slot::Time } else { Slot::Input(0) });
        let bound = BoundExpression {
            text: text.into(),
            slots: slots.collect(),
            formula: expression.formula(&Tables::new()).unwrap(),
        };
        let mut found = run.to_vec();
        add_switches(&bound, &mut found).unwrap();
        found[1..found.len() - 1].to_vec()
    }

    #[track_caller]
    fn assert_are(found: &[f64], expected: &[f64]) {
        assert_eq!(found.len(), expected.len(), "{found:?} {expected:?}");
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-9, "{found} {expected}");
        }
    }

    #[test]
    fn switches_are_where_arguments_pass_levels() {
        let whole: Vec<f64> = (1..10).map(f64::from).collect();
        assert_are(&of("step(time, 3, 0, 3.0001, 1)", [0.0, 10.0]), &[3.0, 3.0001]);
        assert_are(&of("max(0, 1 - abs(time - 4)/1e-6)", [0.0, 10.0]), &[4.0 - 1e-6, 4.0, 4.0 + 1e-6]);
        assert_are(&of("mod(time, 1)", [0.0, 10.0]), &whole);
        assert_are(&of("sign(sin(pi*time))", [0.0, 10.0]), &whole);
        assert_are(&of("max(mod(time, 1), 0.5)", [0.0, 2.0]), &[0.5, 1.0, 1.5]);
        // touched, but not passed
        assert_are(&of("abs((time - 5)^2)", [0.0, 10.0]), &[5.0]);
        assert_are(&of("u*abs(time - 5)", [0.0, 10.0]), &[5.0]);
        for without in
            ["abs(u)", "max(u, time)", "sin(50*time)", "max(time, -1)", "step(time, 11, 0, 12, 1)", "min(2, 1)*time"]
        {
            assert_are(&of(without, [0.0, 10.0]), &[]);
        }
    }

    #[test]
    fn a_thousand_pulses_that_a_sine_makes_are_all_found() {
        let found = of("max(0, sin(100*pi*time) - 0.9999)", [0.0, 20.0]);
        assert_eq!(found.len(), 2000);
    }
}
