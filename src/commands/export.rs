//! `metafmu export`: packages the surrogate as an FMU.

use super::{Outcome, job::Job, print, print_json};
use crate::cli::StudyArgs;
use metafmu::{Result, files, fmu};
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
    let fmu = fmu::pack(surrogate, &job.study.export)?;
    files::write_whole(&job.fmu(), &fmu)?;
    Ok(fmu.len())
}
