//! metafmu turns a multibody model into a small, fast, trustworthy FMU.

pub mod error;
pub mod network;
pub mod study;
pub mod training;

pub use error::{Error, Result};
