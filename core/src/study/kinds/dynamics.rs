//! `[dynamics]`: which of the ways to learn equations is exported, and how they are integrated.

use super::{
    kind::{GivenKeys, StudyKind, digested},
    states::{self, velocity_name},
};
use crate::{
    diagnostics::{Problems, names::expected_one_of},
    study::{Baselines, NetworkOptions, RunForm, Study, TimeStructure, TrainingOptions, outputs::check_variable_name},
};
use metafmu_runtime::Precision;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

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
    pub(in crate::study) fn problems(&self) -> Problems {
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

/// Runs of a mechanism from which the ranges of outputs and the steps of the solver are known, unless given.
const RUNS: usize = 8;

/// Derivatives as functions of states, inputs and parameters.
pub(super) struct DynamicsStudy;

impl StudyKind for DynamicsStudy {
    fn runs(&self) -> RunForm {
        RunForm { start_from_states: true, have_memory: true, usual_number: RUNS, ..RunForm::default() }
    }

    fn section(&self) -> Option<&'static str> {
        Some("dynamics")
    }

    fn is_given(&self, study: &Study) -> bool {
        study.dynamics != DynamicsOptions::default()
    }

    fn problems_beside(&self, study: &Study) -> Problems {
        let mut problems = of_source(study);
        problems.extend(of_states(study));
        problems
    }

    fn set_defaults(&self, study: &mut Study, given: GivenKeys) {
        if study.source.is_of_equations() && !given.network {
            study.network = NetworkOptions::of_equations();
        }
        if study.source.is_of_equations() && !given.training {
            study.training = TrainingOptions::of_equations();
        }
        study.starts = states::starts(study);
    }

    fn digested(&self, study: &Study) -> Option<Value> {
        if self.is_given(study) { digested(&study.dynamics) } else { None }
    }
}

/// Problems of a source that has no equations.
fn of_source(study: &Study) -> Problems {
    let mut problems = Problems::default();
    if study.source.count() != 1 {
        return problems;
    }
    if study.source.index.is_some() {
        let message = "the structure \"dynamics\" is learned from a system, a mechanism, an FMU, a program or one table of all runs, \
                       expected `system`, `mechanism`, `fmu`, `command` or `table`";
        problems.add("source", message);
    }
    if study.source.runs_once() {
        let message =
            "`{result}`: a program that is started for each run has no equations, expected one that answers requests";
        problems.add("source.command", message);
    }
    problems
}

/// Problems of states that depend on the other sections, and of sections that equations of motion do not have.
fn of_states(study: &Study) -> Problems {
    let mut problems = Problems::default();
    let states = &study.states;
    if study.coordinates().next().is_none() {
        let expected = match (&study.source.fmu, &study.source.command) {
            (Some(_), _) => "every continuous state of the FMU",
            (_, Some(_)) => "every state of the program",
            _ => "a coordinate for each degree of freedom",
        };
        let found = if states.is_empty() { "no state" } else { "no coordinate" };
        problems.add("states", format!("{found}, expected {expected}"));
    }
    let (is_run_apart, of_table) = (study.source.is_run_apart(), study.source.is_recorded());
    for (name, state) in states {
        let key = format!("states.{name}");
        let message = "belongs to tables: the source knows the derivatives of its states";
        problems.expect_absent(state.rate.is_some() && !of_table, format!("{key}.rate"), message);
        let message = "belongs to `source.command`: the source knows the units of its states";
        problems.expect_absent(state.unit.is_some() && study.source.command.is_none(), format!("{key}.unit"), message);
        if of_table {
            let message = "belongs to sources that are simulated: recorded runs start where they start";
            problems.expect_absent(state.velocity.is_some(), format!("{key}.velocity"), message);
            problems.expect_absent(state.velocity_range.is_some(), format!("{key}.velocity_range"), message);
            problems.expect_absent(state.start.is_some(), format!("{key}.start"), message);
            check_variable_name(&mut problems, &key, name);
            check_variable_name(&mut problems, &format!("{key}.rate"), &state.rate_name(name));
        } else if is_run_apart {
            let message = "belongs to mechanisms: every state of an FMU or a program has its own range";
            problems.expect_absent(state.velocity.is_some(), format!("{key}.velocity"), message);
            problems.expect_absent(state.velocity_range.is_some(), format!("{key}.velocity_range"), message);
        } else if study.mechanism().is_some_and(|mechanism| mechanism.actuator_states().contains_key(name)) {
            let message = "belongs to coordinates";
            problems.expect_absent(state.velocity.is_some(), format!("{key}.velocity"), message);
            problems.expect_absent(state.velocity_range.is_some(), format!("{key}.velocity_range"), message);
            problems.expect_absent(state.periodic.is_some(), format!("{key}.periodic"), message);
        } else if velocity_name(name).is_none() {
            let expected = "expected `JOINT.angle`, `JOINT.position`, `BODY.angle`, `POINT.x` or `POINT.y`";
            let known: Vec<&str> =
                study.mechanism().into_iter().flat_map(|of| of.actuator_states().keys()).map(String::as_str).collect();
            let known = if known.is_empty() {
                String::new()
            } else {
                format!("; of its states, {}", expected_one_of(name, &known))
            };
            problems.add(&key, format!("`{name}` is not a coordinate, {expected}{known}"));
        } else {
            let message = "belongs to FMUs and programs: an angle of a mechanism is periodic";
            problems.expect_absent(state.is_periodic(), format!("{key}.periodic"), message);
        }
    }
    problems.extend(of_rates(study));
    for name in study.starts.keys().filter(|name| study.parameters.contains_key(*name)) {
        problems.add(format!("parameters.{name}"), format!("`{name}` is the name of a state's value at the start"));
    }
    let has_no_structure = study.source.is_run_apart() && study.dynamics.model == DynamicsModel::Accelerations;
    let message = "\"accelerations\" belongs to mechanisms: of an FMU or a program nothing else is learned";
    problems.expect_absent(has_no_structure, "dynamics.model", message);
    let of_network = "belongs to the structure \"response\"";
    if of_table {
        let message = "equations of a table's motions are learned by least squares";
        problems.expect_absent(study.network != NetworkOptions::default(), "network", message);
        problems.expect_absent(study.training != TrainingOptions::default(), "training", message);
        let DynamicsOptions { model, compare, solver_step: _ } = study.dynamics;
        problems.expect_absent(model != DynamicsModel::default(), "dynamics.model", message);
        problems.expect_absent(compare, "dynamics.compare", message);
        problems.extend(duplicates(study));
    }
    problems.expect_absent(
        study.network.structure == TimeStructure::Fixed,
        "network.structure",
        "\"fixed\" belongs to the structure \"response\"",
    );
    problems.expect_absent(study.target.is_some(), "target", of_network);
    problems.expect_absent(study.search.is_some(), "search", of_network);
    problems.expect_absent(study.baselines != Baselines::default(), "baselines", of_network);
    problems.expect_absent(study.time.margin > 0.0, "time.margin", of_network);
    let is_single = study.export.precision == Precision::Single;
    problems.expect_absent(is_single, "export.precision", "\"single\" belongs to networks");
    problems
}

/// Every mistake in `rate_of`: coordinates come first, then the rate of each in the same order.
fn of_rates(study: &Study) -> Problems {
    let mut problems = Problems::default();
    if !study.has_mass_matrix() {
        return problems;
    }
    let coordinates: Vec<&str> = study.states.keys().take(study.states.len().div_ceil(2)).map(String::as_str).collect();
    for (position, (name, state)) in study.states.iter().enumerate() {
        let key = format!("states.{name}.rate_of");
        let message = "belongs to `source.command`: other sources have no mass matrix";
        problems.expect_absent(state.rate_of.is_some() && study.source.command.is_none(), &key, message);
        let expected = position.checked_sub(coordinates.len()).and_then(|position| coordinates.get(position));
        let order = "coordinates come first, then the rate of each in the same order";
        match (state.rate_of.as_deref(), expected) {
            (found, expected) if found == expected.copied() => {}
            (Some(found), Some(expected)) => problems.add(key, format!("`{found}`, expected `{expected}`: {order}")),
            (None, Some(expected)) => problems.add(key, format!("missing, expected `{expected}`: {order}")),
            (_, None) => problems.add(key, format!("`{name}` is among the coordinates: {order}")),
        }
    }
    if !study.states.len().is_multiple_of(2) {
        problems.add("states", format!("{} states, expected a rate of each coordinate", study.states.len()));
    }
    let (found, expected) =
        (study.dynamics.model, "expected \"best\", \"dictionary\" or \"dictionary and network\" with `rate_of`");
    if matches!(found, DynamicsModel::Network | DynamicsModel::Accelerations) {
        problems.add("dynamics.model", format!("\"{}\", {expected}", found.name().unwrap_or_default()));
    }
    problems
}

/// Columns of a table that are given two meanings. Outputs are states.
fn duplicates(study: &Study) -> Problems {
    let mut problems = Problems::default();
    let mut before: Vec<String> = study.parameters.keys().chain(study.inputs.keys()).cloned().collect();
    for (name, state) in &study.states {
        for (key, name) in
            [(format!("states.{name}"), name.clone()), (format!("states.{name}.rate"), state.rate_name(name))]
        {
            if before.contains(&name) {
                problems.add(
                    key,
                    format!(
                        "`{name}` is another state, a parameter or an input already: names of variables must be unique"
                    ),
                );
            }
            before.push(name);
        }
    }
    problems
}
