//! Surrogates that know inputs and outputs only: the next sample of the outputs follows from past samples of both.
//!
//! ```text
//! y[k + 1] = c + W z[k] + N(z[k]),   z[k] = (y[k], ..., y[k - n + 1],  u[k], ..., u[k - m + 1],  p)
//! ```
//!
//! Samples are `T` seconds apart. The columns of a point are, in this order,
//!
//! | columns | |
//! |---|---|
//! | `p` | parameters |
//! | `y_start`, `u_start` | what outputs and inputs were before the start: parameters, too; the latter if m > 1, as else they do not count |
//! | `u` | inputs |
//! | memory | `y[k], ...`: n samples, one at least; `u[k], ...`: m samples; averages of the inputs and the distance from the [`Support`] of the training, if it is known; `y[k + 1]`; the time since sample k over `T` |
//!
//! and the results are the outputs. The last numbers of `y` may be hidden: they go on as the others do, begin with numbers of the model, and
//! are no outputs. The rule for communication points between samples:
//!
//! - the model goes on at multiples of `T` since the start, whatever the communication steps are;
//! - an input counts at the sample: what it is when the simulation goes on from there, or what its derivatives make of it at a sample
//!   within a communication step;
//! - between two samples the outputs are linear.
//!
//! A sample is at a communication point that is nearer to it than a millionth of `T`; such differences do not add up.

use super::{
    expect_starts, expect_step,
    solver::{Drive, MAX_SOLVER_STEPS, StepError},
};
use crate::{
    FormatError, Input, Map, Precision, State,
    map::{MapScratch, PreparedMap, Task, expect_finite, expect_shape},
    simd::Simd,
};
use std::ops::Range;
pub use support::{Support, Transition};

/// The next sample of the outputs as a function of past samples, see the table above.
#[derive(Clone, Debug, PartialEq)]
pub struct Discrete {
    /// Number of parameters, of inputs and of outputs.
    pub counts: [usize; 3],
    /// What the hidden numbers of `y` are at the start.
    pub hidden: Vec<f64>,
    /// Number of past samples of the outputs, `n`, and of the inputs, `m`, that count.
    pub history: [usize; 2],
    /// Time between two samples, in seconds.
    pub step: f64,
    /// `W`: shape `[numbers of y, columns]`; empty if it is zero.
    pub weights: Vec<f64>,
    /// `c`: shape `[numbers of y]`.
    pub constants: Vec<f64>,
    /// `N`, if there is one: a network or a graph.
    pub map: Option<Map>,
    /// Ranges of the transitions in training, if they are known.
    pub support: Option<Support>,
}

/// Part of a sample by which a communication point may miss it.
const SAME: f64 = 1e-6;

impl Discrete {
    /// Number of columns of `z`.
    pub fn width(&self) -> usize {
        let [parameters, inputs, _] = self.counts;
        self.history[0] * self.numbers() + self.history[1] * inputs + parameters
    }

    /// How many numbers a sample has: outputs, and what is hidden.
    pub fn numbers(&self) -> usize {
        self.counts[2] + self.hidden.len()
    }

    /// Number of inputs whose value before the start counts.
    pub fn past_starts(&self) -> usize {
        if self.history[1] > 1 { self.counts[1] } else { 0 }
    }

    /// Columns of a point before the memory: parameters, starts, inputs.
    fn known(&self) -> usize {
        let [parameters, inputs, outputs] = self.counts;
        parameters + outputs + self.past_starts() + inputs
    }

    /// Number of columns of the memory.
    pub(super) fn memory(&self) -> usize {
        let [past_outputs, past_inputs] = self.past();
        past_outputs + past_inputs + self.supported() + self.numbers() + 1
    }

    /// Number of values for the support: averages of inputs, and the distance.
    fn supported(&self) -> usize {
        if self.support.is_some() { self.past_starts() + 1 } else { 0 }
    }

    /// Column of a point that has the distance from the support.
    pub fn distance_column(&self) -> Option<usize> {
        let [past_outputs, past_inputs] = self.past();
        self.support.as_ref().map(|_| self.known() + past_outputs + past_inputs + self.supported() - 1)
    }

    /// Number of features of a transition.
    fn features(&self) -> usize {
        3 * self.past_starts() + 2 * self.counts[2]
    }

    /// Numbers that the memory has of past outputs and inputs.
    fn past(&self) -> [usize; 2] {
        [self.history[0].max(1) * self.numbers(), self.history[1] * self.counts[1]]
    }

    /// Makes sure that it fits these inputs, no states, and so many outputs.
    ///
    /// # Errors
    /// The first [`FormatError`].
    pub(super) fn check(&self, inputs: &[Input], states: &[State], outputs: usize) -> Result<(), FormatError> {
        let [parameters, driven, found] = self.counts;
        let numbers = self.numbers();
        expect_shape("outputs", &[found], &[outputs])?;
        expect_shape("states", &[states.len()], &[0])?;
        if self.history[1] == 0 {
            return Err(FormatError::NoVariables { what: "past inputs" });
        }
        expect_starts(inputs, [parameters, outputs + self.past_starts(), driven])?;
        if !self.weights.is_empty() {
            expect_shape("linear.weights", &[self.weights.len()], &[numbers * self.width()])?;
        }
        expect_shape("linear.constants", &[self.constants.len()], &[numbers])?;
        expect_finite("hidden.start", self.hidden.iter().copied())?;
        expect_finite("linear.weights", self.weights.iter().copied())?;
        expect_finite("linear.constants", self.constants.iter().copied())?;
        if let Some(map) = &self.map {
            map.check(self.width(), numbers)?;
        }
        if let Some(support) = &self.support {
            support.check(self.features())?;
        }
        expect_step(self.step)
    }
}

/// A [`Discrete`] laid out for fast evaluation.
#[derive(Clone, Debug)]
pub(super) struct PreparedDiscrete {
    discrete: Discrete,
    map: Option<PreparedMap>,
    /// Factor by which the distance from the support fades from sample to sample.
    fading: f64,
    simd: Simd,
}

/// Working memory of one evaluation at a time.
#[derive(Clone, Debug)]
pub(super) struct DiscreteScratch {
    /// `z`
    columns: Vec<f64>,
    /// What the map adds.
    added: Vec<f64>,
    /// The memory before a step.
    before: Vec<f64>,
    map: Option<MapScratch>,
}

/// The parts of a memory.
struct Memory<'a> {
    outputs: &'a mut [f64],
    inputs: &'a mut [f64],
    /// Averages of the inputs, and the distance from the support.
    support: &'a mut [f64],
    next: &'a mut [f64],
    phase: &'a mut f64,
}

impl PreparedDiscrete {
    pub(super) fn new(discrete: &Discrete, precision: Precision) -> Self {
        let map = discrete.map.as_ref().map(|map| PreparedMap::new(map, precision));
        let fading = discrete.support.as_ref().map_or(0.0, Support::fading);
        Self { discrete: discrete.clone(), map, fading, simd: Simd::detect() }
    }

    pub(super) fn scratch(&self) -> DiscreteScratch {
        DiscreteScratch {
            columns: vec![0.0; self.discrete.width()],
            added: vec![0.0; self.discrete.numbers()],
            before: vec![0.0; self.discrete.memory()],
            map: self.map.as_ref().map(PreparedMap::scratch),
        }
    }

    /// Number of columns of the memory.
    pub(super) fn memory(&self) -> usize {
        self.discrete.memory()
    }

    /// Fills the memory with a past in which nothing moved: outputs and inputs have always been what the point has for the start.
    pub(super) fn start(&self, point: &mut [f64]) {
        let Discrete { counts: [parameters, inputs, outputs], hidden, .. } = &self.discrete;
        let (known, memory) = point.split_at_mut(self.discrete.known());
        let starts = &known[*parameters..known.len() - inputs];
        let (of_outputs, of_inputs) = starts.split_at(*outputs);
        let memory = self.parts(memory);
        for sample in memory.outputs.chunks_mut(self.discrete.numbers()).chain([memory.next]) {
            let (shown, rest) = sample.split_at_mut(*outputs);
            shown.copy_from_slice(of_outputs);
            rest.copy_from_slice(hidden);
        }
        if let Some((distance, means)) = memory.support.split_last_mut() {
            means.copy_from_slice(of_inputs);
            *distance = 0.0;
        }
        // of a single sample it does not count: the first step takes what the inputs are then
        match of_inputs {
            [] => memory.inputs.fill(0.0),
            _ => memory.inputs.chunks_mut(*inputs).for_each(|sample| sample.copy_from_slice(of_inputs)),
        }
        *memory.phase = 0.0;
    }

    /// Makes the outputs at the last sample what was measured.
    pub(super) fn correct(&self, point: &mut [f64], outputs: &[f64]) {
        self.parts(&mut point[self.discrete.known()..]).outputs[..outputs.len()].copy_from_slice(outputs);
    }

    fn parts<'a>(&self, memory: &'a mut [f64]) -> Memory<'a> {
        let [past_outputs, past_inputs] = self.discrete.past();
        let (outputs, rest) = memory.split_at_mut(past_outputs);
        let (inputs, rest) = rest.split_at_mut(past_inputs);
        let (support, rest) = rest.split_at_mut(self.discrete.supported());
        let (next, phase) = rest.split_at_mut(self.discrete.numbers());
        Memory { outputs, inputs, support, next, phase: &mut phase[0] }
    }

    /// Columns of the outputs at sample `k` and at the next one, and the share of the latter in the outputs now.
    fn around(&self, point: &[f64]) -> (Range<usize>, Range<usize>, f64) {
        let outputs = self.discrete.counts[2];
        let last = point.len() - 1;
        let first = self.discrete.known();
        let next = last - self.discrete.numbers();
        // a sample that was missed a little is that sample
        let share = if point[last].abs() <= SAME { 0.0 } else { point[last].clamp(0.0, 1.0) };
        (first..first + outputs, next..next + outputs, share)
    }

    /// Does a task at a point. Does not allocate. Outputs depend on the memory only.
    pub(super) fn perform(&self, point: &[f64], task: Task) {
        let (now, next, share) = self.around(point);
        let blend = |from: &[f64], to: &mut [f64]| {
            for ((to, now), next) in to.iter_mut().zip(&from[now.clone()]).zip(&from[next.clone()]) {
                *to = now + share * (next - now);
            }
        };
        match task {
            Task::Outputs(results) => blend(point, results),
            Task::Series { rates, first, second } => {
                blend(rates[0], first);
                match second {
                    Some(second) if !rates[1].is_empty() => blend(rates[1], second),
                    Some(second) => second.fill(0.0),
                    None => {}
                }
            }
            Task::Adjoint { weights, gradient } => {
                gradient.fill(0.0);
                for (output, weight) in weights.iter().enumerate() {
                    gradient[now.start + output] = (1.0 - share) * weight;
                    gradient[next.start + output] = share * weight;
                }
            }
        }
    }

    /// Goes on by `size` seconds, see the rule above. Does not allocate.
    ///
    /// # Errors
    /// A [`StepError`]; the memory is as before.
    pub(super) fn advance(
        &self,
        point: &mut [f64],
        size: f64,
        drive: Drive,
        scratch: &mut DiscreteScratch,
    ) -> Result<(), StepError> {
        let known = self.discrete.known();
        scratch.before.copy_from_slice(&point[known..]);
        let result = self.samples(point, size, drive, scratch);
        if result.is_err() {
            point[known..].copy_from_slice(&scratch.before);
        }
        result
    }

    fn samples(
        &self,
        point: &mut [f64],
        size: f64,
        drive: Drive,
        scratch: &mut DiscreteScratch,
    ) -> Result<(), StepError> {
        let step = self.discrete.step;
        let last = point.len() - 1;
        let begin = point[last];
        let end = begin + size / step;
        if end - begin > MAX_SOLVER_STEPS {
            return Err(StepError::TooManySteps);
        }
        let mut passed = 0.0;
        // at a sample that the step does not just touch
        while end - passed > SAME {
            if point[last] <= SAME {
                let since = ((passed - begin) * step).clamp(0.0, size);
                self.take_inputs(point, since, drive);
                self.compute(point, scratch);
                let memory = self.parts(&mut point[self.discrete.known()..]);
                if !memory.next.iter().all(|value| value.is_finite()) {
                    return Err(StepError::NotFinite { after: since + step });
                }
                self.compare(point);
            }
            if end - passed < 1.0 - SAME {
                break;
            }
            passed += 1.0;
            let memory = self.parts(&mut point[self.discrete.known()..]);
            memory.outputs.rotate_right(memory.next.len());
            memory.outputs[..memory.next.len()].copy_from_slice(memory.next);
            *memory.phase = 0.0;
        }
        point[last] = end - passed;
        Ok(())
    }

    /// Puts the inputs, `since` seconds after the beginning of the step, into the memory.
    fn take_inputs(&self, point: &mut [f64], since: f64, drive: Drive) {
        let (inputs, first) = (self.discrete.counts[1], self.discrete.known() - self.discrete.counts[1]);
        let (known, memory) = point.split_at_mut(self.discrete.known());
        let past = self.parts(memory).inputs;
        past.rotate_right(inputs);
        for (input, to) in past[..inputs].iter_mut().enumerate() {
            let column = first + input;
            let value = known[column] + since * (drive.rates[0][column] + 0.5 * since * drive.rates[1][column]);
            *to = drive.clamp.map_or(value, |domain| domain.clamp(column, value));
        }
    }

    /// Updates the distance of the transition to the next outputs from those of the training.
    fn compare(&self, point: &mut [f64]) {
        let Some(support) = &self.discrete.support else { return };
        let outputs = self.discrete.counts[2];
        let Memory { support: [means @ .., lasting], outputs: now, inputs, next, .. } =
            self.parts(&mut point[self.discrete.known()..])
        else {
            return;
        };
        support.average(means, inputs);
        let count = means.len();
        let past = if count > 0 { [&inputs[count..2 * count], &inputs[..count]] } else { [&[][..]; 2] };
        let transition = Transition { means, inputs: past, outputs: [&now[..outputs], &next[..outputs]] };
        *lasting = support.distance(&transition, *lasting, self.fading);
    }

    /// The next outputs from the memory.
    fn compute(&self, point: &mut [f64], DiscreteScratch { columns, added, map, .. }: &mut DiscreteScratch) {
        let Discrete { counts: [parameters, ..], history, weights, constants, .. } = &self.discrete;
        let (known, memory) = point.split_at_mut(self.discrete.known());
        let memory = self.parts(memory);
        let (of_outputs, rest) = columns.split_at_mut(history[0] * constants.len());
        let (of_inputs, of_parameters) = rest.split_at_mut(memory.inputs.len());
        of_outputs.copy_from_slice(&memory.outputs[..of_outputs.len()]);
        of_inputs.copy_from_slice(memory.inputs);
        of_parameters.copy_from_slice(&known[..*parameters]);
        match (&self.map, map) {
            (Some(map), Some(scratch)) => map.perform(self.simd, columns, Task::Outputs(added), scratch),
            _ => added.fill(0.0),
        }
        // none of them if the weights are zero
        let mut rows = weights.chunks_exact(columns.len().max(1));
        for ((next, constant), added) in memory.next.iter_mut().zip(constants).zip(added) {
            let row = rows.next().unwrap_or_default();
            let linear: f64 = row.iter().zip(&*columns).map(|(weight, column)| weight * column).sum();
            *next = constant + linear + *added;
        }
    }
}

mod support;
#[cfg(test)]
mod tests;
