//! Simulates the training and test runs and writes their tables.

use crate::{
    Error, Result,
    dataset::{self, Dataset, Rounding},
    diagnostics::numbers::counted,
    files,
    kinds::{
        self,
        learning::{Learning, LearningMethod},
    },
    project::{CountedWork, Event, FailedRun, Project, SamplesRecord},
    sampling::{Plan, Sets},
    scaling,
    source::{
        Journal, Simulation, Source,
        shard::{self, Shard},
        simulation::RunOutcome,
    },
    table::header_field,
    variable::SourceVariable,
};
use indexmap::IndexMap;
use metafmu_runtime::Rows;
use serde::Serialize;
use std::{fmt::Write, path::PathBuf, time::Instant};

/// The sampled runs.
pub struct Samples {
    /// The runs of each set.
    pub sets: Sets<Dataset>,
    /// Record of the sampling.
    pub record: SamplesRecord,
}

/// The plan as CSV: `set,run,<parameters>`; of runs that only signals tell apart with the number from which these follow.
///
/// # Errors
/// Those of recorded runs that cannot be read.
pub fn plan_table(project: &Project, part: Option<Shard>) -> Result<String> {
    let plan = match &project.source {
        Source::Simulation(simulation) => simulation.plan(&project.study),
        Source::Rows(_) => return Err(no_runs(project)),
        Source::Recorded(recorded) => {
            let points = |dataset: Dataset| Ok(dataset.runs.into_iter().map(|run| run.parameters).collect());
            recorded.sample(project.control().stop)?.try_map(points)?
        }
    };
    let names: String = match &project.source {
        Source::Simulation(_) => project.study.planned().map(|(name, _)| format!(",{}", header_field(name))).collect(),
        source => source.parameters().iter().map(|parameter| format!(",{}", header_field(&parameter.name))).collect(),
    };
    let mut text = format!("set,run{names}\n");
    let mut position = 0..;
    for (set, points) in plan.named() {
        let with_position = points.iter().enumerate().zip(&mut position);
        for ((run, point), _) in with_position.filter(|(_, position)| part.is_none_or(|part| part.has(*position))) {
            let values: String = point.iter().map(|value| format!(",{value:?}")).collect();
            // writing to a string does not fail
            let _ = writeln!(text, "{set},{run}{values}");
        }
    }
    Ok(text)
}

/// Runs that an earlier command sampled from this study, if it completed. Tables changed since then and tables of another study are
/// an error: sampling again would replace them.
pub(super) fn kept(project: &Project) -> Result<Option<Samples>> {
    let record = match project.load_samples_record() {
        Ok(record) => record,
        Err(Error::OtherStudy { path }) => return Err(Error::OtherStudy { path }),
        Err(_) => return Ok(None),
    };
    if record.tables.keys().any(|set| !project.table(set).exists()) {
        return Ok(None);
    }
    let sets = project.load_tables()?;
    // of a sampling that was killed after its last table was written
    files::remove(&project.journal())?;
    Ok(Some(Samples { sets, record }))
}

/// The runs that failed.
fn failures(project: &Project, plan: &Plan, outcomes: &[RunOutcome]) -> Vec<FailedRun> {
    let runs = plan.named().into_iter().flat_map(|(set, points)| points.iter().enumerate().map(move |run| (set, run)));
    let failure = |((set, (run, point)), outcome): ((&str, (usize, &[f64])), &RunOutcome)| {
        let names = project.study.planned().map(|(name, _)| name.to_owned());
        let reason = outcome.as_ref().err()?.message.clone();
        Some(FailedRun { set: set.into(), run, parameters: names.zip(point.iter().copied()).collect(), reason })
    };
    runs.zip(outcomes).filter_map(failure).collect()
}

/// Reports the number of failed runs, and the reasons of the first few.
fn tell(project: &Project, failed: &[FailedRun], total: usize) {
    const SHOWN: usize = 3;
    if failed.is_empty() {
        return;
    }
    project.warn(format_args!("{} of {total} runs failed and are left out", failed.len()));
    for FailedRun { set, run, parameters, reason } in failed.iter().take(SHOWN) {
        let values: Vec<String> = parameters.iter().map(|(name, value)| format!("{name} = {value}")).collect();
        project.warn(format_args!("{set} run {run} with {}: {reason}", values.join(", ")));
    }
    if failed.len() > SHOWN {
        project.warn(format_args!("{} has the others", project.samples_record().display()));
    }
}

/// Fails if too few runs are left to train or test with.
fn enough(sets: &Sets<Dataset>, failed: &[FailedRun]) -> Result<()> {
    let (found, expected) =
        ((sets.train.runs.len(), sets.test.runs.len()), "expected at least 2 to train and 1 to test");
    if found.0 >= 2 && found.1 >= 1 {
        return Ok(());
    }
    let reason = failed.first().map_or("", |failure| &failure.reason);
    let message = format!("only {} training and {} test runs succeeded, {expected}: {reason}", found.0, found.1);
    Err(Error::Worker { message })
}

/// Simulates every run of the study's plan, then writes the tables and their record.
pub fn stage(project: &Project) -> Result<Samples> {
    let start = Instant::now();
    match &project.source {
        Source::Simulation(simulation) => {
            let plan = simulation.plan(&project.study);
            let points = all_points(&plan);
            let journal = simulation.journal(&project.journal(), &project.study)?;
            method(project)?.check(project)?;
            let outcomes = run_points(project, simulation, &points, points.len(), &journal)?;
            let (sets, failed) = sort(project, simulation, plan, outcomes)?;
            let samples = write(project, sets, failed, start.elapsed().as_secs_f64())?;
            journal.remove()?;
            Ok(samples)
        }
        Source::Recorded(recorded) => {
            let (sets, odd) = recorded.read(project.control().stop)?;
            odd.iter().for_each(|sentence| project.say(sentence));
            write(project, sets, Vec::new(), start.elapsed().as_secs_f64())
        }
        Source::Rows(_) => Err(no_runs(project)),
    }
}

/// Result of a shard.
#[derive(Debug, Serialize)]
pub struct ShardRecord {
    /// Its file.
    pub shard: PathBuf,
    /// Number of its runs.
    pub runs: usize,
    /// How many of them failed.
    pub failed_runs: usize,
}

/// Simulates a part of the study's plan and writes its file.
///
/// # Errors
/// As [`stage`], and recorded runs have no parts.
pub fn sample_shard(project: &Project, part: Shard) -> Result<ShardRecord> {
    let start = Instant::now();
    let simulation = simulated(project)?;
    let all = all_points(&simulation.plan(&project.study));
    let points = all.pick(&part.positions(all.len()).collect::<Vec<_>>());
    let journal = simulation.journal(&project.shard_journal(part), &project.study)?;
    method(project)?.check(project)?;
    let outcomes = run_points(project, simulation, &points, all.len(), &journal)?;
    let path = part.file(project.folder());
    let seconds = start.elapsed().as_secs_f64();
    let failed = outcomes.iter().filter(|outcome| outcome.is_err()).count();
    shard::write(&path, &project.study, part, &outcomes, seconds)?;
    journal.remove()?;
    project.finish(format_args!(
        "sampled shard {part}: {}, {failed} failed, in {seconds:.2} s",
        counted(points.len(), "run")
    ));
    Ok(ShardRecord { shard: path, runs: points.len(), failed_runs: failed })
}

/// Writes the tables from shards: those given, else those in the folder of results.
pub fn merge(project: &Project, files: &[PathBuf]) -> Result<Samples> {
    let simulation = simulated(project)?;
    let plan = simulation.plan(&project.study);
    let points = all_points(&plan);
    let files = if files.is_empty() { Shard::files(project.folder())? } else { files.to_vec() };
    let (outcomes, seconds) = shard::merge(&files, project.folder(), &project.study, simulation, &points)?;
    simulation.check_failures(&points, &outcomes)?;
    let (sets, failed) = sort(project, simulation, plan, outcomes)?;
    write(project, sets, failed, seconds)
}

fn simulated<'a>(project: &'a Project) -> Result<&'a Simulation> {
    match &project.source {
        Source::Simulation(simulation) => Ok(simulation),
        Source::Recorded(_) => {
            let message = "recorded runs are not simulated: there are no shards of them".to_owned();
            Err(project.study.refusal("source", message))
        }
        Source::Rows(_) => Err(no_runs(project)),
    }
}

/// Fails if the study has no runs to sample.
///
/// # Errors
/// [`Error::Study`] of a static map.
pub fn expect_runs(project: &Project) -> Result<()> {
    method(project).map(|_| ())
}

/// The method that learns from runs.
pub(super) fn method(project: &Project) -> Result<&'static dyn LearningMethod> {
    match kinds::of(&project.study).learning(&project.study) {
        Learning::FromRuns(method) => Ok(method),
        Learning::FromRows(_) => Err(no_runs(project)),
    }
}

/// Rows of a table are not sampled.
fn no_runs(project: &Project) -> Error {
    let message = "a static map has no runs: `metafmu train` reads the rows of its table";
    project.study.refusal("structure", message)
}

/// The points of all sets, one after the other.
fn all_points(plan: &Plan) -> Rows {
    plan.named().into_iter().flat_map(|(_, points)| points).collect()
}

/// Runs points, which may be only a part of all.
fn run_points(
    project: &Project,
    simulation: &Simulation,
    points: &Rows,
    total: usize,
    journal: &Journal,
) -> Result<Vec<RunOutcome>> {
    project.begin(CountedWork::Runs, points.len());
    if !journal.is_empty() {
        let verb = if journal.len() == 1 { "is" } else { "are" };
        project
            .note(format_args!("{} {verb} kept from a sampling that was not finished", counted(journal.len(), "run")));
    }
    let outcomes = simulation.run_all(points, total, journal, project.workers(), || project.event(Event::Advance));
    outcomes.inspect_err(|_| project.event(Event::End))
}

/// Results of the points of a plan, by set, and the failed runs.
fn sort(
    project: &Project,
    simulation: &Simulation,
    plan: Plan,
    outcomes: Vec<RunOutcome>,
) -> Result<(Sets<Dataset>, Vec<FailedRun>)> {
    let failed = failures(project, &plan, &outcomes);
    tell(project, &failed, outcomes.len());
    let mut outcomes = outcomes.into_iter();
    let next = |points: Rows| Ok(simulation.dataset(outcomes.by_ref().take(points.len()).collect()));
    let Sets { train, test, calibration } = plan.try_map(next)?;
    // only training runs continue beyond the end
    let stop = project.study.time.stop;
    let sets = Sets { train, test: test.until(stop), calibration: calibration.until(stop) };
    enough(&sets, &failed)?;
    Ok((sets, failed))
}

/// Writes the tables and their record.
fn write(project: &Project, mut sets: Sets<Dataset>, failed: Vec<FailedRun>, sample_seconds: f64) -> Result<Samples> {
    let constants = settle_constants(project, &mut sets);
    for (_, dataset) in sets.named() {
        project.study.refuse(scaling::problems(dataset))?;
    }
    project.say(format_args!(
        "writing {} training, {} test and {} calibration runs to {}",
        sets.train.runs.len(),
        sets.test.runs.len(),
        sets.calibration.runs.len(),
        project.folder().display()
    ));
    let mut record = SamplesRecord {
        sampling_digest: project.study.sampling_digest(),
        train_runs: sets.train.runs.len(),
        train_rows: sets.train.row_count(),
        test_runs: sets.test.runs.len(),
        test_rows: sets.test.row_count(),
        calibration_runs: sets.calibration.runs.len(),
        tables: IndexMap::new(),
        sample_seconds,
        failed_runs: failed.len(),
        failed,
    };
    let SamplesRecord { train_runs, train_rows, test_runs, sample_seconds, .. } = record;
    project.finish(format_args!(
        "sampled {} ({}) and {} in {sample_seconds:.2} s",
        counted(train_runs, "training run"),
        counted(train_rows, "row"),
        counted(test_runs, "test run")
    ));
    constants.iter().for_each(|line| project.say(line));
    // tables without a record are not trusted: it goes first and comes back last
    files::remove(&project.samples_record())?;
    for (set, dataset) in sets.named() {
        if let Some(digest) = project.write_table(set, dataset)? {
            record.tables.insert(set.into(), digest);
        }
    }
    files::write_json(&project.samples_record(), &record)?;
    Ok(Samples { sets, record })
}

/// Sets outputs that vary by rounding only to constants, and reports them.
fn settle_constants(project: &Project, sets: &mut Sets<Dataset>) -> Vec<String> {
    let is_simulated = project.study.source.is_of_equations();
    let rounding = if is_simulated { Rounding::OF_SIMULATIONS } else { Rounding::OF_DOUBLES };
    let Sets { train, test, calibration } = sets;
    let constants = dataset::settle(train, [test, calibration], rounding);
    let line = |(output, constant): (usize, f64)| {
        let SourceVariable { name, unit, .. } = &train.outputs[output];
        let space = if unit.is_empty() { "" } else { " " };
        format!("output {name} varies by rounding only: the tables have the constant {constant}{space}{unit}")
    };
    constants.into_iter().map(line).collect()
}

/// Simulates further runs, those of the given points, after which there are `total`. As many may fail as of a plan of all of
/// them.
pub fn simulate(project: &Project, points: &Rows, total: usize) -> Result<Dataset> {
    let Source::Simulation(simulation) = &project.source else {
        return Err(project.study.refusal("target", "recorded runs cannot be added to"));
    };
    let journal = simulation.journal(&project.journal(), &project.study)?;
    let outcomes = run_points(project, simulation, points, total, &journal)?;
    if let Some(reason) = outcomes.iter().find_map(|outcome| outcome.as_ref().err()) {
        let failed = outcomes.iter().filter(|outcome| outcome.is_err()).count();
        project.warn(format_args!(
            "{failed} of {} further runs failed and are left out, the first: {reason}",
            points.len()
        ));
    }
    let runs = simulation.dataset(outcomes);
    project.finish(format_args!("simulated {} of {} further runs", runs.runs.len(), points.len()));
    journal.remove()?;
    Ok(runs)
}
