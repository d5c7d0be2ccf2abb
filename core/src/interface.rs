//! The interface of a model of another tool: which of its columns is which variable of the FMU.

use crate::{
    Error, Result,
    diagnostics::{
        Problems,
        names::expected_one_of,
        origin::{self, Origin, Problem},
        schema,
    },
    study::{MAX_NAME, check_variable_name},
};
use indexmap::IndexMap;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::{
    collections::HashMap,
    path::{Path, PathBuf},
    sync::LazyLock,
};

/// An interface file: names, units and ranges of what a model of another tool takes and gives.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Interface {
    /// Names the surrogate and its FMU: a letter, then letters, digits, `-` and `_`; at most 100 characters.
    pub name: String,
    /// One sentence for people.
    #[serde(default)]
    pub description: String,
    /// When the FMU is stepped, unless the host says otherwise.
    #[serde(default)]
    pub time: InterfaceTime,
    /// The layers, of a model that is only tensors by name (`.npz`, `.safetensors`); ONNX files have them.
    #[serde(default)]
    pub layers: Vec<LayerOptions>,
    /// Inputs of the FMU by name. Each is a column of the model: in the order of the model's unless they say which.
    pub inputs: IndexMap<String, InterfaceInput>,
    /// Outputs of the FMU by name, likewise. Columns of the model that are not named are left out.
    pub outputs: IndexMap<String, InterfaceOutput>,
    #[serde(skip)]
    origin: Origin,
}

/// `[time]`
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct InterfaceTime {
    /// The natural communication step size.
    #[schemars(extend("x-unit" = "s", "exclusiveMinimum" = 0))]
    pub step: f64,
    /// End of a simulation.
    #[schemars(extend("x-unit" = "s", "exclusiveMinimum" = 0))]
    pub stop: f64,
}

impl Default for InterfaceTime {
    fn default() -> Self {
        Self { step: 0.01, stop: 1.0 }
    }
}

/// A dense layer, `f(W x + b)`, of tensors by name.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LayerOptions {
    /// Name of the tensor `W`: a row for each output, as PyTorch has it, or a column for each, as Keras, JAX and scikit-learn have it; the
    /// bias tells which. Of a square one `transposed` does.
    pub weight: String,
    /// Name of the tensor `b`; zero unless given.
    pub bias: Option<String>,
    /// `f`: tanh, sigmoid, relu, gelu, gelu-exact, silu, sine, identity, leaky-relu (0.01), elu, softplus, softsign.
    #[serde(default = "identity")]
    pub activation: String,
    /// Whether `W` has a column for each output.
    pub transposed: Option<bool>,
}

fn identity() -> String {
    "identity".into()
}

/// An entry of `[inputs]`.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct InterfaceInput {
    /// Which column of the model, for instance `x[0]`; the next one unless given. Either all inputs say so or none.
    pub column: Option<String>,
    /// What it is to a host.
    pub causality: InterfaceCausality,
    /// When a host may change a parameter.
    pub variability: Option<InterfaceVariability>,
    /// Smallest value for which the model was made.
    #[schemars(extend("x-unit" = "the input's"))]
    pub min: Option<f64>,
    /// Largest value for which the model was made.
    #[schemars(extend("x-unit" = "the input's"))]
    pub max: Option<f64>,
    /// Value before a host sets one; the middle of the range unless given.
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

/// What an input is to a host (FMI terms).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum InterfaceCausality {
    /// Another component drives it while the simulation runs.
    #[default]
    Input,
    /// It is set before the simulation, or between two steps.
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

/// An entry of `[outputs]`.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct InterfaceOutput {
    /// Which column of the model, for instance `y[0]`; the next one unless given. Either all outputs say so or none.
    pub column: Option<String>,
    /// Unit, for instance `rad/s`.
    pub unit: String,
    /// One sentence for people.
    pub description: String,
}

static SCHEMA: LazyLock<serde_json::Value> = LazyLock::new(schema::of::<Interface>);

/// The JSON schema of an interface file.
pub fn json_schema() -> &'static serde_json::Value {
    &SCHEMA
}

/// Where each column of a model comes from and goes to.
#[derive(Clone, Debug, PartialEq)]
pub struct Mapping {
    /// Of each column that the model takes.
    pub inputs: Vec<Source>,
    /// Of each output of the FMU its position among the columns that the model gives.
    pub outputs: Vec<usize>,
}

/// Where a column of a model comes from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Source {
    /// An input of the FMU, by its position among those that are variables.
    Input(usize),
    /// Always the same.
    Value(f64),
}

impl Interface {
    /// Reads and checks an interface file.
    ///
    /// # Errors
    /// [`Error::Io`] if it cannot be read, [`Error::Study`] with every mistake.
    pub fn load(path: &Path) -> Result<Self> {
        Self::parse(&origin::read(path, "an interface in TOML")?, path)
    }

    /// Reads and checks the text of an interface file; `path` is for messages.
    ///
    /// # Errors
    /// [`Error::Study`] with every mistake.
    pub fn parse(text: &str, path: &Path) -> Result<Self> {
        let origin = Origin::new(path, text);
        let root = origin.parse()?;
        let hint = "this is a study, expected an interface: `metafmu import MODEL --new FILE` writes one";
        origin.refuse_section("source", hint)?;
        let (problems, damaged) = origin.structure(root.get_ref(), &SCHEMA, |_, _| None);
        if !damaged.is_empty() || !problems.is_empty() {
            return Err(Error::Study { problems });
        }
        let mut interface: Self = origin.deserialize(root)?;
        interface.origin = origin;
        interface.origin.refuse(interface.problems())?;
        Ok(interface)
    }

    /// The same of JSON, which another program wrote: what is wrong with it has keys, but no lines.
    ///
    /// # Errors
    /// [`Error::Study`] with every mistake.
    pub fn from_json(text: &str) -> Result<Self> {
        let origin = Origin::new(Path::new(""), text);
        let mut interface: Self = serde_json::from_str(text).map_err(|error| {
            let message = error.to_string();
            Error::Study { problems: vec![Problem { path: PathBuf::new(), line: 1, key: String::new(), message }] }
        })?;
        interface.origin = origin;
        interface.origin.refuse(interface.problems())?;
        Ok(interface)
    }

    /// The file.
    pub fn path(&self) -> &Path {
        self.origin.path()
    }

    /// Its text.
    pub fn text(&self) -> &str {
        self.origin.text()
    }

    /// Inputs that are variables of the FMU.
    pub fn variables(&self) -> impl Iterator<Item = (&String, &InterfaceInput)> {
        self.inputs.iter().filter(|(_, input)| input.value.is_none())
    }

    /// Fails with problems of keys.
    ///
    /// # Errors
    /// [`Error::Study`] if there are any.
    pub fn refuse(&self, problems: Problems) -> Result<()> {
        self.origin.refuse(problems)
    }

    /// Which column is which variable, of a model with columns of these names.
    ///
    /// # Errors
    /// [`Error::Study`] for columns that there are not, too few or too many of them, or one that is named twice.
    pub fn mapping(&self, inputs: &[String], outputs: &[String]) -> Result<Mapping> {
        let mut problems = Problems::default();
        let given = |(name, input): (&String, &InterfaceInput)| (name.clone(), input.column.clone());
        let columns = columns("inputs", self.inputs.iter().map(given).collect(), inputs, true, &mut problems);
        let given = |(name, output): (&String, &InterfaceOutput)| (name.clone(), output.column.clone());
        let of_outputs =
            self::columns("outputs", self.outputs.iter().map(given).collect(), outputs, false, &mut problems);
        self.origin.refuse(problems)?;
        let mut sources = vec![Source::Value(0.0); inputs.len()];
        let mut variable = 0;
        for (column, input) in columns.into_iter().zip(self.inputs.values()) {
            sources[column] = match input.value {
                Some(value) => Source::Value(value),
                None => {
                    variable += 1;
                    Source::Input(variable - 1)
                }
            };
        }
        Ok(Mapping { inputs: sources, outputs: of_outputs })
    }

    /// What is wrong with it by itself.
    fn problems(&self) -> Problems {
        let mut problems = Problems::default();
        let is_good = |name: &str| {
            name.starts_with(|first: char| first.is_ascii_alphabetic())
                && name.chars().all(|other| other.is_ascii_alphanumeric() || matches!(other, '-' | '_'))
                && name.len() <= MAX_NAME
        };
        let expected = "a letter, then letters, digits, `-` and `_`, at most 100 characters";
        problems.expect(is_good(&self.name), "name", format!("`{}`", self.name), expected);
        problems.expect_positive("time.step", self.time.step);
        problems.expect_positive("time.stop", self.time.stop);
        if self.variables().next().is_none() {
            problems.add("inputs", "no input that is a variable, expected at least one");
        }
        if self.outputs.is_empty() {
            problems.add("outputs", "no output, expected at least one");
        }
        let mut time: Option<&str> = None;
        for (name, input) in &self.inputs {
            let key = format!("inputs.{name}");
            // the time is the independent variable, whatever the column is called
            if input.causality != InterfaceCausality::Time {
                check_variable_name(&mut problems, &key, name);
            }
            input.add_problems(&mut problems, &key);
            if input.causality == InterfaceCausality::Time
                && let Some(other) = time.replace(name)
            {
                problems.add(format!("{key}.causality"), format!("\"time\", but `{other}` is the time already"));
            }
        }
        for (name, output) in &self.outputs {
            let key = format!("outputs.{name}");
            check_variable_name(&mut problems, &key, name);
            if self.inputs.contains_key(name) {
                problems.add(&key, format!("`{name}` is an input already: names of variables must be unique"));
            }
            check_text(&mut problems, &key, &output.unit, &output.description);
        }
        problems
    }
}

impl InterfaceInput {
    fn add_problems(&self, problems: &mut Problems, key: &str) {
        let Self { causality, variability, min, max, start, value, .. } = self;
        check_text(problems, key, &self.unit, &self.description);
        for (field, given) in [("min", min), ("max", max), ("start", start), ("value", value)] {
            if let Some(number) = given.filter(|number| !number.is_finite()) {
                problems.add(format!("{key}.{field}"), format!("{number}, expected a finite number"));
            }
        }
        if value.is_some() {
            for (field, given) in [("min", min.is_some()), ("max", max.is_some()), ("start", start.is_some())] {
                problems.expect_absent(
                    given,
                    format!("{key}.{field}"),
                    "belongs to a variable, which an input with a `value` is not",
                );
            }
        }
        if let (Some(min), Some(max)) = (min, max)
            && min > max
        {
            problems.add(format!("{key}.max"), format!("{max}, expected at least min, which is {min}"));
        }
        if let (Some(start), Some(min), Some(max)) = (start, min, max)
            && min <= max
            && !(min..=max).contains(&start)
        {
            problems.add(format!("{key}.start"), format!("{start}, expected a value from {min} to {max}"));
        }
        if variability.is_some() && *causality != InterfaceCausality::Parameter {
            problems.add(format!("{key}.variability"), "belongs to causality = \"parameter\"");
        }
    }
}

/// Units and descriptions are single lines.
fn check_text(problems: &mut Problems, key: &str, unit: &str, description: &str) {
    for (field, text) in [("unit", unit), ("description", description)] {
        if text.chars().any(char::is_control) {
            problems.add(format!("{key}.{field}"), "has a control character, expected one line of text");
        }
    }
}

/// The position of each variable's column.
fn columns(
    section: &str,
    given: Vec<(String, Option<String>)>,
    known: &[String],
    all: bool,
    problems: &mut Problems,
) -> Vec<usize> {
    let names: Vec<&str> = known.iter().map(String::as_str).collect();
    let count =
        |what: &str| format!("{} {section}, but the model has {} columns of {section}{what}", given.len(), known.len());
    if given.iter().all(|(_, column)| column.is_none()) {
        if given.len() > known.len() || (all && given.len() < known.len()) {
            problems.add(section, count(": expected one for each"));
        } else if given.len() < known.len() {
            problems.add(section, count(": expected one for each, or `column` in each of them"));
        }
        return (0..given.len()).collect();
    }
    let places: HashMap<&str, usize> = names.iter().enumerate().map(|(place, name)| (*name, place)).collect();
    let mut found: Vec<usize> = Vec::new();
    let mut first: HashMap<usize, &str> = HashMap::new();
    for (name, column) in &given {
        let key = format!("{section}.{name}");
        let Some(column) = column else {
            problems.add(key, "no `column`, which others have: expected one in each of them or in none");
            continue;
        };
        match places.get(column.as_str()).copied() {
            None => {
                let expected = expected_one_of(column, &names);
                problems.add(
                    format!("{key}.column"),
                    format!("\"{column}\" is no column of the model's {section}, {expected}"),
                );
            }
            Some(place) => {
                let other = *first.entry(place).or_insert(name);
                if all && other != name {
                    let message = format!("\"{column}\" is the column of `{other}` already");
                    problems.add(format!("{key}.column"), message);
                }
                found.push(place);
            }
        }
    }
    if all {
        let missing: Vec<&str> =
            (0..known.len()).filter(|place| !first.contains_key(place)).map(|place| names[place]).collect();
        if !missing.is_empty() && problems.is_empty() {
            let missing = crate::diagnostics::names::listed(&missing);
            problems.add(
                section,
                format!("no input for the columns {missing}: expected one for each, or one with a `value`"),
            );
        }
    }
    found
}
