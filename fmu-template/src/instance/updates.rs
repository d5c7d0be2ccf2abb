//! Communication steps with intermediate updates: the host may read outputs, set inputs and return early.

use super::Instance;
use crate::{
    state::{InstanceState, Interface, Version},
    status::Refusal,
};
use metafmu_runtime::MAX_SOLVER_STEPS;

impl Instance {
    /// Returns true if a host can be called back in the middle of a step: between steps of the solver.
    pub(crate) fn offers_updates(&self) -> bool {
        (self.kind.version, self.kind.interface) == (Version::Fmi3, Interface::CoSimulation)
            && self.integration.is_some()
    }

    /// Returns true if there are inputs, which can be set in intermediate updates.
    pub(crate) fn has_inputs(&self) -> bool {
        !self.input_columns.is_empty()
    }

    /// Makes sure that a variable exists. All can be read in intermediate updates, also those that the standard does not let a
    /// description mark, such as `in_domain`, which is not continuous: hosts name all outputs.
    pub(crate) fn check_intermediate(&self, reference: u32) -> Result<(), Refusal> {
        self.quantity(reference).map(drop)
    }

    /// Begins a communication step with updates: how many steps of the solver, all of the same size, it is divided into.
    pub(crate) fn begin_updates(&mut self, from: f64, size: f64) -> Result<f64, Refusal> {
        self.check_step(from, size)?;
        self.before.copy_from(&self.now);
        let steps = self.integration.map_or(1.0, |integration| integration.parts(size));
        // too many are refused by the solver
        Ok(if steps > MAX_SOLVER_STEPS { 1.0 } else { steps })
    }

    /// Makes one of these steps, `since` seconds after the beginning of the communication step.
    pub(crate) fn step_to_update(&mut self, since: f64, from: f64, size: f64) -> Result<(), Refusal> {
        self.since = since;
        let answer = self.do_step(from, size);
        self.since = 0.0;
        answer
    }

    /// Gives back what was when the communication step began, for a host that may try it again.
    pub(crate) fn undo_updates(&mut self) {
        self.now.copy_from(&self.before);
        self.stale = true;
    }

    pub(crate) fn enter_update(&mut self) {
        self.now.state = InstanceState::IntermediateUpdate;
    }

    /// A call that was refused has ended the simulation.
    pub(crate) fn leave_update(&mut self) {
        if self.now.state == InstanceState::IntermediateUpdate {
            self.now.state = InstanceState::Step;
        }
    }
}
