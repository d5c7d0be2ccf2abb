//! `[compliant]`: a flexible part as a force that creates no energy.

use super::kind::{StudyKind, digested, without_states};
use crate::{
    diagnostics::Problems,
    study::{Baselines, NetworkOptions, ParameterVariability, RunForm, Study, TrainingOptions},
};
use metafmu_runtime::Precision;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::HashSet;

/// `[compliant]`: a compliant element, of the structure "compliant". Positions, velocities and forces are outputs of the source, parameters
/// are parameters of the study. The forces become functions of the others.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct CompliantOptions {
    /// Relative positions of the two interfaces, 1 to 6: inputs of the FMU.
    #[schemars(length(min = 1, max = MAX_COORDINATES), extend("examples" = [["y", "angle"]]))]
    pub positions: Vec<String>,
    /// Their rates, one for each position, in the same order: inputs of the FMU. Without them the element has no dissipation.
    #[schemars(extend("examples" = [["vy", "rate"]]))]
    pub velocities: Vec<String>,
    /// Forces or moments conjugate to the positions, one for each, in the same order: outputs of the FMU. A force times the rate of its position is
    /// the power that the element takes.
    #[schemars(extend("examples" = [["fy", "moment"]]))]
    pub forces: Vec<String>,
    /// Parameters of the element. The other parameters of the study only determine the motions of its runs.
    pub parameters: Vec<String>,
    /// Total degree of the potential as a polynomial of positions and parameters; chosen by held-out runs unless given.
    #[schemars(range(min = 1, max = MAX_DEGREE))]
    pub potential: Option<u8>,
    /// Total degree of the entries of `L`, of which the damping matrix is `L Lᵀ`; chosen by held-out runs unless given.
    #[schemars(range(max = MAX_DEGREE))]
    pub dissipation: Option<u8>,
}

/// Highest degree of a polynomial.
pub const MAX_DEGREE: u8 = 20;

/// Relative positions of two rigid interfaces.
const MAX_COORDINATES: usize = 6;

impl CompliantOptions {
    /// Every mistake, by key within the section.
    pub(in crate::study) fn problems(&self) -> Problems {
        let Self { positions, velocities, forces, parameters, potential, dissipation } = self;
        let mut problems = Problems::default();
        let count = positions.len();
        if count > MAX_COORDINATES {
            problems.add("positions", format!("{count} positions, expected 1 to {MAX_COORDINATES}"));
        }
        if forces.len() != count {
            problems.add("forces", format!("{} forces, expected one for each of {count} positions", forces.len()));
        }
        if !(velocities.is_empty() || velocities.len() == count) {
            let found = velocities.len();
            problems
                .add("velocities", format!("{found} velocities, expected none or one for each of {count} positions"));
        }
        let mut seen = HashSet::new();
        let lists =
            [("positions", positions), ("velocities", velocities), ("forces", forces), ("parameters", parameters)];
        for (key, name) in lists.iter().flat_map(|(key, names)| names.iter().map(move |name| (*key, name))) {
            if !seen.insert(name) {
                problems.add(key, format!("`{name}` is named twice"));
            }
        }
        if let Some(degree) = potential {
            problems.expect(
                (1..=MAX_DEGREE).contains(degree),
                "potential",
                degree,
                &format!("a degree from 1 to {MAX_DEGREE}"),
            );
        }
        if let Some(degree) = dissipation {
            problems.expect(*degree <= MAX_DEGREE, "dissipation", degree, &format!("a degree from 0 to {MAX_DEGREE}"));
            let message = "belongs to elements with `velocities`";
            problems.expect_absent(velocities.is_empty(), "dissipation", message);
        }
        problems
    }
}

/// Forces of a flexible part as functions of relative positions and velocities.
pub(super) struct CompliantStudy;

impl StudyKind for CompliantStudy {
    fn runs(&self) -> RunForm {
        RunForm { are_planned: true, ..RunForm::default() }
    }

    fn section(&self) -> Option<&'static str> {
        Some("compliant")
    }

    fn is_given(&self, study: &Study) -> bool {
        study.compliant != CompliantOptions::default()
    }

    fn problems_beside(&self, study: &Study) -> Problems {
        let mut problems = of_names(study);
        problems.extend(without_states(study));
        problems.extend(refused(study));
        problems
    }

    fn digested(&self, study: &Study) -> Option<Value> {
        digested(&study.compliant)
    }
}

/// Problems of the names in the section, and of the parameters that it names.
fn of_names(study: &Study) -> Problems {
    let mut problems = Problems::default();
    let options = &study.compliant;
    if options.positions.is_empty() {
        problems.add("compliant", "no position, expected `positions` and `forces` among the outputs");
    }
    let lists = [("positions", &options.positions), ("velocities", &options.velocities), ("forces", &options.forces)];
    for (key, name) in lists.iter().flat_map(|(key, names)| names.iter().map(move |name| (*key, name))) {
        if !study.outputs.contains_key(name) {
            problems.add(format!("compliant.{key}"), format!("`{name}`, expected one of the outputs"));
        }
    }
    for name in options.parameters.iter().filter(|name| !study.parameters.contains_key(*name)) {
        problems.add("compliant.parameters", format!("`{name}`, expected one of the parameters"));
    }
    let is_used = |name: &String| lists.iter().any(|(_, names)| names.contains(name));
    for name in study.outputs.keys().filter(|name| !is_used(name)) {
        problems
            .add(format!("outputs.{name}"), "expected one of the positions, velocities and forces of `[compliant]`");
    }
    for (name, parameter) in &study.parameters {
        if !options.parameters.contains(name) {
            continue;
        }
        let message = "belongs to the structure \"response\": expected `min` and `max`";
        problems.expect_absent(parameter.is_nominal(), format!("parameters.{name}.values"), message);
        problems.expect_absent(parameter.periodic, format!("parameters.{name}.periodic"), message);
        let is_driven = parameter.variability == Some(ParameterVariability::Continuous);
        let message = "\"continuous\", expected \"fixed\" or \"tunable\": an element whose parameters move takes energy from what moves them";
        problems.expect_absent(is_driven, format!("parameters.{name}.variability"), message);
    }
    problems
}

/// Sections and keys that are of other structures.
fn refused(study: &Study) -> Problems {
    let mut problems = Problems::default();
    let arrays = "belongs to other structures: positions, velocities and forces are the outputs of the runs";
    problems.expect_absent(!study.arrays.is_empty(), "arrays", arrays);
    let of_networks = "belongs to networks: a compliant element is a sum of polynomials";
    problems.expect_absent(study.network != NetworkOptions::default(), "network", of_networks);
    let usual = TrainingOptions { validation: study.training.validation, ..TrainingOptions::default() };
    let message = "belongs to networks, but `validation`: a compliant element is a sum of polynomials";
    problems.expect_absent(study.training != usual, "training", message);
    let of_response = "belongs to the structure \"response\"";
    problems.expect_absent(study.target.is_some(), "target", of_response);
    let message = "belongs to other structures: a compliant element has no error bounds";
    problems.expect_absent(study.bounds.is_some(), "bounds", message);
    problems.expect_absent(study.search.is_some(), "search", of_response);
    problems.expect_absent(study.baselines != Baselines::default(), "baselines", of_response);
    let is_single = study.export.precision == Precision::Single;
    let message = "\"single\" belongs to networks: a compliant element is computed in double precision";
    problems.expect_absent(is_single, "export.precision", message);
    problems
}
