//! `metafmu build`: the whole way from a study to a validated FMU.

use super::{
    Outcome, evaluate,
    export::{self, Plan, Written},
    job::Job,
    print, print_json, sample, train,
};
use crate::cli::BuildArgs;
use metafmu::{Result, fmu::validate};
use std::path::PathBuf;

pub fn run(args: &BuildArgs) -> Result<Outcome> {
    let job = Job::new(&args.export.study)?;
    let plan = Plan::new(&job, &args.export)?;
    job.prepare_folder()?;
    let kept = if args.resume { sample::kept(&job) } else { None };
    let samples = kept.map_or_else(|| sample::stage(&job), Ok)?;
    let (surrogate, training) = train::stage(&job, &samples.sets.train, &samples.sets.calibration, args.resume)?;
    let metrics = evaluate::stage(&job, &surrogate, &samples.sets.test, &samples.record, &training)?;
    let written = export::stage(&job, &plan, &surrogate, Some(&metrics.accuracy))?;
    let mut problems = 0;
    for Written { fmu, .. } in &written {
        let report = validate(fmu)?;
        problems += report.problems.len();
        eprint!("validated {}: {report}", fmu.display());
    }
    if job.json {
        print_json(&metrics)?;
    } else {
        print(&format!("\n{}\n", evaluate::table(&job, &metrics)))?;
        print(&files(&job, &written))?;
    }
    Ok(if problems == 0 { Outcome::Fine } else { Outcome::ProblemsFound })
}

/// Where the results are, the FMU first.
fn files(job: &Job, written: &[Written]) -> String {
    let fmu = |Written { fmu, bytes, version }: &Written| {
        let what = format!("FMI {version} co-simulation and model exchange, {} kB", bytes.div_ceil(1000));
        (fmu.clone(), what)
    };
    let others = [
        (job.model(), "network, scaling, variables: opens with safetensors in Python".into()),
        (job.metrics(), "accuracy on the test runs".into()),
        (job.history(), "loss of each epoch".into()),
        (job.table("train"), "training and validation runs".into()),
        (job.table("test"), "test runs".into()),
    ];
    let calibration = job.study.bounds.map(|_| (job.table("calibration"), "runs for the error bounds".into()));
    let rows: Vec<(PathBuf, String)> = written.iter().map(fmu).chain(others).chain(calibration).collect();
    let width = rows.iter().map(|(path, _)| path.display().to_string().len()).max().unwrap_or(0);
    rows.iter().map(|(path, what)| format!("{:<width$}  {what}\n", path.display().to_string())).collect()
}
