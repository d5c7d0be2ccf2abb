//! Ways to learn a surrogate from sampled runs, a file each.

mod compliant;
mod corner_error;
mod discrete;
pub(super) mod learned;
mod mass_matrix;
mod motion;
mod motion_networks;
mod network;
pub(super) mod per_instant;
mod state_space;
mod static_map;
mod trajectories;

use super::{follower::Trained, project::Project};
use crate::{
    Result,
    dataset::Dataset,
    study::{Study, StudyStructure, TimeStructure},
};
use metafmu_runtime::Surrogate;

/// A way to learn a surrogate from sampled runs.
pub(super) trait LearningMethod {
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
pub(super) struct Beginning<'a> {
    /// Number of the last runs that are for training only.
    pub added: usize,
    /// The surrogate of fewer runs, if there is one.
    pub start: Option<&'a Surrogate>,
    /// `true` if a stopped training continues.
    pub resume: bool,
}

/// The method of a study.
pub(super) fn method(study: &Study) -> &'static dyn LearningMethod {
    match study.structure {
        StudyStructure::Dynamics if study.has_mass_matrix() => &mass_matrix::EquationsWithMassMatrix,
        StudyStructure::Dynamics if study.source.is_run_apart() => &state_space::StateEquations,
        StudyStructure::Dynamics if study.source.is_recorded() => &trajectories::RecordedMotions,
        StudyStructure::Dynamics => &motion::EquationsOfMotion,
        StudyStructure::Discrete => &discrete::DiscreteTime,
        StudyStructure::Compliant => &compliant::ElementOfRuns,
        StudyStructure::Static => &static_map::StaticMap,
        StudyStructure::Response => match study.network.structure {
            TimeStructure::Full => &network::SingleNetwork,
            TimeStructure::Fixed => &per_instant::NetworkPerInstant,
        },
    }
}
