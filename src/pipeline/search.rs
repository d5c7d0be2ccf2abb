//! Trains the trials of a study's `[search]` side by side and writes a table and the best study.

use super::compare;
use crate::{
    Error, Result,
    baselines::BaselineKind,
    dataset::Dataset,
    diagnostics::numbers::power,
    evaluation::comparison::ModelStatus,
    files,
    kinds::{
        prepare::{PreparedTraining, baseline_rows_and_held_out, prepare, prepare_instants},
        response::per_instant,
    },
    network::Network,
    parallel::side_by_side,
    project::{CountedWork, Event, Project},
    sampling::Plan,
    scaling,
    search::{self, rungs, survivors},
    source::Source,
    study::{Study, TimeStructure},
    training::{self, EpochRecord, Observer, StopReason, TrainingError, TrainingRows},
};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::{
    fmt::Write,
    ops::ControlFlow,
    panic::{AssertUnwindSafe, catch_unwind},
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

/// Time between two checkpoints of a trial; at a rung's end there is always one.
const CHECKPOINT_EVERY: Duration = Duration::from_secs(10);

/// Progress of a trial: `trial-NNNN.json`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct TrialRecord {
    trial: usize,
    /// [`Study::digest`] of the trial's study.
    study_digest: String,
    /// In the order of `search.space`.
    values: Vec<toml::Value>,
    status: TrialStatus,
    /// Epochs that were completed.
    epochs: usize,
    best_epoch: usize,
    /// Mean over the outputs of 1 - R² on the held-out runs.
    score: Option<f64>,
    seconds: f64,
    /// Reason of the failure.
    message: String,
    /// `true` if it ended with an error, which says nothing about its values. A training that diverges or a baseline
    /// that cannot be fitted is a result.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    broke: bool,
    /// SHA-256 of the rest, so that a changed score has no effect.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    digest: String,
}

impl TrialRecord {
    fn content_digest(&self) -> String {
        let content = serde_json::to_vec(&Self { digest: String::new(), ..self.clone() });
        // plain data: serialization cannot fail, and if it did, no digest could match
        content.map_or_else(|_| String::new(), |content| files::digits(Sha256::new_with_prefix(content)))
    }
}

/// Status of a trial.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TrialStatus {
    /// Not begun.
    Waiting,
    /// Trained up to a rung.
    Paused,
    /// Others were better.
    Stopped,
    /// Came to its end.
    Finished,
    /// Ended with an error, or its training diverged.
    Failed,
}

/// A trial of a search.
struct SearchTrial {
    values: Vec<toml::Value>,
    study: Result<Study>,
    record: PathBuf,
    checkpoint: PathBuf,
    /// Journal of its runs, if they are not those of the study.
    runs: PathBuf,
}

/// Result of a search.
#[derive(Debug, Serialize)]
pub struct Searched {
    /// `search.csv`, a row for each trial.
    pub table: PathBuf,
    /// The study file of the best trial.
    pub best_study: PathBuf,
    /// Record of the best trial.
    pub best: TrialRecord,
    /// The best trials as a table for people.
    #[serde(skip)]
    pub summary: String,
    /// `true` if a trial ended with an error.
    #[serde(skip)]
    pub has_errors: bool,
}

/// Trains the trials of the study in the file `path` and writes the table and the best study. To `resume` is to
/// continue from the results of an earlier search.
///
/// # Errors
/// [`Error::Study`] if the search itself makes no sense, [`Error::Stale`] if no trial finished, [`Error::Interrupted`],
/// [`Error::Io`]. A trial that fails is none of them.
pub fn search(project: &Project, path: &Path, resume: bool) -> Result<Searched> {
    let text = std::fs::read_to_string(path).map_err(Error::io(path, "read"))?;
    let studies = search::studies(&project.study)?;
    let folder = project.search_folder();
    project.prepare_folder()?;
    files::writable_folder(&folder)?;
    let trial = |(number, (values, study))| SearchTrial {
        values,
        study,
        record: folder.join(format!("trial-{number:04}.json")),
        checkpoint: folder.join(format!("trial-{number:04}.safetensors")),
        runs: folder.join(format!("trial-{number:04}-runs.bin")),
    };
    let trials: Vec<SearchTrial> = studies.into_iter().enumerate().map(trial).collect();
    tell_unfit(project, &trials);
    if !resume {
        for trial in &trials {
            files::remove(&trial.record)?;
            files::remove(&trial.checkpoint)?;
            files::remove(&trial.runs)?;
        }
        files::remove(&shared_runs(project))?;
    }
    let records = train_all(project, &trials)?;
    let (table, best_study) = (project.search_table(), project.best_study());
    write_table(project, &records)?;
    let Some(best) = best(&records) else {
        let message = records.first().map_or("there was none", |record| &record.message);
        return Err(Error::Stale { path: table, message: format!("no trial finished; the first: {message}") });
    };
    let keys: Vec<&str> = keys(project).collect();
    let text = search::study_text(&text, path, &keys, &best.values)?;
    let comment = format!("# The best of {} trials of {}.\n\n", records.len(), path.display());
    files::write_whole(&best_study, (comment + &text).as_bytes())?;
    for file in trials.iter().flat_map(|trial| [&trial.checkpoint, &trial.runs]).chain([&shared_runs(project)]) {
        files::remove(file)?;
    }
    let went_wrong = |(trial, record): (&SearchTrial, &TrialRecord)| trial.study.is_err() || record.broke;
    let (best, summary) = (best.clone(), summary(project, &records));
    Ok(Searched { table, best_study, best, summary, has_errors: trials.iter().zip(&records).any(went_wrong) })
}

/// Reports, before the first trial, trials whose values do not fit together.
fn tell_unfit(project: &Project, trials: &[SearchTrial]) {
    let unfit: Vec<&Error> = trials.iter().filter_map(|trial| trial.study.as_ref().err()).collect();
    if let Some(first) = unfit.first() {
        let (count, first) = (unfit.len(), first.to_string().replace('\n', "; "));
        let total = trials.len();
        project.say(format_args!(
            "{count} of {total} trials have values that are not valid together and fail, the first: {first}"
        ));
    }
}

/// Journal of the runs of the study itself.
fn shared_runs(project: &Project) -> PathBuf {
    project.search_folder().join("runs.bin")
}

fn keys<'a>(project: &'a Project) -> impl Iterator<Item = &'a str> {
    project.study.search.iter().flat_map(|search| search.space.keys()).map(String::as_str)
}

fn best(records: &[TrialRecord]) -> Option<&TrialRecord> {
    let finished = records.iter().filter(|record| record.status == TrialStatus::Finished);
    let scored = finished.filter_map(|record| Some((record.score?, record)));
    scored.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, record)| record)
}

/// Trains every trial rung by rung; after each, the best ones continue.
fn train_all(project: &Project, trials: &[SearchTrial]) -> Result<Vec<TrialRecord>> {
    let Some(options) = &project.study.search else { return Ok(Vec::new()) };
    let shared = if trials.iter().any(|trial| shares_samples(project, trial)) {
        Some(samples(project, &project.study, &project.source, &shared_runs(project))?)
    } else {
        None
    };
    let mut records: Vec<TrialRecord> = (0..).zip(trials).map(|(number, trial)| waiting(number, trial)).collect();
    let mut going: Vec<usize> = (0..trials.len()).collect();
    let rungs = rungs(options);
    for (rung, &share) in rungs.iter().enumerate() {
        project.begin(CountedWork::Trials { rung: rung + 1, rungs: rungs.len() }, going.len());
        let done = side_by_side(&going, |number| {
            let record = attempt(project, number, &trials[number], shared.as_ref(), share);
            if let Ok(record) = &record {
                project.say(sentence(record));
                project.event(Event::Advance);
            }
            record
        });
        project.event(Event::End);
        for (number, record) in done {
            records[number] = record?;
        }
        let scores: Vec<(usize, Option<f64>)> = going.iter().map(|&number| (number, records[number].score)).collect();
        if rung + 1 < rungs.len() {
            going = survivors(&scores, options.reduction);
            for (number, _) in scores {
                let record = &mut records[number];
                if !going.contains(&number) && record.status == TrialStatus::Paused {
                    record.status = TrialStatus::Stopped;
                }
            }
        }
    }
    Ok(records)
}

fn shares_samples(project: &Project, trial: &SearchTrial) -> bool {
    trial.study.as_ref().is_ok_and(|study| study.sampling_digest() == project.study.sampling_digest())
}

/// Runs that take long are kept in the journal until the search is over: every rung needs them.
fn samples(project: &Project, study: &Study, source: &Source, journal: &Path) -> Result<Dataset> {
    let dataset = match source {
        Source::Simulation(simulation) => {
            let kept = simulation.journal(journal, study)?;
            let points = Plan::new(study).train;
            let outcomes = simulation.run_all(&points, points.len(), &kept, project.workers(), || ())?;
            simulation.dataset(outcomes)
        }
        Source::Recorded(recorded) => recorded.sample(project.control().stop)?.train,
        // a static map has no `[search]`, which is said elsewhere
        Source::Rows(_) => source.columns().without_runs(),
    };
    study.refuse(scaling::problems(&dataset))?;
    Ok(dataset)
}

fn waiting(trial: usize, of: &SearchTrial) -> TrialRecord {
    TrialRecord {
        trial,
        study_digest: of.study.as_ref().map_or_else(|_| String::new(), Study::digest),
        values: of.values.clone(),
        status: TrialStatus::Waiting,
        epochs: 0,
        best_epoch: 0,
        score: None,
        seconds: 0.0,
        message: String::new(),
        broke: false,
        digest: String::new(),
    }
}

/// Trains a trial up to a share of its epochs, unless it is that far already. Its failure is a record, too; an error
/// ends the search.
fn attempt(
    project: &Project,
    number: usize,
    trial: &SearchTrial,
    shared: Option<&Dataset>,
    share: f64,
) -> Result<TrialRecord> {
    let waiting = waiting(number, trial);
    let kept = std::fs::read(&trial.record).ok().and_then(|bytes| serde_json::from_slice::<TrialRecord>(&bytes).ok());
    let kept = kept.filter(|record| record.study_digest == waiting.study_digest && record.values == waiting.values);
    let kept = kept.filter(|record| record.digest == record.content_digest());
    let goal = trial.study.as_ref().map_or(0, |study| goal(study, share));
    if let Some(record) = &kept
        && (matches!(record.status, TrialStatus::Finished | TrialStatus::Failed) || record.epochs >= goal)
    {
        return Ok(record.clone());
    }
    let mut record = match catch_unwind(AssertUnwindSafe(|| train(project, trial, &waiting, shared, goal))) {
        Ok(Ok(record)) => record,
        // no fault of the trial
        Ok(Err(error)) if matches!(error, Error::Interrupted) || files::is_full(&error) => return Err(error),
        Ok(Err(error)) => {
            TrialRecord { status: TrialStatus::Failed, message: error.to_string(), broke: true, ..waiting }
        }
        Err(panic) => {
            let text = panic.downcast_ref::<String>().cloned();
            let text = text.or_else(|| panic.downcast_ref::<&str>().map(|text| (*text).to_owned()));
            let message = format!("internal error: {}", text.unwrap_or_default());
            TrialRecord { status: TrialStatus::Failed, message, broke: true, ..waiting }
        }
    };
    record.digest = record.content_digest();
    files::write_json(&trial.record, &record)?;
    if matches!(record.status, TrialStatus::Finished | TrialStatus::Failed) {
        files::remove(&trial.checkpoint)?;
    }
    Ok(record)
}

fn goal(study: &Study, share: f64) -> usize {
    ((study.training.epochs as f64 * share).ceil() as usize).max(1)
}

fn train(
    project: &Project,
    trial: &SearchTrial,
    waiting: &TrialRecord,
    shared: Option<&Dataset>,
    goal: usize,
) -> Result<TrialRecord> {
    let study = match &trial.study {
        Ok(study) => study,
        Err(error) => {
            return Ok(TrialRecord { status: TrialStatus::Failed, message: error.to_string(), ..waiting.clone() });
        }
    };
    let own;
    let dataset = match shared.filter(|_| shares_samples(project, trial)) {
        Some(dataset) => dataset,
        None => {
            own = samples(project, study, &Source::new(study)?, &trial.runs)?;
            &own
        }
    };
    if let Some(kind) = project.study.search.as_ref().and_then(|search| search.model) {
        return fit_baseline(project, study, kind, dataset, waiting);
    }
    if study.network.structure == TimeStructure::Fixed {
        return train_instants(project, study, dataset, waiting, goal);
    }
    let PreparedTraining { network, training: rows, validation, .. } = prepare(study, dataset, 0, None)?;
    let options = &study.training;
    let mut follower = TrialFollower { project, trial, goal, epochs: 0, written: None, failed: None };
    let checkpoint = std::fs::read(&trial.checkpoint).ok();
    let resumed = checkpoint
        .map(|bytes| training::resume(&bytes, network.clone(), &rows, &validation, options, study.seed, &mut follower));
    let outcome = match resumed {
        // damaged, or of a study that was changed since
        None | Some(Err(TrainingError::Checkpoint { .. })) => {
            training::train(network, &rows, &validation, options, study.seed, &mut follower)?
        }
        Some(outcome) => outcome?,
    };
    if let Some(error) = follower.failed {
        return Err(error);
    }
    let epochs = outcome.history.len();
    if outcome.reason == StopReason::Interrupted && epochs < goal {
        return Err(Error::Interrupted);
    }
    let (status, message) = match outcome.reason {
        StopReason::Interrupted => (TrialStatus::Paused, ""),
        StopReason::Diverged => (TrialStatus::Failed, "the loss became infinite"),
        StopReason::Finished
        | StopReason::Patience
        | StopReason::Overfitted
        | StopReason::Enough
        | StopReason::TooFewLeft
        | StopReason::Solved => (TrialStatus::Finished, ""),
    };
    Ok(TrialRecord {
        status,
        epochs,
        best_epoch: outcome.best_epoch,
        score: (status != TrialStatus::Failed).then(|| score(&outcome.network, &validation)),
        seconds: outcome.history.last().map_or(0.0, |epoch| epoch.seconds),
        message: message.into(),
        ..waiting.clone()
    })
}

/// Trains a trial with a network for each instant. These train quickly: each rung starts from scratch.
fn train_instants(
    project: &Project,
    study: &Study,
    dataset: &Dataset,
    waiting: &TrialRecord,
    goal: usize,
) -> Result<TrialRecord> {
    let (_, prepared) = prepare_instants(study, dataset)?;
    let outcomes = per_instant::train_all(project, study, &prepared, goal, |_, train| train())?;
    let (status, message) = match per_instant::reason(&outcomes) {
        StopReason::Interrupted => (TrialStatus::Paused, ""),
        StopReason::Diverged => (TrialStatus::Failed, "the loss of a network became infinite"),
        StopReason::Finished
        | StopReason::Patience
        | StopReason::Overfitted
        | StopReason::Enough
        | StopReason::TooFewLeft
        | StopReason::Solved => (TrialStatus::Finished, ""),
    };
    let columns = prepared.iter().zip(&outcomes).map(|(prepared, outcome)| {
        let PreparedTraining { validation, scaling, .. } = prepared;
        columns(&outcome.network, validation, &scaling.output_mean, &scaling.output_scale)
    });
    let together = columns.reduce(|mut all, more| {
        for ([found, expected], [more_found, more_expected]) in all.iter_mut().zip(more) {
            found.extend(more_found);
            expected.extend(more_expected);
        }
        all
    });
    let seconds = outcomes.iter().filter_map(|outcome| outcome.history.last()).map(|epoch| epoch.seconds);
    Ok(TrialRecord {
        status,
        epochs: per_instant::epochs(&outcomes),
        best_epoch: per_instant::best_epoch(&outcomes),
        score: together.filter(|_| status != TrialStatus::Failed).map(|columns| mean_unexplained(&columns)),
        seconds: seconds.sum(),
        message: message.into(),
        ..waiting.clone()
    })
}

/// Fits a baseline instead, at once: rungs mean nothing to it.
fn fit_baseline(
    project: &Project,
    study: &Study,
    kind: BaselineKind,
    dataset: &Dataset,
    waiting: &TrialRecord,
) -> Result<TrialRecord> {
    let (rows, held_out) = baseline_rows_and_held_out(study, dataset);
    let row = compare::measure(project, study, kind, &rows, &held_out)?;
    let (status, message) = match row.status {
        ModelStatus::Fine => (TrialStatus::Finished, String::new()),
        ModelStatus::Stopped => return Err(Error::Interrupted),
        ModelStatus::Failed | ModelStatus::TooSlow => (TrialStatus::Failed, row.note),
    };
    let unexplained: Vec<f64> = row.outputs.values().filter_map(|output| Some(1.0 - output.r2?)).collect();
    let mean = unexplained.iter().sum::<f64>() / unexplained.len() as f64;
    Ok(TrialRecord {
        status,
        score: (!unexplained.is_empty()).then_some(mean),
        seconds: row.fit_seconds.unwrap_or(0.0),
        message,
        ..waiting.clone()
    })
}

/// Mean over the outputs of 1 - R², on standardized rows: comparable for any loss of the trials.
fn score(network: &Network, rows: &TrainingRows) -> f64 {
    mean_unexplained(&columns(network, rows, &vec![0.0; rows.n_outputs()], &vec![1.0; rows.n_outputs()]))
}

/// Predicted and expected values of each output, no longer standardized.
fn columns(network: &Network, rows: &TrainingRows, mean: &[f64], scale: &[f64]) -> Vec<[Vec<f64>; 2]> {
    let mut found = vec![0.0; rows.outputs().len()];
    network.predict(rows.inputs(), &mut found);
    let column = |values: &[f32], output: usize| {
        let values = values.iter().skip(output).step_by(rows.n_outputs());
        values.map(|&value| mean[output] + scale[output] * f64::from(value)).collect()
    };
    (0..rows.n_outputs()).map(|output| [column(&found, output), column(rows.outputs(), output)]).collect()
}

fn mean_unexplained(columns: &[[Vec<f64>; 2]]) -> f64 {
    let unexplained = |[found, expected]: &[Vec<f64>; 2]| {
        let mean = expected.iter().sum::<f64>() / expected.len() as f64;
        let error: f64 = found.iter().zip(expected).map(|(found, expected)| (found - expected).powi(2)).sum();
        error / expected.iter().map(|expected| (expected - mean).powi(2)).sum::<f64>().max(f64::MIN_POSITIVE)
    };
    columns.iter().map(unexplained).sum::<f64>() / columns.len() as f64
}

/// Ends a trial at its goal, keeps its checkpoints and passes Ctrl-C on.
struct TrialFollower<'a> {
    project: &'a Project<'a>,
    trial: &'a SearchTrial,
    goal: usize,
    /// Epochs that are done.
    epochs: usize,
    written: Option<Instant>,
    failed: Option<Error>,
}

impl Observer for TrialFollower<'_> {
    fn step(&mut self, _: &training::Progress) -> ControlFlow<()> {
        let stop = self.epochs >= self.goal || self.failed.is_some() || self.project.is_stopped();
        if stop { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    fn resumed(&mut self, history: &[EpochRecord]) {
        self.epochs = history.len();
    }

    fn epoch(&mut self, record: &EpochRecord) {
        self.epochs = record.epoch;
    }

    fn checkpoint(&mut self, epoch: usize, make: &mut dyn FnMut() -> std::result::Result<Vec<u8>, TrainingError>) {
        let due = epoch == self.goal || self.written.is_none_or(|at| at.elapsed() >= CHECKPOINT_EVERY);
        if due {
            let bytes = make().map_err(Error::from);
            self.failed = bytes.and_then(|bytes| files::write_whole(&self.trial.checkpoint, &bytes)).err();
            self.written = Some(Instant::now());
        }
    }
}

// ---- What people see ---------------------------------------------------------------------------------------------

fn write_table(project: &Project, records: &[TrialRecord]) -> Result<()> {
    let error = |source: csv::Error| Error::io(&project.search_table(), "write")(source.into());
    let mut table = csv::Writer::from_writer(Vec::new());
    let columns = ["status", "epochs", "best_epoch", "one_minus_r2", "seconds", "message"];
    table.write_record(["trial"].into_iter().chain(keys(project)).chain(columns)).map_err(error)?;
    for record in records {
        let TrialRecord { trial, values, status, epochs, best_epoch, score, seconds, message, .. } = record;
        let score = score.map_or(String::new(), |score| format!("{score:e}"));
        let values = values.iter().map(plain);
        let (first, rest) = (
            [trial.to_string()],
            [
                name(*status).into(),
                epochs.to_string(),
                best_epoch.to_string(),
                score,
                format!("{seconds:.2}"),
                message.clone(),
            ],
        );
        table.write_record(first.into_iter().chain(values).chain(rest)).map_err(error)?;
    }
    let bytes =
        table.into_inner().map_err(|problem| Error::io(&project.search_table(), "write")(problem.into_error()))?;
    files::write_whole(&project.search_table(), &bytes)
}

fn name(status: TrialStatus) -> &'static str {
    match status {
        TrialStatus::Waiting => "waiting",
        TrialStatus::Paused => "paused",
        TrialStatus::Stopped => "stopped",
        TrialStatus::Finished => "finished",
        TrialStatus::Failed => "failed",
    }
}

/// A value without quotation marks.
fn plain(value: &toml::Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

fn sentence(record: &TrialRecord) -> String {
    let TrialRecord { trial, status, epochs, score, message, .. } = record;
    match score {
        Some(score) => {
            // a baseline has none
            let after = match epochs {
                0 => String::new(),
                1 => " after 1 epoch".to_owned(),
                _ => format!(" after {epochs} epochs"),
            };
            format!("trial {trial}: 1 - R² {} on held-out runs{after}", power(*score, 2))
        }
        None => format!("trial {trial} {}: {message}", name(*status)),
    }
}

/// The five best trials.
fn summary(project: &Project, records: &[TrialRecord]) -> String {
    let mut order: Vec<&TrialRecord> = records.iter().filter(|record| record.score.is_some()).collect();
    let rank = |record: &TrialRecord| (record.status != TrialStatus::Finished, record.score.unwrap_or(f64::INFINITY));
    order.sort_by(|a, b| rank(a).0.cmp(&rank(b).0).then(rank(a).1.total_cmp(&rank(b).1)));
    let mut text = format!("{:>5}  {:<8}  {:>6}  {:>9}  values\n", "trial", "status", "epochs", "1 - R²");
    for record in order.iter().take(5) {
        let values: Vec<String> =
            keys(project).zip(&record.values).map(|(key, value)| format!("{key} = {value}")).collect();
        let (status, score) = (name(record.status), record.score.map_or_else(String::new, |score| power(score, 2)));
        // writing to a string does not fail
        let _ =
            writeln!(text, "{:>5}  {status:<8}  {:>6}  {score:>9}  {}", record.trial, record.epochs, values.join(", "));
    }
    let failed = records.iter().filter(|record| record.status == TrialStatus::Failed).count();
    if failed > 0 {
        let _ = writeln!(text, "{failed} of {} trials failed: see the table", records.len());
    }
    text
}
