//! Surrogates of trained models: of our own networks, and of third-party models that are imported.
//!
//! Everything here is part of the crate `metafmu` too.

// only commands print
#![warn(clippy::print_stdout, clippy::print_stderr)]

pub mod import;
pub mod surrogate;

use metafmu_baselines as baselines;
use metafmu_core::{dataset, layout, study};
use metafmu_source::source;
use metafmu_tables::{Error, Result, diagnostics, files, reading, table, unpacking, variable};
