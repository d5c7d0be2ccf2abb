//! metafmu turns a multibody model into a small, fast, trustworthy FMU.

// only commands print
#![warn(clippy::print_stdout, clippy::print_stderr)]

pub mod acceptance;
pub mod baseline;
pub mod calibration;
pub mod dataset;
pub mod error;
pub mod evaluation;
pub mod files;
pub mod fmu;
mod html;
pub mod integrate;
pub mod multibody;
mod names;
pub mod network;
pub mod origin;
pub mod refinement;
pub mod report;
pub mod sampling;
pub mod scaling;
pub mod search;
pub mod source;
pub mod study;
pub mod surrogate;
pub mod table;
pub mod training;
pub mod variable;

pub use error::{Error, Result};
