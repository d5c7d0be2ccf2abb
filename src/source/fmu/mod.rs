//! Runs of an FMU of any tool: FMI 2.0 or 3.0, co-simulation, or model exchange.
//!
//! Other people's machine code may crash or hang, so it is run by worker processes, one for each thread: `metafmu` itself,
//! started again. Each run has an instance of its own. A run that fails, ends its process or takes longer than
//! `source.time_limit` is tried again `source.retries` times, in a fresh process; then it is left out and reported. Which
//! process makes which run does not matter to the results, unless the FMU keeps something from instance to instance.

pub mod variables;

use super::{Journal, driven::Driven};
use crate::{
    Error, Result,
    diagnostics::Problems,
    fmi::{
        InterfaceKind,
        host::{Unpacked, describe},
        worker::{
            Job, ReplyStatus, Worker, Workers,
            sampling::{self, SamplingReply, SamplingTask},
        },
    },
    study::Study,
    variable::SourceVariable,
};
use std::{
    borrow::Cow,
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
    time::{Duration, Instant},
};
use variables::{Resolved, resolve};

/// Time limit of a run unless `source.time_limit` sets it.
const TIME_LIMIT: Duration = Duration::from_secs(60);
/// Points whose derivatives a process is asked for at a time, if it may make several instances.
const BATCH: usize = 64;
/// `source.retries` unless given.
const RETRIES: usize = 1;

/// Outputs of a run of an FMU, row by row, or the reason of its failure.
pub type FmuOutcome = std::result::Result<Vec<f64>, String>;

/// An FMU and what its runs are.
#[derive(Clone, Debug)]
pub struct FmuModel {
    task: Arc<SamplingTask>,
    /// Numbers of a run.
    values: usize,
    /// Whether a process may make one run only.
    one_run_per_process: bool,
    time_limit: Duration,
    retries: usize,
    /// How runs start and what drives them, if inputs do.
    driven: Option<Driven>,
}

impl FmuModel {
    /// Finds the study's parameters, constants and outputs in the FMU at `path`; loads nothing. Also the variables of the
    /// parameters and outputs, in the study's order.
    ///
    /// # Errors
    /// [`Error::Study`] with every name that the FMU does not have, or not for that purpose, and every unit that is not the FMU's; the
    /// errors of an FMU that cannot be read.
    pub fn new(study: &Study, path: &Path) -> Result<(Self, Vec<SourceVariable>, Vec<SourceVariable>)> {
        let wanted = match (study.has_states(), study.is_discrete()) {
            (true, _) => Some(InterfaceKind::ModelExchange),
            (_, true) => Some(InterfaceKind::CoSimulation),
            _ => None,
        };
        let (description, interface) = describe(path, wanted)?;
        let Resolved { parameters, outputs, mut task, driven } = resolve(study, &description)?;
        let options = &study.source;
        let times = study.time.training_grid();
        let (rows, stop) = (times.len() - 1, times[times.len() - 1]);
        task.path = path.to_owned();
        task.interface = interface;
        if interface == InterfaceKind::CoSimulation && options.tolerance.is_some() {
            let message = "belongs to model exchange; this FMU is for co-simulation and integrates by itself";
            study.refuse(Problems::one("source.tolerance", message))?;
        }
        task.stop = stop;
        task.tolerance = options.tolerance;
        // of whole steps, so that the last one ends at the stop time
        task.steps_per_row = options.step.map_or(1, |step| (study.time.step / step).round() as usize);
        task.step = stop / (rows * task.steps_per_row) as f64;
        let capabilities = description.interface(interface);
        let model = Self {
            values: (rows + 1) * task.outputs.len(),
            task: Arc::new(task),
            one_run_per_process: capabilities.is_some_and(|interface| interface.only_once_per_process),
            time_limit: options.time_limit().unwrap_or(TIME_LIMIT),
            retries: options.retries.unwrap_or(RETRIES),
            driven,
        };
        Ok((model, parameters, outputs))
    }

    /// How runs start and what drives them, if inputs do.
    pub fn driven(&self) -> Option<&Driven> {
        self.driven.as_ref()
    }

    /// The same, to change it.
    pub(super) fn driven_mut(&mut self) -> Option<&mut Driven> {
        self.driven.as_mut()
    }

    /// What a process is asked for a point.
    fn request<'p>(&self, point: &'p [f64]) -> Cow<'p, [f64]> {
        match (&self.driven, &self.task.driven) {
            (Some(driven), Some(asked)) if !asked.derivatives => {
                let stop = self.task.stop;
                let rows = self.values / self.task.outputs.len().max(1);
                let times: Vec<f64> = (0..rows).map(|row| stop * row as f64 / (rows - 1).max(1) as f64).collect();
                // a number from which only the signals follow is no value of the FMU
                let values = &point[..self.task.parameters() + asked.states.len()];
                [values, &driven.inputs(point, &times)].concat().into()
            }
            _ => point.into(),
        }
    }

    /// Number of times that `done` is called for so many points by [`FmuModel::derivatives`].
    pub fn batches(&self, points: usize) -> usize {
        points.div_ceil(self.batch())
    }

    /// Points that a process is asked for at a time: each takes an instance of its own.
    fn batch(&self) -> usize {
        if self.one_run_per_process { 1 } else { BATCH }
    }

    /// The equations at points, each parameters, inputs and states: derivatives, then outputs, for each point.
    ///
    /// # Errors
    /// Those of [`FmuModel::run_all`]; [`Error::Worker`] if the FMU has no derivatives at a point, has events, or depends on the time.
    pub fn derivatives(
        &self,
        points: &[Vec<f64>],
        workers: Workers<'_>,
        done: impl Fn() + Sync,
    ) -> Result<Vec<Vec<f64>>> {
        let (Some(asked), Some(last)) = (&self.task.driven, points.last()) else { return Ok(Vec::new()) };
        let (width, size) = (asked.states.len() + self.task.outputs.len(), self.batch());
        let mut task = (*self.task).clone();
        task.driven = Some(sampling::DrivenRuns { derivatives: true, ..asked.clone() });
        let model = Self { task: Arc::new(task), values: size * width, ..self.clone() };
        // the last batch is filled up
        let batch = |points: &[Vec<f64>]| {
            let more = std::iter::repeat_n(last, size - points.len());
            points.iter().chain(more).flatten().copied().collect::<Vec<f64>>()
        };
        let batches: Vec<Vec<f64>> = points.chunks(size).map(batch).collect();
        let failure =
            |_: &[f64], reason: &str| Err(Error::Worker { message: format!("{}: {reason}", self.task.path.display()) });
        let replies = model.run_all(&batches, None, workers, &failure, done)?;
        let rows = replies
            .into_iter()
            .flatten()
            .flat_map(|reply| reply.chunks_exact(width).map(<[f64]>::to_vec).collect::<Vec<_>>());
        Ok(rows.take(points.len()).collect())
    }

    /// Runs the FMU at each point, by as many processes as there are threads; runs that are in the journal are taken from
    /// there. `done` is called after each run; when the token of `workers` turns true, runs that have begun are abandoned. `failure` is called with
    /// the point and the reason of each run that failed; its error ends everything.
    ///
    /// # Errors
    /// Those of `failure`, [`Error::Worker`] if the FMU cannot be loaded,
    /// [`Error::Interrupted`], [`Error::Io`] of the journal or the processes, the errors of an FMU that cannot be unpacked.
    pub fn run_all(
        &self,
        points: &[Vec<f64>],
        journal: Option<&Journal>,
        workers: Workers<'_>,
        failure: &(dyn Fn(&[f64], &str) -> Result<()> + Sync),
        done: impl Fn() + Sync,
    ) -> Result<Vec<FmuOutcome>> {
        let kept = |point: &Vec<f64>| Some(journal?.get(point)?.to_vec());
        let mut outcomes: Vec<Option<FmuOutcome>> = points.iter().map(|point| kept(point).map(Ok)).collect();
        let missing: Vec<usize> = (0..points.len()).filter(|&index| outcomes[index].is_none()).collect();
        (missing.len()..points.len()).for_each(|_| done());
        if !missing.is_empty() {
            let unpacked = Unpacked::open(&self.task.path, Some(self.task.interface))?;
            let campaign = Campaign {
                model: self,
                folder: unpacked.folder(),
                points,
                missing: &missing,
                next: AtomicUsize::new(0),
                failure,
                journal,
                workers,
                halt: AtomicBool::new(false),
                done: &done,
            };
            for (index, outcome) in campaign.run()? {
                outcomes[index] = Some(outcome);
            }
        }
        outcomes.into_iter().map(|outcome| outcome.ok_or(Error::Interrupted)).collect()
    }
}

/// Runs on their way.
struct Campaign<'a> {
    model: &'a FmuModel,
    /// Where the FMU is unpacked.
    folder: &'a Path,
    points: &'a [Vec<f64>],
    /// Positions of the points to run, and which of these is next.
    missing: &'a [usize],
    next: AtomicUsize,
    failure: &'a (dyn Fn(&[f64], &str) -> Result<()> + Sync),
    journal: Option<&'a Journal>,
    workers: Workers<'a>,
    /// Another thread met an error.
    halt: AtomicBool,
    done: &'a (dyn Fn() + Sync),
}

impl Campaign<'_> {
    fn run(&self) -> Result<Vec<(usize, FmuOutcome)>> {
        let threads = rayon::current_num_threads().min(self.missing.len());
        let results: Vec<Result<Vec<_>>> = std::thread::scope(|scope| {
            let threads: Vec<_> = (0..threads).map(|_| scope.spawn(|| self.work())).collect();
            threads.into_iter().map(|thread| thread.join().unwrap_or_else(|p| std::panic::resume_unwind(p))).collect()
        });
        // threads that were halted do not know why
        let mut outcomes = Vec::new();
        for result in results {
            outcomes.extend(result?);
        }
        if self.workers.stop.load(Ordering::Relaxed) && outcomes.len() < self.missing.len() {
            return Err(Error::Interrupted);
        }
        Ok(outcomes)
    }

    /// Makes one run after the other with a process of its own.
    fn work(&self) -> Result<Vec<(usize, FmuOutcome)>> {
        let (mut outcomes, mut worker) = (Vec::new(), None);
        while !self.workers.stop.load(Ordering::Relaxed) && !self.halt.load(Ordering::Relaxed) {
            let Some(&index) = self.missing.get(self.next.fetch_add(1, Ordering::Relaxed)) else { break };
            match self.attempt(&self.points[index], &mut worker) {
                Ok(Some(outcome)) => outcomes.push((index, outcome)),
                Ok(None) => break,
                Err(error) => {
                    self.halt.store(true, Ordering::Relaxed);
                    return Err(error);
                }
            }
            (self.done)();
        }
        Ok(outcomes)
    }

    /// One run, with retries; none if the program is to stop.
    fn attempt(&self, point: &[f64], worker: &mut Option<Worker<SamplingReply>>) -> Result<Option<FmuOutcome>> {
        let mut reason = String::new();
        for _ in 0..=self.model.retries {
            let begin = Instant::now();
            let Some(process) = self.ready(worker)? else { return Ok(None) };
            process.ask(&self.model.request(point));
            let mut status = process.reply(Some(self.model.time_limit), self.workers.stop);
            let complete = |outputs: &[f64]| outputs.len() == self.model.values;
            if !matches!(&status, ReplyStatus::Reply(SamplingReply::Done, outputs) if complete(outputs))
                || self.model.one_run_per_process
            {
                // a process in which something went wrong is not trusted any more
                *worker = None;
            }
            reason = match &mut status {
                ReplyStatus::Reply(SamplingReply::Done, outputs) if complete(outputs) => {
                    let outputs = std::mem::take(outputs);
                    if let Some(journal) = self.journal {
                        journal.keep(point, &outputs, begin.elapsed())?;
                    }
                    return Ok(Some(Ok(outputs)));
                }
                ReplyStatus::Reply(SamplingReply::Failed(reason), _) | ReplyStatus::Died(reason) => {
                    std::mem::take(reason)
                }
                ReplyStatus::Reply(..) => "the worker's reply made no sense".into(),
                ReplyStatus::TimedOut => format!("took longer than {:?} (source.time_limit)", self.model.time_limit),
                ReplyStatus::Stopped => return Ok(None),
            };
        }
        (self.failure)(point, &reason)?;
        Ok(Some(Err(reason)))
    }

    /// A process that has loaded the FMU; none if the program is to stop.
    fn ready<'w>(
        &self,
        worker: &'w mut Option<Worker<SamplingReply>>,
    ) -> Result<Option<&'w mut Worker<SamplingReply>>> {
        let path = &self.model.task.path;
        let mut process = match worker.take() {
            Some(process) => return Ok(Some(worker.insert(process))),
            None => Worker::start(
                self.workers.program,
                path,
                self.folder,
                &Job::Sample(Cow::Borrowed(&self.model.task)),
                |_| {},
            )?,
        };
        let message = match process.reply(Some(self.model.time_limit), self.workers.stop) {
            ReplyStatus::Reply(SamplingReply::Ready, _) => return Ok(Some(worker.insert(process))),
            ReplyStatus::Stopped => return Ok(None),
            // it names the FMU
            ReplyStatus::Reply(SamplingReply::Failed(message), _) => return Err(Error::Worker { message }),
            ReplyStatus::Reply(..) => "the worker's reply made no sense".into(),
            ReplyStatus::Died(reason) => format!("when it was loaded, {reason}"),
            ReplyStatus::TimedOut => {
                format!("loading it took longer than {:?} (source.time_limit)", self.model.time_limit)
            }
        };
        Err(Error::Worker { message: format!("{}: {message}", path.display()) })
    }
}
