//! Least squares of the errors of a state space's simulations.

use super::simulate::{
    Limits, Signals, Simulated, StateShape, errors, overwriting, simulate, simulate_with_sensitivities,
};
use crate::training::Damping;
use nalgebra::{Cholesky, DMatrix, DVector};
use rayon::prelude::*;

/// Damping at the start, for each error: of coefficients, and of the correction by measured outputs.
const DAMPING: f64 = 1e-3;
const GAIN_DAMPING: f64 = 1e-6;
/// Relative decrease of the sum of squares and penalties below which a training ends.
const DECREASE: f64 = 1e-4;
/// Search for the correction by measured outputs: given rows, parts of runs, iterations, difference for slopes, and
/// relative decrease below which it ends.
const GIVEN: usize = 50;
const MOST_PARTS: usize = 30;
const GAIN_ITERATIONS: usize = 10;
const GAIN_STEP: f64 = 1e-6;
const GAIN_DECREASE: f64 = 1e-3;
/// Variances of the states' errors over those of the outputs.
const RATIOS: [f64; 6] = [1e-6, 1e-4, 1e-2, 1.0, 1e2, 1e4];
const KALMAN_ITERATIONS: usize = 300;
/// Number of sums of runs that are computed in parallel: it is fixed, so that their order does not depend on the number
/// of threads.
const PARTS: usize = 16;
/// Errors whose sensitivities are multiplied at once.
const BLOCK: usize = 64;

/// Runs to fit to; rows of some of them count.
pub struct CountedRuns<'a> {
    /// Each with the rows that count, up to the last of them.
    runs: Vec<(&'a Signals, Vec<bool>)>,
}

/// Goal of a training.
pub struct Goal<'a> {
    /// Coefficients from which the distance counts.
    pub center: &'a [f64],
    /// Correction of the states by the errors of outputs that are given, shape `[states, outputs]`.
    pub gain: &'a [f64],
    /// Ranges that simulations do not leave.
    pub limits: &'a Limits,
    /// Penalty of the square of that distance.
    pub penalty: f64,
    /// Rows after which the outputs of a simulation are set to the measured ones; `usize::MAX` for whole simulations.
    pub stretch: usize,
    /// Iterations at most.
    pub iterations: usize,
}

/// Result of a training.
pub struct Minimum {
    /// Coefficients, in the order of [`StateShape::places`].
    pub coefficients: Vec<f64>,
    /// Sum of squares and penalties, for each error.
    pub value: f64,
    /// Number of evaluations with sensitivities.
    pub evaluations: usize,
}

/// Squares of the errors, and the normal equations of their sensitivities.
#[derive(Clone)]
struct NormalEquations {
    squares: f64,
    count: usize,
    /// `J^T e`
    gradient: DVector<f64>,
    /// `J^T J`
    matrix: DMatrix<f64>,
}

impl<'a> CountedRuns<'a> {
    /// Runs to fit to. Rows count if `counts` accepts the number of their run; rows before them are only simulated.
    pub fn new(runs: &'a [Signals], counts: impl Fn(usize) -> bool) -> Self {
        let rows = |signals: &'a Signals| {
            let of_row = signals.runs.iter().enumerate().map(|(row, run)| row >= signals.given && counts(*run));
            let mut rows: Vec<bool> = of_row.collect();
            rows.truncate(rows.iter().rposition(|counts| *counts).map_or(0, |last| last + 1));
            (signals, rows)
        };
        Self { runs: runs.iter().map(rows).filter(|(_, rows)| !rows.is_empty()).collect() }
    }

    /// Number of rows that count.
    pub fn rows(&self) -> usize {
        self.runs.iter().flat_map(|(_, rows)| rows).filter(|counts| **counts).count()
    }

    /// Multiplications of an evaluation with sensitivities.
    pub fn cost(&self, shape: &StateShape) -> f64 {
        shape.cost() * self.runs.iter().map(|(_, rows)| rows.len()).sum::<usize>() as f64
    }

    /// Sum of the squares of the errors of the simulations; infinite if one diverges.
    pub fn squares(&self, shape: &StateShape, model: Simulated) -> f64 {
        let of_run = |(run, rows): &(&Signals, Vec<bool>)| {
            let mut squares = 0.0;
            simulate(shape, model, run, [rows.len(), run.given], |row, states| {
                if rows[row] {
                    let measured = &run.outputs[row * shape.outputs..][..shape.outputs];
                    squares += errors(model.limits, states, measured).map(|error| error * error).sum::<f64>();
                }
            })
            .map_or(f64::INFINITY, |()| squares)
        };
        self.runs.par_iter().map(of_run).collect::<Vec<_>>().into_iter().sum()
    }

    /// Returns true if all simulations stay finite.
    pub fn is_stable(&self, shape: &StateShape, model: Simulated) -> bool {
        let is_stable = |(run, rows): &(&Signals, Vec<bool>)| {
            simulate(shape, model, run, [rows.len(), run.given], |_, _| {}).is_some()
        };
        self.runs.par_iter().all(is_stable)
    }

    /// Standard deviations of the states in simulations; none if one diverges.
    pub fn deviations(&self, shape: &StateShape, coefficients: &[f64], limits: &Limits) -> Option<Vec<f64>> {
        let model = Simulated { coefficients, gain: &overwriting(shape), limits };
        let (mut sums, mut squares, mut count) = (vec![0.0; shape.states], vec![0.0; shape.states], 0.0);
        for (run, rows) in &self.runs {
            simulate(shape, model, run, [rows.len(), run.given], |_, states| {
                count += 1.0;
                for ((state, sum), square) in states.iter().zip(&mut sums).zip(&mut squares) {
                    *sum += state;
                    *square += state * state;
                }
            })?;
        }
        Some(
            sums.iter()
                .zip(&squares)
                .map(|(sum, square)| (square / count - (sum / count).powi(2)).max(0.0).sqrt())
                .collect(),
        )
    }

    /// Ranges of the states in simulations; none if one diverges.
    pub fn ranges(&self, shape: &StateShape, model: Simulated) -> Option<Vec<[f64; 2]>> {
        let mut ranges = vec![[f64::INFINITY, f64::NEG_INFINITY]; shape.states];
        for (run, rows) in &self.runs {
            simulate(shape, model, run, [rows.len(), run.given], |_, states| {
                for ([low, high], state) in ranges.iter_mut().zip(states) {
                    (*low, *high) = (low.min(*state), high.max(*state));
                }
            })?;
        }
        Some(ranges)
    }

    fn sums(&self, shape: &StateShape, coefficients: &[f64], goal: &Goal) -> Option<NormalEquations> {
        let parts: Option<Vec<NormalEquations>> = self
            .runs
            .par_chunks(self.runs.len().div_ceil(PARTS).max(1))
            .map(|runs| {
                let mut sums = NormalEquations::new(shape.coefficients());
                runs.iter().try_for_each(|run| sums.add(shape, coefficients, run, goal))?;
                Some(sums)
            })
            .collect();
        parts?.into_iter().reduce(|mut all, part| {
            all.squares += part.squares;
            all.count += part.count;
            all.gradient += part.gradient;
            all.matrix += part.matrix;
            all
        })
    }

    /// Correction with the smallest errors of simulations whose first rows are given. The method of Levenberg and
    /// Marquardt finds it, with differences for slopes. It begins with the best of the known correction, the one that
    /// sets outputs to measured values, and Kalman filters of the linear part.
    pub fn gain(&self, shape: &StateShape, model: Simulated) -> Vec<f64> {
        let parts = self.parts();
        let Simulated { coefficients, gain: known, limits } = model;
        let errors = |gain: &[f64]| {
            let mut found = Vec::new();
            for part in &parts {
                simulate(shape, Simulated { gain, ..model }, part, [part.rows(), part.given], |row, states| {
                    if row > part.given {
                        found.extend(errors(limits, states, &part.outputs[row * shape.outputs..][..shape.outputs]));
                    }
                })?;
            }
            Some(DVector::from_vec(found))
        };
        let filters = RATIOS.into_iter().filter_map(|ratio| kalman(shape, coefficients, ratio));
        let starts = [known.to_vec(), overwriting(shape)].into_iter().chain(filters);
        let tried = starts.filter_map(|start| Some((errors(&start)?, start)));
        let best = tried.min_by(|(a, _), (b, _)| a.norm_squared().total_cmp(&b.norm_squared()));
        let Some((mut found, start)) = best else { return known.to_vec() };
        let mut gain = DVector::from_vec(start);
        let mut damping = Damping::new(GAIN_DAMPING * found.len() as f64);
        for _ in 0..GAIN_ITERATIONS {
            let slope = |place: usize| {
                let mut moved = gain.clone();
                moved[place] += GAIN_STEP;
                Some((errors(moved.as_slice())? - &found) / GAIN_STEP)
            };
            let Some(slopes) = (0..gain.len()).map(slope).collect::<Option<Vec<_>>>() else { break };
            let jacobian = DMatrix::from_columns(&slopes);
            let (matrix, gradient) = (jacobian.tr_mul(&jacobian), jacobian.tr_mul(&found));
            let next = damping.step(&matrix, &gradient, |change| {
                let candidate = &gain - change;
                let more = errors(candidate.as_slice()).filter(|more| more.norm_squared() < found.norm_squared())?;
                Some((candidate, more))
            });
            let Some((candidate, more)) = next else { break };
            let gained = found.norm_squared() - more.norm_squared();
            (gain, found) = (candidate, more);
            if gained < GAIN_DECREASE * found.norm_squared() {
                break;
            }
        }
        gain.as_slice().to_vec()
    }

    /// Parts of the runs, as many rows given as simulated.
    fn parts(&self) -> Vec<Signals> {
        let starts = self.runs.iter().flat_map(|(run, rows)| {
            let length = rows.len().min(2 * GIVEN);
            (0..=rows.len() - length).step_by(GIVEN).map(move |start| (*run, start, length))
        });
        let starts: Vec<_> = starts.collect();
        let apart = starts.len().div_ceil(MOST_PARTS).max(1);
        starts.into_iter().step_by(apart).map(|(run, start, length)| run.part(start, length)).collect()
    }

    /// Coefficients on the way from a start to a goal; the start if its simulations diverge.
    pub fn fit(
        &self,
        shape: &StateShape,
        start: &[f64],
        goal: &Goal,
        is_stopped: &(dyn Fn() -> bool + Sync),
    ) -> Minimum {
        let center = DVector::from_column_slice(goal.center);
        let mut coefficients = DVector::from_column_slice(start);
        let mut evaluations = 1;
        let Some(mut sums) = self.sums(shape, start, goal) else {
            return Minimum { coefficients: start.to_vec(), value: f64::INFINITY, evaluations };
        };
        let count = sums.count.max(1) as f64;
        let weight = goal.penalty;
        let value_of =
            |sums: &NormalEquations, at: &DVector<f64>| sums.squares + weight * (at - &center).norm_squared();
        let mut value = value_of(&sums, &coefficients);
        let mut damping = Damping::new(DAMPING * count);
        for _ in 0..goal.iterations {
            if is_stopped() {
                break;
            }
            let gradient = &sums.gradient + (&coefficients - &center) * weight;
            let mut matrix = sums.matrix.clone();
            (0..matrix.nrows()).for_each(|place| matrix[(place, place)] += weight);
            let next = damping.step(&matrix, &gradient, |change| {
                let candidate = &coefficients - change;
                evaluations += 1;
                let found = self.sums(shape, candidate.as_slice(), goal);
                found.filter(|sums| value_of(sums, &candidate) < value).map(|sums| (candidate, sums))
            });
            let Some((candidate, more)) = next else { break };
            let before = value;
            value = value_of(&more, &candidate);
            (coefficients, sums) = (candidate, more);
            if before - value < DECREASE * before {
                break;
            }
        }
        Minimum { coefficients: coefficients.as_slice().to_vec(), value: value / count, evaluations }
    }
}

impl NormalEquations {
    fn new(count: usize) -> Self {
        Self { squares: 0.0, count: 0, gradient: DVector::zeros(count), matrix: DMatrix::zeros(count, count) }
    }

    /// Adds the errors of a run; none if its simulation diverges.
    fn add(
        &mut self,
        shape: &StateShape,
        coefficients: &[f64],
        (run, rows): &(&Signals, Vec<bool>),
        goal: &Goal,
    ) -> Option<()> {
        let (outputs, count) = (shape.outputs, coefficients.len());
        let mut block = DMatrix::zeros(count, BLOCK);
        let mut errors = DVector::zeros(BLOCK);
        let mut filled = 0;
        let model = Simulated { coefficients, gain: goal.gain, limits: goal.limits };
        simulate_with_sensitivities(shape, model, (run, rows.len()), goal.stretch, |row, states, sensitivities| {
            if !rows[row] {
                return;
            }
            for output in 0..outputs {
                let seen = goal.limits.measured(output, states[output]);
                let error = seen - run.outputs[row * outputs + output];
                self.squares += error * error;
                self.count += 1;
                errors[filled] = error;
                if seen == states[output] {
                    block.column_mut(filled).copy_from_slice(&sensitivities[output * count..][..count]);
                } else {
                    block.column_mut(filled).fill(0.0);
                }
                filled += 1;
                if filled == BLOCK {
                    self.gradient.gemv(1.0, &block, &errors, 1.0);
                    self.matrix.gemm(1.0, &block, &block.transpose(), 1.0);
                    filled = 0;
                }
            }
        })?;
        if filled > 0 {
            let (block, errors) = (block.columns(0, filled), errors.rows(0, filled));
            self.gradient.gemv(1.0, &block, &errors, 1.0);
            self.matrix.gemm(1.0, &block, &block.transpose(), 1.0);
        }
        Some(())
    }
}

/// Gain of the Kalman filter of the linear part (Kalman (1960)): `K = P C' (C P C' + I)^-1`. `P` is the variance of the
/// states after many samples, each of which adds a variance of `ratio` to each state.
fn kalman(shape: &StateShape, coefficients: &[f64], ratio: f64) -> Option<Vec<f64>> {
    let StateShape { states, outputs, columns, .. } = *shape;
    let linear = &coefficients[shape.places()[0].clone()];
    let a = DMatrix::from_fn(states, states, |row, column| {
        f64::from(u8::from(row == column)) + linear[row * columns + column]
    });
    let mut variance = DMatrix::identity(states, states);
    let mut gain = DMatrix::zeros(states, outputs);
    for _ in 0..KALMAN_ITERATIONS {
        variance = &a * variance * a.transpose() + DMatrix::identity(states, states) * ratio;
        let seen = variance.view((0, 0), (outputs, outputs)) + DMatrix::identity(outputs, outputs);
        gain = variance.columns(0, outputs) * Cholesky::new(seen)?.inverse();
        variance -= &gain * variance.rows(0, outputs);
    }
    // row by row
    Some(gain.transpose().as_slice().to_vec())
}

#[cfg(test)]
mod tests {
    use super::{
        super::{
            features::Features,
            simulate::tests::{example, limits},
        },
        *,
    };

    #[test]
    fn a_state_space_is_found_again_from_its_outputs() {
        let (shape, coefficients, mut run) = example(Features::Nodes(4));
        run.given = 1;
        let (gain, limits) = (overwriting(&shape), limits(&shape));
        let (start, rows) = (run.outputs[..2].to_vec(), run.rows());
        let signals = |from: usize| {
            let inputs: Vec<f64> = (0..2 * rows).map(|index| (0.7 * (index + from) as f64).sin()).collect();
            let outputs = [start.clone(), vec![0.0; 2 * rows - 2]].concat();
            let mut run = Signals { outputs, inputs, given: 1, runs: vec![from; rows] };
            let mut outputs = Vec::new();
            let model = Simulated { coefficients: &coefficients, gain: &gain, limits: &limits };
            simulate(&shape, model, &run, [rows, 1], |_, states| outputs.extend_from_slice(&states[..2])).unwrap();
            run.outputs = outputs;
            run
        };
        let runs: Vec<Signals> = (0..9).map(|from| signals(31 * from)).collect();
        let [training, unseen] = [false, true].map(|is_last| CountedRuns::new(&runs, |run| (run == 8 * 31) == is_last));
        let moved: Vec<f64> =
            coefficients.iter().enumerate().map(|(i, of)| of + 0.05 * (2.1 * i as f64).cos()).collect();
        let mut found = Minimum { coefficients: moved.clone(), value: 0.0, evaluations: 0 };
        for stretch in [4, 32, usize::MAX] {
            let goal = Goal { center: &moved, gain: &gain, limits: &limits, penalty: 1e-10, stretch, iterations: 40 };
            found = training.fit(&shape, &found.coefficients, &goal, &|| false);
        }
        let squares = |coefficients| unseen.squares(&shape, Simulated { coefficients, gain: &gain, limits: &limits });
        let errors = [&moved, &found.coefficients].map(|coefficients| squares(coefficients).sqrt());
        assert!(errors[1] < 1e-3 * errors[0], "{errors:?}");
    }

    /// `y' = 0.9 y + h + u`, `h' = 0.8 h + 0.5 u` with noise on the outputs that are measured.
    #[test]
    fn states_are_found_from_noisy_outputs_that_are_given() {
        let shape = StateShape { states: 2, outputs: 1, columns: 3, features: Features::Nodes(0), common_start: None };
        let coefficients = [[-0.1, 1.0, 1.0].as_slice(), &[0.0, -0.2, 0.5], &[0.0; 4]].concat();
        let rows = 400;
        let inputs: Vec<f64> = (0..rows).map(|row| (0.3 * row as f64).sin()).collect();
        let quiet = Signals { outputs: vec![0.0; rows], inputs: inputs.clone(), given: 1, runs: vec![0; rows] };
        let mut outputs = Vec::new();
        let limits = limits(&shape);
        let model = Simulated { coefficients: &coefficients, gain: &[0.0; 2], limits: &limits };
        simulate(&shape, model, &quiet, [rows, 1], |_, states| outputs.push(states[0])).unwrap();
        let noise = |row: usize| 0.3 * (7.7 * (row * row) as f64).sin();
        outputs.iter_mut().enumerate().for_each(|(row, value)| *value += noise(row));
        let noisy = [Signals { outputs, ..quiet }];
        let data = CountedRuns::new(&noisy, |_| true);
        let parts = data.parts();
        let unseen = CountedRuns::new(&parts, |_| true);
        let overwriting = overwriting(&shape);
        let gain = data.gain(&shape, Simulated { gain: &overwriting, ..model });
        let [before, after] = [&overwriting, &gain].map(|gain| unseen.squares(&shape, Simulated { gain, ..model }));
        // errors of the right states
        let starts = (0..=rows - 2 * GIVEN).step_by(GIVEN);
        let least: f64 = starts.flat_map(|start| start + GIVEN..start + 2 * GIVEN).map(|row| noise(row).powi(2)).sum();
        assert!(after - least < 0.3 * (before - least), "{after} {before} {least} {gain:?}");
    }
}
