//! Rows that a static map is measured on, and their predictions: `unseen.csv`.

use super::{
    project::{Project, SamplesRecord},
    record::{MethodRecord, StaticRecord, TrainingRecord},
};
use crate::{
    Error, Result,
    dataset::Dataset,
    evaluation::TestRows,
    files,
    report::Evaluated,
    table::{Table, header_field},
    variable::SourceVariable,
};
use indexmap::IndexMap;
use metafmu_runtime::{Output, Rows, Surrogate};
use std::fmt::Write;

/// Unseen rows of a static map.
pub(super) struct Unseen {
    /// A run of a single row for each, whose parameters are the inputs.
    pub(super) test: Dataset,
    predictions: Rows,
    kind: TestRows,
}

/// The rows as CSV: where each is in the table, inputs, outputs and predictions, with their standard deviations if there are any.
pub(super) fn csv(places: &[u64], test: &Dataset, predictions: &Rows) -> String {
    let names = |variables: &[SourceVariable]| variables.iter().map(|of| of.name.clone()).collect::<Vec<_>>();
    let mut columns = vec!["row".to_owned()];
    let has_std = predictions.width() > test.outputs.len();
    let stds = names(&test.outputs).into_iter().filter(|_| has_std).map(|name| Output::std_name(&name));
    let predicted = names(&test.outputs).into_iter().chain(stds).map(|name| format!("predicted {name}"));
    for mut name in names(&test.parameters).into_iter().chain(names(&test.outputs)).chain(predicted) {
        while columns.contains(&name) {
            name.push('_');
        }
        columns.push(name);
    }
    let header: Vec<String> = columns.iter().map(|name| header_field(name)).collect();
    let mut text = format!("{}\n", header.join(","));
    for ((place, run), predictions) in places.iter().zip(&test.runs).zip(predictions) {
        let _ = write!(text, "{place}");
        for value in run.parameters.iter().chain(&run.outputs).chain(predictions) {
            // writing to a string does not fail
            let _ = write!(text, ",{value:?}");
        }
        text.push('\n');
    }
    text
}

/// Reads the rows that belong to a surrogate of the project.
///
/// # Errors
/// [`Error::Stale`] if the table is missing or was changed, or the record is of another method.
pub(super) fn load(project: &Project, training: &TrainingRecord) -> Result<Unseen> {
    let path = project.unseen();
    let stale =
        |message: &str| Error::Stale { path: path.clone(), message: format!("{message}: run `metafmu train` again") };
    let record = record(training).ok_or_else(|| stale("the surrogate beside it is of another structure"))?;
    if !path.exists() {
        return Err(stale("does not exist"));
    }
    if files::digest(&path)? != record.unseen_digest {
        return Err(stale("was changed since it was written"));
    }
    let (inputs, outputs) = (project.source.inputs(), project.source.outputs());
    let predicted = if project.study.static_map.std { 2 * outputs.len() } else { outputs.len() };
    let mut table = Table::open(&path)?;
    let (mut points, mut labels, mut predictions) = (Rows::default(), Rows::default(), Rows::default());
    while table.next_row()? {
        let mut column = 1;
        let mut next = |count: usize| -> Result<Vec<f64>> {
            let values = (column..column + count).map(|column| table.number(column)).collect();
            column += count;
            values
        };
        points.push(&next(inputs.len())?);
        labels.push(&next(outputs.len())?);
        predictions.push(&next(predicted)?);
    }
    Ok(Unseen { test: Dataset::of_rows(inputs, outputs, &points, &labels), predictions, kind: record.unseen })
}

impl Unseen {
    /// A surrogate on them.
    pub(super) fn evaluated<'a>(&'a self, surrogate: &'a Surrogate) -> Evaluated<'a> {
        Evaluated::of_rows(surrogate, &self.test, &self.predictions, self.kind)
    }
}

/// Record of the fit of a static map.
fn record(training: &TrainingRecord) -> Option<&StaticRecord> {
    match &training.method {
        Some(MethodRecord::StaticMap(record)) => Some(record),
        _ => None,
    }
}

/// The rows of the table as a record of samples.
pub(super) fn samples(project: &Project, training: &TrainingRecord) -> SamplesRecord {
    let of = |count: fn(&StaticRecord) -> usize| record(training).map_or(0, count);
    SamplesRecord {
        sampling_digest: project.study.sampling_digest(),
        train_runs: of(|record| record.rows),
        train_rows: of(|record| record.rows),
        test_runs: of(|record| record.unseen_rows),
        test_rows: of(|record| record.unseen_rows),
        calibration_runs: 0,
        tables: IndexMap::new(),
        sample_seconds: record(training).map_or(0.0, |record| record.read_seconds),
        failed_runs: 0,
        failed: Vec::new(),
    }
}
