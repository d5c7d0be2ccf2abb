//! One run of an FMU in a separate process, row by row.

use super::{Job, Replies, Watch, Worker};
use crate::{
    Error, Result,
    fmi::host::{Fmu, InterfaceKind, RecordedColumn, RowSink, SimulationOptions, Unpacked, simulate_into},
    process::ReplyStatus,
};
use serde::{Deserialize, Serialize};
use std::{
    borrow::Cow,
    mem::ManuallyDrop,
    path::{Path, PathBuf},
    sync::atomic::Ordering,
    time::{Duration, Instant},
};

/// Number of numbers at which rows are sent together.
const TOGETHER: usize = 1 << 13;
/// Age of the first row at which rows are sent together.
const PROMPT: Duration = Duration::from_millis(100);

/// Task of a process that simulates an FMU.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SimulationTask {
    /// The FMU, for messages.
    path: PathBuf,
    interface: InterfaceKind,
    options: SimulationOptions,
}

/// Reply of the process during the run.
#[derive(Debug, Serialize, Deserialize)]
pub(super) enum SimulationReply {
    /// The instance exists, and these variables are recorded.
    Begun(Vec<RecordedColumn>),
    /// Rows, each with its time first.
    Rows,
    /// It is done.
    Done {
        /// `true` if the FMU ended it before its stop time.
        terminated: bool,
    },
    /// The FMU cannot be loaded, or the run failed.
    Failed(String),
}

impl From<Error> for SimulationReply {
    fn from(error: Error) -> Self {
        Self::Failed(error.to_string())
    }
}

/// Runs an unpacked FMU in a separate process and hands on its rows as they come. Returns true if the FMU ended the
/// simulation before its stop time.
///
/// The program must call [`serve`](super::serve) when its first argument is [`ARGUMENT`](super::ARGUMENT).
///
/// # Errors
/// - [`Error::Worker`]: the FMU failed, its process ended, or it took longer than the limit;
/// - [`Error::Variable`], [`Error::Experiment`]: values or times that are not finite;
/// - [`Error::Interrupted`];
/// - those of the sink, and [`Error::Io`] if no process can be started.
pub fn simulate_apart(
    unpacked: &Unpacked,
    options: &SimulationOptions,
    watch: Watch,
    sink: &mut impl RowSink,
) -> Result<bool> {
    finite(options)?;
    let path = unpacked.path();
    let task = SimulationTask { path: path.to_owned(), interface: unpacked.interface(), options: options.clone() };
    let job = Job::Simulate(Cow::Owned(task));
    let worker = Worker::start(watch.workers.program, path, unpacked.folder(), &job, watch.heard)?;
    follow(path, worker, watch, sink)
}

/// Hands on the rows of a run as they come. Returns true if an FMU ended the simulation before its stop time.
pub(super) fn follow(
    path: &Path,
    mut worker: Worker<SimulationReply>,
    watch: Watch,
    sink: &mut impl RowSink,
) -> Result<bool> {
    let begin = Instant::now();
    let (mut width, mut reached) = (None, None);
    let failed = |reached: Option<f64>, begun: bool, reason: String| {
        let when = match (reached, begun) {
            (Some(time), _) => format!("in the simulation, at {time} s or later"),
            (None, true) => "when it was initialized".into(),
            (None, false) => "when it was loaded or instantiated".into(),
        };
        Error::Worker { message: format!("{}: {when}, {reason}", path.display()) }
    };
    loop {
        let left = watch.limit.map(|limit| limit.saturating_sub(begin.elapsed()));
        let (reply, numbers) = match worker.reply(left, watch.workers.stop) {
            // replies may follow each other without end
            _ if watch.workers.stop.load(Ordering::Relaxed) => return Err(Error::Interrupted),
            ReplyStatus::Reply((SimulationReply::Rows, _)) | ReplyStatus::TimedOut
                if left.is_some_and(|left| left.is_zero()) =>
            {
                let seconds = watch.limit.unwrap_or_default().as_secs_f64();
                return Err(failed(
                    reached,
                    width.is_some(),
                    format!("it took longer than {seconds} s (--time-limit)"),
                ));
            }
            ReplyStatus::Reply(reply) => reply,
            ReplyStatus::Died(end) => return Err(failed(reached, width.is_some(), end.message)),
            ReplyStatus::TimedOut => continue,
            ReplyStatus::Stopped => return Err(Error::Interrupted),
        };
        match (reply, width) {
            (SimulationReply::Begun(columns), None) => {
                sink.begin(&columns)?;
                width = Some(columns.len() + 1);
            }
            (SimulationReply::Rows, Some(width)) if numbers.len().is_multiple_of(width) => {
                for row in numbers.chunks_exact(width) {
                    sink.row(row[0], &row[1..])?;
                    reached = Some(row[0]);
                }
            }
            (SimulationReply::Done { terminated }, Some(_)) => {
                worker.finish();
                return Ok(terminated);
            }
            (SimulationReply::Failed(message), _) => {
                worker.finish();
                return Err(Error::Worker { message });
            }
            _ => return Err(failed(reached, width.is_some(), "its process sent a reply that made no sense".into())),
        }
    }
}

/// Refuses numbers that are not finite, which do not reach the other process unchanged.
fn finite(options: &SimulationOptions) -> Result<()> {
    let SimulationOptions { start, stop, step, .. } = *options;
    if [start, stop, step].into_iter().flatten().any(|time| !time.is_finite()) {
        return Err(Error::Experiment { start: start.unwrap_or(0.0), stop, step, expected: "finite times" });
    }
    let inputs = &options.inputs;
    let over_time = inputs.rows.iter().flat_map(|row| inputs.names.iter().zip(row));
    let starts = options.start_values.iter().map(|(name, value)| (name, value));
    match starts.chain(over_time).find(|(_, value)| !value.is_finite()) {
        Some((name, value)) => {
            Err(Error::Variable { name: name.clone(), problem: format!("value {value}, expected a finite number") })
        }
        None => Ok(()),
    }
}

/// Makes the run and sends its result.
pub(super) fn serve(task: &SimulationTask, folder: &Path, mut replies: Replies) -> Result<()> {
    // an FMU need not survive that its library is unloaded
    let fmu = match Fmu::open_unpacked(&task.path, folder, task.interface) {
        Ok(fmu) => ManuallyDrop::new(fmu),
        Err(error) => return replies.send(&SimulationReply::from(error), &[]),
    };
    let instance = match fmu.instantiate("metafmu", false) {
        Ok(instance) => instance,
        Err(error) => return replies.send(&SimulationReply::from(error), &[]),
    };
    let mut sender = Sender::new(&mut replies);
    match simulate_into(&instance, &task.options, &mut sender) {
        Ok(terminated) => {
            sender.send()?;
            drop(instance);
            replies.send(&SimulationReply::Done { terminated }, &[])
        }
        // before the instance is freed, which may not go well either
        Err(error) => replies.send(&SimulationReply::from(error), &[]),
    }
}

/// Sends rows, several at once.
pub(super) struct Sender<'a> {
    replies: &'a mut Replies,
    numbers: Vec<f64>,
    sent: Option<Instant>,
}

impl<'a> Sender<'a> {
    pub(super) fn new(replies: &'a mut Replies) -> Self {
        Self { replies, numbers: Vec::new(), sent: None }
    }

    pub(super) fn send(&mut self) -> Result<()> {
        self.replies.send(&SimulationReply::Rows, &self.numbers)?;
        self.numbers.clear();
        self.sent = Some(Instant::now());
        Ok(())
    }
}

impl RowSink for Sender<'_> {
    fn begin(&mut self, columns: &[RecordedColumn]) -> Result<()> {
        self.replies.send(&SimulationReply::Begun(columns.to_vec()), &[])
    }

    fn row(&mut self, time: f64, values: &[f64]) -> Result<()> {
        self.numbers.push(time);
        self.numbers.extend_from_slice(values);
        // the first row shows that the initialization is over
        if self.numbers.len() >= TOGETHER || self.sent.is_none_or(|sent| sent.elapsed() > PROMPT) {
            self.send()?;
        }
        Ok(())
    }
}
