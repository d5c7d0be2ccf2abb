//! The library that becomes the binary in every FMU.
//!
//! It knows no model: `resources/model.safetensors` beside it holds the surrogate, and the GUID tells whether the XML
//! belongs to it. So one build serves every FMU, and exporting one only copies this library.
//!
//! - `fmi2`: the C functions of FMI 2.0; thin, no arithmetic
//! - `instance`: one simulation: states, table of legal calls, get, set, step; knows no FMI version
//! - `snapshot`: everything a simulation needs to go on from a point, also as bytes
//! - `answer`: every warning and every way to refuse a call
//! - `boundary`: C pointers and panics to Rust and back
//! - `logger`: messages to the host
//! - `location`: the resource URI
//!
//! Nothing but the `fmi2*` functions is exported.

// somebody else's simulator is no place to abort in or to print to
#![cfg_attr(
    not(test),
    deny(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout, clippy::print_stderr)
)]

mod answer;
mod boundary;
mod fmi2;
mod instance;
mod location;
mod logger;
mod snapshot;
