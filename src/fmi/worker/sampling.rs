//! Runs of an FMU with changing parameters, for a sampling.

use super::Replies;
use crate::{
    Result,
    fmi::host::{Fmu, Inputs, InterfaceKind, SimulationOptions, simulate},
};
use serde::{Deserialize, Serialize};
use std::{
    path::{Path, PathBuf},
    sync::mpsc::Receiver,
};

/// What a run of an FMU is.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Task {
    /// The FMU, for messages.
    pub path: PathBuf,
    /// How it is run.
    pub interface: InterfaceKind,
    /// End of a run.
    pub stop: f64,
    /// Communication step size.
    pub step: f64,
    /// Tolerance of model exchange.
    pub tolerance: Option<f64>,
    /// Communication steps from one row to the next.
    pub steps_per_row: usize,
    /// What is set: the parameters, whose values come with each run, then the constants. Inputs are set at every step.
    pub variables: Vec<String>,
    /// Which of them are inputs.
    pub is_input: Vec<bool>,
    /// Values of the constants.
    pub constants: Vec<f64>,
    /// Variables that are recorded.
    pub recorded: Vec<String>,
    /// The outputs: names of variables or of elements of arrays.
    pub outputs: Vec<String>,
}

/// What became of a request.
#[derive(Debug, Serialize, Deserialize)]
pub enum Reply {
    /// The FMU is loaded.
    Ready,
    /// The run is done: its outputs, row by row.
    Done,
    /// The FMU cannot be loaded, or the run failed.
    Failed(String),
}

/// Loads the FMU, then runs it with the values of each request.
pub(super) fn serve(task: &Task, folder: &Path, requests: Receiver<String>, mut replies: Replies) -> Result<()> {
    let fmu = match Fmu::open_unpacked(&task.path, folder, task.interface) {
        Ok(fmu) => fmu,
        Err(error) => return replies.send(&Reply::Failed(error.to_string()), &[]),
    };
    replies.send(&Reply::Ready, &[])?;
    for line in requests {
        let values: Vec<f64> = serde_json::from_str(&line).map_err(|error| super::stream(error.into()))?;
        match run(&fmu, task, values) {
            Ok(outputs) => replies.send(&Reply::Done, &outputs)?,
            Err(message) => replies.send(&Reply::Failed(message), &[])?,
        }
    }
    Ok(())
}

/// One run in an instance of its own: what an FMU forgets to reset cannot get from one run into the next.
fn run(fmu: &Fmu, task: &Task, mut values: Vec<f64>) -> std::result::Result<Vec<f64>, String> {
    values.extend_from_slice(&task.constants);
    let set = || task.variables.iter().cloned().zip(values.iter().copied()).zip(&task.is_input);
    let (names, row) = set().filter_map(|(setting, is_input)| is_input.then_some(setting)).unzip();
    let options = SimulationOptions {
        start: Some(0.0),
        stop: Some(task.stop),
        step: Some(task.step),
        tolerance: task.tolerance,
        start_values: set().filter_map(|(setting, is_input)| (!is_input).then_some(setting)).collect(),
        inputs: Inputs { names, times: vec![0.0], rows: vec![row] },
        record: task.recorded.clone(),
        record_only: true,
    };
    let instance = fmu.instantiate("metafmu", false).map_err(|error| error.to_string())?;
    let table = simulate(&instance, &options).map_err(|error| error.to_string())?;
    if table.terminated {
        let end = table.times.last().copied().unwrap_or(0.0);
        return Err(format!("the FMU ended the simulation at {end} s"));
    }
    let position = |name: &String| {
        let found = table.columns.iter().position(|column| column.name == *name);
        found.ok_or_else(|| format!("`{name}` was not recorded"))
    };
    let columns = task.outputs.iter().map(position).collect::<std::result::Result<Vec<_>, _>>()?;
    let mut outputs = Vec::with_capacity(columns.len() * (table.rows.len() / task.steps_per_row + 1));
    for (time, row) in table.times.iter().zip(&table.rows).step_by(task.steps_per_row) {
        for (&column, name) in columns.iter().zip(&task.outputs) {
            if !row[column].is_finite() {
                return Err(format!("output `{name}` is {} at {time} s", row[column]));
            }
            outputs.push(row[column]);
        }
    }
    Ok(outputs)
}
