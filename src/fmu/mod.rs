//! Functional Mock-up Units.
//!
//! - [`ModelDescription`]: what an FMU says about itself; [`xml`] writes and reads it as FMI 2.0 does.

mod describe;
pub mod model_description;
pub mod unit;
pub mod xml;

pub use describe::model_identifier;
pub use model_description::ModelDescription;
