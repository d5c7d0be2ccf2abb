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

/// Problems of the inputs and parameters of a surrogate that its source lacks: all of them need a default value. The start of
/// a state needs one only if a name of the source that the surrogate does not know is close. `unused`: values that a system
/// sets and the surrogate does not have.
pub(super) fn problems(
    [source, surrogate]: [&ModelDescription; 2],
    unused: &[&str],
    defaults: &[DefaultValue],
) -> Vec<String> {
    let own: Vec<&ScalarVariable> = surrogate.variables.iter().filter(|variable| is_own(surrogate, variable)).collect();
    let state = |variable: &ScalarVariable| {
        let name = variable.name.strip_suffix(AT_START)?;
        surrogate.variable(name).map(|_| name.to_owned())
    };
    let has_counterpart = |variable: &ScalarVariable| {
        source.variable(&variable.name).is_some_and(is_counterpart)
            || state(variable).is_some_and(|name| source.variable(&name).is_some())
    };
    let sets = |variable: &&ScalarVariable| matches!(variable.causality, Causality::Input | Causality::Parameter);
    let known: Vec<&str> = source.variables.iter().filter(sets).map(|variable| variable.name.as_str()).collect();
    let is_unknown = |name: &&str| surrogate.variable(name).is_none() && surrogate.variable(&at_start(name)).is_none();
    let free: Vec<&str> = known.iter().copied().filter(is_unknown).chain(unused.iter().copied()).collect();
    let has_default = |name: &str| defaults.iter().any(|default| default.name == name);
    let is_lacking = |variable: &&&ScalarVariable| {
        let name = variable.name.as_str();
        let is_needed = state(variable).is_none() || closest(name, free.iter().copied()).is_some();
        is_needed && !has_counterpart(variable) && !has_default(name)
    };
    let lacking: Vec<&&ScalarVariable> = own.iter().filter(is_lacking).collect();
    let names: Vec<&str> = lacking.iter().map(|variable| variable.name.as_str()).collect();
    let options = lacking.iter().map(|variable| option_for(&variable.name, variable.start_value()));
    let options = options.collect::<Vec<_>>().join(" ");
    let kind = if names.len() == 1 { "input or parameter" } else { "inputs or parameter" };
    let lacking = missing(kind, &names, &known, &free)
        .map(|message| format!("the source has {message}; for constants: {options}"));
    let own: Vec<&str> = own.iter().map(|variable| variable.name.as_str()).collect();
    let unknown = defaults.iter().filter(|default| !own.contains(&default.name.as_str()));
    lacking.into_iter().chain(unknown.map(|default| default.unknown(&own))).collect()
}

/// Returns true for a variable of a source that an input or parameter of the same name replaces.
pub(super) fn is_counterpart(variable: &ScalarVariable) -> bool {
    match variable.causality {
        Causality::Input | Causality::Parameter | Causality::CalculatedParameter => true,
        Causality::Local => is_settable(variable),
        _ => false,
    }
}

fn at_start(name: &str) -> String {
    format!("{name}{AT_START}")
}

/// Returns true for inputs and parameters of the model, and not of every surrogate.
pub(super) fn is_own(surrogate: &ModelDescription, variable: &ScalarVariable) -> bool {
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
pub(super) mod tests {
    use super::*;
    use crate::fmi::model_description::{RealAttributes, Variability, VariableType};

    pub fn parsed(defaults: &[&str]) -> Vec<DefaultValue> {
        defaults.iter().map(|text| DefaultValue::parse(text).unwrap()).collect()
    }

    pub fn described(variables: &[(&str, Causality)]) -> ModelDescription {
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
    fn inputs_and_parameters_that_the_source_lacks_need_a_default() {
        use Causality::{Input, Local, Parameter};
        let source = described(&[("force", Input), ("L", Parameter), ("mass", Parameter), ("angle", Local)]);
        let surrogate = described(&[
            ("force", Input),
            ("torque", Input),
            ("l", Parameter),
            ("solver_setting", Parameter),
            ("angle", Local),
            ("angle_start", Parameter),
            ("hidden", Local),
            ("hidden_start", Parameter),
            ("domain_policy", Parameter),
        ]);
        let found = |defaults: &[&str]| problems([&source, &surrogate], &[], &parsed(defaults));
        assert_eq!(
            found(&[]),
            [
                "the source has no inputs or parameters `torque`, `l`, `solver_setting`, expected them among force, L, mass; did you \
                 mean `L` for `l`?; for constants: --default torque=1.5 --default l=1.5 --default solver_setting=1.5"
            ]
        );
        assert_eq!(found(&["torque", "l=2", "solver_setting"]), Vec::<String>::new());
        let unknown = &found(&["torque", "l", "solver_setting", "L"])[0];
        assert!(unknown.starts_with("--default L: no such variable, expected one of force, torque"), "{unknown}");
    }

    #[test]
    fn an_output_of_the_source_is_no_counterpart_of_an_input() {
        use Causality::{Input, Output};
        let (source, surrogate) = (described(&[("angle", Output)]), described(&[("angle", Input)]));
        let found = problems([&source, &surrogate], &[], &[]);
        assert!(
            found[0].starts_with("the source has no input or parameter `angle`, expected it among none"),
            "{found:?}"
        );
    }
}
