//! Positions less the turns of the coordinates: what a dictionary learns of them.

use crate::multibody::{coordinate::Coordinate, reduced::Reduced};
use nalgebra::{DMatrix, DVector};
use std::f64::consts::TAU;

/// Turns of each position in a turn of each coordinate that is an angle, and change of each for each metre of the others where that is a
/// whole number: shape `[positions, coordinates]`.
#[derive(Clone, Debug, Default)]
pub(super) struct Windings(pub(super) Vec<f64>);

impl Windings {
    /// Finds how often each position turns in a turn of each coordinate that is an angle, and which positions move along with the
    /// others: the whole number that is left of the change after a turn or a metre. A coordinate that cannot go so far is not followed.
    ///
    /// # Errors
    /// A sentence, as [`Reduced::configuration`].
    pub(super) fn find(positions: &[Coordinate], reduced: &Reduced) -> Result<Self, String> {
        let s = reduced.start().0.clone();
        let n = s.len();
        let mut windings = vec![0.0; positions.len() * n];
        let before = reduced.configuration(&s)?;
        for (k, coordinate) in reduced.coordinates().iter().enumerate() {
            let step = if coordinate.is_angle() { TAU } else { 1.0 };
            let moved = DVector::from_fn(n, |row, _| s[row] + if row == k { step } else { 0.0 });
            let Ok(after) = reduced.configuration(&moved) else { continue };
            let alike = positions.iter().enumerate();
            for (index, position) in alike.filter(|(_, position)| position.is_angle() == coordinate.is_angle()) {
                let change = (position.value(&after) - position.value(&before)) / step;
                if (change - change.round()).abs() < 1e-9 {
                    windings[index * n + k] = change.round();
                }
            }
        }
        Ok(Self(windings))
    }

    /// Positions without their turns, in a configuration of the bodies that belongs to the coordinates `s`.
    pub(super) fn unturned(&self, positions: &[Coordinate], q: &DVector<f64>, s: &[f64]) -> impl Iterator<Item = f64> {
        positions.iter().zip(self.0.chunks(s.len())).map(move |(position, windings)| {
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
            (0..n).map(move |k| position.rate(q, &velocities.column(k).into_owned()) - self.0[index * n + k])
        })
    }
}
