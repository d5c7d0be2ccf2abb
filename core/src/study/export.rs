//! `[export]`: what kind of FMU is made.

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

/// The runtime has no schemas: what is in every FMU stays small.
fn precisions(_: &mut SchemaGenerator) -> Schema {
    json_schema!({ "oneOf": [
        { "type": "string", "const": Precision::Double, "description": "Outputs smooth enough for solvers with tight tolerances." },
        { "type": "string", "const": Precision::Single,
          "description": "Twice as fast, errors around 1e-6 of the outputs' scale: for real-time co-simulation." },
    ]})
}
