//! The surrogate prepared for evaluation.

use super::{
    Clock, CommunicationStep, Drive, Integration, Ports, Program, Scale, StepError,
    samples::{PreparedSampling, SamplesScratch},
    solver::Solver,
};
use crate::{
    Encoder, Metadata, Role,
    graph::{GraphScratch, PreparedGraph},
    simd::Simd,
    task::Task,
};

/// Highest order of the outputs' derivatives along a curve: the FMU's `maxOutputDerivativeOrder`.
pub const MAX_OUTPUT_DERIVATIVE_ORDER: u32 = 2;

/// A [`Surrogate`](crate::Surrogate) laid out for fast evaluation. Immutable: any number of threads may share it, each with a [`Scratch`]
/// of its own. No evaluation allocates.
///
/// A point has one value for each input and, after them, one for each state, or what a program remembers of samples; results are the
/// outputs and, after them, the states' derivatives with respect to time.
///
/// Every method panics if a slice has the wrong length or the scratch belongs to another evaluator.
#[derive(Clone, Debug)]
pub struct Evaluator {
    columns: usize,
    results: usize,
    ports: Ports,
    program: PreparedGraph,
    /// How a point becomes columns of the graph, if it is not what it is.
    encoder: Option<Encoder>,
    clock: PreparedClock,
    /// Of the states.
    scales: Vec<Scale>,
    /// Ranges of the inputs that may change during a step.
    ranges: Vec<[f64; 2]>,
    simd: Simd,
}

#[derive(Clone, Debug)]
enum PreparedClock {
    Static,
    Continuous(Integration),
    Sampled(Box<PreparedSampling>),
}

/// Working memory of one evaluation at a time.
#[derive(Clone, Debug)]
pub struct Scratch {
    program: GraphScratch,
    columns: Columns,
    solver: Option<Box<Solver>>,
    samples: Option<Box<SamplesScratch>>,
    results: Vec<f64>,
}

/// Columns of the graph: their values, rates along a curve, and adjoint derivatives.
#[derive(Clone, Debug)]
struct Columns {
    point: Vec<f64>,
    rates: [Vec<f64>; 2],
    gradient: Vec<f64>,
}

impl Evaluator {
    /// Lays out the weights and chooses the instruction set.
    pub(crate) fn of(metadata: &Metadata, program: &Program) -> Self {
        let Metadata { inputs, states, outputs, precision, .. } = metadata;
        let ports = Ports::of(metadata);
        let (encoder, memory) = match &program.clock {
            Clock::Static => (Encoder::of(inputs), 0),
            Clock::Continuous(_) => {
                let encoder = Encoder::without(ports.start_columns(), ports.known() + ports.states);
                (encoder, ports.states)
            }
            Clock::Sampled(sampling) => (Encoder::of(&[]), sampling.memory(&ports)),
        };
        let clock = match &program.clock {
            Clock::Static => PreparedClock::Static,
            Clock::Continuous(integration) => PreparedClock::Continuous(*integration),
            Clock::Sampled(sampling) => {
                PreparedClock::Sampled(Box::new(PreparedSampling::new(sampling.as_ref().clone(), ports)))
            }
        };
        let driven = inputs.iter().filter(|input| input.role == Role::Input);
        Self {
            columns: inputs.len() + memory,
            results: outputs.len() + states.len(),
            ports,
            program: PreparedGraph::new(&program.graph, *precision),
            encoder: (!encoder.is_plain()).then_some(encoder),
            clock,
            scales: program.scales(states),
            ranges: driven.map(|input| [input.min, input.max]).collect(),
            simd: Simd::detect(),
        }
    }

    /// The same with another integration of continuous states.
    pub fn with_integration(&self, integration: Integration) -> Self {
        let mut other = self.clone();
        if let PreparedClock::Continuous(own) = &mut other.clock {
            *own = integration;
        }
        other
    }

    /// Working memory that fits this evaluator.
    pub fn scratch(&self) -> Scratch {
        let width = self.encoder.as_ref().map_or(self.columns, Encoder::width);
        let zeros = || vec![0.0; width];
        let columns = Columns { point: zeros(), rates: [zeros(), zeros()], gradient: zeros() };
        let (mut solver, mut samples) = (None, None);
        match &self.clock {
            PreparedClock::Static => {}
            PreparedClock::Continuous(_) => {
                let arguments = self.program.motion().map(|motion| motion.arguments()).unwrap_or_default();
                let (ranges, scales) = (self.ranges.clone(), self.scales.clone());
                solver = Some(Box::new(Solver::new(self.columns, ranges, scales, arguments)));
            }
            PreparedClock::Sampled(sampling) => samples = Some(Box::new(sampling.scratch())),
        }
        Scratch { program: self.program.scratch(), columns, solver, samples, results: vec![0.0; self.results] }
    }

    /// Results at one point.
    pub fn evaluate(&self, point: &[f64], results: &mut [f64], scratch: &mut Scratch) {
        self.check_results(results);
        self.perform(point, Task::Outputs(results), scratch);
    }

    /// Directional derivative `J(point) direction`, exact but for rounding.
    pub fn directional(&self, point: &[f64], direction: &[f64], derivative: &mut [f64], scratch: &mut Scratch) {
        self.check_point(direction);
        self.check_results(derivative);
        let task = Task::Series { rates: [direction, &[]], first: derivative, second: None };
        self.perform(point, task, scratch);
    }

    /// First and second derivative of the results along a curve that is at `point` with the derivatives `rates` (first
    /// and second), exact but for rounding.
    pub fn along_curve(&self, point: &[f64], rates: [&[f64]; 2], derivatives: [&mut [f64]; 2], scratch: &mut Scratch) {
        rates.iter().for_each(|rate| self.check_point(rate));
        derivatives.iter().for_each(|derivative| self.check_results(derivative));
        let [first, second] = derivatives;
        self.perform(point, Task::Series { rates, first, second: Some(second) }, scratch);
    }

    /// Adjoint derivative `J(point)^T weights`, exact but for rounding. Of equations it takes as long as a directional derivative
    /// for each column.
    pub fn adjoint(&self, point: &[f64], weights: &[f64], gradient: &mut [f64], scratch: &mut Scratch) {
        self.check_point(gradient);
        self.check_results(weights);
        self.perform(point, Task::Adjoint { weights, gradient }, scratch);
    }

    /// Integrates the states of a point over a communication step, or goes on from sample to sample. Nothing happens without
    /// states or a memory. Returns how many steps the solver tried.
    ///
    /// # Errors
    /// A [`StepError`]; the states are as before.
    pub fn advance(
        &self,
        point: &mut [f64],
        step: CommunicationStep,
        drive: Drive,
        scratch: &mut Scratch,
    ) -> Result<u32, StepError> {
        self.check_point(point);
        let Scratch { program, columns, solver, samples, results } = scratch;
        match &self.clock {
            PreparedClock::Static => Ok(0),
            PreparedClock::Continuous(integration) => {
                let solver = solver.as_mut().expect(OTHER);
                let has_motion = self.program.motion().is_some();
                solver.advance(point, *integration, step, drive, |point, rates, arguments| {
                    self.encode(point, columns);
                    if has_motion {
                        return self.program.rates(&columns.point, (rates, arguments), program);
                    }
                    self.program.perform(self.simd, &columns.point, Task::Outputs(results), program);
                    rates.copy_from_slice(&results[self.ports.outputs..]);
                })
            }
            PreparedClock::Sampled(sampling) => {
                let samples = samples.as_mut().expect(OTHER);
                sampling.advance(point, step.size, drive, samples, |columns, next| {
                    self.program.perform(self.simd, columns, Task::Outputs(next), program);
                })?;
                Ok(0)
            }
        }
    }

    /// Makes a sample of the outputs what was measured; nothing without samples.
    pub fn correct(&self, point: &mut [f64], outputs: &[f64]) {
        if let PreparedClock::Sampled(sampling) = &self.clock {
            sampling.correct(point, outputs);
        }
    }

    /// Number of values of a point: inputs, and states or what is remembered.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Number of results: outputs and derivatives of states.
    pub fn results(&self) -> usize {
        self.results
    }

    /// Gives the states of a point, or its memory, the values that its inputs have for the start.
    pub fn start(&self, point: &mut [f64]) {
        self.check_point(point);
        match &self.clock {
            PreparedClock::Static => {}
            PreparedClock::Continuous(_) => point.copy_within(self.ports.start_columns(), self.ports.known()),
            PreparedClock::Sampled(sampling) => sampling.start(point),
        }
    }

    fn check_point(&self, point: &[f64]) {
        assert_eq!(point.len(), self.columns, "number of inputs and states");
    }

    fn check_results(&self, results: &[f64]) {
        assert_eq!(results.len(), self.results, "number of outputs and derivatives");
    }

    #[inline]
    fn perform(&self, point: &[f64], task: Task, scratch: &mut Scratch) {
        self.check_point(point);
        let Scratch { program, columns, .. } = scratch;
        match (&self.clock, &self.encoder) {
            (PreparedClock::Sampled(sampling), _) => sampling.perform(point, task),
            (_, None) => self.program.perform(self.simd, point, task, program),
            (_, Some(encoder)) => self.encoded(encoder, point, task, columns, program),
        }
    }

    /// Does a task of the point with the columns of the graph, by the chain rule.
    fn encoded(
        &self,
        encoder: &Encoder,
        inputs: &[f64],
        task: Task,
        columns: &mut Columns,
        scratch: &mut GraphScratch,
    ) {
        let Columns { point, rates: [velocity, change], gradient: by_columns } = columns;
        encoder.encode(inputs, point);
        match task {
            Task::Outputs(outputs) => self.program.perform(self.simd, point, Task::Outputs(outputs), scratch),
            Task::Series { rates, first, second } => {
                encoder.along_curve(point, rates, [velocity, change]);
                let rates: [&[f64]; 2] = if second.is_some() { [velocity, change] } else { [velocity, &[]] };
                self.program.perform(self.simd, point, Task::Series { rates, first, second }, scratch);
            }
            Task::Adjoint { weights, gradient } => {
                let task = Task::Adjoint { weights, gradient: by_columns };
                self.program.perform(self.simd, point, task, scratch);
                encoder.gradient(point, by_columns, gradient);
            }
        }
    }

    fn encode(&self, point: &[f64], columns: &mut Columns) {
        match &self.encoder {
            Some(encoder) => encoder.encode(point, &mut columns.point),
            None => columns.point.copy_from_slice(point),
        }
    }
}

const OTHER: &str = "the scratch belongs to another evaluator";

#[cfg(test)]
mod tests;
