//! Checks of a binary in a separate process.

use super::{Job, Replies, Watch, Worker};
use crate::{
    Error, Result,
    fmi::{
        Archive, Fmu, InterfaceKind,
        host::Unpacked,
        validate::{Area, Checks, Note, Notes, Report, check_binary, examine},
    },
    process::ReplyStatus,
};
use serde::{Deserialize, Serialize};
use std::{
    borrow::Cow,
    path::{Path, PathBuf},
};

/// An FMU whose binary is to be checked.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ValidationTask {
    path: PathBuf,
    interface: InterfaceKind,
}

/// A reply of the process.
#[derive(Debug, Serialize, Deserialize)]
enum ValidationReply {
    Note(Note),
    Done,
}

/// Checks an FMU as [`validate`](crate::fmi::validate()) does, but runs it in a separate process for each interface.
/// The end of that process, or a check that takes longer than the limit, is a further problem.
///
/// The program must call [`serve`](super::serve) when its first argument is [`ARGUMENT`](super::ARGUMENT).
///
/// # Errors
/// Those of [`validate`](crate::fmi::validate()), [`Error::Interrupted`], and [`Error::Io`] if no process can be started.
pub fn validate_apart(path: impl AsRef<Path>, watch: Watch, checks: &dyn Checks) -> Result<Report> {
    examine(path.as_ref(), checks, watch.patience(), &mut |unpacked, report| run_apart(&unpacked, watch, report))
}

fn run_apart(unpacked: &Unpacked, watch: Watch, report: &mut Report) -> Result<()> {
    let (path, interface) = (unpacked.path(), unpacked.interface());
    let job = Job::Validate(Cow::Owned(ValidationTask { path: path.to_owned(), interface }));
    let mut worker = Worker::start(watch.workers.program, path, unpacked.folder(), &job, watch.heard)?;
    let mut doing = "loading the FMU".to_owned();
    let problem = loop {
        match worker.reply(watch.limit, watch.workers.stop) {
            ReplyStatus::Reply((ValidationReply::Note(Note::Doing(what)), _)) => doing = what,
            ReplyStatus::Reply((ValidationReply::Note(note), _)) => report.add(note),
            ReplyStatus::Reply((ValidationReply::Done, _)) => {
                worker.finish();
                return Ok(());
            }
            ReplyStatus::Died(end) => break end.message,
            ReplyStatus::TimedOut => {
                let seconds = watch.limit.unwrap_or_default().as_secs_f64();
                break format!("took longer than {seconds} s (--time-limit)");
            }
            ReplyStatus::Stopped => return Err(Error::Interrupted),
        }
    };
    report.problem(Area::Behavior, format!("{interface}, {doing}: {problem}"));
    report.skipped(format!("{interface} after {doing}: the process had ended"));
    Ok(())
}

/// Checks the FMU in a folder and sends the findings.
pub fn serve(task: &ValidationTask, folder: &Path, checks: &dyn Checks, mut replies: Replies) -> Result<()> {
    let mut sent = Ok(());
    let mut send = |note| {
        if sent.is_ok() {
            sent = replies.send(&ValidationReply::Note(note), &[]);
        }
    };
    let mut notes = Notes(&mut send);
    match Fmu::open_unpacked(&task.path, folder, task.interface) {
        Ok(fmu) => {
            check_binary(&fmu, &mut Archive::open(&task.path)?, checks, &mut notes);
            notes.doing("unloading the FMU");
        }
        Err(error) => notes.problem(Area::Binary, error.to_string()),
    }
    sent?;
    replies.send(&ValidationReply::Done, &[])
}
