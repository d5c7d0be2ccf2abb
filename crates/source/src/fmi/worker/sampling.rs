//! Runs of an FMU with changing parameters, for a sampling.

use super::Replies;
use crate::{
    Error, Result,
    fmi::host::{Fmu, Inputs, InterfaceKind, RecordedColumn, SimulationOptions, StateEvaluation, simulate},
};
use serde::{Deserialize, Serialize};
use std::{
    fmt,
    path::{Path, PathBuf},
    sync::mpsc::Receiver,
};

/// Task of a process that samples an FMU.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SamplingTask {
    /// The FMU, for messages.
    pub path: PathBuf,
    /// Interface by which it runs.
    pub interface: InterfaceKind,
    /// End of a run.
    pub stop: f64,
    /// Communication step size.
    pub step: f64,
    /// Tolerance of model exchange.
    pub tolerance: Option<f64>,
    /// Communication steps from one row to the next.
    pub steps_per_row: usize,
    /// Variables that are set: the parameters, whose values come with each run, then the constants. Inputs are set at
    /// every step.
    pub variables: Vec<String>,
    /// `true` for each of them that is an input.
    pub is_input: Vec<bool>,
    /// Values of the constants.
    pub constants: Vec<f64>,
    /// Variables that are recorded.
    pub recorded: Vec<String>,
    /// The outputs: names of variables or of elements of arrays.
    pub outputs: Vec<String>,
    /// Inputs that drive the runs, and initial states, if there are any.
    pub driven: Option<DrivenRuns>,
}

/// Runs that are driven by inputs, with given initial states in model exchange, or the equations in some states.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct DrivenRuns {
    /// Position of each of the study's states in the FMU's state vector; none if runs begin where the initialization ends.
    pub states: Vec<usize>,
    /// Inputs.
    pub inputs: Vec<String>,
    /// `true` if inputs keep the value of a row up to the next one; otherwise they are linear between rows.
    pub held: bool,
    /// `true` if derivatives are requested instead of a run. A request has the parameters, then
    ///
    /// - of a run: the states at its start, then the inputs at each row;
    /// - of derivatives: inputs and states; then those of further points. For each point the reply has derivatives,
    ///   then outputs.
    pub derivatives: bool,
}

/// Reply to a request.
#[derive(Debug, Serialize, Deserialize)]
pub enum SamplingReply {
    /// The FMU is loaded.
    Ready,
    /// The run is done: its outputs, row by row.
    Done,
    /// The FMU cannot be loaded, or the run failed.
    Failed(String),
}

/// Loads the FMU, then runs it with the values of each request.
pub(super) fn serve(
    task: &SamplingTask,
    folder: &Path,
    requests: Receiver<String>,
    mut replies: Replies,
) -> Result<()> {
    let fmu = match Fmu::open_unpacked(&task.path, folder, task.interface) {
        Ok(fmu) => fmu,
        Err(error) => return replies.send(&SamplingReply::Failed(error.to_string()), &[]),
    };
    replies.send(&SamplingReply::Ready, &[])?;
    for line in requests {
        let values: Vec<f64> = serde_json::from_str(&line).map_err(|error| super::stream(error.into()))?;
        let reply = match &task.driven {
            Some(driven) if driven.derivatives => derivatives(&fmu, task, driven, &values),
            _ => run(&fmu, task, values),
        };
        match reply {
            Ok(outputs) => replies.send(&SamplingReply::Done, &outputs)?,
            Err(error) => replies.send(&SamplingReply::Failed(error.to_string()), &[])?,
        }
    }
    Ok(())
}

/// Reason why a request has no numbers.
#[derive(Debug)]
enum SamplingError {
    /// The FMU cannot be instantiated, or its run failed.
    Fmu(Error),
    /// The FMU ended the run early.
    Terminated { time: f64 },
    /// An output of a run is not finite.
    NotFinite { output: String, value: f64, time: f64 },
    /// An output is none of the recorded variables.
    NotRecorded { output: String },
    /// The equations cannot be evaluated at a point.
    Equations {
        states: Vec<f64>,
        inputs: Vec<(String, f64)>,
        /// Failure of the FMU; none if a derivative or output is not finite.
        source: Option<Box<Error>>,
    },
}

impl fmt::Display for SamplingError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Fmu(error) => error.fmt(f),
            Self::Terminated { time } => write!(f, "the FMU ended the simulation at {time} s"),
            Self::NotFinite { output, value, time } => write!(f, "output `{output}` is {value} at {time} s"),
            Self::NotRecorded { output } => write!(f, "`{output}` was not recorded"),
            Self::Equations { states, inputs, source } => {
                let inputs: Vec<String> = inputs.iter().map(|(name, value)| format!("{name} = {value}")).collect();
                write!(f, "in the states {states:?} with {}: ", inputs.join(", "))?;
                match source {
                    Some(error) => error.fmt(f),
                    None => f.write_str("a derivative or output is not finite"),
                }
            }
        }
    }
}

impl std::error::Error for SamplingError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Fmu(error) => Some(error),
            Self::Equations { source, .. } => source.as_ref().map(|error| &**error as _),
            Self::Terminated { .. } | Self::NotFinite { .. } | Self::NotRecorded { .. } => None,
        }
    }
}

/// Makes one run in a separate instance: an FMU that does not reset all of its state cannot affect the next run.
fn run(fmu: &Fmu, task: &SamplingTask, values: Vec<f64>) -> std::result::Result<Vec<f64>, SamplingError> {
    let (values, rest) = values.split_at(task.parameters());
    let Settings { start_values, mut inputs } = task.settings(values);
    let mut states = None;
    if let Some(driven) = &task.driven {
        let (starts, signals) = rest.split_at(driven.states.len());
        states = (!driven.states.is_empty()).then(|| driven.state_vector(starts));
        inputs = driven.inputs(task, inputs, signals);
    }
    let options = SimulationOptions {
        start: Some(0.0),
        stop: Some(task.stop),
        step: Some(task.step),
        tolerance: task.tolerance,
        states,
        start_values,
        inputs,
        inputs_first: true,
        record: task.recorded.clone(),
        record_only: true,
    };
    let instance = fmu.instantiate("metafmu", false).map_err(SamplingError::Fmu)?;
    let table = simulate(&instance, &options).map_err(SamplingError::Fmu)?;
    if table.terminated {
        return Err(SamplingError::Terminated { time: table.times.last().copied().unwrap_or(0.0) });
    }
    let columns = task.columns(&table.columns)?;
    let mut outputs = Vec::with_capacity(columns.len() * (table.rows.len() / task.steps_per_row + 1));
    for (time, row) in table.times.iter().zip(&table.rows).step_by(task.steps_per_row) {
        for (&column, name) in columns.iter().zip(&task.outputs) {
            if !row[column].is_finite() {
                return Err(SamplingError::NotFinite { output: name.clone(), value: row[column], time: *time });
            }
            outputs.push(row[column]);
        }
    }
    Ok(outputs)
}

/// Derivatives of the states and outputs at points, one after the other.
fn derivatives(
    fmu: &Fmu,
    task: &SamplingTask,
    driven: &DrivenRuns,
    values: &[f64],
) -> std::result::Result<Vec<f64>, SamplingError> {
    let (parameters, states) = (task.parameters(), driven.states.len());
    let mut reply = Vec::new();
    for point in values.chunks_exact(parameters + driven.inputs.len() + states) {
        let (settings, rest) = point.split_at(parameters);
        let (inputs, states) = rest.split_at(driven.inputs.len());
        let mut settings = task.settings(settings);
        settings.inputs.names.extend_from_slice(&driven.inputs);
        settings.inputs.rows[0].extend_from_slice(inputs);
        let unusable = |source: Option<Error>| SamplingError::Equations {
            states: states.to_vec(),
            inputs: driven.inputs.iter().cloned().zip(inputs.iter().copied()).collect(),
            source: source.map(Box::new),
        };
        let options = SimulationOptions {
            start: Some(0.0),
            stop: Some(task.stop),
            states: Some(driven.state_vector(states)),
            start_values: settings.start_values,
            inputs: settings.inputs,
            record: task.recorded.clone(),
            record_only: true,
            ..SimulationOptions::default()
        };
        let instance = fmu.instantiate("metafmu", false).map_err(SamplingError::Fmu)?;
        let labels = StateEvaluation::of(&instance, &options).map_err(|error| unusable(Some(error)))?;
        let columns = task.columns(&labels.columns)?;
        let derivatives = driven.states.iter().map(|position| labels.derivatives.get(*position).copied());
        let outputs = columns.into_iter().map(|column| labels.outputs.get(column).copied());
        for value in derivatives.chain(outputs) {
            reply.push(value.filter(|value| value.is_finite()).ok_or_else(|| unusable(None))?);
        }
    }
    Ok(reply)
}

/// Values that are set before a run, and the inputs that are constant.
struct Settings {
    start_values: Vec<(String, f64)>,
    inputs: Inputs,
}

impl SamplingTask {
    /// Number of parameters, whose values come with each run.
    pub fn parameters(&self) -> usize {
        self.variables.len() - self.constants.len()
    }

    fn settings(&self, parameters: &[f64]) -> Settings {
        let values = parameters.iter().chain(&self.constants).copied();
        let set: Vec<_> = self.variables.iter().cloned().zip(values).zip(&self.is_input).collect();
        let of =
            |wanted: bool| set.iter().filter(move |(_, is_input)| **is_input == wanted).map(|(set, _)| set.clone());
        let (names, row) = of(true).unzip();
        Settings { start_values: of(false).collect(), inputs: Inputs { names, times: vec![0.0], rows: vec![row] } }
    }

    /// Position of each output among the columns of a recorder.
    fn columns(&self, recorded: &[RecordedColumn]) -> std::result::Result<Vec<usize>, SamplingError> {
        self.outputs
            .iter()
            .map(|output| {
                let position = recorded.iter().position(|column| column.name == *output);
                position.ok_or_else(|| SamplingError::NotRecorded { output: output.clone() })
            })
            .collect()
    }
}

impl DrivenRuns {
    /// Converts states from the study's order to that of the FMU.
    fn state_vector(&self, states: &[f64]) -> Vec<f64> {
        let mut vector = vec![0.0; states.len()];
        for (position, value) in self.states.iter().zip(states) {
            // each position is that of one state
            if let Some(to) = vector.get_mut(*position) {
                *to = *value;
            }
        }
        vector
    }

    /// Inputs that are constant, and those that change from row to row.
    fn inputs(&self, task: &SamplingTask, constant: Inputs, signals: &[f64]) -> Inputs {
        if self.inputs.is_empty() {
            return constant;
        }
        let Inputs { mut names, rows: fixed, .. } = constant;
        names.extend_from_slice(&self.inputs);
        let row = |signals: &[f64]| [fixed.concat().as_slice(), signals].concat();
        let rows: Vec<Vec<f64>> = signals.chunks_exact(self.inputs.len()).map(row).collect();
        let last = rows.len().saturating_sub(1).max(1) as f64;
        let times: Vec<f64> = (0..rows.len()).map(|row| task.stop * row as f64 / last).collect();
        if !self.held {
            return Inputs { names, times, rows };
        }
        let jumps = (1..rows.len()).map(|row| match task.interface {
            // an event exactly at the communication point
            InterfaceKind::ModelExchange => (row * task.steps_per_row) as f64 * task.step,
            // half a step before the communication point from which on the value counts, whatever rounding makes of that
            InterfaceKind::CoSimulation => times[row] - 0.5 * task.step,
        });
        Inputs {
            names,
            times: times.iter().take(1).copied().chain(jumps.flat_map(|time| [time, time])).collect(),
            rows: rows
                .windows(2)
                .flat_map(|pair| [pair[0].clone(), pair[0].clone()])
                .chain(rows.last().cloned())
                .collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inputs_are_linear_between_rows_or_held_from_row_to_row() {
        let driven = |held: bool| DrivenRuns {
            states: Vec::new(),
            inputs: vec!["u".into(), "v".into()],
            held,
            derivatives: false,
        };
        let task = SamplingTask {
            path: PathBuf::new(),
            interface: InterfaceKind::CoSimulation,
            stop: 2.0,
            step: 0.5,
            tolerance: None,
            steps_per_row: 2,
            variables: Vec::new(),
            is_input: Vec::new(),
            constants: Vec::new(),
            recorded: Vec::new(),
            outputs: Vec::new(),
            driven: None,
        };
        let constant = || Inputs { names: vec!["c".into()], times: vec![0.0], rows: vec![vec![7.0]] };
        let signals = [1.0, 10.0, 2.0, 20.0, 3.0, 30.0];
        let linear = driven(false).inputs(&task, constant(), &signals);
        assert_eq!(linear.names, ["c", "u", "v"]);
        assert_eq!((linear.times, linear.rows[1].as_slice()), (vec![0.0, 1.0, 2.0], &[7.0, 2.0, 20.0][..]));
        // communication points are 0, 0.5, ..., 2
        let held = driven(true).inputs(&task, constant(), &signals);
        assert_eq!(held.times, [0.0, 0.75, 0.75, 1.75, 1.75]);
        let exchange = SamplingTask { interface: InterfaceKind::ModelExchange, ..task };
        let exact = driven(true).inputs(&exchange, constant(), &signals);
        assert_eq!((exact.times, &exact.rows), (vec![0.0, 1.0, 1.0, 2.0, 2.0], &held.rows));
        let of_u: Vec<f64> = held.rows.iter().map(|row| row[1]).collect();
        assert_eq!(of_u, [1.0, 1.0, 2.0, 2.0, 3.0]);
    }
}
