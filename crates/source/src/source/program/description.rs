//! Description that a program gives, and differences from a study.

use super::{
    PROTOCOL,
    reply::{ReplyError, check_id, from_json},
};
use crate::{
    diagnostics::{Problems, names::expected_one_of, numbers::ends},
    study::Study,
    unit::is_same,
};
use indexmap::IndexMap;
use serde::Deserialize;

/// Quantities of a program, as it describes them.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default)]
pub struct ProgramDescription {
    id: Option<u64>,
    protocol: Option<u32>,
    error: Option<String>,
    /// One sentence for people.
    pub description: String,
    /// Quantities that are constant during a run.
    pub parameters: IndexMap<String, ProgramQuantity>,
    /// Quantities that drive a run.
    pub inputs: IndexMap<String, ProgramQuantity>,
    /// Quantities from which the equations follow.
    pub states: IndexMap<String, ProgramQuantity>,
    /// Quantities that a run results in.
    pub outputs: IndexMap<String, ProgramQuantity>,
    /// Length of a usual run, in s.
    pub stop: Option<f64>,
    /// Time between two rows of a usual run, in s.
    pub step: Option<f64>,
}

/// A quantity of a program.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ProgramQuantity {
    /// Unit; empty for a dimensionless quantity.
    pub unit: String,
    /// One sentence for people.
    pub description: String,
    /// Smallest value.
    pub min: Option<f64>,
    /// Largest value.
    pub max: Option<f64>,
    /// Value where it is not set.
    pub start: Option<f64>,
    /// `true` for a state that is an angle in rad, if the equations are the same a turn later.
    pub periodic: bool,
    /// Coordinate whose rate a state is, if the program gives the mass matrix.
    pub rate_of: Option<String>,
}

impl ProgramDescription {
    /// Reads the reply to the first request.
    pub(super) fn parse(line: &[u8], id: u64) -> Result<Self, ReplyError> {
        let description: Self = from_json(line)?;
        if let Some(message) = description.error {
            return Err(ReplyError::Reported(message));
        }
        if description.protocol != Some(PROTOCOL) {
            let message = match description.protocol {
                Some(found) => format!("the program has protocol {found}, expected {PROTOCOL}"),
                None => format!("the reply to `describe` has no `protocol`, expected {PROTOCOL}"),
            };
            return Err(ReplyError::Mismatch(message));
        }
        check_id(description.id, id)?;
        Ok(description)
    }
}

impl ProgramQuantity {
    /// The range, if both ends are known.
    pub fn range(&self) -> Option<[f64; 2]> {
        Some([self.min?, self.max?])
    }
}

/// Every name that the program does not have, every unit that is not the program's, and every range beyond the program's.
pub(super) fn differences(description: &ProgramDescription, study: &Study) -> Problems {
    let mut comparison = DifferenceCheck { problems: Problems::default() };
    let ProgramDescription { parameters, inputs, states, outputs, .. } = description;
    for (name, options) in &study.parameters {
        let key = format!("parameters.{name}");
        comparison.check(
            &key,
            "parameter",
            name,
            parameters,
            options.unit.as_deref(),
            Some([options.min, options.max]),
        );
    }
    for (name, value) in &study.source.constants {
        // a constant is given without a unit
        let unit = parameters.get(name).map(|known| known.unit.as_str());
        let key = format!("source.constants.{name}");
        comparison.check(&key, "parameter", name, parameters, unit, Some([*value, *value]));
    }
    for (name, options) in &study.inputs {
        let ends = options.min.zip(options.max).map(|(min, max)| [min, max]);
        comparison.check(&format!("inputs.{name}"), "input", name, inputs, options.unit.as_deref(), ends);
    }
    for (name, options) in &study.states {
        // the range of the equations may be narrower or wider than that of usual runs
        comparison.check(&format!("states.{name}"), "state", name, states, options.unit.as_deref(), None);
        let own = states.get(name).and_then(|state| state.rate_of.as_deref());
        if let Some(found) = options.rate_of.as_deref().filter(|found| Some(*found) != own) {
            let own = own.map_or("none".into(), |own| format!("`{own}`"));
            let message =
                format!("`{found}`, but the program's `rate_of` is {own}: it gives a mass matrix for its own");
            comparison.problems.add(format!("states.{name}.rate_of"), message);
        }
    }
    for (name, options) in &study.outputs {
        comparison.check(&format!("outputs.{name}"), "output", name, outputs, options.unit.as_deref(), None);
    }
    let missing: Vec<&str> =
        states.keys().filter(|name| !study.states.contains_key(*name)).map(String::as_str).collect();
    if study.runs().start_from_states && !missing.is_empty() {
        let message = format!("without {}, expected every state of the program", missing.join(", "));
        comparison.problems.add("states", message);
    }
    comparison.problems
}

struct DifferenceCheck {
    problems: Problems,
}

impl DifferenceCheck {
    fn check(
        &mut self,
        key: &str,
        what: &str,
        name: &str,
        known: &IndexMap<String, ProgramQuantity>,
        unit: Option<&str>,
        range: Option<[f64; 2]>,
    ) {
        let Some(quantity) = known.get(name) else {
            let names: Vec<&str> = known.keys().map(String::as_str).collect();
            let message = format!("the program has no {what} `{name}`, {}", expected_one_of(name, &names));
            self.problems.add(key, message);
            return;
        };
        let own = quantity.unit.as_str();
        if !is_same(unit.unwrap_or_default(), own) {
            let found = unit.map_or("missing".into(), |unit| format!("`{unit}`"));
            let expected = if own.is_empty() { "no unit (dimensionless)".into() } else { format!("`{own}`") };
            let message = format!("{found}, expected {expected}: values are in the program's unit");
            self.problems.add(format!("{key}.unit"), message);
        }
        let Some([min, max]) = range else { return };
        let (least, most) = (quantity.min.unwrap_or(f64::NEG_INFINITY), quantity.max.unwrap_or(f64::INFINITY));
        if min < least || max > most {
            let found = if min == max { format!("{min}") } else { format!("range from {min} to {max}") };
            self.problems.add(key, format!("{found}, the program takes {}", ends(least, most)));
        }
    }
}
