//! Trains the network on the sampled runs and writes the surrogate.

use super::{
    discrete::{self, DiscreteRecord},
    evaluate::constants,
    motion::{self, MotionRecord},
    observer::{Event, Work},
    per_instant,
    prepare::{Prepared, held_out, prepare},
    project::Project,
    rescue, rounds,
    state_space::{self, StateSpaceRecord},
    trajectories::{self, TrajectoriesRecord},
};
use crate::{
    Error, Result,
    acceptance::{self, OfTraining},
    calibration,
    dataset::Dataset,
    evaluation::Accuracy,
    evaluation::Verdict,
    files,
    study::{Structure, Study, StudyStructure, TrainingOptions},
    surrogate,
    training::{self, EpochRecord, Observer, Outcome, StopReason, TrainingError, write_history},
};
use metafmu_runtime::{Map, Model, Output, ScaledNetwork, Surrogate};
use serde::{Deserialize, Serialize};
use std::{
    fmt,
    ops::ControlFlow,
    path::{Path, PathBuf},
    sync::atomic::{AtomicUsize, Ordering},
    time::{Duration, Instant},
};

/// Share of the time that may go into writing checkpoints.
const CHECKPOINT_SHARE: f64 = 0.05;

/// How the training went.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct TrainingRecord {
    /// Rows that the network was trained on.
    pub train_rows: usize,
    /// Runs that were held out of the training.
    pub validation_runs: usize,
    /// Epochs that were done.
    pub epochs: usize,
    /// The epoch that is kept, the best on the held-out runs.
    pub best_epoch: usize,
    /// Why it ended.
    pub stopped: StopReason,
    /// Wall time of the training.
    pub train_seconds: f64,
    /// Runs that were added to the plan's to meet the study's target.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub added_runs: usize,
    /// Whether the study's target was met, if it has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub target_met: Option<bool>,
    /// What was found by least squares, of a surrogate with states.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub motion: Option<MotionRecord>,
    /// What was learned of the equations of an FMU.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub state_space: Option<StateSpaceRecord>,
    /// What was learned from the motions of a table.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub trajectories: Option<TrajectoriesRecord>,
    /// What was learned of recorded runs with inputs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub discrete: Option<DiscreteRecord>,
}

impl TrainingRecord {
    /// Whether it was stopped before its end.
    pub fn was_interrupted(&self) -> bool {
        self.stopped == StopReason::Interrupted
    }

    /// What is known of the training itself, regardless of the accuracy.
    pub fn findings(&self, study: &Study) -> OfTraining {
        OfTraining { problems: self.problems(study), advice: self.advice(study) }
    }

    fn problems(&self, study: &Study) -> Vec<String> {
        let Self { epochs, stopped, target_met, motion, state_space, trajectories, .. } = self;
        let poor = motion.as_ref().and_then(MotionRecord::problem);
        let poor = poor.or(state_space.as_ref().and_then(StateSpaceRecord::problem));
        let poor = poor.or(trajectories.as_ref().and_then(TrajectoriesRecord::problem));
        let diverged = *stopped == StopReason::Diverged;
        let diverged = diverged.then(|| format!("the training diverged after {epochs} epochs: {stopped}"));
        let short = study
            .target
            .filter(|_| *target_met == Some(false))
            .map(|target| format!("not every output reached an R² of {} on the held-out runs (target.r2)", target.r2));
        diverged.into_iter().chain(short).chain(poor).collect()
    }

    /// What may make the surrogate better, the surest first.
    fn advice(&self, study: &Study) -> Vec<String> {
        let Self { epochs, stopped, train_rows, .. } = self;
        let longer = match stopped {
            StopReason::Interrupted => Some("continue the training that was stopped: --resume".into()),
            StopReason::Finished => Some(format!("train longer: `training.epochs` above {epochs}")),
            _ => None,
        };
        let more = match (study.structure, study.source.is_recorded()) {
            (_, true) => format!("record more runs: these have {train_rows} training rows"),
            (StudyStructure::Dynamics, false) => "more `sampling.states`, or smaller ranges".into(),
            (_, false) => {
                let runs = study.sampling.runs.map_or(String::new(), |runs| format!(" above {runs}"));
                format!("add runs: `sampling.runs`{runs}, or a `[target]`")
            }
        };
        let memory = format!("a longer memory: `discrete.history` above {}", study.discrete.history);
        let memory = (study.structure == StudyStructure::Discrete).then_some(memory);
        let larger = (*epochs > 0).then(|| "a larger network: `network.hidden`".into());
        longer.into_iter().chain([more]).chain(memory).chain(larger).collect()
    }
}

fn is_zero(count: &usize) -> bool {
    *count == 0
}

/// The verdict on a surrogate by the runs that were held out of its training: the test runs must not be used here.
pub fn judge(project: &Project, train: &Dataset, surrogate: &Surrogate, record: &TrainingRecord) -> Verdict {
    let study = &project.study;
    let accuracy = Accuracy::of(surrogate, &held_out(study, train));
    acceptance::judge(study, surrogate, (&accuracy, "held-out runs"), None, record.findings(study))
}

/// Trains, in several rounds if the study has a target. To `resume` is to take what an earlier training has finished, or else to
/// continue from its checkpoint, if there is one.
pub fn stage(
    project: &Project,
    dataset: &Dataset,
    calibration: &Dataset,
    resume: bool,
) -> Result<(Surrogate, TrainingRecord)> {
    match &project.study.target {
        None => once(project, dataset, 0, None, Some(calibration), resume),
        Some(target) => rounds::stage(project, target, dataset, calibration, resume),
    }
}

/// Trains, keeps the epoch that is best on held-out runs, measures error bounds on the calibration runs if the study wants
/// them, writes the surrogate and the history. The last `added` runs are for training only. The network begins as the one of
/// `start`, if there is one.
pub(super) fn once(
    project: &Project,
    dataset: &Dataset,
    added: usize,
    start: Option<&Surrogate>,
    calibration: Option<&Dataset>,
    resume: bool,
) -> Result<(Surrogate, TrainingRecord)> {
    if resume && let Some(finished) = finished(project)? {
        return Ok(finished);
    }
    let study = &project.study;
    let Trained { surrogate, history, record } = match study.structure {
        StudyStructure::Dynamics if study.source.fmu.is_some() => {
            state_space::train(project, dataset, &Checkpoints::new(project, resume)?)?
        }
        StudyStructure::Dynamics if study.source.is_recorded() => trajectories::train(project, dataset)?,
        StudyStructure::Dynamics => motion::train(project, dataset, &Checkpoints::new(project, resume)?)?,
        StudyStructure::Discrete => discrete::train(project, dataset)?,
        StudyStructure::Response => match study.network.structure {
            Structure::Full => train(project, dataset, added, start, resume)?,
            Structure::Fixed => per_instant::train(project, dataset, resume)?,
        },
    };
    for (Output { name, unit, .. }, constant) in constants(&surrogate) {
        let space = if unit.is_empty() { "" } else { " " };
        project
            .say(format_args!("output {name} does not vary: it is exported as the constant {constant}{space}{unit}"));
    }
    let surrogate = with_bounds(surrogate, calibration, &project.study)?;
    rescue::write(project, |project| {
        surrogate::save(&surrogate, &project.model())?;
        write_history(&project.history(), &history)?;
        files::write_json(&project.training_record(), &record)
    })?;
    if !record.was_interrupted() {
        project.remove_checkpoints()?;
    }
    Ok((surrogate, record))
}

/// The result of a training.
pub(super) struct Trained {
    pub(super) surrogate: Surrogate,
    pub(super) history: Vec<EpochRecord>,
    pub(super) record: TrainingRecord,
}

/// Trains a single network, of which the time is an input.
fn train(
    project: &Project,
    dataset: &Dataset,
    added: usize,
    start: Option<&Surrogate>,
    resume: bool,
) -> Result<Trained> {
    let (study, options) = (&project.study, &project.study.training);
    project.say(format_args!("preparing {} rows for the training", dataset.row_count()));
    let Prepared { scaling, network, training: training_rows, validation: validation_rows, validation_runs } =
        prepare(study, dataset, added, start)?;
    let mut follower = Follower::new(project, training_rows.len());
    let outcome = match load_checkpoint(project, resume)? {
        None => {
            // of any earlier training: this one starts from scratch
            project.remove_checkpoints()?;
            training::train(network, &training_rows, &validation_rows, options, study.seed, &mut follower)?
        }
        Some(bytes) => {
            training::resume(&bytes, network, &training_rows, &validation_rows, options, study.seed, &mut follower)
                .map_err(|error| unusable_checkpoint(project.checkpoint(), error))?
        }
    };
    let outcome = at_least_one_epoch(project, outcome)?;
    // a Ctrl-C that ended the training is used up: what follows is quick and uses the best network
    project.control().stop.store(false, Ordering::Relaxed);

    let record = TrainingRecord {
        train_rows: training_rows.len(),
        validation_runs,
        epochs: outcome.history.len(),
        best_epoch: outcome.best_epoch,
        stopped: outcome.reason,
        train_seconds: outcome.history.last().map_or(0.0, |epoch| epoch.seconds),
        added_runs: added,
        target_met: None,
        motion: None,
        state_space: None,
        trajectories: None,
        discrete: None,
    };
    project.finish(format_args!(
        "trained on {} rows for {} of {} epochs in {:.1} s ({}); epoch {} is the best on {} held-out runs",
        record.train_rows,
        record.epochs,
        options.epochs,
        record.train_seconds,
        record.stopped,
        record.best_epoch,
        record.validation_runs
    ));
    let network = per_instant::without_constants(&outcome.network, &training_rows);
    let model = Model::Response(Map::Network(ScaledNetwork { scaling, layers: network.to_layers() }));
    let surrogate = surrogate::assemble(study, dataset, record.train_rows, model)?;
    Ok(Trained { surrogate, history: outcome.history, record })
}

/// A training with at least one complete epoch: before that there is no network to keep.
pub(super) fn at_least_one_epoch(project: &Project, outcome: Outcome) -> Result<Outcome> {
    outcome.completed().map_err(|error| {
        let error = Error::from(error);
        if matches!(error, Error::Interrupted) {
            project.finish("the first epoch is not complete: there is no network to keep");
        }
        error
    })
}

/// The surrogate with the error bounds that the study wants.
pub(super) fn with_bounds(surrogate: Surrogate, calibration: Option<&Dataset>, study: &Study) -> Result<Surrogate> {
    let Some((options, runs)) = study.bounds.zip(calibration) else { return Ok(surrogate) };
    // runs of a table are driven by whatever they are driven by
    match calibration::bounds(&surrogate, runs, options.coverage, !study.source.is_recorded()) {
        Ok(bounds) => surrogate::with_bounds(surrogate, bounds),
        Err(message) => Err(study.refusal("bounds", message)),
    }
}

/// The surrogate of a training of this study that came to its end.
pub(super) fn finished(project: &Project) -> Result<Option<(Surrogate, TrainingRecord)>> {
    if project.is_unfinished() || !project.training_record().exists() {
        return Ok(None);
    }
    let Ok(surrogate) = project.load_model() else { return Ok(None) };
    let record = project.load_training_record()?;
    let complete = !record.was_interrupted();
    if complete {
        project.say(format_args!("{} is already finished", project.model().display()));
    }
    Ok(complete.then_some((surrogate, record)))
}

fn load_checkpoint(project: &Project, resume: bool) -> Result<Option<Vec<u8>>> {
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

pub(super) fn unusable_checkpoint(path: PathBuf, error: TrainingError) -> Error {
    match error {
        TrainingError::Checkpoint { problem } => {
            let message = format!("{problem}: train without --resume to start from scratch");
            Error::Stale { path, message }
        }
        other => other.into(),
    }
}

/// Where the trainings of several networks, one after the other, continue from: a checkpoint each, also of those that have come to their end.
pub(super) struct Checkpoints<'a> {
    project: &'a Project<'a>,
    resume: bool,
    /// Trainings so far.
    count: AtomicUsize,
}

impl<'a> Checkpoints<'a> {
    /// Those of a training that is resumed, or of one that starts from scratch.
    pub(super) fn new(project: &'a Project<'a>, resume: bool) -> Result<Self> {
        if !resume {
            project.remove_checkpoints()?;
        }
        Ok(Self { project, resume, count: AtomicUsize::new(0) })
    }

    /// The file of the next training, and its content if that is resumed.
    pub(super) fn next(&self) -> Result<(PathBuf, Option<Vec<u8>>)> {
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
pub(super) struct Follower<'a> {
    project: &'a Project<'a>,
    /// Rows of an epoch.
    rows: usize,
    epochs: usize,
    history: Vec<EpochRecord>,
    /// The epochs that were done when the first step of this process was, and when that was.
    began: Option<(f64, Instant)>,
    /// When the last checkpoint was complete, and how long it took.
    written: Option<(Instant, Duration)>,
    /// Where checkpoints go, if they are kept, and whether that is also one of the last epoch.
    checkpoints: Option<(PathBuf, bool)>,
}

impl<'a> Follower<'a> {
    pub(super) fn new(project: &'a Project<'a>, rows: usize) -> Self {
        Self::with(project, &project.study.training, rows)
    }

    /// With other options than the study's.
    pub(super) fn with(project: &'a Project<'a>, options: &TrainingOptions, rows: usize) -> Self {
        project.begin(Work::Steps, rows.div_ceil(options.batch) * options.epochs);
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

    /// For a network that is one of several.
    pub(super) fn without_checkpoints(self) -> Self {
        Self { checkpoints: None, ..self }
    }

    /// For a network that is one of several, and whose checkpoints go to a file of its own.
    pub(super) fn with_checkpoint(self, path: PathBuf) -> Self {
        Self { checkpoints: Some((path, true)), ..self }
    }

    fn speed(&mut self, done: f64) -> Speed {
        let (before, began) = *self.began.get_or_insert((done, Instant::now()));
        Speed { done: done - before, left: self.epochs as f64 - done, began, rows: self.rows }
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

/// Rows per second and the seconds left at this speed, in words.
struct Speed {
    /// Epochs that this process has done, and those that are left.
    done: f64,
    left: f64,
    began: Instant,
    rows: usize,
}

impl fmt::Display for Speed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let epochs_per_second = self.done / self.began.elapsed().as_secs_f64();
        if !epochs_per_second.is_normal() {
            return f.write_str("no speed yet");
        }
        let left = self.left / epochs_per_second;
        write!(f, "{:.2e} rows/s, {left:.0} s left", epochs_per_second * self.rows as f64)
    }
}
