//! Positions of a surrogate's variables in a point.

use crate::{Encoder, FormatError, Input, Metadata, Role, check::expect_shape};
use std::ops::Range;

/// Number of variables by role. The columns of a point with a state are, in this order,
///
/// | columns | |
/// |---|---|
/// | parameters | |
/// | starts | parameters: initial values of states, or outputs and inputs before the start |
/// | inputs | |
/// | states, or the memory of samples | |
///
/// Without a state, a point consists of the inputs in any order, the time included.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ports {
    /// Fixed and tunable parameters.
    pub parameters: usize,
    /// Initial values.
    pub starts: usize,
    /// Inputs that other components drive.
    pub inputs: usize,
    /// Continuous states.
    pub states: usize,
    /// Outputs.
    pub outputs: usize,
}

impl Ports {
    /// Ports of a description.
    pub fn of(Metadata { inputs, states, outputs, .. }: &Metadata) -> Self {
        let roles = inputs.iter().map(|input| input.role);
        Self {
            parameters: roles.clone().filter(|role| matches!(role, Role::Parameter(_))).count(),
            starts: roles.clone().filter(|role| *role == Role::Start).count(),
            inputs: roles.filter(|role| *role == Role::Input).count(),
            states: states.len(),
            outputs: outputs.len(),
        }
    }

    /// Columns of a point that are starts.
    pub fn start_columns(&self) -> Range<usize> {
        self.parameters..self.parameters + self.starts
    }

    /// Columns of a point that are inputs.
    pub fn input_columns(&self) -> Range<usize> {
        let first = self.start_columns().end;
        first..first + self.inputs
    }

    /// Number of columns before the states or the memory.
    pub fn known(&self) -> usize {
        self.input_columns().end
    }

    /// Number of columns and results of a graph without a clock.
    pub(super) fn expect_static(
        &self,
        Metadata { inputs, states, .. }: &Metadata,
    ) -> Result<(usize, usize), FormatError> {
        if let Some(input) = inputs.iter().find(|input| input.role == Role::Start) {
            return Err(FormatError::NoState { name: input.name.clone() });
        }
        expect_shape("states", &[states.len()], &[0])?;
        Ok((Encoder::of(inputs).width(), self.outputs))
    }

    /// Number of columns and results of a graph with states: parameters, inputs and states; outputs and derivatives.
    pub(super) fn expect_continuous(&self, metadata: &Metadata) -> Result<(usize, usize), FormatError> {
        self.expect_order(&metadata.inputs)?;
        if self.states == 0 {
            return Err(FormatError::NoVariables { what: "states" });
        }
        expect_shape("inputs", &[self.starts], &[self.states])?;
        Ok((self.parameters + self.inputs + self.states, self.outputs + self.states))
    }

    /// Checks that variables are parameters, starts and inputs, in this order, without an encoding.
    pub(super) fn expect_order(&self, inputs: &[Input]) -> Result<(), FormatError> {
        let places = inputs.iter().map(|input| match input.role {
            Role::Parameter(_) => 0,
            Role::Start => 1,
            Role::Input => 2,
            Role::Time => 3,
        });
        let places: Vec<usize> = places.collect();
        if !places.is_sorted() || places.last() == Some(&3) {
            return Err(FormatError::Order);
        }
        match inputs.iter().find(|input| !input.encoding.is_plain()) {
            Some(input) => Err(FormatError::Encoding { name: input.name.clone(), expected: "none with states" }),
            None => Ok(()),
        }
    }
}
