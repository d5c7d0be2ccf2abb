//! Numerics and studies of metafmu: equations of motion, networks and their training, and the options of a
//! study.
//!
//! Everything here is part of the crate `metafmu` too, whose documentation has the whole way from a study to an FMU.

// only commands print
#![warn(clippy::print_stdout, clippy::print_stderr)]

pub mod acceptance;
pub mod calibration;
pub mod compliant;
pub mod dataset;
pub mod discrete;
pub mod dynamics;
pub mod evaluation;
pub mod layout;
pub mod network;
pub mod processor_time;
pub mod refinement;
pub mod sampling;
pub mod scaling;
pub mod study;
pub mod systems;
pub mod training;

use metafmu_multibody as multibody;
use metafmu_numerics::{integrate, worst};
use metafmu_tables::{Error, Result, diagnostics, files, reading, signal, table, unit, variable};
