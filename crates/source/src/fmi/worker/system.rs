//! One run of a system of FMUs in a separate process, row by row.

use super::{
    Job, Replies, Watch, Worker,
    simulation::{Sender, SimulationReply, follow},
};
use crate::{
    Result,
    fmi::{
        host::RowSink,
        system::{master::folder, run::SystemRun},
    },
};
use std::{borrow::Cow, path::Path};

/// Runs a system, all of its components in one separate process, and hands on its rows as they come; `path` is for
/// messages. Returns true if an FMU ended the simulation before its stop time.
///
/// The program must call [`serve`](super::serve) when its first argument is [`ARGUMENT`](super::ARGUMENT).
///
/// # Errors
/// - [`Error::Worker`](crate::Error::Worker): an FMU failed, their process ended, or it took longer than the limit;
/// - [`Error::Interrupted`](crate::Error::Interrupted);
/// - those of the sink, and [`Error::Io`](crate::Error::Io) if no process can be started.
pub fn run_system_apart(path: &Path, run: &SystemRun, watch: Watch, sink: &mut impl RowSink) -> Result<bool> {
    let job = Job::System(Cow::Borrowed(run));
    // should this process be killed, the other FMUs' folders are removed when another is unpacked
    let worker = Worker::start(watch.workers.program, path, folder(run), &job, watch.heard)?;
    follow(path, worker, watch, sink)
}

/// Makes the run and sends its result.
pub(super) fn serve(run: &SystemRun, mut replies: Replies) -> Result<()> {
    let loaded = match run.load() {
        Ok(loaded) => loaded,
        Err(error) => return replies.send(&SimulationReply::from(error), &[]),
    };
    let instances = match run.instantiate(&loaded) {
        Ok(instances) => instances,
        Err(error) => return replies.send(&SimulationReply::from(error), &[]),
    };
    let mut sender = Sender::new(&mut replies);
    match run.simulate(&instances, &mut sender) {
        Ok(terminated) => {
            sender.send()?;
            drop(instances);
            replies.send(&SimulationReply::Done { terminated }, &[])
        }
        // before the instances are freed, which may not go well either
        Err(error) => replies.send(&SimulationReply::from(error), &[]),
    }
}
