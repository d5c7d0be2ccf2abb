//! Kinds of surrogate: sections of the study file that only one of them has, and the runs that each is learned from.

mod compliant;
mod discrete;
mod dynamics;
mod kind;
mod response;
pub(super) mod states;
pub(super) mod static_map;

use super::{RunForm, Study};
use crate::diagnostics::Problems;
pub use compliant::{CompliantOptions, MAX_DEGREE};
pub use discrete::{DiscreteModel, DiscreteOptions};
pub use dynamics::{DynamicsModel, DynamicsOptions};
pub(super) use kind::{GivenKeys, StudyKind};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
pub use states::{StateOptions, is_angle, velocity_name};
pub use static_map::{ModelKind, NETWORK, SmallNetworks, StaticOptions};

/// Structure of a surrogate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum StudyStructure {
    /// Response surrogate: outputs are functions of parameters and time.
    #[default]
    Response,
    /// Equations of motion: derivatives are functions of states, inputs and parameters, learned by their structure from a mechanism.
    Dynamics,
    /// Discrete-time model: outputs are functions of past outputs, past inputs and parameters, learned from recorded runs of a component with
    /// inputs, or from runs of a program or an FMU.
    Discrete,
    /// Static map: outputs are functions of inputs, learned from the rows of a table without a time.
    Static,
    /// Compliant element: forces are functions of relative positions, velocities and parameters, and create no energy; learned from runs in
    /// which a flexible part is deformed.
    Compliant,
}

impl StudyStructure {
    const ALL: [Self; 5] = [Self::Response, Self::Dynamics, Self::Discrete, Self::Static, Self::Compliant];

    /// The structure of this name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|structure| structure.name() == name)
    }

    /// Its name in a study file.
    pub fn name(self) -> &'static str {
        match self {
            Self::Response => "response",
            Self::Dynamics => "dynamics",
            Self::Discrete => "discrete",
            Self::Static => "static",
            Self::Compliant => "compliant",
        }
    }

    /// The kind of surrogate.
    pub(super) fn kind(self) -> &'static dyn StudyKind {
        match self {
            Self::Response => &response::ResponseStudy,
            Self::Dynamics => &dynamics::DynamicsStudy,
            Self::Discrete => &discrete::DiscreteStudy,
            Self::Static => &static_map::StaticStudy,
            Self::Compliant => &compliant::CompliantStudy,
        }
    }

    /// Form of the runs that the surrogate is learned from.
    pub fn runs(self) -> RunForm {
        self.kind().runs()
    }
}

/// Options of other kinds in a study.
pub(super) fn options_of_others(study: &Study) -> Problems {
    let mut problems = Problems::default();
    for other in StudyStructure::ALL.into_iter().filter(|other| *other != study.structure) {
        if let Some(section) = other.kind().section() {
            let message = format!("belongs to the structure \"{}\"", other.name());
            problems.expect_absent(other.kind().is_given(study), section, &message);
        }
    }
    problems
}
