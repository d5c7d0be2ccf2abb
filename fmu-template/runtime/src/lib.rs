//! What the metafmu tool and every FMU it writes share.
//!
//! - [`Surrogate`]: the variables and the [`Model`] of a surrogate, as they stand in the model file.
//! - [`format`](mod@format): the model file itself, a safetensors container; its layout is specified there.
//! - [`Evaluator`]: the surrogate prepared for evaluation, with exact derivatives.
//! - [`Encoding`]: how an input's value becomes columns of the network.
//! - [`regression`]: models that are a formula in double precision, such as polynomials and forests.
//! - [`Domain`]: the ranges the surrogate was trained in.
//! - [`extra`]: the variables every FMU adds to those of the surrogate.
//!
//! ```
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! # let surrogate = metafmu_runtime::example::surrogate();
//! # let bytes = surrogate.to_bytes()?;
//! let surrogate = metafmu_runtime::Surrogate::from_bytes(&bytes)?;
//! let evaluator = metafmu_runtime::Evaluator::new(&surrogate);
//! let mut scratch = evaluator.scratch();
//! let mut outputs = vec![0.0; surrogate.outputs().len()];
//! let inputs: Vec<f64> = surrogate.inputs().iter().map(|input| input.start).collect();
//! evaluator.evaluate(&inputs, &mut outputs, &mut scratch);
//! # Ok(())
//! # }
//! ```

mod activation;
mod bounds;
mod domain;
mod encoding;
mod evaluator;
pub mod example;
pub mod extra;
pub mod format;
mod jet;
mod layers;
mod network;
pub mod regression;
mod series;
mod simd;
mod surrogate;

pub use activation::Activation;
pub use bounds::Bounds;
pub use domain::{Domain, TOLERANCE};
pub use encoding::{Encoder, Encoding};
pub use evaluator::{Evaluator, MAX_OUTPUT_DERIVATIVE_ORDER, Scratch};
pub use format::FormatError;
pub use surrogate::{
    Input, Layer, Metadata, Model, Output, OutputArray, Precision, Provenance, Role, ScaledNetwork, Scaling, Surrogate,
    Variability,
};
