//! The interface of a third-party model: which of its columns is which variable of the FMU.

mod of_study;
mod read;
mod with_std;

use crate::{
    Error, Result,
    diagnostics::{
        Problems,
        names::{expected_one_of, out_of_order_problem},
        origin::{self, Origin},
        problem::Problem,
        schema,
    },
    study::{MAX_NAME, MAX_VARIABLES, check_variable_name},
};
use indexmap::IndexMap;
pub use read::NO_SAMPLE_TIME;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::{
    collections::{HashMap, HashSet},
    path::{Path, PathBuf},
    sync::LazyLock,
};

/// An interface file: names, units and ranges of the inputs and outputs of a third-party model.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "Interface")]
pub struct ModelInterface {
    /// Names the surrogate and its FMU: a letter, then letters, digits, `-` and `_`; at most 100 characters.
    pub name: String,
    /// One sentence for people.
    #[serde(default)]
    pub description: String,
    /// Default experiment of the FMU.
    #[serde(default)]
    pub time: InterfaceTime,
    /// Domain of validity that the FMU reports, if there is a table of training data.
    #[serde(default)]
    pub domain: InterfaceDomain,
    /// The layers, of a model that is only tensors by name (`.npz`, `.safetensors`); ONNX files have them.
    #[serde(default)]
    pub layers: Vec<LayerOptions>,
    /// Inputs of the FMU by name. Each is a column of the model: in the order of the model's unless they say which. Only models with states may have
    /// none.
    #[serde(default)]
    pub inputs: IndexMap<String, InterfaceInput>,
    /// States of the FMU by name: columns of the model's inputs whose next values, or whose derivatives, are columns of its outputs.
    #[serde(default)]
    pub states: IndexMap<String, InterfaceState>,
    /// Outputs of the FMU by name. Each is a column of the model: in the order of the model's unless they say which.
    /// Columns of the model that are not named are ignored.
    pub outputs: IndexMap<String, InterfaceOutput>,
    #[serde(skip)]
    origin: Origin,
}

/// Domain of validity, beside the ranges of the inputs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum InterfaceDomain {
    /// Within the ranges, where rows of training data are near; of models without states.
    #[default]
    Data,
    /// Everywhere in the ranges.
    Ranges,
}

/// `[time]`
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct InterfaceTime {
    /// The natural communication step size; the sample time if there is one, else 0.01 s, unless given.
    #[schemars(extend("x-unit" = "s", "exclusiveMinimum" = 0))]
    pub step: Option<f64>,
    /// Sample time: the time between a state and its `next` value.
    #[schemars(extend("x-unit" = "s", "exclusiveMinimum" = 0))]
    pub sample: Option<f64>,
    /// Fixed step of the solver inside the FMU (Runge-Kutta, order 4), for real time and states that have a
    /// `derivative`. By default the solver controls its error, with a tolerance from simulations.
    #[schemars(extend("x-unit" = "s", "exclusiveMinimum" = 0))]
    pub solver_step: Option<f64>,
    /// End of a simulation.
    #[schemars(extend("x-unit" = "s", "exclusiveMinimum" = 0))]
    pub stop: f64,
}

impl Default for InterfaceTime {
    fn default() -> Self {
        Self { step: None, sample: None, solver_step: None, stop: 1.0 }
    }
}

impl InterfaceTime {
    /// The natural communication step size, in seconds.
    pub fn communication_step(&self) -> f64 {
        self.step.or(self.sample).unwrap_or(0.01)
    }
}

/// A dense layer, `f(W x + b)`, of tensors by name.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LayerOptions {
    /// Name of the tensor `W`: a row for each output, as in PyTorch, or a column for each, as in Keras, JAX and
    /// scikit-learn. The bias decides between the two, or `transposed` if `W` is square.
    pub weight: String,
    /// Name of the tensor `b`; zero by default.
    pub bias: Option<String>,
    /// `f`: tanh, sigmoid, relu, gelu, gelu-exact, silu, sine, identity, leaky-relu (0.01), elu, softplus, softsign.
    #[serde(default = "identity")]
    pub activation: String,
    /// True if `W` has a column for each output.
    pub transposed: Option<bool>,
}

fn identity() -> String {
    "identity".into()
}

/// An entry of `[inputs]`.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct InterfaceInput {
    /// Column of the model, for instance `x[0]`; by default the next one. Either all inputs say so or none.
    pub column: Option<String>,
    /// Causality, as a host sees it.
    pub causality: InterfaceCausality,
    /// When a host may change a parameter.
    pub variability: Option<InterfaceVariability>,
    /// Smallest value for which the model was made.
    #[schemars(extend("x-unit" = "the input's"))]
    pub min: Option<f64>,
    /// Largest value for which the model was made.
    #[schemars(extend("x-unit" = "the input's"))]
    pub max: Option<f64>,
    /// Value before a host sets one. By default it is the middle of the range, or if there are no data there, that of
    /// the nearest row.
    #[schemars(extend("x-unit" = "the input's"))]
    pub start: Option<f64>,
    /// The column has always this value: it is no variable of the FMU.
    #[schemars(extend("x-unit" = "the input's"))]
    pub value: Option<f64>,
    /// Unit, for instance `rad/s`.
    #[serde(default)]
    pub unit: String,
    /// One sentence for people.
    #[serde(default)]
    pub description: String,
}

/// Causality of an input, in terms of FMI.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum InterfaceCausality {
    /// Another component drives it while the simulation runs.
    #[default]
    Input,
    /// Set before the simulation, or between two steps.
    Parameter,
    /// The simulation time, in seconds.
    Time,
}

/// When a host may change a parameter (FMI terms).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum InterfaceVariability {
    /// Only before the simulation starts.
    Fixed,
    /// Also between two communication steps.
    Tunable,
}

/// An entry of `[states]`. It is discrete if it has `next`, continuous if it has `derivative`.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct InterfaceState {
    /// Which column of the model's inputs it is, for instance `x[0]`; or an input's name, for instance `h0`: all columns of it.
    pub column: String,
    /// Column of the model's outputs, or output with all its columns, that is the state one sample time later.
    pub next: Option<String>,
    /// Column of the model's outputs, or output with all its columns, that is its derivative with respect to time.
    pub derivative: Option<String>,
    /// Value at the start; of all columns.
    #[schemars(extend("x-unit" = "the state's"))]
    pub start: Option<f64>,
    /// Smallest value for which the model was made; of a state that has a derivative.
    #[schemars(extend("x-unit" = "the state's"))]
    pub min: Option<f64>,
    /// Largest value for which the model was made.
    #[schemars(extend("x-unit" = "the state's"))]
    pub max: Option<f64>,
    /// Unit, for instance `rad`.
    pub unit: String,
    /// One sentence for people.
    pub description: String,
}

/// Evolution of the states of an interface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Evolution {
    /// Discrete-time.
    Discrete,
    /// By their derivatives.
    Continuous,
}

/// An entry of `[outputs]`.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct InterfaceOutput {
    /// Column of the model, for instance `y[0]`; by default the next one. Either all outputs say so or none. Of a model
    /// with states it may be that of a state.
    pub column: Option<String>,
    /// Unit, for instance `rad/s`.
    pub unit: String,
    /// One sentence for people.
    pub description: String,
    /// Position of the output whose predicted standard deviation it is.
    #[serde(skip)]
    pub std_of: Option<u32>,
}

static SCHEMA: LazyLock<serde_json::Value> = LazyLock::new(schema::of::<ModelInterface>);

/// The JSON schema of an interface file.
pub fn json_schema() -> &'static serde_json::Value {
    &SCHEMA
}

/// Assignment of a model's columns to variables.
#[derive(Clone, Debug, PartialEq)]
pub struct Mapping {
    /// Source of each column that the model takes.
    pub inputs: Vec<ColumnSource>,
    /// Source of each output of the FMU.
    pub outputs: Vec<OutputSource>,
    /// Each column that is a state.
    pub states: Vec<Followed>,
}

/// A column that is a state.
#[derive(Clone, Debug, PartialEq)]
pub struct Followed {
    /// The state's name; with the position in brackets if it has several columns.
    pub name: String,
    /// Which entry of `[states]` it belongs to.
    pub of: usize,
    /// Its next value's, or its derivative's, position among the columns that the model gives.
    pub output: usize,
}

/// Source of an output.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum OutputSource {
    /// A column that the model gives.
    Column(usize),
    /// A column that is a state.
    State(usize),
}

/// Source of a column of a model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ColumnSource {
    /// An input of the FMU, by its position among those that are variables.
    Input(usize),
    /// Always the same.
    Value(f64),
    /// A column that is a state, by its position among those.
    State(usize),
}
