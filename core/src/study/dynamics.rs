//! `[dynamics]`: which of the ways to learn equations is exported, and how they are integrated.

use crate::diagnostics::Problems;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `[dynamics]`: of the structure "dynamics", which of the ways to learn the equations is exported, and how they are integrated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct DynamicsOptions {
    /// Form of the functions in the equations.
    pub model: DynamicsModel,
    /// `true` if all forms are compared although the dictionary is exact, which no network can improve.
    pub compare: bool,
    /// Fixed step of the solver inside the FMU, for real time: every communication step then takes the same time. It is refused where it is
    /// unstable or wrong at a corner of the domain. Unless given the solver controls its error.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("x-unit" = "s", "exclusiveMinimum" = 0))]
    pub solver_step: Option<f64>,
}

/// Form of the functions in the equations.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum DynamicsModel {
    /// The one of the others that is best at states that were held out.
    #[default]
    #[serde(rename = "best")]
    Best,
    /// Sums of sines, cosines and powers.
    #[serde(rename = "dictionary")]
    Dictionary,
    /// A network.
    #[serde(rename = "network")]
    Network,
    /// Sums of the lowest order, and a network for the residual.
    #[serde(rename = "dictionary and network")]
    Both,
    /// The accelerations as a network of coordinates, parameters, velocities and inputs, without the structure of the equations: of a
    /// mechanism, to be compared with the others. The best is never it.
    #[serde(rename = "accelerations")]
    Accelerations,
}

impl DynamicsModel {
    /// As in the study and in the record of the training; none of the best.
    pub fn name(self) -> Option<&'static str> {
        match self {
            Self::Best => None,
            Self::Dictionary => Some("dictionary"),
            Self::Network => Some("network"),
            Self::Both => Some("dictionary and network"),
            Self::Accelerations => Some("accelerations"),
        }
    }
}

impl DynamicsOptions {
    /// Every mistake, by key within the section.
    pub(super) fn problems(&self) -> Problems {
        let mut problems = Problems::default();
        if let Some(step) = self.solver_step {
            problems.expect_positive("solver_step", step);
        }
        problems
    }

    /// Returns true if the form of this name is tried; the dictionary always is. `exact` is true if the dictionary
    /// needs no network.
    pub fn tries(&self, name: &str, exact: bool) -> bool {
        match self.model.name() {
            _ if self.compare => true,
            None => !exact && Some(name) != DynamicsModel::Accelerations.name(),
            Some(wanted) => wanted == name,
        }
    }
}
