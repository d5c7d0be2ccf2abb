//! `[export]`: what kind of FMU is made.

use super::Study;
use crate::diagnostics::{Problems, names::listed};
use indexmap::IndexMap;
use metafmu_runtime::Precision;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};

/// `[export]`: what kind of FMU is made, and what it says about itself.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ExportOptions {
    /// Version of the standard.
    pub fmi: FmiChoice,
    /// Floating-point precision of the FMU's computations.
    #[schemars(schema_with = "precisions")]
    pub precision: Precision,
    /// Variables of the FMU.
    pub interface: FmuInterface,
    /// Additions of metafmu that hosts can wire: inputs and outputs of the FMU instead of local variables.
    pub ports: Vec<FmuPort>,
    /// Names of the variables.
    pub names: NameStyle,
    /// Author of the model.
    pub author: Option<String>,
    /// Copyright of the model.
    pub copyright: Option<String>,
    /// License of the model.
    pub license: Option<String>,
}

/// Version of the standard that FMUs are made for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum FmiChoice {
    /// FMI 2.0, which more hosts know.
    #[default]
    #[serde(rename = "2")]
    V2,
    /// FMI 3.0.
    #[serde(rename = "3")]
    V3,
    /// An FMU of each.
    #[serde(rename = "both")]
    Both,
}

/// Which variables an FMU has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum FmuInterface {
    /// The study's, the parameter `domain_policy`, and as local variables `in_domain`, `domain_distance` and error bounds.
    #[default]
    Study,
    /// The study's alone.
    Plain,
}

/// Additional inputs or outputs of an FMU.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum FmuPort {
    /// Outputs `in_domain` and `domain_distance`.
    Domain,
    /// Outputs `NAME_bound`, the error bounds of a study with `[bounds]`.
    Bounds,
    /// Inputs `use_measured` and `NAME_measured` of a discrete-time FMU, which replace the past outputs in its equations.
    Measured,
}

/// How variables of an FMU are named.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum NameStyle {
    /// As in the study.
    #[default]
    Study,
    /// Letters, digits and `_` only, for hosts that refuse dots and brackets: `rail.position` is `rail_position`.
    Flat,
}

impl ExportOptions {
    /// Every mistake in ports and names of a study's FMU, by key within the section.
    pub fn problems_beside(&self, study: &Study) -> Problems {
        let mut problems = Problems::default();
        for problem in self.port_problems(study.bounds.is_some(), study.runs().are_samples) {
            problems.add("ports", problem);
        }
        for problem in self.names.problems(names(study)) {
            problems.add("names", problem);
        }
        problems
    }

    /// Ports that an FMU cannot have: `has_bounds`: whether there are error bounds; `is_discrete`: whether it is discrete-time.
    pub fn port_problems(&self, has_bounds: bool, is_discrete: bool) -> Vec<String> {
        let problems = self.ports.iter().filter_map(|port| self.port_problem(*port, has_bounds, is_discrete));
        let mut problems: Vec<String> = problems.map(str::to_owned).collect();
        problems.dedup();
        problems
    }

    /// Why an FMU cannot have a port.
    fn port_problem(&self, port: FmuPort, has_bounds: bool, is_discrete: bool) -> Option<&'static str> {
        match port {
            _ if self.interface == FmuInterface::Plain => Some("a plain interface has variables of the study only"),
            FmuPort::Bounds if !has_bounds => {
                Some("`bounds`: there are no error bounds, expected a section `[bounds]`")
            }
            FmuPort::Measured if !is_discrete => Some("`measured`: only discrete-time FMUs take measured outputs"),
            FmuPort::Domain | FmuPort::Bounds | FmuPort::Measured => None,
        }
    }
}

/// Names of the study's variables.
fn names(study: &Study) -> impl Iterator<Item = &String> {
    let columns = study.parameters.keys().chain(study.inputs.keys()).chain(study.outputs.keys());
    columns.chain(study.states.keys()).chain(study.arrays.keys())
}

impl NameStyle {
    /// The name in this style of a variable that the study has under `name`.
    pub fn of(self, name: &str) -> String {
        if self == Self::Study {
            return name.into();
        }
        let parts = name.split(|c: char| !c.is_ascii_alphanumeric() && c != '_').filter(|part| !part.is_empty());
        let flat = parts.collect::<Vec<_>>().join("_");
        if flat.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_') { flat } else { format!("_{flat}") }
    }

    /// Names that this style does not distinguish.
    pub fn problems<'a>(self, names: impl Iterator<Item = &'a String>) -> Vec<String> {
        let mut of_style: IndexMap<String, Vec<&str>> = IndexMap::new();
        for name in names {
            let same = of_style.entry(self.of(name)).or_default();
            if !same.contains(&name.as_str()) {
                same.push(name);
            }
        }
        let alike = of_style.into_iter().filter(|(_, names)| names.len() > 1);
        alike.map(|(style, names)| format!("{} would all be `{style}`", listed(&names))).collect()
    }
}

/// The runtime has no schemas: what is in every FMU stays small.
fn precisions(_: &mut SchemaGenerator) -> Schema {
    json_schema!({ "oneOf": [
        { "type": "string", "const": Precision::Double, "description": "Outputs smooth enough for solvers with tight tolerances." },
        { "type": "string", "const": Precision::Single,
          "description": "Twice as fast, errors around 1e-6 of the outputs' scale: for real-time co-simulation." },
    ]})
}
