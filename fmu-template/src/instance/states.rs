//! The continuous states: set and read by a solver around the FMU, or integrated by the one inside it; and the memory of samples.

use super::Instance;
use crate::{
    state::InstanceState,
    status::{Implausible, Refusal, Status},
};
use metafmu_runtime::{CommunicationStep, DomainPolicy, Drive, Role, StepError};
use std::mem::swap;

impl Instance {
    /// Returns true if outputs depend on the past: there are states, or a memory.
    #[inline]
    pub(super) fn has_memory(&self) -> bool {
        self.point.len() > self.metadata.inputs.len()
    }

    /// The states' values.
    pub(crate) fn states(&self) -> &[f64] {
        &self.now.values[self.metadata.inputs.len()..][..self.metadata.states.len()]
    }

    /// Nominal values of the states, which a solver's tolerance is relative to.
    pub(crate) fn nominals(&self) -> &[f64] {
        &self.nominals
    }

    /// The states' derivatives with respect to time.
    pub(crate) fn derivatives(&mut self) -> Result<&[f64], Refusal> {
        self.update_results()?;
        Ok(&self.results[self.metadata.outputs.len()..])
    }

    /// States that a solver tries. Those that are not finite are discarded, as both standards provide: a solver whose step diverged tries
    /// again with a smaller one.
    pub(crate) fn set_states(&mut self, states: &[f64]) -> Result<(), Refusal> {
        if let Some(&value) = states.iter().find(|state| !state.is_finite()) {
            return Err(Refusal::StateNotFinite { argument: "continuousStates", value });
        }
        let first = self.metadata.inputs.len();
        self.now.values[first..].copy_from_slice(states);
        self.stale = true;
        Ok(())
    }

    /// Returns true if the states are still those that the start parameters give.
    pub(super) fn is_starting(&self) -> bool {
        matches!(self.now.state, InstanceState::Instantiated | InstanceState::Initialization)
    }

    /// Initializes the states, or the memory, until the simulation runs.
    pub(super) fn initialize_states(&mut self) {
        if self.is_starting() {
            self.start_states();
        }
    }

    fn start_states(&mut self) {
        // inputs that act directly do so as clamped
        self.update_point();
        let Self { input_columns, now, point, .. } = self;
        input_columns.iter().for_each(|&column| swap(&mut now.values[column], &mut point[column]));
        self.evaluator.start(&mut now.values);
        input_columns.iter().for_each(|&column| swap(&mut now.values[column], &mut point[column]));
    }

    /// Follows a parameter that got another value after the initialization, at the start time. Start values of states are those of the
    /// states, and the memory of samples follows all parameters.
    #[cold]
    pub(super) fn restart(&mut self, column: usize) {
        if !self.is_smooth {
            self.start_states();
        } else if self.metadata.inputs[column].role == Role::Start {
            let state = self.started_by(column);
            self.now.values[state] = self.now.values[column];
        }
    }

    /// The column of the state whose start value a parameter is.
    pub(super) fn started_by(&self, column: usize) -> usize {
        let starts = self.metadata.inputs[..column].iter().filter(|input| input.role == Role::Start);
        self.metadata.inputs.len() + starts.count()
    }

    /// Advances the states over a communication step that ends at `time`, by integration or from sample to sample.
    /// Inputs follow the derivatives that the host gave.
    pub(super) fn advance_states(&mut self, time: f64, size: f64, refused: Status) -> Result<(), Refusal> {
        let first = self.metadata.inputs.len();
        // those of results that were computed here
        let is_known = !self.stale && !self.metadata.states.is_empty();
        self.update_point();
        // inputs are clamped on the way
        for &column in &self.input_columns {
            self.point[column] = self.now.values[column];
        }
        let clamp = (self.now.policy == DomainPolicy::Clamp).then_some(&self.domain);
        let drive = Drive { rates: self.now.rates.each_ref().map(Vec::as_slice), clamp };
        let step = CommunicationStep {
            tolerance: Some(self.now.tolerance).filter(|tolerance| *tolerance > 0.0),
            derivatives: is_known.then(|| &self.results[self.metadata.outputs.len()..]),
            ..CommunicationStep::of(size)
        };
        let made = self.evaluator.advance(&mut self.point, step, drive);
        if let Err(error) = made {
            return Err(self.step_refused(error, size, refused));
        }
        let states = first..self.domain.columns();
        for column in states.clone() {
            self.check_value(column, self.point[column], time, self.now.policy, refused)?;
        }
        self.now.values[first..].copy_from_slice(&self.point[first..]);
        self.stale = true;
        states.for_each(|column| self.note_value(column));
        Ok(())
    }

    /// Why a step was not made, and where in the communication step.
    fn step_refused(&self, error: StepError, size: f64, status: Status) -> Refusal {
        match error {
            StepError::NotFinite { after } if self.metadata.states.is_empty() => {
                Refusal::OutputsDiverged { after: self.since + after, status }
            }
            StepError::NotFinite { after } => Refusal::Diverged { after: self.since + after, status },
            StepError::Implausible { state, value, after } => {
                Refusal::Implausible { after: Some(self.since + after), of: self.implausible(state, value), status }
            }
            StepError::Underflow { after } => Refusal::Underflow { after: self.since + after, status },
            StepError::TooManySteps => Refusal::LongStep { size },
        }
    }

    /// Makes sure that no state that a solver around the FMU has accepted is beyond what is plausible.
    pub(super) fn expect_plausible(&self) -> Result<(), Refusal> {
        let limits = self.metadata.states.iter().map(metafmu_runtime::State::limit);
        for (state, (value, limit)) in self.states().iter().zip(limits).enumerate() {
            // a NaN is implausible as well
            if value.is_nan() || value.abs() > limit {
                let of = self.implausible(state, *value);
                return Err(Refusal::Implausible { after: None, of, status: Status::Error });
            }
        }
        Ok(())
    }

    fn implausible(&self, state: usize, value: f64) -> Implausible {
        let state = &self.metadata.states[state];
        Implausible { name: state.name.clone(), value, valid: state.valid(), limit: state.limit() }
    }
}
