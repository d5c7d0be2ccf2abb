//! Simulation of a state space with its sensitivities, and the least squares of its errors.

use super::features::{FeatureValues, Features};
use nalgebra::{Cholesky, DMatrix, DVector};
use rayon::prelude::*;
use std::ops::Range;

/// Damping at the start, for each error; its changes, and the number of them in one iteration.
const DAMPING: f64 = 1e-3;
const DAMPING_DOWN: f64 = 0.2;
const DAMPING_UP: f64 = 4.0;
const TRIES: usize = 10;
/// Relative decrease of the sum of squares and penalties below which a training ends.
const DECREASE: f64 = 1e-4;
/// Rows that are given when the correction by measured outputs is found, and number of parts of runs that it is found from; its iterations, difference
/// for its slopes, and relative decrease below which it is found.
const GIVEN: usize = 50;
const MOST_PARTS: usize = 30;
const GAIN_ITERATIONS: usize = 10;
const GAIN_STEP: f64 = 1e-6;
const GAIN_DECREASE: f64 = 1e-3;
/// Variances of the states' errors over those of the outputs.
const RATIOS: [f64; 6] = [1e-6, 1e-4, 1e-2, 1.0, 1e2, 1e4];
const KALMAN_ITERATIONS: usize = 300;
/// Standardized magnitude from which on a simulation has diverged.
const DIVERGED: f64 = 1e3;
/// Sums of runs that are computed side by side: always the same ones, so that their order does not depend on the number of threads.
const PARTS: usize = 16;
/// Errors whose sensitivities are multiplied at once.
const BLOCK: usize = 64;

/// Sizes of a state space, and the places of its coefficients: `L`, `c`, `G`, `W`, `b`, then the hidden states at the start, matrices row by
/// row. `W` and `b` are those of nodes.
#[derive(Clone, Debug, PartialEq)]
pub struct StateShape {
    /// Number of states, the outputs first.
    pub states: usize,
    pub outputs: usize,
    /// Number of columns: states, inputs, parameters.
    pub columns: usize,
    pub features: Features,
}

impl StateShape {
    pub fn hidden(&self) -> usize {
        self.states - self.outputs
    }

    /// Places of `L`, `c`, `G`, `W`, `b` and the hidden start.
    pub fn places(&self) -> [Range<usize>; 6] {
        let Self { states, columns, .. } = *self;
        let (features, nodes) = (self.features.count(), self.features.nodes());
        let mut end = 0;
        [states * columns, states, states * features, nodes * columns, nodes, self.hidden()].map(|length| {
            end += length;
            end - length..end
        })
    }

    pub fn coefficients(&self) -> usize {
        self.places()[5].end
    }

    /// Multiplications of an evaluation with sensitivities, for each row.
    pub fn cost(&self) -> f64 {
        let (states, outputs, count) = (self.states as f64, self.outputs as f64, self.coefficients() as f64);
        count * (states * states + outputs * count)
    }
}

/// Ends of ranges that simulations do not leave, standardized.
#[derive(Clone, Debug, PartialEq)]
pub struct Limits {
    /// Of the states, where they stop.
    pub states: Vec<[f64; 2]>,
    /// Of what is measured of the outputs, which may be beyond.
    pub measured: Vec<[f64; 2]>,
}

impl Limits {
    /// Of numbers without ends.
    pub const NONE: [f64; 2] = [f64::NEG_INFINITY, f64::INFINITY];

    /// What is measured of an output.
    pub fn measured(&self, output: usize, value: f64) -> f64 {
        within(self.measured[output], value)
    }
}

/// Not [`f64::clamp`], for it needs to keep NaN only.
fn within([low, high]: [f64; 2], value: f64) -> f64 {
    if value < low {
        low
    } else if value > high {
        high
    } else {
        value
    }
}

/// A state space to simulate.
#[derive(Clone, Copy)]
pub struct Simulated<'a> {
    pub coefficients: &'a [f64],
    /// Correction of the states by the errors of outputs that are given, shape `[states, outputs]`.
    pub gain: &'a [f64],
    pub limits: &'a Limits,
}

/// A run, standardized, or several that follow each other.
#[derive(Clone)]
pub struct Signals {
    /// Shape `[rows, outputs]`.
    pub outputs: Vec<f64>,
    /// Inputs and parameters, shape `[rows, columns - states]`.
    pub inputs: Vec<f64>,
    /// Number of rows that are given: outputs of the simulation are what was measured.
    pub given: usize,
    /// Number of the run of each row.
    pub runs: Vec<usize>,
}

impl Signals {
    pub fn rows(&self) -> usize {
        self.runs.len()
    }

    /// Its first rows.
    pub fn cut(&self, rows: usize) -> Self {
        let given = self.given.min(rows);
        Self { given, ..self.part(0, rows.min(self.rows())) }
    }

    /// So many rows, the first half of them given.
    fn part(&self, start: usize, rows: usize) -> Self {
        let [outputs, inputs] = [&self.outputs, &self.inputs].map(|of| {
            let width = of.len() / self.rows().max(1);
            of[start * width..(start + rows) * width].to_vec()
        });
        Self { outputs, inputs, given: rows / 2, runs: self.runs[start..start + rows].to_vec() }
    }

    /// Whether another run begins with the last rows of this one: those that are given there, and one more.
    pub fn is_followed_by(&self, next: &Self) -> bool {
        let shared = next.given + 1;
        let is_same = |one: &[f64], next: &[f64], width: usize| {
            one.len() >= shared * width && next.len() >= shared * width && one.ends_with(&next[..shared * width])
        };
        let [outputs, inputs] = [&next.outputs, &next.inputs].map(|of| of.len() / next.rows().max(1));
        // a single row that is given may be the first of a run from rest
        next.given > 1 && is_same(&self.outputs, &next.outputs, outputs) && is_same(&self.inputs, &next.inputs, inputs)
    }

    /// Adds what comes after the shared rows of a run that follows.
    pub fn extend(&mut self, next: &Self) {
        let shared = next.given + 1;
        let [outputs, inputs] = [&next.outputs, &next.inputs].map(|of| shared * (of.len() / next.rows().max(1)));
        self.outputs.extend_from_slice(&next.outputs[outputs..]);
        self.inputs.extend_from_slice(&next.inputs[inputs..]);
        self.runs.extend_from_slice(&next.runs[shared..]);
    }
}

/// Runs to fit to; rows of some of them count.
pub struct CountedRuns<'a> {
    /// Each with the rows that count, up to the last of them.
    runs: Vec<(&'a Signals, Vec<bool>)>,
}

/// What a training looks for.
pub struct Goal<'a> {
    /// Coefficients from which the distance counts.
    pub center: &'a [f64],
    /// Correction of the states by the errors of outputs that are given, shape `[states, outputs]`.
    pub gain: &'a [f64],
    pub limits: &'a Limits,
    /// Penalty of the square of that distance.
    pub penalty: f64,
    /// Rows after which the outputs of a simulation are made what was measured; `usize::MAX` of whole simulations.
    pub stretch: usize,
    /// Iterations at most.
    pub iterations: usize,
}

/// Result of a training.
pub struct Minimum {
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
    /// Rows of the runs with some numbers count; what is before them is simulated.
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

    /// Whether all simulations stay finite.
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

    /// The correction after which simulations have the smallest errors, if so many rows are given first: by the method of Levenberg and Marquardt, with
    /// differences for slopes. It begins with the best of a known one, that which makes outputs what is measured, and Kalman filters of the
    /// linear part.
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
        let mut damping = 1e-6 * found.len() as f64;
        for _ in 0..GAIN_ITERATIONS {
            let slope = |place: usize| {
                let mut moved = gain.clone();
                moved[place] += GAIN_STEP;
                Some((errors(moved.as_slice())? - &found) / GAIN_STEP)
            };
            let Some(slopes) = (0..gain.len()).map(slope).collect::<Option<Vec<_>>>() else { break };
            let jacobian = DMatrix::from_columns(&slopes);
            let (matrix, gradient) = (jacobian.tr_mul(&jacobian), jacobian.tr_mul(&found));
            let next = (0..TRIES).find_map(|_| {
                let mut damped = matrix.clone();
                (0..damped.nrows()).for_each(|place| damped[(place, place)] += damping);
                let candidate = &gain - Cholesky::new(damped)?.solve(&gradient);
                let better = errors(candidate.as_slice()).filter(|more| more.norm_squared() < found.norm_squared());
                damping *= if better.is_some() { DAMPING_DOWN } else { DAMPING_UP };
                better.map(|more| (candidate, more))
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
        let mut damping = DAMPING * count;
        for _ in 0..goal.iterations {
            if is_stopped() {
                break;
            }
            let gradient = &sums.gradient + (&coefficients - &center) * weight;
            let next = (0..TRIES).find_map(|_| {
                let mut matrix = sums.matrix.clone();
                (0..matrix.nrows()).for_each(|place| matrix[(place, place)] += weight + damping);
                let candidate = &coefficients - Cholesky::new(matrix)?.solve(&gradient);
                evaluations += 1;
                let found = self.sums(shape, candidate.as_slice(), goal);
                let better = found.filter(|sums| value_of(sums, &candidate) < value);
                if better.is_none() {
                    damping *= DAMPING_UP;
                }
                better.map(|sums| (candidate, sums))
            });
            let Some((candidate, more)) = next else { break };
            let before = value;
            value = value_of(&more, &candidate);
            (coefficients, sums) = (candidate, more);
            damping = (damping * DAMPING_DOWN).max(1e-12 * count);
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
        simulate_with_sensitivities(shape, coefficients, (run, rows.len()), goal, |row, states, sensitivities| {
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

/// The correction that makes outputs what is given.
pub fn overwriting(shape: &StateShape) -> Vec<f64> {
    let outputs = shape.outputs;
    let element = |place: usize| f64::from(u8::from(place / outputs == place % outputs));
    (0..shape.states * outputs).map(element).collect()
}

/// The gain of the Kalman filter of the linear part, `K = P C' (C P C' + I)^-1` with the variance `P` of the states after many samples (Kalman
/// (1960)), where each sample adds a variance of `ratio` to each state.
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

/// Calls back with the states at each of the first rows of a run, before those that are given correct them; none if they diverge.
fn simulate(
    shape: &StateShape,
    Simulated { coefficients, gain, limits }: Simulated,
    run: &Signals,
    [rows, given]: [usize; 2],
    mut visit: impl FnMut(usize, &[f64]),
) -> Option<()> {
    let StateShape { states, outputs, columns, ref features } = *shape;
    let [linear, constant, last, first, bias, hidden] = shape.places().map(|place| &coefficients[place]);
    let mut active = FeatureValues::new(features, states);
    let count = active.values.len();
    let (mut z, mut next) = (vec![0.0; columns], vec![0.0; states]);
    z[outputs..states].copy_from_slice(hidden);
    for row in 0..rows {
        let measured = &run.outputs[row * outputs..][..outputs];
        if row == 0 {
            z[..outputs].copy_from_slice(measured);
        }
        visit(row, &z[..states]);
        if row < given {
            correct(&mut z[..states], gain, limits, measured);
        }
        z[states..].copy_from_slice(&run.inputs[row * (columns - states)..][..columns - states]);
        active.evaluate(features, [first, bias], &z);
        for (state, next) in next.iter_mut().enumerate() {
            let change = constant[state] + dot(&linear[state * columns..][..columns], &z);
            *next = z[state] + change + dot(&last[state * count..][..count], &active.values);
        }
        next.iter_mut().zip(&limits.states).for_each(|(state, range)| *state = within(*range, *state));
        if !next.iter().all(|value| value.abs() < DIVERGED) {
            return None;
        }
        z[..states].copy_from_slice(&next);
    }
    Some(())
}

/// As [`simulate`], with the sensitivities to the coefficients, shape `[states, coefficients]`. Outputs are made what was measured after each
/// `stretch` of rows.
fn simulate_with_sensitivities(
    shape: &StateShape,
    coefficients: &[f64],
    (run, rows): (&Signals, usize),
    goal: &Goal,
    mut visit: impl FnMut(usize, &[f64], &[f64]),
) -> Option<()> {
    let StateShape { states, outputs, columns, ref features } = *shape;
    let places = shape.places();
    let [linear, constant, last, first, bias, hidden] = places.clone().map(|place| &coefficients[place]);
    let count = coefficients.len();
    let mut active = FeatureValues::new(features, states);
    let terms = active.values.len();
    let (mut z, mut next) = (vec![0.0; columns], vec![0.0; states]);
    let mut seen = vec![true; outputs];
    let (mut sensitivities, mut changed) = (vec![0.0; states * count], vec![0.0; states * count]);
    z[outputs..states].copy_from_slice(hidden);
    (outputs..states).zip(places[5].clone()).for_each(|(state, place)| sensitivities[state * count + place] = 1.0);
    for row in 0..rows {
        let measured = &run.outputs[row * outputs..][..outputs];
        if row == 0 {
            z[..outputs].copy_from_slice(measured);
            sensitivities[..outputs * count].fill(0.0);
        }
        visit(row, &z[..states], &sensitivities);
        if row < run.given {
            let is_seen = |(output, range): (usize, &[f64; 2])| within(*range, z[output]) == z[output];
            goal.limits.measured.iter().enumerate().map(is_seen).zip(&mut seen).for_each(|(is, seen)| *seen = is);
            correct(&mut z[..states], goal.gain, goal.limits, measured);
            correct_sensitivities(&mut sensitivities, goal.gain, &seen, states);
        } else if (row - run.given + 1).is_multiple_of(goal.stretch) {
            z[..outputs].copy_from_slice(measured);
            sensitivities[..outputs * count].fill(0.0);
        }
        z[states..].copy_from_slice(&run.inputs[row * (columns - states)..][..columns - states]);
        active.evaluate(features, [first, bias], &z);
        active.differentiate(features, first);
        for state in 0..states {
            let weights = &last[state * terms..][..terms];
            let change = constant[state] + dot(&linear[state * columns..][..columns], &z);
            next[state] = z[state] + change + dot(weights, &active.values);
            let changed = &mut changed[state * count..][..count];
            changed.fill(0.0);
            for (other, sensitivity) in sensitivities.chunks_exact(count).enumerate() {
                let own = if other == state { 1.0 } else { 0.0 };
                let through = |term: usize| weights[term] * active.slopes[term * states + other];
                let slope = own + linear[state * columns + other] + (0..terms).map(through).sum::<f64>();
                changed.iter_mut().zip(sensitivity).for_each(|(sum, more)| *sum += slope * more);
            }
            add(&mut changed[places[0].start + state * columns..], &z, 1.0);
            changed[places[1].start + state] += 1.0;
            add(&mut changed[places[2].start + state * terms..], &active.values, 1.0);
            for node in 0..features.nodes() {
                let slope = weights[node] * (1.0 - active.values[node] * active.values[node]);
                add(&mut changed[places[3].start + node * columns..], &z, slope);
                changed[places[4].start + node] += slope;
            }
        }
        for (state, range) in goal.limits.states.iter().enumerate() {
            let value = within(*range, next[state]);
            if value != next[state] {
                next[state] = value;
                changed[state * count..][..count].fill(0.0);
            }
        }
        if !next.iter().all(|value| value.abs() < DIVERGED) {
            return None;
        }
        z[..states].copy_from_slice(&next);
        std::mem::swap(&mut sensitivities, &mut changed);
    }
    Some(())
}

/// Errors of what is measured of simulated outputs.
fn errors(limits: &Limits, states: &[f64], measured: &[f64]) -> impl Iterator<Item = f64> {
    let error = |(output, measured): (usize, &f64)| limits.measured(output, states[output]) - measured;
    measured.iter().enumerate().map(error)
}

/// `x + K (y - x_y)`, where `x_y` is in the range that is measured.
fn correct(states: &mut [f64], gain: &[f64], limits: &Limits, measured: &[f64]) {
    let outputs = measured.len();
    let errors: Vec<f64> = errors(limits, states, measured).collect();
    states.iter_mut().zip(gain.chunks_exact(outputs)).for_each(|(state, gain)| *state -= dot(gain, &errors));
}

/// The same of the sensitivities, shape `[states, coefficients]`: what is measured has none, and outputs beyond its range have no effect.
fn correct_sensitivities(sensitivities: &mut [f64], gain: &[f64], seen: &[bool], states: usize) {
    let count = sensitivities.len() / states;
    let of_outputs = sensitivities[..seen.len() * count].to_vec();
    for (of_state, gain) in sensitivities.chunks_exact_mut(count).zip(gain.chunks_exact(seen.len())) {
        let of_seen = gain.iter().zip(of_outputs.chunks_exact(count)).zip(seen).filter(|(_, seen)| **seen);
        of_seen.for_each(|((gain, of), _)| add(of_state, of, -gain));
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn add(to: &mut [f64], from: &[f64], factor: f64) {
    to.iter_mut().zip(from).for_each(|(to, from)| *to += factor * from);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn limits(shape: &StateShape) -> Limits {
        Limits { states: vec![Limits::NONE; shape.states], measured: vec![Limits::NONE; shape.outputs] }
    }

    /// A run of a made-up state space with two outputs, a hidden state, an input and a parameter.
    fn example(features: Features) -> (StateShape, Vec<f64>, Signals) {
        let shape = StateShape { states: 3, outputs: 2, columns: 5, features };
        let number = |index: usize| (1.3 * index as f64 + 0.2).sin();
        let coefficients: Vec<f64> = (0..shape.coefficients()).map(|index| 0.2 * number(index)).collect();
        let rows = 30;
        let outputs = (0..2 * rows).map(|index| number(index + 100)).collect();
        let inputs = (0..2 * rows).map(|index| number(index + 300)).collect();
        (shape, coefficients, Signals { outputs, inputs, given: 3, runs: vec![0; rows] })
    }

    #[test]
    fn sensitivities_are_those_of_differences() {
        for features in [Features::Nodes(4), Features::products(5, 3, |_| true, 100).unwrap()] {
            let (shape, coefficients, run) = example(features);
            let coefficients: Vec<f64> = coefficients.iter().map(|value| 0.2 * value).collect();
            let count = coefficients.len();
            let mut found = Vec::new();
            let gain: Vec<f64> = (0..6).map(|place| 0.3 * (place as f64).cos()).collect();
            // a hidden state stops, and the sensor of an output saturates
            let mut limits = limits(&shape);
            (limits.states[2], limits.measured[0]) = ([-0.05, 0.05], [-0.1, 0.2]);
            let goal =
                Goal { center: &[], gain: &gain, limits: &limits, penalty: 0.0, stretch: usize::MAX, iterations: 0 };
            simulate_with_sensitivities(&shape, &coefficients, (&run, 30), &goal, |row, states, of| {
                if row == 12 {
                    found = [states, of].concat();
                }
            })
            .unwrap();
            let at = |index: usize, by: f64| {
                let mut moved = coefficients.clone();
                moved[index] += by;
                let mut states = Vec::new();
                simulate(
                    &shape,
                    Simulated { coefficients: &moved, gain: &gain, limits: &limits },
                    &run,
                    [30, 3],
                    |row, found| {
                        if row == 12 {
                            states = found.to_vec();
                        }
                    },
                )
                .unwrap();
                states
            };
            assert_eq!(found[..3], at(0, 0.0));
            for index in 0..count {
                let (after, before) = (at(index, 1e-6), at(index, -1e-6));
                for state in 0..3 {
                    let expected = (after[state] - before[state]) / 2e-6;
                    let slope = found[3 + state * count + index];
                    assert!(
                        (slope - expected).abs() < 1e-7 * (1.0 + expected.abs()),
                        "{index} {state}: {slope} {expected}"
                    );
                }
            }
        }
    }

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
        let shape = StateShape { states: 2, outputs: 1, columns: 3, features: Features::Nodes(0) };
        let coefficients = [[-0.1, 1.0, 1.0].as_slice(), &[0.0, -0.2, 0.5], &[0.0; 3]].concat();
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
