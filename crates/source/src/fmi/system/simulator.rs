//! Simulators of a system's components: instances of FMUs, and mechanisms.

use super::run::SystemRun;
use crate::{
    Error, Result,
    fmi::{
        host::{Exchange, FmuInstance, Grid, InterfaceKind, NO_INPUTS, Recorder, StepResult, set_start},
        model_description::{RealAttributes, ScalarVariable, VariableType},
    },
    multibody::{Mechanism, MotionError, Stepper},
};

/// Tolerance of a mechanism's integration if none is given, as that of model exchange.
const TOLERANCE: f64 = 1e-8;

/// A component as the master sees it. Values are in the order of the inputs and outputs that it was made for.
pub trait Simulator {
    /// Sets start values and enters the initialization.
    fn enter(&mut self, start_values: &[(String, f64)], run: &SystemRun) -> Result<()>;

    /// Sets the inputs in the initialization.
    fn set(&mut self, inputs: &[f64]) -> Result<()>;

    /// The outputs now.
    fn read(&self) -> Result<Vec<f64>>;

    /// A variable that is no output now.
    fn watch(&self, variable: &str) -> Result<f64>;

    /// Leaves the initialization.
    fn begin(&mut self, run: &SystemRun) -> Result<StepResult>;

    /// Steps with inputs, which may have changed since the last step, from a time by a step size to the next time.
    fn step(&mut self, inputs: &[f64], changed: bool, times: [f64; 3]) -> Result<StepResult>;

    /// Ends the simulation.
    fn terminate(&self) -> Result<()>;
}

/// An instance of an FMU.
pub struct FmuSimulator<'a> {
    instance: &'a FmuInstance<'a>,
    /// Integration by model exchange, after the initialization.
    integration: Option<Exchange<'a>>,
    inputs: Vec<&'a ScalarVariable>,
    outputs: Recorder<'a>,
    /// Tolerance of model exchange.
    tolerance: Option<f64>,
}

impl<'a> FmuSimulator<'a> {
    pub fn new(
        instance: &'a FmuInstance<'a>,
        inputs: &[&str],
        outputs: &[String],
        tolerance: Option<f64>,
    ) -> Result<Self> {
        let inputs = inputs.iter().map(|name| find(instance, name)).collect::<Result<_>>()?;
        Ok(Self { instance, integration: None, inputs, outputs: Recorder::new(instance, outputs, true)?, tolerance })
    }
}

impl Simulator for FmuSimulator<'_> {
    fn enter(&mut self, start_values: &[(String, f64)], run: &SystemRun) -> Result<()> {
        start_values.iter().try_for_each(|(name, value)| set_start(self.instance, name, *value))?;
        // the master has found the times to be a run
        let stop = Grid::of_times(run.start, run.stop, run.step).ok().and_then(|grid| grid.stop_time());
        self.instance.enter_initialization_mode(run.start, stop)
    }

    fn set(&mut self, inputs: &[f64]) -> Result<()> {
        set_all(self.instance, &self.inputs, inputs)
    }

    fn read(&self) -> Result<Vec<f64>> {
        self.outputs.row()
    }

    fn watch(&self, variable: &str) -> Result<f64> {
        let values = self.instance.get_numbers(find(self.instance, variable)?)?;
        Ok(values.first().copied().unwrap_or(f64::NAN))
    }

    fn begin(&mut self, run: &SystemRun) -> Result<StepResult> {
        self.instance.exit_initialization_mode()?;
        if self.instance.fmu().interface() == InterfaceKind::CoSimulation {
            return Ok(StepResult::Done);
        }
        let (integration, begun) = Exchange::start(self.instance, &NO_INPUTS, self.tolerance, run.start)?;
        self.integration = Some(integration);
        Ok(begun)
    }

    fn step(&mut self, inputs: &[f64], changed: bool, [time, size, end]: [f64; 3]) -> Result<StepResult> {
        let (instance, variables) = (self.instance, &self.inputs);
        let Some(integration) = &mut self.integration else {
            set_all(instance, variables, inputs)?;
            return instance.do_step(time, size);
        };
        if changed {
            // inputs that jump are an event
            let handled = integration.interrupt(|| set_all(instance, variables, inputs))?;
            if handled != StepResult::Done {
                return Ok(handled);
            }
        }
        integration.advance(end)
    }

    fn terminate(&self) -> Result<()> {
        self.instance.terminate()
    }
}

/// Sets variables, those of double precision by one call.
fn set_all(instance: &FmuInstance, variables: &[&ScalarVariable], values: &[f64]) -> Result<()> {
    let (mut references, mut reals) = (Vec::with_capacity(values.len()), Vec::with_capacity(values.len()));
    for (variable, &value) in variables.iter().zip(values) {
        if matches!(variable.kind, VariableType::Real(RealAttributes { single: false, .. })) {
            references.push(variable.value_reference);
            reals.push(value);
        } else {
            instance.set_numbers(variable, &[value])?;
        }
    }
    if references.is_empty() { Ok(()) } else { instance.set_real(&references, &reals) }
}

fn find<'a>(instance: &FmuInstance<'a>, name: &str) -> Result<&'a ScalarVariable> {
    let variable = instance.fmu().description().variable(name);
    variable.ok_or_else(|| Error::Variable { name: name.into(), problem: "is not a variable of the FMU".into() })
}

/// A mechanism that our integrator solves.
pub struct MechanismSimulator<'a> {
    mechanism: &'a Mechanism,
    /// From the initialization on.
    stepper: Option<Stepper>,
    /// Values of all inputs of the mechanism.
    given: Vec<f64>,
    /// Positions of the connected inputs among them.
    inputs: Vec<usize>,
    /// Positions of the outputs among all of the mechanism.
    outputs: Vec<usize>,
    tolerance: Option<f64>,
}

impl<'a> MechanismSimulator<'a> {
    pub fn new(mechanism: &'a Mechanism, inputs: &[&str], outputs: &[String], tolerance: Option<f64>) -> Self {
        let positions =
            outputs.iter().filter_map(|name| mechanism.outputs().iter().position(|output| output.name == *name));
        Self {
            mechanism,
            stepper: None,
            given: mechanism.inputs().values().map(|input| input.start).collect(),
            inputs: inputs.iter().filter_map(|name| mechanism.inputs().get_index_of(*name)).collect(),
            outputs: positions.collect(),
            tolerance,
        }
    }

    fn stepper(&mut self) -> Result<&mut Stepper> {
        self.stepper.as_mut().ok_or_else(|| Error::Worker { message: "it is not initialized".into() })
    }
}

impl Simulator for MechanismSimulator<'_> {
    fn enter(&mut self, start_values: &[(String, f64)], run: &SystemRun) -> Result<()> {
        let parameters = self.mechanism.parameters().iter();
        let values: Vec<f64> =
            parameters.map(|(name, parameter)| start_value(start_values, name).unwrap_or(parameter.default)).collect();
        for (given, name) in self.given.iter_mut().zip(self.mechanism.inputs().keys()) {
            *given = start_value(start_values, name).unwrap_or(*given);
        }
        let tolerance = self.tolerance.unwrap_or(TOLERANCE);
        let stepper = self.mechanism.stepper(&values, &self.given, run.start, tolerance).map_err(failed)?;
        self.stepper = Some(stepper);
        Ok(())
    }

    fn set(&mut self, inputs: &[f64]) -> Result<()> {
        for (&input, value) in self.inputs.iter().zip(inputs) {
            self.given[input] = *value;
        }
        let given = std::mem::take(&mut self.given);
        let set = self.stepper().and_then(|stepper| stepper.set_inputs(&given).map_err(failed));
        self.given = given;
        set
    }

    fn read(&self) -> Result<Vec<f64>> {
        let all = self.stepper.as_ref().map(Stepper::outputs).unwrap_or_default();
        Ok(self.outputs.iter().map(|&output| all.get(output).copied().unwrap_or(f64::NAN)).collect())
    }

    fn watch(&self, variable: &str) -> Result<f64> {
        Err(Error::Variable { name: variable.into(), problem: "is not an output of the mechanism".into() })
    }

    fn begin(&mut self, _: &SystemRun) -> Result<StepResult> {
        Ok(StepResult::Done)
    }

    fn step(&mut self, inputs: &[f64], changed: bool, [_, _, end]: [f64; 3]) -> Result<StepResult> {
        if changed {
            self.set(inputs)?;
        }
        self.stepper()?.advance(end).map_err(failed)?;
        Ok(StepResult::Done)
    }

    fn terminate(&self) -> Result<()> {
        Ok(())
    }
}

/// The start value of a name.
fn start_value(start_values: &[(String, f64)], name: &str) -> Option<f64> {
    start_values.iter().find(|(known, _)| known == name).map(|(_, value)| *value)
}

fn failed(error: MotionError) -> Error {
    Error::Worker { message: error.message }
}
