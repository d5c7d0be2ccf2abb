//! The revolute joint: its two points coincide, the bodies rotate about them.

use super::{Coordinate, Ends, JointOption, Measure, Measures, Range, force};

/// Its optional keys.
pub(super) const OPTIONS: &[JointOption] = &[];

/// Holds both components of the difference of its points, and leaves the angle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Revolute {
    /// The connected points.
    pub ends: Ends,
}

impl Revolute {
    pub(super) fn held(&self) -> [(Coordinate, f64); 2] {
        self.ends.difference().map(|component| (component, 0.0))
    }

    pub(super) fn free(&self) -> Coordinate {
        self.ends.angle()
    }

    pub(super) fn measures(&self, rows: Range<usize>) -> Measures {
        let angle = [
            ("angle", Measure::Position(self.free())),
            ("angular_velocity", Measure::Velocity(self.free())),
            ("angular_acceleration", Measure::Acceleration(self.free())),
        ];
        angle.into_iter().chain(force(&rows)).collect()
    }
}
