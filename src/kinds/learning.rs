//! Ways to learn a surrogate.

use super::record::TrainingRecord;
use crate::{Result, dataset::Dataset, project::Project, training::EpochRecord};
use metafmu_runtime::Surrogate;

/// Way in which the surrogate of a study is learned.
pub enum Learning {
    /// From runs of its source.
    FromRuns(&'static dyn LearningMethod),
    /// From the rows of its table, which have no time.
    FromRows(fn(&Project) -> Result<Trained>),
}

/// A way to learn a surrogate from sampled runs.
pub trait LearningMethod {
    /// Evaluates a few of the source's equations, to refuse unusable ones before any run is sampled.
    ///
    /// # Errors
    /// Those of [`learn`](Self::learn) that a few equations show.
    fn check(&self, _: &Project) -> Result<()> {
        Ok(())
    }

    /// The surrogate, and how it was learned. The last runs of the data set may be for training only.
    ///
    /// # Errors
    /// [`Error::Interrupted`](crate::Error::Interrupted) if the work ended before there was a surrogate, and those of the method.
    fn learn(&self, project: &Project, dataset: &Dataset, begin: &Beginning) -> Result<Trained>;
}

/// Start of a method.
pub struct Beginning<'a> {
    /// Number of the last runs that are for training only.
    pub added: usize,
    /// The surrogate of fewer runs, if there is one.
    pub start: Option<&'a Surrogate>,
    /// `true` if a stopped training continues.
    pub resume: bool,
}

/// The result of a training.
pub struct Trained {
    /// The surrogate, without error bounds that are measured on runs.
    pub surrogate: Surrogate,
    /// The loss, epoch by epoch.
    pub history: Vec<EpochRecord>,
    /// Record of the training.
    pub record: TrainingRecord,
}
