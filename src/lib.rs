//! metafmu turns a multibody model into a small, fast, trustworthy FMU.

pub mod error;
pub mod file;
pub mod study;
pub mod surrogate;

pub use error::{Error, Result};
