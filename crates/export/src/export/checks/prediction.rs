//! Compares an FMU with the surrogate inside it.

use crate::{
    Result,
    export::MODEL_FILE,
    fmi::{
        Fmu, FmuInstance, InterfaceKind,
        host::Grid,
        validate::{
            Area, Notes,
            run::{ValidationRun, experiment},
        },
    },
};
use metafmu_runtime::{CommunicationStep, Drive, Evaluator, Input, Role, Surrogate, Tunability};

/// Largest difference between the FMU and the surrogate, relative to the nominal value of the output.
const TOLERANCE: f64 = 1e-12;
/// Steps of a run of an FMU with states.
const STEPS_OF_MOTION: usize = 100;
/// Largest difference of a state after a step of co-simulation, relative to its nominal value.
const STATE_TOLERANCE: f64 = 1e-9;
/// Largest number of parameters for which every corner of the ranges is tried.
const MAX_CORNER_PARAMETERS: u32 = 6;

/// Reports what of the surrogate is wrong, and where the FMU computes something else.
pub fn check(fmu: &Fmu, surrogate: &Surrogate, report: &mut Notes) {
    identity(fmu, surrogate, report);
    let Some(oracle) = Oracle::new(fmu, surrogate, report) else { return };
    let mut errors = Vec::new();
    for point in points(surrogate, report) {
        report.doing("a run with changed parameters");
        if let Err(error) = oracle.compare(&point, report) {
            let inputs = surrogate.inputs().iter().zip(&point).filter(|(input, _)| input.role != Role::Time);
            let at: Vec<String> = inputs.map(|(input, value)| format!("{} = {value}", input.name)).collect();
            errors.push((error.to_string(), at.join(", ")));
        }
    }
    // where the first of those alike is
    errors.dedup_by(|one, other| one.0 == other.0);
    for (error, at) in errors {
        report.problem(Area::Behavior, format!("{error}, in a run with {at}"));
    }
}

fn identity(fmu: &Fmu, surrogate: &Surrogate, report: &mut Notes) {
    let (found, expected) = (&fmu.description().token, surrogate.instantiation_token());
    if *found != expected {
        let message = format!("the token in modelDescription.xml is {found}, expected {expected} as in `{MODEL_FILE}`");
        report.problem(Area::Surrogate, message);
    }
}

/// Values of the input columns at which to compare: the start values, then the corners of the parameter ranges.
fn points(surrogate: &Surrogate, report: &mut Notes) -> Vec<Vec<f64>> {
    let inputs = surrogate.inputs();
    // an input that is at the end of its range for long drives a motion out of the domain
    let has_memory = surrogate.program().has_memory();
    let mut parameters: Vec<usize> = (0..inputs.len())
        .filter(|&column| match inputs[column].role {
            Role::Time => false,
            Role::Input => !has_memory,
            Role::Parameter(_) | Role::Start => true,
        })
        .collect();
    if parameters.len() > MAX_CORNER_PARAMETERS as usize {
        report.skipped(format!("corners of the parameter ranges beyond those of {MAX_CORNER_PARAMETERS} parameters"));
        parameters.truncate(MAX_CORNER_PARAMETERS as usize);
    }
    let start: Vec<f64> = inputs.iter().map(|input| input.start).collect();
    let corners: Vec<_> = (0..1 << parameters.len())
        .map(|corner| {
            let mut point = start.clone();
            for (bit, &column) in parameters.iter().enumerate() {
                let Input { min, max, .. } = inputs[column];
                point[column] = if corner >> bit & 1 == 0 { min } else { max };
            }
            point
        })
        .collect();
    [vec![start.clone()], corners].concat()
}

/// The surrogate's own prediction, and where its columns are in the FMU.
struct Oracle<'a> {
    fmu: &'a Fmu,
    surrogate: &'a Surrogate,
    evaluator: Evaluator,
    experiment: Grid,
    /// Value references of the input columns; that of the time is not used.
    inputs: Vec<u32>,
    outputs: Vec<u32>,
    states: Vec<u32>,
    /// Largest difference of each output.
    tolerances: Vec<f64>,
}

impl<'a> Oracle<'a> {
    fn new(fmu: &'a Fmu, surrogate: &'a Surrogate, report: &mut Notes) -> Option<Self> {
        let description = fmu.description();
        let inputs: Vec<&str> = surrogate.inputs().iter().map(|input| input.name.as_str()).collect();
        let outputs: Vec<&str> = surrogate.outputs().iter().map(|output| output.name.as_str()).collect();
        // all of them, so that every one that is missing is reported
        let states: Vec<&str> = surrogate.states().iter().map(|state| state.name.as_str()).collect();
        let references: Vec<Option<u32>> = inputs
            .iter()
            .chain(&outputs)
            .chain(&states)
            .map(|name| {
                let variable = description.variable(name).filter(|variable| variable.kind.as_real().is_some());
                if variable.is_none() {
                    report.problem(Area::Surrogate, format!("modelDescription.xml has no real variable \"{name}\""));
                }
                variable.map(|variable| variable.value_reference)
            })
            .collect();
        let references: Vec<u32> = references.into_iter().collect::<Option<_>>()?;
        Some(Self {
            fmu,
            surrogate,
            evaluator: Evaluator::new(surrogate),
            // what of it cannot be run has been reported
            experiment: {
                let mut experiment = experiment(fmu, &mut Notes(&mut drop))?;
                if surrogate.program().has_memory() && experiment.steps() > STEPS_OF_MOTION {
                    experiment.shorten(STEPS_OF_MOTION);
                }
                experiment
            },
            inputs: references[..inputs.len()].to_vec(),
            outputs: references[inputs.len()..][..outputs.len()].to_vec(),
            states: references[inputs.len() + outputs.len()..].to_vec(),
            tolerances: outputs
                .iter()
                .map(|name| {
                    let nominal = description.variable(name).and_then(|variable| variable.kind.as_real()?.nominal);
                    TOLERANCE * nominal.unwrap_or(1.0)
                })
                .collect(),
        })
    }

    /// Runs with the parameters of a point: at the start, at every communication point, after a change of the tunable
    /// parameters, and after a step of another size.
    fn compare(&self, point: &[f64], report: &mut Notes) -> Result<()> {
        let Self { experiment, surrogate, .. } = self;
        let mut values = point.to_vec();
        values.resize(self.evaluator.columns(), 0.0);
        let mut comparison = PredictionComparison { oracle: self, evaluator: self.evaluator.clone(), point: values };
        let instance = self.fmu.instantiate("comparison", true)?;
        comparison.set(&instance, point, |_| true)?;
        instance.enter_initialization_mode(experiment.time(0), None)?;
        if !comparison.holds(&instance, experiment.time(0), "in Initialization Mode", report)? {
            return Ok(());
        }
        let instance = self.fmu.instantiate("comparison", true)?;
        let mut run =
            ValidationRun::start(&instance, experiment, |instance| comparison.set(instance, point, |_| true))?;
        if !comparison.holds(&instance, experiment.time(0), "at the start", report)? {
            return Ok(());
        }
        for step in 0..experiment.steps() {
            run.step(step)?;
            if !comparison.advances(&instance, experiment.size(step), report)? {
                return Ok(());
            }
            // one report a run is enough: the rest would be wrong as well
            if !comparison.holds(&instance, experiment.time(step + 1), "after a step", report)? {
                return Ok(());
            }
        }
        let now = experiment.time(experiment.steps());
        if self.fmu.interface() == InterfaceKind::ModelExchange {
            instance.enter_event_mode()?;
        }
        if surrogate.program().has_memory() {
            return Ok(());
        }
        let starts: Vec<f64> = surrogate.inputs().iter().map(|input| input.start).collect();
        comparison.set(&instance, &starts, |input| {
            matches!(input.role, Role::Parameter(Tunability::Tunable) | Role::Input)
        })?;
        comparison.holds(&instance, now, "after a change of tunable parameters and inputs", report)?;
        Ok(())
    }
}

struct PredictionComparison<'a> {
    oracle: &'a Oracle<'a>,
    evaluator: Evaluator,
    /// Values of the input columns now.
    point: Vec<f64>,
}

impl PredictionComparison<'_> {
    /// Sets those parameters that `which` wants.
    fn set(&mut self, instance: &FmuInstance, values: &[f64], which: impl Fn(&Input) -> bool) -> Result<()> {
        for (column, input) in self.oracle.surrogate.inputs().iter().enumerate() {
            if input.role != Role::Time && which(input) {
                instance.set_real(&[self.oracle.inputs[column]], &[values[column]])?;
                self.point[column] = values[column];
            }
        }
        // until the first step
        self.evaluator.start(&mut self.point);
        Ok(())
    }

    /// Advances the states as the FMU has done in a step, and compares; reports and returns false if they differ. A solver around the
    /// FMU is not repeated: the states are its.
    fn advances(&mut self, instance: &FmuInstance, size: f64, report: &mut Notes) -> Result<bool> {
        let Oracle { fmu, surrogate, states, .. } = self.oracle;
        let mut found = vec![0.0; states.len()];
        instance.get_real(states, &mut found)?;
        let first = surrogate.inputs().len();
        if fmu.interface() == InterfaceKind::CoSimulation {
            let constant = vec![0.0; self.point.len()];
            let drive = Drive { rates: [&constant, &constant], clamp: None };
            let step = self.evaluator.advance(&mut self.point, CommunicationStep::of(size), drive);
            for (index, state) in surrogate.states().iter().enumerate() {
                let (found, expected) = (found[index], self.point[first + index]);
                let scale = STATE_TOLERANCE * (state.nominal + expected.abs());
                // written so that NaN is wrong
                let right = (found - expected).abs() <= scale;
                if step.is_err() || !right {
                    let message = format!("state \"{}\" is {found} after a step, expected {expected}", state.name);
                    report.problem(Area::Behavior, message);
                    return Ok(false);
                }
            }
        }
        self.point[first..][..found.len()].copy_from_slice(&found);
        Ok(true)
    }

    /// Compares the outputs now; reports and returns false if they are not those predicted.
    fn holds(&mut self, instance: &FmuInstance, time: f64, when: &str, report: &mut Notes) -> Result<bool> {
        let Oracle { surrogate, outputs, tolerances, .. } = self.oracle;
        if let Some(column) = surrogate.time_column() {
            self.point[column] = time;
        }
        let (mut found, mut expected) = (vec![0.0; outputs.len()], vec![0.0; self.evaluator.results()]);
        instance.get_real(outputs, &mut found)?;
        self.evaluator.evaluate(&self.point, &mut expected);
        for (index, tolerance) in tolerances.iter().enumerate() {
            let (found, expected) = (found[index], expected[index]);
            // written so that it does not hold for NaN
            if (found - expected).abs() <= *tolerance {
                continue;
            }
            let inputs = surrogate.inputs().iter().zip(&self.point);
            let at: Vec<String> = inputs.map(|(input, value)| format!("{} = {value}", input.name)).collect();
            let (name, at) = (&surrogate.outputs()[index].name, at.join(", "));
            let message = format!("{when}, \"{name}\" is {found}, but the surrogate predicts {expected} at {at}");
            report.problem(Area::Behavior, message);
            return Ok(false);
        }
        Ok(true)
    }
}
