//! The table of models side by side: `comparison.json` and `comparison.csv`.

use super::OutputMetrics;
use crate::diagnostics::numbers::{self, counted, power};
use indexmap::{IndexMap, IndexSet};
use serde::{Deserialize, Serialize};
use std::fmt::Write;

/// Name of the network's row.
pub use crate::study::NETWORK;

/// Models of one study measured on the same test runs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Comparison {
    /// Name of the study.
    pub name: String,
    /// Digest of the network's model file, as in its provenance; none if there was no network.
    pub content_digest: Option<String>,
    /// Number of test runs.
    pub test_runs: usize,
    /// Number of rows of all of them.
    pub test_rows: usize,
    /// One row a model, the network first.
    pub models: Vec<ModelRow>,
}

/// Result of one model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModelRow {
    /// [`NETWORK`], or the baseline's name as in the study.
    pub model: String,
    /// Status; [`ModelStatus::Fine`] if there are metrics.
    pub status: ModelStatus,
    /// Remark on the metrics, for instance `on 2000 of 267531 rows`, or the reason why there are none.
    pub note: String,
    /// Number of rows it was fitted to; 0 if it was not.
    pub rows: usize,
    /// Processor seconds of fitting all outputs.
    pub fit_seconds: Option<f64>,
    /// Seconds of one prediction of all outputs at one point, on one core, in the test rows' order.
    pub predict_seconds_per_point: Option<f64>,
    /// Bytes of the fitted model.
    pub memory_bytes: Option<u64>,
    /// `true` if `metafmu export --model` packages it.
    pub exportable: bool,
    /// Accuracy of each output, by name; empty if there is none.
    pub outputs: IndexMap<String, ModelAccuracy>,
}

/// Status of a model in a comparison.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ModelStatus {
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

impl ModelStatus {
    /// As in `comparison.json`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Fine => "fine",
            Self::Failed => "failed",
            Self::TooSlow => "too slow",
            Self::Stopped => "stopped",
        }
    }
}

impl ModelRow {
    /// The smallest coefficient of determination of an output.
    pub fn worst_r2(&self) -> Option<f64> {
        self.outputs.values().filter_map(|accuracy| accuracy.r2).reduce(f64::min)
    }

    /// One line for people.
    pub fn summary(&self) -> String {
        let Self { model, status, note, .. } = self;
        match (self.worst_r2(), self.fit_seconds) {
            (Some(r2), Some(seconds)) => {
                let r2 = if r2.abs() < 1e4 { format!("{r2:.5}") } else { power(r2, 2) };
                format!("{model}: smallest R² {r2}, fitted in {seconds:.2} CPU s")
            }
            _ => format!("{model}: {}: {note}", status.name()),
        }
    }
}

impl Comparison {
    /// Returns true if the user stopped it before every model was measured.
    pub fn was_interrupted(&self) -> bool {
        self.models.iter().any(|row| row.status == ModelStatus::Stopped)
    }

    /// The rows as a table for people.
    pub fn table(&self) -> String {
        let Self { name, test_runs, test_rows, models, .. } = self;
        let outputs: Vec<&String> =
            models.iter().flat_map(|row| row.outputs.keys()).collect::<IndexSet<_>>().into_iter().collect();
        // a static map has rows, each of which is a run
        let on = match test_runs == test_rows {
            true => format!("{test_rows} unseen rows, each kind of model separately"),
            false => format!("{}, {}", counted(*test_runs, "unseen run"), counted(*test_rows, "row")),
        };
        let mut text = format!("{name} on {on}\n\n{:<18}", "R² of");
        // writing to a string does not fail
        let _ = outputs.iter().try_for_each(|output| write!(text, " {output:>11.11}"));
        let _ = writeln!(text, " {:>10} {:>11} {:>9}  note", "fit, CPU s", "prediction", "memory");
        for row in models {
            let _ = write!(text, "{:<18}", row.model);
            if row.status != ModelStatus::Fine {
                let _ = writeln!(text, " {}: {}", row.status.name(), row.note);
                continue;
            }
            for output in &outputs {
                let r2 = row.outputs.get(*output).and_then(|accuracy| accuracy.r2);
                let _ = write!(text, " {:>11}", r2.map_or("constant".into(), numbers::r2));
            }
            let fit = row.fit_seconds.map_or(String::new(), |seconds| format!("{seconds:.2}"));
            let point =
                row.predict_seconds_per_point.map_or(String::new(), |seconds| format!("{:.2} us", seconds * 1e6));
            let memory = row.memory_bytes.map_or(String::new(), |bytes| format!("{:.1} kB", bytes as f64 / 1e3));
            let _ = writeln!(text, " {fit:>10} {point:>11} {memory:>9}  {}", row.note);
        }
        text
    }

    /// The rows as CSV: a line for each output of a model, or one without an output.
    pub fn csv(&self) -> String {
        let mut text = String::from(
            "model,status,output,r2,mse,max_abs_error,rows,fit_seconds,predict_seconds_per_point,memory_bytes,exportable,note\n",
        );
        let number = |value: Option<f64>| value.map_or(String::new(), |value| format!("{value:?}"));
        for row in &self.models {
            let before = format!("{},{}", row.model, row.status.name());
            let memory = row.memory_bytes.map_or(String::new(), |bytes| bytes.to_string());
            let times = [row.fit_seconds, row.predict_seconds_per_point].map(number).join(",");
            let note = row.note.replace('"', "\"\"").replace('\n', " ");
            let after = format!("{},{times},{memory},{},\"{note}\"", row.rows, row.exportable);
            for (output, ModelAccuracy { r2, mse, max_abs_error }) in &row.outputs {
                let r2 = number(*r2);
                let _ = writeln!(text, "{before},{output},{r2},{mse:?},{max_abs_error:?},{after}");
            }
            if row.outputs.is_empty() {
                let _ = writeln!(text, "{before},,,,,{after}");
            }
        }
        text
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
            status: ModelStatus::Fine,
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
            status: ModelStatus::TooSlow,
            note: "not done after 60 s".into(),
            fit_seconds: None,
            predict_seconds_per_point: None,
            memory_bytes: None,
            outputs: IndexMap::new(),
            ..row.clone()
        };
        let models = vec![row, slow];
        let comparison =
            Comparison { name: "pendulum".into(), content_digest: None, test_runs: 200, test_rows: 40_200, models };
        let text = serde_json::to_string(&comparison).unwrap();
        assert!(text.contains(r#""status":"too slow""#), "{text}");
        assert!(text.contains(r#""theta":{"r2":0.99,"mse":0.3333333333333333,"max_abs_error":0.5}"#), "{text}");
        assert_eq!(serde_json::from_str::<Comparison>(&text).unwrap(), comparison);
        assert!(
            comparison.table().contains("forest             too slow: not done after 60 s"),
            "{}",
            comparison.table()
        );
        let csv = comparison.csv();
        assert!(
            csv.contains("\nnetwork,fine,theta,0.99,0.3333333333333333,0.5,267531,58.0,1e-6,72000,true,\"\"\n"),
            "{csv}"
        );
        assert!(csv.ends_with("\nforest,too slow,,,,,267531,,,,true,\"not done after 60 s\"\n"), "{csv}");
    }
}
