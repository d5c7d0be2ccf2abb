//! What the metafmu tool and every FMU it writes share.
//!
//! - [`Surrogate`]: the variables and the model of a surrogate, as the model file has them.
//! - [`Map`]: a pure function from columns to outputs: a network, or a sequence of steps such as a polynomial or a forest.
//! - [`Model`]: maps together with time, and equations with states.
//! - [`Variables`]: the variables of its FMU in the order of their value references.
//! - [`format`](mod@format): the model file itself, a safetensors container; its layout is specified there.
//! - [`Evaluator`]: the model prepared for evaluation, with exact derivatives.
//! - [`Encoding`]: how an input's value becomes columns of the model.
//! - [`Domain`]: where the surrogate was trained: ranges, and a [`Cover`] of the data in them.
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

mod bounds;
mod cover;
mod description;
mod domain;
mod encoding;
mod error;
#[cfg(feature = "example")]
pub mod example;
pub mod format;
mod map;
mod metadata;
mod model;
mod simd;
mod surrogate;
mod variables;

pub use bounds::Bounds;
pub use cover::Cover;
pub use description::{Encoding, Input, Output, OutputArray, Precision, Provenance, Role, State, Variability};
pub use domain::{Domain, DomainPolicy, TOLERANCE};
pub use encoding::Encoder;
pub use error::FormatError;
pub use map::{Activation, Layer, Map, Numbers, ScaledNetwork, Scaling, dictionary, formula, graph, jet::Jet, law};
pub use metadata::Metadata;
pub use model::{
    CommunicationStep, Discrete, Drive, EffortColumn, Efforts, Evaluator, Given, Integration,
    MAX_OUTPUT_DERIVATIVE_ORDER, MAX_SOLVER_STEPS, Model, Motion, Reactions, Scale, Scratch, Shown, StateSpace,
    StepError, Support, Transition,
    dynamics::{Dynamics, DynamicsScratch, Point as StatePoint},
};
pub use surrogate::Surrogate;
pub use variables::{BuiltIn, Known, Quantity, Variable, Variables};
