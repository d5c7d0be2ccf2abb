//! metafmu turns a multibody model into a small, fast, trustworthy FMU.

pub mod error;
pub mod study;

pub use error::{Error, Result};
