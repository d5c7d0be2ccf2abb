//! The result of a training is not lost if it cannot be written to its folder: a full disk, or a folder that is gone.

use super::Project;
use crate::{Error, Result, files};
use std::{
    path::PathBuf,
    sync::atomic::Ordering,
    time::{Duration, Instant},
};

/// Longest wait for room, if the results cannot go anywhere else.
const PATIENCE: Duration = Duration::from_secs(3600);
/// Time between two attempts.
const PAUSE: Duration = Duration::from_secs(2);

/// Has results written to the project's folder. If that fails, they go to a new folder beside other temporary files, which the error
/// names. If that is full as well, they are kept in memory and tried again, for an hour or until Ctrl-C.
pub fn write(project: &Project, write: impl Fn(&Project) -> Result<()>) -> Result<()> {
    let Err(mut error) = write(project) else { return Ok(()) };
    if !matches!(error, Error::Io { .. }) {
        return Err(error);
    }
    match elsewhere(project, &write) {
        Ok(folder) => {
            let place = project.folder().display();
            return Err(beside(error, &format!("the results are in {}: move them to {place}", folder.display())));
        }
        Err(_) if !files::is_full(&error) => return Err(error),
        Err(other) => project.say(format_args!("{error}\n{other}")),
    }
    project.say("the trained network is in memory, waiting for room; Ctrl-C gives it up");
    let began = Instant::now();
    while began.elapsed() < PATIENCE && pause(project) {
        match write(project) {
            Err(again) if files::is_full(&again) => error = again,
            done => return done,
        }
    }
    let left = if project.is_unfinished() { ": --resume continues from the last checkpoint" } else { "" };
    Err(beside(error, &format!("the trained network is lost{left}")))
}

/// Writes into a new folder among the temporary files.
fn elsewhere(project: &Project, write: impl Fn(&Project) -> Result<()>) -> Result<PathBuf> {
    let all = std::env::temp_dir();
    let folder = tempfile::Builder::new().prefix(&format!("metafmu-{}-", project.study.name)).tempdir_in(&all);
    let folder = folder.map_err(Error::io(&all, "write into the folder"))?;
    write(&project.with_folder(folder.path().to_owned()))?;
    Ok(folder.keep())
}

/// Waits for the next attempt; false at a Ctrl-C.
fn pause(project: &Project) -> bool {
    let began = Instant::now();
    while began.elapsed() < PAUSE {
        if project.control().stop.swap(false, Ordering::Relaxed) {
            return false;
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    true
}

/// The error with what became of the results.
fn beside(error: Error, what: &str) -> Error {
    match error {
        Error::Io { path, action, source } => {
            let source = std::io::Error::new(source.kind(), format!("{source}; {what}"));
            Error::Io { path, action, source }
        }
        other => other,
    }
}
