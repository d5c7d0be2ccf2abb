//! `metafmu sample`: simulates the training and test runs and writes their tables.

use super::{Outcome, interrupt, job::Job, job::SamplesRecord, print, print_json, progress::Progress};
use crate::cli::SampleArgs;
use metafmu::{
    Result,
    dataset::Dataset,
    files,
    sampling::Plan,
    source::{Journal, Source},
};
use std::{fmt::Write, time::Instant};

/// The sampled runs.
pub struct Samples {
    pub train: Dataset,
    pub test: Dataset,
    pub record: SamplesRecord,
}

pub fn run(args: &SampleArgs) -> Result<Outcome> {
    let job = Job::new(&args.study)?;
    if args.dry_run {
        print(&plan_table(&job)?)?;
        return Ok(Outcome::Fine);
    }
    job.prepare_folder()?;
    let samples = stage(&job)?;
    if job.json {
        print_json(&samples.record)?;
    } else {
        print(&format!("{}\n{}\n", job.train_table().display(), job.test_table().display()))?;
    }
    Ok(Outcome::Fine)
}

/// The plan as CSV: `set,run,<parameters>`.
fn plan_table(job: &Job) -> Result<String> {
    let plan = match &job.source {
        Source::Simulation(_) => Plan::new(&job.study),
        Source::Recorded(recorded) => {
            let (train, test) = recorded.sample(interrupt::flag())?;
            let points = |dataset: Dataset| dataset.runs.into_iter().map(|run| run.parameters).collect();
            Plan { train: points(train), test: points(test) }
        }
    };
    let names: String = job.source.parameters().iter().map(|parameter| format!(",{}", parameter.name)).collect();
    let mut text = format!("set,run{names}\n");
    for (set, points) in [("train", &plan.train), ("test", &plan.test)] {
        for (run, point) in points.iter().enumerate() {
            let values: String = point.iter().map(|value| format!(",{value:?}")).collect();
            // writing to a string does not fail
            let _ = writeln!(text, "{set},{run}{values}");
        }
    }
    Ok(text)
}

/// The runs that an earlier command has sampled from this study, if it came so far.
pub fn kept(job: &Job) -> Option<Samples> {
    let record = job.load_samples_record().ok()?;
    Some(Samples { train: job.load_train_table().ok()?, test: job.load_test_table().ok()?, record })
}

/// Simulates every run of the study's plan, then writes the tables and their record.
pub fn stage(job: &Job) -> Result<Samples> {
    let start = Instant::now();
    let mut journal = None;
    let (progress, train, test) = match &job.source {
        Source::Simulation(simulation) => {
            let plan = Plan::new(&job.study);
            let progress = Progress::runs(plan.train.len() + plan.test.len());
            let kept = simulation.journal(&job.journal(), &job.study)?;
            if !kept.is_empty() {
                progress.note(&format!("{} runs are there from a sampling that was not finished", kept.len()));
            }
            let run_all = |points| simulation.run_all(points, &kept, interrupt::flag(), || progress.advance(1));
            let (train, test) = (run_all(&plan.train)?, run_all(&plan.test)?);
            journal = Some(kept);
            (progress, train, test)
        }
        Source::Recorded(recorded) => {
            let (train, test) = recorded.sample(interrupt::flag())?;
            (Progress::runs(train.runs.len() + test.runs.len()), train, test)
        }
    };
    let record = SamplesRecord {
        sampling_digest: job.study.sampling_digest(),
        train_runs: train.runs.len(),
        train_rows: train.row_count(),
        test_runs: test.runs.len(),
        test_rows: test.row_count(),
        sample_seconds: start.elapsed().as_secs_f64(),
    };
    let SamplesRecord { train_runs, train_rows, test_runs, sample_seconds, .. } = record;
    progress.finish(&format!(
        "sampled {train_runs} training runs ({train_rows} rows) and {test_runs} test runs in {sample_seconds:.2} s"
    ));
    // tables without a record are not trusted: it goes first and comes back last
    files::remove(&job.samples_record())?;
    train.write_csv(&job.train_table())?;
    test.write_csv(&job.test_table())?;
    files::write_json(&job.samples_record(), &record)?;
    journal.map_or(Ok(()), Journal::remove)?;
    Ok(Samples { train, test, record })
}
