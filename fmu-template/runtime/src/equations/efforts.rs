//! Efforts: forces, torques and accelerations in [equations of motion](super::dynamics) that have known formulas.

use crate::{
    FormatError,
    check::{expect_below, expect_finite, expect_shape},
    formula::{Formula, FormulaStep, LookupTable},
};
use std::sync::Arc;

/// Forces, torques and prescribed accelerations as formulas of parameters, inputs, positions and their rates.
///
/// The columns of a formula are, in this order,
///
/// | columns | |
/// |---|---|
/// | `p` | parameters |
/// | `u` | inputs |
/// | `r` | positions `r(q, p) + w^T q`, whose functions `r` are those of the equations |
/// | `rd` | their rates |
#[derive(Clone, Debug, PartialEq)]
pub struct Efforts {
    parameters: usize,
    inputs: usize,
    /// `w` of each position, shape `[positions, coordinates]`.
    windings: Vec<f64>,
    coordinates: usize,
    formulas: Vec<Formula>,
}

/// A damaged file must not claim more memory than there is.
const MOST_INPUTS: usize = 1 << 16;

/// Quantity in a column of a formula.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EffortColumn {
    /// A parameter.
    Parameter(usize),
    /// An input.
    Input(usize),
    /// A position.
    Position(usize),
    /// The rate of a position.
    Rate(usize),
}

impl Efforts {
    /// Efforts from their formulas, in equations with these numbers of parameters, inputs and coordinates.
    ///
    /// # Errors
    /// [`FormatError`] if there are too many inputs, a position does not have a winding for each coordinate, or a
    /// formula has a column beyond the last.
    pub fn new(
        [parameters, inputs, coordinates]: [usize; 3],
        windings: Vec<f64>,
        formulas: Vec<Formula>,
    ) -> Result<Self, FormatError> {
        expect_below(&"efforts.inputs", 0, inputs, MOST_INPUTS)?;
        let positions = windings.len().checked_div(coordinates).unwrap_or(0);
        expect_shape("efforts.windings", &[windings.len()], &[positions * coordinates])?;
        expect_finite("efforts.windings", windings.iter().copied())?;
        let efforts = Self { parameters, inputs, windings, coordinates, formulas };
        let limit = parameters + inputs + 2 * positions;
        for (index, formula) in efforts.formulas.iter().enumerate() {
            for column in formula.columns() {
                expect_below(&"efforts.steps", index, column, limit)?;
            }
        }
        Ok(efforts)
    }

    /// Efforts that are the inputs.
    pub fn of_inputs([parameters, inputs, coordinates]: [usize; 3]) -> Self {
        let formulas = (0..inputs).map(|input| Formula::column(parameters + input)).collect();
        Self { parameters, inputs, windings: Vec::new(), coordinates, formulas }
    }

    /// Numbers of parameters, inputs and coordinates.
    pub(crate) fn counts(&self) -> [usize; 3] {
        [self.parameters, self.inputs, self.coordinates]
    }

    /// Number of efforts.
    pub fn count(&self) -> usize {
        self.formulas.len()
    }

    /// Number of inputs.
    pub fn inputs(&self) -> usize {
        self.inputs
    }

    /// Number of positions.
    pub fn positions(&self) -> usize {
        self.windings.len().checked_div(self.coordinates).unwrap_or(0)
    }

    /// `w` of each position, shape `[positions, coordinates]`.
    pub fn windings(&self) -> &[f64] {
        &self.windings
    }

    /// A formula for each effort.
    pub fn formulas(&self) -> &[Formula] {
        &self.formulas
    }

    /// Lookup tables in the formulas, each once.
    pub fn tables(&self) -> Vec<&Arc<LookupTable>> {
        let mut tables: Vec<&Arc<LookupTable>> = Vec::new();
        for step in self.formulas.iter().flat_map(Formula::steps) {
            if let FormulaStep::Lookup(table) = step
                && !tables.contains(&table)
            {
                tables.push(table);
            }
        }
        tables
    }

    /// Quantity in a column of the formulas.
    pub fn column(&self, column: usize) -> EffortColumn {
        let (inputs, positions) = (self.parameters, self.parameters + self.inputs);
        let rates = positions + self.positions();
        match column {
            _ if column < inputs => EffortColumn::Parameter(column),
            _ if column < positions => EffortColumn::Input(column - inputs),
            _ if column < rates => EffortColumn::Position(column - positions),
            _ => EffortColumn::Rate(column - rates),
        }
    }

    /// The columns of a formula.
    pub fn columns(&self, formula: usize) -> impl Iterator<Item = EffortColumn> + '_ {
        self.formulas[formula].columns().map(|column| self.column(column))
    }

    /// Returns true if the value of a position, not its rate alone, is in a formula.
    pub(super) fn has_position(&self, position: usize) -> bool {
        (0..self.count()).any(|formula| self.columns(formula).any(|of| of == EffortColumn::Position(position)))
    }

    /// Returns true if a formula has a column, or a position that moves along with a coordinate, by its position among the
    /// coordinates and parameters. The rate of such a position depends on the coordinate only as far as functions do.
    pub(super) fn depends_on(&self, column: usize) -> bool {
        let n = self.coordinates;
        (0..self.count()).flat_map(|formula| self.columns(formula)).any(|of| match of {
            EffortColumn::Parameter(parameter) => column == n + parameter,
            EffortColumn::Position(position) => column < n && self.windings[position * n + column] != 0.0,
            EffortColumn::Rate(_) | EffortColumn::Input(_) => false,
        })
    }

    /// Returns true if an effort changes with an input.
    pub fn follows_input(&self, effort: usize, input: usize) -> bool {
        self.columns(effort).any(|column| column == EffortColumn::Input(input))
    }

    /// Returns true if every effort is an input.
    pub(super) fn are_inputs(&self) -> bool {
        let inputs = self.parameters..self.parameters + self.inputs;
        self.formulas.iter().all(|formula| inputs.clone().any(|column| *formula == Formula::column(column)))
    }
}
