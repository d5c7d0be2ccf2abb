//! Processes that run FMUs: a crash, a hang or output there does not affect the program that started them.
//!
//! Each is the program itself, started again with [`ARGUMENT`], so a program that uses this must call [`serve`] in that
//! case. Standard input has a line of JSON with the [`Job`], then requests. Standard output has replies: a line of JSON
//! with a message and a count, then this number of little-endian doubles. At the end of standard input the process
//! removes the folder of the FMU and ends, even during a call of the FMU.

mod process;
pub mod sampling;
mod simulation;
mod system;
mod validation;

pub use process::{Watch, Worker, Workers};
pub use simulation::simulate_apart;
pub use system::run_system_apart;
pub use validation::validate_apart;

use super::{
    host::{
        process::{Pipes, exit_now},
        unpacked,
    },
    system::run::SystemRun,
    validate::Checks,
};
use crate::{Error, Result};
use serde::{Deserialize, Serialize};
use std::{
    borrow::Cow,
    fs::File,
    io::{BufRead, BufReader, Write},
    path::{Path, PathBuf},
    sync::mpsc,
};

/// Argument that makes `metafmu` such a process.
pub const ARGUMENT: &str = "fmu-worker";

/// Environment variable of a worker: the temporary folder of its FMU.
const FOLDER: &str = "METAFMU_FMU_WORKER";

/// Job of a worker with an FMU.
#[derive(Debug, Serialize, Deserialize)]
pub enum Job<'a> {
    /// Runs of a sampling, whose values follow.
    Sample(Cow<'a, sampling::SamplingTask>),
    /// One run, row by row.
    Simulate(Cow<'a, simulation::SimulationTask>),
    /// One run of a system of FMUs, row by row.
    System(Cow<'a, SystemRun>),
    /// Checks of a validation with the binary.
    Validate(Cow<'a, validation::ValidationTask>),
}

/// Serves the requests of the process that started this one; `checks` are those of a validation.
///
/// # Errors
/// [`Error::Io`] if the streams cannot be used, [`Error::Worker`] if no process has asked for anything.
pub fn serve(checks: &dyn Checks) -> Result<()> {
    let Some(folder) = std::env::var_os(FOLDER).map(PathBuf::from) else {
        return Err(Error::Worker { message: format!("`{ARGUMENT}` is started by metafmu itself") });
    };
    let Pipes { requests, replies } = Pipes::take().map_err(stream)?;
    let mut lines = BufReader::new(requests).lines().map_while(std::io::Result::ok);
    let Some(first) = lines.next() else { leave(&folder) };
    let job: Job = serde_json::from_str(&first).map_err(|error| stream(error.into()))?;

    let (send, requests) = mpsc::channel();
    let unpacked = folder.clone();
    std::thread::spawn(move || {
        for line in lines {
            // the receiver lives as long as the process
            let _ = send.send(line);
        }
        leave(&unpacked)
    });
    let replies = Replies(replies);
    match job {
        Job::Sample(task) => sampling::serve(&task, &folder, requests, replies)?,
        Job::Simulate(task) => simulation::serve(&task, &folder, replies)?,
        Job::System(run) => system::serve(&run, replies)?,
        Job::Validate(task) => validation::serve(&task, &folder, checks, replies)?,
    }
    // an FMU need not survive that its library is unloaded
    exit_now()
}

/// No other process removes the folder if that process was killed.
fn leave(folder: &Path) -> ! {
    unpacked::remove(folder);
    exit_now()
}

fn stream(source: std::io::Error) -> Error {
    Error::io(Path::new("standard input and output"), "use")(source)
}

/// Connection to the process that started this one.
pub struct Replies(File);

impl Replies {
    /// Sends a message and numbers.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn send(&mut self, message: &impl Serialize, numbers: &[f64]) -> Result<()> {
        let mut bytes = serde_json::to_vec(&(message, numbers.len())).map_err(|error| stream(error.into()))?;
        bytes.push(b'\n');
        bytes.extend(numbers.iter().flat_map(|value| value.to_le_bytes()));
        self.0.write_all(&bytes).map_err(stream)
    }
}
