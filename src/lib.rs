//! metafmu turns a multibody model into a small, fast, trustworthy FMU.

pub mod error;
pub mod files;
pub mod fmu;
pub mod study;
pub mod surrogate;

pub use error::{Error, Result};
