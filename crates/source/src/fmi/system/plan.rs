//! Fits a system to its components: connected, set and recorded variables must be in their descriptions.

use super::{
    ComponentSource, Connection, End, FmuSystem,
    run::{ComponentRun, Port, SystemRun},
};
use crate::{
    Error, Result,
    diagnostics::names::did_you_mean,
    fmi::{
        ModelDescription,
        host::is_settable,
        model_description::{Causality, ScalarVariable, VariableType},
    },
    unit::is_same,
};

/// When and how a system is run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Experiment {
    /// First communication point in s.
    pub start: f64,
    /// Last communication point in s.
    pub stop: f64,
    /// Communication step size in s.
    pub step: f64,
    /// Tolerance of model exchange, see [`SystemRun::tolerance`].
    pub tolerance: Option<f64>,
}

impl FmuSystem {
    /// Run of the system with a source for each component. It has the system's values and connections, but records
    /// nothing yet; the steps of component `measured` are measured.
    ///
    /// # Errors
    /// [`Error::System`] with every connector and value that does not fit the sources.
    ///
    /// # Panics
    /// If there are more or fewer sources than components.
    pub fn plan(&self, sources: &[ComponentSource], measured: usize, experiment: Experiment) -> Result<SystemRun> {
        assert_eq!(sources.len(), self.components.len(), "a source for each component");
        let mut problems = Vec::new();
        for (position, source) in sources.iter().enumerate() {
            problems.extend(self.misfits(position, source.description()));
        }
        problems.sort();
        problems.dedup();
        self.refuse(problems)?;
        let connections = self.connect(sources)?;
        let components = self.components.iter().zip(sources).map(|(component, source)| ComponentRun {
            name: component.name.clone(),
            path: source.path().to_owned(),
            model: source.model(),
            start_values: component.values.iter().map(|value| (value.name.clone(), value.value)).collect(),
            tolerance: None,
        });
        let Experiment { start, stop, step, tolerance } = experiment;
        Ok(SystemRun {
            components: components.collect(),
            connections,
            recorded: Vec::new(),
            watched: Vec::new(),
            measured,
            start,
            stop,
            step,
            tolerance,
        })
    }

    /// The connections by the sources' own names; every source has the variables.
    ///
    /// # Errors
    /// [`Error::System`] with those between values of different types.
    pub fn connect(&self, sources: &[ComponentSource]) -> Result<Vec<[Port; 2]>> {
        let kind = |end: &End| {
            let variable = sources[end.component].description().variable(&end.connector)?;
            Some(group(variable))
        };
        let mixed = self
            .connections
            .iter()
            .filter_map(|Connection { from, to }| {
                let (one, other) = (kind(from)?, kind(to)?);
                let message =
                    format!("`{}` is {one}, and `{}` is {other}: expected equal types", from.connector, to.connector);
                // all of them are numbers
                (one != other && other != REAL).then_some((from.line, message))
            })
            .collect();
        self.refuse(mixed)?;
        let port = |end: &End| port(end.component, &sources[end.component], &end.connector);
        Ok(self.connections.iter().map(|Connection { from, to }| [port(from), port(to)]).collect())
    }

    fn refuse(&self, problems: Vec<(usize, String)>) -> Result<()> {
        if problems.is_empty() { Ok(()) } else { Err(Error::System { path: self.path.clone(), problems }) }
    }

    /// Mismatches between the system and the description of a component, with lines.
    fn misfits(&self, position: usize, description: &ModelDescription) -> Vec<(usize, String)> {
        let component = &self.components[position];
        let mut problems = Vec::new();
        let connected = self.connections.iter().flat_map(|Connection { from, to }| [(from, false), (to, true)]);
        let outputs = self.outputs.iter().map(|(_, end)| (end, false));
        for (end, is_input) in connected.chain(outputs).filter(|(end, _)| end.component == position) {
            if let Some(problem) = misfit(description, &end.connector, is_input) {
                let line =
                    component.connectors.iter().find(|known| known.name == end.connector).map(|known| known.line);
                problems.push((line.unwrap_or(end.line), format!("component `{}`: {problem}", component.name)));
            }
        }
        for value in &component.values {
            let Some(variable) = description.variable(&value.name) else {
                let message = format!("component `{}`: it has no variable `{}`", component.name, value.name);
                problems.push((value.line, message + &meant(description, &value.name)));
                continue;
            };
            let wrong =
                |problem: String| (value.line, format!("component `{}`: `{}` {problem}", component.name, value.name));
            if !is_settable(variable) || !is_number(variable) {
                problems.push(wrong("cannot be set to a number before initialization".into()));
            }
            let unit = description.unit_of(variable);
            if let (Some(found), Some(expected)) = (value.unit.as_deref(), unit)
                && !is_same(found, expected)
            {
                problems
                    .push(wrong(format!("is set in {found}, expected its unit {expected}: units are not converted")));
            }
        }
        problems
    }
}

/// Reason why a variable cannot be a connector: it is missing, or has another causality or type.
pub fn misfit(description: &ModelDescription, name: &str, is_input: bool) -> Option<String> {
    let Some(variable) = description.variable(name) else {
        return Some(format!("it has no variable `{name}`{}", meant(description, name)));
    };
    if (variable.causality == Causality::Input) != is_input {
        return Some(format!("`{name}` is no {}", if is_input { "input" } else { "output" }));
    }
    (!is_number(variable)).then(|| format!("`{name}` is not a scalar number"))
}

/// A variable of a component, by the name that is not an alias.
pub fn port(component: usize, source: &ComponentSource, name: &str) -> Port {
    let variable = source.description().variable(name).map_or(name, |variable| &variable.name);
    Port { component, variable: variable.to_owned() }
}

/// Returns true if a variable is a scalar real number, integer or boolean.
pub fn is_number(variable: &ScalarVariable) -> bool {
    variable.kind.is_number() && variable.dimensions.is_empty()
}

fn meant(description: &ModelDescription, name: &str) -> String {
    did_you_mean(name, description.variables.iter().map(|variable| variable.name.as_str()))
}

const REAL: &str = "a real number";

/// Kind of a variable; only variables of one kind may be connected.
fn group(variable: &ScalarVariable) -> &'static str {
    match variable.kind {
        VariableType::Real(_) => REAL,
        VariableType::Boolean { .. } => "a boolean",
        _ => "an integer",
    }
}
