//! The library that becomes the binary in every FMU.
//!
//! It knows no model: `resources/model.safetensors` beside it holds the surrogate, and the GUID tells whether the XML
//! belongs to it. So one build serves every FMU, and exporting one only copies this library.
//!
//! - `fmi2`, `fmi3`: the C functions of each version; thin, no arithmetic; with them their tables of legal calls
//! - `component`: what all of them have in common: null checks, legal calls, answers to the host
//! - `instance`: one simulation: modes, get, set, step, derivatives; neither C nor names of functions
//! - `state`: the modes, and how a table says what may be called in which
//! - `snapshot`: everything a simulation needs to go on from a point, also as bytes
//! - `status`: every warning and every way to refuse a call
//! - `backtrace`: panics without backtraces
//! - `boundary`: C pointers and panics to Rust and back
//! - `logger`: messages to the host
//! - `location`: the resource URI of FMI 2.0
//!
//! Nothing but the `fmi2*` and `fmi3*` functions is exported.

// somebody else's simulator is no place to abort in or to print to
#![cfg_attr(
    not(test),
    deny(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout, clippy::print_stderr)
)]

// of a static unwinder no function can be replaced
#[cfg(all(target_os = "linux", target_env = "gnu", not(any(test, static_unwinder))))]
mod backtrace;
mod boundary;
#[cfg(test)]
mod calls;
mod component;
mod fmi2;
mod fmi3;
mod instance;
mod location;
mod logger;
mod snapshot;
mod state;
mod status;
#[cfg(test)]
mod testing;
