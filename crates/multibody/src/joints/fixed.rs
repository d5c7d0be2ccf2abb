//! The fixed joint: two bodies move as one.

use super::{Coordinate, Ends, JointOption, Measures, Range, force, moment};

/// Its optional keys.
pub(super) const OPTIONS: &[JointOption] = &[JointOption::Angle];

/// Holds both components of the difference of its points, and the angle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FixedJoint {
    /// The connected points.
    pub ends: Ends,
    /// Angle of the second body relative to the first, in rad.
    pub angle: f64,
}

impl FixedJoint {
    pub(super) fn held(&self) -> [(Coordinate, f64); 3] {
        let [x, y] = self.ends.difference();
        [(x, 0.0), (y, 0.0), (self.ends.angle(), self.angle)]
    }

    pub(super) fn measures(&self, rows: Range<usize>) -> Measures {
        force(&rows).into_iter().chain([moment(rows)]).collect()
    }
}
