//! `metafmu export`: packages the surrogate as an FMU.

use super::{Outcome, job::Job, print, print_json};
use crate::cli::StudyArgs;
use metafmu::{Result, fmu::package};
use metafmu_runtime::Surrogate;

pub fn run(args: &StudyArgs) -> Result<Outcome> {
    let job = Job::new(args)?;
    let surrogate = job.load_model()?;
    job.prepare_folder()?;
    let size = stage(&job, &surrogate)?;
    if job.json {
        print_json(&serde_json::json!({ "fmu": job.fmu(), "bytes": size }))?;
    } else {
        print(&format!("{}\n", job.fmu().display()))?;
    }
    Ok(Outcome::Fine)
}

/// Writes the FMU and returns its size in bytes.
pub fn stage(job: &Job, surrogate: &Surrogate) -> Result<usize> {
    let bytes = package::package(surrogate, &job.study.export)?;
    let size = bytes.len();
    metafmu::files::write_whole(&job.fmu(), |file| std::io::Write::write_all(file, &bytes))?;
    Ok(size)
}
