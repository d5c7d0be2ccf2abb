//! Rows that a static map is measured on, and their predictions: `unseen.csv`.

use super::record;
use crate::{
    Error, Result,
    dataset::Dataset,
    files,
    kinds::{
        record::{StaticRecord, TrainingRecord},
        unseen::{UnseenData, UnseenRuns},
    },
    project::{Project, SamplesRecord},
    table::{Table, header_field},
    variable::SourceVariable,
};
use indexmap::IndexMap;
use metafmu_runtime::{Output, Rows};
use std::fmt::Write;

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
pub(super) fn load(project: &Project, training: &TrainingRecord) -> Result<UnseenData> {
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
    let rows = Dataset::of_rows(inputs, outputs, &points, &labels);
    let test = UnseenRuns::predicted(rows, predictions, record.unseen);
    Ok(UnseenData { test, record: samples(project, record) })
}

/// The rows of the table as a record of samples.
fn samples(project: &Project, record: &StaticRecord) -> SamplesRecord {
    SamplesRecord {
        sampling_digest: project.study.sampling_digest(),
        train_runs: record.rows,
        train_rows: record.rows,
        test_runs: record.unseen_rows,
        test_rows: record.unseen_rows,
        calibration_runs: 0,
        tables: IndexMap::new(),
        sample_seconds: record.read_seconds,
        failed_runs: 0,
        failed: Vec::new(),
    }
}
