//! Properties of FMUs that hosts stumble over: each function returns what of the FMU has the property.

use super::facts::{FmuFacts, WrittenVariable};
use crate::{
    diagnostics::names::listed,
    fmi::{
        FmiVersion, ModelDescription, Platform,
        host::required_functions,
        model_description::{Causality, Initial, ModelStructure, ScalarVariable, Unknown, Variability, VariableType},
    },
};
use std::collections::HashSet;

/// Names that a message lists.
const SHOWN: usize = 3;

/// The first names, none if there are none.
fn some<'a>(names: impl Iterator<Item = &'a str>) -> Option<String> {
    let names: Vec<String> = names.map(|name| format!("`{name}`")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    match names.len() {
        0 => None,
        count if count > SHOWN => Some(format!("{} and {} more", listed(&names[..SHOWN]), count - SHOWN)),
        _ => Some(listed(&names)),
    }
}

fn named<'a>(variables: impl Iterator<Item = WrittenVariable<'a>>) -> Option<String> {
    some(variables.map(|written| written.variable.name.as_str()))
}

/// A property of the whole FMU, which needs no names.
fn whole(has: bool) -> Option<String> {
    has.then(String::new)
}

fn is_real(variable: &ScalarVariable) -> bool {
    matches!(&variable.kind, VariableType::Real(real) if !real.single) && variable.dimensions.is_empty()
}

fn is_boolean(variable: &ScalarVariable) -> bool {
    matches!(variable.kind, VariableType::Boolean { .. })
}

// ---- the description ------------------------------------------------------------------------------------------------

pub(super) fn breaks_schema(facts: &FmuFacts) -> Option<String> {
    let problem = facts.document.problems.first()?;
    Some(format!("modelDescription.xml, line {}: {}", problem.line, problem.message))
}

/// Returns true if a start value belongs to this variable.
fn needs_start(variable: &ScalarVariable) -> bool {
    let is_exact = matches!(variable.initial, Some(Initial::Exact | Initial::Approx));
    let is_clock = matches!(variable.kind, VariableType::Clock { .. });
    !is_clock && (variable.causality == Causality::Input || is_exact)
}

/// Returns true if a start value is written, as an attribute or, for texts and bytes of FMI 3.0, as elements.
fn has_start(written: &WrittenVariable) -> bool {
    written.kind.attribute("start").is_some() || written.kind.child("Start").is_some()
}

pub(super) fn lacks_starts(facts: &FmuFacts) -> Option<String> {
    named(facts.variables().filter(|written| needs_start(written.variable) && !has_start(written)))
}

pub(super) fn has_starts_of_calculated(facts: &FmuFacts) -> Option<String> {
    let is_wrong = |written: &WrittenVariable| {
        written.variable.initial == Some(Initial::Calculated)
            && written.kind.attribute("start").is_some_and(|start| !start.is_empty())
    };
    named(facts.variables().filter(is_wrong))
}

pub(super) fn repeats_names(facts: &FmuFacts) -> Option<String> {
    let mut known = HashSet::new();
    some(
        facts.description().variables.iter().map(|variable| variable.name.as_str()).filter(|name| !known.insert(*name)),
    )
}

/// The default variability of FMI 2.0 is continuous, whatever the type is.
pub(super) fn has_continuous_others(facts: &FmuFacts) -> Option<String> {
    let is_wrong = |written: &WrittenVariable| {
        let is_number = matches!(written.variable.kind, VariableType::Real(_));
        let is_continuous = match facts.version() {
            FmiVersion::V2 => written.variable.variability == Variability::Continuous,
            FmiVersion::V3 => written.element.attribute("variability") == Some("continuous"),
        };
        !is_number && is_continuous
    };
    named(facts.variables().filter(is_wrong))
}

pub(super) fn combines_what_is_not_allowed(facts: &FmuFacts) -> Option<String> {
    let is_wrong = |written: &WrittenVariable| {
        let ScalarVariable { causality, variability, initial, kind, .. } = written.variable;
        if matches!(kind, VariableType::Clock { .. }) {
            return false;
        }
        match Initial::allowed(facts.version(), *causality, *variability) {
            None => true,
            Some(allowed) => initial.is_some_and(|initial| !allowed.is_empty() && !allowed.contains(&initial)),
        }
    };
    named(facts.variables().filter(is_wrong))
}

pub(super) fn uses_unknown_units(facts: &FmuFacts) -> Option<String> {
    let description = facts.description();
    let is_unknown = |unit: &str| description.units.iter().all(|known| known.name != unit);
    let is_wrong = |written: &WrittenVariable| description.unit_of(written.variable).is_some_and(is_unknown);
    named(facts.variables().filter(is_wrong))
}

pub(super) fn uses_unknown_display_units(facts: &FmuFacts) -> Option<String> {
    let description = facts.description();
    let is_wrong = |written: &WrittenVariable| {
        let Some(display) = written.variable.kind.as_real().and_then(|real| real.display_unit.as_deref()) else {
            return false;
        };
        let unit = description.unit_of(written.variable);
        let known = description.units.iter().find(|known| Some(known.name.as_str()) == unit);
        known.is_none_or(|known| known.display.iter().all(|known| known.name != display))
    };
    named(facts.variables().filter(is_wrong))
}

pub(super) fn uses_unknown_types(facts: &FmuFacts) -> Option<String> {
    let description = facts.description();
    let is_wrong = |written: &WrittenVariable| {
        written.variable.declared_type.is_some() && description.type_of(written.variable).is_none()
    };
    named(facts.variables().filter(is_wrong))
}

pub(super) fn lacks_independent(facts: &FmuFacts) -> Option<String> {
    whole(facts.version() == FmiVersion::V3 && facts.of(Causality::Independent).count() != 1)
}

pub(super) fn repeats_references(facts: &FmuFacts) -> Option<String> {
    let mut known = HashSet::new();
    let is_repeated = |written: &WrittenVariable| !known.insert(written.variable.value_reference);
    if facts.version() == FmiVersion::V3 { named(facts.variables().filter(is_repeated)) } else { None }
}

// ---- the archive ----------------------------------------------------------------------------------------------------

pub(super) fn has_backslashes(facts: &FmuFacts) -> Option<String> {
    some(facts.entries.iter().map(|entry| entry.name.as_str()).filter(|name| name.contains('\\')))
}

pub(super) fn has_colons(facts: &FmuFacts) -> Option<String> {
    some(
        facts
            .entries
            .iter()
            .map(|entry| entry.name.as_str())
            .filter(|name| name.contains(':') || name.starts_with('/')),
    )
}

pub(super) fn is_packed_in_a_rare_way(facts: &FmuFacts) -> Option<String> {
    some(facts.entries.iter().filter(|entry| !entry.is_deflated).map(|entry| entry.name.as_str()))
}

pub(super) fn lacks_library(facts: &FmuFacts) -> Option<String> {
    let library = facts.library()?;
    let is_missing = facts.entries.iter().all(|entry| entry.name.replace('\\', "/") != library);
    is_missing.then(|| format!("no `{library}` for this platform, {}", Platform::CURRENT.tuple))
}

pub(super) fn lacks_functions(facts: &FmuFacts) -> Option<String> {
    // a library without any names has been stripped of them in a way that is not understood here
    if facts.functions.is_empty() {
        return None;
    }
    let required = required_functions(facts.version(), facts.interface).into_iter().flatten().copied();
    some(required.filter(|function| !facts.functions.contains(*function)))
}

pub(super) fn is_broken(facts: &FmuFacts) -> Option<String> {
    let failed = facts.broken.iter().find(|failed| failed.interface == facts.interface);
    failed.map(|failed| failed.message.clone()).filter(|_| lacks_library(facts).is_none())
}

pub(super) fn has_dots_in_its_identifier(facts: &FmuFacts) -> Option<String> {
    some(
        facts
            .capabilities()
            .map(|capabilities| capabilities.model_identifier.as_str())
            .into_iter()
            .filter(|name| name.contains('.')),
    )
}

// ---- types of variables ---------------------------------------------------------------------------------------------

/// Value references of real variables: hosts that read others as reals meet those.
fn references_of_reals(facts: &FmuFacts) -> HashSet<u32> {
    facts
        .description()
        .variables
        .iter()
        .filter(|variable| is_real(variable))
        .map(|variable| variable.value_reference)
        .collect()
}

/// Variables of a causality that are not real: in FMI 2.0, whose types have separate value references, those that hit no real one, or those that
/// hit one.
fn others(facts: &FmuFacts, causality: Causality, hits: bool) -> Option<String> {
    let (reals, converts) = (references_of_reals(facts), converts_types(facts));
    let is_wrong = |written: &WrittenVariable| {
        let ScalarVariable { value_reference, dimensions, .. } = written.variable;
        !is_real(written.variable) && reals.contains(value_reference) == hits && !(converts && dimensions.is_empty())
    };
    named(facts.of(causality).filter(is_wrong))
}

pub(super) fn has_other_outputs(facts: &FmuFacts) -> Option<String> {
    others(facts, Causality::Output, false)
}

pub(super) fn has_other_outputs_that_hit_reals(facts: &FmuFacts) -> Option<String> {
    others(facts, Causality::Output, true)
}

pub(super) fn has_other_inputs(facts: &FmuFacts) -> Option<String> {
    others(facts, Causality::Input, false)
}

pub(super) fn has_other_inputs_that_hit_reals(facts: &FmuFacts) -> Option<String> {
    others(facts, Causality::Input, true)
}

/// Outputs that are no scalar real numbers, arrays aside, which users of some hosts need not name.
pub(super) fn has_other_scalar_outputs(facts: &FmuFacts) -> Option<String> {
    let converts = converts_types(facts);
    let is_wrong = |written: &WrittenVariable| !is_real(written.variable) && written.variable.dimensions.is_empty();
    named(facts.of(Causality::Output).filter(|written| is_wrong(written) && !converts))
}

/// Tunable parameters of FMI 3.0, which the structure of an FMU does not list among dependencies.
pub(super) fn has_tunable_parameters_in_fmi_3(facts: &FmuFacts) -> Option<String> {
    let is_tunable =
        |written: &WrittenVariable| written.variable.variability == Variability::Tunable && is_real(written.variable);
    if facts.version() == FmiVersion::V3 { named(facts.of(Causality::Parameter).filter(is_tunable)) } else { None }
}

/// Inputs of FMI 3.0 that are neither real numbers nor Booleans.
pub(super) fn has_inputs_beyond_booleans(facts: &FmuFacts) -> Option<String> {
    let is_wrong = |written: &WrittenVariable| {
        let is_boolean = is_boolean(written.variable) && written.variable.dimensions.is_empty();
        !is_real(written.variable) && !is_boolean
    };
    if converts_types(facts) { None } else { named(facts.of(Causality::Input).filter(is_wrong)) }
}

fn is_set(written: &WrittenVariable) -> bool {
    matches!(written.variable.causality, Causality::Input | Causality::Parameter)
}

/// Parameters and inputs of FMI 2.0 that are numbers but not real ones.
pub(super) fn has_whole_numbers_to_set(facts: &FmuFacts) -> Option<String> {
    let reals = references_of_reals(facts);
    let is_wrong = |written: &WrittenVariable| {
        let is_text = matches!(written.variable.kind, VariableType::String { .. });
        is_set(written) && !is_real(written.variable) && !is_text && !reals.contains(&written.variable.value_reference)
    };
    let is_strict = facts.version() == FmiVersion::V2 && !converts_types(facts);
    if is_strict { named(facts.variables().filter(is_wrong)) } else { None }
}

/// Returns true if a written start value cannot be read as one number: `true` of a Boolean, a text, several numbers of an array.
fn has_text_start(written: &WrittenVariable) -> bool {
    let text = written.kind.attribute("start").is_some_and(|start| start.trim().parse::<f64>().is_err());
    text || written.kind.child("Start").is_some()
}

/// Inputs, parameters and outputs of FMI 2.0 with such starts.
pub(super) fn has_text_starts(facts: &FmuFacts) -> Option<String> {
    let is_wrong = |written: &WrittenVariable| {
        let is_port = is_set(written) || written.variable.causality == Causality::Output;
        is_port && has_text_start(written)
    };
    if facts.version() == FmiVersion::V2 { named(facts.variables().filter(is_wrong)) } else { None }
}

/// Variables of any causality that begin with such a start.
pub(super) fn has_exact_text_starts(facts: &FmuFacts) -> Option<String> {
    let is_wrong = |written: &WrittenVariable| {
        let is_exact =
            written.variable.initial == Some(Initial::Exact) || written.variable.causality == Causality::Input;
        is_exact && has_text_start(written)
    };
    named(facts.variables().filter(is_wrong))
}

pub(super) fn has_constants(facts: &FmuFacts) -> Option<String> {
    named(
        facts.variables().filter(|written| written.variable.variability == Variability::Constant && has_start(written)),
    )
}

/// Texts, bytes and clocks that the FMU computes.
pub(super) fn has_computed_texts(facts: &FmuFacts) -> Option<String> {
    let is_wrong = |written: &WrittenVariable| {
        !written.variable.kind.is_number()
            && written.variable.initial != Some(Initial::Exact)
            && written.variable.causality != Causality::Input
    };
    named(facts.variables().filter(is_wrong))
}

pub(super) fn has_text_outputs(facts: &FmuFacts) -> Option<String> {
    named(facts.of(Causality::Output).filter(|written| !written.variable.kind.is_number()))
}

pub(super) fn has_enumerated_outputs(facts: &FmuFacts) -> Option<String> {
    named(facts.of(Causality::Output).filter(|written| matches!(written.variable.kind, VariableType::Enumeration(_))))
}

pub(super) fn has_arrays(facts: &FmuFacts) -> Option<String> {
    named(facts.variables().filter(|written| !written.variable.dimensions.is_empty()))
}

pub(super) fn has_arrays_to_set(facts: &FmuFacts) -> Option<String> {
    named(facts.variables().filter(|written| is_set(written) && !written.variable.dimensions.is_empty()))
}

pub(super) fn has_bytes_to_set(facts: &FmuFacts) -> Option<String> {
    named(
        facts
            .variables()
            .filter(|written| is_set(written) && matches!(written.variable.kind, VariableType::Binary { .. })),
    )
}

pub(super) fn has_single_precision_to_set(facts: &FmuFacts) -> Option<String> {
    let is_single =
        |written: &WrittenVariable| matches!(&written.variable.kind, VariableType::Real(real) if real.single);
    named(facts.variables().filter(|written| is_set(written) && is_single(written)))
}

pub(super) fn has_texts_in_elements(facts: &FmuFacts) -> Option<String> {
    named(facts.variables().filter(|written| written.kind.child("Start").is_some()))
}

pub(super) fn has_structural_parameters(facts: &FmuFacts) -> Option<String> {
    named(facts.of(Causality::StructuralParameter))
}

// ---- starts and initialization --------------------------------------------------------------------------------------

pub(super) fn has_inputs_that_start_elsewhere(facts: &FmuFacts) -> Option<String> {
    let is_wrong = |written: &WrittenVariable| written.variable.start_value().is_some_and(|start| start != 0.0);
    named(facts.of(Causality::Input).filter(is_wrong))
}

pub(super) fn writes_initial_of_inputs(facts: &FmuFacts) -> Option<String> {
    named(facts.of(Causality::Input).filter(|written| written.element.attribute("initial").is_some()))
}

/// States whose start the FMU computes.
pub(super) fn has_states_without_start(facts: &FmuFacts) -> Option<String> {
    let states = facts.description().states()?;
    some(states.into_iter().filter(|state| !state.kind.has_start()).map(|state| state.name.as_str()))
}

pub(super) fn has_events(facts: &FmuFacts) -> Option<String> {
    whole(facts.description().indicator_count() > 0)
}

/// Parameters that neither are fixed nor change.
pub(super) fn has_odd_parameters(facts: &FmuFacts) -> Option<String> {
    let is_wrong =
        |written: &WrittenVariable| !matches!(written.variable.variability, Variability::Fixed | Variability::Tunable);
    named(facts.of(Causality::Parameter).filter(is_wrong))
}

/// Returns true if the FMU reads and sets integers and Booleans as reals as well: value references of such tools tell the type.
fn converts_types(facts: &FmuFacts) -> bool {
    let tool = facts.description().generation_tool.as_deref().unwrap_or_default();
    tool.starts_with("metafmu ") || (facts.version() == FmiVersion::V2 && tool.starts_with("Dymola"))
}

/// Dymola whose FMUs insist on the event iteration after their initialization: that of 2022x and later.
pub(super) fn is_of_late_dymola(facts: &FmuFacts) -> Option<String> {
    let tool = facts.description().generation_tool.as_deref().unwrap_or_default();
    let year: String = tool.strip_prefix("Dymola Version ")?.chars().take_while(char::is_ascii_digit).collect();
    let is_late = year.parse::<u32>().is_ok_and(|year| year >= 2022);
    if facts.version() == FmiVersion::V2 && is_late { Some(tool.into()) } else { None }
}

pub(super) fn has_no_states(facts: &FmuFacts) -> Option<String> {
    whole(facts.description().state_count() == 0)
}

// ---- structure ------------------------------------------------------------------------------------------------------

/// Names of the unknowns of `lists` without the attribute `dependencies`.
fn without_dependencies(facts: &FmuFacts, lists: &[&Vec<Unknown>]) -> Option<String> {
    let unknowns = lists.iter().flat_map(|list| list.iter()).filter(|unknown| unknown.dependencies.is_none());
    some(unknowns.filter_map(|unknown| Some(facts.description().variables.get(unknown.variable)?.name.as_str())))
}

pub(super) fn lacks_dependencies(facts: &FmuFacts) -> Option<String> {
    let ModelStructure { outputs, derivatives, initial_unknowns, .. } = &facts.description().structure;
    without_dependencies(facts, &[outputs, derivatives, initial_unknowns])
}

pub(super) fn lacks_dependencies_in_fmi_3(facts: &FmuFacts) -> Option<String> {
    if facts.version() == FmiVersion::V3 { lacks_dependencies(facts) } else { None }
}

pub(super) fn counts_kinds_of_dependencies_wrongly(facts: &FmuFacts) -> Option<String> {
    let ModelStructure { outputs, derivatives, initial_unknowns, .. } = &facts.description().structure;
    let is_wrong = |unknown: &&Unknown| {
        unknown
            .kinds
            .as_ref()
            .is_some_and(|kinds| unknown.dependencies.as_ref().is_none_or(|found| found.len() != kinds.len()))
    };
    let unknowns = [outputs, derivatives, initial_unknowns].into_iter().flatten().filter(is_wrong);
    some(unknowns.filter_map(|unknown| Some(facts.description().variables.get(unknown.variable)?.name.as_str())))
}

/// Outputs that depend on the variable with the value reference 0.
pub(super) fn depends_on_reference_zero(facts: &FmuFacts) -> Option<String> {
    let ModelDescription { variables, structure, .. } = facts.description();
    let is_zero = |position: &usize| variables.get(*position).is_some_and(|variable| variable.value_reference == 0);
    let depends = |unknown: &&Unknown| unknown.dependencies.iter().flatten().any(is_zero);
    let outputs = structure.outputs.iter().filter(depends);
    let found = some(outputs.filter_map(|unknown| Some(variables.get(unknown.variable)?.name.as_str())));
    found.filter(|_| facts.version() == FmiVersion::V3)
}

pub(super) fn has_dots_or_brackets(facts: &FmuFacts) -> Option<String> {
    let names = facts.description().variables.iter().map(|variable| variable.name.as_str());
    some(names.filter(|name| name.contains(['.', '[', ']', '(', ')'])))
}

pub(super) fn has_both_interfaces(facts: &FmuFacts) -> Option<String> {
    whole(facts.description().co_simulation.is_some() && facts.description().model_exchange.is_some())
}

pub(super) fn calls_a_variable_time(facts: &FmuFacts) -> Option<String> {
    let is_wrong = |written: &WrittenVariable| {
        written.variable.name == "time" && written.variable.causality != Causality::Independent
    };
    named(facts.variables().filter(is_wrong))
}

pub(super) fn lacks_step_size(facts: &FmuFacts) -> Option<String> {
    whole(facts.description().default_experiment.is_none_or(|experiment| experiment.step_size.is_none()))
}

pub(super) fn needs_another_program(facts: &FmuFacts) -> Option<String> {
    whole(facts.capabilities().is_some_and(|capabilities| capabilities.needs_execution_tool))
}

pub(super) fn has_enumerations(facts: &FmuFacts) -> Option<String> {
    named(facts.variables().filter(|written| matches!(written.variable.kind, VariableType::Enumeration(_))))
}

pub(super) fn has_clocks(facts: &FmuFacts) -> Option<String> {
    named(facts.variables().filter(|written| matches!(written.variable.kind, VariableType::Clock { .. })))
}

/// Inputs and outputs that are texts, bytes or clocks.
pub(super) fn has_text_ports(facts: &FmuFacts) -> Option<String> {
    let is_port =
        |written: &WrittenVariable| matches!(written.variable.causality, Causality::Input | Causality::Output);
    named(facts.variables().filter(|written| is_port(written) && !written.variable.kind.is_number()))
}

pub(super) fn cannot_put_its_state_back(facts: &FmuFacts) -> Option<String> {
    whole(facts.capabilities().is_some_and(|capabilities| !capabilities.get_and_set_state))
}

pub(super) fn is_of_fmi_3(facts: &FmuFacts) -> Option<String> {
    whole(facts.version() == FmiVersion::V3)
}

/// Names that are the same if all but letters and digits are `_`.
pub(super) fn has_names_that_become_one(facts: &FmuFacts) -> Option<String> {
    let mut known = HashSet::new();
    let plain =
        |name: &str| -> String { name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect() };
    let names = facts.description().variables.iter().map(|variable| variable.name.as_str());
    some(names.filter(|name| !known.insert(plain(name))))
}

/// Returns something if the library for Windows is missing.
pub(super) fn lacks_windows(facts: &FmuFacts) -> Option<String> {
    let identifier = &facts.capabilities()?.model_identifier;
    let windows = Platform::from_tuple("x86_64-windows")?.binary(facts.version(), identifier);
    facts.entries.iter().all(|entry| entry.name != windows).then(|| format!("no `{windows}`"))
}
