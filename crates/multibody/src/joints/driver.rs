//! The driver: any coordinate of the mechanism follows a function of time, or has a prescribed acceleration, which is
//! not a constraint of positions ([`Prescribed`](crate::model::Prescribed)).

use super::{Coordinate, Measure, Measures};
use crate::constraint::{BoundExpression, Target};

/// Holds one coordinate at a motion.
#[derive(Clone, Debug)]
pub struct Driver {
    /// The coordinate.
    pub coordinate: Coordinate,
    /// Its value, of `time` alone.
    pub motion: BoundExpression,
}

impl Driver {
    /// The coordinate that its constraint prescribes, and its motion.
    pub fn held(self) -> (Coordinate, Target) {
        (self.coordinate, Target::Motion(self.motion))
    }

    /// Measures of a driver of either kind whose multiplier is `row`.
    pub fn measures(row: usize) -> Measures {
        vec![("effort", Measure::DriverEffort(row))]
    }
}
