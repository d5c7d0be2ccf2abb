//! Trains, and adds runs and trains on, until the study's target is met or its budget ends.

use super::{sample, training};
use crate::{
    Error, Result,
    dataset::Dataset,
    diagnostics::numbers::{counted, power},
    evaluation::Accuracy,
    files,
    kinds::{follower::unless_interrupted, learning::Beginning, prepare::held_out, record::TrainingRecord},
    project::{Project, rescue},
    refinement::next_points,
    sampling::Plan,
    study::TargetOptions,
    surrogate,
    table::header_field,
    training::{EpochRecord, StopReason, joined, read_history, write_history},
};
use metafmu_runtime::{Rows, Surrogate};

/// Trains, in several rounds if the study has a target. To `resume` is to use the results of an earlier training, or
/// else to continue from its checkpoint, if there is one.
pub fn stage(
    project: &Project,
    dataset: &Dataset,
    calibration: &Dataset,
    resume: bool,
) -> Result<(Surrogate, TrainingRecord)> {
    match &project.study.target {
        None => training::from_runs(project, dataset, Some(calibration), &Beginning { added: 0, start: None, resume }),
        Some(target) => in_rounds(project, target, dataset, calibration, resume),
    }
}

/// Accuracy of the surrogate after a round.
struct Round {
    runs: usize,
    /// R² of each output on the held-out runs; none of a constant one.
    r2: Vec<Option<f64>>,
    record: TrainingRecord,
    history: Vec<EpochRecord>,
}

impl Round {
    /// The smallest R², if any output has one.
    fn worst(&self) -> Option<f64> {
        self.r2.iter().flatten().copied().reduce(f64::min)
    }
}

/// Trains in rounds, each from the network of the one before. Writes the files of a single training, `rounds.csv` with
/// a row for each round, and the table `added` with the added runs. Every round has a separate folder, from which `resume`
/// continues; the folders are removed at the end.
fn in_rounds(
    project: &Project,
    target: &TargetOptions,
    planned: &Dataset,
    calibration: &Dataset,
    resume: bool,
) -> Result<(Surrogate, TrainingRecord)> {
    if resume && let Some(finished) = training::finished(project)? {
        return Ok(finished);
    }
    if !resume {
        files::remove_folder(&project.rounds())?;
    }
    let validation = held_out(&project.study, planned);
    let (mut dataset, mut rounds, mut start, mut asked) = (planned.clone(), Vec::<Round>::new(), None, 0);
    let mut failed = failures(&Plan::new(&project.study).train, planned);
    let trained = loop {
        let round = project.round(rounds.len());
        round.prepare_folder()?;
        let added = dataset.runs.len() - planned.runs.len();
        let begin = Beginning { added, start: start.as_ref(), resume };
        let done = training::from_runs(&round, &dataset, None, &begin);
        let (trained, record) =
            match (unless_interrupted(project, done, start.is_some())?, start.take(), rounds.last_mut()) {
                (Some(done), ..) => done,
                // the network of the round before is the best so far
                (None, Some(before), Some(last)) => {
                    last.record.stopped = StopReason::Interrupted;
                    dataset.runs.truncate(last.runs);
                    break before;
                }
                (None, ..) => return Err(Error::Interrupted),
            };
        let r2 = Accuracy::of(&trained, &validation).outputs.values().map(|metrics| metrics.r2).collect();
        let history = read_history(&round.history())?;
        let finished = Round { runs: dataset.runs.len(), r2, record, history };
        let is_met = finished.worst().is_none_or(|worst| worst >= target.r2);
        let is_last = is_met || finished.record.was_interrupted() || dataset.runs.len() >= target.max_runs;
        report(project, &rounds, &finished, target, validation.runs.len());
        rounds.push(finished);
        write_rounds(project, &rounds)?;
        if is_last {
            break trained;
        }
        let points = next_points(&project.study, target, &trained, &dataset, &failed, asked);
        asked += points.len();
        let added = simulate(&round, &points, dataset.runs.len() + points.len())?;
        if added.runs.is_empty() {
            project.say("no further run can be added: the training ends short of the target");
            break trained;
        }
        failed.extend(&failures(&points, &added));
        dataset.runs.extend(added.runs);
        start = Some(trained);
    };
    let trained = training::with_bounds(trained, Some(calibration), &project.study)?;
    let record = total(&rounds, dataset.runs.len() - planned.runs.len(), target);
    let added = Dataset { runs: dataset.runs.split_off(planned.runs.len()), ..dataset };
    rescue::write(project, |to| {
        to.write_table("added", &added)?;
        surrogate::save(&trained, &to.model())?;
        write_history(&to.history(), &joined(rounds.iter().map(|round| round.history.as_slice())))?;
        files::write_json(&to.training_record(), &record)
    })?;
    if !record.was_interrupted() {
        files::remove_folder(&project.rounds())?;
    }
    Ok((trained, record))
}

/// The runs of these points: those a killed training has simulated already, or new ones. There will be `total` with those
/// before.
fn simulate(round: &Project, points: &Rows, total: usize) -> Result<Dataset> {
    let (path, digest) = (round.table("added"), round.folder().join("added.sha256"));
    if let Ok(digest) = std::fs::read_to_string(&digest)
        && let Ok(kept) = Dataset::read(&path, &digest, round.source.columns())
        && !kept.runs.is_empty()
        && failures(points, &kept).len() + kept.runs.len() == points.len()
    {
        return Ok(kept);
    }
    let runs = sample::simulate(round, points, total)?;
    if let Some(written) = round.write_table("added", &runs)? {
        files::write_whole(&digest, written.as_bytes())?;
    }
    Ok(runs)
}

/// The points whose runs are not there, because they failed; the others' are in the order of the points.
fn failures(points: &Rows, made: &Dataset) -> Rows {
    let mut made = made.runs.iter().peekable();
    points.iter().filter(|point| made.next_if(|run| run.parameters == *point).is_none()).collect()
}

fn report(project: &Project, before: &[Round], round: &Round, target: &TargetOptions, validation_runs: usize) {
    let worst = round
        .worst()
        .map_or("none".into(), |worst| if worst.abs() < 1e4 { format!("{worst:.7}") } else { power(worst, 2) });
    let went = match round.worst() {
        Some(worst) if worst < target.r2 && round.runs >= target.max_runs => {
            "short of the target, and no more runs allowed"
        }
        Some(worst) if worst < target.r2 => "short of the target",
        _ => "the target is met",
    };
    project.say(format_args!(
        "round {} with {}: smallest R² {worst} on {}, {went} ({})",
        before.len() + 1,
        counted(round.runs, "run"),
        counted(validation_runs, "held-out run"),
        target.r2
    ));
}

fn write_rounds(project: &Project, rounds: &[Round]) -> Result<()> {
    let outputs: Vec<String> =
        project.source.outputs().iter().map(|output| header_field(&format!("r2_{}", output.name))).collect();
    files::write_with(&project.rounds_table(), |file| {
        writeln!(file, "round,runs,epochs,seconds,{}", outputs.join(","))?;
        for (index, Round { runs, r2, record, .. }) in rounds.iter().enumerate() {
            let r2: Vec<String> = r2.iter().map(|r2| r2.map_or(String::new(), |r2| r2.to_string())).collect();
            let TrainingRecord { epochs, train_seconds, .. } = record;
            writeln!(file, "{},{runs},{epochs},{train_seconds:.3},{}", index + 1, r2.join(","))?;
        }
        Ok(())
    })
}

/// The rounds as one training.
fn total(rounds: &[Round], added_runs: usize, target: &TargetOptions) -> TrainingRecord {
    let last = &rounds[rounds.len() - 1];
    let before: usize = rounds[..rounds.len() - 1].iter().map(|round| round.record.epochs).sum();
    TrainingRecord {
        epochs: before + last.record.epochs,
        best_epoch: before + last.record.best_epoch,
        train_seconds: rounds.iter().map(|round| round.record.train_seconds).sum(),
        processor_seconds: rounds.iter().map(|round| round.record.processor_seconds).sum(),
        added_runs,
        target_met: Some(last.worst().is_none_or(|worst| worst >= target.r2)),
        ..last.record.clone()
    }
}
