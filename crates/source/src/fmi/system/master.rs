//! A run of a system: components that step side by side and exchange values at common communication points.
//!
//! The coupling is of the Jacobi kind: over a step every component has as inputs the outputs that the others had at its beginning,
//! held until its end. At the start, outputs are handed on in Initialization Mode until nothing changes.

use super::{
    run::{ComponentModel, ComponentRun, Port, SystemRun},
    simulator::{FmuSimulator, MechanismSimulator, Simulator},
};
use crate::{
    Error, Result,
    fmi::host::{Fmu, FmuInstance, Grid, RecordedColumn, RowSink, StepResult},
    multibody::Mechanism,
};
use std::{mem::ManuallyDrop, path::Path, time::Instant};

/// Largest number of passes that hand on outputs at the start. Components that depend on each other without delay might
/// never settle.
const PASSES: usize = 100;

/// A component that is loaded.
#[derive(Debug)]
#[expect(clippy::large_enum_variant, reason = "there is one for each component of a system")]
pub enum Loaded {
    /// An FMU; it need not survive that its library is unloaded.
    Fmu(ManuallyDrop<Fmu>),
    /// A mechanism.
    Mechanism(Mechanism),
}

/// A component that is about to be simulated.
#[derive(Debug)]
pub enum Instantiated<'a> {
    /// An FMU.
    Fmu(FmuInstance<'a>),
    /// A mechanism.
    Mechanism(&'a Mechanism),
}

/// Names of the columns behind those of variables: wall time in s of the step that leads to the row. The first is that
/// of the measured component with its inputs and outputs, the second that of all components. Both are 0 in the first
/// row.
pub const TIMES: [&str; 2] = ["component_seconds", "step_seconds"];

impl SystemRun {
    /// Loads the components, in a process that is there for this run alone.
    ///
    /// # Errors
    /// [`Error::Component`].
    pub fn load(&self) -> Result<Vec<Loaded>> {
        self.components
            .iter()
            .map(|ComponentRun { name, path, model, .. }| {
                let loaded = match model {
                    ComponentModel::Fmu { folder, interface } => {
                        Fmu::open_unpacked(path, folder, *interface).map(|fmu| Loaded::Fmu(ManuallyDrop::new(fmu)))
                    }
                    ComponentModel::Mechanism { text } => Mechanism::parse(text, path).map(Loaded::Mechanism),
                };
                loaded.map_err(of_component(name))
            })
            .collect()
    }

    /// Makes an instance of each component.
    ///
    /// # Errors
    /// [`Error::Component`].
    pub fn instantiate<'a>(&self, loaded: &'a [Loaded]) -> Result<Vec<Instantiated<'a>>> {
        self.components
            .iter()
            .zip(loaded)
            .map(|(ComponentRun { name, .. }, loaded)| match loaded {
                Loaded::Fmu(fmu) => fmu.instantiate(name, false).map(Instantiated::Fmu).map_err(of_component(name)),
                Loaded::Mechanism(mechanism) => Ok(Instantiated::Mechanism(mechanism)),
            })
            .collect()
    }

    /// Makes the run with instances that are new, and gives its rows to a sink: recorded variables, those watched, [`TIMES`]. Returns
    /// whether an FMU ended the simulation before its stop time.
    ///
    /// # Errors
    /// - [`Error::Experiment`]: the times make no simulation, or need a partial step that an FMU cannot do;
    /// - [`Error::Component`]: a component failed;
    /// - those of the sink.
    pub fn simulate(&self, instances: &[Instantiated], sink: &mut impl RowSink) -> Result<bool> {
        let fmus = instances.iter().filter_map(|instance| match instance {
            Instantiated::Fmu(instance) => Some(instance.fmu()),
            Instantiated::Mechanism(_) => None,
        });
        let grid = Grid::of_fmus(self.start, self.stop, self.step, fmus)?;
        let mut parts = Vec::new();
        for (index, instance) in instances.iter().enumerate() {
            parts.push(
                CoupledComponent::new(self, index, instance).map_err(of_component(&self.components[index].name))?,
            );
        }
        let outputs: Vec<Vec<String>> = (0..parts.len()).map(|component| self.outputs(component)).collect();
        let recorded: Vec<(usize, usize)> = self
            .recorded
            .iter()
            .map(|Port { component, variable }| {
                let column = outputs[*component].iter().position(|name| name == variable);
                (*component, column.unwrap_or_default())
            })
            .collect();
        sink.begin(&self.columns())?;
        let row = |parts: &[CoupledComponent], seconds: [f64; 2]| {
            let mut row: Vec<f64> =
                recorded.iter().map(|&(component, column)| parts[component].values[column]).collect();
            for Port { component, variable } in &self.watched {
                let CoupledComponent { simulator, name, .. } = &parts[*component];
                row.push(simulator.watch(variable).map_err(of_component(name))?);
            }
            row.extend(seconds);
            Ok::<_, Error>(row)
        };
        if self.initialize(&mut parts)? {
            return Ok(true);
        }
        sink.row(self.start, &row(&parts, [0.0; 2])?)?;
        for index in 0..grid.steps() {
            let (begin, mut seconds) = (Instant::now(), 0.0);
            let inputs: Vec<Vec<f64>> = parts.iter().map(|part| part.gather(&parts)).collect();
            let mut terminated = false;
            for (position, (part, inputs)) in parts.iter_mut().zip(inputs).enumerate() {
                let begin = Instant::now();
                let step = part.step(inputs, [grid.time(index), grid.size(index), grid.time(index + 1)]);
                terminated |= step.map_err(of_component(part.name))? != StepResult::Done;
                if position == self.measured {
                    seconds = begin.elapsed().as_secs_f64();
                }
            }
            let all = begin.elapsed().as_secs_f64();
            if terminated {
                return Ok(true);
            }
            sink.row(grid.time(index + 1), &row(&parts, [seconds, all])?)?;
        }
        parts.iter().try_for_each(|part| part.simulator.terminate().map_err(of_component(part.name)))?;
        Ok(false)
    }

    /// Sets start values and goes through the initialization. Returns whether a component ends the simulation there.
    fn initialize(&self, parts: &mut [CoupledComponent]) -> Result<bool> {
        for (part, component) in parts.iter_mut().zip(&self.components) {
            part.simulator.enter(&component.start_values, self).map_err(of_component(part.name))?;
            part.read().map_err(of_component(part.name))?;
        }
        for _ in 0..PASSES {
            let mut changed = false;
            for index in 0..parts.len() {
                let inputs = parts[index].gather(parts);
                let part = &mut parts[index];
                if !same(&part.given, &inputs) {
                    changed = true;
                    part.set(inputs).and_then(|()| part.read()).map_err(of_component(part.name))?;
                }
            }
            if !changed {
                break;
            }
        }
        let mut terminated = false;
        for part in parts {
            let begun = part.simulator.begin(self).and_then(|step| part.read().map(|()| step));
            terminated |= begun.map_err(of_component(part.name))? != StepResult::Done;
        }
        Ok(terminated)
    }

    /// Columns of the rows.
    fn columns(&self) -> Vec<RecordedColumn> {
        let names = self
            .recorded
            .iter()
            .chain(&self.watched)
            .map(|Port { component, variable }| format!("{}.{variable}", self.components[*component].name))
            .chain(TIMES.map(str::to_owned));
        names.map(|name| RecordedColumn { name, unit: None }).collect()
    }

    /// The outputs of a component that are connected or recorded, each once.
    fn outputs(&self, component: usize) -> Vec<String> {
        let mut names: Vec<String> = Vec::new();
        let ports = self.connections.iter().map(|[from, _]| from).chain(&self.recorded);
        for port in ports.filter(|port| port.component == component) {
            if !names.contains(&port.variable) {
                names.push(port.variable.clone());
            }
        }
        names
    }
}

/// A component in its system.
struct CoupledComponent<'a> {
    name: &'a str,
    simulator: Box<dyn Simulator + 'a>,
    /// The component and output that each input takes its value from.
    sources: Vec<(usize, usize)>,
    /// Values that the inputs have.
    given: Vec<f64>,
    /// Values of the outputs at the last communication point.
    values: Vec<f64>,
}

impl<'a> CoupledComponent<'a> {
    fn new(run: &'a SystemRun, index: usize, instance: &'a Instantiated<'a>) -> Result<Self> {
        let (mut inputs, mut sources) = (Vec::new(), Vec::new());
        for [from, to] in run.connections.iter().filter(|[_, to]| to.component == index) {
            let output = run.outputs(from.component).iter().position(|name| *name == from.variable);
            inputs.push(to.variable.as_str());
            sources.push((from.component, output.unwrap_or_default()));
        }
        let outputs = run.outputs(index);
        let ComponentRun { name, tolerance, .. } = &run.components[index];
        let tolerance = tolerance.or(run.tolerance);
        let simulator: Box<dyn Simulator> = match instance {
            Instantiated::Fmu(instance) => Box::new(FmuSimulator::new(instance, &inputs, &outputs, tolerance)?),
            Instantiated::Mechanism(mechanism) => {
                Box::new(MechanismSimulator::new(mechanism, &inputs, &outputs, tolerance))
            }
        };
        Ok(Self { name, simulator, sources, given: Vec::new(), values: Vec::new() })
    }

    /// The values that its inputs are to have.
    fn gather(&self, parts: &[Self]) -> Vec<f64> {
        self.sources.iter().map(|&(component, output)| parts[component].values[output]).collect()
    }

    /// Sets the inputs in the initialization.
    fn set(&mut self, inputs: Vec<f64>) -> Result<()> {
        self.simulator.set(&inputs)?;
        self.given = inputs;
        Ok(())
    }

    fn read(&mut self) -> Result<()> {
        self.values = self.simulator.read()?;
        Ok(())
    }

    /// Sets the inputs, steps and reads the outputs.
    fn step(&mut self, inputs: Vec<f64>, times: [f64; 3]) -> Result<StepResult> {
        let changed = !same(&self.given, &inputs);
        let step = self.simulator.step(&inputs, changed, times)?;
        self.given = inputs;
        self.read()?;
        Ok(step)
    }
}

/// Returns true if values are equal to the last bit.
fn same(one: &[f64], other: &[f64]) -> bool {
    one.len() == other.len() && one.iter().zip(other).all(|(one, other)| one.to_bits() == other.to_bits())
}

/// For `map_err`: adds the name of the component that failed.
fn of_component(name: &str) -> impl FnOnce(Error) -> Error {
    move |source| Error::Component { name: name.to_owned(), source: Box::new(source) }
}

/// The folder that a worker removes if nobody else does.
pub(in crate::fmi) fn folder(run: &SystemRun) -> &Path {
    let mut folders = run.components.iter().filter_map(|component| match &component.model {
        ComponentModel::Fmu { folder, .. } => Some(folder.as_path()),
        ComponentModel::Mechanism { .. } => None,
    });
    folders.next().unwrap_or(Path::new(""))
}
