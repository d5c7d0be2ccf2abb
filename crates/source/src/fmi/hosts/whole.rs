//! Properties of whole FMUs that hosts stumble over: functions that return a text name what has the property.

use super::{conditions::listing, facts::HostedFmu};
use crate::fmi::{
    FmiVersion, InterfaceKind, ModelDescription, Platform,
    host::required_functions,
    model_description::{Causality, ModelStructure, ScalarVariable, Unknown, Variability},
};
use std::collections::HashSet;

// ---- the description ------------------------------------------------------------------------------------------------

pub(super) fn breaks_schema(fmu: HostedFmu) -> Option<String> {
    let problem = fmu.facts.document.problems.first()?;
    Some(format!("modelDescription.xml, line {}: {}", problem.line, problem.message))
}

pub(super) fn repeats_names(fmu: HostedFmu) -> Option<String> {
    let mut known = HashSet::new();
    listing(names(fmu).filter(|name| !known.insert(*name)))
}

/// Names that are equal if all but letters and digits are `_`.
pub(super) fn has_names_that_become_one(fmu: HostedFmu) -> Option<String> {
    let mut known = HashSet::new();
    listing(names(fmu).filter(|name| !known.insert(plain(name))))
}

fn names(fmu: HostedFmu<'_>) -> impl Iterator<Item = &str> {
    fmu.description().variables.iter().map(|variable| variable.name.as_str())
}

/// A name with `_` in place of all but letters and digits.
fn plain(name: &str) -> String {
    name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect()
}

pub(super) fn repeats_references(fmu: HostedFmu) -> Option<String> {
    if fmu.facts.version() != FmiVersion::V3 {
        return None;
    }
    let mut known = HashSet::new();
    let repeated = fmu.description().variables.iter().filter(|variable| !known.insert(variable.value_reference));
    listing(repeated.map(|variable| variable.name.as_str()))
}

pub(super) fn lacks_independent(fmu: HostedFmu) -> bool {
    fmu.facts.version() == FmiVersion::V3 && fmu.facts.of(Causality::Independent).count() != 1
}

pub(super) fn lacks_step_size(fmu: HostedFmu) -> bool {
    fmu.description().default_experiment.is_none_or(|experiment| experiment.step_size.is_none())
}

pub(super) fn is_of_fmi_3(fmu: HostedFmu) -> bool {
    fmu.facts.version() == FmiVersion::V3
}

/// Dymola whose FMUs insist on the event iteration after their initialization: that of 2022x and later.
pub(super) fn is_of_late_dymola(fmu: HostedFmu) -> Option<String> {
    let tool = fmu.facts.generation_tool();
    let year: String = tool.strip_prefix("Dymola Version ")?.chars().take_while(char::is_ascii_digit).collect();
    let is_late = year.parse::<u32>().is_ok_and(|year| year >= 2022);
    if fmu.facts.version() == FmiVersion::V2 && is_late { Some(tool.into()) } else { None }
}

// ---- the archive ----------------------------------------------------------------------------------------------------

pub(super) fn has_backslashes(fmu: HostedFmu) -> Option<String> {
    listing(entries(fmu).filter(|name| name.contains('\\')))
}

pub(super) fn has_colons(fmu: HostedFmu) -> Option<String> {
    listing(entries(fmu).filter(|name| name.contains(':') || name.starts_with('/')))
}

fn entries(fmu: HostedFmu<'_>) -> impl Iterator<Item = &str> {
    fmu.facts.entries.iter().map(|entry| entry.name.as_str())
}

pub(super) fn is_packed_in_a_rare_way(fmu: HostedFmu) -> Option<String> {
    let rare = fmu.facts.entries.iter().filter(|entry| !entry.is_deflated);
    listing(rare.map(|entry| entry.name.as_str()))
}

pub(super) fn lacks_library(fmu: HostedFmu) -> Option<String> {
    let library = fmu.library()?;
    let is_missing = entries(fmu).all(|name| name.replace('\\', "/") != library);
    is_missing.then(|| format!("no `{library}` for this platform, {}", Platform::CURRENT.tuple))
}

/// The library for Windows, if it is missing.
pub(super) fn lacks_windows(fmu: HostedFmu) -> Option<String> {
    let identifier = &fmu.capabilities()?.model_identifier;
    let windows = Platform::from_tuple("x86_64-windows")?.binary(fmu.facts.version(), identifier);
    entries(fmu).all(|name| name != windows).then(|| format!("no `{windows}`"))
}

pub(super) fn lacks_functions(fmu: HostedFmu) -> Option<String> {
    // a library without any names has been stripped of them in a way that is not understood here
    if fmu.facts.functions.is_empty() {
        return None;
    }
    let required = required_functions(fmu.facts.version(), fmu.interface).into_iter().flatten().copied();
    listing(required.filter(|function| !fmu.facts.functions.contains(*function)))
}

pub(super) fn is_broken(fmu: HostedFmu) -> Option<String> {
    let failed = fmu.facts.broken.iter().find(|failed| failed.interface == fmu.interface)?;
    if lacks_library(fmu).is_none() { Some(failed.message.clone()) } else { None }
}

// ---- the interfaces -------------------------------------------------------------------------------------------------

pub(super) fn has_dots_in_its_identifier(fmu: HostedFmu) -> Option<String> {
    let identifiers = fmu.capabilities().map(|capabilities| capabilities.model_identifier.as_str());
    listing(identifiers.into_iter().filter(|identifier| identifier.contains('.')))
}

pub(super) fn offers_both_interfaces(fmu: HostedFmu) -> bool {
    fmu.description().co_simulation.is_some() && fmu.description().model_exchange.is_some()
}

pub(super) fn offers_co_simulation(fmu: HostedFmu) -> bool {
    fmu.description().interface(InterfaceKind::CoSimulation).is_some()
}

pub(super) fn needs_another_program(fmu: HostedFmu) -> bool {
    fmu.capabilities().is_some_and(|capabilities| capabilities.needs_execution_tool)
}

pub(super) fn cannot_put_its_state_back(fmu: HostedFmu) -> bool {
    fmu.capabilities().is_some_and(|capabilities| !capabilities.get_and_set_state)
}

// ---- states and structure -------------------------------------------------------------------------------------------

pub(super) fn has_no_states(fmu: HostedFmu) -> bool {
    fmu.description().state_count() == 0
}

pub(super) fn has_events(fmu: HostedFmu) -> bool {
    fmu.description().indicator_count() > 0
}

/// States whose start the FMU computes.
pub(super) fn has_states_without_start(fmu: HostedFmu) -> Option<String> {
    let states = fmu.description().states()?;
    listing(states.into_iter().filter(|state| !state.kind.has_start()).map(|state| state.name.as_str()))
}

pub(super) fn lacks_dependencies(fmu: HostedFmu) -> Option<String> {
    let unknowns = unknowns(fmu).filter(|unknown| unknown.dependencies.is_none());
    listing(unknowns.filter_map(|unknown| name_of(fmu.description(), unknown)))
}

pub(super) fn lacks_dependencies_in_fmi_3(fmu: HostedFmu) -> Option<String> {
    if fmu.facts.version() == FmiVersion::V3 { lacks_dependencies(fmu) } else { None }
}

/// Tunable parameters of FMI 3.0 on which no output and no derivative is said to depend.
pub(super) fn has_unlisted_parameters(fmu: HostedFmu) -> Option<String> {
    if fmu.facts.version() != FmiVersion::V3 {
        return None;
    }
    let description = fmu.description();
    let ModelStructure { outputs, derivatives, .. } = &description.structure;
    let mut listed: HashSet<usize> = HashSet::new();
    for unknown in outputs.iter().chain(derivatives) {
        // it depends on everything
        let dependencies = unknown.dependencies.as_ref()?;
        listed.extend(dependencies);
    }
    let variables = description.variables.iter().enumerate();
    let unlisted = variables.filter(|(position, variable)| is_tunable_real(variable) && !listed.contains(position));
    listing(unlisted.map(|(_, variable)| variable.name.as_str()))
}

fn is_tunable_real(variable: &ScalarVariable) -> bool {
    let is_tunable = variable.causality == Causality::Parameter && variable.variability == Variability::Tunable;
    is_tunable && variable.kind.as_real().is_some()
}

pub(super) fn counts_kinds_of_dependencies_wrongly(fmu: HostedFmu) -> Option<String> {
    let unknowns = unknowns(fmu).filter(|unknown| has_kinds_without_dependencies(unknown));
    listing(unknowns.filter_map(|unknown| name_of(fmu.description(), unknown)))
}

/// Returns true if an unknown has another number of kinds than of dependencies.
fn has_kinds_without_dependencies(unknown: &Unknown) -> bool {
    let Some(kinds) = &unknown.kinds else { return false };
    unknown.dependencies.as_ref().is_none_or(|dependencies| dependencies.len() != kinds.len())
}

/// Outputs that depend on the variable with the value reference 0.
pub(super) fn depends_on_reference_zero(fmu: HostedFmu) -> Option<String> {
    let description = fmu.description();
    if description.fmi_version != FmiVersion::V3 {
        return None;
    }
    let outputs = description.structure.outputs.iter().filter(|unknown| depends_on_zero(description, unknown));
    listing(outputs.filter_map(|unknown| name_of(description, unknown)))
}

fn depends_on_zero(description: &ModelDescription, unknown: &Unknown) -> bool {
    let dependencies = unknown.dependencies.iter().flatten();
    let mut variables = dependencies.filter_map(|position| description.variables.get(*position));
    variables.any(|variable| variable.value_reference == 0)
}

/// The unknowns for which hosts need dependencies.
fn unknowns(fmu: HostedFmu<'_>) -> impl Iterator<Item = &Unknown> {
    let ModelStructure { outputs, derivatives, initial_unknowns, .. } = &fmu.description().structure;
    [outputs, derivatives, initial_unknowns].into_iter().flatten()
}

fn name_of<'a>(description: &'a ModelDescription, unknown: &Unknown) -> Option<&'a str> {
    Some(description.variables.get(unknown.variable)?.name.as_str())
}
