//! Positions of a mechanism at coordinates that a surrogate has come to.

use super::{Region, labels::MechanismRegion, outputs::Outputs};
use crate::multibody::{Mechanism, MotionError, coordinate::Coordinate, reduced::Reduced};
use metafmu_runtime::Shown;
use nalgebra::DVector;

/// A mechanism that is put together at given independent coordinates: its closed loops are closed.
pub struct Assembly<'a>(MechanismRegion<'a>);

/// An [`Assembly`] with values for the parameters.
pub struct Assembled<'a> {
    reduced: Reduced,
    positions: Vec<Coordinate>,
    outputs: &'a Outputs,
}

impl<'a> Assembly<'a> {
    /// # Errors
    /// As [`fit`](super::fit).
    pub fn new(mechanism: &'a Mechanism, region: &'a Region) -> Result<Self, MotionError> {
        MechanismRegion::new(mechanism, region).map(Self)
    }

    /// With values of the region's parameters.
    ///
    /// # Errors
    /// An error: what [`Mechanism::reduced`] says.
    pub fn with(&self, parameters: &[f64]) -> Result<Assembled<'_>, MotionError> {
        let Self(labels) = self;
        let point: Vec<f64> =
            std::iter::repeat_n(0.0, labels.coordinates()).chain(parameters.iter().copied()).collect();
        Ok(Assembled {
            reduced: labels.reduced(&point)?,
            positions: labels.positions(&point)?,
            outputs: labels.outputs(),
        })
    }
}

impl Assembled<'_> {
    /// Outputs that are positions, each by its number, at independent coordinates `s`; the configuration is followed from that of the call
    /// before.
    ///
    /// # Errors
    /// An error that names the constraint that is singular on the way.
    pub fn positions(&self, s: &[f64]) -> Result<Vec<(usize, f64)>, MotionError> {
        let q = self.reduced.configuration(&DVector::from_column_slice(s))?;
        let unturned: Vec<f64> = self.outputs.windings.unturned(&self.positions, &q, s).collect();
        let positions = self.outputs.shown.iter().enumerate();
        Ok(positions
            .filter_map(|(output, shown)| match *shown {
                Shown::Position(position) => {
                    let windings = &self.outputs.windings.0[position * s.len()..][..s.len()];
                    let turned: f64 = windings.iter().zip(s).map(|(winding, s)| winding * s).sum();
                    Some((output, unturned[position] + turned))
                }
                _ => None,
            })
            .collect())
    }
}
