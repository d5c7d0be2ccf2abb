//! Stages of a static map: rows of a table in, a surrogate measured on unseen rows out.

use super::{project::Project, record::TrainingRecord, train, unseen};
use crate::{Result, evaluation::Verdict};
use metafmu_runtime::Surrogate;

/// Fits a model to the rows of the table and writes the surrogate. To `resume` is to keep what an earlier fit has finished.
pub(super) fn stage(project: &Project, resume: bool) -> Result<(Surrogate, TrainingRecord)> {
    let no_runs = project.source.columns().without_runs();
    train::once(project, &no_runs, 0, None, None, resume)
}

/// Fits a model to the rows of the table and writes the surrogate; with the verdict by the unseen rows. To `resume` is to keep what an earlier fit has
/// finished.
///
/// # Errors
/// [`Error::Rows`](crate::Error::Rows), [`Error::Study`](crate::Error::Study) and [`Error::Table`](crate::Error::Table) of the table,
/// [`Error::Import`](crate::Error::Import) if no model can be fitted, [`Error::Interrupted`](crate::Error::Interrupted),
/// [`Error::Io`](crate::Error::Io).
pub fn fit(project: &Project, resume: bool) -> Result<(Surrogate, TrainingRecord, Verdict)> {
    let (surrogate, training) = stage(project, resume)?;
    let unseen = unseen::load(project, &training)?;
    let accuracy = unseen.evaluated(&surrogate).accuracy;
    let verdict = project.judge(&surrogate, &training, &accuracy, None, Vec::new());
    Ok((surrogate, training, verdict))
}
