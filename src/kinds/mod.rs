//! Kinds of surrogate, a folder each: how it is learned, what it is measured on, and how its results are described.
//!
//! The stages of the pipeline ask [`of`] for the kind of a study instead of telling kinds apart themselves. Kinds do not know each other: what
//! several need is beside their folders.

mod compliant;
mod discrete;
mod dynamics;
pub(crate) mod follower;
mod judge;
mod kind;
pub(crate) mod learning;
pub(crate) mod prepare;
pub mod record;
mod registry;
pub(crate) mod response;
pub mod static_map;
pub(crate) mod unseen;

pub(crate) use judge::findings;
pub(crate) use kind::Fact;
pub use kind::ResultFile;
pub use registry::of;
