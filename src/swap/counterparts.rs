//! Inputs and parameters of a surrogate that its source has no variable for.

use super::AT_START;
use crate::{
    diagnostics::names::{closest, missing},
    fmi::{
        ModelDescription,
        host::is_settable,
        model_description::{Causality, ScalarVariable},
        system::is_number,
    },
    variable::{DefaultValue, option_for},
};
use metafmu_runtime::{BuiltIn, Output};

/// Problems of the inputs and parameters of a surrogate that its source lacks. Inputs need a default value. Parameters
/// need one if a name of the source that the surrogate does not know is close. `unused`: values that a system sets and
/// the surrogate does not have.
pub(super) fn problems(
    [source, surrogate]: [&ModelDescription; 2],
    unused: &[&str],
    defaults: &[DefaultValue],
) -> Vec<String> {
    let own: Vec<&ScalarVariable> = surrogate.variables.iter().filter(|variable| is_own(surrogate, variable)).collect();
    let counterpart = |variable: &&ScalarVariable| {
        let state = variable.name.strip_suffix(AT_START);
        [Some(variable.name.as_str()), state].into_iter().flatten().any(|name| source.variable(name).is_some())
    };
    let sets = |variable: &&ScalarVariable| matches!(variable.causality, Causality::Input | Causality::Parameter);
    let known: Vec<&str> = source.variables.iter().filter(sets).map(|variable| variable.name.as_str()).collect();
    let is_unknown = |name: &&str| surrogate.variable(name).is_none() && surrogate.variable(&at_start(name)).is_none();
    let free: Vec<&str> = known.iter().copied().filter(is_unknown).chain(unused.iter().copied()).collect();
    let default = |name: &str| defaults.iter().any(|default| default.name == name);
    let is_lacking = |variable: &&&ScalarVariable| {
        let name = variable.name.as_str();
        let is_needed = variable.causality == Causality::Input || closest(name, free.iter().copied()).is_some();
        is_needed && !counterpart(variable) && !default(name)
    };
    let lacking: Vec<&&ScalarVariable> = own.iter().filter(is_lacking).collect();
    let names: Vec<&str> = lacking.iter().map(|variable| variable.name.as_str()).collect();
    let options = lacking.iter().map(|variable| option_for(&variable.name, variable.start_value()));
    let options = options.collect::<Vec<_>>().join(" ");
    let lacking = missing("variable", &names, &known, &free)
        .map(|message| format!("the source has {message}; constants: {options}"));
    let own: Vec<&str> = own.iter().map(|variable| variable.name.as_str()).collect();
    let unknown = defaults.iter().filter(|default| !own.contains(&default.name.as_str()));
    lacking.into_iter().chain(unknown.map(|default| default.unknown(&own))).collect()
}

/// Start values that the user requests.
pub(super) fn values(surrogate: &ModelDescription, defaults: &[DefaultValue]) -> Vec<(String, f64)> {
    let value = |default: &DefaultValue| {
        let start = || surrogate.variable(&default.name).and_then(ScalarVariable::start_value);
        Some((default.name.clone(), default.value.or_else(start)?))
    };
    defaults.iter().filter_map(value).collect()
}

fn at_start(name: &str) -> String {
    format!("{name}{AT_START}")
}

/// Returns true for inputs and parameters of the model, and not of every surrogate.
fn is_own(surrogate: &ModelDescription, variable: &ScalarVariable) -> bool {
    let name = variable.name.as_str();
    let is_built_in = BuiltIn::ALWAYS.into_iter().chain([BuiltIn::UseMeasured]).any(|of| of.name() == name);
    let is_measured = surrogate.variable(BuiltIn::UseMeasured.name()).is_some()
        && surrogate
            .variables
            .iter()
            .any(|output| output.causality == Causality::Output && Output::measured_name(&output.name) == name);
    matches!(variable.causality, Causality::Parameter | Causality::Input)
        && is_settable(variable)
        && is_number(variable)
        && !is_built_in
        && !is_measured
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fmi::model_description::{RealAttributes, Variability, VariableType};

    fn described(variables: &[(&str, Causality)]) -> ModelDescription {
        let variable = |(place, (name, causality)): (usize, &(&str, Causality))| ScalarVariable {
            name: (*name).into(),
            value_reference: place as u32,
            description: None,
            causality: *causality,
            variability: Variability::Continuous,
            initial: None,
            declared_type: None,
            kind: VariableType::Real(RealAttributes { start: Some(1.5), ..RealAttributes::default() }),
            dimensions: Vec::new(),
            clocks: Vec::new(),
            intermediate_update: false,
            aliases: Vec::new(),
        };
        let variables = variables.iter().enumerate().map(variable).collect();
        ModelDescription { variables, ..ModelDescription::default() }
    }

    #[test]
    fn inputs_without_a_source_and_misspelled_parameters_need_a_default() {
        use Causality::{Input, Local, Parameter};
        let source = described(&[("force", Input), ("L", Parameter), ("mass", Parameter), ("angle", Local)]);
        let surrogate = described(&[
            ("force", Input),
            ("torque", Input),
            ("l", Parameter),
            ("solver_setting", Parameter),
            ("angle_start", Parameter),
            ("domain_policy", Parameter),
        ]);
        let found = |defaults: &[&str]| {
            let defaults: Vec<DefaultValue> = defaults.iter().map(|text| DefaultValue::parse(text).unwrap()).collect();
            problems([&source, &surrogate], &[], &defaults)
        };
        assert_eq!(
            found(&[]),
            [
                "the source has no variables `torque`, `l`, expected them among force, L, mass; did you mean `L` for `l`?; constants: \
                 --default torque=1.5 --default l=1.5"
            ]
        );
        assert_eq!(found(&["torque", "l=2"]), Vec::<String>::new());
        let defaults = ["torque", "l=2"].map(|text| DefaultValue::parse(text).unwrap());
        assert_eq!(values(&surrogate, &defaults), [("torque".to_owned(), 1.5), ("l".to_owned(), 2.0)]);
        assert!(
            found(&["torque", "l", "L"])[0].starts_with("--default L: no such variable, expected one of force, torque")
        );
    }
}
