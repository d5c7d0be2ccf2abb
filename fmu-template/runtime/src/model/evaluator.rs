//! The surrogate prepared for evaluation.

use super::{
    CommunicationStep, Drive, Integration, Model, Scale, StepError,
    discrete::{DiscreteScratch, PreparedDiscrete},
    maps::{Maps, MapsScratch},
    motion::{MotionScratch, PreparedMotion},
    state_space::{PreparedStateSpace, StateSpaceScratch},
};
use crate::{Metadata, Role, map::Task};

/// Highest order of the outputs' derivatives along a curve: the FMU's `maxOutputDerivativeOrder`.
pub const MAX_OUTPUT_DERIVATIVE_ORDER: u32 = 2;

/// A [`Surrogate`](crate::Surrogate) laid out for fast evaluation. Immutable: any number of threads may share it, each with a [`Scratch`]
/// of its own. No evaluation allocates.
///
/// A point has one value for each input and, after them, one for each state, or what a discrete model remembers; results are the
/// outputs and, after them, the states' derivatives with respect to time.
///
/// Every method panics if a slice has the wrong length or the scratch belongs to another evaluator.
#[derive(Clone, Debug)]
pub struct Evaluator {
    columns: usize,
    results: usize,
    /// Of the states.
    scales: Vec<Scale>,
    /// Ranges of the inputs that may change during a step.
    ranges: Vec<[f64; 2]>,
    engine: Engine,
}

#[derive(Clone, Debug)]
enum Engine {
    Maps(Maps),
    Motion(Box<PreparedMotion>),
    StateSpace(Box<PreparedStateSpace>),
    Discrete(Box<PreparedDiscrete>),
}

/// Working memory of one evaluation at a time.
#[derive(Clone, Debug)]
pub struct Scratch(Working);

#[derive(Clone, Debug)]
enum Working {
    Maps(Box<MapsScratch>),
    Motion(Box<MotionScratch>),
    StateSpace(Box<StateSpaceScratch>),
    Discrete(Box<DiscreteScratch>),
}

impl Evaluator {
    /// Lays out the weights and chooses the instruction set.
    pub(crate) fn of(metadata: &Metadata, model: &Model) -> Self {
        let states = metadata.states.len();
        let engine = match model {
            Model::Motion(motion) => Engine::Motion(Box::new(PreparedMotion::new(motion.as_ref().clone()))),
            Model::StateSpace(space) => {
                Engine::StateSpace(Box::new(PreparedStateSpace::new(space, metadata.precision)))
            }
            Model::Discrete(discrete) => {
                Engine::Discrete(Box::new(PreparedDiscrete::new(discrete, metadata.precision)))
            }
            Model::Response(_) | Model::PerInstant { .. } => Engine::Maps(Maps::new(metadata, model)),
        };
        let memory = match &engine {
            Engine::Discrete(discrete) => discrete.memory(),
            Engine::Maps(_) | Engine::Motion(_) | Engine::StateSpace(_) => states,
        };
        let driven = metadata.inputs.iter().filter(|input| input.role == Role::Input);
        Self {
            columns: metadata.inputs.len() + memory,
            results: metadata.outputs.len() + states,
            scales: model.scales(&metadata.states),
            ranges: driven.map(|input| [input.min, input.max]).collect(),
            engine,
        }
    }

    /// The same with another integration of continuous states.
    pub fn with_integration(&self, integration: Integration) -> Self {
        let mut other = self.clone();
        match &mut other.engine {
            Engine::Motion(motion) => motion.integrate_by(integration),
            Engine::StateSpace(space) => space.integrate_by(integration),
            Engine::Maps(_) | Engine::Discrete(_) => {}
        }
        other
    }

    /// Working memory that fits this evaluator.
    pub fn scratch(&self) -> Scratch {
        Scratch(match &self.engine {
            Engine::Maps(maps) => Working::Maps(Box::new(maps.scratch())),
            Engine::Motion(motion) => Working::Motion(Box::new(motion.scratch(&self.scales, &self.ranges))),
            Engine::StateSpace(space) => Working::StateSpace(Box::new(space.scratch(&self.scales, &self.ranges))),
            Engine::Discrete(discrete) => Working::Discrete(Box::new(discrete.scratch())),
        })
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

    /// Adjoint derivative `J(point)^T weights`, exact but for rounding. With states it takes as long as a directional derivative
    /// for each column.
    pub fn adjoint(&self, point: &[f64], weights: &[f64], gradient: &mut [f64], scratch: &mut Scratch) {
        self.check_point(gradient);
        self.check_results(weights);
        self.perform(point, Task::Adjoint { weights, gradient }, scratch);
    }

    /// Integrates the states of a point over a communication step; a discrete model goes on from sample to sample. Nothing happens without
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
        match (&self.engine, &mut scratch.0) {
            (Engine::Maps(_), _) => Ok(0),
            (Engine::Motion(motion), Working::Motion(scratch)) => motion.advance(point, step, drive, scratch),
            (Engine::StateSpace(space), Working::StateSpace(scratch)) => space.advance(point, step, drive, scratch),
            (Engine::Discrete(discrete), Working::Discrete(scratch)) => {
                discrete.advance(point, step.size, drive, scratch).map(|()| 0)
            }
            _ => panic!("{OTHER}"),
        }
    }

    /// Of a discrete model, makes a sample of the outputs what was measured; of other models nothing.
    pub fn correct(&self, point: &mut [f64], outputs: &[f64]) {
        if let Engine::Discrete(discrete) = &self.engine {
            discrete.correct(point, outputs);
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
        let starts = match &self.engine {
            Engine::Maps(_) => return,
            Engine::Motion(motion) => motion.start_columns(),
            Engine::StateSpace(space) => space.start_columns(),
            Engine::Discrete(discrete) => return discrete.start(point),
        };
        let first = self.columns - starts.len();
        point.copy_within(starts, first);
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
        match (&self.engine, &mut scratch.0) {
            (Engine::Maps(maps), Working::Maps(scratch)) => maps.perform(point, task, scratch),
            (Engine::Motion(motion), Working::Motion(scratch)) => motion.perform(point, task, scratch),
            (Engine::StateSpace(space), Working::StateSpace(scratch)) => space.perform(point, task, scratch),
            (Engine::Discrete(discrete), _) => discrete.perform(point, task),
            _ => panic!("{OTHER}"),
        }
    }
}

const OTHER: &str = "the scratch belongs to another evaluator";

#[cfg(test)]
mod tests;
