//! Where a mistake is and what it is: the one error type, lines and keys of files, "did you mean".

pub mod error;
pub(crate) mod names;
pub mod origin;
mod place;

pub use place::Place;
