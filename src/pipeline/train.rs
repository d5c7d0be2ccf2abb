//! Learns the surrogate of a study, and judges it.

use super::{rounds, training};
use crate::{
    Result, acceptance,
    dataset::Dataset,
    evaluation::Verdict,
    kinds::{self, findings, learning::Learning, prepare::held_out, record::TrainingRecord},
    project::Project,
};
use metafmu_runtime::Surrogate;
use std::path::PathBuf;

/// A surrogate that was learned and written.
pub struct TrainingResult {
    /// Record of the training.
    pub record: TrainingRecord,
    /// The verdict on the surrogate by data that it has not seen; the test runs are not among them.
    pub verdict: Verdict,
    /// The model, and the file that shows most about the training.
    pub files: [PathBuf; 2],
}

impl TrainingResult {
    fn new(project: &Project, record: TrainingRecord, verdict: Verdict) -> Self {
        let files = [project.model(), kinds::of(&project.study).training_file(project)];
        Self { record, verdict, files }
    }
}

/// Learns the surrogate of a study and writes it; with the verdict by data that it has not seen. To `resume` is to use what an earlier training
/// has finished, or else to continue from its checkpoint, if there is one.
///
/// # Errors
/// [`Error::Stale`](crate::Error::Stale) if there are no runs of this study, the errors of the method, [`Error::Io`](crate::Error::Io).
pub fn train(project: &Project, resume: bool) -> Result<TrainingResult> {
    let kind = kinds::of(&project.study);
    if let Learning::FromRows(fit) = kind.learning(&project.study) {
        project.prepare_folder()?;
        let (surrogate, training) = training::from_rows(project, fit, resume)?;
        let accuracy = kind.load_unseen(project, &training)?.test.evaluated(&surrogate).accuracy;
        let verdict = project.judge(&surrogate, &training, &accuracy, None, Vec::new());
        return Ok(TrainingResult::new(project, training, verdict));
    }
    let (train, calibration) = (project.load_table("train")?, project.load_table("calibration")?);
    project.prepare_folder()?;
    let (surrogate, training) = rounds::stage(project, &train, &calibration, resume)?;
    let verdict = judge(project, &train, &surrogate, &training);
    Ok(TrainingResult::new(project, training, verdict))
}

/// The verdict on a surrogate by the runs that were held out of its training: the test runs must not be used here.
fn judge(project: &Project, train: &Dataset, surrogate: &Surrogate, record: &TrainingRecord) -> Verdict {
    let study = &project.study;
    let held_out = held_out(study, train);
    let accuracy = kinds::of(study).unseen_runs(study, held_out).evaluated(surrogate).accuracy;
    acceptance::judge(study, surrogate, (&accuracy, "held-out runs"), None, findings(study, record))
}
