//! What of the outputs of a mechanism is learned: positions, of which velocities and accelerations are exact derivatives, and forces of
//! joints and springs.

use crate::multibody::{Mechanism, coordinate::Coordinate, measure::Measure, reduced::Reduced};
use metafmu_runtime::Shown;
use nalgebra::{DMatrix, DVector};
use std::f64::consts::TAU;

/// The outputs in terms of positions.
#[derive(Clone, Debug, Default)]
pub(super) struct Outputs {
    /// Different ones that the outputs need.
    pub positions: Vec<Coordinate>,
    /// Different forces of joints and springs, and the name of an output that shows each.
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
    /// A sentence: an output is not known, or the effort of a driver.
    pub(super) fn new(mechanism: &Mechanism, values: &[f64], names: &[String]) -> Result<Self, String> {
        let measures = mechanism.measures(values)?;
        let mut outputs = Self::default();
        for name in names {
            let position = mechanism.outputs().iter().position(|output| output.name == *name);
            let measure = position.map(|position| &measures[position]);
            let shown = match measure.ok_or_else(|| format!("the mechanism has no output `{name}`"))? {
                Measure::Position(coordinate) => Shown::Position(outputs.add(*coordinate)),
                Measure::Velocity(coordinate) => Shown::Velocity(outputs.add(*coordinate)),
                Measure::Acceleration(coordinate) => Shown::Acceleration(outputs.add(*coordinate)),
                Measure::KineticEnergy => Shown::KineticEnergy,
                Measure::PotentialEnergy => Shown::PotentialEnergy,
                measure @ (Measure::JointForce { .. } | Measure::JointMoment { .. } | Measure::SpringEffort(_)) => {
                    Shown::Reaction(outputs.add_reaction(name, measure))
                }
                Measure::DriverEffort(_) => {
                    let expected = "expected a position, velocity, acceleration, energy, or force of a joint or spring";
                    return Err(format!("the output `{name}` is the effort of a driver, {expected}"));
                }
            };
            outputs.shown.push(shown);
        }
        Ok(outputs)
    }

    fn add(&mut self, coordinate: Coordinate) -> usize {
        let known = self.positions.iter().position(|known| *known == coordinate);
        known.unwrap_or_else(|| {
            self.positions.push(coordinate);
            self.positions.len() - 1
        })
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

    /// The positions without their turns, in a configuration of the bodies that belongs to the coordinates `s`.
    pub(super) fn labels(&self, q: &DVector<f64>, s: &[f64]) -> impl Iterator<Item = f64> {
        self.positions.iter().zip(self.windings.chunks(s.len())).map(move |(position, windings)| {
            let turned: f64 = windings.iter().zip(s).map(|(winding, s)| winding * s).sum();
            position.value(q) - turned
        })
    }

    /// Derivatives of these with respect to the coordinates, shape `[positions, coordinates]`; `velocities` are those of the bodies in
    /// the configuration, shape `[3 bodies, coordinates]`.
    pub(super) fn gradients(&self, q: &DVector<f64>, velocities: &DMatrix<f64>) -> impl Iterator<Item = f64> {
        let n = velocities.ncols();
        self.positions.iter().enumerate().flat_map(move |(index, position)| {
            (0..n).map(move |k| position.rate(q, &velocities.column(k).into_owned()) - self.windings[index * n + k])
        })
    }
}
