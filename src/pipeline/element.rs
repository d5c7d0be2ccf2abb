//! Test data in the form in which a surrogate is measured: runs, or of a compliant element their rows.

use super::project::Project;
use crate::{
    compliant::{ElementColumns, ElementRows},
    dataset::Dataset,
    evaluation::{TestRows, predict_rows},
    report::Evaluated,
    study::Study,
};
use metafmu_runtime::{Rows, Surrogate};
use std::borrow::Cow;

/// The runs, or of a compliant element a run of a single row for each of their rows, whose parameters are the inputs.
pub(super) fn test_data<'a>(study: &Study, runs: &'a Dataset) -> Cow<'a, Dataset> {
    if !study.is_compliant() {
        return Cow::Borrowed(runs);
    }
    let ElementColumns { inputs, outputs } = ElementColumns::of(study, runs);
    let rows = ElementRows::of(study, runs, &runs.runs);
    Cow::Owned(Dataset::of_rows(&inputs, &outputs, &rows.points, &rows.forces))
}

/// A surrogate on [`test_data`].
pub(super) fn evaluated<'a>(project: &Project, surrogate: &'a Surrogate, test: &'a Dataset) -> Evaluated<'a> {
    if !project.study.is_compliant() {
        return Evaluated::new(surrogate, test);
    }
    let points: Rows = test.runs.iter().map(|row| &row.parameters).collect();
    Evaluated::of_rows(surrogate, test, &predict_rows(surrogate, &points), TestRows::OfRuns)
}
