//! `metafmu train`: trains the network on the sampled runs and writes the surrogate.

use super::{
    Outcome, improve, instants, interrupt,
    job::Job,
    prepare::{Prepared, held_out, prepare},
    print, print_json,
    progress::Progress,
    rescue, say,
};
use crate::cli::TrainArgs;
use metafmu::{
    Error, Result,
    acceptance::{self, Verdict},
    calibration,
    dataset::Dataset,
    evaluation::Accuracy,
    files,
    study::{Structure, Study},
    surrogate,
    training::{self, EpochRecord, Observer, StopReason, TrainingError},
};
use metafmu_runtime::{Model, ScaledNetwork, Surrogate};
use serde::{Deserialize, Serialize};
use std::{
    ops::ControlFlow,
    sync::atomic::Ordering,
    time::{Duration, Instant},
};

/// Share of the time that may go into writing checkpoints.
const CHECKPOINT_SHARE: f64 = 0.05;

/// How the training went.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct TrainingRecord {
    pub train_rows: usize,
    pub validation_runs: usize,
    pub epochs: usize,
    pub best_epoch: usize,
    pub stopped: String,
    pub train_seconds: f64,
    /// Runs that were added to the plan's to meet the study's target.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub added_runs: usize,
    /// Whether the study's target was met, if it has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub target_met: Option<bool>,
}

impl TrainingRecord {
    /// What is wrong with the training, whatever the accuracy is.
    pub fn problems(&self, study: &Study) -> Vec<String> {
        let Self { epochs, stopped, target_met, .. } = self;
        let diverged = stopped == describe(StopReason::Diverged);
        let diverged = diverged.then(|| format!("the training diverged after {epochs} epochs: {stopped}"));
        let short = study
            .target
            .filter(|_| *target_met == Some(false))
            .map(|target| format!("not every output reached an R² of {} on the held-out runs (target.r2)", target.r2));
        diverged.into_iter().chain(short).collect()
    }
}

/// What `train` prints as JSON.
#[derive(Serialize)]
struct Printed<'a> {
    #[serde(flatten)]
    record: &'a TrainingRecord,
    verdict: &'a Verdict,
}

fn is_zero(count: &usize) -> bool {
    *count == 0
}

pub fn run(args: &TrainArgs) -> Result<Outcome> {
    let job = Job::new(&args.study)?;
    let (train, calibration) = (job.load_table("train")?, job.load_table("calibration")?);
    job.prepare_folder()?;
    let (surrogate, record) = stage(&job, &train, &calibration, args.resume)?;
    // the test runs are not for this: on those that were held out
    let accuracy = Accuracy::of(&surrogate, &held_out(&job.study, &train));
    let of_outputs = acceptance::problems(&job.study, &surrogate, &accuracy, None, "held-out runs");
    let verdict = Verdict::of([record.problems(&job.study), of_outputs].concat());
    if job.json {
        print_json(&Printed { record: &record, verdict: &verdict })?;
    } else {
        print(&format!("{}\n{}\n", job.model().display(), job.history().display()))?;
    }
    let outcome = conclude(&job, &verdict)?;
    Ok(if was_interrupted(&record) { Outcome::Interrupted } else { outcome })
}

/// The last lines of a command that has made or measured a surrogate, and how it ends.
pub fn conclude(job: &Job, verdict: &Verdict) -> Result<Outcome> {
    if job.json {
        verdict.text().lines().for_each(say);
    } else {
        print(&verdict.text())?;
    }
    Ok(if verdict.accepted { Outcome::Fine } else { Outcome::ProblemsFound })
}

/// Trains, in several rounds if the study has a target. To `resume` is to take what an earlier training has finished, or else to
/// go on from its checkpoint, if there is one.
pub fn stage(job: &Job, dataset: &Dataset, calibration: &Dataset, resume: bool) -> Result<(Surrogate, TrainingRecord)> {
    match &job.study.target {
        None => once(job, dataset, 0, None, Some(calibration), resume),
        Some(target) => improve::stage(job, target, dataset, calibration, resume),
    }
}

/// Trains, keeps the epoch that is best on held-out runs, measures error bounds on the calibration runs if the study wants
/// them, writes the surrogate and the history. The last `added` runs are for training only. The network begins as the one of
/// `start`, if there is one.
pub fn once(
    job: &Job,
    dataset: &Dataset,
    added: usize,
    start: Option<&Surrogate>,
    calibration: Option<&Dataset>,
    resume: bool,
) -> Result<(Surrogate, TrainingRecord)> {
    if resume && let Some(finished) = finished(job)? {
        return Ok(finished);
    }
    let trained = match job.study.network.structure {
        Structure::Full => train(job, dataset, added, start, resume)?,
        Structure::Fixed => instants::train(job, dataset, resume)?,
    };
    let Trained { model, history, record } = trained;
    let surrogate = surrogate::assemble(&job.study, dataset, record.train_rows, model)?;
    let surrogate = with_bounds(surrogate, calibration, &job.study)?;
    rescue::write(job, |job| {
        surrogate::save(&surrogate, &job.model())?;
        write_history(job, &history)?;
        files::write_json(&job.training_record(), &record)
    })?;
    if !was_interrupted(&record) {
        files::remove(&job.checkpoint())?;
        files::remove(&job.unfinished_networks())?;
    }
    Ok((surrogate, record))
}

/// What a training leaves behind.
pub struct Trained {
    pub model: Model,
    pub history: Vec<EpochRecord>,
    pub record: TrainingRecord,
}

/// Trains a single network, of which the time is an input.
fn train(job: &Job, dataset: &Dataset, added: usize, start: Option<&Surrogate>, resume: bool) -> Result<Trained> {
    let (study, options) = (&job.study, &job.study.training);
    let Prepared { scaling, network, training: training_rows, validation: validation_rows, validation_runs } =
        prepare(study, dataset, added, start)?;
    let mut display = Display::new(job, training_rows.len());
    let outcome = match load_checkpoint(job, resume)? {
        None => {
            // of whatever training it is: this one begins anew
            files::remove(&job.checkpoint())?;
            training::train(network, &training_rows, &validation_rows, options, study.seed, &mut display)?
        }
        Some(bytes) => {
            training::resume(&bytes, network, &training_rows, &validation_rows, options, study.seed, &mut display)
                .map_err(|error| unusable_checkpoint(job, error))?
        }
    };
    // a Ctrl-C that ended the training is used up: what follows is quick and uses the best network
    interrupt::flag().store(false, Ordering::Relaxed);

    let record = TrainingRecord {
        train_rows: training_rows.len(),
        validation_runs,
        epochs: outcome.history.len(),
        best_epoch: outcome.best_epoch,
        stopped: describe(outcome.reason).into(),
        train_seconds: outcome.history.last().map_or(0.0, |epoch| epoch.seconds),
        added_runs: added,
        target_met: None,
    };
    display.progress.finish(&format!(
        "trained on {} rows for {} epochs in {:.1} s ({}); epoch {} is the best on {} held-out runs",
        record.train_rows,
        record.epochs,
        record.train_seconds,
        record.stopped,
        record.best_epoch,
        record.validation_runs
    ));
    let network = instants::without_constants(&outcome.network, &training_rows)?;
    let model = Model::Network(ScaledNetwork { scaling, layers: network.to_layers() });
    Ok(Trained { model, history: outcome.history, record })
}

/// The surrogate with the error bounds that the study wants.
pub fn with_bounds(surrogate: Surrogate, calibration: Option<&Dataset>, study: &Study) -> Result<Surrogate> {
    let wanted = study.bounds.zip(calibration);
    let bounds = wanted.and_then(|(options, runs)| calibration::bounds(&surrogate, runs, options.coverage));
    match bounds {
        None => Ok(surrogate),
        Some(bounds) => surrogate::with_bounds(surrogate, bounds),
    }
}

/// The surrogate of a training of this study that came to its end.
pub fn finished(job: &Job) -> Result<Option<(Surrogate, TrainingRecord)>> {
    let unfinished = job.checkpoint().exists() || job.unfinished_networks().exists();
    if unfinished || !job.training_record().exists() {
        return Ok(None);
    }
    let Ok(surrogate) = job.load_model() else { return Ok(None) };
    let record = job.load_training_record()?;
    let complete = !was_interrupted(&record);
    if complete {
        say(format_args!("{} is finished already", job.model().display()));
    }
    Ok(complete.then_some((surrogate, record)))
}

fn load_checkpoint(job: &Job, resume: bool) -> Result<Option<Vec<u8>>> {
    let path = job.checkpoint();
    if !resume {
        return Ok(None);
    }
    if !path.exists() {
        say(format_args!("no checkpoint in {}: the training begins", path.display()));
        return Ok(None);
    }
    std::fs::read(&path).map(Some).map_err(Error::io(&path, "read"))
}

fn unusable_checkpoint(job: &Job, error: TrainingError) -> Error {
    match error {
        TrainingError::Checkpoint { problem } => {
            let message = format!("{problem}: train without --resume to begin anew");
            Error::Stale { path: job.checkpoint(), message }
        }
        other => other.into(),
    }
}

fn write_history(job: &Job, history: &[EpochRecord]) -> Result<()> {
    files::write_with(&job.history(), |file| {
        writeln!(file, "epoch,train_loss,validation_loss,learning_rate,seconds")?;
        for EpochRecord { epoch, train_loss, validation_loss, learning_rate, seconds, .. } in history {
            writeln!(file, "{epoch},{train_loss:e},{validation_loss:e},{learning_rate:e},{seconds:.3}")?;
        }
        Ok(())
    })
}

/// Whether the training was stopped before its end.
pub fn was_interrupted(record: &TrainingRecord) -> bool {
    record.stopped == describe(StopReason::Interrupted)
}

pub fn describe(reason: StopReason) -> &'static str {
    match reason {
        StopReason::Finished => "all epochs done",
        StopReason::Patience => "no more improvement",
        StopReason::Enough => "good enough",
        StopReason::TooFewLeft => "too few epochs left to gain anything",
        StopReason::Interrupted => "stopped by Ctrl-C",
        StopReason::Diverged => "the loss became infinite: lower the learning rate",
    }
}

/// Shows the training, passes Ctrl-C on to it and keeps its checkpoints.
struct Display<'a> {
    job: &'a Job,
    progress: Progress,
    /// Rows of an epoch.
    rows: usize,
    history: Vec<EpochRecord>,
    /// The epochs that were done when the first step of this process was, and when that was.
    began: Option<(f64, Instant)>,
    /// When the last checkpoint was complete, and how long it took.
    written: Option<(Instant, Duration)>,
}

impl<'a> Display<'a> {
    fn new(job: &'a Job, rows: usize) -> Self {
        let options = &job.study.training;
        let steps = rows.div_ceil(options.batch) * options.epochs;
        Self { job, progress: Progress::steps(steps), rows, history: Vec::new(), began: None, written: None }
    }

    /// Rows per second, in words, and the seconds left at this speed.
    fn speed(&mut self, done: f64) -> String {
        let (begin, at) = *self.began.get_or_insert((done, Instant::now()));
        let epochs_per_second = (done - begin) / at.elapsed().as_secs_f64();
        if !epochs_per_second.is_normal() {
            return "no speed yet".into();
        }
        let left = (self.job.study.training.epochs as f64 - done) / epochs_per_second;
        format!("{:.2e} rows/s, {left:.0} s left", epochs_per_second * self.rows as f64)
    }

    fn write_checkpoint(
        &mut self,
        make: &mut dyn FnMut() -> std::result::Result<Vec<u8>, TrainingError>,
    ) -> Result<()> {
        let began = Instant::now();
        let bytes = make()?;
        files::write_whole(&self.job.checkpoint(), &bytes)?;
        write_history(self.job, &self.history)?;
        self.written = Some((Instant::now(), began.elapsed()));
        Ok(())
    }
}

impl Observer for Display<'_> {
    fn step(&mut self, progress: &training::Progress) -> ControlFlow<()> {
        let training::Progress { epoch, epochs, step, steps, loss } = *progress;
        let done = (epoch - 1) as f64 + step as f64 / steps as f64;
        if self.began.is_none() || self.progress.is_due() {
            let message = format!("epoch {epoch}/{epochs}, loss {loss:.2e}, {}", self.speed(done));
            self.progress.set(((epoch - 1) * steps + step) as u64, message);
        }
        if interrupt::flag().load(Ordering::Relaxed) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    fn resumed(&mut self, history: &[EpochRecord]) {
        self.history = history.to_vec();
        say(format_args!("going on after epoch {}", history.len()));
    }

    fn epoch(&mut self, record: &EpochRecord) {
        self.history.push(*record);
        let EpochRecord { epoch, train_loss, validation_loss, .. } = *record;
        let epochs = self.job.study.training.epochs;
        if epoch % epochs.div_ceil(10) == 0 || epoch == epochs {
            let speed = self.speed(epoch as f64);
            self.progress.note(&format!(
                "epoch {epoch}/{epochs}: loss {train_loss:.2e}, on held-out runs {validation_loss:.2e}, {speed}"
            ));
        }
    }

    fn checkpoint(&mut self, epoch: usize, make: &mut dyn FnMut() -> std::result::Result<Vec<u8>, TrainingError>) {
        let due = self.written.is_none_or(|(at, took)| at.elapsed().mul_f64(CHECKPOINT_SHARE) >= took);
        if !due || epoch == self.job.study.training.epochs {
            return;
        }
        // a full disk is no reason to lose the training
        if let Err(error) = self.write_checkpoint(make) {
            self.progress.warn(&format!("no checkpoint: {error}"));
        }
    }
}
