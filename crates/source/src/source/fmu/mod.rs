//! Runs of third-party FMUs: FMI 2.0 or 3.0, co-simulation, or model exchange.
//!
//! Third-party machine code may crash or hang, so worker processes run it: `metafmu` itself, started again. Each run has a separate instance.

pub mod variables;

use super::{
    FailureCause, RunFailure,
    driven::Driven,
    launch::{Launcher, Started, WorkerProcess, WorkerReply},
    setting::SourceSetting,
};
use crate::{
    Error, Result,
    diagnostics::Problems,
    fmi::{
        InterfaceKind, Workers,
        host::{Unpacked, describe},
        worker::{
            Job, Worker,
            sampling::{DrivenRuns, SamplingReply, SamplingTask},
        },
    },
    process::ReplyStatus,
    study::Study,
    unpacking::Patience,
    variable::SourceVariable,
};
use std::{
    borrow::Cow,
    path::Path,
    sync::{Arc, atomic::AtomicBool},
    time::Duration,
};
use variables::{Resolved, resolve};

/// Runs of an FMU, or its equations.
#[derive(Clone, Debug)]
pub struct FmuRuns {
    pub(super) task: Arc<SamplingTask>,
    /// `true` if a process may make only one run.
    pub(super) one_run_per_process: bool,
}

/// Runs of an FMU with the variables of the study.
pub(super) struct ResolvedFmu {
    pub(super) runs: FmuRuns,
    pub(super) driven: Option<Driven>,
    pub(super) parameters: Vec<SourceVariable>,
    pub(super) outputs: Vec<SourceVariable>,
}

impl FmuRuns {
    /// Finds the study's parameters, constants and outputs in the FMU at `path`; loads nothing.
    ///
    /// # Errors
    /// [`Error::Study`] with every name that the FMU does not have, or not for that purpose, and every unit that is not the FMU's; the
    /// errors of an FMU that cannot be read.
    pub(super) fn resolve(study: &Study, path: &Path) -> Result<ResolvedFmu> {
        let wanted = study.runs().start_from_states.then_some(InterfaceKind::ModelExchange);
        let (description, interface) = describe(path, wanted)?;
        let Resolved { parameters, outputs, mut task, driven } = resolve(study, &description)?;
        let options = &study.source;
        let times = study.time.training_grid();
        let (rows, stop) = (times.len() - 1, times[times.len() - 1]);
        task.path = path.to_owned();
        task.interface = interface;
        if interface == InterfaceKind::CoSimulation && options.tolerance.is_some() {
            let message = "belongs to model exchange; this FMU is for co-simulation and has its own solver";
            study.refuse(Problems::one("source.tolerance", message))?;
        }
        task.stop = stop;
        task.tolerance = options.tolerance;
        // of whole steps, so that the last one ends at the stop time
        task.steps_per_row = options.step.map_or(1, |step| (study.time.step / step).round() as usize);
        task.step = stop / (rows * task.steps_per_row) as f64;
        let capabilities = description.interface(interface);
        let one_run_per_process = capabilities.is_some_and(|interface| interface.only_once_per_process);
        let runs = Self { task: Arc::new(task), one_run_per_process };
        Ok(ResolvedFmu { runs, driven, parameters, outputs })
    }

    /// Copy whose processes evaluate the equations.
    pub(super) fn of_equations(&self) -> Self {
        let mut task = (*self.task).clone();
        task.driven = task.driven.map(|driven| DrivenRuns { derivatives: true, ..driven });
        Self { task: Arc::new(task), ..self.clone() }
    }

    /// Copy whose runs end at a row.
    pub(super) fn until(&self, stop: f64) -> Self {
        let task = SamplingTask { stop, ..(*self.task).clone() };
        Self { task: Arc::new(task), ..self.clone() }
    }

    /// Settings of the accuracy from the loosest to the study's.
    pub(super) fn settings(&self) -> Vec<SourceSetting> {
        let SamplingTask { interface, tolerance, steps_per_row, .. } = *self.task;
        match interface {
            InterfaceKind::ModelExchange => SourceSetting::tolerances_above(tolerance),
            // each a divisor of the study's, so that every row is a communication point
            InterfaceKind::CoSimulation if steps_per_row > 1 => {
                let divisors = (1..=steps_per_row).filter(|steps| steps_per_row.is_multiple_of(*steps));
                divisors.map(SourceSetting::StepsPerRow).collect()
            }
            InterfaceKind::CoSimulation => vec![SourceSetting::Fixed],
        }
    }

    /// Copy with another setting of the accuracy.
    pub(super) fn with_setting(&self, setting: SourceSetting) -> Self {
        let mut task = (*self.task).clone();
        match setting {
            SourceSetting::Tolerance(tolerance) => task.tolerance = Some(tolerance),
            SourceSetting::StepsPerRow(steps) => {
                task.step *= task.steps_per_row as f64 / steps as f64;
                task.steps_per_row = steps;
            }
            SourceSetting::Fixed => {}
        }
        Self { task: Arc::new(task), ..self.clone() }
    }

    /// Unpacks the FMU, for as long as the launcher lives.
    pub(super) fn launcher(&self, patience: Patience) -> Result<FmuLauncher<'_>> {
        let unpacked = Unpacked::open(&self.task.path, Some(self.task.interface), patience)?;
        Ok(FmuLauncher { runs: self, unpacked })
    }
}

/// Starts processes that run an unpacked FMU.
pub(super) struct FmuLauncher<'a> {
    runs: &'a FmuRuns,
    unpacked: Unpacked,
}

impl Launcher for FmuLauncher<'_> {
    fn start(&self, limit: Duration, workers: Workers<'_>) -> Result<Started> {
        let task = &self.runs.task;
        let job = Job::Sample(Cow::Borrowed(task));
        let mut worker = Worker::start(workers.program, &task.path, self.unpacked.folder(), &job, |_| {})?;
        let message = match worker.reply(Some(limit), workers.stop) {
            ReplyStatus::Reply((SamplingReply::Ready, _)) => {
                return Ok(Some(Box::new(FmuProcess { worker, one_run: self.runs.one_run_per_process })));
            }
            ReplyStatus::Stopped => return Ok(None),
            // it names the FMU
            ReplyStatus::Reply((SamplingReply::Failed(message), _)) => return Err(Error::Worker { message }),
            ReplyStatus::Reply(_) => "the worker's reply made no sense".into(),
            ReplyStatus::Died(end) => format!("when it was loaded, {}", end.message),
            ReplyStatus::TimedOut => format!("loading it took longer than {limit:?} (source.time_limit)"),
        };
        Err(Error::Worker { message: format!("{}: {message}", task.path.display()) })
    }
}

/// A process with the loaded FMU.
struct FmuProcess {
    worker: Worker<SamplingReply>,
    one_run: bool,
}

impl WorkerProcess for FmuProcess {
    fn run(&mut self, request: &[f64], limit: Duration, stop: &AtomicBool) -> WorkerReply {
        self.worker.ask(&request);
        match self.worker.reply(Some(limit), stop) {
            ReplyStatus::Reply((SamplingReply::Done, outputs)) => WorkerReply::Done(outputs),
            ReplyStatus::Reply((SamplingReply::Failed(reason), _)) => {
                WorkerReply::Failed(RunFailure::new(FailureCause::Model, reason))
            }
            ReplyStatus::Reply(_) => WorkerReply::Failed(RunFailure::senseless_reply()),
            ReplyStatus::Died(end) => WorkerReply::Failed(RunFailure::new(FailureCause::Process, end.message)),
            ReplyStatus::TimedOut => WorkerReply::TimedOut,
            ReplyStatus::Stopped => WorkerReply::Stopped,
        }
    }

    fn is_spent(&self) -> bool {
        self.one_run
    }

    fn memory(&self) -> Option<u64> {
        self.worker.memory()
    }

    fn finish(self: Box<Self>) {}
}
