//! Sources of training data: systems and mechanisms that are simulated here, tables, and FMUs and programs in separate processes.
//!
//! Everything here is part of the crate `metafmu` too.

// only commands print
#![warn(clippy::print_stdout, clippy::print_stderr)]

pub mod fmi;
mod process;
pub mod source;

use metafmu_core::{dataset, dynamics, evaluation, sampling, scaling, study, systems};
use metafmu_multibody as multibody;
use metafmu_numerics::integrate;
use metafmu_tables::{
    Error, Result, diagnostics, fail_points, files, reading, signal, table, unit, unpacking, variable,
};
