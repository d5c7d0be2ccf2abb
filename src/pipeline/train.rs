//! Trains the network on the sampled runs and writes the surrogate.

use super::{
    discrete,
    evaluate::constants,
    follower::{Checkpoints, Follower, Trained, at_least_one_epoch, load_checkpoint, unusable_checkpoint},
    motion, per_instant,
    prepare::{PreparedTraining, held_out, prepare},
    project::Project,
    record::TrainingRecord,
    rescue, state_space, trajectories,
};
use crate::{
    Result, acceptance, calibration,
    dataset::Dataset,
    evaluation::Accuracy,
    evaluation::Verdict,
    files,
    study::{Study, StudyStructure, TimeStructure},
    surrogate,
    training::{self, write_history},
};
use metafmu_runtime::{Graph, Output, ScaledNetwork, Surrogate};
use std::sync::atomic::Ordering;

/// The verdict on a surrogate by the runs that were held out of its training: the test runs must not be used here.
pub fn judge(project: &Project, train: &Dataset, surrogate: &Surrogate, record: &TrainingRecord) -> Verdict {
    let study = &project.study;
    let accuracy = Accuracy::of(surrogate, &held_out(study, train));
    acceptance::judge(study, surrogate, (&accuracy, "held-out runs"), None, record.findings(study))
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
            TimeStructure::Full => train(project, dataset, added, start, resume)?,
            TimeStructure::Fixed => per_instant::train(project, dataset, resume)?,
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
    let PreparedTraining { scaling, network, training: training_rows, validation: validation_rows, validation_runs } =
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
        method: None,
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
    let graph = Graph::from(&ScaledNetwork { scaling, layers: network.to_layers() });
    let surrogate = surrogate::assemble(study, dataset, record.train_rows, graph)?;
    Ok(Trained { surrogate, history: outcome.history, record })
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
