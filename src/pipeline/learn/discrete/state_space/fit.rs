//! Simulation of a state space with its sensitivities, and the least squares of its errors.

use nalgebra::{Cholesky, DMatrix, DVector};
use rayon::prelude::*;
use std::ops::Range;

/// Rows after which the outputs of a simulation are made what was measured, one after the other. Whole simulations have more minima, and errors
/// of short ones are biased by noise: a training either has them all or begins with the last.
pub const STRETCHES: [usize; 3] = [4, 32, usize::MAX];
/// Iterations with each of them at most.
const ITERATIONS: usize = 40;
/// Relative decrease below which the next one follows.
const DECREASE: f64 = 1e-3;
/// Iterations without a better simulation of the held-out runs, after which a training ends.
const PATIENCE: usize = 15;
/// Damping at the start, for each error; its changes, and the number of them in one iteration.
const DAMPING: f64 = 1e-3;
const DAMPING_DOWN: f64 = 0.2;
const DAMPING_UP: f64 = 4.0;
const TRIES: usize = 10;
/// Standardized magnitude from which on a simulation has diverged.
const DIVERGED: f64 = 1e3;
/// Sums of runs that are computed side by side: always the same ones, so that their order does not depend on the number of threads.
const PARTS: usize = 16;
/// Errors whose sensitivities are multiplied at once.
const BLOCK: usize = 64;

/// Sizes of a state space, and the places of its coefficients: `L`, `c`, `G`, `W`, `b`, then the hidden states at the start, matrices row by
/// row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shape {
    /// Number of states, the outputs first.
    pub states: usize,
    pub outputs: usize,
    /// Number of columns: states, inputs, parameters.
    pub columns: usize,
    pub nodes: usize,
}

impl Shape {
    pub fn hidden(&self) -> usize {
        self.states - self.outputs
    }

    /// Places of `L`, `c`, `G`, `W`, `b` and the hidden start.
    pub fn places(&self) -> [Range<usize>; 6] {
        let Self { states, columns, nodes, .. } = *self;
        let mut end = 0;
        [states * columns, states, states * nodes, nodes * columns, nodes, self.hidden()].map(|length| {
            end += length;
            end - length..end
        })
    }

    pub fn coefficients(&self) -> usize {
        self.places()[5].end
    }

    /// Multiplications of an evaluation with sensitivities, for each row.
    fn cost(&self) -> f64 {
        let (states, outputs, count) = (self.states as f64, self.outputs as f64, self.coefficients() as f64);
        count * (states * states + outputs * count)
    }
}

/// A run, standardized.
pub struct Signals {
    /// Shape `[rows, outputs]`.
    pub outputs: Vec<f64>,
    /// Inputs and parameters, shape `[rows, columns - states]`.
    pub inputs: Vec<f64>,
    /// Number of rows that are given: outputs of the simulation are what was measured.
    pub given: usize,
}

/// Runs to fit to, and those that choose.
pub struct Data {
    pub training: Vec<Signals>,
    pub validation: Vec<Signals>,
}

/// Squares of the errors, and the normal equations of their sensitivities.
#[derive(Clone)]
struct Sums {
    squares: f64,
    count: usize,
    /// `J^T e`
    gradient: DVector<f64>,
    /// `J^T J`
    matrix: DMatrix<f64>,
}

impl Data {
    fn rows(&self, shape: Shape) -> f64 {
        let numbers: usize = self.training.iter().map(|run| run.outputs.len()).sum();
        (numbers / shape.outputs) as f64
    }

    /// Root mean square error of the simulations of the held-out runs, infinite if one diverges.
    pub fn error(&self, shape: Shape, coefficients: &[f64]) -> f64 {
        let of_run = |run: &Signals| {
            let (mut squares, mut count) = (0.0, 0);
            simulate(shape, coefficients, run, |row, states| {
                if row >= run.given {
                    let measured = &run.outputs[row * shape.outputs..][..shape.outputs];
                    squares += states.iter().zip(measured).map(|(found, value)| (found - value).powi(2)).sum::<f64>();
                    count += shape.outputs;
                }
            })
            .map(|()| (squares, count))
        };
        let found: Option<Vec<(f64, usize)>> = self.validation.par_iter().map(of_run).collect();
        let sums = found.map(|all| all.into_iter().fold((0.0, 0), |a, b| (a.0 + b.0, a.1 + b.1)));
        sums.map_or(f64::INFINITY, |(squares, count)| (squares / count.max(1) as f64).sqrt())
    }

    /// Standard deviations of the states in simulations of the training runs; none if one diverges.
    pub fn deviations(&self, shape: Shape, coefficients: &[f64]) -> Option<Vec<f64>> {
        let (mut sums, mut squares, mut count) = (vec![0.0; shape.states], vec![0.0; shape.states], 0.0);
        for run in &self.training {
            simulate(shape, coefficients, run, |_, states| {
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

    fn sums(&self, shape: Shape, coefficients: &[f64], stretch: usize) -> Option<Sums> {
        let parts: Option<Vec<Sums>> = self
            .training
            .par_chunks(self.training.len().div_ceil(PARTS).max(1))
            .map(|runs| {
                let mut sums = Sums::new(shape.coefficients());
                runs.iter().try_for_each(|run| sums.add(shape, coefficients, run, stretch))?;
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

    /// Coefficients with the best simulations of the held-out runs on the way from a start to the least squares, and their error. `penalty` of
    /// the coefficients for each error. `left` is the number of multiplications that are allowed.
    pub fn train(
        &self,
        shape: Shape,
        start: Vec<f64>,
        penalty: f64,
        stretches: &[usize],
        left: &mut f64,
        is_stopped: &dyn Fn() -> bool,
    ) -> (f64, Vec<f64>) {
        let mut best = (self.error(shape, &start), start.clone());
        let mut coefficients = DVector::from_vec(start);
        let cost = shape.cost() * self.rows(shape);
        for &stretch in stretches {
            let Some(mut sums) = self.sums(shape, coefficients.as_slice(), stretch) else { continue };
            let count = sums.count as f64;
            let (mut damping, mut since) = (DAMPING * count, 0);
            for _ in 0..ITERATIONS {
                if *left <= 0.0 || is_stopped() {
                    return best;
                }
                let value = sums.squares + penalty * count * coefficients.norm_squared();
                let gradient = &sums.gradient + &coefficients * (penalty * count);
                let next = (0..TRIES).find_map(|_| {
                    let mut matrix = sums.matrix.clone();
                    (0..matrix.nrows()).for_each(|place| matrix[(place, place)] += penalty * count + damping);
                    let candidate = &coefficients - Cholesky::new(matrix)?.solve(&gradient);
                    *left -= cost;
                    let found = self.sums(shape, candidate.as_slice(), stretch);
                    let of_found = |sums: &Sums| sums.squares + penalty * count * candidate.norm_squared();
                    let better = found.map(|sums| (of_found(&sums), sums)).filter(|(found, _)| *found < value);
                    if better.is_none() {
                        damping *= DAMPING_UP;
                    }
                    better.map(|(found, sums)| (candidate, sums, found))
                });
                let Some((candidate, more, found)) = next else { break };
                (coefficients, sums) = (candidate, more);
                damping = (damping * DAMPING_DOWN).max(1e-12 * count);
                let error = self.error(shape, coefficients.as_slice());
                since += 1;
                if error < best.0 {
                    best = (error, coefficients.as_slice().to_vec());
                    since = 0;
                }
                let is_last = stretch == usize::MAX;
                if is_last && since >= PATIENCE || !is_last && value - found < DECREASE * value {
                    break;
                }
            }
        }
        best
    }
}

impl Sums {
    fn new(count: usize) -> Self {
        Self { squares: 0.0, count: 0, gradient: DVector::zeros(count), matrix: DMatrix::zeros(count, count) }
    }

    /// Adds the errors of a run; none if its simulation diverges.
    fn add(&mut self, shape: Shape, coefficients: &[f64], run: &Signals, stretch: usize) -> Option<()> {
        let (outputs, count) = (shape.outputs, coefficients.len());
        let mut block = DMatrix::zeros(count, BLOCK);
        let mut errors = DVector::zeros(BLOCK);
        let mut filled = 0;
        simulate_with_sensitivities(shape, coefficients, run, stretch, |row, states, sensitivities| {
            if row < run.given {
                return;
            }
            for output in 0..outputs {
                let error = states[output] - run.outputs[row * outputs + output];
                self.squares += error * error;
                self.count += 1;
                errors[filled] = error;
                block.column_mut(filled).copy_from_slice(&sensitivities[output * count..][..count]);
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

/// Calls back with the states at each row of a run; none if they diverge.
pub fn simulate(shape: Shape, coefficients: &[f64], run: &Signals, mut visit: impl FnMut(usize, &[f64])) -> Option<()> {
    let Shape { states, outputs, columns, nodes } = shape;
    let [linear, constant, last, first, bias, hidden] = shape.places().map(|place| &coefficients[place]);
    let mut z = vec![0.0; columns];
    let (mut active, mut next) = (vec![0.0; nodes], vec![0.0; states]);
    z[outputs..states].copy_from_slice(hidden);
    let rows = run.outputs.len() / outputs;
    for row in 0..rows {
        if row < run.given.max(1) {
            z[..outputs].copy_from_slice(&run.outputs[row * outputs..][..outputs]);
        }
        visit(row, &z[..states]);
        z[states..].copy_from_slice(&run.inputs[row * (columns - states)..][..columns - states]);
        for (node, active) in active.iter_mut().enumerate() {
            *active = (bias[node] + dot(&first[node * columns..][..columns], &z)).tanh();
        }
        for (state, next) in next.iter_mut().enumerate() {
            let change = constant[state] + dot(&linear[state * columns..][..columns], &z);
            *next = z[state] + change + dot(&last[state * nodes..][..nodes], &active);
        }
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
    shape: Shape,
    coefficients: &[f64],
    run: &Signals,
    stretch: usize,
    mut visit: impl FnMut(usize, &[f64], &[f64]),
) -> Option<()> {
    let Shape { states, outputs, columns, nodes } = shape;
    let [linear, constant, last, first, bias, hidden] = shape.places().map(|place| &coefficients[place]);
    let places = shape.places();
    let count = coefficients.len();
    let (mut z, mut active, mut next) = (vec![0.0; columns], vec![0.0; nodes], vec![0.0; states]);
    let (mut sensitivities, mut changed) = (vec![0.0; states * count], vec![0.0; states * count]);
    z[outputs..states].copy_from_slice(hidden);
    (outputs..states).zip(places[5].clone()).for_each(|(state, place)| sensitivities[state * count + place] = 1.0);
    let rows = run.outputs.len() / outputs;
    for row in 0..rows {
        if row < run.given.max(1) {
            z[..outputs].copy_from_slice(&run.outputs[row * outputs..][..outputs]);
            sensitivities[..outputs * count].fill(0.0);
        }
        visit(row, &z[..states], &sensitivities);
        if row >= run.given && (row - run.given + 1).is_multiple_of(stretch) {
            z[..outputs].copy_from_slice(&run.outputs[row * outputs..][..outputs]);
            sensitivities[..outputs * count].fill(0.0);
        }
        z[states..].copy_from_slice(&run.inputs[row * (columns - states)..][..columns - states]);
        for (node, active) in active.iter_mut().enumerate() {
            *active = (bias[node] + dot(&first[node * columns..][..columns], &z)).tanh();
        }
        for state in 0..states {
            let of_nodes = &last[state * nodes..][..nodes];
            let change = constant[state] + dot(&linear[state * columns..][..columns], &z);
            next[state] = z[state] + change + dot(of_nodes, &active);
            let changed = &mut changed[state * count..][..count];
            changed.fill(0.0);
            for (other, sensitivity) in sensitivities.chunks_exact(count).enumerate() {
                let through =
                    |node: usize| of_nodes[node] * (1.0 - active[node] * active[node]) * first[node * columns + other];
                let own = if other == state { 1.0 } else { 0.0 };
                let slope = own + linear[state * columns + other] + (0..nodes).map(through).sum::<f64>();
                changed.iter_mut().zip(sensitivity).for_each(|(sum, more)| *sum += slope * more);
            }
            add(&mut changed[places[0].start + state * columns..], &z, 1.0);
            changed[places[1].start + state] += 1.0;
            add(&mut changed[places[2].start + state * nodes..], &active, 1.0);
            for node in 0..nodes {
                let slope = of_nodes[node] * (1.0 - active[node] * active[node]);
                add(&mut changed[places[3].start + node * columns..], &z, slope);
                changed[places[4].start + node] += slope;
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

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn add(to: &mut [f64], from: &[f64], factor: f64) {
    to.iter_mut().zip(from).for_each(|(to, from)| *to += factor * from);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A run of a made-up state space with two outputs, a hidden state, an input and a parameter.
    fn example() -> (Shape, Vec<f64>, Signals) {
        let shape = Shape { states: 3, outputs: 2, columns: 5, nodes: 4 };
        let number = |index: usize| (1.3 * index as f64 + 0.2).sin();
        let coefficients: Vec<f64> = (0..shape.coefficients()).map(|index| 0.2 * number(index)).collect();
        let rows = 30;
        let outputs = (0..2 * rows).map(|index| number(index + 100)).collect();
        let inputs = (0..2 * rows).map(|index| number(index + 300)).collect();
        (shape, coefficients, Signals { outputs, inputs, given: 3 })
    }

    #[test]
    fn sensitivities_are_those_of_differences() {
        let (shape, coefficients, run) = example();
        let count = coefficients.len();
        let mut found = Vec::new();
        simulate_with_sensitivities(shape, &coefficients, &run, usize::MAX, |row, states, of| {
            if row == 20 {
                found = [states, of].concat();
            }
        })
        .unwrap();
        let at = |index: usize, by: f64| {
            let mut moved = coefficients.clone();
            moved[index] += by;
            let mut states = Vec::new();
            simulate(shape, &moved, &run, |row, found| {
                if row == 20 {
                    states = found.to_vec();
                }
            })
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

    #[test]
    fn a_state_space_is_found_again_from_its_outputs() {
        let (shape, coefficients, mut run) = example();
        run.given = 1;
        let (start, rows) = (run.outputs[..2].to_vec(), run.outputs.len() / 2);
        let signals = |from: usize| {
            let inputs: Vec<f64> = (0..2 * rows).map(|index| (0.7 * (index + from) as f64).sin()).collect();
            let mut run = Signals { outputs: [start.clone(), vec![0.0; 2 * rows - 2]].concat(), inputs, given: 1 };
            let mut outputs = Vec::new();
            simulate(shape, &coefficients, &run, |_, states| outputs.extend_from_slice(&states[..2])).unwrap();
            run.outputs = outputs;
            run
        };
        let data = Data { training: (0..8).map(|from| signals(31 * from)).collect(), validation: vec![signals(777)] };
        let moved: Vec<f64> =
            coefficients.iter().enumerate().map(|(i, of)| of + 0.05 * (2.1 * i as f64).cos()).collect();
        let before = data.error(shape, &moved);
        let (error, _) = data.train(shape, moved, 1e-12, &STRETCHES, &mut 1e12, &|| false);
        assert!(error < 1e-3 * before, "{error} {before}");
    }
}
