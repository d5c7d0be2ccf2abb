//! How well equations continue recorded motions.

use super::super::trajectory::Trajectory;
use metafmu_runtime::{Dynamics, StatePoint, dictionary::Dictionary};

/// Model of the accelerations.
#[derive(Clone, Debug)]
pub enum AccelerationModel {
    /// Equations of motion.
    Motion(Box<Dynamics>),
    /// Functions of parameters, inputs, coordinates and rates.
    Functions(Box<Dictionary>),
}

/// Steps of the integration between two rows.
const SUB_STEPS: usize = 4;

/// Stretches of a motion that are continued.
const STRETCHES: usize = 3;

/// Motions that are continued, and rows of a stretch: more cost time and tell little more.
const MOTIONS: usize = 8;
const LONGEST: usize = 100;

/// Root mean square error of coordinates along stretches of the rows from `split` on, in the last part of each motion: relative to the
/// standard deviation of each coordinate. Infinite if a motion cannot be continued.
pub(super) fn error(model: &AccelerationModel, trajectories: &[Trajectory], split: impl Fn(usize) -> usize) -> f64 {
    let stride = trajectories.len().div_ceil(MOTIONS);
    let (mut sum, mut count) = (0.0, 0usize);
    for trajectory in trajectories.iter().step_by(stride) {
        let (rows, n) = (trajectory.rows(), trajectory.coordinates);
        let first = split(rows);
        let length = (rows - first) / 2;
        let scales = deviations(trajectory);
        for stretch in 0..STRETCHES {
            let begin = first + stretch * length / (STRETCHES - 1);
            let mut state: Vec<f64> = [&trajectory.q[begin * n..][..n], &trajectory.v[begin * n..][..n]].concat();
            let mut derivatives = Derivatives::new(model, trajectory);
            for row in begin..(begin + length.min(LONGEST)).min(rows - 1) {
                derivatives.advance(row, &mut state);
                let truth = &trajectory.q[(row + 1) * n..][..n];
                let errors =
                    state.iter().zip(truth).zip(&scales).map(|((found, truth), scale)| (found - truth) / scale);
                sum += errors.map(|error| error * error).sum::<f64>();
                count += n;
            }
        }
    }
    let error = (sum / count.max(1) as f64).sqrt();
    if error.is_finite() { error } else { f64::INFINITY }
}

/// Standard deviation of each coordinate; one of those that do not move.
pub(super) fn deviations(trajectory: &Trajectory) -> Vec<f64> {
    let (rows, n) = (trajectory.rows() as f64, trajectory.coordinates);
    let deviations = (0..n).map(|k| {
        let values = trajectory.q.iter().skip(k).step_by(n);
        let mean = values.clone().sum::<f64>() / rows;
        let deviation = (values.map(|value| (value - mean).powi(2)).sum::<f64>() / rows).sqrt();
        if deviation > 0.0 { deviation } else { 1.0 }
    });
    deviations.collect()
}

/// Accelerations along a motion, and steps of the classical Runge-Kutta method.
struct Derivatives<'a> {
    model: &'a AccelerationModel,
    trajectory: &'a Trajectory,
    scratch: Option<metafmu_runtime::DynamicsScratch>,
    inputs: Vec<f64>,
    columns: Vec<f64>,
}

impl<'a> Derivatives<'a> {
    fn new(model: &'a AccelerationModel, trajectory: &'a Trajectory) -> Self {
        let scratch = match model {
            AccelerationModel::Motion(dynamics) => Some(dynamics.scratch()),
            AccelerationModel::Functions(_) => None,
        };
        Self { model, trajectory, scratch, inputs: vec![0.0; trajectory.inputs()], columns: Vec::new() }
    }

    /// From a row to the next one.
    fn advance(&mut self, row: usize, state: &mut [f64]) {
        let h = self.trajectory.step / SUB_STEPS as f64;
        let width = state.len();
        for step in 0..SUB_STEPS {
            let share = step as f64 / SUB_STEPS as f64;
            let half = 0.5 / SUB_STEPS as f64;
            let stages = [(0.0, 0.0, 1.0), (0.5, half, 2.0), (0.5, half, 2.0), (1.0, 2.0 * half, 1.0)];
            let (mut rates, mut sum, mut at) = (vec![0.0; width], vec![0.0; width], state.to_vec());
            for (reach, later, weight) in stages {
                for (k, at) in at.iter_mut().enumerate() {
                    *at = state[k] + reach * h * rates[k];
                }
                self.rates((row, share + later), &at, &mut rates);
                sum.iter_mut().zip(&rates).for_each(|(sum, rate)| *sum += weight / 6.0 * rate);
            }
            state.iter_mut().zip(&sum).for_each(|(state, sum)| *state += h * sum);
        }
    }

    /// Derivatives of a state, at a share of the time from a row to the next one.
    fn rates(&mut self, (row, share): (usize, f64), state: &[f64], rates: &mut [f64]) {
        let Self { model, trajectory: Trajectory { parameters, u, coordinates, .. }, scratch, inputs, columns } = self;
        let m = inputs.len();
        for (k, input) in inputs.iter_mut().enumerate() {
            *input = u[row * m + k] + share * (u[(row + 1) * m + k] - u[row * m + k]);
        }
        let (q, v) = state.split_at(*coordinates);
        let (velocities, accelerations) = rates.split_at_mut(*coordinates);
        velocities.copy_from_slice(v);
        match (model, scratch) {
            (AccelerationModel::Motion(dynamics), Some(scratch)) => {
                dynamics.accelerations(StatePoint { q, v, u: inputs, p: parameters }, accelerations, scratch);
            }
            (AccelerationModel::Functions(functions), _) => {
                columns.clear();
                [parameters, inputs.as_slice(), q, v].iter().for_each(|part| columns.extend_from_slice(part));
                functions.evaluate(columns, accelerations);
            }
            (AccelerationModel::Motion(_), None) => accelerations.fill(f64::NAN),
        }
    }
}
