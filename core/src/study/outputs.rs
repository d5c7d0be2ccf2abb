//! `[outputs]` and `[arrays]`: what the surrogate predicts.

use super::Study;
use crate::diagnostics::Problems;
use indexmap::IndexMap;
use metafmu_runtime::{BuiltIn, Output};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// An entry of `[outputs]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(extend("examples" = [{"unit": "rad"}, {}]))]
pub struct OutputOptions {
    /// Unit; must be the source's own, which it is unless given.
    pub unit: Option<String>,
    /// One sentence for people; the source's unless given.
    pub description: Option<String>,
}

/// Every mistake in `[outputs]`, by dotted key.
pub(super) fn problems(outputs: &IndexMap<String, OutputOptions>) -> Problems {
    let mut problems = Problems::default();
    if outputs.is_empty() {
        problems.add("outputs", "no output, expected at least one");
    }
    for name in outputs.keys() {
        check_variable_name(&mut problems, &format!("outputs.{name}"), name);
    }
    problems
}

/// Every mistake within `[arrays]`, by dotted key.
pub(super) fn array_problems(arrays: &IndexMap<String, Vec<String>>) -> Problems {
    let mut problems = Problems::default();
    for (name, outputs) in arrays {
        let key = format!("arrays.{name}");
        check_variable_name(&mut problems, &key, name);
        if outputs.len() < 2 {
            problems.add(&key, format!("{} outputs, expected at least 2", outputs.len()));
        }
        for (_, output) in outputs.iter().enumerate().filter(|(index, output)| outputs[..*index].contains(output)) {
            problems.add(&key, format!("`{output}` is duplicated"));
        }
    }
    problems
}

/// Problems that depend on the other sections: names of variables must be unique.
pub(super) fn problems_beside(study: &Study) -> Problems {
    let mut problems = Problems::default();
    let Study { parameters, outputs, arrays, .. } = study;
    for name in outputs.keys().filter(|name| parameters.contains_key(*name)) {
        let message = format!("`{name}` is a parameter already: names of variables must be unique");
        problems.add(format!("outputs.{name}"), message);
    }
    for (name, elements) in arrays {
        let key = format!("arrays.{name}");
        if parameters.contains_key(name) || outputs.contains_key(name) {
            let message = format!("`{name}` is a parameter or output already: names of variables must be unique");
            problems.add(&key, message);
        }
        for output in elements.iter().filter(|output| !outputs.contains_key(*output)) {
            problems.add(&key, format!("`{output}` is not an output"));
        }
    }
    for name in outputs.keys() {
        let derived = [
            (study.bounds.is_some(), format!("{name}_bound"), "error bound"),
            (study.static_map.std, Output::std_name(name), "predicted standard deviation"),
        ];
        for (_, derived, what) in derived.iter().filter(|(is_made, ..)| *is_made) {
            let sections = [
                ("parameters", parameters.contains_key(derived)),
                ("outputs", outputs.contains_key(derived)),
                ("arrays", arrays.contains_key(derived)),
                ("inputs", study.inputs.contains_key(derived)),
                ("states", study.states.contains_key(derived)),
            ];
            for (section, _) in sections.iter().filter(|(_, is_there)| *is_there) {
                problems
                    .add(format!("{section}.{derived}"), format!("`{derived}` is the name of the {what} of `{name}`"));
            }
        }
    }
    problems
}

/// FMI takes any text on one line, and so do the tables but for spaces at its ends.
pub fn check_variable_name(problems: &mut Problems, key: &str, name: &str) {
    if name.is_empty() || name.contains(char::is_control) || name.trim() != name {
        let expected = "expected a text on one line without spaces at its ends";
        problems.add(key, format!("`{}` is not a valid name of a variable, {expected}", name.escape_debug()));
    }
    if name == BuiltIn::Time.name() {
        problems.add(key, "`time` is the name of the independent variable");
    } else if BuiltIn::ALWAYS.iter().any(|variable| variable.name() == name) {
        problems.add(key, format!("`{name}` is the name of a variable that every FMU of metafmu has"));
    }
}
