//! The process that runs an FMU for another one: what crashes or hangs here costs one run.
//!
//! Standard input has a line of JSON with the [`Setup`], then one with the values of each run. Standard output has a line of
//! JSON for each of them, a [`Reply`]; after [`Reply::Done`] follow the run's outputs, row by row, as little-endian doubles.
//! At the end of standard input the process ends, whatever the FMU is doing.

use crate::{
    Error, Result,
    fmu::host::{
        Fmu, Inputs, InterfaceKind, SimulationOptions,
        process::{Pipes, exit_now},
        simulate,
    },
};
use serde::{Deserialize, Serialize};
use std::{
    fs::File,
    io::{BufRead, BufReader, Write},
    path::{Path, PathBuf},
    sync::mpsc,
};

/// The argument that makes `metafmu` such a process.
pub const ARGUMENT: &str = "fmu-worker";

/// What to run.
#[derive(Debug, Serialize, Deserialize)]
pub struct Setup<'a> {
    /// Where the FMU is unpacked.
    pub folder: PathBuf,
    /// The rest, which is the same for every sampling.
    pub task: std::borrow::Cow<'a, Task>,
}

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
    /// The run is done; so many numbers follow.
    Done(usize),
    /// The FMU cannot be loaded, or the run failed.
    Failed(String),
}

/// Runs an FMU for the process that started this one; returns if there is none that asks for anything.
///
/// # Errors
/// [`Error::Io`] if the streams cannot be used.
pub fn serve() -> Result<()> {
    let stream = |source| Error::io(Path::new("standard input and output"), "use")(source);
    let Pipes { requests, mut replies } = Pipes::take().map_err(stream)?;
    let mut lines = BufReader::new(requests).lines();
    let Some(first) = lines.next() else { return Ok(()) };
    let setup: Setup = serde_json::from_str(&first.map_err(stream)?).map_err(|error| stream(error.into()))?;
    let Setup { folder, task } = setup;

    let (send, receive) = mpsc::channel();
    let unpacked = folder.clone();
    std::thread::spawn(move || {
        for line in lines.map_while(std::io::Result::ok) {
            // the receiver lives as long as the process
            let _ = send.send(line);
        }
        // nobody else does it if the other process was killed
        let _ = std::fs::remove_dir_all(unpacked);
        exit_now();
    });
    let fmu = match Fmu::open_unpacked(&task.path, &folder, task.interface) {
        Ok(fmu) => fmu,
        Err(error) => return reply(&mut replies, &Reply::Failed(error.to_string()), &[]).map_err(stream),
    };
    reply(&mut replies, &Reply::Ready, &[]).map_err(stream)?;
    for line in receive {
        let values: Vec<f64> = serde_json::from_str(&line).map_err(|error| stream(error.into()))?;
        match run(&fmu, &task, values) {
            Ok(outputs) => reply(&mut replies, &Reply::Done(outputs.len()), &outputs),
            Err(message) => reply(&mut replies, &Reply::Failed(message), &[]),
        }
        .map_err(stream)?;
    }
    Ok(())
}

fn reply(replies: &mut File, reply: &Reply, outputs: &[f64]) -> std::io::Result<()> {
    let mut bytes = serde_json::to_vec(reply)?;
    bytes.push(b'\n');
    bytes.extend(outputs.iter().flat_map(|value| value.to_le_bytes()));
    replies.write_all(&bytes)
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
