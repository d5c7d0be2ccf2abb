//! Common part of the metafmu tool and of every FMU it writes.
//!
//! - [`Surrogate`]: the variables and the program of a surrogate, as the model file has them.
//! - [`Program`]: a [`Graph`], which is a sequence of steps (a network, a polynomial, equations), and a [`Clock`], which says when it is
//!   evaluated: whenever outputs are wanted, for the derivatives of states, or at samples.
//! - [`Variables`]: the variables of its FMU in the order of their value references.
//! - [`format`](mod@format): the model file itself, a safetensors container; its layout is specified there.
//! - [`Evaluator`]: the program prepared for evaluation, with exact derivatives.
//! - [`Encoding`]: how an input's value becomes columns of the graph.
//! - [`Domain`]: where the surrogate was trained: ranges, and a [`Cover`] of the data in them.
//!
//! ```
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! # let surrogate = metafmu_example::surrogate();
//! # let bytes = surrogate.to_bytes()?;
//! let surrogate = metafmu_runtime::Surrogate::from_bytes(&bytes)?;
//! let mut evaluator = metafmu_runtime::Evaluator::new(&surrogate);
//! let mut outputs = vec![0.0; surrogate.outputs().len()];
//! let inputs: Vec<f64> = surrogate.inputs().iter().map(|input| input.start).collect();
//! evaluator.evaluate(&inputs, &mut outputs);
//! # Ok(())
//! # }
//! ```

#[cfg(test)]
extern crate self as metafmu_runtime;

mod bounds;
mod check;
mod cover;
mod description;
mod domain;
mod encoding;
mod equations;
mod error;
// as tests of this crate see it: of its types, not of those of the crate that others link
#[cfg(test)]
#[path = "../../example/src/lib.rs"]
pub mod example;
pub mod format;
pub mod graph;
mod metadata;
mod network;
mod numbers;
mod program;
mod rows;
mod simd;
mod surrogate;
mod task;
mod tensors;
mod variables;

pub use bounds::Bounds;
pub use cover::Cover;
pub use description::{Encoding, Input, Output, OutputArray, Precision, Provenance, Role, State, Tunability};
pub use domain::{Domain, DomainPolicy, TOLERANCE};
pub use encoding::Encoder;
pub use equations::{
    EffortColumn, Efforts, Motion, Reactions, Shown, bends, dictionary,
    dynamics::{Dynamics, DynamicsScratch, Point as StatePoint},
    formula, function_set, switches,
    tape::listing,
};
pub use error::FormatError;
pub use graph::Graph;
pub use metadata::Metadata;
pub use network::{Layer, Numbers, ScaledNetwork, Scaling};
pub use numbers::{activation::Activation, decimal::exact, jet::Jet};
pub use program::{
    Clock, CommunicationStep, Drive, Evaluator, Integration, MAX_OUTPUT_DERIVATIVE_ORDER, MAX_SOLVER_STEPS, Ports,
    Program, Sampling, Scale, StepError, Support,
};
pub use rows::{Rows, RowsIter};
pub use surrogate::Surrogate;
pub use variables::{BuiltIn, Known, Quantity, Variable, Variables};
