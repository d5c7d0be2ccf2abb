//! Response surrogates: outputs as functions of parameters and time.

mod network;
pub(crate) mod per_instant;

use super::{
    kind::{ResultFile, SurrogateKind, history, run_tables},
    learning::Learning,
    record::TrainingRecord,
};
use crate::{
    project::Project,
    study::{Study, TimeStructure},
};

/// Outputs as functions of parameters and time.
pub(super) struct ResponseKind;

impl SurrogateKind for ResponseKind {
    fn learning(&self, study: &Study) -> Learning {
        Learning::FromRuns(match study.network.structure {
            TimeStructure::Full => &network::SingleNetwork,
            TimeStructure::Fixed => &per_instant::NetworkPerInstant,
        })
    }

    fn model_content(&self) -> &'static str {
        "network, scaling"
    }

    fn files(&self, project: &Project, _: &TrainingRecord) -> Vec<ResultFile> {
        let mut files =
            vec![ResultFile::new(project.comparison(), "the network beside simpler models"), history(project)];
        files.extend(run_tables(project));
        files
    }

    fn no_baselines(&self) -> Option<&'static str> {
        None
    }
}
