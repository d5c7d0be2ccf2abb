//! Simpler models beside the network, on the same rows: whether it is worth it.

pub mod comparison;

pub use comparison::{Comparison, ModelAccuracy, ModelRow, Status};
