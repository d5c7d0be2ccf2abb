//! A whole run of one FMU.

use super::{
    Exchange, FmuInstance, Grid, InterfaceKind, Recorder, SimulationOptions, StepResult,
    recorder::{RecordedColumn, find},
};
use crate::{
    Error, Result,
    model_description::{Causality, ScalarVariable, Variability, VariableType},
};

/// Receives the rows of a run as they come: one for each communication point, the start included.
pub trait RowSink {
    /// Receives names and units of the columns before the initialization; time is not among them.
    ///
    /// # Errors
    /// Whatever ends the run.
    fn begin(&mut self, columns: &[RecordedColumn]) -> Result<()>;

    /// Receives the values at a time, one for each column.
    ///
    /// # Errors
    /// Whatever ends the run.
    fn row(&mut self, time: f64, values: &[f64]) -> Result<()>;
}

/// The result of a run: a row for each communication point, the start included.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SimulationTable {
    /// Names and units of the columns; time is not among them.
    pub columns: Vec<RecordedColumn>,
    /// Time of each row.
    pub times: Vec<f64>,
    /// Values of each row, in the order of the columns.
    pub rows: Vec<Vec<f64>>,
    /// `true` if the FMU ended the simulation before its stop time.
    pub terminated: bool,
}

impl RowSink for SimulationTable {
    fn begin(&mut self, columns: &[RecordedColumn]) -> Result<()> {
        self.columns = columns.to_vec();
        Ok(())
    }

    fn row(&mut self, time: f64, values: &[f64]) -> Result<()> {
        self.times.push(time);
        self.rows.push(values.to_vec());
        Ok(())
    }
}

/// Runs an instance as [`simulate_into`] does, and keeps the rows.
///
/// # Errors
/// Those of [`simulate_into`].
pub fn simulate(instance: &FmuInstance, options: &SimulationOptions) -> Result<SimulationTable> {
    let mut table = SimulationTable::default();
    table.terminated = simulate_into(instance, options, &mut table)?;
    Ok(table)
}

/// Runs an instance that was just made or reset, from its initialization to its end, and records the outputs. Returns whether
/// the FMU ended the simulation before its stop time.
///
/// Step `i` begins at `start + i * step`, with no accumulation of rounding; a last partial step reaches `stop`. Inputs
/// are set at the beginning of every step; [`SimulationOptions::inputs_first`] says when outputs are read.
///
/// In model exchange the communication points are where the outputs are evaluated. In between, the continuous states are
/// integrated, and events are handled where they happen: time events, state events, step events, jumps of inputs. The row
/// of an event has the values after it.
///
/// # Errors
/// - [`Error::Experiment`]: the times make no simulation, or need a partial step the FMU cannot do;
/// - [`Error::UnknownVariable`], [`Error::Variable`]: a start value, input or recorded variable that cannot be;
/// - [`Error::Integration`]: model exchange that cannot be integrated, or has no end of events;
/// - [`Error::Fmi`]: the FMU failed;
/// - those of the sink.
pub fn simulate_into(instance: &FmuInstance, options: &SimulationOptions, sink: &mut impl RowSink) -> Result<bool> {
    let fmu = instance.fmu();
    let exchange = fmu.interface() == InterfaceKind::ModelExchange;
    let grid = Grid::new(fmu, options)?;
    let recorder = Recorder::new(instance, &options.record, options.record_only)?;
    let inputs = options.inputs.drive(fmu.description())?;
    sink.begin(&recorder.columns)?;
    for (name, value) in &options.start_values {
        set_start(instance, name, *value)?;
    }
    let start = grid.time(0);
    if !exchange {
        inputs.set_at(instance, start)?;
    }
    instance.enter_initialization_mode(start, grid.stop_time())?;
    if exchange {
        inputs.set_at(instance, start)?;
    }
    instance.exit_initialization_mode()?;

    let (mut terminated, mut integration) = (false, None);
    if exchange {
        let (mut run, begun) = Exchange::start(instance, &inputs, options.tolerance, start)?;
        terminated = begun != StepResult::Done;
        if let (Some(states), false) = (&options.states, terminated) {
            run.set_states(states)?;
        }
        integration = Some(run);
    }
    sink.row(start, &recorder.row()?)?;
    for step in 0..grid.steps() {
        if terminated {
            break;
        }
        let time = grid.time(step + 1);
        let reached = match &mut integration {
            Some(run) => run.advance(time)?,
            None => {
                if step > 0 && !options.inputs_first {
                    inputs.set_at(instance, grid.time(step))?;
                }
                instance.do_step(grid.time(step), grid.size(step))?
            }
        };
        let reached_time = match reached {
            StepResult::Done => {
                if !exchange && options.inputs_first {
                    inputs.set_at(instance, time)?;
                }
                time
            }
            StepResult::Terminated { time } => time,
        };
        terminated = reached != StepResult::Done;
        sink.row(reached_time, &recorder.row()?)?;
    }
    instance.terminate()?;
    Ok(terminated)
}

/// Returns true if a variable can be set before initialization.
pub fn is_settable(variable: &ScalarVariable) -> bool {
    !(variable.variability == Variability::Constant || variable.causality == Causality::Independent)
        && (variable.causality == Causality::Input || variable.kind.has_start())
}

/// Sets a start value before initialization.
pub fn set_start(instance: &FmuInstance, name: &str, value: f64) -> Result<()> {
    let variable = find(instance, name)?;
    if let VariableType::String { .. } = variable.kind {
        let problem = "is a text, which cannot be set to a number".into();
        return Err(Error::Variable { name: name.into(), problem });
    }
    if !is_settable(variable) {
        return Err(Error::Variable { name: name.into(), problem: "has no start value to be set".into() });
    }
    // of an array all elements
    instance.set_numbers(variable, &vec![value; instance.element_count(variable)?])
}
