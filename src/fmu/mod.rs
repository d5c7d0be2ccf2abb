//! Functional Mock-up Units: made of surrogates, read, run and checked.
//!
//! - [`ModelDescription`]: what an FMU says about itself; [`xml`] writes and reads it as FMI 2.0 does.
//! - [`export`] and [`pack`]: a model file becomes an FMU.

mod archive;
mod describe;
pub mod model_description;
mod package;
mod platform;
pub mod unit;
pub mod xml;

pub use archive::Archive;
pub use describe::model_identifier;
pub use model_description::ModelDescription;
pub use package::{MODEL_FILE, export, pack};
pub use platform::Platform;
