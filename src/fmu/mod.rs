//! Functional Mock-up Units: made of surrogates, read, run and checked.
//!
//! - [`ModelDescription`]: what an FMU says about itself; [`xml`] writes and reads it as FMI 2.0 and 3.0 do.
//! - [`pack`]: a surrogate becomes an FMU; [`Binary`]: the library for a platform.
//! - [`Fmu`] and [`Instance`]: load anyone's FMU and run it; [`simulate`] does a whole run.
//! - [`worker`]: FMUs run in processes of their own; [`simulate_apart`] does a whole run in one.
//! - [`validate()`]: every problem of an FMU; [`validate_apart`] in processes of their own.
//! - [`sources`]: the FMU as C source code.

mod archive;
mod binary;
mod card;
pub(crate) mod describe;
pub mod host;
pub mod model_description;
mod package;
mod platform;
mod reference;
pub mod sources;
#[cfg(test)]
pub(crate) mod testing;
pub mod unit;
pub mod validate;
pub mod worker;
pub mod xml;

pub use archive::Archive;
pub use binary::Binary;
pub use describe::model_identifier;
pub use host::{Fmu, Inputs, Instance, InterfaceKind, SimulationOptions, Table, simulate};
pub use model_description::{FmiVersion, ModelDescription};
pub use package::{Contents, MODEL_FILE, pack};
pub use platform::Platform;
pub use reference::ReferenceOptions;
pub use validate::{Report, validate, validate_apart};
pub use worker::{Watch, Workers, simulate_apart};
