//! Programs: a graph with a clock, which says when it is evaluated and what its results are.

mod columns;
mod evaluator;
mod ports;
pub(crate) mod samples;
mod solver;

use crate::{
    FormatError, Metadata, Motion, State,
    dictionary::Factor,
    graph::{Graph, Step},
};
pub use evaluator::{Evaluator, MAX_OUTPUT_DERIVATIVE_ORDER};
pub use ports::Ports;
pub use samples::{Sampling, Support};
pub use solver::{CommunicationStep, Drive, Integration, MAX_SOLVER_STEPS, Scale, StepError};

/// Function from a point to the outputs of a surrogate. A point consists of one value per input, the time included, and one per state.
#[derive(Clone, Debug, PartialEq)]
pub struct Program {
    /// A function of the columns that [`Ports`] lists for the clock.
    pub graph: Graph,
    /// Evaluation times.
    pub clock: Clock,
}

/// Evaluation times of a graph, and the meaning of its results.
#[derive(Clone, Debug, PartialEq)]
pub enum Clock {
    /// Static: evaluated for outputs, which depend on the present inputs alone.
    Static,
    /// Continuous: evaluated for outputs and derivatives of states. The results are outputs, then derivatives.
    Continuous(Integration),
    /// Sampled: evaluated at samples. The results are the next sample.
    Sampled(Box<Sampling>),
}

impl From<Graph> for Program {
    fn from(graph: Graph) -> Self {
        Self { graph, clock: Clock::Static }
    }
}

impl Program {
    /// Equations of motion.
    pub fn of_motion(motion: Motion, integration: Integration) -> Self {
        let inputs = motion.columns();
        let steps = vec![Step::Motion { of: 0, motion: Box::new(motion) }];
        Self { graph: Graph { inputs, steps }, clock: Clock::Continuous(integration) }
    }

    /// Integration of continuous states, if the program has any.
    pub fn integration(&self) -> Option<Integration> {
        if let Clock::Continuous(integration) = self.clock { Some(integration) } else { None }
    }

    /// The program with a different integration of its continuous states. Nothing changes without states.
    #[must_use]
    pub fn with_integration(mut self, integration: Integration) -> Self {
        if let Clock::Continuous(own) = &mut self.clock {
            *own = integration;
        }
        self
    }

    /// Returns true if outputs depend on the past, through states or samples.
    pub fn has_memory(&self) -> bool {
        self.clock != Clock::Static
    }

    /// The samples, if there are any.
    pub fn sampling(&self) -> Option<&Sampling> {
        if let Clock::Sampled(sampling) = &self.clock { Some(sampling) } else { None }
    }

    /// The equations of motion, if they are the whole graph.
    pub fn motion(&self) -> Option<&Motion> {
        if let [Step::Motion { motion, .. }] = self.graph.steps.as_slice() { Some(motion) } else { None }
    }

    /// Scale of each continuous state.
    pub fn scales(&self, states: &[State]) -> Vec<Scale> {
        let first = self.graph.inputs.saturating_sub(states.len());
        (first..).zip(states).map(|(column, state)| Scale::new(state, self.is_angle(column))).collect()
    }

    /// Returns true if whole turns of a column change no other value.
    pub fn is_angle(&self, column: usize) -> bool {
        self.graph.steps.iter().any(|step| match step {
            // a coordinate without a range is an angle, or nothing depends on it
            Step::Motion { .. } => true,
            Step::Dictionary { of: 0, dictionary } => dictionary.factors().nth(column) == Some(Factor::Angle),
            _ => false,
        })
    }

    /// Checks the program against the inputs, states and outputs of a description.
    ///
    /// # Errors
    /// The first [`FormatError`].
    pub(crate) fn check(&self, metadata: &Metadata) -> Result<(), FormatError> {
        let ports = Ports::of(metadata);
        let (columns, results) = match &self.clock {
            Clock::Static => ports.expect_static(metadata)?,
            Clock::Continuous(integration) => {
                integration.check()?;
                ports.expect_continuous(metadata)?
            }
            Clock::Sampled(sampling) => sampling.check(&ports, &metadata.inputs)?,
        };
        self.graph.check(columns, results)
    }
}
