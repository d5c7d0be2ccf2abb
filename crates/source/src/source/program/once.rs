//! A program that is started for each run, with values in its arguments, and writes a CSV file.

use super::{ProgramRuns, columns, names, reply};
use crate::{
    Error, Result,
    diagnostics::Problems,
    process::ReplyStatus,
    source::{
        FailureCause, RunFailure,
        launch::{WorkerProcess, WorkerReply},
    },
    study::{RESULT, Study},
};
use std::{fmt::Write, io, path::Path, sync::atomic::AtomicBool, time::Duration};
use tempfile::TempDir;

/// Placeholder for the file with the inputs at each row.
const INPUTS: &str = "{inputs}";

/// Placeholders beside those of parameters and constants.
const BUILT_IN: [&str; 4] = ["result", "inputs", "stop", "step"];

/// Every parameter and constant that no argument has, and every name that means something else.
pub(super) fn problems(study: &Study, arguments: &[String]) -> Problems {
    let mut problems = Problems::default();
    let parameters = study.parameters.keys().map(|name| (format!("parameters.{name}"), name));
    let constants = study.source.constants.keys().map(|name| (format!("source.constants.{name}"), name));
    for (key, name) in parameters.chain(constants) {
        if BUILT_IN.contains(&name.as_str()) {
            problems.add(key, format!("`{{{name}}}` has another meaning in source.command: choose another name"));
        } else if !is_used(arguments, &format!("{{{name}}}")) {
            problems.add(key, format!("has no effect: expected `{{{name}}}` in an argument of source.command"));
        }
    }
    if !study.inputs.is_empty() && !is_used(arguments, INPUTS) {
        let message =
            "the inputs have no effect, expected `{inputs}` in an argument: a CSV file with a row for each time";
        problems.add("source.command", message);
    }
    problems
}

/// Returns true if an argument has a placeholder.
fn is_used(arguments: &[String], placeholder: &str) -> bool {
    arguments.iter().any(|argument| argument.contains(placeholder))
}

/// Runs of such a program, one after the other.
pub(super) struct OneShot {
    runs: ProgramRuns,
    /// Folder in which the program reads and writes files.
    folder: TempDir,
}

impl OneShot {
    pub(super) fn new(runs: &ProgramRuns) -> Result<Self> {
        let folder = TempDir::with_prefix("metafmu-").map_err(Error::io(&std::env::temp_dir(), "write to"))?;
        Ok(Self { runs: runs.clone(), folder })
    }

    /// The arguments with values in place of placeholders.
    fn arguments(&self, values: &[f64], result: &Path) -> io::Result<Vec<String>> {
        let (parameters, signals) = self.runs.parameters(values);
        let inputs = self.folder.path().join("inputs.csv");
        let time = &self.runs.study.time;
        let mut placeholders: Vec<(String, String)> = vec![
            (RESULT.into(), result.display().to_string()),
            ("{stop}".into(), format!("{:?}", self.runs.times.last().copied().unwrap_or_default())),
            ("{step}".into(), format!("{:?}", time.step)),
        ];
        if !self.runs.study.inputs.is_empty() {
            std::fs::write(&inputs, self.table_of_inputs(signals))?;
            placeholders.push((INPUTS.into(), inputs.display().to_string()));
        }
        placeholders.extend(parameters.iter().map(|(name, value)| (format!("{{{name}}}"), format!("{value:?}"))));
        Ok(self
            .runs
            .command
            .arguments
            .iter()
            .map(|argument| {
                placeholders
                    .iter()
                    .fold(argument.clone(), |text, (placeholder, value)| text.replace(placeholder.as_str(), value))
            })
            .collect())
    }

    fn table_of_inputs(&self, signals: &[f64]) -> String {
        let columns = columns(names(&self.runs.study.inputs), signals);
        let mut text = String::from("time");
        columns.keys().for_each(|name| text.extend([",", &crate::table::header_field(name)]));
        text.push('\n');
        for (row, time) in self.runs.times.iter().enumerate() {
            // writing to a string does not fail
            let _ = write!(text, "{time:?}");
            for value in columns.values().filter_map(|column| column.get(row)) {
                let _ = write!(text, ",{value:?}");
            }
            text.push('\n');
        }
        text
    }
}

impl WorkerProcess for OneShot {
    fn run(&mut self, values: &[f64], limit: Duration, stop: &AtomicBool) -> WorkerReply {
        let result = self.folder.path().join("result.csv");
        // that of the run before must not count
        let _ = std::fs::remove_file(&result);
        let arguments = match self.arguments(values, &result) {
            Ok(arguments) => arguments,
            Err(error) => return process_failed(error.to_string()),
        };
        let mut process = match self.runs.command.spawn(&arguments, discard) {
            Ok(process) => process,
            Err(error) => return process_failed(error.to_string()),
        };
        process.close();
        match process.end(limit, stop) {
            ReplyStatus::Died(end) if end.is_success && result.exists() => {}
            ReplyStatus::Died(end) if end.is_success => {
                return process_failed(format!("{}, but did not write {RESULT}", end.message));
            }
            ReplyStatus::Died(end) => return process_failed(end.message),
            ReplyStatus::TimedOut => return WorkerReply::TimedOut,
            ReplyStatus::Stopped | ReplyStatus::Reply(()) => return WorkerReply::Stopped,
        }
        match reply::rows_of(&result, &self.runs.study, &self.runs.times) {
            Ok(values) => WorkerReply::Done(values),
            Err(error) => {
                let message = without_folder(error).to_string();
                WorkerReply::Failed(RunFailure::new(FailureCause::Model, message))
            }
        }
    }

    fn finish(self: Box<Self>) {}
}

/// Reads what a program prints, and keeps nothing of it.
fn discard(output: &mut crate::process::ReplyStream) -> Option<()> {
    let _ = io::copy(output, &mut io::sink());
    None
}

fn process_failed(message: String) -> WorkerReply {
    WorkerReply::Failed(RunFailure::new(FailureCause::Process, message))
}

/// Error of the result's file with the placeholder as its path: each process has another folder.
fn without_folder(error: Error) -> Error {
    let path = RESULT.into();
    match error {
        Error::Io { action, source, .. } => Error::Io { path, action, source },
        Error::Table { place, message, .. } => Error::Table { path, place, message },
        Error::OtherFile { message, .. } => Error::OtherFile { path, message },
        error => error,
    }
}
