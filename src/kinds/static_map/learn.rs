//! A static map of the rows of a table: the best of several kinds of model, or the one that the study names.

use super::{
    fit::{self, CandidateScore, Fit, FitOptions, UnseenRows},
    unseen_table,
};
use crate::{
    Error, Result, calibration,
    dataset::Dataset,
    evaluation::comparison::{Comparison, ModelRow, ModelStatus},
    files,
    import::interface::ModelInterface,
    kinds::{
        learning::Trained,
        record::{Candidate, MethodRecord, StaticRecord, TrainingRecord},
    },
    project::{Project, rescue},
    source::{Source, rows::ReadRows},
    study::{BoundsOptions, NETWORK, Study},
    surrogate,
    training::StopReason,
};
use metafmu_runtime::{Rows, Surrogate};
use sha2::{Digest, Sha256};
use std::time::Instant;

/// Fits a model of the inputs alone to the rows of the table, and writes unseen rows and the candidates.
///
/// # Errors
/// [`Error::Rows`], [`Error::Study`] and [`Error::Table`] of the table, [`Error::Import`] if no model can be fitted, [`Error::Interrupted`],
/// [`Error::Io`].
pub(super) fn learn(project: &Project) -> Result<Trained> {
    let study = &project.study;
    let Source::Rows(source) = &project.source else {
        return Err(study.refusal("source", "expected a table of rows"));
    };
    let began = Instant::now();
    let ReadRows { inputs, outputs, places, notes } = source.read(study, project.control().stop)?;
    notes.iter().for_each(|note| project.say(note));
    let (rows, read_seconds) = (inputs.len(), began.elapsed().as_secs_f64());
    let options = FitOptions {
        model: study.static_map.model.into(),
        std: study.static_map.std,
        network: study.network.clone(),
        training: study.training_on(rows),
        small_networks: study.small_networks(),
        seed: study.seed,
        measure: true,
    };
    if let Some(problem) = fit::std_problem(&options, rows) {
        return Err(study.refusal("static.std", problem));
    }
    expect_bounds(study, fit::unseen_rows(rows, &options.training))?;
    project.say(format_args!("fitting to {rows} rows: inputs {}, outputs {}", inputs.width(), outputs.width()));
    let began = Instant::now();
    let interface = ModelInterface::of_study(study, source.inputs(), source.outputs());
    let (surrogate, fit) = fit::fit((inputs.clone(), &outputs), &interface, &options, project.control())?;
    // a stopped fit measures nothing, and a shorter one is no use
    let unseen = fit.unseen.as_ref().filter(|_| !project.is_stopped()).ok_or(Error::Interrupted)?;
    let surrogate = surrogate::of_rows(study, &with_bounds(study, surrogate, unseen, &outputs)?)?;
    let comparison = comparison(study, &surrogate, &fit);
    let (points, labels) = (inputs.pick(&unseen.rows), outputs.pick(&unseen.rows));
    let test = Dataset::of_rows(source.inputs(), source.outputs(), &points, &labels);
    let lines: Vec<u64> = unseen.rows.iter().map(|row| places[*row]).collect();
    let table = unseen_table::csv(&lines, &test, &unseen.predictions);
    rescue::write(project, |project| {
        files::write_json(&project.comparison(), &comparison)?;
        files::write_whole(&project.comparison_table(), comparison.csv().as_bytes())?;
        files::write_whole(&project.unseen(), table.as_bytes())
    })?;
    let record = TrainingRecord {
        train_rows: fit.train_rows,
        validation_runs: fit.validation_rows,
        epochs: fit.epochs,
        best_epoch: fit.best_epoch.unwrap_or(0),
        stopped: fit.stopped.unwrap_or(StopReason::Solved),
        train_seconds: began.elapsed().as_secs_f64(),
        processor_seconds: None,
        added_runs: 0,
        target_met: None,
        method: Some(MethodRecord::StaticMap(StaticRecord {
            candidates: measured(&fit.candidates),
            exported: fit.model.into(),
            rows,
            read_seconds,
            unseen: unseen.kind,
            unseen_rows: unseen.rows.len(),
            unseen_digest: files::digits(Sha256::new_with_prefix(&table)),
        })),
    };
    project.finish(format_args!("fitted {} to {} rows in {:.1} s", fit.model, fit.train_rows, record.train_seconds));
    Ok(Trained { surrogate, history: fit.history, record })
}

/// Fails if `unseen` rows are too few for the bounds that the study wants.
fn expect_bounds(study: &Study, unseen: usize) -> Result<()> {
    let Some(BoundsOptions { coverage, .. }) = study.bounds else { return Ok(()) };
    let least = BoundsOptions::least_runs(coverage);
    if unseen >= least {
        return Ok(());
    }
    let message = format!("{unseen} unseen rows, expected at least {least} for a coverage of {coverage}");
    Err(study.refusal("bounds.coverage", message))
}

fn with_bounds(study: &Study, map: Surrogate, unseen: &UnseenRows, outputs: &Rows) -> Result<Surrogate> {
    let Some(BoundsOptions { coverage, .. }) = study.bounds else { return Ok(map) };
    let error = |(row, found): (&usize, &[f64])| -> Vec<f64> {
        outputs[*row].iter().zip(found).map(|(label, found)| (label - found).abs()).collect()
    };
    let errors: Vec<Vec<f64>> = unseen.rows.iter().zip(&unseen.predictions).map(error).collect();
    let bounds = calibration::bounds_of_rows(&errors, coverage);
    let bounds = bounds.map_err(|error| study.refusal("bounds", error.to_string()))?;
    surrogate::with_bounds(map, bounds)
}

/// The candidates that were measured, as a record has them.
fn measured(candidates: &[CandidateScore]) -> Vec<Candidate> {
    let of = |CandidateScore { model, one_minus_r2, fit_seconds, .. }: &CandidateScore| {
        Some(Candidate { name: (*model).into(), error: one_minus_r2.as_ref()?.sqrt(), seconds: (*fit_seconds)? })
    };
    candidates.iter().filter_map(of).collect()
}

/// The candidates as a table, the network first.
fn comparison(study: &Study, surrogate: &Surrogate, fit: &Fit) -> Comparison {
    let names = || surrogate.predictions().iter().map(|output| output.name.clone());
    let row = |CandidateScore { model, fit_seconds, note, outputs, .. }: &CandidateScore| {
        let is_exported = *model == fit.model;
        // of a single kind and many rows nothing else is measured than the accuracy itself
        let alone =
            fit.accuracy.iter().filter(|_| is_exported && outputs.is_empty()).flat_map(|of| of.outputs.values());
        let outputs = names().zip(outputs.iter().chain(alone).map(Into::into)).collect();
        let exported = if is_exported { "exported" } else { "" };
        let notes = [exported, note.as_str()].into_iter().filter(|note| !note.is_empty()).collect::<Vec<_>>();
        ModelRow {
            model: (*model).into(),
            status: if fit_seconds.is_some() { ModelStatus::Fine } else { ModelStatus::Failed },
            note: notes.join("; "),
            rows: if fit_seconds.is_some() { fit.train_rows } else { 0 },
            fit_seconds: *fit_seconds,
            predict_seconds_per_point: None,
            memory_bytes: None,
            exportable: true,
            outputs,
        }
    };
    let mut models: Vec<ModelRow> = fit.candidates.iter().map(row).collect();
    models.sort_by_key(|row| row.model != NETWORK);
    let rows = fit.compared_rows;
    let content_digest = Some(surrogate.metadata().provenance.content_digest.clone());
    Comparison { name: study.name.clone(), content_digest, test_runs: rows, test_rows: rows, models }
}
