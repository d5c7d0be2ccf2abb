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
        let both = [&measures[..], &elsewhere];
        for name in names {
            let position = mechanism.outputs().iter().position(|output| output.name == *name);
            let position = position.ok_or_else(|| {
                let message = format!("the mechanism has no output `{name}`");
                MotionError::of(&format!("outputs.{name}"), MotionCause::Unsuitable, message)
            })?;
            let shown = match &measures[position] {
                Measure::Position(_) => Shown::Position(outputs.add_position(position, both)),
                Measure::Velocity(_) => Shown::Velocity(outputs.add_position(position, both)),
                Measure::Acceleration(_) => Shown::Acceleration(outputs.add_position(position, both)),
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

    /// Place of the position that a measure is of, which is added unless it is known. `both` are all measures for two sets of parameters.
    fn add_position(&mut self, measure: usize, both: [&[Measure]; 2]) -> usize {
        // two positions may be one for the defaults only
        let known = self
            .measures
            .iter()
            .position(|known| both.iter().all(|of| coordinate(&of[*known]) == coordinate(&of[measure])));
        known.unwrap_or_else(|| {
            let [position, elsewhere] = both.map(|of| coordinate(&of[measure]));
            self.vary |= position != elsewhere;
            self.positions.extend(position);
            self.measures.push(measure);
            self.measures.len() - 1
        })
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
