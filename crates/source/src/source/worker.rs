//! Runs by worker processes, one for each thread: of an FMU, or of a program.
//!
//! A run that fails, ends its process or takes longer than `source.time_limit` is repeated `source.retries` times, in a
//! fresh process. After that it is dropped and reported. Results do not depend on which process makes which run: a few runs
//! are repeated after others, and a source whose results differ is refused. A process whose memory exceeds a limit is replaced.

mod campaign;
mod repeat;

use super::{
    Journal, RunFailure,
    driven::Driven,
    fmu::{FmuRuns, ResolvedFmu},
    launch::{Launcher, WorkerProcess},
    program::{ProgramRuns, ResolvedProgram},
    setting::SourceSetting,
};
use crate::{Error, Result, fmi::Workers, study::Study, unpacking::Patience, variable::SourceVariable};
use campaign::Campaign;
use metafmu_runtime::Rows;
use std::{borrow::Cow, path::Path, sync::Arc, time::Duration};

/// Default `source.time_limit` of a run.
const TIME_LIMIT: Duration = Duration::from_secs(60);
/// Points at which a process evaluates the equations for one request, if it can make several runs.
const BATCH: usize = 64;
/// Default `source.retries`.
const RETRIES: usize = 1;
/// Default `source.repeats`.
const REPEATS: usize = 2;

/// Outputs of a run, row by row, or its failure.
pub type RunOutputs = std::result::Result<Vec<f64>, RunFailure>;

/// Model whose runs are made by worker processes.
#[derive(Clone, Debug)]
pub struct WorkerModel {
    runner: Runner,
    /// Parameters of the study.
    parameters: usize,
    outputs: usize,
    /// Numbers of the lower triangle of the mass matrix, if the source gives it.
    masses: usize,
    times: Arc<[f64]>,
    /// Numbers of a reply.
    values: usize,
    /// Names of the numbers of a row or point, for messages.
    columns: Arc<[String]>,
    /// `true` if processes evaluate the equations and make no runs.
    is_of_equations: bool,
    time_limit: Duration,
    retries: usize,
    /// Number of runs that are repeated.
    repeats: usize,
    /// Limit of the memory of a process in bytes, if the study has one.
    memory_limit: Option<u64>,
    study: Arc<Study>,
    /// Initial states of the runs, and inputs that drive them, if there are any.
    driven: Option<Driven>,
}

/// Model that the processes run.
#[derive(Clone, Debug)]
enum Runner {
    Fmu(FmuRuns),
    Program(ProgramRuns),
}

impl WorkerModel {
    /// Finds the study's parameters, constants and outputs in the FMU at `path`; loads nothing. Also returns the
    /// variables of the parameters and outputs, in the study's order.
    ///
    /// # Errors
    /// [`Error::Study`] with every name that the FMU does not have, or not for that purpose, and every unit that is not the FMU's; the
    /// errors of an FMU that cannot be read.
    pub fn of_fmu(study: &Study, path: &Path) -> Result<(Self, Vec<SourceVariable>, Vec<SourceVariable>)> {
        let ResolvedFmu { runs, driven, parameters, outputs } = FmuRuns::resolve(study, path)?;
        Ok((Self::new(study, Runner::Fmu(runs), driven), parameters, outputs))
    }

    /// Takes parameters, constants and outputs of a program from the study; starts nothing. Also returns the variables
    /// of the parameters and outputs, in the study's order. Each process describes itself before its first run.
    ///
    /// # Errors
    /// [`Error::Study`] with every mistake in the command and in the inputs.
    pub fn of_program(study: &Study) -> Result<(Self, Vec<SourceVariable>, Vec<SourceVariable>)> {
        let ResolvedProgram { runs, driven, parameters, outputs } = ProgramRuns::resolve(study)?;
        Ok((Self::new(study, Runner::Program(runs), driven), parameters, outputs))
    }

    fn new(study: &Study, runner: Runner, driven: Option<Driven>) -> Self {
        let (times, outputs): (Arc<[f64]>, usize) = (study.time.training_grid().into(), study.outputs.len());
        let rates = study.states.len() / 2;
        Self {
            runner,
            parameters: study.parameters.len(),
            outputs,
            masses: if study.has_mass_matrix() { rates * (rates + 1) / 2 } else { 0 },
            values: times.len() * outputs,
            columns: study.outputs.keys().map(|name| format!("output `{name}`")).collect(),
            times,
            is_of_equations: false,
            time_limit: study.source.time_limit().unwrap_or(TIME_LIMIT),
            retries: study.source.retries.unwrap_or(RETRIES),
            repeats: study.source.repeats.unwrap_or(REPEATS),
            // a float beyond the range of integers becomes the largest one
            memory_limit: study.source.memory_limit.map(|megabytes| (1e6 * megabytes) as u64),
            study: Arc::new(study.clone()),
            driven,
        }
    }

    /// Initial states of the runs, and inputs that drive them, if there are any.
    pub fn driven(&self) -> Option<&Driven> {
        self.driven.as_ref()
    }

    /// Mutable access to [`WorkerModel::driven`].
    pub(super) fn driven_mut(&mut self) -> Option<&mut Driven> {
        self.driven.as_mut()
    }

    /// Number of times that [`WorkerModel::derivatives`] calls `done` for a number of points.
    pub fn batches(&self, points: usize) -> usize {
        points.div_ceil(self.batch())
    }

    /// The equations at points, each parameters, inputs and states: derivatives, outputs, then the lower triangle of the mass matrix row by
    /// row if the source gives it, for each point.
    ///
    /// # Errors
    /// Those of [`WorkerModel::run_all`]; [`Error::Worker`] if a derivative does not exist at a point, or an FMU has events or depends on the
    /// time.
    pub fn derivatives(&self, points: &Rows, workers: Workers<'_>, done: impl Fn() + Sync) -> Result<Rows> {
        let (Some(driven), Some(last)) = (&self.driven, points.iter().next_back()) else { return Ok(Rows::default()) };
        let (width, size) = (driven.states().len() + self.outputs + self.masses, self.batch());
        let states = self.study.states.keys().map(|name| format!("the derivative of `{name}`"));
        let masses = (0..self.masses).map(|_| "an element of the mass matrix".to_owned());
        let columns = states.chain(self.columns.iter().cloned()).chain(masses).collect();
        let model = Self { values: size * width, columns, ..self.of_equations() };
        // the last batch is filled up
        let (numbers, mut values) = (size * last.len(), points.values().to_vec());
        let missing = values.len().next_multiple_of(numbers) - values.len();
        values.extend(last.iter().cycle().take(missing));
        let batches: Rows = values.chunks_exact(numbers).collect();
        let refuse = |_: &[f64], failure: &RunFailure| {
            let message = format!("{}: {failure}", self.name());
            Err(Error::Worker { message })
        };
        let replies = model.run_all(&batches, None, workers, &refuse, done)?;
        Ok(replies.iter().flatten().flat_map(|reply| reply.chunks_exact(width)).take(points.len()).collect())
    }

    /// Copy whose processes evaluate the equations.
    fn of_equations(&self) -> Self {
        let runner = match &self.runner {
            Runner::Fmu(runs) => Runner::Fmu(runs.of_equations()),
            Runner::Program(runs) => Runner::Program(runs.of_equations()),
        };
        Self { runner, is_of_equations: true, ..self.clone() }
    }

    /// Works with a process that evaluates the equations at any number of points for one request, which follow one another; none if a
    /// process makes only one run.
    ///
    /// # Errors
    /// Those of the work and of a process that cannot be started, [`Error::Interrupted`].
    pub(super) fn with_equations<T>(
        &self,
        workers: Workers<'_>,
        work: impl FnOnce(&mut dyn WorkerProcess) -> Result<T>,
    ) -> Result<Option<T>> {
        if self.batch() == 1 {
            return Ok(None);
        }
        let model = self.of_equations();
        let launcher = model.launcher(workers)?;
        let Some(mut process) = launcher.start(self.time_limit, workers)? else { return Err(Error::Interrupted) };
        let result = work(&mut *process)?;
        process.finish();
        Ok(Some(result))
    }

    /// Number of the study's parameters, the first of a point.
    pub(super) fn parameters(&self) -> usize {
        self.parameters
    }

    /// Time limit of a request.
    pub(super) fn time_limit(&self) -> Duration {
        self.time_limit
    }

    /// Makes the run of each point, with one process for each thread; runs in the journal are taken from it. `done` is
    /// called after each run. When the token of `workers` turns true, runs that have begun are abandoned. `failure` is
    /// called with the point of each failed run; its error ends everything.
    ///
    /// # Errors
    /// - Those of `failure`, of the journal and of an FMU that cannot be unpacked;
    /// - [`Error::Worker`] if an FMU cannot be loaded;
    /// - [`Error::Study`] if a program does not answer, or does not have what the study names, or a run that is repeated has other results;
    /// - [`Error::Interrupted`], [`Error::Io`] of the processes.
    pub fn run_all(
        &self,
        points: &Rows,
        journal: Option<&Journal>,
        workers: Workers<'_>,
        failure: &(dyn Fn(&[f64], &RunFailure) -> Result<()> + Sync),
        done: impl Fn() + Sync,
    ) -> Result<Vec<RunOutputs>> {
        let mut outcomes: Vec<Option<RunOutputs>> =
            points.iter().map(|point| Some(Ok(journal?.get(point)?.to_vec()))).collect();
        let missing: Vec<usize> = (0..points.len()).filter(|&index| outcomes[index].is_none()).collect();
        (missing.len()..points.len()).for_each(|_| done());
        if !missing.is_empty() {
            let launcher = self.launcher(workers)?;
            let campaign = Campaign {
                model: self,
                launcher: &*launcher,
                points,
                missing: &missing,
                failure,
                journal,
                workers,
                done: &done,
            };
            for (index, outcome) in campaign.run()? {
                outcomes[index] = Some(outcome);
            }
        }
        outcomes.into_iter().map(|outcome| outcome.ok_or(Error::Interrupted)).collect()
    }

    /// Numbers of a reply.
    pub(super) fn values(&self) -> usize {
        self.values
    }

    /// Copy whose runs end with the row of this number.
    pub(super) fn with_rows(&self, rows: usize) -> Self {
        let times: Arc<[f64]> = self.times[..rows].into();
        let runner = match &self.runner {
            Runner::Fmu(runs) => Runner::Fmu(runs.until(times.last().copied().unwrap_or_default())),
            Runner::Program(runs) => Runner::Program(runs.with_times(Arc::clone(&times))),
        };
        Self { runner, values: rows * self.outputs, times, ..self.clone() }
    }

    /// Settings of the accuracy from the loosest to the study's.
    pub(super) fn settings(&self) -> Vec<SourceSetting> {
        match &self.runner {
            Runner::Fmu(runs) => runs.settings(),
            Runner::Program(_) => vec![SourceSetting::Fixed],
        }
    }

    /// Copy with another setting of the accuracy.
    pub(super) fn with_setting(&self, setting: SourceSetting) -> Self {
        match &self.runner {
            Runner::Fmu(runs) => Self { runner: Runner::Fmu(runs.with_setting(setting)), ..self.clone() },
            Runner::Program(_) => self.clone(),
        }
    }

    /// Unpacks an FMU, for as long as the launcher lives.
    pub(super) fn launcher(&self, workers: Workers) -> Result<Box<dyn Launcher + '_>> {
        let default = Patience::default();
        // a limit of short runs is none of unpacking
        let limit = self.time_limit.max(default.limit);
        let patience = Patience { limit, option: "source.time_limit", stop: Some(workers.stop) };
        Ok(match &self.runner {
            Runner::Fmu(runs) => Box::new(runs.launcher(patience)?),
            Runner::Program(runs) => Box::new(runs),
        })
    }

    /// Request to a process for a point.
    pub(super) fn request<'p>(&self, point: &'p [f64]) -> Cow<'p, [f64]> {
        match &self.driven {
            Some(driven) if !self.is_of_equations => {
                // a number from which only the signals follow is no value of the model
                let values = &point[..self.parameters + driven.states().len()];
                [values, &driven.inputs(point, &self.times)].concat().into()
            }
            _ => point.into(),
        }
    }

    /// Points that a process evaluates for one request; an FMU evaluates each in a separate instance.
    fn batch(&self) -> usize {
        match &self.runner {
            Runner::Fmu(runs) if runs.one_run_per_process => 1,
            _ => BATCH,
        }
    }

    /// The FMU or program, for messages.
    fn name(&self) -> String {
        match &self.runner {
            Runner::Fmu(runs) => runs.task.path.display().to_string(),
            Runner::Program(runs) => runs.name(),
        }
    }
}
