//! Libraries that are embedded in FMUs, as bytes.
//!
//! This is a separate crate so that its build script, which takes one core for a minute, runs while the dependencies of
//! `metafmu` are compiled.

/// Platform tuples of FMI 3.0, sorted, each with its library of `fmu-template`. In a checkout this is the library built
/// with this program, in the published package those packed with it. Libraries in the folder that `METAFMU_RUNTIMES`
/// named at build time are added.
pub const LIBRARIES: &[(&str, &[u8])] = include!(concat!(env!("OUT_DIR"), "/libraries.rs"));
