//! State spaces, and their simulations with sensitivities to the coefficients.

use super::features::{FeatureValues, Features};
use crate::network::kernels::{InstructionSet, SimdKernel, SimdLanes};
use std::ops::Range;

/// Standardized magnitude from which on a simulation has diverged.
const DIVERGED: f64 = 1e3;
/// Sensitivities that are computed at once, in registers.
const BLOCK: usize = 16;

/// Sizes of a state space, and the positions of its coefficients: `L`, `c`, `G`, `W`, `b`, then the initial states,
/// matrices row by row. `W` and `b` are those of nodes.
#[derive(Clone, Debug, PartialEq)]
pub struct StateShape {
    /// Number of states, the outputs first.
    pub states: usize,
    /// Number of outputs.
    pub outputs: usize,
    /// Number of columns: states, inputs, parameters.
    pub columns: usize,
    /// Nonlinear functions of the columns.
    pub features: Features,
    /// Outputs at the start of runs from rest, if they differ by no more than noise. All states at the start are then
    /// coefficients, which the first outputs correct as those of later rows do. Otherwise a run begins with its first
    /// outputs, and hidden states are a linear function of them, `h = h0 + H y`, with the coefficients `h0` and `H`.
    pub common_start: Option<Vec<f64>>,
}

impl StateShape {
    /// Number of hidden states.
    pub fn hidden(&self) -> usize {
        self.states - self.outputs
    }

    /// Number of coefficients of the start.
    fn started(&self) -> usize {
        if self.common_start.is_some() { self.states } else { self.hidden() * (1 + self.outputs) }
    }

    /// States at the start, from their coefficients and a run's first outputs.
    fn begin(&self, start: &[f64], measured: &[f64], states: &mut [f64]) {
        if self.common_start.is_some() {
            return states.copy_from_slice(start);
        }
        let (hidden, of_outputs) = start.split_at(self.hidden());
        states[..self.outputs].copy_from_slice(measured);
        for ((state, value), row) in
            states[self.outputs..].iter_mut().zip(hidden).zip(of_outputs.chunks_exact(self.outputs))
        {
            *state = value + dot(row, measured);
        }
    }

    /// Sensitivities of these states, shape `[states, coefficients]`.
    fn begin_sensitivities(&self, measured: &[f64], sensitivities: &mut [f64]) {
        let count = self.coefficients();
        let first = self.places()[5].start;
        if self.common_start.is_some() {
            return (0..self.states).for_each(|state| sensitivities[state * count + first + state] = 1.0);
        }
        for hidden in 0..self.hidden() {
            let row = &mut sensitivities[(self.outputs + hidden) * count..][..count];
            row[first + hidden] = 1.0;
            let of_outputs = first + self.hidden() + hidden * self.outputs;
            row[of_outputs..of_outputs + self.outputs].copy_from_slice(measured);
        }
    }

    /// Coefficients of states that keep their start values.
    pub fn constant(&self) -> Vec<f64> {
        let mut coefficients = vec![0.0; self.coefficients()];
        let start = self.places()[5].start;
        let outputs = self.common_start.as_deref().unwrap_or_default();
        coefficients[start..start + outputs.len()].copy_from_slice(outputs);
        coefficients
    }

    /// Places of `L`, `c`, `G`, `W`, `b` and the start.
    pub fn places(&self) -> [Range<usize>; 6] {
        let Self { states, columns, .. } = *self;
        let (features, nodes) = (self.features.count(), self.features.nodes());
        let mut end = 0;
        [states * columns, states, states * features, nodes * columns, nodes, self.started()].map(|length| {
            end += length;
            end - length..end
        })
    }

    /// Number of coefficients.
    pub fn coefficients(&self) -> usize {
        self.places()[5].end
    }

    /// Multiplications of an evaluation with sensitivities, for each row.
    pub fn cost(&self) -> f64 {
        let (states, outputs, count) = (self.states as f64, self.outputs as f64, self.coefficients() as f64);
        count * (states * states + outputs * count)
    }
}

/// Standardized ranges that simulations do not leave.
#[derive(Clone, Debug, PartialEq)]
pub struct Limits {
    /// Range of each state, which stops at its ends.
    pub states: Vec<[f64; 2]>,
    /// Range of the sensor of each output; the output itself may leave it.
    pub measured: Vec<[f64; 2]>,
}

impl Limits {
    /// Range without ends.
    pub const NONE: [f64; 2] = [f64::NEG_INFINITY, f64::INFINITY];

    /// Measured value of an output.
    pub fn measured(&self, output: usize, value: f64) -> f64 {
        within(self.measured[output], value)
    }
}

/// Nearest value in a range; NaN stays NaN.
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
    /// Coefficients, in the order of [`StateShape::places`].
    pub coefficients: &'a [f64],
    /// Correction of the states by the errors of outputs that are given, shape `[states, outputs]`.
    pub gain: &'a [f64],
    /// Ranges that the simulation does not leave.
    pub limits: &'a Limits,
}

/// A run, standardized, or several that follow each other.
#[derive(Clone)]
pub struct Signals {
    /// Shape `[rows, outputs]`.
    pub outputs: Vec<f64>,
    /// Inputs and parameters, shape `[rows, columns - states]`.
    pub inputs: Vec<f64>,
    /// Number of given rows, in which outputs of the simulation are set to the measured ones.
    pub given: usize,
    /// Number of the run of each row.
    pub runs: Vec<usize>,
}

impl Signals {
    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.runs.len()
    }

    /// Its first rows.
    pub fn cut(&self, rows: usize) -> Self {
        let given = self.given.min(rows);
        Self { given, ..self.part(0, rows.min(self.rows())) }
    }

    /// Part of `rows` rows, the first half of them given.
    pub fn part(&self, start: usize, rows: usize) -> Self {
        let [outputs, inputs] = [&self.outputs, &self.inputs].map(|of| {
            let width = of.len() / self.rows().max(1);
            of[start * width..(start + rows) * width].to_vec()
        });
        Self { outputs, inputs, given: rows / 2, runs: self.runs[start..start + rows].to_vec() }
    }

    /// Returns true if another run begins with the last rows of this one: the rows given there, and one more.
    pub fn is_followed_by(&self, next: &Self) -> bool {
        let shared = next.given + 1;
        let is_same = |one: &[f64], next: &[f64], width: usize| {
            one.len() >= shared * width && next.len() >= shared * width && one.ends_with(&next[..shared * width])
        };
        let [outputs, inputs] = [&next.outputs, &next.inputs].map(|of| of.len() / next.rows().max(1));
        // a single row that is given may be the first of a run from rest
        next.given > 1 && is_same(&self.outputs, &next.outputs, outputs) && is_same(&self.inputs, &next.inputs, inputs)
    }

    /// Adds the rows of a following run after those that both share.
    pub fn extend(&mut self, next: &Self) {
        let shared = next.given + 1;
        let [outputs, inputs] = [&next.outputs, &next.inputs].map(|of| shared * (of.len() / next.rows().max(1)));
        self.outputs.extend_from_slice(&next.outputs[outputs..]);
        self.inputs.extend_from_slice(&next.inputs[inputs..]);
        self.runs.extend_from_slice(&next.runs[shared..]);
    }
}

/// Correction that sets outputs to the measured ones.
pub fn overwriting(shape: &StateShape) -> Vec<f64> {
    let outputs = shape.outputs;
    let element = |place: usize| f64::from(u8::from(place / outputs == place % outputs));
    (0..shape.states * outputs).map(element).collect()
}

/// `x + L z + c + G f`, with the matrices column by column: all states are computed at once.
struct NextStates<'a> {
    /// `c`
    constant: &'a [f64],
    /// `L`, shape `[columns, states]`.
    linear: Vec<f64>,
    /// `G`, shape `[features, states]`.
    last: Vec<f64>,
    /// Parts of the change that are linear, and those of the features.
    parts: [Vec<f64>; 2],
}

impl<'a> NextStates<'a> {
    fn new(constant: &'a [f64], linear: &[f64], last: &[f64]) -> Self {
        let states = constant.len();
        let by_columns = |matrix: &[f64]| -> Vec<f64> {
            let columns = matrix.len() / states;
            (0..matrix.len()).map(|place| matrix[place % states * columns + place / states]).collect()
        };
        let parts = [vec![0.0; states], vec![0.0; states]];
        Self { constant, linear: by_columns(linear), last: by_columns(last), parts }
    }

    /// `x[k+1]` from the columns and the values of the features.
    fn evaluate(&mut self, z: &[f64], features: &[f64], next: &mut [f64]) {
        let states = next.len();
        for (part, (matrix, factors)) in self.parts.iter_mut().zip([(&self.linear, z), (&self.last, features)]) {
            part.fill(0.0);
            matrix.chunks_exact(states).zip(factors).for_each(|(column, factor)| add(part, column, *factor));
        }
        let [linear, last] = &self.parts;
        for (state, next) in next.iter_mut().enumerate() {
            *next = z[state] + (self.constant[state] + linear[state]) + last[state];
        }
    }
}

/// `S' = J S`, the part of the sensitivities that continues from one row to the next: `S` of shape `[states, coefficients]`, `J` of
/// `[states, states]`. Products are added in the order of the states, so all instruction sets have the same result.
struct Propagation<'a> {
    jacobian: &'a [f64],
    sensitivities: &'a [f64],
    changed: &'a mut [f64],
    states: usize,
}

impl SimdKernel for Propagation<'_> {
    type Output = ();

    // no explicit lanes: the compiler vectorizes over the blocks, and fuses no multiplication with an addition
    #[inline(always)]
    fn run<L: SimdLanes>(self) {
        let count = self.sensitivities.len() / self.states;
        let rows = self.changed.chunks_exact_mut(count).zip(self.jacobian.chunks_exact(self.states));
        for (changed, slopes) in rows {
            let (blocks, rest) = changed.as_chunks_mut::<BLOCK>();
            for (index, block) in blocks.iter_mut().enumerate() {
                let mut sums = [0.0; BLOCK];
                for (slope, sensitivity) in slopes.iter().zip(self.sensitivities.chunks_exact(count)) {
                    let of_block = &sensitivity[index * BLOCK..][..BLOCK];
                    sums.iter_mut().zip(of_block).for_each(|(sum, more)| *sum += slope * more);
                }
                *block = sums;
            }
            let first = count - rest.len();
            rest.fill(0.0);
            for (slope, sensitivity) in slopes.iter().zip(self.sensitivities.chunks_exact(count)) {
                add(rest, &sensitivity[first..], *slope);
            }
        }
    }
}

/// Simulates the first rows of a run, and calls back with the states at each row, before measured outputs correct them. None if it diverges.
pub fn simulate(
    shape: &StateShape,
    Simulated { coefficients, gain, limits }: Simulated,
    run: &Signals,
    [rows, given]: [usize; 2],
    mut visit: impl FnMut(usize, &[f64]),
) -> Option<()> {
    let StateShape { states, outputs, columns, ref features, .. } = *shape;
    let [linear, constant, last, first, bias, start] = shape.places().map(|place| &coefficients[place]);
    let mut active = FeatureValues::new(features, states);
    let mut equation = NextStates::new(constant, linear, last);
    let (mut z, mut next) = (vec![0.0; columns], vec![0.0; states]);
    for row in 0..rows {
        let measured = &run.outputs[row * outputs..][..outputs];
        if row == 0 {
            shape.begin(start, measured, &mut z[..states]);
        }
        visit(row, &z[..states]);
        if row < given {
            correct(&mut z[..states], gain, limits, measured);
        }
        z[states..].copy_from_slice(&run.inputs[row * (columns - states)..][..columns - states]);
        active.evaluate(features, [first, bias], &z);
        equation.evaluate(&z, &active.values, &mut next);
        next.iter_mut().zip(&limits.states).for_each(|(state, range)| *state = within(*range, *state));
        if !next.iter().all(|value| value.abs() < DIVERGED) {
            return None;
        }
        z[..states].copy_from_slice(&next);
    }
    Some(())
}

/// As [`simulate`], with the sensitivities to the coefficients, shape `[states, coefficients]`. Outputs are set to the
/// measured ones after each `stretch` of rows.
pub fn simulate_with_sensitivities(
    shape: &StateShape,
    Simulated { coefficients, gain, limits }: Simulated,
    (run, rows): (&Signals, usize),
    stretch: usize,
    mut visit: impl FnMut(usize, &[f64], &[f64]),
) -> Option<()> {
    let StateShape { states, outputs, columns, ref features, .. } = *shape;
    let places = shape.places();
    let [linear, constant, last, first, bias, start] = places.clone().map(|place| &coefficients[place]);
    let count = coefficients.len();
    let mut active = FeatureValues::new(features, states);
    let terms = active.values.len();
    let mut equation = NextStates::new(constant, linear, last);
    let mut jacobian = vec![0.0; states * states];
    let set = InstructionSet::detect();
    let (mut z, mut next) = (vec![0.0; columns], vec![0.0; states]);
    let mut seen = vec![true; outputs];
    let (mut sensitivities, mut changed) = (vec![0.0; states * count], vec![0.0; states * count]);
    for row in 0..rows {
        let measured = &run.outputs[row * outputs..][..outputs];
        if row == 0 {
            shape.begin(start, measured, &mut z[..states]);
            shape.begin_sensitivities(measured, &mut sensitivities);
        }
        visit(row, &z[..states], &sensitivities);
        if row < run.given {
            let is_seen = |(output, range): (usize, &[f64; 2])| within(*range, z[output]) == z[output];
            limits.measured.iter().enumerate().map(is_seen).zip(&mut seen).for_each(|(is, seen)| *seen = is);
            correct(&mut z[..states], gain, limits, measured);
            correct_sensitivities(&mut sensitivities, gain, &seen, states);
        } else if (row - run.given + 1).is_multiple_of(stretch) {
            z[..outputs].copy_from_slice(measured);
            sensitivities[..outputs * count].fill(0.0);
        }
        z[states..].copy_from_slice(&run.inputs[row * (columns - states)..][..columns - states]);
        active.evaluate(features, [first, bias], &z);
        active.differentiate(features, first);
        equation.evaluate(&z, &active.values, &mut next);
        for (state, slopes) in jacobian.chunks_exact_mut(states).enumerate() {
            slopes.fill(0.0);
            let weights = &last[state * terms..][..terms];
            weights.iter().zip(active.slopes.chunks_exact(states)).for_each(|(weight, of)| add(slopes, of, *weight));
            for (other, slope) in slopes.iter_mut().enumerate() {
                let own = if other == state { 1.0 } else { 0.0 };
                *slope += own + linear[state * columns + other];
            }
        }
        set.run(Propagation { jacobian: &jacobian, sensitivities: &sensitivities, changed: &mut changed, states });
        for (state, changed) in changed.chunks_exact_mut(count).enumerate() {
            let weights = &last[state * terms..][..terms];
            add(&mut changed[places[0].start + state * columns..], &z, 1.0);
            changed[places[1].start + state] += 1.0;
            add(&mut changed[places[2].start + state * terms..], &active.values, 1.0);
            for node in 0..features.nodes() {
                let slope = weights[node] * (1.0 - active.values[node] * active.values[node]);
                add(&mut changed[places[3].start + node * columns..], &z, slope);
                changed[places[4].start + node] += slope;
            }
        }
        for (state, range) in limits.states.iter().enumerate() {
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

/// Errors of simulated outputs, as far as they are measured.
pub fn errors(limits: &Limits, states: &[f64], measured: &[f64]) -> impl Iterator<Item = f64> {
    let error = |(output, measured): (usize, &f64)| limits.measured(output, states[output]) - measured;
    measured.iter().enumerate().map(error)
}

/// `x + K (y - x_y)`, where `x_y` is in the range that is measured.
pub fn correct(states: &mut [f64], gain: &[f64], limits: &Limits, measured: &[f64]) {
    let outputs = measured.len();
    let errors: Vec<f64> = errors(limits, states, measured).collect();
    states.iter_mut().zip(gain.chunks_exact(outputs)).for_each(|(state, gain)| *state -= dot(gain, &errors));
}

/// Corrects the sensitivities, shape `[states, coefficients]`: measured values have none, and outputs beyond their
/// range have no effect.
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
pub mod tests {
    use super::*;

    pub fn limits(shape: &StateShape) -> Limits {
        Limits { states: vec![Limits::NONE; shape.states], measured: vec![Limits::NONE; shape.outputs] }
    }

    /// A run of a made-up state space with two outputs, a hidden state, an input and a parameter.
    pub fn example(features: Features) -> (StateShape, Vec<f64>, Signals) {
        let shape = StateShape { states: 3, outputs: 2, columns: 5, features, common_start: None };
        let number = |index: usize| (1.3 * index as f64 + 0.2).sin();
        let coefficients: Vec<f64> = (0..shape.coefficients()).map(|index| 0.2 * number(index)).collect();
        let rows = 30;
        let outputs = (0..2 * rows).map(|index| number(index + 100)).collect();
        let inputs = (0..2 * rows).map(|index| number(index + 300)).collect();
        (shape, coefficients, Signals { outputs, inputs, given: 3, runs: vec![0; rows] })
    }

    #[test]
    fn all_instruction_sets_propagate_the_same_bits() {
        let (states, count) = (3, 2 * BLOCK + 5);
        let number = |index: usize| (1.7 * index as f64 + 0.3).sin();
        let jacobian: Vec<f64> = (0..states * states).map(number).collect();
        let sensitivities: Vec<f64> = (0..states * count).map(|index| number(index + 50)).collect();
        let element = |place: usize| {
            let row = &jacobian[place / count * states..][..states];
            row.iter().enumerate().fold(0.0, |sum, (of, slope)| sum + slope * sensitivities[of * count + place % count])
        };
        let expected: Vec<f64> = (0..states * count).map(element).collect();
        for set in InstructionSet::available() {
            let mut changed = vec![f64::NAN; states * count];
            set.run(Propagation { jacobian: &jacobian, sensitivities: &sensitivities, changed: &mut changed, states });
            assert_eq!(changed, expected, "{set:?}");
        }
    }

    #[test]
    fn sensitivities_are_those_of_differences() {
        let products = Features::products(5, 3, |_| true, 100).unwrap();
        for (features, common_start) in [(Features::Nodes(4), None), (products, Some(vec![0.3, -0.2]))] {
            let (mut shape, coefficients, run) = example(features);
            shape.common_start = common_start;
            let coefficients: Vec<f64> = coefficients.iter().map(|value| 0.2 * value).collect();
            let count = coefficients.len();
            let mut found = Vec::new();
            let gain: Vec<f64> = (0..6).map(|place| 0.3 * (place as f64).cos()).collect();
            // a hidden state stops, and the sensor of an output saturates
            let mut limits = limits(&shape);
            (limits.states[2], limits.measured[0]) = ([-0.05, 0.05], [-0.1, 0.2]);
            let model = Simulated { coefficients: &coefficients, gain: &gain, limits: &limits };
            simulate_with_sensitivities(&shape, model, (&run, 30), usize::MAX, |row, states, of| {
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
}
