//! Sources of training data.

mod calibration_runs;
pub mod driven;
mod failure;
pub mod fmu;
mod journal;
mod kinds;
mod launch;
mod own_equations;
mod point;
pub mod program;
pub mod recorded;
pub mod rows;
pub mod setting;
pub mod shard;
pub mod simulation;
pub mod timed;
pub mod worker;

use crate::{
    Result,
    dataset::{DatasetColumns, Run},
    diagnostics::{KeyProblem, Problems},
    study::{Draft, Study},
    unit,
    variable::SourceVariable,
};
pub use failure::{FailureCause, RunFailure};
pub use journal::Journal;
use metafmu_runtime::{BuiltIn, Output, State};
pub use own_equations::{OwnRuns, integrate_own_equations};
pub use point::{MovingMechanism, MovingPoint};
pub use recorded::Recorded;
pub use rows::StaticRows;
pub use simulation::Simulation;
use std::path::Path;

/// Source of a study's runs, with its parameters and outputs resolved.
#[derive(Clone, Debug)]
pub enum Source {
    /// A system or mechanism that is simulated here, or an FMU or program that is run.
    Simulation(Simulation),
    /// Tables of runs that were simulated elsewhere.
    Recorded(Box<Recorded>),
    /// A table of rows without a time.
    Rows(Box<StaticRows>),
}

/// Reads a study file and finds its source.
///
/// # Errors
/// [`Error::Study`](crate::Error::Study) with every mistake in the study, in the files it names, and in what it asks its source for; the errors of a
/// source that cannot be read, if nothing else is wrong.
pub fn open(path: &Path) -> Result<(Study, Source)> {
    let mut draft = Draft::load(path)?;
    if !draft.is_valid() {
        if let Some(Err(error)) = draft.names().map(Source::new) {
            draft.add(error);
        }
        return Err(draft.finish().expect_err("the draft is not valid"));
    }
    let study = draft.finish()?;
    let source = Source::new(&study)?;
    Ok((study, source))
}

/// Problems of names in a study that its FMU needs for measured outputs, if it is discrete-time.
fn names_of_measured(study: &Study) -> Problems {
    let mut problems = Problems::default();
    if !study.runs().are_samples {
        return problems;
    }
    let of_output =
        |name: &String| (Output::measured_name(name), format!("the name of the measured value of `{name}`"));
    let switch =
        (BuiltIn::UseMeasured.name().to_owned(), "the name of the input that switches measured outputs on".into());
    for (name, what) in study.outputs.keys().map(of_output).chain([switch]) {
        for (section, is_there) in [
            ("parameters", study.parameters.contains_key(&name)),
            ("inputs", study.inputs.contains_key(&name)),
            ("outputs", study.outputs.contains_key(&name)),
            ("arrays", study.arrays.contains_key(&name)),
        ] {
            if is_there {
                problems.add(format!("{section}.{name}"), format!("`{name}` is {what}"));
            }
        }
    }
    problems
}

impl Source {
    /// Finds the study's system, mechanism or table and in it the study's parameters, constants and outputs.
    ///
    /// # Errors
    /// [`Error::Study`](crate::Error::Study) with every name the source does not know and every unit that is not the
    /// source's, [`Error::Table`](crate::Error::Table) or [`Error::Io`](crate::Error::Io) if it is a table that cannot be read.
    pub fn new(study: &Study) -> Result<Self> {
        let source = if study.runs().are_rows {
            Self::Rows(Box::new(StaticRows::new(study)?))
        } else if study.source.is_recorded() {
            Self::Recorded(Box::new(Recorded::new(study)?))
        } else {
            Self::Simulation(Simulation::new(study)?)
        };
        let mut problems = source.array_problems(study);
        problems.extend(names_of_measured(study));
        study.refuse(problems)?;
        Ok(source)
    }

    /// The parameters, in the study's order.
    pub fn parameters(&self) -> &[SourceVariable] {
        match self {
            Self::Simulation(simulation) => simulation.parameters(),
            Self::Recorded(recorded) => recorded.parameters(),
            Self::Rows(_) => &[],
        }
    }

    /// The outputs, in the study's order.
    pub fn outputs(&self) -> &[SourceVariable] {
        match self {
            Self::Simulation(simulation) => simulation.outputs(),
            Self::Recorded(recorded) => recorded.outputs(),
            Self::Rows(rows) => rows.outputs(),
        }
    }

    /// Inputs that drive the runs, in the source's order.
    pub fn inputs(&self) -> &[SourceVariable] {
        match self {
            Self::Simulation(simulation) => simulation.inputs(),
            Self::Recorded(recorded) => recorded.inputs(),
            Self::Rows(rows) => rows.inputs(),
        }
    }

    /// For discrete-time models: the value of each input before the start, and its range in the study or the source,
    /// infinite where neither has one.
    pub fn drives(&self) -> Vec<(f64, [f64; 2])> {
        match self {
            Self::Simulation(simulation) => {
                let drivers = simulation.driven().map_or(&[][..], driven::Driven::drivers);
                drivers.iter().map(|driver| (driver.start, [driver.min, driver.max])).collect()
            }
            Self::Recorded(recorded) => recorded.drives(),
            Self::Rows(_) => Vec::new(),
        }
    }

    /// Initial states and inputs, if the study wants states, or the source simulates driven runs.
    pub fn driven(&self) -> Option<&driven::Driven> {
        match self {
            Self::Simulation(simulation) => simulation.driven(),
            Self::Recorded(recorded) => recorded.motions().map(recorded::Motions::driven),
            Self::Rows(_) => None,
        }
    }

    /// The columns of its tables.
    pub fn columns(&self) -> DatasetColumns<'_> {
        DatasetColumns { parameters: self.parameters(), inputs: self.inputs(), outputs: self.outputs() }
    }

    /// Points whose paths follow from the outputs: those that the system declares, outputs `P.x` and `P.y` of a mechanism, and
    /// arrays of two outputs in metres.
    pub fn points(&self, study: &Study) -> Vec<MovingPoint> {
        let mut points = match self {
            Self::Simulation(simulation) => simulation.points(),
            Self::Recorded(_) | Self::Rows(_) => Vec::new(),
        };
        let outputs = self.outputs();
        for (name, elements) in &study.arrays {
            let columns: Vec<usize> = elements
                .iter()
                .filter_map(|name| outputs.iter().position(|output| output.name == *name))
                .filter(|&column| outputs[column].unit == "m")
                .collect();
            if let ([x, y], 2) = (columns.as_slice(), elements.len()) {
                points.push(MovingPoint::of_outputs(name, *x, *y));
            }
        }
        points
    }

    /// Mechanism in a run that was simulated here, for a picture of it.
    pub fn moving_mechanism(&self, run: &Run) -> Option<MovingMechanism> {
        match self {
            Self::Simulation(simulation) => simulation.moving_mechanism(run),
            Self::Recorded(_) | Self::Rows(_) => None,
        }
    }

    /// The elements of an array share its unit.
    fn array_problems(&self, study: &Study) -> Problems {
        let mut problems = Problems::default();
        for (name, elements) in &study.arrays {
            let units: Vec<Option<&String>> = elements
                .iter()
                .map(|name| self.outputs().iter().find(|output| output.name == *name).map(|output| &output.unit))
                .collect();
            if units.iter().any(|unit| *unit != units[0]) {
                problems.add(format!("arrays.{name}"), "the outputs have different units");
            }
        }
        problems
    }
}

/// Values are in the source's own unit; a study with another one would be silently wrong.
fn wrong_unit(key: &str, found: Option<&str>, expected: &str) -> Option<KeyProblem> {
    let found = found.filter(|&found| !unit::is_same(found, expected))?;
    let expected = if expected.is_empty() { "no unit (dimensionless)".into() } else { format!("`{expected}`") };
    let message = format!("`{found}`, expected {expected}: values are in the source's unit");
    Some(KeyProblem { key: format!("{key}.unit"), message })
}

/// Further parameters of a discrete-time run, behind those of the study: the values of outputs and inputs before it.
fn before_start<'a>(variables: impl Iterator<Item = &'a SourceVariable>) -> impl Iterator<Item = SourceVariable> {
    variables.map(|SourceVariable { name, unit, .. }| {
        SourceVariable::new(&State::start_name(name), unit, &format!("{name} before the start"))
    })
}

fn list<T: AsRef<str>>(names: impl Iterator<Item = T>) -> String {
    names.map(|name| name.as_ref().to_owned()).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn the_elements_of_an_array_have_one_unit() {
        let text = crate::systems::SYSTEMS[0].study.replacen(
            "[sampling]",
            "[arrays]\nq = [\"theta\", \"thetad\"]\n[sampling]",
            1,
        );
        let study = Study::parse(&text, Path::new("s.toml")).unwrap();
        let message = Source::new(&study).unwrap_err().to_string();
        assert!(message.contains("arrays.q: the outputs have different units"), "{message}");
    }
}
