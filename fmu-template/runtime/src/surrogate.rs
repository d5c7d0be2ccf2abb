//! The surrogate as data: variables, scaling, layers, provenance.

use crate::{
    Activation, Bounds, Encoder, Encoding, FormatError,
    extra::{self, Extra},
    regression::Regression,
};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::{
    collections::{HashMap, HashSet},
    fmt::Write,
};

/// A model with everything needed to use it: which variable each column is, in what unit, and over what range it was
/// trained.
///
/// A value of this type has been validated: shapes fit, every number is finite, names are unique, ranges are not empty.
#[derive(Clone, Debug, PartialEq)]
pub struct Surrogate {
    metadata: Metadata,
    model: Model,
    /// Output columns of each array, in the order of its elements; made from the metadata.
    array_columns: Vec<Vec<usize>>,
}

/// What computes a surrogate's outputs from its inputs.
#[derive(Clone, Debug, PartialEq)]
pub enum Model {
    /// One network; the time, if it is an input, is a column like the others.
    Network(ScaledNetwork),
    /// A network for each of some instants `t_0 < ... < t_N`, whose inputs are the columns other than the time. Between
    /// two instants the outputs are interpolated linearly in time, `y = (1 - w) y_k + w y_(k+1)` with
    /// `w = (t - t_k) / (t_(k+1) - t_k)`; before the first and after the last one they do not depend on the time.
    Series {
        /// `t_0, ..., t_N` in seconds, at least two.
        instants: Vec<f64>,
        /// One an instant, all with layers of the same sizes.
        networks: Vec<ScaledNetwork>,
    },
    /// A formula in double precision.
    Regression(Regression),
}

/// A feed-forward network and the scaling of its columns.
///
/// With standardised inputs `z = (x - input_mean) / input_scale`, `x` the inputs after their [`Encoding`], hidden layers `h = act(W h + b)` and a linear last
/// layer, the outputs are `y = output_mean + output_scale * (W h + b)`.
#[derive(Clone, Debug, PartialEq)]
pub struct ScaledNetwork {
    /// Scaling of inputs and outputs.
    pub scaling: Scaling,
    /// The layers, first to last.
    pub layers: Vec<Layer>,
}

/// The descriptive part of a [`Surrogate`], kept as JSON in the model file's metadata.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Metadata {
    /// Name of the surrogate; also the FMU's model name.
    pub name: String,
    /// One sentence for people.
    pub description: String,
    /// The inputs, in order.
    pub inputs: Vec<Input>,
    /// The network's output columns, in order.
    pub outputs: Vec<Output>,
    /// Outputs grouped into arrays, for FMI 3.0; each output is a variable of its own all the same.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub arrays: Vec<OutputArray>,
    /// How far outputs may be from the truth, if that was measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bounds: Option<Bounds>,
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

/// One input of the surrogate: a column of the network, or several if its encoding says so.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Input {
    /// Variable name, as the FMU shows it.
    pub name: String,
    /// What the input is to a host.
    pub role: Role,
    /// Unit, for instance `rad/s`; empty for a dimensionless quantity.
    pub unit: String,
    /// One sentence for people.
    pub description: String,
    /// Smallest value in the training range.
    pub min: f64,
    /// Largest value in the training range.
    pub max: f64,
    /// Value before a host sets one; within the range, and one of the values of a nominal input.
    pub start: f64,
    /// How its value becomes columns of the network.
    #[serde(default, skip_serializing_if = "Encoding::is_plain")]
    pub encoding: Encoding,
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
    #[default]
    Fixed,
    /// Also between two communication steps.
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

impl Output {
    /// Name of the variable that holds the error bound.
    pub fn bound_name(&self) -> String {
        format!("{}_bound", self.name)
    }
}

/// Several outputs of one unit as one array variable of FMI 3.0, for instance the coordinates of a point.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OutputArray {
    /// Variable name, as the FMU shows it.
    pub name: String,
    /// One sentence for people.
    pub description: String,
    /// Names of the outputs that are the elements, in order; at least two, each at most once.
    pub outputs: Vec<String>,
}

/// In place of the digest of a surrogate that has none yet.
const UNSEALED: &str = "0000000000000000000000000000000000000000000000000000000000000000";

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

/// Column-wise affine scaling of inputs and outputs: `standardised = (value - mean) / scale`. Input columns are those after
/// the inputs' [`Encoding`].
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
    pub fn new(metadata: Metadata, model: Model) -> Result<Self, FormatError> {
        validate_metadata(&metadata)?;
        let array_columns = array_columns(&metadata)?;
        let columns = Encoder::of(&metadata.inputs).width();
        match &model {
            Model::Network(network) => validate_network(network, columns, metadata.outputs.len())?,
            Model::Series { instants, networks } => validate_series(instants, networks, &metadata)?,
            Model::Regression(regression) => {
                validate_scaling(&regression.scaling, columns, metadata.outputs.len())?;
                regression.check()?;
            }
        }
        Ok(Self { metadata, model, array_columns })
    }

    /// Name, variables, provenance.
    pub fn metadata(&self) -> &Metadata {
        &self.metadata
    }

    /// The inputs, in order.
    pub fn inputs(&self) -> &[Input] {
        &self.metadata.inputs
    }

    /// The network's output columns, in order.
    pub fn outputs(&self) -> &[Output] {
        &self.metadata.outputs
    }

    /// Outputs grouped into arrays, in order.
    pub fn arrays(&self) -> &[OutputArray] {
        &self.metadata.arrays
    }

    /// Error bounds of the outputs, if they were measured.
    pub fn bounds(&self) -> Option<&Bounds> {
        self.metadata.bounds.as_ref()
    }

    /// Position of the time column among the inputs, if time is an input.
    pub fn time_column(&self) -> Option<usize> {
        self.inputs().iter().position(|input| input.role == Role::Time)
    }

    /// What computes the outputs.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// The network, if it is a single one.
    pub fn network(&self) -> Option<&ScaledNetwork> {
        match &self.model {
            Model::Network(network) => Some(network),
            Model::Series { .. } | Model::Regression(_) => None,
        }
    }

    /// FMI value reference of output `index`. An input column's value reference is its position; outputs follow.
    pub fn output_value_reference(&self, index: usize) -> u32 {
        (self.inputs().len() + index) as u32
    }

    /// FMI value reference of a variable that every FMU adds: they follow the outputs.
    pub fn extra_value_reference(&self, extra: &Extra) -> u32 {
        (self.inputs().len() + self.outputs().len()) as u32 + extra.offset
    }

    /// FMI 3.0 value reference of array `index`. Arrays follow everything else; the value reference of
    /// [`extra::TIME`] is left out for them even if a column is the time.
    pub fn array_value_reference(&self, index: usize) -> u32 {
        self.extra_value_reference(&extra::TIME) + 1 + index as u32
    }

    /// FMI value reference of the error bound of output `index`: they follow the arrays, also in FMI 2.0, which has none.
    pub fn bound_value_reference(&self, index: usize) -> u32 {
        self.array_value_reference(self.arrays().len() + index)
    }

    /// Unit of all elements of array `index`, and which outputs they are.
    ///
    /// # Panics
    /// If there is no such array.
    pub fn array_elements(&self, index: usize) -> (&str, &[usize]) {
        let columns = &self.array_columns[index];
        (&self.outputs()[columns[0]].unit, columns)
    }

    /// FMI 2.0 `guid` and FMI 3.0 `instantiationToken`: the first 128 bits of the content digest, so that a description
    /// and a model file that do not belong together are told apart.
    pub fn instantiation_token(&self) -> String {
        let digits = &self.metadata.provenance.content_digest;
        let parts = [&digits[..8], &digits[8..12], &digits[12..16], &digits[16..20], &digits[20..32]];
        format!("{{{}}}", parts.join("-"))
    }

    /// SHA-256 of the model file with sixty-four zeros in place of the digest itself, in hexadecimal digits.
    ///
    /// # Errors
    /// As [`Surrogate::to_bytes`].
    pub fn content_digest(&self) -> Result<String, FormatError> {
        let blank = self.clone().with_content_digest(UNSEALED.into())?;
        Ok(Sha256::digest(blank.to_bytes()?).iter().fold(String::new(), |mut text, byte| {
            // writing to a string does not fail
            let _ = write!(text, "{byte:02x}");
            text
        }))
    }

    /// The surrogate with the digest of its content: the last step of making one.
    ///
    /// # Errors
    /// As [`Surrogate::to_bytes`].
    pub fn sealed(self) -> Result<Self, FormatError> {
        let digest = self.content_digest()?;
        self.with_content_digest(digest)
    }

    /// Makes sure that nothing changed since the digest was put in. Of a file without one nothing is known.
    ///
    /// # Errors
    /// [`FormatError::Damaged`] if the content has another digest.
    pub fn check_content(&self) -> Result<(), FormatError> {
        let noted = &self.metadata.provenance.content_digest;
        if noted == UNSEALED {
            return Ok(());
        }
        let found = self.content_digest()?;
        if *noted == found { Ok(()) } else { Err(FormatError::Damaged { found, expected: noted.clone() }) }
    }

    /// The same surrogate with error bounds; to be sealed again.
    ///
    /// # Errors
    /// [`FormatError::BoundCount`] or [`FormatError::Bound`] if the bounds do not fit the outputs.
    pub fn with_bounds(mut self, bounds: Bounds) -> Result<Self, FormatError> {
        self.metadata.bounds = Some(bounds);
        Self::new(self.metadata, self.model)
    }

    /// The same surrogate with another content digest.
    ///
    /// # Errors
    /// [`FormatError::Digest`] if it is not 64 hexadecimal digits.
    pub fn with_content_digest(mut self, digest: String) -> Result<Self, FormatError> {
        self.metadata.provenance.content_digest = digest;
        Self::new(self.metadata, self.model)
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
    let arrays = metadata.arrays.iter().map(|array| &array.name);
    let bounds: Vec<String> =
        metadata.bounds.iter().flat_map(|_| metadata.outputs.iter().map(Output::bound_name)).collect();
    for name in inputs.clone().chain(outputs.clone()).map(|(name, ..)| name).chain(arrays).chain(&bounds) {
        if extra::ALL.iter().any(|extra| extra.name == name) || (!has_time && extra::TIME.name == name) {
            return Err(FormatError::ReservedName { name: name.clone() });
        }
        if !names.insert(name) {
            return Err(FormatError::DuplicateVariable { name: name.clone() });
        }
    }
    for (name, min, max) in inputs.chain(outputs) {
        if !(min.is_finite() && max.is_finite() && min <= max) {
            return Err(FormatError::EmptyRange { name: name.clone(), min, max });
        }
    }
    for input in &metadata.inputs {
        input.check_encoding()?;
        if !(input.min..=input.max).contains(&input.start) {
            let Input { name, start, min, max, .. } = input.clone();
            return Err(FormatError::StartOutsideRange { name, start, min, max });
        }
    }
    let times = metadata.inputs.iter().filter(|input| input.role == Role::Time).count();
    if times > 1 {
        return Err(FormatError::SeveralTimes { count: times });
    }
    if let Some(bounds) = &metadata.bounds {
        bounds.check(metadata.outputs.len())?;
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

/// The output columns of each array.
fn array_columns(metadata: &Metadata) -> Result<Vec<Vec<usize>>, FormatError> {
    let positions: HashMap<&str, usize> =
        metadata.outputs.iter().enumerate().map(|(column, output)| (output.name.as_str(), column)).collect();
    metadata.arrays.iter().map(|array| columns_of(array, &metadata.outputs, &positions)).collect()
}

fn columns_of(
    array: &OutputArray,
    outputs: &[Output],
    positions: &HashMap<&str, usize>,
) -> Result<Vec<usize>, FormatError> {
    let name = || array.name.clone();
    if array.outputs.len() < 2 {
        return Err(FormatError::ShortArray { array: name(), count: array.outputs.len() });
    }
    let mut columns = Vec::with_capacity(array.outputs.len());
    let mut seen = HashSet::new();
    for output in &array.outputs {
        let Some(&column) = positions.get(output.as_str()) else {
            return Err(FormatError::UnknownElement { array: name(), output: output.clone() });
        };
        if !seen.insert(column) {
            return Err(FormatError::DuplicateElement { array: name(), output: output.clone() });
        }
        columns.push(column);
        let (found, expected) = (&outputs[column].unit, &outputs[columns[0]].unit);
        if found != expected {
            let (output, found, expected) = (output.clone(), found.clone(), expected.clone());
            return Err(FormatError::ElementUnit { array: name(), output, found, expected });
        }
    }
    Ok(columns)
}

fn validate_network(network: &ScaledNetwork, inputs: usize, outputs: usize) -> Result<(), FormatError> {
    validate_scaling(&network.scaling, inputs, outputs)?;
    validate_layers(&network.layers, inputs, outputs)
}

fn validate_scaling(scaling: &Scaling, inputs: usize, outputs: usize) -> Result<(), FormatError> {
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
    Ok(())
}

fn validate_series(instants: &[f64], networks: &[ScaledNetwork], metadata: &Metadata) -> Result<(), FormatError> {
    if metadata.inputs.iter().all(|input| input.role != Role::Time) {
        return Err(FormatError::NoTime);
    }
    // the time is one of them
    let columns = Encoder::of(&metadata.inputs).width() - 1;
    if columns == 0 {
        return Err(FormatError::OnlyTime);
    }
    if instants.len() < 2 {
        return Err(FormatError::FewInstants { count: instants.len() });
    }
    expect_finite("instants", instants.iter().copied())?;
    if let Some(index) = instants.windows(2).position(|pair| pair[0] >= pair[1]) {
        return Err(FormatError::NotAscending {
            index: index + 1,
            before: instants[index],
            found: instants[index + 1],
        });
    }
    if networks.len() != instants.len() {
        return Err(FormatError::NetworkCount { found: networks.len(), expected: instants.len() });
    }
    let sizes = |network: &ScaledNetwork| network.layers.iter().map(|layer| layer.outputs).collect::<Vec<_>>();
    for (instant, network) in networks.iter().enumerate() {
        let problem = |source| FormatError::OfInstant { instant, source: Box::new(source) };
        validate_network(network, columns, metadata.outputs.len()).map_err(problem)?;
        let (found, expected) = (sizes(network), sizes(&networks[0]));
        if found != expected {
            return Err(FormatError::LayerSizes { instant, found, expected });
        }
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

pub(crate) fn expect_shape(name: &str, found: &[usize], expected: &[usize]) -> Result<(), FormatError> {
    if found == expected {
        return Ok(());
    }
    Err(FormatError::Shape { name: name.into(), found: found.into(), expected: expected.into() })
}

pub(crate) fn expect_finite(name: &str, values: impl Iterator<Item = f64>) -> Result<(), FormatError> {
    match values.enumerate().find(|(_, value)| !value.is_finite()) {
        Some((index, value)) => Err(FormatError::NotFinite { name: name.into(), index, value }),
        None => Ok(()),
    }
}

pub(crate) fn expect_positive(name: &str, values: &[f64]) -> Result<(), FormatError> {
    match values.iter().enumerate().find(|&(_, &value)| value <= 0.0) {
        Some((index, &value)) => Err(FormatError::NotPositive { name: name.into(), index, value }),
        None => Ok(()),
    }
}
