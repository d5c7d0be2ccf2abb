//! Course of a training: its progress and its checkpoints.

use crate::{
    Error, Result, files,
    project::{CountedWork, Event, Project},
    study::TrainingOptions,
    training::{self, EpochRecord, Observer, Outcome, TrainingError, write_history},
};
use std::{
    fmt,
    ops::ControlFlow,
    path::{Path, PathBuf},
    sync::atomic::{AtomicUsize, Ordering},
    time::{Duration, Instant},
};

/// Share of the time that may go into writing checkpoints.
const CHECKPOINT_SHARE: f64 = 0.05;

/// A training with at least one complete epoch: before that there is no network to keep.
pub(crate) fn at_least_one_epoch(project: &Project, outcome: Outcome) -> Result<Outcome> {
    outcome.completed().map_err(|error| {
        let error = Error::from(error);
        if matches!(error, Error::Interrupted) {
            project.finish("the first epoch is not complete: there is no network to keep");
        }
        error
    })
}

/// A training; none if Ctrl-C ended it before its first epoch was complete and an earlier one is there to keep.
///
/// # Errors
/// Those of the training.
pub(crate) fn unless_interrupted<T>(project: &Project, trained: Result<T>, has_earlier: bool) -> Result<Option<T>> {
    match trained {
        Err(Error::Interrupted) if has_earlier => {
            project.control().stop.store(false, Ordering::Relaxed);
            Ok(None)
        }
        other => other.map(Some),
    }
}

pub(crate) fn load_checkpoint(project: &Project, resume: bool) -> Result<Option<Vec<u8>>> {
    let path = project.checkpoint();
    if !resume {
        return Ok(None);
    }
    if !path.exists() {
        project.say(format_args!("no checkpoint in {}: the training begins", path.display()));
        return Ok(None);
    }
    std::fs::read(&path).map(Some).map_err(Error::io(&path, "read"))
}

pub(crate) fn unusable_checkpoint(path: PathBuf, error: TrainingError) -> Error {
    match error {
        TrainingError::Checkpoint { problem } => {
            let message = format!("{problem}: train without --resume to start from scratch");
            Error::Stale { path, message }
        }
        other => other.into(),
    }
}

/// Checkpoints of several trainings, one after the other: one for each, completed ones included.
pub(crate) struct Checkpoints<'a> {
    project: &'a Project<'a>,
    resume: bool,
    /// Trainings so far.
    count: AtomicUsize,
}

impl<'a> Checkpoints<'a> {
    /// Checkpoints of a resumed training, or of one that starts from scratch.
    pub(crate) fn new(project: &'a Project<'a>, resume: bool) -> Result<Self> {
        if !resume {
            project.remove_checkpoints()?;
        }
        Ok(Self { project, resume, count: AtomicUsize::new(0) })
    }

    /// The file of the next training, and its content if that is resumed.
    pub(crate) fn next(&self) -> Result<(PathBuf, Option<Vec<u8>>)> {
        let path = self.project.checkpoint_of(self.count.fetch_add(1, Ordering::Relaxed) + 1);
        let bytes = if self.resume && path.exists() {
            Some(std::fs::read(&path).map_err(Error::io(&path, "read"))?)
        } else {
            None
        };
        Ok((path, bytes))
    }
}

/// Reports the progress of the training, ends it if the work must stop, and keeps its checkpoints.
pub(crate) struct Follower<'a> {
    project: &'a Project<'a>,
    /// Rows of an epoch.
    rows: usize,
    epochs: usize,
    history: Vec<EpochRecord>,
    /// The epochs that were done when the first step of this process was, and when that was.
    began: Option<(f64, Instant)>,
    /// When the last checkpoint was complete, and how long it took.
    written: Option<(Instant, Duration)>,
    /// Path of checkpoints, if they are written, and `true` if the last epoch has one as well.
    checkpoints: Option<(PathBuf, bool)>,
}

impl<'a> Follower<'a> {
    pub(crate) fn new(project: &'a Project<'a>, rows: usize) -> Self {
        Self::with(project, &project.study.training, rows)
    }

    /// Follower with other options than the study's.
    pub(crate) fn with(project: &'a Project<'a>, options: &TrainingOptions, rows: usize) -> Self {
        project.begin(CountedWork::Steps, rows.div_ceil(options.batch) * options.epochs);
        Self {
            project,
            rows,
            epochs: options.epochs,
            history: Vec::new(),
            began: None,
            written: None,
            checkpoints: Some((project.checkpoint(), false)),
        }
    }

    /// Follower of a network that is one of several.
    pub(crate) fn without_checkpoints(self) -> Self {
        Self { checkpoints: None, ..self }
    }

    /// Follower of a network that is one of several, and whose checkpoints go to a separate file.
    pub(crate) fn with_checkpoint(self, path: PathBuf) -> Self {
        Self { checkpoints: Some((path, true)), ..self }
    }

    fn speed(&mut self, done: f64) -> TrainingSpeed {
        let (before, began) = *self.began.get_or_insert((done, Instant::now()));
        TrainingSpeed { done: done - before, left: self.epochs as f64 - done, began, rows: self.rows }
    }

    fn write_checkpoint(
        &mut self,
        path: &Path,
        make: &mut dyn FnMut() -> std::result::Result<Vec<u8>, TrainingError>,
    ) -> Result<()> {
        let began = Instant::now();
        let bytes = make()?;
        files::write_whole(path, &bytes)?;
        if path == self.project.checkpoint() {
            write_history(&self.project.history(), &self.history)?;
        }
        self.written = Some((Instant::now(), began.elapsed()));
        Ok(())
    }
}

impl Observer for Follower<'_> {
    fn step(&mut self, progress: &training::Progress) -> ControlFlow<()> {
        let training::Progress { epoch, epochs, step, steps, loss } = *progress;
        let speed = self.speed((epoch - 1) as f64 + step as f64 / steps as f64);
        let about = format_args!("epoch {epoch}/{epochs}, loss {loss:.2e}, {speed}");
        self.project.event(Event::Progress { done: (epoch - 1) * steps + step, about });
        if self.project.is_stopped() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    fn resumed(&mut self, history: &[EpochRecord]) {
        self.history = history.to_vec();
        self.project.say(format_args!("continuing after epoch {}", history.len()));
    }

    fn epoch(&mut self, record: &EpochRecord) {
        self.history.push(*record);
        let EpochRecord { epoch, train_loss, validation_loss, .. } = *record;
        let epochs = self.epochs;
        if epoch % epochs.div_ceil(10) == 0 || epoch == epochs {
            let speed = self.speed(epoch as f64);
            self.project.note(format_args!(
                "epoch {epoch}/{epochs}: loss {train_loss:.2e}, on held-out runs {validation_loss:.2e}, {speed}"
            ));
        }
    }

    fn checkpoint(&mut self, epoch: usize, make: &mut dyn FnMut() -> std::result::Result<Vec<u8>, TrainingError>) {
        let Some((path, keeps_last)) = self.checkpoints.clone() else { return };
        let due = self.written.is_none_or(|(at, took)| at.elapsed().mul_f64(CHECKPOINT_SHARE) >= took);
        if if epoch == self.epochs { !keeps_last } else { !due } {
            return;
        }
        // a full disk must not cost the training
        if let Err(error) = self.write_checkpoint(&path, make) {
            self.project.warn(format_args!("no checkpoint: {error}"));
        }
    }
}

/// Speed of a training: rows per second, and the remaining seconds at this speed, as text.
struct TrainingSpeed {
    /// Epochs that this process has done, and those that are left.
    done: f64,
    left: f64,
    began: Instant,
    rows: usize,
}

impl fmt::Display for TrainingSpeed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let epochs_per_second = self.done / self.began.elapsed().as_secs_f64();
        if !epochs_per_second.is_normal() {
            return f.write_str("no speed yet");
        }
        let left = self.left / epochs_per_second;
        write!(f, "{:.2e} rows/s, {left:.0} s left", epochs_per_second * self.rows as f64)
    }
}
