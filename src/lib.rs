//! metafmu turns a multibody model into a small, fast, trustworthy FMU.

pub mod error;

pub use error::{Error, Result};
