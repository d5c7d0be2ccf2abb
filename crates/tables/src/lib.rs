//! Tables, units and variables of metafmu, files that are written whole or not at all, and errors that say where and why.
//!
//! Everything here is part of the crate `metafmu` too.

// only commands print
#![warn(clippy::print_stdout, clippy::print_stderr)]

pub mod diagnostics;
pub mod fail_points;
pub mod files;
pub mod reading;
pub mod signal;
pub mod table;
pub mod unit;
pub mod unpacking;
pub mod variable;

pub use diagnostics::error::{Error, Result};
