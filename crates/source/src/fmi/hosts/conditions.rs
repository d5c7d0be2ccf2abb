//! Conditions of rules: properties of FMUs that hosts stumble over.

use super::facts::{HostedFmu, WrittenVariable};
use crate::diagnostics::names::listed;

/// A property of FMUs.
#[derive(Clone, Copy)]
pub(super) enum Condition {
    /// Property of variables, whose names a finding lists.
    Variables(fn(&WrittenVariable) -> bool),
    /// Property of the whole FMU.
    Whole(fn(HostedFmu) -> bool),
    /// Property of something else: the function returns text that names what has it.
    Text(fn(HostedFmu) -> Option<String>),
}

/// Names that a message lists.
const SHOWN: usize = 3;

impl Condition {
    /// The cause of a finding: what has the property, followed by its consequence. None if nothing has it.
    pub fn cause(self, fmu: HostedFmu, consequence: &str) -> Option<String> {
        let found = match self {
            Self::Whole(holds) => return holds(fmu).then(|| consequence.to_owned()),
            Self::Variables(holds) => {
                let variables = fmu.facts.variables().filter(holds);
                listing(variables.map(|written| written.variable.name.as_str()))
            }
            Self::Text(text) => text(fmu),
        };
        found.map(|found| format!("{found}: {consequence}"))
    }
}

/// The first of several names as text, or `None` without names.
pub(super) fn listing<'a>(names: impl Iterator<Item = &'a str>) -> Option<String> {
    let names: Vec<String> = names.map(|name| format!("`{name}`")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    match names.len() {
        0 => None,
        count if count > SHOWN => Some(format!("{} and {} more", listed(&names[..SHOWN]), count - SHOWN)),
        _ => Some(listed(&names)),
    }
}
