//! Runs of a source one after the other, with their wall times.

use super::{
    launch::{Launcher, WorkerProcess, WorkerReply},
    simulation::Simulation,
    worker::WorkerModel,
};
use crate::{Error, Result, fmi::Workers};
use std::time::Instant;

/// Run with its wall time.
#[derive(Debug)]
pub struct TimedRun {
    /// Wall time in seconds, without the start of a process.
    pub seconds: f64,
    /// Outputs, row by row.
    pub outputs: Vec<f64>,
}

/// Runs of a simulation one after the other; those of an FMU or a program share a process where it can make several.
pub struct TimedRuns<'a> {
    simulation: &'a Simulation,
    process: Option<TimedProcess<'a>>,
}

/// Worker process of a model.
struct TimedProcess<'a> {
    model: &'a WorkerModel,
    launcher: Box<dyn Launcher + 'a>,
    idle: Option<Box<dyn WorkerProcess>>,
    workers: Workers<'a>,
}

impl<'a> TimedRuns<'a> {
    /// Prepares runs; no process is started yet.
    ///
    /// # Errors
    /// Those of an FMU that cannot be unpacked.
    pub fn new(simulation: &'a Simulation, workers: Workers<'a>) -> Result<Self> {
        let Some(model) = simulation.worker_model() else { return Ok(Self { simulation, process: None }) };
        let process = TimedProcess { model, launcher: model.launcher(workers)?, idle: None, workers };
        Ok(Self { simulation, process: Some(process) })
    }

    /// Makes the run of a point; none if it fails.
    ///
    /// # Errors
    /// Those of a process that cannot be started, [`Error::Interrupted`].
    pub fn run(&mut self, point: &[f64]) -> Result<Option<TimedRun>> {
        if let Some(process) = &mut self.process {
            return process.run(point);
        }
        let begin = Instant::now();
        let run = self.simulation.run(point).ok();
        Ok(run.map(|run| TimedRun { seconds: begin.elapsed().as_secs_f64(), outputs: run.outputs }))
    }
}

impl TimedProcess<'_> {
    fn run(&mut self, point: &[f64]) -> Result<Option<TimedRun>> {
        let limit = self.model.time_limit();
        let started = match self.idle.take() {
            Some(process) => Some(process),
            None => self.launcher.start(limit, self.workers)?,
        };
        let Some(mut process) = started else { return Err(Error::Interrupted) };
        let request = self.model.request(point);
        let begin = Instant::now();
        let reply = process.run(&request, limit, self.workers.stop);
        let seconds = begin.elapsed().as_secs_f64();
        match reply {
            WorkerReply::Done(outputs) if outputs.len() == self.model.values() => {
                self.idle = (!process.is_spent()).then_some(process);
                Ok(Some(TimedRun { seconds, outputs }))
            }
            WorkerReply::Stopped => Err(Error::Interrupted),
            _ => Ok(None),
        }
    }
}

impl Drop for TimedProcess<'_> {
    fn drop(&mut self) {
        if let Some(process) = self.idle.take() {
            process.finish();
        }
    }
}
