//! Arguments of forces whose [bends](metafmu_runtime::bends) no part of a run may step over.

use super::{
    constraint::BoundExpression,
    coordinate::Positions,
    model::{MultibodyModel, Sample},
};
use metafmu_runtime::{
    bends::{ArgumentPath, BentArgument, step_over},
    formula::Formula,
    switches::{FormulaArgument, bent_arguments, table_arguments},
};
use nalgebra::DVector;
use std::{cell::RefCell, collections::VecDeque, sync::Arc};

/// Evaluations of a step of Dormand and Prince's method of order 8 without dense output, from its first stage to the derivative at its end.
const EVALUATIONS_OF_STEP: usize = 12;

/// Arguments with bends of a model's expressions, and where a part of a run takes them.
pub(super) struct Bending<'a> {
    functions: Vec<ArgumentFunction<'a>>,
    arguments: Vec<BentArgument>,
    observed: RefCell<Observed>,
}

/// An argument as a function of the columns of an expression.
struct ArgumentFunction<'a> {
    of: &'a BoundExpression,
    formula: Formula,
}

impl ArgumentFunction<'_> {
    fn value(&self, t: f64, q: &impl Positions, v: &DVector<f64>, u: &[f64]) -> f64 {
        self.formula.value(|column| self.of.slots[column].value(t, q, v, u))
    }
}

/// Values of the arguments since the beginning of a part of a run.
#[derive(Default)]
struct Observed {
    /// Where the part ends.
    end: f64,
    /// In accepted steps, in the order of time.
    accepted: Vec<ObservedPoint>,
    /// In the step that is tried, which may be rejected.
    tried: VecDeque<ObservedPoint>,
}

/// Values of the arguments at a time.
struct ObservedPoint {
    t: f64,
    values: Vec<f64>,
}

impl<'a> Bending<'a> {
    /// Arguments of tables and formulas of everything that acts.
    pub fn of(model: &'a MultibodyModel) -> Self {
        let (mut functions, mut arguments) = (Vec::new(), Vec::new());
        let mut group = 0;
        for (bound, _) in model.acting_expressions() {
            let varies = |column: usize| bound.slots[column].changes();
            let of_tables = table_arguments(&bound.formula, &varies).into_iter().map(|argument| vec![argument]);
            for of_group in of_tables.chain([bent_arguments(&bound.formula, &varies)]) {
                for FormulaArgument { formula, bends } in of_group {
                    functions.push(ArgumentFunction { of: bound, formula });
                    arguments.push(BentArgument { bends: Arc::new(bends), group });
                }
                group += 1;
            }
        }
        Self { functions, arguments, observed: RefCell::default() }
    }

    /// Returns true if no expression bends.
    pub fn is_empty(&self) -> bool {
        self.functions.is_empty()
    }

    /// Begins the part from a sample to a time.
    pub fn begin(&self, from: &Sample, to: f64) {
        let values = self.values(from.t, &from.q, &from.v, &from.u);
        // inputs may jump at the end
        let end = to - 1e-9 * (to - from.t);
        self.observed.replace(Observed {
            end,
            accepted: vec![ObservedPoint { t: from.t, values }],
            tried: VecDeque::new(),
        });
    }

    /// Forgets everything but the beginning: another method begins there.
    pub fn restart(&self) {
        let Observed { accepted, tried, .. } = &mut *self.observed.borrow_mut();
        accepted.truncate(1);
        tried.clear();
    }

    /// Notes a state in which the explicit method evaluates the equations; it counts if its step is accepted.
    pub fn try_state(&self, t: f64, q: &impl Positions, v: &DVector<f64>, u: &[f64]) {
        let Observed { end, tried, .. } = &mut *self.observed.borrow_mut();
        if t < *end {
            tried.push_back(ObservedPoint { t, values: self.values(t, q, v, u) });
            if tried.len() > EVALUATIONS_OF_STEP {
                tried.pop_front();
            }
        }
    }

    /// Accepts the step that was tried last.
    pub fn accept(&self) {
        let Observed { accepted, tried, .. } = &mut *self.observed.borrow_mut();
        // states of a rejected step are left if this one ends behind the end, where none are noted; those before its beginning do not count
        let since = accepted.last().map_or(f64::NEG_INFINITY, |point| point.t);
        let first = accepted.len();
        accepted.extend(tried.drain(..).filter(|point| point.t > since));
        accepted[first..].sort_by(|a, b| a.t.total_cmp(&b.t));
    }

    /// Adds a state of an accepted step.
    pub fn add(&self, t: f64, q: &impl Positions, v: &DVector<f64>, u: &[f64]) {
        let Observed { end, accepted, .. } = &mut *self.observed.borrow_mut();
        if t < *end {
            accepted.push(ObservedPoint { t, values: self.values(t, q, v, u) });
        }
    }

    /// Share of the time up to a sample, from 0 to 1, within which nothing is stepped over.
    pub fn share_up_to(&self, model: &MultibodyModel, sample: &Sample) -> f64 {
        let Observed { end, accepted, .. } = &mut *self.observed.borrow_mut();
        let u = model.at(*end, sample.actuator_states(model));
        accepted.push(ObservedPoint { t: *end, values: self.values(*end, &sample.q, &sample.v, &u) });
        let paths: Vec<ArgumentPath> = (0..self.arguments.len()).map(|argument| path(accepted, argument)).collect();
        step_over(&self.arguments, &paths).share
    }

    fn values(&self, t: f64, q: &impl Positions, v: &DVector<f64>, u: &[f64]) -> Vec<f64> {
        self.functions.iter().map(|function| function.value(t, q, v, u)).collect()
    }
}

/// Path of an argument through some points, with the turns between them.
fn path(points: &[ObservedPoint], argument: usize) -> ArgumentPath {
    let mut path = ArgumentPath::at(points[0].values[argument]);
    points[1..].iter().for_each(|point| path.add(point.values[argument]));
    for three in points.windows(3) {
        path.add_turn([0, 1, 2].map(|index| [three[index].t, three[index].values[argument]]));
    }
    path
}
