//! Where a surrogate's variables are in a point, and which of them are columns of the graph.

use crate::{Encoder, FormatError, Input, Metadata, Role, check::expect_shape};
use std::ops::Range;

/// Numbers of a surrogate's variables by their roles. The columns of a point with a state are, in this order,
///
/// | columns | |
/// |---|---|
/// | parameters | |
/// | starts | parameters, too: only the values of states at initialization, or what outputs and inputs were before the start |
/// | inputs | |
/// | states, or the memory of samples | |
///
/// Without a state they are the inputs in any order, the time among them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ports {
    /// Fixed and tunable ones.
    pub parameters: usize,
    /// Values at the start.
    pub starts: usize,
    /// What other components drive.
    pub inputs: usize,
    /// Continuous states.
    pub states: usize,
    /// Outputs.
    pub outputs: usize,
}

impl Ports {
    /// Those of a description.
    pub fn of(Metadata { inputs, states, outputs, .. }: &Metadata) -> Self {
        let count = |is_wanted: fn(Role) -> bool| inputs.iter().filter(|input| is_wanted(input.role)).count();
        Self {
            parameters: count(|role| matches!(role, Role::Parameter(_))),
            starts: count(|role| role == Role::Start),
            inputs: count(|role| role == Role::Input),
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
    pub(super) fn known(&self) -> usize {
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

    /// Makes sure that inputs are parameters, starts and inputs, in this order, and are what they are.
    pub(super) fn expect_order(&self, inputs: &[Input]) -> Result<(), FormatError> {
        let place = |role: Role| match role {
            Role::Parameter(_) => 0,
            Role::Start => 1,
            Role::Input => 2,
            Role::Time => 3,
        };
        let places: Vec<usize> = inputs.iter().map(|input| place(input.role)).collect();
        if !places.is_sorted() || places.last() == Some(&3) {
            return Err(FormatError::Order);
        }
        match inputs.iter().find(|input| !input.encoding.is_plain()) {
            Some(input) => Err(FormatError::Encoding { name: input.name.clone(), expected: "none with states" }),
            None => Ok(()),
        }
    }
}
