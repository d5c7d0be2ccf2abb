//! FMI, the standard: FMUs of any tool are read, run and checked. Nothing here knows of surrogates.
//!
//! - [`ModelDescription`]: an FMU's description of itself; [`xml`] writes and reads it as FMI 2.0 and 3.0 do.
//! - [`Fmu`] and [`FmuInstance`]: load anyone's FMU and run it; [`simulate`] does a whole run.
//! - [`system`]: systems of FMUs that exchange values (SSP), and runs of them.
//! - [`worker`]: FMUs in separate processes; [`simulate_apart`] does a whole run in one.
//! - [`validate()`]: every problem of an FMU; [`validate_apart`] runs it in separate processes.
//! - [`hosts`]: what hosts will do with an FMU.

mod archive;
pub mod host;
pub mod hosts;
pub mod identifier;
pub mod model_description;
pub(crate) mod platform;
pub mod system;
pub mod validate;
pub mod worker;
pub mod xml;

pub use archive::Archive;
pub use host::{Fmu, FmuInstance, Inputs, InterfaceKind, SimulationOptions, SimulationTable, simulate};
pub use model_description::{FmiVersion, ModelDescription};
pub use platform::Platform;
pub use validate::{Checks, Report, StandardOnly, validate};
pub use worker::{Watch, Workers, simulate_apart, validate_apart};
