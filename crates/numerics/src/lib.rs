//! Integrators of metafmu, explicit and implicit, and the largest of several errors.
//!
//! Everything here is part of the crate `metafmu` too.

// only commands print
#![warn(clippy::print_stdout, clippy::print_stderr)]

pub mod integrate;
pub mod worst;
