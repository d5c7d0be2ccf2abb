//! Runs of a program that answers requests in lines of JSON on its standard input and output, or is started for each run.
//!
//! docs/command-sources.md specifies the protocol. The study says what the program has, so that a study is opened without the program; each
//! process describes itself before its first run, and everything that differs from the study is refused.

mod description;
mod once;
mod reply;

use super::{
    FailureCause, RunFailure,
    driven::{Driven, OwnInput},
    launch::{Launcher, Started, WorkerProcess, WorkerReply},
};
use crate::{
    Error, Result,
    diagnostics::Problems,
    fmi::Workers,
    process::{ChildProcess, ReplyStatus, ReplyStream},
    study::Study,
    variable::SourceVariable,
};
pub use description::{ProgramDescription, ProgramQuantity};
use indexmap::IndexMap;
use once::OneShot;
use reply::{Request, parse};
use serde::Serialize;
use std::{
    fmt,
    io::{BufRead, Read},
    path::{Path, PathBuf},
    process::Command,
    sync::{Arc, atomic::AtomicBool},
    time::Duration,
};

/// Version of the protocol.
pub const PROTOCOL: u32 = 1;

/// Environment variables for threads of libraries for linear algebra: there is a process for each core.
const THREADS: [&str; 3] = ["OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"];

/// Runs of a program, or its equations.
#[derive(Clone, Debug)]
pub struct ProgramRuns {
    study: Arc<Study>,
    command: ProgramCommand,
    times: Arc<[f64]>,
    is_of_equations: bool,
}

/// Runs of a program with the variables of the study.
pub(super) struct ResolvedProgram {
    pub(super) runs: ProgramRuns,
    pub(super) driven: Option<Driven>,
    pub(super) parameters: Vec<SourceVariable>,
    pub(super) outputs: Vec<SourceVariable>,
}

/// A program, its arguments and its working directory.
#[derive(Clone, Debug)]
pub struct ProgramCommand {
    arguments: Vec<String>,
    folder: PathBuf,
}

impl ProgramRuns {
    /// Takes parameters, states, inputs and outputs from the study; starts nothing.
    ///
    /// # Errors
    /// [`Error::Study`] with every placeholder that is missing and every input without a range.
    pub(super) fn resolve(study: &Study) -> Result<ResolvedProgram> {
        let mut parameters: Vec<SourceVariable> =
            study.parameters.iter().map(|(name, p)| variable(name, &p.unit, &p.description)).collect();
        let outputs = study.outputs.iter().map(|(name, o)| variable(name, &o.unit, &o.description)).collect();
        let states = study.states.iter().map(|(name, state)| (variable(name, &state.unit, &None), None)).collect();
        let inputs = study.inputs.iter().map(|(name, input)| OwnInput {
            variable: variable(name, &input.unit, &input.description),
            range: [None, None],
            start: None,
        });
        let arguments = study.source.command.clone().unwrap_or_default();
        let mut problems = Problems::default();
        if study.source.runs_once() {
            problems.extend(once::problems(study, &arguments));
        }
        let mut driven = None;
        if study.runs().have_memory {
            match Driven::of_states(study, states, inputs.collect()) {
                Ok(found) => driven = Some(found),
                Err(more) => problems.extend(more),
            }
        }
        study.refuse(problems)?;
        parameters.extend(driven.iter().flat_map(Driven::starts));
        let command = ProgramCommand::new(arguments, &study.beside(Path::new("")));
        let (study, times) = (Arc::new(study.clone()), study.time.training_grid().into());
        let runs = Self { study, command, times, is_of_equations: false };
        Ok(ResolvedProgram { runs, driven, parameters, outputs })
    }

    /// Copy whose runs have other times.
    pub(super) fn with_times(&self, times: Arc<[f64]>) -> Self {
        Self { times, ..self.clone() }
    }

    /// Copy whose processes evaluate the equations.
    pub(super) fn of_equations(&self) -> Self {
        Self { is_of_equations: true, ..self.clone() }
    }

    /// The command, for messages.
    pub(super) fn name(&self) -> String {
        self.command.name()
    }

    /// Values by name: the study's parameters, of which `values` begins with the values, and constants. Also the remaining values.
    fn parameters<'a>(&'a self, values: &'a [f64]) -> (IndexMap<&'a str, f64>, &'a [f64]) {
        let (values, rest) = values.split_at(self.study.parameters.len());
        let varied = self.study.parameters.keys().zip(values);
        let all = varied.chain(&self.study.source.constants);
        (all.map(|(name, value)| (name.as_str(), *value)).collect(), rest)
    }

    /// A request for a run: parameters, states at the start, inputs at each row.
    fn request_of_run<'a>(&'a self, values: &'a [f64]) -> Request<'a> {
        let (parameters, rest) = self.parameters(values);
        let (states, signals) = rest.split_at(self.study.states.len());
        let interpolation = if self.study.runs().are_samples { "hold" } else { "linear" };
        Request::Run {
            parameters,
            times: &self.times,
            states: names(&self.study.states).zip(states.iter().copied()).collect(),
            inputs: columns(names(&self.study.inputs), signals),
            interpolation: (!self.study.inputs.is_empty()).then_some(interpolation),
            outputs: names(&self.study.outputs).collect(),
        }
    }

    /// A request for derivatives and outputs at points, each parameters, inputs and states.
    fn request_of_equations<'a>(&'a self, values: &'a [f64]) -> Request<'a> {
        let counts = [self.study.parameters.len(), self.study.inputs.len(), self.study.states.len()];
        let width: usize = counts.iter().sum();
        let points = values.len() / width.max(1);
        let [of_parameters, of_inputs, of_states] = [0, counts[0], counts[0] + counts[1]]
            .map(|first| (first..).map(move |index| values.iter().skip(index).step_by(width).copied().collect()));
        let mut parameters: IndexMap<&str, Vec<f64>> = names(&self.study.parameters).zip(of_parameters).collect();
        let constants = &self.study.source.constants;
        parameters.extend(constants.iter().map(|(name, value)| (name.as_str(), vec![*value; points])));
        Request::Equations {
            points,
            parameters,
            inputs: names(&self.study.inputs).zip(of_inputs).collect(),
            states: names(&self.study.states).zip(of_states).collect(),
            outputs: names(&self.study.outputs).collect(),
            mass: self.study.has_mass_matrix(),
        }
    }
}

/// A variable of the study, without a unit and a description if it gives none.
fn variable(name: &str, unit: &Option<String>, description: &Option<String>) -> SourceVariable {
    SourceVariable::new(name, unit.as_deref().unwrap_or_default(), description.as_deref().unwrap_or_default())
}

impl Launcher for &ProgramRuns {
    fn start(&self, limit: Duration, workers: Workers<'_>) -> Result<Started> {
        if self.study.source.runs_once() {
            return Ok(Some(Box::new(OneShot::new(self)?)));
        }
        // numbers of up to 25 characters, and what else a program adds
        let states = self.study.states.len();
        let numbers = self.times.len().max(64) * (self.study.outputs.len() + states + states * states);
        let started = RunningProgram::start(&self.command, numbers, limit, workers.stop);
        let started = started.map_err(|error| self.study.refusal("source.command", error.to_string()))?;
        let Some((program, description)) = started else { return Ok(None) };
        self.study.refuse(description::differences(&description, &self.study))?;
        Ok(Some(Box::new(ProgramProcess { program, runs: (*self).clone() })))
    }
}

/// Requests the description of a program; none if that is interrupted.
///
/// # Errors
/// [`Error::Worker`] if it does not answer, [`Error::Io`] if it cannot be started.
pub fn describe(command: &ProgramCommand, limit: Duration, stop: &AtomicBool) -> Result<Option<ProgramDescription>> {
    let started = RunningProgram::start(command, 0, limit, stop)?;
    Ok(started.map(|(program, description)| {
        program.finish();
        description
    }))
}

impl ProgramCommand {
    /// A program and its arguments, to be started in a folder.
    pub fn new(arguments: Vec<String>, folder: &Path) -> Self {
        let here = folder.as_os_str().is_empty();
        Self { arguments, folder: if here { PathBuf::from(".") } else { folder.to_owned() } }
    }

    fn name(&self) -> String {
        self.arguments.join(" ")
    }

    fn command(&self, arguments: &[String]) -> Command {
        let (program, arguments) = arguments.split_first().map_or(("", arguments), |(program, rest)| (program, rest));
        // a path is relative to the folder on every platform; a name is searched on the PATH
        let is_path = Path::new(program).components().count() > 1;
        let beside = self.folder.canonicalize().ok().filter(|_| is_path).map(|folder| folder.join(program));
        let mut command = beside.map_or_else(|| Command::new(program), Command::new);
        command.args(arguments).current_dir(&self.folder);
        for name in THREADS.into_iter().filter(|name| std::env::var_os(name).is_none()) {
            command.env(name, "1");
        }
        command
    }

    /// Starts the program with these arguments.
    fn spawn<M: Send + 'static>(
        &self,
        arguments: &[String],
        read: impl FnMut(&mut ReplyStream) -> Option<M> + Send + 'static,
    ) -> Result<ChildProcess<M>> {
        let started = ChildProcess::start(self.command(arguments), "the program ended", read, |_| {});
        started.map_err(Error::io(Path::new(&self.name()), "start"))
    }
}

/// A request with its number.
#[derive(Serialize)]
struct Numbered<'a> {
    id: u64,
    #[serde(flatten)]
    request: Request<'a>,
}

/// A program that answers requests.
struct RunningProgram {
    process: ChildProcess<Vec<u8>>,
    name: String,
    id: u64,
}

impl RunningProgram {
    /// Starts a program whose replies have at most `numbers` numbers, and requests its description; none if that is
    /// interrupted.
    fn start(
        command: &ProgramCommand,
        numbers: usize,
        limit: Duration,
        stop: &AtomicBool,
    ) -> Result<Option<(Self, ProgramDescription)>> {
        let longest = (1 << 20) + 64 * numbers as u64;
        let process = command.spawn(&command.arguments, move |output: &mut ReplyStream| {
            let mut line = Vec::new();
            let count = output.by_ref().take(longest).read_until(b'\n', &mut line).ok()?;
            (count > 0).then_some(line)
        })?;
        let mut program = Self { process, name: command.name(), id: 0 };
        match program.ask(Request::Describe { protocol: PROTOCOL }, limit, stop) {
            Answer::Line(line) => match ProgramDescription::parse(&line, program.id) {
                Ok(description) => Ok(Some((program, description))),
                Err(error) => Err(program.refused(error)),
            },
            Answer::Ended(reason) => Err(program.refused(reason)),
            Answer::TimedOut => {
                Err(program.refused(format_args!("no description within {limit:?} (source.time_limit)")))
            }
            Answer::Stopped => Ok(None),
        }
    }

    fn refused(&self, reason: impl fmt::Display) -> Error {
        Error::Worker { message: format!("{}: {reason}", self.name) }
    }

    /// Closes standard input, at whose end the program ends.
    fn finish(mut self) {
        self.process.close();
        self.process.finish();
    }

    fn ask(&mut self, request: Request, limit: Duration, stop: &AtomicBool) -> Answer {
        self.id += 1;
        self.process.ask(&Numbered { id: self.id, request });
        match self.process.reply(Some(limit), stop) {
            ReplyStatus::Reply(line) => Answer::Line(line),
            ReplyStatus::Died(end) => Answer::Ended(end.message),
            ReplyStatus::TimedOut => Answer::TimedOut,
            ReplyStatus::Stopped => Answer::Stopped,
        }
    }
}

/// Result of a request to a program.
enum Answer {
    Line(Vec<u8>),
    /// The process ended, with the reason.
    Ended(String),
    TimedOut,
    Stopped,
}

/// A program with its description.
struct ProgramProcess {
    program: RunningProgram,
    runs: ProgramRuns,
}

impl WorkerProcess for ProgramProcess {
    fn run(&mut self, values: &[f64], limit: Duration, stop: &AtomicBool) -> WorkerReply {
        let Self { program, runs } = self;
        let request = match runs.is_of_equations {
            true => runs.request_of_equations(values),
            false => runs.request_of_run(values),
        };
        let points = if let Request::Equations { points, .. } = &request { *points } else { 0 };
        let line = match program.ask(request, limit, stop) {
            Answer::Line(line) => line,
            Answer::Ended(reason) => return WorkerReply::Failed(RunFailure::new(FailureCause::Process, reason)),
            Answer::TimedOut => return WorkerReply::TimedOut,
            Answer::Stopped => return WorkerReply::Stopped,
        };
        let values = parse(&line, program.id).and_then(|reply| match runs.is_of_equations {
            true => reply.equations(&runs.study, points),
            false => reply.run(&runs.study, &runs.times, &runs.command.folder),
        });
        match values {
            Ok(values) => WorkerReply::Done(values),
            Err(error) => WorkerReply::Failed(error.into()),
        }
    }

    fn memory(&self) -> Option<u64> {
        self.program.process.memory()
    }

    fn finish(self: Box<Self>) {
        self.program.finish();
    }
}

fn names<T>(variables: &IndexMap<String, T>) -> impl Iterator<Item = &str> {
    variables.keys().map(String::as_str)
}

/// Columns of rows.
fn columns<'a>(names: impl Iterator<Item = &'a str>, rows: &[f64]) -> IndexMap<&'a str, Vec<f64>> {
    let names: Vec<&str> = names.collect();
    let columns = (0..names.len()).map(|index| rows.iter().skip(index).step_by(names.len()).copied().collect());
    names.iter().copied().zip(columns).collect()
}
