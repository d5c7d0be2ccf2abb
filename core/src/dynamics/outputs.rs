//! What of the outputs of a mechanism is learned: positions, of which velocities and accelerations are exact derivatives, and forces of
//! joints, drivers and springs.

use crate::multibody::{Mechanism, coordinate::Coordinate, measure::Measure, reduced::Reduced};
use metafmu_runtime::Shown;
use nalgebra::{DMatrix, DVector};
use std::f64::consts::TAU;

/// The outputs in terms of positions.
#[derive(Clone, Debug, Default)]
pub(super) struct Outputs {
    /// Different ones that the outputs need, for the parameters' defaults.
    pub positions: Vec<Coordinate>,
    /// Which of the mechanism's outputs measures each, or its velocity or acceleration.
    measures: Vec<usize>,
    /// Whether parameters that vary move the points between which they are measured.
    vary: bool,
    /// Different forces of joints, drivers and springs, and the name of an output that shows each.
    pub reactions: Vec<(String, Measure)>,
    /// What each output is.
    pub shown: Vec<Shown>,
    /// Turns of each position in a turn of each coordinate that is an angle, and change of each for each metre of the others where that
    /// is a whole number: shape `[positions, coordinates]`.
    pub windings: Vec<f64>,
}

impl Outputs {
    /// Finds outputs of a mechanism by their names.
    ///
    /// # Errors
    /// A sentence: an output is not known.
    pub(super) fn new(
        mechanism: &Mechanism,
        [defaults, others]: [&[f64]; 2],
        names: &[String],
    ) -> Result<Self, String> {
        let (measures, elsewhere) = (mechanism.measures(defaults)?, mechanism.measures(others)?);
        let mut outputs = Self::default();
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
            let position = position.ok_or_else(|| format!("the mechanism has no output `{name}`"))?;
            let shown = match &measures[position] {
                Measure::Position(_) => Shown::Position(add(&mut outputs, position)),
                Measure::Velocity(_) => Shown::Velocity(add(&mut outputs, position)),
                Measure::Acceleration(_) => Shown::Acceleration(add(&mut outputs, position)),
                Measure::KineticEnergy => Shown::KineticEnergy,
                Measure::PotentialEnergy => Shown::PotentialEnergy,
                measure @ (Measure::JointForce { .. }
                | Measure::JointMoment { .. }
                | Measure::DriverEffort(_)
                | Measure::SpringEffort(_)) => Shown::Reaction(outputs.add_reaction(name, measure)),
            };
            outputs.shown.push(shown);
        }
        Ok(outputs)
    }

    /// The positions for values of all parameters.
    ///
    /// # Errors
    /// A sentence, as [`Mechanism::measures`].
    pub(super) fn positions_with(&self, mechanism: &Mechanism, values: &[f64]) -> Result<Vec<Coordinate>, String> {
        if !self.vary {
            return Ok(self.positions.clone());
        }
        let measures = mechanism.measures(values)?;
        Ok(self.measures.iter().filter_map(|measure| coordinate(&measures[*measure])).collect())
    }

    fn add_reaction(&mut self, name: &str, measure: &Measure) -> usize {
        let known = self.reactions.iter().position(|(_, known)| known == measure);
        known.unwrap_or_else(|| {
            self.reactions.push((name.into(), measure.clone()));
            self.reactions.len() - 1
        })
    }

    /// Finds how often each position turns in a turn of each coordinate that is an angle, and which positions move along with the
    /// others: the whole number that is left of the change after a turn or a metre. A coordinate that cannot go so far is not followed.
    pub(super) fn wind(&mut self, reduced: &Reduced) -> Result<(), String> {
        let s = reduced.start().0.clone();
        let n = s.len();
        self.windings = vec![0.0; self.positions.len() * n];
        let before = reduced.configuration(&s)?;
        for (k, coordinate) in reduced.coordinates().iter().enumerate() {
            let step = if coordinate.is_angle() { TAU } else { 1.0 };
            let moved = DVector::from_fn(n, |row, _| s[row] + if row == k { step } else { 0.0 });
            let Ok(after) = reduced.configuration(&moved) else { continue };
            let alike = self.positions.iter().enumerate();
            for (index, position) in alike.filter(|(_, position)| position.is_angle() == coordinate.is_angle()) {
                let change = (position.value(&after) - position.value(&before)) / step;
                if (change - change.round()).abs() < 1e-9 {
                    self.windings[index * n + k] = change.round();
                }
            }
        }
        Ok(())
    }

    /// Positions without their turns, in a configuration of the bodies that belongs to the coordinates `s`.
    pub(super) fn labels(&self, positions: &[Coordinate], q: &DVector<f64>, s: &[f64]) -> impl Iterator<Item = f64> {
        positions.iter().zip(self.windings.chunks(s.len())).map(move |(position, windings)| {
            let turned: f64 = windings.iter().zip(s).map(|(winding, s)| winding * s).sum();
            position.value(q) - turned
        })
    }

    /// Derivatives of these with respect to the coordinates, shape `[positions, coordinates]`; `velocities` are those of the bodies in
    /// the configuration, shape `[3 bodies, coordinates]`.
    pub(super) fn gradients(
        &self,
        positions: &[Coordinate],
        q: &DVector<f64>,
        velocities: &DMatrix<f64>,
    ) -> impl Iterator<Item = f64> {
        let n = velocities.ncols();
        positions.iter().enumerate().flat_map(move |(index, position)| {
            (0..n).map(move |k| position.rate(q, &velocities.column(k).into_owned()) - self.windings[index * n + k])
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
