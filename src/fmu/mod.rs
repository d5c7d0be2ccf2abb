//! Functional Mock-up Units: made of surrogates, read, run and checked.
//!
//! - [`ModelDescription`]: what an FMU says about itself; [`xml`] writes and reads it as FMI 2.0 does.
//! - [`pack`]: a surrogate becomes an FMU.
//! - [`Fmu`] and [`Instance`]: load anyone's FMI 2.0 co-simulation FMU and run it; [`simulate`] does a whole run.
//! - [`validate()`]: every problem of an FMU.
//! - [`sources`]: the FMU as C source code.

mod archive;
mod describe;
pub mod host;
pub mod model_description;
mod package;
mod platform;
pub mod sources;
#[cfg(test)]
mod testing;
pub mod unit;
pub mod validate;
pub mod xml;

pub use archive::Archive;
pub use describe::model_identifier;
pub use host::{Fmu, Instance, SimulationOptions, Table, simulate};
pub use model_description::ModelDescription;
pub use package::{MODEL_FILE, pack};
pub use platform::Platform;
pub use validate::{Report, validate};
