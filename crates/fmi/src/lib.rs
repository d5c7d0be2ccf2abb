//! FMI, the standard: FMUs of any tool are read, run and checked. Nothing here knows of surrogates.
//!
//! - [`ModelDescription`]: an FMU's description of itself; [`xml`] writes and reads it as FMI 2.0 and 3.0 do.
//! - [`Fmu`] and [`FmuInstance`]: load anyone's FMU and run it; [`simulate`] does a whole run.
//! - [`validate()`]: every problem of an FMU.
//!
//! Everything here is part of the crate `metafmu` too.

// only commands print
#![warn(clippy::print_stdout, clippy::print_stderr)]

mod archive;
pub mod host;
pub mod identifier;
pub mod model_description;
pub mod platform;
pub mod validate;
pub mod xml;

pub use archive::{Archive, description_error};
pub use host::{Fmu, FmuInstance, Inputs, InterfaceKind, SimulationOptions, SimulationTable, simulate};
use metafmu_numerics::integrate;
use metafmu_tables::{Error, Result, diagnostics, reading, table, unit, unpacking, variable};
pub use model_description::{FmiVersion, ModelDescription};
pub use platform::Platform;
pub use validate::{Checks, Report, StandardOnly, validate};
