//! Errors of learned accelerations and forces along motions that begin at corners of the domain, where random states hardly ever are.

use super::corners::IntegrationTrial;
use crate::{
    dataset::Run,
    dynamics::{Equations, EquationsWithParameters, ExactMotion},
    evaluation::RollOut,
    kinds::record::{CornerError, CornerRecord},
    worst::worst,
};
use metafmu_runtime::{Domain, Evaluator, Output, Rows, Shown, Surrogate};
use rayon::prelude::*;

/// States that are compared in all runs together, at most.
const STATES: usize = 40_000;

/// Largest change of a coordinate from one state that is compared to the next, in its unit: errors oscillate with the coordinates, and
/// their peaks are narrow.
const SPACING: f64 = 0.1;

/// Rows outside of the domain after which a run is given up: no state is compared there, but the motion may take long to compute.
const MOST_ROWS_OUTSIDE: usize = 50;

/// States between two rows, at most.
const MOST_BETWEEN_ROWS: usize = 8;

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

/// Largest errors along a run.
struct RunErrors {
    /// Largest error of an acceleration, relative to its standard deviation.
    accelerations: f64,
    /// Largest error of a force that an output shows, relative to the range of the output in training or in this run, whichever is larger;
    /// none if no output is such a force.
    forces: Option<f64>,
}

/// Errors of a force along a run.
struct ForceError {
    /// The output that shows it.
    output: usize,
    /// Its position among the forces of the mechanism.
    reaction: usize,
    /// Largest error.
    error: f64,
    /// Smallest and largest exact value.
    range: [f64; 2],
}

impl LearnedMotion<'_> {
    /// Largest errors along these runs, wherever they are in the domain; none if no run has a state there.
    pub(super) fn largest_errors(&self, trials: &[IntegrationTrial]) -> Option<CornerRecord> {
        let (evaluator, domain) = (Evaluator::new(self.surrogate), Domain::of(self.surrogate));
        let most = STATES.div_ceil(trials.len().max(1));
        let errors = trials.par_iter().map(|trial| {
            let points = self.points(&trial.run, &evaluator, &domain);
            self.errors_along(&trial.run, &points, most, evaluator.clone()).map(|errors| (trial, errors))
        });
        let errors: Vec<Option<(&IntegrationTrial, RunErrors)>> = errors.collect();
        let errors: Vec<(&IntegrationTrial, RunErrors)> = errors.into_iter().flatten().collect();
        Some(CornerRecord {
            runs: errors.len(),
            accelerations: largest(errors.iter().map(|(trial, errors)| (*trial, errors.accelerations)))?,
            forces: largest(errors.iter().filter_map(|(trial, errors)| Some((*trial, errors.forces?)))),
        })
    }

    /// States of a run, and states between two of them, that are in the domain: points of parameters, initial values, inputs and states.
    fn points(&self, run: &Run, evaluator: &Evaluator, domain: &Domain) -> Rows {
        let mut roll_out = RollOut::along(self.surrogate, evaluator, run);
        let (units, first_state) = (self.equations.units(), self.surrogate.inputs().len());
        let (mut points, mut before, mut outside) = (Rows::default(), Vec::new(), 0);
        for row in 0..run.times.len() {
            let Some((point, _)) = roll_out.at(row) else { break };
            if row == 0 {
                before = point.to_vec();
            }
            let inside = points.len();
            let parts = parts(&before[first_state..], &point[first_state..], &units);
            for part in 1..=parts {
                let share = part as f64 / parts as f64;
                let between = before.iter().zip(point).map(|(before, after)| before + share * (after - before));
                let between: Vec<f64> = between.collect();
                // states are compared one by one, so the motion may leave the domain and come back
                if (first_state..between.len()).all(|column| domain.contains(column, between[column])) {
                    points.push(&between);
                }
            }
            before = point.to_vec();
            outside = if points.len() > inside { 0 } else { outside + 1 };
            if outside > MOST_ROWS_OUTSIDE {
                break;
            }
        }
        points
    }

    /// Accelerations and forces of the mechanism at a point of the surrogate; none where it cannot be put together.
    fn exact(&self, equations: &EquationsWithParameters, point: &[f64]) -> Option<ExactMotion> {
        let (before, states) = point.split_at(self.surrogate.inputs().len());
        let (coordinates, rest) = states.split_at(self.deviations.len());
        let (velocities, actuator_states) = rest.split_at(self.deviations.len());
        let inputs = [&before[self.parameters + states.len()..], actuator_states].concat();
        equations.motion(coordinates, velocities, &inputs).ok()
    }

    /// Largest errors at some points of a run, `most` of them at most; none if the mechanism can be put together at none of them.
    fn errors_along(&self, run: &Run, points: &Rows, most: usize, mut evaluator: Evaluator) -> Option<RunErrors> {
        let equations = self.equations.with(&run.parameters[..self.parameters]).ok()?;
        let (mut accelerations, mut forces) = (Vec::new(), self.force_errors());
        let mut results = vec![0.0; evaluator.results()];
        for point in points.iter().step_by(points.len().div_ceil(most).max(1)) {
            let Some(exact) = self.exact(&equations, point) else { continue };
            evaluator.evaluate(point, &mut results);
            let rates = &results[self.surrogate.outputs().len()..];
            // the rates of velocities follow those of coordinates
            let learned = &rates[self.deviations.len()..];
            let of_state = learned.iter().zip(&exact.accelerations).zip(self.deviations);
            accelerations
                .push(worst(of_state.map(|((learned, exact), deviation)| (learned - exact).abs() / deviation)));
            forces.iter_mut().for_each(|force| force.add(results[force.output], exact.reactions[force.reaction]));
        }
        let relative: Vec<f64> =
            forces.iter().map(|force| force.relative(&self.surrogate.outputs()[force.output])).collect();
        (!accelerations.is_empty()).then(|| RunErrors {
            accelerations: worst(accelerations.into_iter()),
            forces: (!relative.is_empty()).then(|| worst(relative.into_iter())),
        })
    }

    /// The forces that outputs show, without an error yet.
    fn force_errors(&self) -> Vec<ForceError> {
        let mut forces = Vec::new();
        for (output, shown) in self.equations.shown().iter().enumerate() {
            if let Shown::Reaction(reaction) = *shown {
                let range = [f64::INFINITY, f64::NEG_INFINITY];
                forces.push(ForceError { output, reaction, error: 0.0, range });
            }
        }
        forces
    }
}

impl ForceError {
    fn add(&mut self, learned: f64, exact: f64) {
        self.error = worst([self.error, (learned - exact).abs()].into_iter());
        self.range = [self.range[0].min(exact), self.range[1].max(exact)];
    }

    /// The error relative to the range of the output in training or in the run.
    fn relative(&self, output: &Output) -> f64 {
        let [low, high] = self.range;
        let range = (output.max - output.min).max(high - low);
        if self.error == 0.0 { 0.0 } else { self.error / range }
    }
}

/// Number of parts in which the way between two states is compared.
fn parts(before: &[f64], after: &[f64], units: &[f64]) -> usize {
    let changes = before.iter().zip(after).zip(units);
    let spacings = changes.map(|((before, after), unit)| (after - before).abs() / (SPACING * unit));
    (spacings.fold(1.0, f64::max).ceil() as usize).min(MOST_BETWEEN_ROWS + 1)
}

/// The largest error, and its run.
fn largest<'t>(errors: impl Iterator<Item = (&'t IntegrationTrial, f64)>) -> Option<CornerError> {
    // NaN is the largest in a total order
    let (trial, error) = errors.max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))?;
    Some(CornerError { error: error.min(f64::MAX), run: trial.name.clone() })
}
