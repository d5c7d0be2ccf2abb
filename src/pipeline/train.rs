//! Learns from the sampled runs by the method of the study and writes the surrogate.

use super::{
    element,
    evaluate::constants,
    follower::Trained,
    learn::{Beginning, method},
    prepare::held_out,
    project::Project,
    record::TrainingRecord,
    rescue,
};
use crate::{
    Result, acceptance, calibration, dataset::Dataset, evaluation::Verdict, files, study::Study, surrogate,
    training::write_history,
};
use metafmu_runtime::{Output, Surrogate};

/// The verdict on a surrogate by the runs that were held out of its training: the test runs must not be used here.
pub fn judge(project: &Project, train: &Dataset, surrogate: &Surrogate, record: &TrainingRecord) -> Verdict {
    let study = &project.study;
    let held_out = held_out(study, train);
    let accuracy = element::evaluated(project, surrogate, &element::test_data(study, &held_out)).accuracy.clone();
    acceptance::judge(study, surrogate, (&accuracy, "held-out runs"), None, record.findings(study))
}

/// Trains, keeps the epoch that is best on held-out runs, measures error bounds on the calibration runs if the study
/// wants them, writes the surrogate and the history. The last `added` runs are for training only. The network begins as
/// that of `start`, if there is one.
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
    let begin = Beginning { added, start, resume };
    let Trained { surrogate, history, record } = method(study).learn(project, dataset, &begin)?;
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
