//! The prismatic joint: the second body slides along an axis of the first, at a constant angle to it.

use super::{Coordinate, Ends, JointOption, Measure, Measures, Range, force, moment};
use nalgebra::Vector2;

/// Its optional keys.
pub(super) const OPTIONS: &[JointOption] = &[JointOption::Axis, JointOption::Angle];

/// Holds the component of the difference of its points across the axis, and the angle; leaves the component along the axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prismatic {
    /// The connected points.
    pub ends: Ends,
    /// Direction of the translation, in the frame of the first body; a unit vector.
    pub axis: Vector2<f64>,
    /// Angle of the second body relative to the first, in rad.
    pub angle: f64,
}

impl Prismatic {
    pub(super) fn held(&self) -> [(Coordinate, f64); 2] {
        let across = Vector2::new(-self.axis.y, self.axis.x);
        [(self.ends.along(across), 0.0), (self.ends.angle(), self.angle)]
    }

    pub(super) fn free(&self) -> Coordinate {
        self.ends.along(self.axis)
    }

    pub(super) fn measures(&self, rows: Range<usize>) -> Measures {
        let position = [
            ("position", Measure::Position(self.free())),
            ("velocity", Measure::Velocity(self.free())),
            ("acceleration", Measure::Acceleration(self.free())),
        ];
        position.into_iter().chain(force(&rows)).chain([moment(rows)]).collect()
    }
}
