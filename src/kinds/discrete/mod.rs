//! Discrete-time models: outputs as functions of past outputs, past inputs and parameters.

mod learn;

use super::{
    kind::{ResultFile, SurrogateKind, history, run_tables},
    learning::Learning,
    record::TrainingRecord,
};
use crate::{project::Project, study::Study};

/// Outputs as functions of past outputs, past inputs and parameters.
pub(super) struct DiscreteKind;

impl SurrogateKind for DiscreteKind {
    fn learning(&self, _: &Study) -> Learning {
        Learning::FromRuns(&learn::DiscreteModels)
    }

    fn model_content(&self) -> &'static str {
        "network, scaling"
    }

    fn interfaces(&self) -> &'static str {
        "co-simulation"
    }

    fn files(&self, project: &Project, _: &TrainingRecord) -> Vec<ResultFile> {
        let mut files = vec![history(project)];
        files.extend(run_tables(project));
        files
    }

    fn more_structure(&self, study: &Study) -> Option<String> {
        Some(format!("a longer memory: `discrete.history` above {}", study.discrete.history))
    }
}
