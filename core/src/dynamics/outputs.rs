//! Learned part of a mechanism's outputs: positions, whose exact derivatives are velocities and accelerations, and
//! forces of joints, drivers and springs.

use super::windings::Windings;
use crate::multibody::{Mechanism, MotionCause, MotionError, coordinate::Coordinate, measure::Measure};
use metafmu_runtime::Shown;

/// The outputs in terms of positions.
#[derive(Clone, Debug, Default)]
pub(super) struct Outputs {
    /// Different ones that the outputs need, for the parameters' defaults.
    pub positions: Vec<Coordinate>,
    /// Which of the mechanism's outputs measures each, or its velocity or acceleration.
    measures: Vec<usize>,
    /// `true` if parameters that vary move the points between which they are measured.
    vary: bool,
    /// Different forces of joints, drivers and springs.
    pub reactions: Vec<Measure>,
    /// Quantity that each output shows.
    pub shown: Vec<Shown>,
    /// Windings of the positions.
    pub windings: Windings,
    /// The effort that is the first formula of an output, and the number of these formulas.
    first_formula: usize,
    formulas: usize,
}

impl Outputs {
    /// Finds outputs of a mechanism by their names.
    ///
    /// # Errors
    /// An error: an output is not known.
    pub(super) fn new(
        mechanism: &Mechanism,
        [defaults, others]: [&[f64]; 2],
        names: &[String],
    ) -> Result<Self, MotionError> {
        let (model, measures) = mechanism.build(defaults)?;
        let elsewhere = mechanism.measures(others)?;
        let first_formula = model.efforts.len() + model.prescribed.len();
        let mut outputs = Self { first_formula, formulas: model.formulas.len(), ..Self::default() };
        let add = |outputs: &mut Self, measure: usize| {
            // two positions may be one for the defaults only
            let is_same = |known: &usize| {
                [&measures, &elsewhere].iter().all(|of| coordinate(&of[*known]) == coordinate(&of[measure]))
            };
            outputs.measures.iter().position(is_same).unwrap_or_else(|| {
                outputs.vary |= coordinate(&measures[measure]) != coordinate(&elsewhere[measure]);
                outputs.positions.extend(coordinate(&measures[measure]));
                outputs.measures.push(measure);
                outputs.measures.len() - 1
            })
        };
        for name in names {
            let position = mechanism.outputs().iter().position(|output| output.name == *name);
            let position = position.ok_or_else(|| {
                let message = format!("the mechanism has no output `{name}`");
                MotionError::of(&format!("outputs.{name}"), MotionCause::Unsuitable, message)
            })?;
            let shown = match &measures[position] {
                Measure::Position(_) => Shown::Position(add(&mut outputs, position)),
                Measure::Velocity(_) => Shown::Velocity(add(&mut outputs, position)),
                Measure::Acceleration(_) => Shown::Acceleration(add(&mut outputs, position)),
                Measure::Formula(formula) => Shown::Effort(outputs.first_formula + formula),
                Measure::KineticEnergy => Shown::KineticEnergy,
                Measure::PotentialEnergy => Shown::PotentialEnergy,
                measure @ (Measure::JointForce { .. }
                | Measure::JointMoment { .. }
                | Measure::DriverEffort(_)
                | Measure::SpringEffort(_)) => Shown::Reaction(outputs.add_reaction(measure)),
            };
            outputs.shown.push(shown);
        }
        Ok(outputs)
    }

    /// The positions for values of all parameters.
    ///
    /// # Errors
    /// As [`Mechanism::measures`].
    pub(super) fn positions_with(&self, mechanism: &Mechanism, values: &[f64]) -> Result<Vec<Coordinate>, MotionError> {
        if !self.vary {
            return Ok(self.positions.clone());
        }
        let measures = mechanism.measures(values)?;
        Ok(self.measures.iter().filter_map(|measure| coordinate(&measures[*measure])).collect())
    }

    /// Efforts that are formulas of other outputs of the mechanism.
    pub(super) fn unused_formulas(&self) -> impl Iterator<Item = usize> + '_ {
        let all = self.first_formula..self.first_formula + self.formulas;
        all.filter(|formula| !self.shown.contains(&Shown::Effort(*formula)))
    }

    fn add_reaction(&mut self, measure: &Measure) -> usize {
        let known = self.reactions.iter().position(|known| known == measure);
        known.unwrap_or_else(|| {
            self.reactions.push(measure.clone());
            self.reactions.len() - 1
        })
    }
}

/// The position that is measured, or whose velocity or acceleration.
fn coordinate(measure: &Measure) -> Option<Coordinate> {
    match measure {
        Measure::Position(coordinate) | Measure::Velocity(coordinate) | Measure::Acceleration(coordinate) => {
            Some(*coordinate)
        }
        _ => None,
    }
}
