//! The descriptive part of a surrogate.

use crate::{
    Bounds, Cover,
    description::{Input, Output, OutputArray, Precision, Provenance, State},
};
use serde::Serialize;

/// The descriptive part of a [`Surrogate`](crate::Surrogate), kept as JSON in the model file's metadata.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Metadata {
    /// Name of the surrogate; also the FMU's model name.
    pub name: String,
    /// One sentence for people.
    pub description: String,
    /// The inputs, in order.
    pub inputs: Vec<Input>,
    /// The network's output columns, in order.
    pub outputs: Vec<Output>,
    /// The continuous states, in order; the model integrates them.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub states: Vec<State>,
    /// Outputs grouped into arrays, for FMI 3.0; each output remains a separate variable.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub arrays: Vec<OutputArray>,
    /// Error bounds of the outputs, if they were measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bounds: Option<Bounds>,
    /// Perturbation of the start, in all states, that changes the outputs as much as the error of the states' solver at
    /// most, if that was measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub solver_error: Option<f64>,
    /// Where in the ranges of the inputs the training data are, if that is known; of a model without a state.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cover: Option<Cover>,
    /// Precision of its networks.
    #[serde(skip_serializing_if = "Precision::is_double")]
    pub precision: Precision,
    /// Time between two rows of a training run, in seconds: the natural communication step size.
    pub time_step: f64,
    /// End of a run in seconds, if the time is no input with a range.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stop_time: Option<f64>,
    /// Where the surrogate comes from.
    pub provenance: Provenance,
}

impl Metadata {
    /// The outputs that predict quantities: those before the first predicted standard deviation.
    pub fn predictions(&self) -> &[Output] {
        let count = self.outputs.iter().take_while(|output| output.std_of.is_none()).count();
        &self.outputs[..count]
    }
}
