//! Static maps: outputs as functions of inputs, from the rows of a table without a time.

pub mod fit;
mod learn;
mod unseen_table;

use super::{
    kind::{Fact, ResultFile, SurrogateKind, history},
    learning::Learning,
    record::{MethodRecord, StaticRecord, TrainingRecord},
    unseen::UnseenData,
};
use crate::{
    Result,
    dataset::Dataset,
    project::{Project, SamplesRecord},
    study::Study,
};
use std::path::PathBuf;

/// Outputs as functions of inputs.
pub(super) struct StaticKind;

impl SurrogateKind for StaticKind {
    fn learning(&self, _: &Study) -> Learning {
        Learning::FromRows(learn::learn)
    }

    fn model_content(&self) -> &'static str {
        "map of inputs to outputs"
    }

    fn files(&self, project: &Project, training: &TrainingRecord) -> Vec<ResultFile> {
        let mut files = vec![
            ResultFile::new(project.comparison(), "kinds of model"),
            ResultFile::new(project.unseen(), "unseen rows and their predictions"),
        ];
        if training.epochs > 0 {
            files.push(history(project));
        }
        files
    }

    fn metrics_content(&self) -> &'static str {
        "accuracy on the unseen rows"
    }

    fn training_file(&self, project: &Project) -> PathBuf {
        project.unseen()
    }

    fn unseen_table(&self, project: &Project) -> PathBuf {
        project.unseen()
    }

    fn load_unseen(&self, project: &Project, training: &TrainingRecord) -> Result<UnseenData> {
        unseen_table::load(project, training)
    }

    fn load_calibration(&self, _: &Project) -> Result<Option<Dataset>> {
        Ok(None)
    }

    fn no_baselines(&self) -> Option<&'static str> {
        Some(
            "`metafmu train` compares the kinds of model of a static map, and `static.model` names the one that is exported",
        )
    }

    fn no_other_beside(&self) -> Option<&'static str> {
        Some("each static map is measured on other rows: the report shows one study, without --beside")
    }

    fn subject(&self) -> Option<&'static str> {
        Some("A static map")
    }

    fn facts(&self, project: &Project, samples: &SamplesRecord, training: &TrainingRecord) -> Vec<Fact> {
        vec![
            Fact::new("Source", "table of rows"),
            Fact::new("Rows of the table", samples.train_rows.to_string()),
            Fact::new("Unseen rows", samples.test_rows.to_string()),
            Fact::new("Fit", training.describe(&project.study)),
            Fact::new("Fit took", format!("{:.1} s", training.train_seconds)),
        ]
    }

    fn advice(&self, _: &Study, training: &TrainingRecord) -> Vec<String> {
        record(training)
            .map(|StaticRecord { rows, .. }| format!("add rows to the table, which has {rows}"))
            .into_iter()
            .collect()
    }
}

/// Record of the fit of a static map.
fn record(training: &TrainingRecord) -> Option<&StaticRecord> {
    match &training.method {
        Some(MethodRecord::StaticMap(record)) => Some(record),
        _ => None,
    }
}
