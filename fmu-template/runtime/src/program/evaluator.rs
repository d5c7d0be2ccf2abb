//! The surrogate prepared for evaluation.

use super::{
    Clock, CommunicationStep, Drive, Integration, Ports, Program, StepError,
    columns::Columns,
    samples::{PreparedSampling, SamplesScratch},
    solver::Solver,
};
use crate::{
    Encoder, Metadata, Role,
    graph::{GraphScratch, PreparedGraph},
    simd::Simd,
    task::Task,
};
use std::{ops::Range, sync::Arc};

/// Highest order of the outputs' derivatives along a curve: the FMU's `maxOutputDerivativeOrder`.
pub const MAX_OUTPUT_DERIVATIVE_ORDER: u32 = 2;

/// A [`Surrogate`](crate::Surrogate) prepared for fast evaluation, with working memory. No evaluation allocates. Each thread needs a clone:
/// clones share the weights and have separate working memory.
///
/// A point consists of one value per input, then the states or the memory of samples. Results are the outputs, then the derivatives of the
/// states with respect to time.
///
/// Every method panics if a slice has the wrong length.
#[derive(Clone, Debug)]
pub struct Evaluator {
    prepared: Arc<PreparedProgram>,
    /// Integration of continuous states.
    integration: Option<Integration>,
    work: EvaluatorScratch,
}

/// Weights and layout, shared by all clones.
#[derive(Debug)]
struct PreparedProgram {
    /// Number of values of a point.
    values: usize,
    results: usize,
    ports: Ports,
    graph: PreparedGraph,
    columns: Columns,
    sampling: Option<PreparedSampling>,
    simd: Simd,
}

/// Working memory.
#[derive(Clone, Debug)]
struct EvaluatorScratch {
    graph: GraphScratch,
    columns: ColumnWork,
    solver: Option<Box<Solver>>,
    samples: Option<Box<SamplesScratch>>,
    results: Vec<f64>,
}

/// Columns of the graph: values, rates along a curve, and adjoint derivatives.
#[derive(Clone, Debug)]
struct ColumnWork {
    point: Vec<f64>,
    rates: [Vec<f64>; 2],
    gradient: Vec<f64>,
}

impl ColumnWork {
    fn new(width: usize) -> Self {
        let zeros = vec![0.0; width];
        Self { point: zeros.clone(), rates: [zeros.clone(), zeros.clone()], gradient: zeros }
    }
}

impl Evaluator {
    /// Lays out the weights and chooses the instruction set.
    pub(crate) fn of(metadata: &Metadata, program: &Program) -> Self {
        let Metadata { inputs, states, outputs, precision, .. } = metadata;
        let ports = Ports::of(metadata);
        let (columns, memory) = match &program.clock {
            Clock::Static if inputs.iter().all(|input| input.encoding.is_plain()) => (Columns::Same, 0),
            Clock::Static => (Columns::Encoded(Encoder::of(inputs)), 0),
            Clock::Continuous(_) => (Columns::Without(ports.start_columns()), ports.states),
            Clock::Sampled(sampling) => (Columns::Same, sampling.memory(&ports)),
        };
        let prepared = PreparedProgram {
            values: inputs.len() + memory,
            results: outputs.len() + states.len(),
            ports,
            graph: PreparedGraph::new(&program.graph, *precision),
            columns,
            sampling: program.sampling().map(|sampling| PreparedSampling::new(sampling.clone(), ports)),
            simd: Simd::detect(),
        };
        let width = prepared.columns.width(prepared.values);
        let solver = program.integration().map(|_| {
            let driven = inputs.iter().filter(|input| input.role == Role::Input);
            let ranges = driven.map(|input| [input.min, input.max]).collect();
            let arguments = prepared.graph.motion().map(|motion| motion.arguments()).unwrap_or_default();
            Box::new(Solver::new(prepared.values, ranges, program.scales(states), arguments))
        });
        let work = EvaluatorScratch {
            graph: prepared.graph.scratch(),
            columns: ColumnWork::new(width),
            solver,
            samples: prepared.sampling.as_ref().map(|sampling| Box::new(sampling.scratch())),
            results: vec![0.0; prepared.results],
        };
        Self { prepared: Arc::new(prepared), integration: program.integration(), work }
    }

    /// The evaluator with a different integration of its continuous states. Nothing changes without states.
    pub fn with_integration(&self, integration: Integration) -> Self {
        let mut other = self.clone();
        if let Some(own) = &mut other.integration {
            *own = integration;
        }
        other
    }

    /// Results at one point.
    pub fn evaluate(&mut self, point: &[f64], results: &mut [f64]) {
        self.check_results(results);
        self.perform(point, Task::Outputs(results));
    }

    /// Directional derivative `J(point) direction`, exact but for rounding.
    pub fn directional(&mut self, point: &[f64], direction: &[f64], derivative: &mut [f64]) {
        self.check_point(direction);
        self.check_results(derivative);
        let task = Task::Series { rates: [direction, &[]], first: derivative, second: None };
        self.perform(point, task);
    }

    /// First and second derivative of the results along a curve that is at `point` with the derivatives `rates` (first
    /// and second), exact but for rounding.
    pub fn along_curve(&mut self, point: &[f64], rates: [&[f64]; 2], derivatives: [&mut [f64]; 2]) {
        rates.iter().for_each(|rate| self.check_point(rate));
        derivatives.iter().for_each(|derivative| self.check_results(derivative));
        let [first, second] = derivatives;
        self.perform(point, Task::Series { rates, first, second: Some(second) });
    }

    /// Adjoint derivative `J(point)^T weights`, exact but for rounding. Of equations it takes as long as a directional derivative
    /// for each column.
    pub fn adjoint(&mut self, point: &[f64], weights: &[f64], gradient: &mut [f64]) {
        self.check_point(gradient);
        self.check_results(weights);
        self.perform(point, Task::Adjoint { weights, gradient });
    }

    /// Integrates the states of a point over a communication step, or advances its samples. Does nothing for a static program. Returns the
    /// number of steps that the solver tried.
    ///
    /// # Errors
    /// A [`StepError`]; the states are as before.
    // the shell of the FMU, which calls it, is optimized for size
    #[inline(never)]
    pub fn advance(&mut self, point: &mut [f64], step: CommunicationStep, drive: Drive) -> Result<u32, StepError> {
        self.check_point(point);
        let Self { prepared, integration, work } = self;
        let PreparedProgram { ports, graph: program, columns, sampling, simd, .. } = &**prepared;
        let EvaluatorScratch { graph, columns: ColumnWork { point: of_graph, .. }, solver, samples, results } = work;
        if let (Some(integration), Some(solver)) = (integration, solver) {
            let has_motion = program.motion().is_some();
            return solver.advance(point, *integration, step, drive, |point, rates, arguments| {
                if has_motion {
                    return program.rates(point, ports.start_columns(), (rates, arguments), graph);
                }
                columns.write(point, of_graph);
                program.perform(*simd, of_graph, Task::Outputs(results), graph);
                rates.copy_from_slice(&results[ports.outputs..]);
            });
        }
        if let (Some(sampling), Some(samples)) = (sampling, samples) {
            sampling.advance(point, step.size, drive, samples, |columns, next| {
                program.perform(*simd, columns, Task::Outputs(next), graph);
            })?;
        }
        Ok(0)
    }

    /// Makes the outputs at the last sample what was measured, and uses it for the next sample; or ends the use of measured outputs. Does
    /// nothing without samples.
    pub fn measure(&self, point: &mut [f64], outputs: Option<&[f64]>) {
        if let Some(sampling) = &self.prepared.sampling {
            sampling.measure(point, outputs);
        }
    }

    /// Columns of a point that are measured outputs; the column after them is 1 while they are used, else 0. None without samples.
    pub fn measured_columns(&self) -> Option<Range<usize>> {
        self.prepared.sampling.as_ref().map(PreparedSampling::measured_columns)
    }

    /// Number of values of a point: inputs, then states or the memory of samples.
    pub fn columns(&self) -> usize {
        self.prepared.values
    }

    /// Number of results: outputs and derivatives of states.
    pub fn results(&self) -> usize {
        self.prepared.results
    }

    /// Initializes the states or the memory of a point from its start values.
    pub fn start(&self, point: &mut [f64]) {
        self.check_point(point);
        let PreparedProgram { ports, sampling, .. } = &*self.prepared;
        match sampling {
            Some(sampling) => sampling.start(point),
            None if self.integration.is_some() => point.copy_within(ports.start_columns(), ports.known()),
            None => {}
        }
    }

    fn check_point(&self, point: &[f64]) {
        assert_eq!(point.len(), self.columns(), "number of inputs and states");
    }

    fn check_results(&self, results: &[f64]) {
        assert_eq!(results.len(), self.results(), "number of outputs and derivatives");
    }

    #[inline]
    fn perform(&mut self, point: &[f64], task: Task) {
        self.check_point(point);
        let EvaluatorScratch { graph, columns, .. } = &mut self.work;
        let prepared = &*self.prepared;
        match (&prepared.sampling, &prepared.columns) {
            (Some(sampling), _) => sampling.perform(point, task),
            (None, Columns::Same) => prepared.graph.perform(prepared.simd, point, task, graph),
            (None, _) => prepared.perform(point, task, columns, graph),
        }
    }
}

impl PreparedProgram {
    /// Performs a task of a point with the columns of the graph, by the chain rule.
    fn perform(&self, inputs: &[f64], task: Task, work: &mut ColumnWork, graph: &mut GraphScratch) {
        let ColumnWork { point, rates: [velocity, change], gradient: by_columns } = work;
        self.columns.write(inputs, point);
        match task {
            Task::Outputs(outputs) => self.graph.perform(self.simd, point, Task::Outputs(outputs), graph),
            Task::Series { rates, first, second } => {
                self.columns.along_curve(point, rates, [velocity, change]);
                let rates: [&[f64]; 2] = if second.is_some() { [velocity, change] } else { [velocity, &[]] };
                self.graph.perform(self.simd, point, Task::Series { rates, first, second }, graph);
            }
            Task::Adjoint { weights, gradient } => {
                self.graph.perform(self.simd, point, Task::Adjoint { weights, gradient: by_columns }, graph);
                self.columns.gradient(point, by_columns, gradient);
            }
        }
    }
}

#[cfg(test)]
mod tests;
