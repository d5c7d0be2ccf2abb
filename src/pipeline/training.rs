//! A single training: learns a surrogate, adds error bounds, and writes it.

use super::{evaluate::constants, sample};
use crate::{
    Result, calibration,
    dataset::Dataset,
    files,
    kinds::{
        learning::{Beginning, Trained},
        record::TrainingRecord,
    },
    project::{Project, rescue},
    study::Study,
    surrogate,
    training::write_history,
};
use metafmu_runtime::{Output, Surrogate};

/// Learns from runs, measures error bounds on the calibration runs if the study wants them, and writes the surrogate and its history.
pub(super) fn from_runs(
    project: &Project,
    dataset: &Dataset,
    calibration: Option<&Dataset>,
    begin: &Beginning,
) -> Result<(Surrogate, TrainingRecord)> {
    if begin.resume
        && let Some(finished) = finished(project)?
    {
        return Ok(finished);
    }
    let trained = sample::method(project)?.learn(project, dataset, begin)?;
    write(project, trained, calibration)
}

/// Fits a model to the rows of the table, and writes the surrogate and its history.
pub(super) fn from_rows(
    project: &Project,
    fit: fn(&Project) -> Result<Trained>,
    resume: bool,
) -> Result<(Surrogate, TrainingRecord)> {
    if resume && let Some(finished) = finished(project)? {
        return Ok(finished);
    }
    write(project, fit(project)?, None)
}

/// Writes what was learned.
fn write(project: &Project, trained: Trained, calibration: Option<&Dataset>) -> Result<(Surrogate, TrainingRecord)> {
    let Trained { surrogate, history, record } = trained;
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

/// The surrogate with the error bounds that the study wants.
pub(super) fn with_bounds(surrogate: Surrogate, calibration: Option<&Dataset>, study: &Study) -> Result<Surrogate> {
    let Some((options, runs)) = study.bounds.zip(calibration) else { return Ok(surrogate) };
    // runs of a table are driven by whatever they are driven by
    match calibration::bounds(&surrogate, runs, options.coverage, !study.source.is_recorded()) {
        Ok(bounds) => surrogate::with_bounds(surrogate, bounds),
        Err(error) => Err(study.refusal("bounds", error.to_string())),
    }
}

/// Surrogate of a completed training of this study.
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
