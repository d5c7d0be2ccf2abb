//! Start values of a surrogate that replaces a source, and where they are from.

use super::{
    AT_START,
    counterparts::{is_counterpart, is_own},
    unit,
};
use crate::{
    diagnostics::{names::listed, numbers::exact},
    fmi::{
        ModelDescription,
        host::is_settable,
        model_description::{Causality, ScalarVariable},
        system::is_number,
    },
    variable::DefaultValue,
};
use serde::Serialize;
use std::fmt;

/// A start value of a surrogate.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SurrogateStart {
    /// The parameter or input.
    pub name: String,
    /// Its value.
    pub value: f64,
    /// Its unit; empty if it has none.
    pub unit: String,
    /// Where the value is from.
    pub origin: StartOrigin,
}

/// Origin of a start value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum StartOrigin {
    /// The system sets it for the source.
    System,
    /// It is the start value of the source.
    Source,
    /// The user requests it: `--default`.
    Default,
    /// It is the surrogate's own: the source has none.
    Surrogate,
}

impl StartOrigin {
    const ALL: [Self; 4] = [Self::System, Self::Source, Self::Default, Self::Surrogate];
}

impl fmt::Display for StartOrigin {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            Self::System => "set by the system",
            Self::Source => "of the source",
            Self::Default => "requested by --default",
            Self::Surrogate => "of the surrogate, as the source has none",
        })
    }
}

/// Start values and parameters that a surrogate takes over from a source.
pub(super) struct TakenOver {
    pub values: Vec<SurrogateStart>,
    /// Names and values that the system sets and the surrogate has no parameter for.
    pub unused: Vec<(String, f64)>,
}

/// Start values of a surrogate that replaces a source. `set`: names and values that the system sets. `is_connected`: true for
/// an input that the system connects.
pub(super) fn taken_over(
    [source, surrogate]: [&ModelDescription; 2],
    set: &[(&str, f64)],
    defaults: &[DefaultValue],
    is_connected: impl Fn(&str) -> bool,
) -> TakenOver {
    let takes =
        |name: &str| surrogate.variable(name).is_some_and(|variable| is_settable(variable) && is_number(variable));
    let target = |name: &str| [name.to_owned(), format!("{name}{AT_START}")].into_iter().find(|name| takes(name));
    let of = |name: &str, value: f64, origin: StartOrigin| SurrogateStart {
        name: name.into(),
        value,
        unit: unit(surrogate, name),
        origin,
    };
    let mut found = TakenOver { values: Vec::new(), unused: Vec::new() };
    for &(name, value) in set {
        match target(name) {
            Some(target) => found.values.push(of(&target, value, StartOrigin::System)),
            None => found.unused.push((name.to_owned(), value)),
        }
    }
    let parameters = surrogate.variables.iter().filter(|variable| {
        matches!(variable.causality, Causality::Parameter | Causality::Input) && takes(&variable.name)
    });
    for parameter in parameters {
        let name = parameter.name.as_str();
        if found.values.iter().any(|value| value.name == name) {
            continue;
        }
        let is_own = is_own(surrogate, parameter);
        let default = defaults.iter().rev().find(|default| default.name == name).filter(|_| is_own);
        let requested = default.and_then(|default| default.value.or(parameter.start_value()));
        if let Some(value) = start_of_source(source, parameter) {
            found.values.push(of(name, value, StartOrigin::Source));
        } else if let Some(value) = requested {
            found.values.push(of(name, value, StartOrigin::Default));
        } else if let Some(value) = parameter.start_value()
            && is_own
            && !is_connected(name)
        {
            found.values.push(of(name, value, StartOrigin::Surrogate));
        }
    }
    found
}

/// Start value of the source's counterpart of a parameter or input; for `NAME_start`, of the source's variable `NAME`.
fn start_of_source(source: &ModelDescription, parameter: &ScalarVariable) -> Option<f64> {
    let own = source.variable(&parameter.name).filter(|variable| is_counterpart(variable));
    let state = parameter.name.strip_suffix(AT_START).and_then(|name| source.variable(name));
    own.or(state).filter(|variable| is_number(variable)).and_then(ScalarVariable::start_value)
}

/// Names and values to be set: those that are not the surrogate's own anyway.
pub(super) fn to_set(surrogate: &ModelDescription, values: &[SurrogateStart]) -> Vec<(String, f64)> {
    let differs = |value: &&SurrogateStart| {
        let own = surrogate.variable(&value.name).and_then(ScalarVariable::start_value);
        match value.origin {
            StartOrigin::System | StartOrigin::Default => true,
            StartOrigin::Source => own != Some(value.value),
            StartOrigin::Surrogate => false,
        }
    };
    values.iter().filter(differs).map(|value| (value.name.clone(), value.value)).collect()
}

impl SurrogateStart {
    /// Lines with all start values, one for each origin.
    pub fn lines(values: &[Self]) -> Vec<String> {
        let line = |origin: &StartOrigin| {
            let texts: Vec<String> =
                values.iter().filter(|value| value.origin == *origin).map(ToString::to_string).collect();
            let texts: Vec<&str> = texts.iter().map(String::as_str).collect();
            (!texts.is_empty()).then(|| format!("start values {origin}: {}", listed(&texts)))
        };
        StartOrigin::ALL.iter().filter_map(line).collect()
    }
}

impl fmt::Display for SurrogateStart {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Self { name, value, unit, .. } = self;
        let space = if unit.is_empty() { "" } else { " " };
        write!(f, "{name} = {}{space}{unit}", exact(*value))
    }
}

/// Lines about default values that are not used, because the system or the source has one.
pub(super) fn doubts(values: &[SurrogateStart], defaults: &[DefaultValue]) -> Vec<String> {
    let doubt = |default: &DefaultValue| {
        let used = values.iter().find(|value| value.name == default.name)?;
        let is_used = used.origin == StartOrigin::Default;
        (!is_used).then(|| format!("--default {} is not used: the value {} is {}", default.name, used, used.origin))
    };
    defaults.iter().filter_map(doubt).collect()
}

#[cfg(test)]
mod tests {
    use super::{
        super::counterparts::tests::{described, parsed},
        *,
    };

    #[test]
    fn every_start_value_has_its_origin() {
        use Causality::{Input, Local, Parameter};
        let source =
            described(&[("force", Input), ("load", Input), ("L", Parameter), ("mass", Parameter), ("angle", Local)]);
        let surrogate = described(&[
            ("force", Input),
            ("load", Input),
            ("torque", Input),
            ("L", Parameter),
            ("mass", Parameter),
            ("angle_start", Parameter),
            ("hidden_start", Parameter),
            ("domain_policy", Parameter),
        ]);
        let defaults = parsed(&["torque=2", "L=3"]);
        let set = [("mass", 4.0), ("theta0", 0.1)];
        let TakenOver { values, unused } =
            taken_over([&source, &surrogate], &set, &defaults, |name: &str| name == "force");
        assert_eq!(unused, [("theta0".to_owned(), 0.1)]);
        assert_eq!(
            SurrogateStart::lines(&values),
            [
                "start values set by the system: mass = 4",
                "start values of the source: force = 1.5, load = 1.5, L = 1.5, angle_start = 1.5",
                "start values requested by --default: torque = 2",
                "start values of the surrogate, as the source has none: hidden_start = 1.5",
            ]
        );
        assert_eq!(doubts(&values, &defaults), ["--default L is not used: the value L = 1.5 is of the source"]);
        // equal values need not be set
        assert_eq!(to_set(&surrogate, &values), [("mass".to_owned(), 4.0), ("torque".to_owned(), 2.0)]);
    }
}
