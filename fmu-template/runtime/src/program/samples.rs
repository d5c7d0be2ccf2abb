//! Discrete-time programs without internal states: past samples of inputs and outputs determine the next sample of the outputs.
//!
//! ```text
//! y[k + 1] = f(z[k]),   z[k] = (y[k], ..., y[k - n + 1],  u[k], ..., u[k - m + 1],  p)
//! ```
//!
//! Samples are `T` seconds apart. The columns of a point are, in this order,
//!
//! | columns | |
//! |---|---|
//! | `p` | parameters |
//! | `y_start`, `u_start` | outputs and inputs before the start, which are parameters as well; `u_start` only if m > 1, as it has no effect otherwise |
//! | `u` | inputs |
//! | memory | see below |
//!
//! and the results are the outputs. The memory is, in this order,
//!
//! | part | |
//! |---|---|
//! | `y[k], ...` | n samples, at least one |
//! | `u[k], ...` | m samples |
//! | support | averages, last values and average changes of the inputs, if the [`Support`] of the training has them |
//! | | residual of errors outside the support and distance from it, -1 before the first sample, if there is a support |
//! | measured outputs | one of each, and 1 while they are used, else 0 |
//! | `y[k + 1]` | next sample |
//! | phase | time since sample k over `T` |
//!
//! The last numbers of `y` may be hidden: they advance like outputs, start from values of the program, and are not
//! outputs. Inputs may act on outputs at the same time: the outputs are then `y + D u`, with the inputs of the point.
//! The rule for communication points between samples:
//!
//! - the program advances at multiples of `T` after the start, independently of the communication steps;
//! - an input has its value at the sample. Within a communication step its derivatives give that value;
//! - measured outputs are inputs as well: while they are used, less `D u[k]` they replace the outputs of `y[k]` before `y[k + 1]` is computed;
//! - between two samples `y` is linear.
//!
//! A sample is at a communication point that is nearer to it than a millionth of `T`; such differences do not add up.

use super::{
    Ports,
    solver::{Drive, MAX_SOLVER_STEPS, StepError, expect_step},
};
use crate::{
    FormatError, Input,
    check::{expect_finite, expect_shape},
    task::Task,
};
use std::ops::Range;
use support::NEGLIGIBLE;
pub use support::Support;

/// History from which the next sample is computed, see the table above.
#[derive(Clone, Debug, PartialEq)]
pub struct Sampling {
    /// Hidden numbers of `y` at the start.
    pub hidden: Vec<f64>,
    /// Direct effect of the inputs on the outputs, `D`, shape `[outputs, inputs]`; empty if there is none.
    pub direct: Vec<f64>,
    /// Number of past samples of the outputs, `n`, and of the inputs, `m`, that count.
    pub history: [usize; 2],
    /// Time between two samples, in seconds.
    pub step: f64,
    /// Domain of the transitions in training, if it is known.
    pub support: Option<Support>,
}

/// Distance from the support before the first sample.
const UNKNOWN: f64 = -1.0;
/// Part of a sample by which a communication point may miss it.
const SAME: f64 = 1e-6;

impl Sampling {
    /// Number of columns of `z`.
    pub fn width(&self, ports: &Ports) -> usize {
        self.history[0] * self.numbers(ports) + self.history[1] * ports.inputs + ports.parameters
    }

    /// Number of values of a sample: outputs and hidden numbers.
    pub fn numbers(&self, ports: &Ports) -> usize {
        ports.outputs + self.hidden.len()
    }

    /// Number of inputs whose value before the start counts.
    pub fn past_starts(&self, ports: &Ports) -> usize {
        if self.history[1] > 1 { ports.inputs } else { 0 }
    }

    /// Number of columns of the memory.
    pub(super) fn memory(&self, ports: &Ports) -> usize {
        let [past_outputs, past_inputs] = self.past(ports);
        past_outputs + past_inputs + self.supported() + ports.outputs + 1 + self.numbers(ports) + 1
    }

    /// Columns of a point that are measured outputs. The column after them is 1 while they are used, else 0.
    pub fn measured_columns(&self, ports: &Ports) -> Range<usize> {
        let [past_outputs, past_inputs] = self.past(ports);
        let first = ports.known() + past_outputs + past_inputs + self.supported();
        first..first + ports.outputs
    }

    /// Number of values for the support: its memory of inputs, the residual of errors, and the distance.
    fn supported(&self) -> usize {
        self.support.as_ref().map_or(0, |support| support.memory() + 2)
    }

    /// Column of a point that has the distance from the support.
    pub fn distance_column(&self, ports: &Ports) -> Option<usize> {
        let [past_outputs, past_inputs] = self.past(ports);
        self.support.as_ref().map(|_| ports.known() + past_outputs + past_inputs + self.supported() - 1)
    }

    /// Factor by which the distance of a transition from the support fades from sample to sample: a distance of 1 fades
    /// until all past samples that count came after it.
    pub fn settling(&self) -> f64 {
        NEGLIGIBLE.powf(1.0 / self.history[0].max(self.history[1]) as f64)
    }

    /// Numbers that the memory has of past outputs and inputs.
    fn past(&self, ports: &Ports) -> [usize; 2] {
        [self.history[0].max(1) * self.numbers(ports), self.history[1] * ports.inputs]
    }

    /// Makes sure that its numbers are valid and fit the ports; the result is the number of columns and of results of the graph.
    ///
    /// # Errors
    /// The first [`FormatError`].
    pub(super) fn check(&self, ports: &Ports, inputs: &[Input]) -> Result<(usize, usize), FormatError> {
        if self.history[1] == 0 {
            return Err(FormatError::NoVariables { what: "past inputs" });
        }
        ports.expect_order(inputs)?;
        expect_shape("states", &[ports.states], &[0])?;
        expect_shape("inputs", &[ports.starts], &[ports.outputs + self.past_starts(ports)])?;
        expect_finite("samples.hidden", self.hidden.iter().copied())?;
        expect_finite("samples.direct", self.direct.iter().copied())?;
        if !self.direct.is_empty() {
            expect_shape("samples.direct", &[self.direct.len()], &[ports.outputs * ports.inputs])?;
        }
        if let Some(support) = &self.support {
            support.check(ports.inputs, ports.outputs, self.hidden.len())?;
        }
        expect_step(self.step)?;
        Ok((self.width(ports), self.numbers(ports)))
    }
}

/// A [`Sampling`] prepared for evaluation.
#[derive(Clone, Debug)]
pub(super) struct PreparedSampling {
    sampling: Sampling,
    ports: Ports,
    /// Factors by which errors made outside the support, and the distance from it, fade from sample to sample.
    fading: [f64; 2],
}

/// Working memory of one evaluation at a time.
#[derive(Clone, Debug)]
pub(super) struct SamplesScratch {
    /// `z`
    columns: Vec<f64>,
    /// Measures of a transition.
    measures: Vec<f64>,
    /// The memory before a step.
    before: Vec<f64>,
}

/// The parts of a memory.
struct Memory<'a> {
    outputs: &'a mut [f64],
    inputs: &'a mut [f64],
    /// Memory of inputs of the support, residual of errors, and distance from the support.
    support: &'a mut [f64],
    next: &'a mut [f64],
    phase: &'a mut f64,
}

/// A time between sample `k` and the next one.
struct BetweenSamples {
    /// Columns of the outputs at sample `k`.
    now: Range<usize>,
    /// Columns of the outputs at the next sample.
    next: Range<usize>,
    /// Share of the next sample in the outputs.
    share: f64,
}

impl PreparedSampling {
    pub(super) fn new(sampling: Sampling, ports: Ports) -> Self {
        let support = sampling.support.as_ref();
        let fading = support.map_or([0.0; 2], |support| [support.fading(), sampling.settling()]);
        Self { sampling, ports, fading }
    }

    pub(super) fn scratch(&self) -> SamplesScratch {
        SamplesScratch {
            columns: vec![0.0; self.sampling.width(&self.ports)],
            measures: vec![0.0; self.sampling.support.as_ref().map_or(0, |support| support.ranges.len())],
            before: vec![0.0; self.sampling.memory(&self.ports)],
        }
    }

    /// Fills the memory with a past in which nothing moved: outputs and inputs have always been what the point has for the start. What is
    /// measured stays, as inputs do.
    pub(super) fn start(&self, point: &mut [f64]) {
        let Ports { inputs, outputs, .. } = self.ports;
        let (known, memory) = point.split_at_mut(self.ports.known());
        let (of_outputs, of_inputs) = known[self.ports.start_columns()].split_at(outputs);
        let memory = self.parts(memory);
        for sample in memory.outputs.chunks_mut(self.sampling.numbers(&self.ports)).chain([memory.next]) {
            let (shown, rest) = sample.split_at_mut(outputs);
            shown.copy_from_slice(of_outputs);
            self.add_direct(-1.0, &known[self.ports.input_columns()], shown);
            rest.copy_from_slice(&self.sampling.hidden);
        }
        if let Some((distance, past)) = memory.support.split_last_mut() {
            past.fill(0.0);
            *distance = UNKNOWN;
        }
        // of a single sample it does not count: the first step takes what the inputs are then
        match of_inputs {
            [] => memory.inputs.fill(0.0),
            _ => memory.inputs.chunks_mut(inputs).for_each(|sample| sample.copy_from_slice(of_inputs)),
        }
        *memory.phase = 0.0;
    }

    /// Makes the outputs at the last sample what was measured, and uses it; or ends the use of measured outputs.
    pub(super) fn measure(&self, point: &mut [f64], outputs: Option<&[f64]>) {
        let measured = self.measured_columns();
        point[measured.end] = if outputs.is_some() { 1.0 } else { 0.0 };
        if let Some(outputs) = outputs {
            point[measured].copy_from_slice(outputs);
            let (known, memory) = point.split_at_mut(self.ports.known());
            let shown = &mut memory[..outputs.len()];
            shown.copy_from_slice(outputs);
            self.add_direct(-1.0, &known[self.ports.input_columns()], shown);
        }
    }

    /// Adds a multiple of the direct effect of inputs to outputs.
    #[inline(never)]
    fn add_direct(&self, factor: f64, inputs: &[f64], outputs: &mut [f64]) {
        let rows = self.sampling.direct.chunks_exact(self.ports.inputs.max(1));
        for (output, row) in outputs.iter_mut().zip(rows) {
            *output += factor * row.iter().zip(inputs).map(|(direct, input)| direct * input).sum::<f64>();
        }
    }

    /// Columns of the measured outputs and, after them, of their switch.
    pub(super) fn measured_columns(&self) -> Range<usize> {
        self.sampling.measured_columns(&self.ports)
    }

    fn parts<'a>(&self, memory: &'a mut [f64]) -> Memory<'a> {
        let Self { sampling, ports, .. } = self;
        let [past_outputs, past_inputs] = sampling.past(ports);
        let (outputs, rest) = memory.split_at_mut(past_outputs);
        let (inputs, rest) = rest.split_at_mut(past_inputs);
        let (support, rest) = rest.split_at_mut(sampling.supported());
        let (_, rest) = rest.split_at_mut(ports.outputs + 1);
        let (next, phase) = rest.split_at_mut(sampling.numbers(ports));
        Memory { outputs, inputs, support, next, phase: &mut phase[0] }
    }

    fn between(&self, point: &[f64]) -> BetweenSamples {
        let outputs = self.ports.outputs;
        let last = point.len() - 1;
        let first = self.ports.known();
        let next = last - self.sampling.numbers(&self.ports);
        // a sample that was missed a little is that sample
        let share = if point[last].abs() <= SAME { 0.0 } else { point[last].clamp(0.0, 1.0) };
        BetweenSamples { now: first..first + outputs, next: next..next + outputs, share }
    }

    /// Writes the outputs between two samples, or their derivatives, from the columns or their derivatives.
    #[inline]
    fn blend(&self, BetweenSamples { now, next, share }: &BetweenSamples, from: &[f64], to: &mut [f64]) {
        for ((to, now), next) in to.iter_mut().zip(&from[now.clone()]).zip(&from[next.clone()]) {
            *to = now + share * (next - now);
        }
        self.add_direct(1.0, &from[self.ports.input_columns()], to);
    }

    /// Does a task at a point. Does not allocate. Outputs depend on the memory, and on inputs that act directly.
    pub(super) fn perform(&self, point: &[f64], task: Task) {
        let between = self.between(point);
        match task {
            Task::Outputs(results) => self.blend(&between, point, results),
            Task::Series { rates, first, second } => {
                self.blend(&between, rates[0], first);
                match second {
                    Some(second) if !rates[1].is_empty() => self.blend(&between, rates[1], second),
                    Some(second) => second.fill(0.0),
                    None => {}
                }
            }
            Task::Adjoint { weights, gradient } => {
                gradient.fill(0.0);
                let BetweenSamples { now, next, share } = between;
                for (output, weight) in weights.iter().enumerate() {
                    gradient[now.start + output] = (1.0 - share) * weight;
                    gradient[next.start + output] = share * weight;
                }
                let inputs = &mut gradient[self.ports.input_columns()];
                for (row, weight) in self.sampling.direct.chunks_exact(inputs.len().max(1)).zip(weights) {
                    inputs.iter_mut().zip(row).for_each(|(gradient, direct)| *gradient += weight * direct);
                }
            }
        }
    }

    /// Advances by `size` seconds by the rule above. `next` computes the next sample from `z`. Does not allocate.
    ///
    /// # Errors
    /// A [`StepError`]; the memory is as before.
    pub(super) fn advance(
        &self,
        point: &mut [f64],
        size: f64,
        drive: Drive,
        scratch: &mut SamplesScratch,
        next: impl FnMut(&[f64], &mut [f64]),
    ) -> Result<(), StepError> {
        let known = self.ports.known();
        scratch.before.copy_from_slice(&point[known..]);
        let result = self.samples(point, size, drive, scratch, next);
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
        SamplesScratch { columns, measures, .. }: &mut SamplesScratch,
        mut next: impl FnMut(&[f64], &mut [f64]),
    ) -> Result<(), StepError> {
        let step = self.sampling.step;
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
                self.take_measured(point, since, drive);
                self.gather(point, columns);
                let memory = self.parts(&mut point[self.ports.known()..]);
                next(columns, memory.next);
                let outputs = &memory.outputs[..self.ports.outputs];
                if !outputs.iter().chain(&*memory.next).all(|value| value.is_finite()) {
                    return Err(StepError::NotFinite { after: since + step });
                }
                self.compare(point, measures);
            }
            if end - passed < 1.0 - SAME {
                break;
            }
            passed += 1.0;
            let memory = self.parts(&mut point[self.ports.known()..]);
            memory.outputs.rotate_right(memory.next.len());
            memory.outputs[..memory.next.len()].copy_from_slice(memory.next);
            *memory.phase = 0.0;
        }
        point[last] = end - passed;
        Ok(())
    }

    /// Puts the inputs, `since` seconds after the beginning of the step, into the memory.
    fn take_inputs(&self, point: &mut [f64], since: f64, drive: Drive) {
        let (known, memory) = point.split_at_mut(self.ports.known());
        let past = self.parts(memory).inputs;
        past.rotate_right(self.ports.inputs);
        for (column, to) in self.ports.input_columns().zip(past) {
            let value = drive.at(column, known[column], since);
            *to = drive.clamp.map_or(value, |domain| domain.clamp(column, value));
        }
    }

    /// Returns true while measured outputs are used.
    fn is_measured(&self, point: &[f64]) -> bool {
        // not exactly 0 or 1 where a start is perturbed
        point[self.measured_columns().end] > 0.5
    }

    /// While measured outputs are used, makes them the outputs at the last sample, `since` seconds after the beginning of the step, whose inputs
    /// have been taken.
    fn take_measured(&self, point: &mut [f64], since: f64, drive: Drive) {
        let measured = self.measured_columns();
        if !self.is_measured(point) {
            return;
        }
        for (output, column) in measured.enumerate() {
            point[self.ports.known() + output] = drive.at(column, point[column], since);
        }
        let memory = self.parts(&mut point[self.ports.known()..]);
        self.add_direct(-1.0, &memory.inputs[..self.ports.inputs], &mut memory.outputs[..self.ports.outputs]);
    }

    /// Updates the distance of the transition to the next outputs from those of the training.
    fn compare(&self, point: &mut [f64], measures: &mut [f64]) {
        let Some(support) = &self.sampling.support else { return };
        let Ports { inputs: count, outputs, .. } = self.ports;
        let is_measured = self.is_measured(point);
        let (known, memory) = point.split_at_mut(self.ports.known());
        let Memory { support: [past @ .., error, distance], outputs: now, inputs, next, .. } = self.parts(memory)
        else {
            return;
        };
        let inputs = &inputs[..count];
        if *distance < 0.0 {
            // what was before measured outputs is not known
            let before = &known[self.ports.start_columns()][outputs..];
            support.begin(past, if is_measured || before.is_empty() { inputs } else { before });
            *distance = 0.0;
        }
        let (next, hidden) = next.split_at(outputs);
        support.measure(past, inputs, [&now[..outputs], next], hidden, measures);
        let own = support.distance(measures);
        [*error, *distance] = Support::after(own, [*error, *distance], self.fading, is_measured);
    }

    /// `z` from a point.
    fn gather(&self, point: &mut [f64], columns: &mut [f64]) {
        let (known, memory) = point.split_at_mut(self.ports.known());
        let memory = self.parts(memory);
        let past_outputs = self.sampling.history[0] * self.sampling.numbers(&self.ports);
        let (of_outputs, rest) = columns.split_at_mut(past_outputs);
        let (of_inputs, of_parameters) = rest.split_at_mut(memory.inputs.len());
        of_outputs.copy_from_slice(&memory.outputs[..past_outputs]);
        of_inputs.copy_from_slice(memory.inputs);
        of_parameters.copy_from_slice(&known[..self.ports.parameters]);
    }
}

mod support;
#[cfg(test)]
mod tests;
