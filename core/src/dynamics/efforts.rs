//! Efforts of a mechanism: its forces, actuators and prescribed accelerations, whose expressions become formulas of the equations. Formulas
//! of outputs and rates of actuator states are efforts that act on no coordinate.

use super::windings::Windings;
use crate::multibody::{
    Mechanism, MotionCause, MotionError,
    constraint::{BoundExpression, Slot},
    coordinate::Coordinate,
    model::MultibodyModel,
    reduced::Reduced,
};
use metafmu_runtime::{
    Efforts,
    formula::{ElementaryFunction, Formula, FormulaStep},
};

/// Formulas, and the positions that occur in them.
pub(super) struct KnownEfforts {
    bound: Vec<BoundExpression>,
    /// Expression and slot where each position occurs first.
    positions: Vec<(usize, usize)>,
    /// The position of each slot of each expression, if it is one or its rate.
    occurs: Vec<Vec<Option<usize>>>,
    pub(super) windings: Windings,
}

impl KnownEfforts {
    /// Efforts of a mechanism with two sets of parameter values. Positions that agree in both are one position. Unused ones become zero.
    ///
    /// # Errors
    /// An error that says what cannot be built of these values.
    pub(super) fn new(
        mechanism: &Mechanism,
        values: [&[f64]; 2],
        unused: impl Iterator<Item = usize>,
    ) -> Result<Self, MotionError> {
        let [mut bound, elsewhere] = [mechanism.known_expressions(values[0])?, mechanism.known_expressions(values[1])?];
        for index in unused {
            let formula = Formula::new(vec![FormulaStep::Constant(0.0)])?;
            bound[index] = BoundExpression { text: "0".into(), formula, slots: Vec::new() };
        }
        let at =
            |(expression, slot): (usize, usize)| [&bound, &elsewhere].map(|of| position(&of[expression].slots[slot]));
        let mut positions: Vec<(usize, usize)> = Vec::new();
        let mut occurs = Vec::new();
        for (expression, of) in bound.iter().enumerate() {
            let of_slots = (0..of.slots.len()).map(|slot| {
                let this = (expression, slot);
                at(this)[0]?;
                let known = positions.iter().position(|known| at(*known) == at(this));
                Some(known.unwrap_or_else(|| {
                    positions.push(this);
                    positions.len() - 1
                }))
            });
            occurs.push(of_slots.collect());
        }
        Ok(Self { bound, positions, occurs, windings: Windings::default() })
    }

    /// Number of efforts, prescribed accelerations, formulas of outputs and rates of actuator states.
    pub(super) fn count(&self) -> usize {
        self.bound.len()
    }

    /// Number of positions in their formulas.
    pub(super) fn positions(&self) -> usize {
        self.positions.len()
    }

    /// Flag for each position: true if it is an angle.
    pub(super) fn are_angles(&self) -> impl Iterator<Item = bool> + '_ {
        let positions =
            self.positions.iter().filter_map(|(expression, slot)| position(&self.bound[*expression].slots[*slot]));
        positions.map(|position| position.is_angle())
    }

    /// The positions of a model with values for the parameters.
    pub(super) fn positions_of(&self, model: &MultibodyModel) -> Vec<Coordinate> {
        let bound: Vec<&BoundExpression> = model.known_expressions().collect();
        self.positions.iter().filter_map(|(expression, slot)| position(&bound[*expression].slots[*slot])).collect()
    }

    /// Finds how the positions turn with the coordinates.
    ///
    /// # Errors
    /// As [`Windings::find`].
    pub(super) fn wind(&mut self, reduced: &Reduced) -> Result<(), MotionError> {
        self.windings = Windings::find(&self.positions_of(reduced.model()), reduced)?;
        Ok(())
    }

    /// Returns true if a formula has a function that repeats itself: a periodic table, or a sine, cosine or tangent.
    pub(super) fn have_periods(&self) -> bool {
        self.bound.iter().any(|bound| bound.formula.steps().iter().any(is_periodic))
    }

    /// Returns true if a position, not its rate alone, occurs that moves along with one of `n` coordinates.
    pub(super) fn has_position_along(&self, coordinate: usize, n: usize) -> bool {
        self.slots().any(|(slot, occurs)| match (slot, occurs) {
            (Slot::Position(_), Some(position)) => self.windings.0[position * n + coordinate] != 0.0,
            _ => false,
        })
    }

    /// Returns true if the value of a position, not its rate alone, occurs.
    pub(super) fn has_position(&self, position: usize) -> bool {
        self.slots().any(|(slot, occurs)| matches!(slot, Slot::Position(_)) && occurs == Some(position))
    }

    /// The slots of all formulas, each with its position, if it has one.
    fn slots(&self) -> impl Iterator<Item = (&Slot, Option<usize>)> {
        let formulas = self.bound.iter().zip(&self.occurs);
        formulas.flat_map(|(bound, occurs)| bound.slots.iter().zip(occurs.iter().copied()))
    }

    /// Returns true if a parameter occurs, by its position in the mechanism.
    pub(super) fn has_parameter(&self, parameter: usize) -> bool {
        let mut slots = self.bound.iter().flat_map(|bound| &bound.slots);
        slots.any(|slot| matches!(slot, Slot::Parameter(known, _) if *known == parameter))
    }

    /// Formulas for equations whose parameters are those at the positions `varied` in the mechanism. The others are constants.
    ///
    /// # Errors
    /// An error: a formula depends on time.
    pub(super) fn formulas(&self, varied: &[usize], inputs: usize, coordinates: usize) -> Result<Efforts, MotionError> {
        let formulas = self.bound.iter().zip(&self.occurs).map(|(bound, occurs)| -> Result<Formula, MotionError> {
            let leaves = bound.slots.iter().zip(occurs).map(|(slot, occurs)| self.leaf(slot, *occurs, varied, inputs));
            let leaves = leaves.collect::<Option<Vec<_>>>().ok_or_else(|| {
                let message = format!("`{}` depends on time", bound.text);
                MotionError::new(MotionCause::Unsuitable, message)
            })?;
            Ok(bound.formula.with_columns(|name| leaves[name].clone())?)
        });
        let formulas = formulas.collect::<Result<_, _>>()?;
        Ok(Efforts::new([varied.len(), inputs, coordinates], self.windings.0.clone(), formulas)?)
    }

    /// Leaf of a formula for a slot: a column of a varied parameter, an input, a position or its rate, or a constant; None for the time.
    fn leaf(&self, slot: &Slot, occurs: Option<usize>, varied: &[usize], inputs: usize) -> Option<FormulaStep> {
        let first = varied.len() + inputs;
        match (slot, occurs) {
            (Slot::Parameter(parameter, value), _) => match varied.iter().position(|known| known == parameter) {
                Some(column) => Some(FormulaStep::Column(column)),
                None => Some(FormulaStep::Constant(*value)),
            },
            (Slot::Input(input), _) => Some(FormulaStep::Column(varied.len() + input)),
            (Slot::Position(_), Some(position)) => Some(FormulaStep::Column(first + position)),
            (Slot::Velocity(_), Some(position)) => Some(FormulaStep::Column(first + self.positions() + position)),
            (Slot::Time | Slot::Position(_) | Slot::Velocity(_), _) => None,
        }
    }
}

/// Returns true if a step of a formula may have the same value a period later.
fn is_periodic(step: &FormulaStep) -> bool {
    match step {
        FormulaStep::Lookup(table) => (0..table.axes().len()).any(|axis| table.period(axis).is_some()),
        FormulaStep::Call(function) => {
            matches!(function, ElementaryFunction::Sin | ElementaryFunction::Cos | ElementaryFunction::Tan)
        }
        _ => false,
    }
}

/// Position that a slot is the value or the rate of.
fn position(slot: &Slot) -> Option<Coordinate> {
    match slot {
        Slot::Position(coordinate) | Slot::Velocity(coordinate) => Some(*coordinate),
        Slot::Parameter(..) | Slot::Time | Slot::Input(_) => None,
    }
}
