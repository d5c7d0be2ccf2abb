//! Error of learned accelerations along motions that begin at corners of the domain, where random states hardly ever are.

use crate::{
    dynamics::Equations,
    evaluation::RollOut,
    pipeline::{corners::IntegrationTrial, record::CornerRecord},
    worst::worst,
};
use metafmu_runtime::{Domain, Evaluator, Surrogate};
use rayon::prelude::*;

/// States of a run at which accelerations are compared, at most: peaks of a network's error are narrow.
const STATES_OF_RUN: usize = 500;

/// Accelerations that a surrogate has learned, and those of the mechanism.
pub(super) struct LearnedAccelerations<'a> {
    pub surrogate: &'a Surrogate,
    /// Equations of the mechanism.
    pub equations: &'a Equations<'a>,
    /// Standard deviation of each acceleration over random states.
    pub deviations: &'a [f64],
    /// Number of parameters, which are the first columns of a point.
    pub parameters: usize,
}

impl LearnedAccelerations<'_> {
    /// Largest error along these runs, as long as they are in the domain; none if no run has a state there.
    pub(super) fn largest_error(&self, trials: &[IntegrationTrial]) -> Option<CornerRecord> {
        let (evaluator, domain) = (Evaluator::new(self.surrogate), Domain::of(self.surrogate));
        let errors = trials.par_iter().map(|trial| {
            let roll_out = RollOut::along(self.surrogate, &evaluator, &trial.run);
            self.largest_error_along(roll_out, trial.run.times.len(), &domain)
        });
        let errors: Vec<Option<f64>> = errors.collect();
        let runs = errors.iter().flatten().count();
        let known = trials.iter().zip(errors).filter_map(|(trial, error)| Some((trial, error?)));
        // NaN is the largest in a total order
        let (trial, error) = known.max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))?;
        Some(CornerRecord { error: error.min(f64::MAX), runs, worst: trial.name.clone() })
    }

    fn largest_error_along(&self, mut roll_out: RollOut, rows: usize, domain: &Domain) -> Option<f64> {
        let first_state = self.surrogate.inputs().len();
        let rates = self.surrogate.outputs().len();
        let n = self.deviations.len();
        let mut states = Vec::new();
        for row in 0..rows {
            let Some((point, results)) = roll_out.at(row) else { break };
            if !(first_state..point.len()).all(|column| domain.contains(column, point[column])) {
                break;
            }
            // the rates of velocities follow those of coordinates
            states.push((self.state(point), results[rates + n..rates + 2 * n].to_vec()));
        }
        let stride = states.len().div_ceil(STATES_OF_RUN).max(1);
        let errors = states.iter().step_by(stride).filter_map(|(state, learned)| self.error(state, learned));
        let errors: Vec<f64> = errors.collect();
        (!errors.is_empty()).then(|| worst(errors.into_iter()))
    }

    /// State `(q, p, v, u)` of the mechanism at a point of the surrogate, which has parameters, initial values, inputs and states.
    fn state(&self, point: &[f64]) -> Vec<f64> {
        let n = self.deviations.len();
        let (before, states) = point.split_at(self.surrogate.inputs().len());
        let inputs = &before[self.parameters + states.len()..];
        [&states[..n], &before[..self.parameters], &states[n..2 * n], inputs, &states[2 * n..]].concat()
    }

    /// Largest error of an acceleration, relative to its standard deviation; none where the mechanism cannot be put together.
    fn error(&self, state: &[f64], learned: &[f64]) -> Option<f64> {
        let exact = self.equations.accelerations_at(state).ok()?;
        let errors = learned.iter().zip(&exact).zip(self.deviations);
        Some(worst(errors.map(|((learned, exact), deviation)| (learned - exact).abs() / deviation)))
    }
}
