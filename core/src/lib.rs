//! Numerics and studies of metafmu: tables, mechanisms, equations of motion, networks and their training, and the
//! options of a study.
//!
//! Everything here is part of the crate `metafmu` too, whose documentation has the whole way from a study to an FMU.

// only commands print
#![warn(clippy::print_stdout, clippy::print_stderr)]

pub mod acceptance;
pub mod calibration;
pub mod compliant;
pub mod dataset;
pub mod diagnostics;
pub mod discrete;
pub mod dynamics;
pub mod evaluation;
pub mod fail_points;
pub mod files;
pub mod integrate;
pub mod layout;
pub mod multibody;
pub mod network;
pub mod processor_time;
pub mod reading;
pub mod refinement;
pub mod sampling;
pub mod scaling;
pub mod signal;
pub mod study;
pub mod systems;
pub mod table;
pub mod training;
pub mod unit;
pub mod variable;
pub mod worst;

pub use diagnostics::error::{Error, Result};
