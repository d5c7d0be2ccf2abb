//! Planar multibody dynamics: rigid bodies, joints, springs, forces and prescribed motion, from a description in a file.
//!
//! [`Mechanism::load`] reads and checks a [description]; [`Mechanism::simulate`] puts numbers in for its parameters
//! ([`build`]), closes the loops ([`model::MultibodyModel::initial_state`]), and solves the equations of motion in one of two
//! [formulations](formulation).
//!
//! Everything here is part of the crate `metafmu` too.

// only commands print
#![warn(clippy::print_stdout, clippy::print_stderr)]

mod bends;
pub mod build;
pub mod constraint;
pub mod coordinate;
pub mod description;
mod enclosure;
mod equilibrium;
mod error;
pub mod expression;
pub mod formulation;
pub mod gradients;
pub mod joints;
pub mod kinematics;
pub mod measure;
mod mechanism;
pub mod model;
mod motion;
pub mod reduced;
mod redundancy;
pub mod review;
pub mod simulate;
mod start;
mod stepper;
mod switches;
mod tables;
mod variables;

use metafmu_numerics::integrate;
use metafmu_tables::{Error, Result, diagnostics, signal, table, unit, variable};

pub use build::{JointGeometry, MechanismGeometry};
pub use error::{MotionCause, MotionError};
pub use mechanism::{FreeCoordinate, Mechanism, RunStart, json_schema};
pub use motion::BodyMotion;
pub use stepper::Stepper;

#[cfg(test)]
mod tests;
