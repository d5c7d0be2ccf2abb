//! Constraints and measures of joints and drivers: one file each.
//!
//! A joint gives the [coordinates](super::coordinate) that it constrains, which define the residual of its constraints,
//! their row of the Jacobian and the right-hand side of their accelerations. It also gives the free coordinate between
//! its two bodies, and the names of its measures (Haug: *Computer-Aided Kinematics and Dynamics of Mechanical Systems*,
//! chapter 3). Both formulations use the constraints only: a new joint needs no change there.

mod driver;
mod fixed;
mod prismatic;
mod revolute;

pub use driver::Driver;
pub use fixed::FixedJoint;
pub use prismatic::Prismatic;
pub use revolute::Revolute;

use super::{
    coordinate::{BodyPoint, Coordinate},
    description::JointType,
    measure::Measure,
};
use nalgebra::Vector2;
use std::ops::Range;

/// The two points that a joint connects.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ends {
    /// Point of the first body.
    pub from: BodyPoint,
    /// Point of the second body. Relative motion is that of the second body against the first.
    pub to: BodyPoint,
}

/// An optional key of a joint in the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JointOption {
    /// `axis`: required by the types that have it.
    Axis,
    /// `angle`: zero where it is not said.
    Angle,
}

/// Measures by their names, which follow that of the joint and a dot.
pub type Measures = Vec<(&'static str, Measure)>;

/// A joint with numbers in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Joint {
    /// Leaves the rotation about the common point.
    Revolute(Revolute),
    /// Leaves the translation along an axis.
    Prismatic(Prismatic),
    /// Leaves nothing.
    Fixed(FixedJoint),
}

impl Joint {
    /// A joint of a type; `axis`, a unit vector in the frame of the first body, and `angle` of the second body relative to the
    /// first, in rad, are for those types that have them.
    pub fn new(joint: JointType, ends: Ends, axis: Vector2<f64>, angle: f64) -> Self {
        match joint {
            JointType::Revolute => Self::Revolute(Revolute { ends }),
            JointType::Prismatic => Self::Prismatic(Prismatic { ends, axis, angle }),
            JointType::Fixed => Self::Fixed(FixedJoint { ends, angle }),
        }
    }

    /// The coordinates that its constraints hold, each at a value in m or rad.
    pub fn held(&self) -> Vec<(Coordinate, f64)> {
        match self {
            Self::Revolute(joint) => joint.held().to_vec(),
            Self::Prismatic(joint) => joint.held().to_vec(),
            Self::Fixed(joint) => joint.held().to_vec(),
        }
    }

    /// The relative coordinate that it leaves free.
    pub fn free(&self) -> Option<Coordinate> {
        match self {
            Self::Revolute(joint) => Some(joint.free()),
            Self::Prismatic(joint) => Some(joint.free()),
            Self::Fixed(_) => None,
        }
    }

    /// Measures of the joint; `rows` are its constraints.
    pub fn measures(&self, rows: Range<usize>) -> Measures {
        match self {
            Self::Revolute(joint) => joint.measures(rows),
            Self::Prismatic(joint) => joint.measures(rows),
            Self::Fixed(joint) => joint.measures(rows),
        }
    }
}

impl JointOption {
    /// The types of joints that have it.
    pub fn joints(self) -> impl Iterator<Item = JointType> {
        JointType::ALL.into_iter().filter(move |&joint| options(joint).contains(&self))
    }
}

/// The optional keys of a type of joints.
fn options(joint: JointType) -> &'static [JointOption] {
    match joint {
        JointType::Revolute => revolute::OPTIONS,
        JointType::Prismatic => prismatic::OPTIONS,
        JointType::Fixed => fixed::OPTIONS,
    }
}

impl Ends {
    /// Both components of the difference of the points, in the ground frame.
    fn difference(self) -> [Coordinate; 2] {
        let Self { from, to } = self;
        [Vector2::x(), Vector2::y()].map(|axis| Coordinate::Projection { from, to, frame: None, axis })
    }

    /// The component of the difference along an axis that is fixed in the first body.
    fn along(self, axis: Vector2<f64>) -> Coordinate {
        let Self { from, to } = self;
        Coordinate::Projection { from, to, frame: from.frame, axis }
    }

    /// The angle of the second body relative to the first.
    fn angle(self) -> Coordinate {
        Coordinate::Angle { from: self.from.frame, to: self.to.frame }
    }
}

/// The components of a joint's force on the second body.
fn force(rows: &Range<usize>) -> Measures {
    let [fx, fy] = [0, 1].map(|component| Measure::JointForce { rows: rows.clone(), component });
    vec![("fx", fx), ("fy", fy)]
}

/// The moment of a joint that holds the angle.
fn moment(rows: Range<usize>) -> (&'static str, Measure) {
    ("moment", Measure::JointMoment { rows })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};

    fn joints() -> [Joint; 3] {
        let point = |frame, x, y| BodyPoint { frame, local: Vector2::new(x, y) };
        let ends = Ends { from: point(Some(0), 0.4, -0.3), to: point(Some(1), -0.2, 0.9) };
        JointType::ALL.map(|joint| Joint::new(joint, ends, Vector2::new(0.6, 0.8), 0.25))
    }

    /// Coordinates of both bodies that satisfy the joint, with its free coordinate at `free`.
    fn assembled(joint: &Joint, free: f64) -> DVector<f64> {
        let (slide, angle) = match joint {
            Joint::Revolute(_) => (0.0, free),
            Joint::Prismatic(_) => (free, 0.25),
            Joint::Fixed(_) => (0.0, 0.25),
        };
        let turned =
            |phi: f64, x: f64, y: f64| Vector2::new(phi.cos() * x - phi.sin() * y, phi.sin() * x + phi.cos() * y);
        let (first, phi) = (Vector2::new(-0.5, 1.1), 0.7);
        let common = first + turned(phi, 0.4 + 0.6 * slide, -0.3 + 0.8 * slide);
        let second = common - turned(phi + angle, -0.2, 0.9);
        DVector::from_vec(vec![first.x, first.y, phi, second.x, second.y, phi + angle])
    }

    #[test]
    fn constraints_hold_wherever_the_free_coordinate_is() {
        for joint in joints() {
            for free in [-0.8, 0.3, 1.9] {
                let q = assembled(&joint, free);
                for (coordinate, value) in joint.held() {
                    assert!((coordinate.value(&q) - value).abs() < 1e-15, "{joint:?} {coordinate:?}");
                }
                if let Some(coordinate) = joint.free() {
                    assert!((coordinate.value(&q) - free).abs() < 1e-15, "{joint:?}");
                }
            }
        }
    }

    #[test]
    fn constraints_and_the_free_coordinate_decide_the_three_relative_motions() {
        for joint in joints() {
            let q = assembled(&joint, 0.3);
            let held = joint.held().into_iter().map(|(coordinate, _)| coordinate);
            let coordinates: Vec<Coordinate> = held.chain(joint.free()).collect();
            let mut gradients = DMatrix::zeros(q.len(), coordinates.len());
            for (coordinate, gradient) in coordinates.iter().zip(gradients.as_mut_slice().chunks_mut(q.len())) {
                coordinate.add_gradient(&q, 1.0, gradient);
            }
            // of the second body, with the first one at rest
            let determinant = gradients.rows(3, 3).into_owned().determinant();
            assert!((determinant.abs() - 1.0).abs() < 1e-15, "{joint:?}: {determinant}");
        }
    }
}
