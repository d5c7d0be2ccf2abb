//! A worker process of a source: numbers in, numbers out.

use super::RunFailure;
use crate::{Result, fmi::Workers};
use std::{sync::atomic::AtomicBool, time::Duration};

/// A worker process that can make runs; none if the program must stop.
pub(super) type Started = Option<Box<dyn WorkerProcess>>;

/// Starts worker processes.
pub(super) trait Launcher: Sync {
    /// Starts a process and waits until it can make runs.
    ///
    /// # Errors
    /// [`Error::Worker`](crate::Error::Worker) if it cannot, [`Error::Study`](crate::Error::Study) if it does not have what the study names,
    /// [`Error::Io`](crate::Error::Io) with the system's reason.
    fn start(&self, limit: Duration, workers: Workers<'_>) -> Result<Started>;
}

/// A process that makes one run after the other.
pub(super) trait WorkerProcess {
    /// Sends a request and waits for the reply.
    fn run(&mut self, request: &[f64], limit: Duration, stop: &AtomicBool) -> WorkerReply;

    /// Returns true if the process cannot make another run.
    fn is_spent(&self) -> bool {
        false
    }

    /// Resident memory of the process and those below it, in bytes; none if it is not known, or no process outlives a run.
    fn memory(&self) -> Option<u64> {
        None
    }

    /// Ends the process after its last run.
    fn finish(self: Box<Self>);
}

/// Result of a request.
#[derive(Debug)]
pub(super) enum WorkerReply {
    /// Numbers.
    Done(Vec<f64>),
    /// The run failed.
    Failed(RunFailure),
    /// No reply within the time limit.
    TimedOut,
    /// Abandoned, because the program must stop.
    Stopped,
}
