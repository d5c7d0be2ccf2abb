//! State spaces of discrete-time models: simulations with sensitivities, and least squares of their errors.

mod features;
mod fit;
mod saturation;
mod simulate;

pub use features::{Features, SPAN};
pub use fit::{CountedRuns, Goal, Minimum};
pub use saturation::Saturation;
pub use simulate::{Limits, Signals, Simulated, StateShape, correct, overwriting, simulate};
