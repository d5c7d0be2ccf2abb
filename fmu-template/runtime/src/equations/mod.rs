//! Equations: functions of some columns, written as tapes, and equations of motion that are made of them.

pub mod bends;
pub mod dictionary;
pub(crate) mod dynamics;
pub(crate) mod efforts;
pub mod formula;
pub mod function_set;
pub(crate) mod lookup;
pub(crate) mod motion;
mod places;
pub(crate) mod reactions;
pub mod switches;
pub(crate) mod tape;

pub use efforts::{EffortColumn, Efforts};
pub use motion::{Motion, Shown};
pub use reactions::Reactions;
