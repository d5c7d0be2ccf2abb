//! Positions less what they move along with the coordinates: what a dictionary learns of them.

use crate::multibody::{MotionError, coordinate::Coordinate, reduced::Reduced};
use nalgebra::{DMatrix, DVector};
use std::f64::consts::TAU;

/// Change of each position in a turn of each coordinate that is an angle, by radian, and for each metre of the others, where that is the
/// same everywhere or a whole number: shape `[positions, coordinates]`.
#[derive(Clone, Debug, Default)]
pub(super) struct Windings(pub(super) Vec<f64>);

/// Part of a turn or a metre after which a change is compared with that from the start.
const ELSEWHERE: f64 = 0.3;

impl Windings {
    /// Finds what each position moves along with a coordinate: its change in a turn or a metre. An angle turns with an angle by a whole
    /// number; any other change must be the same from elsewhere, as that of a gear or a rack. A coordinate that cannot go so far is not followed.
    ///
    /// # Errors
    /// As [`Reduced::configuration`].
    pub(super) fn find(positions: &[Coordinate], reduced: &Reduced) -> Result<Self, MotionError> {
        let s = reduced.start().0.clone();
        let n = s.len();
        let mut windings = vec![0.0; positions.len() * n];
        let before = reduced.configuration(&s)?;
        for (k, coordinate) in reduced.coordinates().iter().enumerate() {
            let step = if coordinate.is_angle() { TAU } else { 1.0 };
            let moved = |by: f64| {
                let moved = DVector::from_fn(n, |row, _| s[row] + if row == k { by } else { 0.0 });
                reduced.configuration(&moved).ok()
            };
            let Some(after) = moved(step) else { continue };
            let elsewhere = Option::zip(moved(ELSEWHERE * step), moved((1.0 + ELSEWHERE) * step));
            for (index, position) in positions.iter().enumerate() {
                let change = (position.value(&after) - position.value(&before)) / step;
                let is_whole = position.is_angle() == coordinate.is_angle() && (change - change.round()).abs() < 1e-9;
                let is_same = elsewhere.as_ref().is_some_and(|(before, after)| {
                    let other = (position.value(after) - position.value(before)) / step;
                    (other - change).abs() < 1e-9 * (1.0 + change.abs())
                });
                if is_whole || is_same {
                    windings[index * n + k] =
                        if (change - change.round()).abs() < 1e-9 { change.round() } else { change };
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
