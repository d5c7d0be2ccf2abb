//! Errors and their locations: the one error type, problems by key, lines and keys of files, "did you mean".

pub mod error;
pub mod interruption;
pub mod kinds;
pub mod names;
pub mod numbers;
pub mod origin;
mod place;
pub mod problem;
mod problems;
pub mod schema;

pub use place::Place;
pub use problems::{KeyProblem, Problems};
