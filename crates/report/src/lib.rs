//! Reports of surrogates as self-contained web pages, and plots of runs.
//!
//! Everything here is part of the crate `metafmu` too.

// only commands print
#![warn(clippy::print_stdout, clippy::print_stderr)]

pub mod html;
pub mod report;

use metafmu_core::{dataset, evaluation, layout, study, training};
use metafmu_multibody as multibody;
use metafmu_source::source;
use metafmu_surrogate::surrogate;
use metafmu_tables::{Error, Result, diagnostics};
