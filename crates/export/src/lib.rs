//! FMUs of surrogates: description, archive, model card, C sources, ONNX models, and checks of all of them.
//!
//! Everything here is part of the crate `metafmu` too.

// only commands print
#![warn(clippy::print_stdout, clippy::print_stderr)]

pub mod export;

use metafmu_core::{evaluation, study};
use metafmu_report::{html, report};
use metafmu_source::fmi;
use metafmu_surrogate::{import, surrogate};
use metafmu_tables::{Error, Result, diagnostics, reading, table, unit};
