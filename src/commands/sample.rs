//! `metafmu sample`: simulates the training and test runs and writes their tables.

use super::{Outcome, interrupt, job::Job, job::SamplesRecord, print, print_json, progress::Progress};
use crate::cli::StudyArgs;
use metafmu::{Result, dataset::Dataset, files, sampling::Plan};
use std::time::Instant;

/// The sampled runs.
pub struct Samples {
    pub train: Dataset,
    pub test: Dataset,
    pub record: SamplesRecord,
}

pub fn run(args: &StudyArgs) -> Result<Outcome> {
    let job = Job::new(args)?;
    job.prepare_folder()?;
    let samples = stage(&job)?;
    if job.json {
        print_json(&samples.record)?;
    } else {
        print(&format!("{}\n{}\n", job.train_table().display(), job.test_table().display()))?;
    }
    Ok(Outcome::Fine)
}

/// Simulates every run of the study's plan, then writes the tables and their record.
pub fn stage(job: &Job) -> Result<Samples> {
    let plan = Plan::new(&job.study);
    let start = Instant::now();
    let progress = Progress::runs(plan.train.len() + plan.test.len());
    let train = job.source.run_all(&plan.train, interrupt::flag(), || progress.advance(1))?;
    let test = job.source.run_all(&plan.test, interrupt::flag(), || progress.advance(1))?;
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
    Ok(Samples { train, test, record })
}
