//! Stages of the commands, without a terminal: from a study file to validated FMUs, for every program.
//!
//! A [`Project`] is a study with its source and its folder of results. Each stage reads the results of the one before
//! from that folder, reports its progress to a [`PipelineObserver`], and ends when its stop token is set. Nothing here
//! prints, reads the command line, or depends on the program that runs it.

pub mod build;
pub mod compare;
pub mod cost;
pub mod evaluate;
pub mod export;
pub mod import;
pub mod measured;
pub mod plan;
pub mod predict;
pub mod report;
pub mod rounds;
pub mod sample;
pub mod search;
mod speed;
pub mod stages;
pub mod train;
mod training;
pub mod trial;

pub use build::{Built, build};
pub use compare::compare;
pub use evaluate::evaluate;
pub use predict::predict;
pub use report::report;
pub use search::search;

pub use crate::kinds::{ResultFile, record, static_map::fit};
pub use crate::project::{
    Control, CountedWork, Event, FailedRun, PipelineObserver, Project, SamplesRecord, Silent, describe,
};
use crate::{Result, export::serve_worker, fmi::worker};

/// Does the work of a worker process if this process was started as one; after that the program must end. Programs that
/// name themselves in [`Control::program`] call it first thing.
///
/// # Errors
/// [`Error::Io`](crate::Error::Io) of the streams, [`Error::Worker`](crate::Error::Worker) if it was not started by a program as a worker.
pub fn serve_workers() -> Result<bool> {
    match std::env::args().nth(1).as_deref() {
        Some(worker::ARGUMENT) => serve_worker()?,
        Some(compare::FIT_BASELINE) => compare::work()?,
        _ => return Ok(false),
    }
    Ok(true)
}
