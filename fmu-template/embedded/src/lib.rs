//! The libraries that go into FMUs, embedded as bytes.
//!
//! A crate of its own, so that its build script, which needs a minute of one core, runs beside the compilation of what
//! `metafmu` depends on.

/// Platform tuples of FMI 3.0, sorted, and the library of `fmu-template` for each: in a checkout the one built with this program, in
/// what is published those that are packed with it, and those in the folder that `METAFMU_RUNTIMES` named when it was built.
pub const LIBRARIES: &[(&str, &[u8])] = include!(concat!(env!("OUT_DIR"), "/libraries.rs"));
