//! Properties of variables that hosts stumble over.

use super::facts::{WrittenVariable, is_real};
use crate::fmi::{
    FmiVersion,
    model_description::{Causality, Initial, ScalarVariable, Variability, VariableType},
};

impl WrittenVariable<'_> {
    fn is_input(&self) -> bool {
        self.variable.causality == Causality::Input
    }

    fn is_output(&self) -> bool {
        self.variable.causality == Causality::Output
    }

    fn is_parameter(&self) -> bool {
        self.variable.causality == Causality::Parameter
    }

    /// Returns true if hosts set the variable.
    fn is_set(&self) -> bool {
        self.is_input() || self.is_parameter()
    }

    fn is_scalar(&self) -> bool {
        self.variable.dimensions.is_empty()
    }

    /// Returns true if the variable is no scalar real number, and the FMU does not convert it to one.
    fn is_never_real(&self) -> bool {
        let is_converted = self.facts.converts_types() && self.is_scalar();
        !is_real(self.variable) && !is_converted
    }

    /// Returns true if a real variable has the same value reference: types of FMI 2.0 have separate value references.
    fn hits_real(&self) -> bool {
        self.facts.real_references.contains(&self.variable.value_reference)
    }

    /// Returns true if a start value belongs to this variable.
    fn needs_start(&self) -> bool {
        let is_exact = matches!(self.variable.initial, Some(Initial::Exact | Initial::Approx));
        let is_clock = matches!(self.variable.kind, VariableType::Clock { .. });
        !is_clock && (self.is_input() || is_exact)
    }

    /// Returns true if a start value is written, as an attribute or, for texts and bytes of FMI 3.0, as elements.
    fn has_start(&self) -> bool {
        self.kind.attribute("start").is_some() || self.kind.child("Start").is_some()
    }

    /// Returns true if a written start value cannot be read as one number: `true` of a Boolean, a text, several numbers of an array.
    fn has_text_start(&self) -> bool {
        let text = self.kind.attribute("start").is_some_and(|start| start.trim().parse::<f64>().is_err());
        text || self.kind.child("Start").is_some()
    }
}

// ---- the description ------------------------------------------------------------------------------------------------

pub(super) fn lacks_start(written: &WrittenVariable) -> bool {
    written.needs_start() && !written.has_start()
}

pub(super) fn is_calculated_with_start(written: &WrittenVariable) -> bool {
    let has_start = written.kind.attribute("start").is_some_and(|start| !start.is_empty());
    written.variable.initial == Some(Initial::Calculated) && has_start
}

/// Returns true if a variable is continuous but not real. The default variability of FMI 2.0 is continuous, whatever the type is.
pub(super) fn is_continuous_but_not_real(written: &WrittenVariable) -> bool {
    let is_continuous = match written.facts.version() {
        FmiVersion::V2 => written.variable.variability == Variability::Continuous,
        FmiVersion::V3 => written.element.attribute("variability") == Some("continuous"),
    };
    is_continuous && !matches!(written.variable.kind, VariableType::Real(_))
}

/// Returns true if the standard does not allow the variable's causality, variability and initial together.
pub(super) fn combines_what_is_not_allowed(written: &WrittenVariable) -> bool {
    let ScalarVariable { causality, variability, initial, kind, .. } = written.variable;
    if matches!(kind, VariableType::Clock { .. }) {
        return false;
    }
    match Initial::allowed(written.facts.version(), *causality, *variability) {
        None => true,
        Some(allowed) => initial.is_some_and(|initial| !allowed.is_empty() && !allowed.contains(&initial)),
    }
}

pub(super) fn uses_unknown_unit(written: &WrittenVariable) -> bool {
    let description = written.facts.description();
    let unit = description.unit_of(written.variable);
    unit.is_some_and(|unit| description.units.iter().all(|known| known.name != unit))
}

pub(super) fn uses_unknown_display_unit(written: &WrittenVariable) -> bool {
    let description = written.facts.description();
    let Some(display) = written.variable.kind.as_real().and_then(|real| real.display_unit.as_deref()) else {
        return false;
    };
    let unit = description.unit_of(written.variable);
    let known = description.units.iter().find(|known| Some(known.name.as_str()) == unit);
    known.is_none_or(|known| known.display.iter().all(|known| known.name != display))
}

pub(super) fn uses_unknown_type(written: &WrittenVariable) -> bool {
    written.variable.declared_type.is_some() && written.facts.description().type_of(written.variable).is_none()
}

/// Returns true if a variable has the name of the independent variable and is another one.
pub(super) fn is_called_time(written: &WrittenVariable) -> bool {
    written.variable.name == "time" && written.variable.causality != Causality::Independent
}

pub(super) fn has_dots_or_brackets(written: &WrittenVariable) -> bool {
    written.variable.name.contains(['.', '[', ']', '(', ')'])
}

// ---- types ----------------------------------------------------------------------------------------------------------

/// Returns true if reading an output as a real number fails.
pub(super) fn is_output_but_not_real(written: &WrittenVariable) -> bool {
    written.is_output() && written.is_never_real() && !written.hits_real()
}

/// Returns true if reading an output as a real number gives the value of another variable.
pub(super) fn is_output_that_hits_a_real(written: &WrittenVariable) -> bool {
    written.is_output() && written.is_never_real() && written.hits_real()
}

/// Returns true if an output is a scalar but not real. Users of some hosts need not name arrays.
pub(super) fn is_scalar_output_but_not_real(written: &WrittenVariable) -> bool {
    written.is_output() && written.is_never_real() && written.is_scalar()
}

/// Returns true if setting an input as a real number fails.
pub(super) fn is_input_but_not_real(written: &WrittenVariable) -> bool {
    written.is_input() && written.is_never_real() && !written.hits_real()
}

/// Returns true if setting an input as a real number sets another variable.
pub(super) fn is_input_that_hits_a_real(written: &WrittenVariable) -> bool {
    written.is_input() && written.is_never_real() && written.hits_real()
}

/// Returns true if setting an input of FMI 2.0 as a real number fails.
pub(super) fn is_input_of_fmi_2_but_not_real(written: &WrittenVariable) -> bool {
    written.facts.version() == FmiVersion::V2 && is_input_but_not_real(written)
}

/// Returns true if an input is neither a real number nor a Boolean.
pub(super) fn is_input_beyond_booleans(written: &WrittenVariable) -> bool {
    let is_boolean = matches!(written.variable.kind, VariableType::Boolean { .. }) && written.is_scalar();
    written.is_input() && !written.facts.converts_types() && !is_real(written.variable) && !is_boolean
}

/// Returns true if it is a parameter or an input of FMI 2.0, and a number but not a real one.
pub(super) fn is_whole_number_to_set(written: &WrittenVariable) -> bool {
    let is_strict = written.facts.version() == FmiVersion::V2 && !written.facts.converts_types();
    let is_text = matches!(written.variable.kind, VariableType::String { .. });
    is_strict && written.is_set() && !is_real(written.variable) && !is_text && !written.hits_real()
}

/// Returns true if the start value of an input, a parameter or an output of FMI 2.0 is not one number.
pub(super) fn is_port_with_text_start(written: &WrittenVariable) -> bool {
    let is_port = written.is_set() || written.is_output();
    written.facts.version() == FmiVersion::V2 && is_port && written.has_text_start()
}

/// Returns true if a variable begins with a start value that is not one number.
pub(super) fn has_exact_text_start(written: &WrittenVariable) -> bool {
    let is_exact = written.variable.initial == Some(Initial::Exact) || written.is_input();
    is_exact && written.has_text_start()
}

pub(super) fn is_constant(written: &WrittenVariable) -> bool {
    written.variable.variability == Variability::Constant && written.has_start()
}

/// Returns true if the FMU computes it, and it is a text, bytes or a clock.
pub(super) fn is_computed_text(written: &WrittenVariable) -> bool {
    let is_computed = written.variable.initial != Some(Initial::Exact) && !written.is_input();
    is_computed && !written.variable.kind.is_number()
}

pub(super) fn is_text_output(written: &WrittenVariable) -> bool {
    written.is_output() && !written.variable.kind.is_number()
}

/// Returns true if an input or output is a text, bytes or a clock.
pub(super) fn is_text_port(written: &WrittenVariable) -> bool {
    (written.is_input() || written.is_output()) && !written.variable.kind.is_number()
}

pub(super) fn is_text_in_elements(written: &WrittenVariable) -> bool {
    written.kind.child("Start").is_some()
}

pub(super) fn is_enumeration(written: &WrittenVariable) -> bool {
    matches!(written.variable.kind, VariableType::Enumeration(_))
}

pub(super) fn is_enumerated_output(written: &WrittenVariable) -> bool {
    written.is_output() && is_enumeration(written)
}

pub(super) fn is_clock(written: &WrittenVariable) -> bool {
    matches!(written.variable.kind, VariableType::Clock { .. })
}

pub(super) fn is_array(written: &WrittenVariable) -> bool {
    !written.is_scalar()
}

pub(super) fn is_array_to_set(written: &WrittenVariable) -> bool {
    written.is_set() && !written.is_scalar()
}

pub(super) fn has_bytes_to_set(written: &WrittenVariable) -> bool {
    written.is_set() && matches!(written.variable.kind, VariableType::Binary { .. })
}

pub(super) fn is_single_precision_to_set(written: &WrittenVariable) -> bool {
    written.is_set() && matches!(&written.variable.kind, VariableType::Real(real) if real.single)
}

pub(super) fn is_structural_parameter(written: &WrittenVariable) -> bool {
    written.variable.causality == Causality::StructuralParameter
}

// ---- starts and initialization --------------------------------------------------------------------------------------

pub(super) fn is_input_that_starts_elsewhere(written: &WrittenVariable) -> bool {
    written.is_input() && written.variable.start_value().is_some_and(|start| start != 0.0)
}

pub(super) fn is_input_with_initial(written: &WrittenVariable) -> bool {
    written.is_input() && written.element.attribute("initial").is_some()
}

/// Returns true if a parameter is neither fixed nor tunable.
pub(super) fn is_odd_parameter(written: &WrittenVariable) -> bool {
    let is_usual = matches!(written.variable.variability, Variability::Fixed | Variability::Tunable);
    written.is_parameter() && !is_usual
}
