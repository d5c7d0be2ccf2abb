//! A whole run of one FMU.

use super::{Grid, Inputs, Instance, InterfaceKind, Recorder, Step, recorder::Column};
use crate::{
    Error, Result,
    fmu::model_description::{Causality, ScalarVariable, Variability, VariableType},
};

/// What to run. Whatever is not given comes from the FMU's default experiment.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SimulationOptions {
    /// Start time; else the FMU's, else 0.
    pub start: Option<f64>,
    /// Stop time; else the FMU's.
    pub stop: Option<f64>,
    /// Communication step size; else the FMU's, else a 500th of the whole.
    pub step: Option<f64>,
    /// Values that variables start with, by name: 0 or 1 for a boolean.
    pub start_values: Vec<(String, f64)>,
    /// Inputs that change over time.
    pub inputs: Inputs,
    /// Names of further variables to record.
    pub record: Vec<String>,
    /// Whether they are all that is recorded, without the outputs.
    pub record_only: bool,
}

/// The result of a run: a row for each communication point, the start included.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    /// What the columns are; time is not among them.
    pub columns: Vec<Column>,
    /// Time of each row.
    pub times: Vec<f64>,
    /// Values of each row, in the order of the columns.
    pub rows: Vec<Vec<f64>>,
    /// Whether the FMU ended the simulation before its stop time.
    pub terminated: bool,
}

/// Runs an instance that was just made or reset, from its initialization to its end, and records the outputs.
///
/// Step `i` begins at `start + i * step`, with no accumulation of rounding; a last partial step reaches `stop`. Inputs
/// are set at every communication point before the outputs are read there, so that outputs follow inputs without delay.
///
/// In model exchange the communication points are where the outputs are evaluated, and time events in between are
/// handled. Only FMUs without continuous states and event indicators are run: there is no integrator here.
///
/// # Errors
/// - [`Error::Experiment`]: the times make no simulation, or need a partial step the FMU cannot do;
/// - [`Error::UnknownVariable`], [`Error::Variable`]: a start value, input or recorded variable that cannot be;
/// - [`Error::NeedsIntegrator`]: model exchange with states or event indicators;
/// - [`Error::Fmi`]: the FMU failed.
pub fn simulate(instance: &Instance, options: &SimulationOptions) -> Result<Table> {
    let fmu = instance.fmu();
    let exchange = fmu.interface() == InterfaceKind::ModelExchange;
    let (states, indicators) = (fmu.description().state_count(), fmu.description().event_indicators);
    if exchange && (states > 0 || indicators > 0) {
        return Err(Error::NeedsIntegrator { states, indicators });
    }
    let grid = Grid::new(fmu, options)?;
    let recorder = Recorder::new(instance, &options.record, options.record_only)?;
    let driven = options.inputs.variables(fmu.description())?;
    for (name, value) in &options.start_values {
        set_start(instance, name, *value)?;
    }
    let (start, stop) = (grid.time(0), grid.time(grid.steps()));
    let set_inputs = |time: f64| options.inputs.set(instance, &driven, time);
    if !exchange {
        set_inputs(start)?;
    }
    // a stop time that is the start time is refused by some FMUs
    instance.enter_initialization_mode(start, (stop > start).then_some(stop))?;
    if exchange {
        set_inputs(start)?;
    }
    instance.exit_initialization_mode()?;

    let mut table = Table { columns: recorder.columns.clone(), times: Vec::new(), rows: Vec::new(), terminated: false };
    let mut next_event = None;
    if exchange {
        let events = instance.settle_events()?;
        (table.terminated, next_event) = (events.terminate, events.next_event_time);
    }
    table.times.push(start);
    table.rows.push(recorder.row()?);
    for step in 0..grid.steps() {
        if table.terminated {
            break;
        }
        let time = grid.time(step + 1);
        let reached = if exchange {
            exchange_step(instance, time, &mut next_event)?
        } else {
            instance.do_step(grid.time(step), grid.size(step))?
        };
        table.terminated = reached != Step::Done;
        match reached {
            Step::Done => {
                set_inputs(time)?;
                table.times.push(time);
            }
            Step::Terminated { time } => table.times.push(time),
        }
        table.rows.push(recorder.row()?);
    }
    instance.terminate()?;
    Ok(table)
}

/// Goes on to a time in Continuous-Time Mode, through the time events before it.
pub fn exchange_step(instance: &Instance, time: f64, next_event: &mut Option<f64>) -> Result<Step> {
    while let Some(event) = next_event.filter(|event| *event <= time) {
        instance.set_time(event)?;
        instance.enter_event_mode()?;
        let states = instance.settle_events()?;
        if states.terminate {
            return Ok(Step::Terminated { time: event });
        }
        // an event that stays where it was would be handled for ever
        *next_event = states.next_event_time.filter(|next| *next > event);
    }
    instance.set_time(time)?;
    let needed = instance.fmu().description().model_exchange.as_ref();
    if needed.is_some_and(|exchange| exchange.needs_completed_integrator_step) {
        let completed = instance.completed_integrator_step()?;
        if completed.enter_event_mode && !completed.terminate {
            instance.enter_event_mode()?;
            let states = instance.settle_events()?;
            *next_event = states.next_event_time;
            if states.terminate {
                return Ok(Step::Terminated { time });
            }
        }
        if completed.terminate {
            return Ok(Step::Terminated { time });
        }
    }
    Ok(Step::Done)
}

/// Sets a start value before initialization.
pub(super) fn set_start(instance: &Instance, name: &str, value: f64) -> Result<()> {
    let variable = find(instance, name)?;
    let wrong = |problem: &str| Err(Error::Variable { name: name.into(), problem: problem.into() });
    let settable = variable.variability != Variability::Constant
        && (variable.causality == Causality::Input || variable.kind.has_start());
    if let VariableType::String { .. } = variable.kind {
        return wrong("is a text, which cannot be set to a number");
    }
    if !settable || variable.causality == Causality::Independent {
        return wrong("has no start value to be set");
    }
    // of an array all elements
    instance.set_numbers(variable, &vec![value; instance.element_count(variable)?])
}

pub(super) fn find<'a>(instance: &Instance<'a>, name: &str) -> Result<&'a ScalarVariable> {
    let description = instance.fmu().description();
    description.variable(name).ok_or_else(|| Error::UnknownVariable {
        name: name.into(),
        known: description.variables.iter().map(|variable| variable.name.clone()).collect(),
    })
}
