//! The surrogate as data: variables, scaling, layers, provenance.

use crate::{
    Activation, FormatError,
    extra::{self, Extra},
};
use serde::{Deserialize, Serialize};
use std::collections::HashSet;

/// A feed-forward network with everything needed to use it: which variable each column is, in what unit, over
/// what range it was trained, and how columns are scaled.
///
/// With standardised inputs `z = (x - input_mean) / input_scale`, hidden layers `h = act(W h + b)` and a linear last
/// layer, the outputs are `y = output_mean + output_scale * (W h + b)`.
///
/// A value of this type has been validated: shapes fit, every number is finite, names are unique, ranges are not empty.
#[derive(Clone, Debug, PartialEq)]
pub struct Surrogate {
    metadata: Metadata,
    scaling: Scaling,
    layers: Vec<Layer>,
}

/// The descriptive part of a [`Surrogate`], kept as JSON in the model file's metadata.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Metadata {
    /// Name of the surrogate; also the FMU's model name.
    pub name: String,
    /// One sentence for people.
    pub description: String,
    /// The network's input columns, in order.
    pub inputs: Vec<Input>,
    /// The network's output columns, in order.
    pub outputs: Vec<Output>,
    /// Activation of every hidden layer.
    pub activation: Activation,
    /// What the network computes in.
    #[serde(default, skip_serializing_if = "Precision::is_double")]
    pub precision: Precision,
    /// Time between two rows of a training run, in seconds: the natural communication step size.
    pub time_step: f64,
    /// Where the surrogate comes from.
    pub provenance: Provenance,
}

/// One input column of the network.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Input {
    /// Variable name, as the FMU shows it.
    pub name: String,
    /// What the column is to a host.
    pub role: Role,
    /// Unit, for instance `rad/s`; empty for a dimensionless quantity.
    pub unit: String,
    /// One sentence for people.
    pub description: String,
    /// Smallest value in the training range.
    pub min: f64,
    /// Largest value in the training range.
    pub max: f64,
    /// Value before a host sets one; within the range.
    pub start: f64,
}

/// What an input column of the network is to a host.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase", tag = "causality", content = "variability")]
pub enum Role {
    /// A parameter the host sets.
    Parameter(Variability),
    /// The simulation time.
    Time,
    /// A continuous input: another component drives it while the simulation runs.
    Input,
}

/// What a network computes in. Weights are kept in single precision and scaling is done in double precision either way.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// Outputs smooth enough for solvers with tight tolerances.
    #[default]
    Double,
    /// Twice as fast, errors around 1e-6 of the outputs' scale: for real-time co-simulation.
    Single,
}

impl Precision {
    fn is_double(&self) -> bool {
        *self == Self::Double
    }
}

/// When a host may change a parameter (FMI terms).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Variability {
    /// Only before the simulation starts.
    Fixed,
    /// Also between two communication steps.
    #[default]
    Tunable,
}

/// One output column of the network.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Output {
    /// Variable name, as the FMU shows it.
    pub name: String,
    /// Unit; empty for a dimensionless quantity.
    pub unit: String,
    /// One sentence for people.
    pub description: String,
    /// Smallest value seen in training.
    pub min: f64,
    /// Largest value seen in training.
    pub max: f64,
}

/// Where a surrogate comes from; enough to make it again.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Provenance {
    /// Name and version of the program that wrote the file.
    pub tool: String,
    /// SHA-256 of the study's content, in hexadecimal digits.
    pub study_digest: String,
    /// The study's seed.
    pub seed: u64,
    /// Number of training rows.
    pub train_rows: u64,
    /// SHA-256 of everything in the file but this field: the FMU's GUID is made from it.
    pub content_digest: String,
}

/// Column-wise affine scaling of inputs and outputs: `standardised = (value - mean) / scale`.
#[derive(Clone, Debug, PartialEq)]
pub struct Scaling {
    /// Means of the input columns.
    pub input_mean: Vec<f64>,
    /// Scales of the input columns, each positive.
    pub input_scale: Vec<f64>,
    /// Means of the output columns.
    pub output_mean: Vec<f64>,
    /// Scales of the output columns, each positive.
    pub output_scale: Vec<f64>,
}

/// One dense layer, `W x + b`, as trained in single precision.
#[derive(Clone, Debug, PartialEq)]
pub struct Layer {
    /// Number of columns of `W`.
    pub inputs: usize,
    /// Number of rows of `W`.
    pub outputs: usize,
    /// `W`, row by row: shape `[outputs, inputs]`, as in PyTorch's `Linear`.
    pub weight: Vec<f32>,
    /// `b`: shape `[outputs]`.
    pub bias: Vec<f32>,
}

impl Surrogate {
    /// Puts the parts together and validates them.
    ///
    /// # Errors
    /// The first [`FormatError`] that says how the parts do not fit each other.
    pub fn new(metadata: Metadata, scaling: Scaling, layers: Vec<Layer>) -> Result<Self, FormatError> {
        validate_metadata(&metadata)?;
        let (inputs, outputs) = (metadata.inputs.len(), metadata.outputs.len());
        for (name, column, expected) in [
            ("input_mean", &scaling.input_mean, inputs),
            ("input_scale", &scaling.input_scale, inputs),
            ("output_mean", &scaling.output_mean, outputs),
            ("output_scale", &scaling.output_scale, outputs),
        ] {
            expect_shape(name, &[column.len()], &[expected])?;
            expect_finite(name, column.iter().copied())?;
            if name.ends_with("scale") {
                expect_positive(name, column)?;
            }
        }
        validate_layers(&layers, inputs, outputs)?;
        Ok(Self { metadata, scaling, layers })
    }

    /// Name, variables, provenance.
    pub fn metadata(&self) -> &Metadata {
        &self.metadata
    }

    /// The network's input columns, in order.
    pub fn inputs(&self) -> &[Input] {
        &self.metadata.inputs
    }

    /// The network's output columns, in order.
    pub fn outputs(&self) -> &[Output] {
        &self.metadata.outputs
    }

    /// Position of the time column among the inputs, if time is an input.
    pub fn time_column(&self) -> Option<usize> {
        self.inputs().iter().position(|input| input.role == Role::Time)
    }

    /// Scaling of inputs and outputs.
    pub fn scaling(&self) -> &Scaling {
        &self.scaling
    }

    /// The layers, first to last.
    pub fn layers(&self) -> &[Layer] {
        &self.layers
    }

    /// FMI value reference of output `index`. An input column's value reference is its position; outputs follow.
    pub fn output_value_reference(&self, index: usize) -> u32 {
        (self.inputs().len() + index) as u32
    }

    /// FMI value reference of a variable that every FMU adds: they follow the outputs.
    pub fn extra_value_reference(&self, extra: &Extra) -> u32 {
        (self.inputs().len() + self.outputs().len()) as u32 + extra.offset
    }

    /// FMI 2.0 `guid` and FMI 3.0 `instantiationToken`: the first 128 bits of the content digest, so that a description
    /// and a model file that do not belong together are told apart.
    pub fn instantiation_token(&self) -> String {
        let digits = &self.metadata.provenance.content_digest;
        let parts = [&digits[..8], &digits[8..12], &digits[12..16], &digits[16..20], &digits[20..32]];
        format!("{{{}}}", parts.join("-"))
    }

    /// The same surrogate with another content digest.
    ///
    /// # Errors
    /// [`FormatError::Digest`] if it is not 64 hexadecimal digits.
    pub fn with_content_digest(mut self, digest: String) -> Result<Self, FormatError> {
        self.metadata.provenance.content_digest = digest;
        Self::new(self.metadata, self.scaling, self.layers)
    }
}

fn validate_metadata(metadata: &Metadata) -> Result<(), FormatError> {
    if metadata.inputs.is_empty() {
        return Err(FormatError::NoVariables { what: "inputs" });
    }
    if metadata.outputs.is_empty() {
        return Err(FormatError::NoVariables { what: "outputs" });
    }
    let has_time = metadata.inputs.iter().any(|input| input.role == Role::Time);
    let mut names = HashSet::new();
    let inputs = metadata.inputs.iter().map(|v| (&v.name, v.min, v.max));
    let outputs = metadata.outputs.iter().map(|v| (&v.name, v.min, v.max));
    for (name, min, max) in inputs.chain(outputs) {
        if extra::ALL.iter().any(|extra| extra.name == name) || (!has_time && extra::TIME.name == name) {
            return Err(FormatError::ReservedName { name: name.clone() });
        }
        if !names.insert(name) {
            return Err(FormatError::DuplicateVariable { name: name.clone() });
        }
        if !(min.is_finite() && max.is_finite() && min <= max) {
            return Err(FormatError::EmptyRange { name: name.clone(), min, max });
        }
    }
    for input in &metadata.inputs {
        if !(input.min..=input.max).contains(&input.start) {
            let Input { name, start, min, max, .. } = input.clone();
            return Err(FormatError::StartOutsideRange { name, start, min, max });
        }
    }
    let times = metadata.inputs.iter().filter(|input| input.role == Role::Time).count();
    if times > 1 {
        return Err(FormatError::SeveralTimes { count: times });
    }
    if !(metadata.time_step.is_finite() && metadata.time_step > 0.0) {
        return Err(FormatError::TimeStep { found: metadata.time_step });
    }
    let digest = &metadata.provenance.content_digest;
    if digest.len() != 64 || !digest.bytes().all(|byte| byte.is_ascii_hexdigit()) {
        return Err(FormatError::Digest { found: digest.clone() });
    }
    Ok(())
}

fn validate_layers(layers: &[Layer], inputs: usize, outputs: usize) -> Result<(), FormatError> {
    if layers.is_empty() {
        return Err(FormatError::MissingTensor { name: "layers.0.weight".into() });
    }
    let mut width = inputs;
    for (index, layer) in layers.iter().enumerate() {
        let rows = if index + 1 == layers.len() { outputs } else { layer.outputs };
        let (weight, bias) = (format!("layers.{index}.weight"), format!("layers.{index}.bias"));
        expect_shape(&weight, &[layer.outputs, layer.inputs], &[rows, width])?;
        expect_shape(&weight, &[layer.weight.len()], &[rows * width])?;
        expect_shape(&bias, &[layer.bias.len()], &[rows])?;
        expect_finite(&weight, layer.weight.iter().map(|&w| w.into()))?;
        expect_finite(&bias, layer.bias.iter().map(|&b| b.into()))?;
        width = rows;
    }
    Ok(())
}

fn expect_shape(name: &str, found: &[usize], expected: &[usize]) -> Result<(), FormatError> {
    if found == expected {
        return Ok(());
    }
    Err(FormatError::Shape { name: name.into(), found: found.into(), expected: expected.into() })
}

fn expect_finite(name: &str, values: impl Iterator<Item = f64>) -> Result<(), FormatError> {
    match values.enumerate().find(|(_, value)| !value.is_finite()) {
        Some((index, value)) => Err(FormatError::NotFinite { name: name.into(), index, value }),
        None => Ok(()),
    }
}

fn expect_positive(name: &str, values: &[f64]) -> Result<(), FormatError> {
    match values.iter().enumerate().find(|&(_, &value)| value <= 0.0) {
        Some((index, &value)) => Err(FormatError::NotPositive { name: name.into(), index, value }),
        None => Ok(()),
    }
}
