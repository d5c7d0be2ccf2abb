//! Equations of motion: derivatives as functions of states, inputs and parameters.

mod corner_error;
mod corners;
mod learned;
mod mass_matrix;
mod motion;
mod motion_networks;
mod solver;
mod state_space;
mod trajectories;

use super::{
    kind::{ResultFile, SurrogateKind, run_tables},
    learning::Learning,
    record::{MethodRecord, TrainingRecord},
};
use crate::{project::Project, study::Study};

/// Derivatives as functions of states, inputs and parameters.
pub(super) struct DynamicsKind;

impl SurrogateKind for DynamicsKind {
    fn learning(&self, study: &Study) -> Learning {
        Learning::FromRuns(if study.has_mass_matrix() {
            &mass_matrix::EquationsWithMassMatrix
        } else if study.source.is_run_apart() {
            &state_space::StateEquations
        } else if study.source.is_recorded() {
            &trajectories::RecordedMotions
        } else {
            &motion::EquationsOfMechanism
        })
    }

    fn model_content(&self) -> &'static str {
        "equations of motion"
    }

    fn files(&self, project: &Project, _: &TrainingRecord) -> Vec<ResultFile> {
        run_tables(project)
    }

    fn has_equations(&self) -> bool {
        true
    }

    fn usual_sampling(&self) -> &'static str {
        "random starts, parameters and inputs"
    }

    fn more_samples(&self, _: &Study, training: &TrainingRecord) -> String {
        match &training.method {
            Some(MethodRecord::Motion(motion)) if !motion.may_gain_from_states() => "smaller ranges".into(),
            _ => "more `sampling.states`, or smaller ranges".into(),
        }
    }
}
