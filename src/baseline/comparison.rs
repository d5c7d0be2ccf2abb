//! The table of models side by side: `comparison.json` and `comparison.csv`.

use crate::evaluation::OutputMetrics;
use indexmap::IndexMap;
use serde::{Deserialize, Serialize};

/// Name of the network's row.
pub const NETWORK: &str = "network";

/// Models of one study measured on the same test runs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Comparison {
    /// Name of the study.
    pub name: String,
    /// Number of test runs.
    pub test_runs: usize,
    /// Number of rows of all of them.
    pub test_rows: usize,
    /// One row a model, the network first.
    pub models: Vec<ModelRow>,
}

/// What became of one model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModelRow {
    /// [`NETWORK`], or the baseline's name as in the study.
    pub model: String,
    /// Whether there are figures.
    pub status: Status,
    /// What a reader must know beside the figures, for instance `on 2000 of 267531 rows`, or why there are none.
    pub note: String,
    /// Number of rows it was fitted to; 0 if it was not.
    pub rows: usize,
    /// Seconds that fitting took, with all outputs.
    pub fit_seconds: Option<f64>,
    /// Seconds of one prediction of all outputs at one point, on one core, in the test rows' order.
    pub predict_seconds_per_point: Option<f64>,
    /// Bytes of the fitted model.
    pub memory_bytes: Option<u64>,
    /// Whether `metafmu export --model` packages it.
    pub exportable: bool,
    /// Accuracy of each output, by name; empty if there is none.
    pub outputs: IndexMap<String, ModelAccuracy>,
}

/// Whether there are figures of a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Status {
    /// There are.
    Fine,
    /// It could not be fitted, or gave no finite numbers.
    Failed,
    /// It took longer than its time budget.
    #[serde(rename = "too slow")]
    TooSlow,
    /// Ctrl-C came before it was done.
    Stopped,
}

/// Accuracy of one output over all test rows, in the output's unit; see [`OutputMetrics`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModelAccuracy {
    /// Coefficient of determination; none for a constant output.
    pub r2: Option<f64>,
    /// Mean squared error.
    pub mse: f64,
    /// Largest absolute error.
    pub max_abs_error: f64,
}

impl From<&OutputMetrics> for ModelAccuracy {
    fn from(metrics: &OutputMetrics) -> Self {
        let OutputMetrics { r2, mse, max_abs_error, .. } = *metrics;
        Self { r2, mse, max_abs_error }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_comparison_reads_back_as_it_was_written() {
        let accuracy = ModelAccuracy { r2: Some(0.99), mse: 1.0 / 3.0, max_abs_error: 0.5 };
        let row = ModelRow {
            model: NETWORK.into(),
            status: Status::Fine,
            note: String::new(),
            rows: 267_531,
            fit_seconds: Some(58.0),
            predict_seconds_per_point: Some(1e-6),
            memory_bytes: Some(72_000),
            exportable: true,
            outputs: [("theta".to_owned(), accuracy)].into_iter().collect(),
        };
        let slow = ModelRow {
            model: "forest".into(),
            status: Status::TooSlow,
            note: "not done after 60 s".into(),
            fit_seconds: None,
            predict_seconds_per_point: None,
            memory_bytes: None,
            outputs: IndexMap::new(),
            ..row.clone()
        };
        let models = vec![row, slow];
        let comparison = Comparison { name: "pendulum".into(), test_runs: 200, test_rows: 40_200, models };
        let text = serde_json::to_string(&comparison).unwrap();
        assert!(text.contains(r#""status":"too slow""#), "{text}");
        assert!(text.contains(r#""theta":{"r2":0.99,"mse":0.3333333333333333,"max_abs_error":0.5}"#), "{text}");
        assert_eq!(serde_json::from_str::<Comparison>(&text).unwrap(), comparison);
    }
}
