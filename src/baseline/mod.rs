//! Simpler models beside the network, on the same rows: whether it is worth it. The models are those of
//! [`metafmu_baselines`], whose names stand here as well.

pub mod comparison;
mod prepare;

pub use comparison::{Comparison, ModelAccuracy, ModelRow, ModelStatus};
pub use metafmu_baselines::*;
pub use prepare::{choose_rows, rows};
