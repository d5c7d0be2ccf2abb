//! The study file: what is sampled, how, and what is made of it.

mod options;

pub use options::{NetworkOptions, Optimizer, Schedule, TrainingOptions};
