//! `metafmu sample`: simulates the training and test runs and writes their tables.

use super::{
    interrupt,
    job::{FailedRun, Job, SamplesRecord},
    print, print_json,
    progress::Progress,
};
use crate::cli::SampleArgs;
use indexmap::IndexMap;
use metafmu::{
    Error, Result,
    dataset::Dataset,
    files,
    sampling::{Plan, Sets},
    scaling,
    source::{
        Journal, Simulation, Source,
        shard::{self, Shard},
        simulation::Outcome,
    },
    table::header_field,
};
use std::{fmt::Write, path::PathBuf, time::Instant};

/// The sampled runs.
pub struct Samples {
    pub sets: Sets<Dataset>,
    pub record: SamplesRecord,
}

pub fn run(args: &SampleArgs) -> Result<super::Outcome> {
    let job = Job::new(&args.study)?;
    job.describe_mechanism();
    if args.dry_run {
        print(&plan_table(&job, args.shard)?)?;
        return Ok(super::Outcome::Fine);
    }
    job.prepare_folder()?;
    if let Some(part) = args.shard {
        return sample_shard(&job, part);
    }
    let samples = match &args.merge {
        Some(files) => merge(&job, files)?,
        None => stage(&job)?,
    };
    if job.json {
        print_json(&samples.record)?;
    } else {
        let tables = samples.sets.named().into_iter().filter(|(_, dataset)| !dataset.runs.is_empty());
        print(&tables.map(|(set, _)| format!("{}\n", job.table(set).display())).collect::<String>())?;
    }
    Ok(super::Outcome::Fine)
}

/// The plan as CSV: `set,run,<parameters>`.
fn plan_table(job: &Job, part: Option<Shard>) -> Result<String> {
    let plan = match &job.source {
        Source::Simulation(_) => Plan::new(&job.study),
        Source::Recorded(recorded) => {
            let points = |dataset: Dataset| Ok(dataset.runs.into_iter().map(|run| run.parameters).collect());
            recorded.sample(interrupt::flag())?.try_map(points)?
        }
    };
    let names: String =
        job.source.parameters().iter().map(|parameter| format!(",{}", header_field(&parameter.name))).collect();
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

/// The runs that an earlier command has sampled from this study, if it came so far. Tables that were changed since are an
/// error: to sample again would replace them.
pub fn kept(job: &Job) -> Result<Option<Samples>> {
    let Ok(record) = job.load_samples_record() else { return Ok(None) };
    if record.tables.keys().any(|set| !job.table(set).exists()) {
        return Ok(None);
    }
    Ok(Some(Samples { sets: job.load_tables()?, record }))
}

/// The runs that failed.
fn failures(job: &Job, plan: &Plan, outcomes: &[Outcome]) -> Vec<FailedRun> {
    let runs = plan.named().into_iter().flat_map(|(set, points)| points.iter().enumerate().map(move |run| (set, run)));
    let failure = |((set, (run, point)), outcome): ((&str, (usize, &Vec<f64>)), &Outcome)| {
        let names = job.source.parameters().iter().map(|parameter| parameter.name.clone());
        let reason = outcome.as_ref().err()?.clone();
        Some(FailedRun { set: set.into(), run, parameters: names.zip(point.iter().copied()).collect(), reason })
    };
    runs.zip(outcomes).filter_map(failure).collect()
}

/// Says how many runs failed and why the first few did.
fn tell(job: &Job, progress: &Progress, failed: &[FailedRun], total: usize) {
    const SHOWN: usize = 3;
    if failed.is_empty() {
        return;
    }
    progress.warn(&format!("{} of {total} runs failed and are left out", failed.len()));
    for FailedRun { set, run, parameters, reason } in failed.iter().take(SHOWN) {
        let values: Vec<String> = parameters.iter().map(|(name, value)| format!("{name} = {value}")).collect();
        progress.warn(&format!("{set} run {run} with {}: {reason}", values.join(", ")));
    }
    if failed.len() > SHOWN {
        progress.warn(&format!("{} has the others", job.samples_record().display()));
    }
}

/// Refuses what is left if nothing can be trained or tested with it.
fn enough(sets: &Sets<Dataset>, failed: &[FailedRun]) -> Result<()> {
    let (found, expected) =
        ((sets.train.runs.len(), sets.test.runs.len()), "expected at least 2 to train and 1 to test");
    if found.0 >= 2 && found.1 >= 1 {
        return Ok(());
    }
    let reason = failed.first().map_or("", |failure| &failure.reason);
    let message = format!("{} training and {} test runs did not fail, {expected}: {reason}", found.0, found.1);
    Err(Error::Worker { message })
}

/// Simulates every run of the study's plan, then writes the tables and their record.
pub fn stage(job: &Job) -> Result<Samples> {
    let start = Instant::now();
    match &job.source {
        Source::Simulation(simulation) => {
            let plan = Plan::new(&job.study);
            let points = all_points(&plan);
            let journal = simulation.journal(&job.journal(), &job.study)?;
            let (outcomes, progress) = run_points(simulation, &points, points.len(), &journal)?;
            let (sets, failed) = sort(job, simulation, plan, outcomes, &progress)?;
            let samples = write(job, sets, failed, start.elapsed().as_secs_f64(), &progress)?;
            journal.remove()?;
            Ok(samples)
        }
        Source::Recorded(recorded) => {
            let sets = recorded.sample(interrupt::flag())?;
            let progress = Progress::runs(sets.named().iter().map(|(_, dataset)| dataset.runs.len()).sum());
            write(job, sets, Vec::new(), start.elapsed().as_secs_f64(), &progress)
        }
    }
}

/// Simulates a part of the study's plan and writes its file.
fn sample_shard(job: &Job, part: Shard) -> Result<super::Outcome> {
    let start = Instant::now();
    let simulation = simulated(job)?;
    let all = all_points(&Plan::new(&job.study));
    let points: Vec<Vec<f64>> = part.positions(all.len()).map(|position| all[position].clone()).collect();
    let journal = simulation.journal(&job.shard_journal(part), &job.study)?;
    let (outcomes, progress) = run_points(simulation, &points, all.len(), &journal)?;
    let path = part.file(job.folder());
    let seconds = start.elapsed().as_secs_f64();
    let failed = outcomes.iter().filter(|outcome| outcome.is_err()).count();
    shard::write(&path, &job.study, part, &outcomes, seconds)?;
    journal.remove()?;
    progress.finish(&format!("sampled shard {part}: {} runs, {failed} failed, in {seconds:.2} s", points.len()));
    if job.json {
        print_json(&serde_json::json!({ "shard": path, "runs": points.len(), "failed_runs": failed }))?;
    } else {
        print(&format!("{}\n", path.display()))?;
    }
    Ok(super::Outcome::Fine)
}

/// Writes the tables from shards: those given, else those in the folder of results.
fn merge(job: &Job, files: &[PathBuf]) -> Result<Samples> {
    let simulation = simulated(job)?;
    let plan = Plan::new(&job.study);
    let points = all_points(&plan);
    let files = if files.is_empty() { Shard::files(job.folder())? } else { files.to_vec() };
    let (outcomes, seconds) = shard::merge(&files, job.folder(), &job.study, simulation, &points)?;
    simulation.check_failures(&points, &outcomes)?;
    let progress = Progress::runs(points.len());
    let (sets, failed) = sort(job, simulation, plan, outcomes, &progress)?;
    write(job, sets, failed, seconds, &progress)
}

fn simulated(job: &Job) -> Result<&Simulation> {
    match &job.source {
        Source::Simulation(simulation) => Ok(simulation),
        Source::Recorded(_) => {
            let message = "recorded runs are not simulated: there are no shards of them".to_owned();
            Err(job.study.refuse(vec![("source".into(), message)]).expect_err("there is a problem"))
        }
    }
}

/// The points of all sets, one after the other.
fn all_points(plan: &Plan) -> Vec<Vec<f64>> {
    plan.named().map(|(_, points)| points.as_slice()).concat()
}

/// Runs points that are all or part of so many.
fn run_points(
    simulation: &Simulation,
    points: &[Vec<f64>],
    total: usize,
    journal: &Journal,
) -> Result<(Vec<Outcome>, Progress)> {
    let progress = Progress::runs(points.len());
    if !journal.is_empty() {
        progress.note(&format!("{} runs are there from a sampling that was not finished", journal.len()));
    }
    let outcomes = simulation.run_all(points, total, journal, interrupt::flag(), || progress.advance(1))?;
    Ok((outcomes, progress))
}

/// What came of the points of a plan, by set, and what failed.
fn sort(
    job: &Job,
    simulation: &Simulation,
    plan: Plan,
    outcomes: Vec<Outcome>,
    progress: &Progress,
) -> Result<(Sets<Dataset>, Vec<FailedRun>)> {
    let failed = failures(job, &plan, &outcomes);
    tell(job, progress, &failed, outcomes.len());
    let mut outcomes = outcomes.into_iter();
    let next = |points: Vec<_>| Ok(simulation.dataset(outcomes.by_ref().take(points.len()).collect()));
    let Sets { train, test, calibration } = plan.try_map(next)?;
    // only training goes on beyond the end
    let stop = job.study.time.stop;
    let sets = Sets { train, test: test.until(stop), calibration: calibration.until(stop) };
    enough(&sets, &failed)?;
    Ok((sets, failed))
}

/// Writes the tables and their record.
fn write(
    job: &Job,
    sets: Sets<Dataset>,
    failed: Vec<FailedRun>,
    sample_seconds: f64,
    progress: &Progress,
) -> Result<Samples> {
    for (_, dataset) in sets.named() {
        job.study.refuse(scaling::problems(dataset))?;
    }
    let mut record = SamplesRecord {
        sampling_digest: job.study.sampling_digest(),
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
    progress.finish(&format!(
        "sampled {train_runs} training runs ({train_rows} rows) and {test_runs} test runs in {sample_seconds:.2} s"
    ));
    // tables without a record are not trusted: it goes first and comes back last
    files::remove(&job.samples_record())?;
    for (set, dataset) in sets.named() {
        let table = job.table(set);
        if dataset.runs.is_empty() {
            files::remove(&table)?;
        } else {
            record.tables.insert(set.into(), dataset.write_csv(&table)?);
        }
    }
    files::write_json(&job.samples_record(), &record)?;
    Ok(Samples { sets, record })
}

/// Simulates further runs, those of the given points, after which there are `total`. As many may fail as of a plan of all of
/// them.
pub fn simulate(job: &Job, points: &[Vec<f64>], total: usize) -> Result<Dataset> {
    let Source::Simulation(simulation) = &job.source else {
        let problem = ("target".to_owned(), "recorded runs cannot be added to".to_owned());
        return Err(job.study.refuse(vec![problem]).expect_err("there is a problem"));
    };
    let journal = simulation.journal(&job.journal(), &job.study)?;
    let (outcomes, progress) = run_points(simulation, points, total, &journal)?;
    if let Some(reason) = outcomes.iter().find_map(|outcome| outcome.as_ref().err()) {
        let failed = outcomes.iter().filter(|outcome| outcome.is_err()).count();
        progress
            .warn(&format!("{failed} of {} further runs failed and are left out, the first: {reason}", points.len()));
    }
    let runs = simulation.dataset(outcomes);
    progress.finish(&format!("simulated {} of {} further runs", runs.runs.len(), points.len()));
    journal.remove()?;
    Ok(runs)
}
