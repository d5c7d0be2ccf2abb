//! Arguments of forces whose [bends](metafmu_runtime::bends) no part of a run may step over.

use super::{
    constraint::BoundExpression,
    coordinate::Positions,
    model::{MultibodyModel, Sample},
};
use metafmu_runtime::{
    bends::{ArgumentPath, BentArgument, share_of_step},
    formula::Formula,
    switches::{FormulaArgument, bent_arguments, table_arguments},
};
use nalgebra::DVector;
use std::{cell::RefCell, sync::Arc};

/// Arguments with bends of a model's expressions, and their paths in a part of a run.
pub(super) struct Bending<'a> {
    functions: Vec<(&'a BoundExpression, Formula)>,
    arguments: Vec<BentArgument>,
    /// Paths since [`begin`](Self::begin), and where they end.
    paths: RefCell<(Vec<ArgumentPath>, f64)>,
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
                    functions.push((bound, formula));
                    arguments.push(BentArgument { bends: Arc::new(bends), group });
                }
                group += 1;
            }
        }
        Self { functions, arguments, paths: RefCell::default() }
    }

    /// Returns true if no expression bends.
    pub fn is_empty(&self) -> bool {
        self.functions.is_empty()
    }

    /// Begins the paths from a sample to a time.
    pub fn begin(&self, model: &MultibodyModel, from: &Sample, to: f64) {
        let u = model.at(from.t, &from.z);
        let starts = self.values(from.t, &from.q, &from.v, &u).map(ArgumentPath::at).collect();
        // inputs may jump at the end
        self.paths.replace((starts, to - 1e-9 * (to - from.t)));
    }

    /// Adds a state at a time, unless it is at the end or behind it.
    pub fn add(&self, t: f64, q: &impl Positions, v: &DVector<f64>, u: &[f64]) {
        let (paths, end) = &mut *self.paths.borrow_mut();
        if t < *end {
            paths.iter_mut().zip(self.values(t, q, v, u)).for_each(|(path, value)| path.add(value));
        }
    }

    /// Share of the time up to a sample, from 0 to 1, within which nothing is stepped over.
    pub fn share_up_to(&self, model: &MultibodyModel, sample: &Sample) -> f64 {
        let (paths, end) = &mut *self.paths.borrow_mut();
        let u = model.at(*end, &sample.z);
        paths.iter_mut().zip(self.values(*end, &sample.q, &sample.v, &u)).for_each(|(path, value)| path.add(value));
        share_of_step(&self.arguments, paths)
    }

    fn values(&self, t: f64, q: &impl Positions, v: &DVector<f64>, u: &[f64]) -> impl Iterator<Item = f64> {
        let value = move |(bound, formula): &(&BoundExpression, Formula)| {
            formula.value(|column| bound.slots[column].value(t, q, v, u))
        };
        self.functions.iter().map(value)
    }
}
