//! Compliant elements: forces of a flexible part as functions of relative positions and velocities.

mod learn;

use super::{
    kind::{ResultFile, SurrogateKind, run_tables},
    learning::Learning,
    record::TrainingRecord,
    unseen::UnseenRuns,
};
use crate::{
    compliant::{ElementColumns, ElementRows},
    dataset::Dataset,
    project::Project,
    study::Study,
};

/// Forces of a flexible part as functions of relative positions and velocities.
pub(super) struct CompliantKind;

impl SurrogateKind for CompliantKind {
    fn learning(&self, _: &Study) -> Learning {
        Learning::FromRuns(&learn::ElementOfRuns)
    }

    fn model_content(&self) -> &'static str {
        "potential and dissipation"
    }

    fn files(&self, project: &Project, _: &TrainingRecord) -> Vec<ResultFile> {
        run_tables(project)
    }

    /// Each row of the runs alone: forces do not depend on the past.
    fn unseen_runs(&self, study: &Study, runs: Dataset) -> UnseenRuns {
        let ElementColumns { inputs, outputs } = ElementColumns::of(study, &runs);
        let rows = ElementRows::of(study, &runs, &runs.runs);
        UnseenRuns::rows_of_runs(Dataset::of_rows(&inputs, &outputs, &rows.points, &rows.forces))
    }

    fn no_other_beside(&self) -> Option<&'static str> {
        Some("compliant elements are measured on rows: the report shows one study, without --beside")
    }

    fn no_speed(&self, _: &Study) -> Option<&'static str> {
        Some("another component moves it, so no run is compared")
    }

    fn subject(&self) -> Option<&'static str> {
        Some("A compliant element, which creates no energy,")
    }

    fn more_samples(&self, _: &Study, _: &TrainingRecord) -> String {
        "more `sampling.runs`, or motions that reach more of the ranges".into()
    }
}
