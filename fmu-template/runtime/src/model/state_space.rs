//! Surrogates with states whose derivatives are any functions of parameters, inputs and states.
//!
//! ```text
//! xd = f(p, u, x)
//! y = g(p, u, x)
//! ```
//!
//! The columns of a point are, in this order, with `n` states
//!
//! | columns | |
//! |---|---|
//! | `p` | parameters |
//! | `n` | states at the start: parameters, too; only the states' values at initialization |
//! | `u` | inputs |
//! | `n` | the states `x` |
//!
//! and the results are the outputs and the derivatives. Each is a state itself, as the derivative of a position is, or one of the
//! functions that were learned: a dictionary, to which a network adds what the dictionary leaves over, or a graph of another tool.

use super::{
    adjoint::ByDirections,
    expect_roles,
    solver::{CommunicationStep, Drive, Integration, Scale, Solver, StepError},
};
use crate::{
    Encoder, Encoding, FormatError, Input, Map, Precision, State,
    map::{
        MapScratch, PreparedMap, Task,
        dictionary::{Dictionary, Factor},
        expect_shape,
        jet::{Jet, Number},
        law::{Law, PreparedLaw},
        tape::TapeWork,
    },
    simd::Simd,
};
use std::{f64::consts::TAU, ops::Range};

/// Derivatives and outputs, and the steps of the solver inside the FMU.
#[derive(Clone, Debug, PartialEq)]
pub struct StateSpace {
    /// Number of parameters, of inputs and of states.
    pub counts: [usize; 3],
    /// From `(p, u, x)` to the functions; an angle is a column of [`Factor::Angle`].
    pub functions: Dictionary,
    /// What is added to the functions: from the same columns, an angle being two of them, its sine and cosine.
    pub map: Option<Map>,
    /// What the outputs are, then what the derivatives are.
    pub results: Vec<Given>,
    /// How the states are integrated.
    pub integration: Integration,
}

/// What an output or a derivative is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Given {
    /// A state.
    State(usize),
    /// One of the functions.
    Function(usize),
}

impl StateSpace {
    /// Columns of the functions: `(p, u, x)`.
    fn width(&self) -> usize {
        self.counts.iter().sum()
    }

    fn columns(&self) -> usize {
        self.width() + self.counts[2]
    }

    /// Whether whole turns of a state change nothing but it.
    pub(super) fn is_angle(&self, state: usize) -> bool {
        self.functions.factors().nth(self.counts[0] + self.counts[1] + state) == Some(Factor::Angle)
    }

    /// Column of the input that gives each state at the start, in order.
    pub(super) fn start_columns(&self) -> Range<usize> {
        let [parameters, _, states] = self.counts;
        parameters..parameters + states
    }

    /// Whether a function depends on inputs; with a map each does.
    ///
    /// # Panics
    /// If there is no such function.
    pub fn is_driven(&self, function: usize) -> bool {
        let [parameters, inputs, _] = self.counts;
        let inputs = parameters..parameters + inputs;
        let mut terms = self.functions.terms().filter(|term| term.coefficients[function] != 0.0);
        !inputs.is_empty()
            && (self.map.is_some() || terms.any(|term| term.exponents[inputs.clone()].iter().any(|e| *e != 0)))
    }

    /// What makes columns of the map.
    fn encoder(&self) -> Encoder {
        let encodings: Vec<Encoding> = self.functions.factors().map(encoding).collect();
        Encoder::new(encodings.iter().map(|encoding| (encoding, 0.0, TAU)))
    }

    /// Makes sure that it fits these inputs, states and so many outputs.
    ///
    /// # Errors
    /// The first [`FormatError`].
    pub(super) fn check(&self, inputs: &[Input], states: &[State], outputs: usize) -> Result<(), FormatError> {
        let count = self.counts[2];
        expect_roles(inputs, states, self.counts)?;
        expect_shape("results.given", &[self.results.len()], &[outputs + count])?;
        expect_shape("functions", &[self.functions.columns()], &[self.width()])?;
        for (index, given) in self.results.iter().enumerate() {
            let (found, limit) = match *given {
                Given::State(state) => (state, count),
                Given::Function(function) => (function, self.functions.outputs()),
            };
            if found >= limit {
                let (found, limit) = (found as u64, limit as u64);
                return Err(FormatError::Index { name: "results.given".into(), index, found, limit });
            }
        }
        match &self.map {
            // the graphs of other tools have columns that are what they are
            Some(Map::Graph(_)) if self.encoder().width() != self.width() => return Err(FormatError::StateSpaceMap),
            Some(map) => map.check(self.encoder().width(), self.functions.outputs())?,
            None => {}
        }
        self.integration.check()
    }
}

fn encoding(factor: Factor) -> Encoding {
    match factor {
        Factor::Angle => Encoding::Periodic,
        Factor::Power { .. } => Encoding::Plain,
    }
}

/// A [`StateSpace`] laid out for fast evaluation.
#[derive(Clone, Debug)]
pub(super) struct PreparedStateSpace {
    space: StateSpace,
    functions: PreparedLaw,
    map: Option<(PreparedMap, Encoder)>,
    simd: Simd,
}

/// Working memory of one evaluation at a time.
#[derive(Clone, Debug)]
pub(super) struct StateSpaceScratch {
    work: Work,
    by_directions: ByDirections,
    solver: Solver,
}

#[derive(Clone, Debug)]
struct Work {
    plain: Functions<f64>,
    series: Functions<Jet>,
    map: Option<MapWork>,
}

/// The functions in one kind of numbers.
#[derive(Clone, Debug)]
struct Functions<T> {
    /// `(p, u, x)`.
    columns: Vec<T>,
    values: Vec<T>,
    functions: TapeWork<T>,
}

/// Columns of the map, their rates along a curve, and what it gives: values, first and second derivatives.
#[derive(Clone, Debug)]
struct MapWork {
    columns: Vec<f64>,
    rates: [Vec<f64>; 2],
    curve: [Vec<f64>; 2],
    results: [Vec<f64>; 3],
    scratch: MapScratch,
}

impl PreparedStateSpace {
    pub(super) fn new(space: &StateSpace, precision: Precision) -> Self {
        let prepared = |map| (PreparedMap::new(map, precision), space.encoder());
        let map = space.map.as_ref().map(prepared);
        let [parameters, ..] = space.counts;
        let functions = Law::from(space.functions.clone()).prepared(0, 0..parameters);
        Self { map, functions, space: space.clone(), simd: Simd::detect() }
    }

    pub(super) fn scratch(&self, scales: &[Scale], ranges: &[[f64; 2]]) -> StateSpaceScratch {
        let Self { space, map, .. } = self;
        let map = map.as_ref().map(|(map, encoder)| MapWork {
            columns: vec![0.0; encoder.width()],
            rates: [vec![0.0; encoder.width()], vec![0.0; encoder.width()]],
            curve: [vec![0.0; space.width()], vec![0.0; space.width()]],
            results: std::array::from_fn(|_| vec![0.0; space.functions.outputs()]),
            scratch: map.scratch(),
        });
        StateSpaceScratch {
            work: Work { plain: self.work(), series: self.work(), map },
            by_directions: ByDirections::new(space.columns(), space.results.len()),
            solver: Solver::new(space.columns(), ranges.to_vec(), scales.to_vec(), Vec::new()),
        }
    }

    fn work<T: Number>(&self) -> Functions<T> {
        Functions {
            columns: vec![T::from(0.0); self.space.width()],
            values: vec![T::from(0.0); self.space.functions.outputs()],
            functions: self.functions.work(),
        }
    }

    /// Another integration of the states.
    pub(super) fn integrate_by(&mut self, integration: Integration) {
        self.space.integration = integration;
    }

    /// Number of states.
    pub(super) fn states(&self) -> usize {
        self.space.counts[2]
    }

    /// See [`StateSpace`].
    pub(super) fn start_columns(&self) -> Range<usize> {
        self.space.start_columns()
    }

    /// Does a task at a point. Does not allocate.
    pub(super) fn perform(&self, point: &[f64], task: Task, scratch: &mut StateSpaceScratch) {
        match task {
            Task::Outputs(results) => {
                self.compute(point, &mut scratch.work);
                let values = &scratch.work.plain.values;
                results
                    .iter_mut()
                    .zip(&self.space.results)
                    .for_each(|(to, given)| *to = self.given(*given, point, values));
            }
            Task::Series { rates, first, second } => {
                self.compute_series(point, rates, &mut scratch.work);
                let values = &scratch.work.series.values;
                let state = |index: usize, order: usize| {
                    let column = self.space.columns() - self.states() + index;
                    rates[order].get(column).copied().unwrap_or(0.0)
                };
                for (to, given) in first.iter_mut().zip(&self.space.results) {
                    *to = match *given {
                        Given::State(index) => state(index, 0),
                        Given::Function(index) => values[index].first,
                    };
                }
                for (to, given) in second.into_iter().flatten().zip(&self.space.results) {
                    *to = match *given {
                        Given::State(index) => state(index, 1),
                        Given::Function(index) => values[index].second,
                    };
                }
            }
            Task::Adjoint { weights, gradient } => {
                let mut by_directions = std::mem::take(&mut scratch.by_directions);
                by_directions.adjoint(weights, gradient, |along, change| {
                    self.perform(point, Task::Series { rates: [along, &[]], first: change, second: None }, scratch);
                });
                scratch.by_directions = by_directions;
            }
        }
    }

    /// Integrates the states at the end of `point`, as [`Solver::advance`] does.
    ///
    /// # Errors
    /// A [`StepError`]; the states are as before.
    pub(super) fn advance(
        &self,
        point: &mut [f64],
        step: CommunicationStep,
        drive: Drive,
        scratch: &mut StateSpaceScratch,
    ) -> Result<u32, StepError> {
        let StateSpaceScratch { work, solver, .. } = scratch;
        let derivatives = &self.space.results[self.space.results.len() - self.states()..];
        solver.advance(point, self.space.integration, step, drive, |point, rates, _| {
            self.compute(point, work);
            let values = &work.plain.values;
            rates.iter_mut().zip(derivatives).for_each(|(to, given)| *to = self.given(*given, point, values));
        })
    }

    fn given(&self, given: Given, point: &[f64], values: &[f64]) -> f64 {
        match given {
            Given::State(index) => point[point.len() - self.states() + index],
            Given::Function(index) => values[index],
        }
    }

    /// The functions at a point.
    fn compute(&self, point: &[f64], Work { plain, map: work, .. }: &mut Work) {
        self.space.without_starts(point, &mut plain.columns);
        let Functions { columns, values, functions } = plain;
        self.functions.compute(columns, values, &mut [], functions);
        if let (Some((map, encoder)), Some(work)) = (&self.map, work) {
            let [more, ..] = &mut work.results;
            encoder.encode(columns, &mut work.columns);
            map.perform(self.simd, &work.columns, Task::Outputs(more), &mut work.scratch);
            values.iter_mut().zip(more).for_each(|(value, more)| *value += *more);
        }
    }

    /// The functions along a curve through a point; of the series' values those of the map are left out.
    fn compute_series(&self, point: &[f64], rates: [&[f64]; 2], Work { plain, series, map: work }: &mut Work) {
        self.space.without_starts(point, &mut plain.columns);
        let Functions { columns, values, functions } = series;
        for (index, column) in columns.iter_mut().enumerate() {
            let place = self.space.place(index);
            let rate = |order: usize| rates[order].get(place).copied().unwrap_or(0.0);
            *column = Jet { value: plain.columns[index], first: rate(0), second: rate(1) };
        }
        self.functions.compute(columns, values, &mut [], functions);
        if let (Some((map, encoder)), Some(work)) = (&self.map, work) {
            let MapWork { columns: encoded, rates: [velocity, change], curve: [first, second], results, scratch } =
                work;
            for (index, column) in columns.iter().enumerate() {
                (first[index], second[index]) = (column.first, column.second);
            }
            encoder.encode(&plain.columns, encoded);
            encoder.along_curve(encoded, [first, second], [velocity, change]);
            let [_, once, twice] = results;
            let task = Task::Series { rates: [velocity, change], first: once, second: Some(twice) };
            map.perform(self.simd, encoded, task, scratch);
            for (index, value) in values.iter_mut().enumerate() {
                value.first += once[index];
                value.second += twice[index];
            }
        }
    }
}

impl StateSpace {
    /// Position in a point of a column of the functions.
    fn place(&self, column: usize) -> usize {
        let [parameters, _, states] = self.counts;
        if column < parameters { column } else { column + states }
    }

    fn without_starts(&self, point: &[f64], columns: &mut [f64]) {
        let starts = self.start_columns();
        columns[..starts.start].copy_from_slice(&point[..starts.start]);
        columns[starts.start..].copy_from_slice(&point[starts.end..]);
    }
}

#[cfg(test)]
mod tests {
    use crate::{CommunicationStep, Drive, Evaluator, Integration, example};

    /// mu, starts, force, states.
    const POINT: [f64; 6] = [1.2, 0.0, 0.0, 0.3, 0.8, -0.5];

    #[test]
    fn results_are_the_equations() {
        for surrogate in [example::oscillator(None), example::oscillator_by_graph()] {
            let evaluator = Evaluator::new(&surrogate);
            let (mut scratch, mut results) = (evaluator.scratch(), [0.0; 3]);
            evaluator.evaluate(&POINT, &mut results, &mut scratch);
            let [mu, _, _, u, x, v] = POINT;
            let expected = [x, v, mu * (1.0 - x * x) * v - x + u];
            assert!(results.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-14), "{results:?} {expected:?}");
        }
    }

    #[test]
    fn derivatives_are_those_of_finite_differences_with_and_without_a_map() {
        let by_network = example::oscillator(Some(example::residual_network()));
        for surrogate in [example::oscillator(None), by_network, example::oscillator_by_graph()] {
            let evaluator = Evaluator::new(&surrogate);
            let mut scratch = evaluator.scratch();
            let (direction, bend) = ([0.4, 1.0, 1.0, -0.7, 0.2, 0.9], [0.1, 0.0, 0.0, 0.3, -0.6, 0.2]);
            let (mut along, mut first, mut second) = ([0.0; 3], [0.0; 3], [0.0; 3]);
            evaluator.directional(&POINT, &direction, &mut along, &mut scratch);
            evaluator.along_curve(&POINT, [&direction, &bend], [&mut first, &mut second], &mut scratch);
            let mut at = |h: f64| {
                let point: [f64; 6] = std::array::from_fn(|k| POINT[k] + h * (direction[k] + 0.5 * h * bend[k]));
                let mut results = [0.0; 3];
                evaluator.evaluate(&point, &mut results, &mut scratch);
                results
            };
            let h = 1e-4;
            let [before, here, after] = [at(-h), at(0.0), at(h)];
            for k in 0..3 {
                let slope = (after[k] - before[k]) / (2.0 * h);
                let bent = (after[k] - 2.0 * here[k] + before[k]) / (h * h);
                assert!((first[k] - slope).abs() < 1e-6 && along[k] == first[k], "{k}: {} {slope}", first[k]);
                assert!((second[k] - bent).abs() < 1e-5, "{k}: {} {bent}", second[k]);
            }
            let (weights, mut gradient) = ([0.5, -1.0, 2.0], [0.0; 6]);
            evaluator.adjoint(&POINT, &weights, &mut gradient, &mut scratch);
            let forwards: f64 = weights.iter().zip(along).map(|(weight, along)| weight * along).sum();
            let backwards: f64 = gradient.iter().zip(direction).map(|(gradient, along)| gradient * along).sum();
            assert!((forwards - backwards).abs() < 1e-13);
        }
    }

    #[test]
    fn both_methods_reach_the_same_state() {
        let none = [0.0; 6];
        let reach = |integration: Integration| {
            let evaluator = Evaluator::new(&example::integrated(&example::oscillator(None), integration));
            let mut point = POINT;
            let drive = Drive { rates: [&none, &none], clamp: None };
            evaluator.advance(&mut point, CommunicationStep::of(1.5), drive, &mut evaluator.scratch()).unwrap();
            point
        };
        let fixed = reach(Integration::Fixed { step: 0.005 });
        let adaptive = reach(Integration::ErrorControlled { tolerance: 1e-12, longest: 1.0 });
        assert!(
            (4..6).all(|k| (fixed[k] - adaptive[k]).abs() < 1e-9 && fixed[k] != POINT[k]),
            "{fixed:?} {adaptive:?}"
        );
    }
}
