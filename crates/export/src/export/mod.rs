//! A surrogate becomes an FMU.
//!
//! - [`pack`]: the archive with everything in it, [`read_surrogate`]: the surrogate of such an archive; [`Binary`]: the library for a platform.
//! - [`sources`]: the FMU as C source code; [`onnx()`]: the surrogate as an ONNX model.
//! - [`validate()`] and [`validate_apart`]: the checks of any FMU and those of our own; [`serve_worker`] is their process.

mod binary;
mod card;
mod checks;
mod describe;
mod onnx;
mod package;
mod reference;
pub mod sources;
mod structure;

pub use binary::Binary;
pub use checks::{SurrogateChecks, serve_worker, validate, validate_apart};
pub use describe::{added_variables, is_own};
pub use onnx::onnx;
pub use package::{Contents, MODEL_FILE, find_surrogate, pack, read_surrogate};
pub use reference::ReferenceOptions;
