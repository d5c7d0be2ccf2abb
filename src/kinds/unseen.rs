//! Unseen data, in the form in which a surrogate is measured on them.

use crate::{
    dataset::Dataset,
    evaluation::{TestRows, predict_rows},
    project::SamplesRecord,
    report::Evaluated,
};
use metafmu_runtime::{Rows, Surrogate};

/// Data that a surrogate is measured on.
pub struct UnseenData {
    /// The data that its accuracy is measured on.
    pub test: UnseenRuns,
    /// Record of all samples.
    pub record: SamplesRecord,
}

/// Unseen runs, or rows as runs of a single row.
pub struct UnseenRuns {
    /// The runs. If they are rows, the parameters of each are the inputs.
    pub runs: Dataset,
    rows: Option<MeasuredRows>,
}

/// Rows without order.
struct MeasuredRows {
    kind: TestRows,
    /// Predictions by a model that was fitted without them; none if the surrogate itself has not seen them.
    predictions: Option<Rows>,
}

impl UnseenRuns {
    /// Runs, along which a surrogate is simulated.
    pub(super) fn of_runs(runs: Dataset) -> Self {
        Self { runs, rows: None }
    }

    /// Rows of unseen runs.
    pub(super) fn rows_of_runs(rows: Dataset) -> Self {
        Self { runs: rows, rows: Some(MeasuredRows { kind: TestRows::OfRuns, predictions: None }) }
    }

    /// Rows with their predictions.
    pub(super) fn predicted(rows: Dataset, predictions: Rows, kind: TestRows) -> Self {
        Self { runs: rows, rows: Some(MeasuredRows { kind, predictions: Some(predictions) }) }
    }

    /// A surrogate on them.
    pub(crate) fn evaluated<'a>(&'a self, surrogate: &'a Surrogate) -> Evaluated<'a> {
        match &self.rows {
            None => Evaluated::new(surrogate, &self.runs),
            Some(MeasuredRows { kind, predictions: Some(predictions) }) => {
                Evaluated::of_rows(surrogate, &self.runs, predictions, *kind)
            }
            Some(MeasuredRows { kind, predictions: None }) => {
                let points: Rows = self.runs.runs.iter().map(|row| &row.parameters).collect();
                Evaluated::of_rows(surrogate, &self.runs, &predict_rows(surrogate, &points), *kind)
            }
        }
    }
}
