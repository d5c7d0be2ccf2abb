//! Errors of learned accelerations and forces along motions that begin at corners of the domain, where random states hardly ever are.

use crate::{
    dataset::Run,
    dynamics::{Equations, EquationsWithParameters, ExactMotion},
    evaluation::RollOut,
    pipeline::{
        corners::IntegrationTrial,
        record::{CornerError, CornerRecord},
    },
    worst::worst,
};
use metafmu_runtime::{Domain, Evaluator, Output, Shown, Surrogate};
use rayon::prelude::*;

/// States of a run that are compared, at most.
const STATES_OF_RUN: usize = 4000;

/// Number of states that are compared for each row of a run: errors oscillate with the coordinates, and their peaks are narrow.
const STATES_OF_ROW: usize = 8;

/// Accelerations and forces that a surrogate has learned, and those of the mechanism.
pub(super) struct LearnedMotion<'a> {
    pub surrogate: &'a Surrogate,
    /// Equations of the mechanism.
    pub equations: &'a Equations<'a>,
    /// Standard deviation of each acceleration over random states.
    pub deviations: &'a [f64],
    /// Number of parameters, which are the first columns of a point.
    pub parameters: usize,
}

/// A state of a run, and what the surrogate computes there.
struct ComparedState {
    /// Parameters, initial values, inputs, states.
    point: Vec<f64>,
    /// Outputs and the states' derivatives.
    results: Vec<f64>,
}

/// Largest errors along a run.
struct RunErrors {
    /// Largest error of an acceleration, relative to its standard deviation.
    accelerations: f64,
    /// Largest error of a force that an output shows, relative to the range of the output in training or in this run, whichever is larger.
    forces: f64,
}

/// Errors of a force along a run.
struct ForceError<'a> {
    output: &'a Output,
    error: f64,
    /// Smallest and largest exact value.
    range: [f64; 2],
}

impl LearnedMotion<'_> {
    /// Largest errors along these runs, wherever they are in the domain; none if no run has a state there.
    pub(super) fn largest_errors(&self, trials: &[IntegrationTrial]) -> Option<CornerRecord> {
        let (evaluator, domain) = (Evaluator::new(self.surrogate), Domain::of(self.surrogate));
        let errors = trials.par_iter().map(|trial| {
            let run = with_states_between(&trial.run);
            let states = self.states(RollOut::along(self.surrogate, &evaluator, &run), run.times.len(), &domain);
            let equations = self.equations.with(&run.parameters[..self.parameters]).ok()?;
            self.errors(&equations, &states).map(|errors| (trial, errors))
        });
        let errors: Vec<Option<(&IntegrationTrial, RunErrors)>> = errors.collect();
        let errors: Vec<(&IntegrationTrial, RunErrors)> = errors.into_iter().flatten().collect();
        let has_forces = self.equations.shown().iter().any(|shown| matches!(shown, Shown::Reaction(_)));
        let of_forces = || largest(errors.iter().map(|(trial, errors)| (*trial, errors.forces)));
        Some(CornerRecord {
            runs: errors.len(),
            accelerations: largest(errors.iter().map(|(trial, errors)| (*trial, errors.accelerations)))?,
            forces: if has_forces { of_forces() } else { None },
        })
    }

    /// States of a run that are in the domain.
    fn states(&self, mut roll_out: RollOut, rows: usize, domain: &Domain) -> Vec<ComparedState> {
        let first_state = self.surrogate.inputs().len();
        let mut states = Vec::new();
        for row in 0..rows {
            let Some((point, results)) = roll_out.at(row) else { break };
            // states are compared one by one, so the motion may leave the domain and come back
            if (first_state..point.len()).all(|column| domain.contains(column, point[column])) {
                states.push(ComparedState { point: point.to_vec(), results: results.to_vec() });
            }
        }
        states
    }

    /// Accelerations and forces of the mechanism at a point of the surrogate; none where it cannot be put together.
    fn exact(&self, equations: &EquationsWithParameters, point: &[f64]) -> Option<ExactMotion> {
        let (before, states) = point.split_at(self.surrogate.inputs().len());
        let (coordinates, rest) = states.split_at(self.deviations.len());
        let (velocities, actuator_states) = rest.split_at(self.deviations.len());
        let inputs = [&before[self.parameters + states.len()..], actuator_states].concat();
        equations.motion(coordinates, velocities, &inputs).ok()
    }

    /// Largest errors in states of a run; none if the mechanism can be put together in none of them.
    fn errors(&self, equations: &EquationsWithParameters, states: &[ComparedState]) -> Option<RunErrors> {
        let stride = states.len().div_ceil(STATES_OF_RUN).max(1);
        let (mut accelerations, mut forces) = (Vec::new(), self.force_errors());
        for ComparedState { point, results } in states.iter().step_by(stride) {
            let Some(exact) = self.exact(equations, point) else { continue };
            let rates = &results[self.surrogate.outputs().len()..];
            // the rates of velocities follow those of coordinates
            let learned = &rates[self.deviations.len()..];
            let of_state = learned.iter().zip(&exact.accelerations).zip(self.deviations);
            accelerations
                .push(worst(of_state.map(|((learned, exact), deviation)| (learned - exact).abs() / deviation)));
            for ((learned, shown), force) in results.iter().zip(self.equations.shown()).zip(&mut forces) {
                if let Shown::Reaction(reaction) = shown {
                    force.add(*learned, exact.reactions[*reaction]);
                }
            }
        }
        let relative = forces.iter().map(ForceError::relative);
        (!accelerations.is_empty())
            .then(|| RunErrors { accelerations: worst(accelerations.into_iter()), forces: worst(relative) })
    }

    /// No error yet, one of each output; those of outputs that are no forces stay zero.
    fn force_errors(&self) -> Vec<ForceError<'_>> {
        let of_output = |output| ForceError { output, error: 0.0, range: [f64::INFINITY, f64::NEG_INFINITY] };
        self.surrogate.outputs().iter().map(of_output).collect()
    }
}

impl ForceError<'_> {
    fn add(&mut self, learned: f64, exact: f64) {
        self.error = worst([self.error, (learned - exact).abs()].into_iter());
        self.range = [self.range[0].min(exact), self.range[1].max(exact)];
    }

    /// Relative to the range in training or in the run.
    fn relative(&self) -> f64 {
        let [low, high] = self.range;
        let range = (self.output.max - self.output.min).max(high - low);
        if self.error == 0.0 { 0.0 } else { self.error / range }
    }
}

/// A run with more rows.
fn with_states_between(run: &Run) -> Run {
    let width = run.inputs.len() / run.times.len().max(1);
    let (mut times, mut inputs) = (Vec::new(), Vec::new());
    for (row, pair) in run.times.windows(2).enumerate() {
        for part in 0..STATES_OF_ROW {
            let share = part as f64 / STATES_OF_ROW as f64;
            times.push(pair[0] + share * (pair[1] - pair[0]));
            // inputs are constant along runs from corners
            inputs.extend_from_slice(&run.inputs[row * width..][..width]);
        }
    }
    Run { parameters: run.parameters.clone(), times: times.into(), inputs, outputs: Vec::new() }
}

/// The largest error, and its run.
fn largest<'t>(errors: impl Iterator<Item = (&'t IntegrationTrial, f64)>) -> Option<CornerError> {
    // NaN is the largest in a total order
    let (trial, error) = errors.max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))?;
    Some(CornerError { error: error.min(f64::MAX), run: trial.name.clone() })
}
