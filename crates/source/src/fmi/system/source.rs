//! Source of a component: an FMU, or a mechanism that is described as if it were one.

use super::run::ComponentModel;
use crate::{
    Error, Result,
    fmi::{
        ModelDescription,
        host::Unpacked,
        model_description::{Causality, RealAttributes, ScalarVariable, Variability, VariableType},
    },
    multibody::Mechanism,
};
use std::path::{Path, PathBuf};

/// Source of a component.
#[derive(Debug)]
pub enum ComponentSource {
    /// An FMU.
    Fmu(Box<Unpacked>),
    /// A mechanism.
    Mechanism {
        /// Its file, for messages.
        path: PathBuf,
        /// The content of the file.
        text: String,
        /// Its inputs, parameters and outputs; as constants, positions and velocities at the start by the names of their measures.
        description: Box<ModelDescription>,
    },
}

/// Scalar variables of a mechanism, which have their positions as value references.
#[derive(Default)]
struct ScalarVariables(Vec<ScalarVariable>);

impl ScalarVariables {
    fn add(&mut self, name: &str, causality: Causality, variability: Variability, start: Option<f64>, unit: &str) {
        let unit = (!unit.is_empty()).then(|| unit.to_owned());
        self.0.push(ScalarVariable {
            name: name.to_owned(),
            value_reference: self.0.len() as u32,
            description: None,
            causality,
            variability,
            initial: None,
            declared_type: None,
            kind: VariableType::Real(RealAttributes { unit, start, ..RealAttributes::default() }),
            dimensions: Vec::new(),
            clocks: Vec::new(),
            intermediate_update: false,
            aliases: Vec::new(),
        });
    }
}

impl ComponentSource {
    /// A mechanism with values of some parameters, which its start depends on.
    ///
    /// # Errors
    /// As [`Mechanism::parse`]; [`Error::Run`] if it cannot be assembled.
    pub fn mechanism(path: PathBuf, text: String, set: impl Fn(&str) -> Option<f64>) -> Result<Self> {
        let mechanism = Mechanism::parse(&text, &path)?;
        let parameters = mechanism.parameters().iter();
        let values: Vec<f64> = parameters.map(|(name, parameter)| set(name).unwrap_or(parameter.default)).collect();
        let start = mechanism.state_at_start(&values, 0.0).map_err(|error| Error::Run {
            system: path.display().to_string(),
            values: "the values that the system sets".into(),
            message: error.message,
        })?;
        let mut variables = ScalarVariables::default();
        for (name, input) in mechanism.inputs() {
            variables.add(name, Causality::Input, Variability::Continuous, Some(input.start), &input.unit);
        }
        for (name, parameter) in mechanism.parameters() {
            variables.add(name, Causality::Parameter, Variability::Fixed, Some(parameter.default), &parameter.unit);
        }
        for output in mechanism.outputs() {
            variables.add(&output.name, Causality::Output, Variability::Continuous, None, &output.unit);
        }
        for (name, value) in &start {
            variables.add(name, Causality::Local, Variability::Constant, Some(*value), "");
        }
        let description = Box::new(ModelDescription { variables: variables.0, ..ModelDescription::default() });
        Ok(Self::Mechanism { path, text, description })
    }

    /// Its file, for messages.
    pub fn path(&self) -> &Path {
        match self {
            Self::Fmu(fmu) => fmu.path(),
            Self::Mechanism { path, .. } => path,
        }
    }

    /// Its variables.
    pub fn description(&self) -> &ModelDescription {
        match self {
            Self::Fmu(fmu) => fmu.description(),
            Self::Mechanism { description, .. } => description,
        }
    }

    /// Model of the component in a run.
    pub fn model(&self) -> ComponentModel {
        match self {
            Self::Fmu(fmu) => ComponentModel::Fmu { folder: fmu.folder().to_owned(), interface: fmu.interface() },
            Self::Mechanism { text, .. } => ComponentModel::Mechanism { text: text.clone() },
        }
    }
}
