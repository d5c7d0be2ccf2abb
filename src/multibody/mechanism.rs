//! The mechanism file: read, checked, simulated.

use super::{
    build::{Problems, build},
    description::{Description, ParameterOptions},
    simulate::simulate,
};
use crate::{Error, Result, origin::Origin, variable::Variable};
use indexmap::IndexMap;
use std::path::Path;

/// A mechanism file's content, checked.
#[derive(Clone, Debug)]
pub struct Mechanism {
    description: Description,
    outputs: Vec<Variable>,
}

impl Mechanism {
    /// Reads and checks a mechanism file.
    ///
    /// # Errors
    /// [`Error::Io`] if it cannot be read, [`Error::Study`] with every problem found.
    pub fn load(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(Error::io(path, "read"))?;
        Self::parse(&text, path)
    }

    /// Checks a mechanism file's text; `path` is for messages.
    ///
    /// # Errors
    /// [`Error::Study`] with every problem found.
    pub fn parse(text: &str, path: &Path) -> Result<Self> {
        let origin = Origin::new(path, text);
        let description: Description = origin.deserialize()?;
        origin.refuse(name_problems(&description))?;
        let defaults: Vec<f64> = description.parameters.values().map(|parameter| parameter.default).collect();
        let (model, measures) = match build(&description, &defaults) {
            Ok(built) => built,
            Err(problems) => return Err(origin.refuse(problems).expect_err("there is a problem")),
        };
        let (mut problems, mut outputs) = (Problems::new(), Vec::new());
        for ((name, output), measure) in description.outputs.iter().zip(&measures) {
            let unit = measure.unit(&model);
            if let Some(found) = output.unit.as_deref().filter(|&found| found != unit) {
                problems.push((format!("outputs.{name}.unit"), format!("`{found}`, expected `{unit}`")));
            }
            let description = output.description.clone();
            outputs.push(Variable::new(name, unit, &description));
        }
        if let Err(message) = model.initial_state(0.0) {
            let sets = [&model.constraints, &model.initial_positions, &model.initial_velocities];
            let mut owners = sets.iter().flat_map(|set| &set.0).map(|constraint| &constraint.owner);
            let key = owners.find(|owner| message.contains(&format!("`{owner}`")));
            problems.push((key.cloned().unwrap_or_default(), message));
        }
        origin.refuse(problems)?;
        Ok(Self { description, outputs })
    }

    /// What the file says.
    pub fn description(&self) -> &Description {
        &self.description
    }

    /// What a study may vary.
    pub fn parameters(&self) -> &IndexMap<String, ParameterOptions> {
        &self.description.parameters
    }

    /// What a study may ask for.
    pub fn outputs(&self) -> &[Variable] {
        &self.outputs
    }

    /// Simulates one run: a value for each parameter, evenly spaced times and the integration's tolerance in; rows of all
    /// outputs out, one after the other.
    ///
    /// # Errors
    /// A sentence that says what failed, when, and at which joint.
    pub fn simulate(&self, values: &[f64], times: &[f64], tolerance: f64) -> std::result::Result<Vec<f64>, String> {
        let sentence = |problems: Problems| {
            problems.into_iter().map(|(key, message)| format!("{key}: {message}")).collect::<Vec<_>>().join("; ")
        };
        let (mut model, measures) = build(&self.description, values).map_err(sentence)?;
        model.tolerance = tolerance;
        let mut rows = Vec::with_capacity(times.len() * measures.len());
        for sample in simulate(&model, times)? {
            for (measure, output) in measures.iter().zip(&self.outputs) {
                let value = measure.value(&model, &sample);
                if !value.is_finite() {
                    return Err(format!("output `{}` is {value} at t = {} s", output.name, sample.t));
                }
                rows.push(value);
            }
        }
        Ok(rows)
    }
}

/// Names that cannot be told apart or cannot stand in an expression.
fn name_problems(description: &Description) -> Problems {
    let mut problems = Problems::new();
    let Description { parameters, bodies, joints, drivers, springs, forces, actuators, .. } = description;
    let mut parts: Vec<(&str, &str)> = vec![("the ground", "ground")];
    let sections: [(&str, Vec<&String>); 7] = [
        ("parameters", parameters.keys().collect()),
        ("bodies", bodies.keys().collect()),
        ("joints", joints.keys().collect()),
        ("drivers", drivers.keys().collect()),
        ("springs", springs.keys().collect()),
        ("forces", forces.keys().collect()),
        ("actuators", actuators.keys().collect()),
    ];
    for (section, names) in &sections {
        // parameters stand alone in expressions, parts of the mechanism with a dot behind them
        let mut taken = vec![("the time", "time"), ("a number", "pi")];
        let seen = if *section == "parameters" { &mut taken } else { &mut parts };
        for name in names {
            let key = format!("{section}.{name}");
            if !is_plain(name) {
                let expected = "expected a letter or `_`, then letters, digits and `_`";
                problems.push((key, format!("`{name}` is no name: {expected}")));
            } else if let Some((other, _)) = seen.iter().find(|(_, known)| known == name) {
                problems.push((key, format!("`{name}` is the name of {other} already")));
            } else {
                seen.push((section, name));
            }
        }
    }
    let points = bodies.iter().map(|(name, body)| (format!("bodies.{name}"), &body.points));
    for (key, points) in points.chain([("ground".to_owned(), &description.ground.points)]) {
        for name in points.keys().filter(|name| !is_plain(name)) {
            problems.push((format!("{key}.points.{name}"), format!("`{name}` is no name")));
        }
    }
    if bodies.is_empty() {
        problems.push(("bodies".into(), "no body, expected at least one".into()));
    }
    if description.outputs.is_empty() {
        problems.push(("outputs".into(), "no output, expected at least one".into()));
    }
    for (name, parameter) in parameters {
        for (field, value) in [("default", Some(parameter.default)), ("min", parameter.min), ("max", parameter.max)] {
            if value.is_some_and(|value| !value.is_finite()) {
                problems.push((format!("parameters.{name}.{field}"), "expected a finite number".into()));
            }
        }
    }
    problems
}

fn is_plain(name: &str) -> bool {
    let first = name.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_');
    first && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
}
