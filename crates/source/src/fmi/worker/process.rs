//! A worker as the process that started it sees it.

use super::{ARGUMENT, FOLDER, Job};
use crate::{
    Error, Result,
    process::{ChildProcess, ReplyStatus, ReplyStream},
    unpacking::Patience,
};
use serde::{Serialize, de::DeserializeOwned};
use std::{
    io::{self, BufRead, Read},
    path::Path,
    process::Command,
    sync::atomic::AtomicBool,
    time::Duration,
};

/// Settings of worker processes.
#[derive(Clone, Copy, Debug)]
pub struct Workers<'a> {
    /// The program that is started with [`ARGUMENT`]: `metafmu`, or another one that calls [`serve`](super::serve) in
    /// that case.
    pub program: &'a Path,
    /// Ends them when it turns true.
    pub stop: &'a AtomicBool,
}

/// Watch over an FMU that runs in a separate process.
#[derive(Clone, Copy, Debug)]
pub struct Watch<'a> {
    /// Settings of its process.
    pub workers: Workers<'a>,
    /// Time limit.
    pub limit: Option<Duration>,
    /// Receives each line that it prints.
    pub heard: fn(&str),
}

impl<'a> Watch<'a> {
    /// Limit of the unpacking of the FMU.
    pub fn patience(self) -> Patience<'a> {
        let of_unpacking = Patience::default();
        let (limit, option) =
            self.limit.map_or((of_unpacking.limit, of_unpacking.option), |limit| (limit, "--time-limit"));
        Patience { limit, option, stop: Some(self.workers.stop) }
    }
}

/// A running worker for an FMU, with replies of a type and numbers; killed when dropped.
#[derive(Debug)]
pub struct Worker<R>(ChildProcess<(R, Vec<f64>)>);

impl<R: DeserializeOwned + Send + 'static> Worker<R> {
    /// Starts `program` for the FMU at `path` that is unpacked into a folder; `heard` takes each line that it prints.
    ///
    /// # Errors
    /// [`Error::Io`] with the system's reason.
    pub fn start(program: &Path, path: &Path, folder: &Path, job: &Job, heard: fn(&str)) -> Result<Self> {
        const DOING: &str = "start a process for";
        if std::env::var_os(FOLDER).is_some() {
            let other = "a worker cannot start another: does the program call `worker::serve`?";
            return Err(Error::io(path, DOING)(io::Error::other(other)));
        }
        let mut command = Command::new(program);
        command.arg(ARGUMENT).env(FOLDER, folder);
        let name = "the FMU ended its process";
        let worker = Self(ChildProcess::start(command, name, read_reply, heard).map_err(Error::io(path, DOING))?);
        worker.ask(job);
        Ok(worker)
    }

    /// Sends a request.
    pub fn ask(&self, request: &impl Serialize) {
        self.0.ask(request);
    }

    /// Waits for the next reply.
    pub fn reply(&mut self, limit: Option<Duration>, stop: &AtomicBool) -> ReplyStatus<(R, Vec<f64>)> {
        self.0.reply(limit, stop)
    }

    /// Resident memory of the process, in bytes, if the system tells it.
    pub fn memory(&self) -> Option<u64> {
        self.0.memory()
    }

    /// After the last reply: reads its remaining output.
    pub fn finish(self) {
        self.0.finish();
    }
}

/// The next reply; none at the end, or if it makes no sense.
fn read_reply<R: DeserializeOwned>(output: &mut ReplyStream) -> Option<(R, Vec<f64>)> {
    let mut line = Vec::new();
    output.read_until(b'\n', &mut line).ok().filter(|count| *count > 0)?;
    let (reply, count) = serde_json::from_slice::<(R, usize)>(&line).ok()?;
    let mut numbers = Vec::new();
    for _ in 0..count {
        let mut bytes = [0; 8];
        output.read_exact(&mut bytes).ok()?;
        numbers.push(f64::from_le_bytes(bytes));
    }
    Some((reply, numbers))
}
