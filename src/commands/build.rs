//! `metafmu build`: the whole way from a study to a validated FMU.

use super::{Outcome, evaluate, export, job::Job, print, print_json, sample, train};
use crate::cli::StudyArgs;
use metafmu::{Result, fmu::validate};

pub fn run(args: &StudyArgs) -> Result<Outcome> {
    let job = Job::new(args)?;
    job.prepare_folder()?;
    let samples = sample::stage(&job)?;
    let (surrogate, training) = train::stage(&job, &samples.train)?;
    let metrics = evaluate::stage(&job, &surrogate, &samples.test, &samples.record, &training)?;
    let size = export::stage(&job, &surrogate)?;
    let report = validate(job.fmu())?;
    if job.json {
        print_json(&metrics)?;
    } else {
        print(&format!("\n{}\n", evaluate::table(&job, &metrics)))?;
        print(&files(&job, size))?;
    }
    eprint!("validated: {report}");
    Ok(if report.problems.is_empty() { Outcome::Fine } else { Outcome::ProblemsFound })
}

/// Where the results are, the FMU first.
fn files(job: &Job, size: usize) -> String {
    let rows = [
        (job.fmu(), format!("FMI 2.0 co-simulation, {} kB", size.div_ceil(1000))),
        (job.model(), "network, scaling, variables: opens with safetensors in Python".into()),
        (job.metrics(), "accuracy on the test runs".into()),
        (job.history(), "loss of each epoch".into()),
        (job.train_table(), "training and validation runs".into()),
        (job.test_table(), "test runs".into()),
    ];
    let width = rows.iter().map(|(path, _)| path.display().to_string().len()).max().unwrap_or(0);
    rows.iter().map(|(path, what)| format!("{:<width$}  {what}\n", path.display().to_string())).collect()
}
