//! metafmu turns a multibody model into a small, fast, trustworthy FMU.
//!
//! The whole way, from a study file to the FMU and a step of it:
//!
//! ```standalone_crate
//! use metafmu::{
//!     fmi::Fmu,
//!     pipeline::{Control, Project, Silent, build, export::{ExportPlan, ExportRequest}, serve_workers},
//! };
//! use std::sync::atomic::AtomicBool;
//!
//! # const STUDY: &str = r#"
//! # name = "pendulum"
//! # source = { system = "single-pendulum", constants = { m = 0.3, g = 9.81, theta0 = 1.5, c = 0.1, thetad0 = 0.0 } }
//! # time = { stop = 0.5, step = 0.05 }
//! # parameters.L = { min = 0.1, max = 0.2, unit = "m" }
//! # outputs.theta = { unit = "rad" }
//! # sampling = { method = "mesh", levels = 9, test_runs = 4 }
//! # network = { hidden = [16, 16] }
//! # training = { epochs = 200, batch = 16, learning_rate = 0.01 }
//! # "#;
//! fn main() -> Result<(), Box<dyn std::error::Error>> {
//!     if serve_workers()? {
//!         return Ok(()); // this process runs an FMU for the one that started it
//!     }
//!     let (stop, program) = (AtomicBool::new(false), std::env::current_exe()?);
//!     let control = Control { observer: &Silent, stop: &stop, program: &program, heard: |_| {} };
//! #   let folder = tempfile::tempdir()?;
//! #   let study = folder.path().join("study.toml");
//! #   std::fs::write(&study, STUDY)?;
//! #   let results = folder.path().join("out");
//!     // sample, train, compare, evaluate, export, validate, report
//!     let project = Project::open(&study, Some(&results), control)?;
//!     let built = build(&project, &ExportPlan::new(&project, &ExportRequest::default())?, false)?;
//!     assert!(built.verdict.accepted, "{}", built.verdict.text());
//!
//!     let (written, validation) = &built.fmus[0];
//!     assert!(validation.problems.is_empty(), "{validation}");
//!     let fmu = Fmu::open(&written.fmu)?;
//!     let theta = fmu.description().variable("theta").ok_or("no theta")?.value_reference;
//!     let pendulum = fmu.instantiate("pendulum", false)?;
//!     pendulum.enter_initialization_mode(0.0, None)?;
//!     pendulum.exit_initialization_mode()?;
//!     pendulum.do_step(0.0, 0.1)?;
//!     let mut value = [0.0];
//!     pendulum.get_real(&[theta], &mut value)?;
//!     assert!(value[0] < 1.5, "it falls: {value:?}");
//!     Ok(())
//! }
//! ```
//!
//! [`pipeline`] has the single stages.

// only commands print
#![warn(clippy::print_stdout, clippy::print_stderr)]

mod cli;
mod commands;
mod kinds;
mod parallel;
pub mod pipeline;
mod project;
pub mod search;
pub mod swap;
mod templates;

// the commands use the public items here, like every other program
extern crate self as metafmu;

pub use commands::command;
#[doc(inline)]
pub use metafmu_baselines as baselines;
#[doc(inline)]
pub use metafmu_core::{
    acceptance, calibration, compliant, dataset, discrete, dynamics, evaluation, layout, network, processor_time,
    refinement, sampling, scaling, study, systems, training,
};
#[doc(inline)]
pub use metafmu_export::export;
#[doc(inline)]
pub use metafmu_multibody as multibody;
#[doc(inline)]
pub use metafmu_numerics::{integrate, worst};
#[doc(inline)]
pub use metafmu_report::report;
#[doc(inline)]
pub use metafmu_source::{fmi, source};
#[doc(inline)]
pub use metafmu_surrogate::{import, surrogate};
#[doc(inline)]
pub use metafmu_tables::{Error, Result, diagnostics, files, reading, signal, table, unit, unpacking, variable};
