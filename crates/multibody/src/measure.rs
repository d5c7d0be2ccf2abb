//! Names that outputs, formulas and initial conditions can use.
//!
//! | name | what |
//! |---|---|
//! | `P.x P.y`, `P.vx P.vy`, `P.ax P.ay` | position, velocity, acceleration of a point; a body's name is its centre of mass |
//! | `BODY.angle`, `.angular_velocity`, `.angular_acceleration` | of a body, against the ground |
//! | `JOINT.angle`, `.angular_velocity`, `.angular_acceleration` | of a revolute joint: second body against the first |
//! | `JOINT.position`, `.velocity`, `.acceleration` | of a prismatic joint, along its axis |
//! | `JOINT.fx JOINT.fy`, `JOINT.moment` | force at the joint's second point and moment, of the first body on the second |
//! | `SPRING.length`, `.velocity`, `SPRING.force` | of a spring between points; force (or torque), positive where it pushes |
//! | `BUSHING.fx`, `.fy`, `.moment` | force and moment on the second body, in the frame of the first |
//! | `BUSHING.x`, `.y`, `.angle`, `.vx`, `.vy`, `.angular_velocity` | its deflections, and their rates |
//! | `CONTACT.fx`, `.fy` | friction along the line and normal force, on the body of the point; an output's measure only |
//! | `CONTACT.x`, `.y`, `.angle`, `.vx`, `.vy`, `.angular_velocity` | the point and its body against the line, and their rates |
//! | `DRIVER.effort`, `COUPLING.effort` | force or torque that keeps a driver's motion or acceleration, or holds a coupled coordinate |
//! | `STATE` | an actuator state, by its name |
//! | `kinetic_energy`, `potential_energy` | of gravity and springs |

use super::{
    coordinate::{Coordinate, turned},
    model::MultibodyModel,
    model::Sample,
};
use std::ops::Range;

/// Something that is measured.
#[derive(Clone, Debug, PartialEq)]
pub enum Measure {
    /// A coordinate.
    Position(Coordinate),
    /// A coordinate's rate.
    Velocity(Coordinate),
    /// A coordinate's second derivative.
    Acceleration(Coordinate),
    /// Component of a joint's force, from its constraints.
    JointForce {
        /// The joint's constraints.
        rows: Range<usize>,
        /// 0: x, 1: y of the ground frame.
        component: usize,
    },
    /// A joint's moment, from its constraints.
    JointMoment {
        /// The joint's constraints.
        rows: Range<usize>,
    },
    /// Force or torque of a driver, by its multiplier.
    DriverEffort(usize),
    /// Force or torque of a spring, by its position in the model.
    SpringEffort(usize),
    /// An expression, by its position among the model's formulas.
    Formula(usize),
    /// Kinetic energy.
    KineticEnergy,
    /// Potential energy.
    PotentialEnergy,
}

impl Measure {
    /// Unit of the value in a model.
    pub fn unit<'m>(&self, model: &'m MultibodyModel) -> &'m str {
        match self {
            Self::Position(coordinate) => {
                if coordinate.is_angle() {
                    "rad"
                } else {
                    "m"
                }
            }
            Self::Velocity(coordinate) => {
                if coordinate.is_angle() {
                    "rad/s"
                } else {
                    "m/s"
                }
            }
            Self::Acceleration(coordinate) => {
                if coordinate.is_angle() {
                    "rad/s2"
                } else {
                    "m/s2"
                }
            }
            Self::JointForce { .. } => "N",
            Self::JointMoment { .. } => "N.m",
            Self::DriverEffort(row) => effort_unit(model.held_coordinate(*row)),
            Self::SpringEffort(spring) => effort_unit(&model.springs[*spring].coordinate),
            Self::Formula(formula) => &model.formulas[*formula].unit,
            Self::KineticEnergy | Self::PotentialEnergy => "J",
        }
    }

    /// Value in a sample.
    pub fn value(&self, model: &MultibodyModel, sample: &Sample) -> f64 {
        let Sample { t, q, v, u, qdd, multipliers } = sample;
        match self {
            Self::Position(coordinate) => coordinate.value(q),
            Self::Velocity(coordinate) => coordinate.rate(q, v),
            Self::Acceleration(coordinate) => coordinate.rate(q, qdd) + coordinate.curvature(q, v),
            Self::JointForce { rows, component } => {
                let forces = rows.clone().map(|row| match &model.constraints[row].coordinate {
                    Coordinate::Projection { frame, axis, .. } => {
                        -multipliers[row] * turned(*frame, *axis, q)[*component]
                    }
                    _ => 0.0,
                });
                forces.sum()
            }
            Self::JointMoment { rows } => {
                let angles = rows.clone().filter(|&row| model.constraints[row].coordinate.is_angle());
                angles.map(|row| -multipliers[row]).sum()
            }
            Self::DriverEffort(row) => -multipliers[*row],
            Self::SpringEffort(spring) => {
                let spring = &model.springs[*spring];
                let further = spring.further.map(|effort| &model.efforts[effort].expression);
                spring.effort(q, v) + further.map_or(0.0, |of| of.value(*t, q, v, u))
            }
            Self::Formula(formula) => model.formulas[*formula].expression.value(*t, q, v, u),
            Self::KineticEnergy => model.kinetic_energy(v),
            Self::PotentialEnergy => model.potential_energy(q),
        }
    }
}

fn effort_unit(coordinate: &Coordinate) -> &'static str {
    if coordinate.is_angle() { "N.m" } else { "N" }
}
