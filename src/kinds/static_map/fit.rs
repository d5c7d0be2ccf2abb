//! A model of rows of inputs and outputs, without a study: a network or a baseline.

mod candidates;
mod network;

pub use crate::study::ModelKind;
use crate::{
    Error, Result,
    diagnostics::Problems,
    evaluation::{self, Accuracy, TestRows},
    import::{self, About, interface::ModelInterface},
    project::{Control, Event},
    sampling::{self, Stream},
    study::{NetworkOptions, SmallNetworks, TimeStructure, TrainingOptions},
    training::{EpochRecord, StopReason},
};
use candidates::SelectedModel;
pub use candidates::{CandidateScore, ModelChoice, UnknownModel};
use metafmu_runtime::{Rows, Surrogate};
use serde::{Deserialize, Serialize};
use std::{path::Path, sync::atomic::Ordering};

/// Model to fit, and how.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FitOptions {
    /// Kind of model; by default the best of several.
    pub model: ModelChoice,
    /// `true` if predicted standard deviations `NAME_std` follow the outputs. Only kinds of model with predicted standard deviations are then candidates.
    pub std: bool,
    /// The network.
    pub network: NetworkOptions,
    /// Its training; `validation` is a share of the rows.
    pub training: TrainingOptions,
    /// Networks of few rows that are trained by Levenberg-Marquardt steps instead: without held-out rows and without
    /// epochs.
    pub small_networks: SmallNetworks,
    /// Seed of the choice of held-out rows, the initial network, the order of the rows, and the random parts of a
    /// baseline.
    pub seed: u64,
    /// `true` if the accuracy on unseen rows is measured: on half of the held-out rows, or by cross-validation if there
    /// are few rows.
    pub measure: bool,
}

/// Fewest rows without cross-validation: a share of fewer rows is too few to measure the accuracy.
const FEW_ROWS: usize = 1000;
/// Parts of a cross-validation.
const FOLDS: usize = 5;
/// Fewest rows that judge.
const JUDGES: usize = 50;

/// Result of a fit beside the surrogate.
#[derive(Clone, Debug, Serialize)]
pub struct Fit {
    /// Kind of the model: `network`, or the name of a baseline.
    pub model: &'static str,
    /// Kinds that were compared, or the one that was requested.
    pub candidates: Vec<CandidateScore>,
    /// Rows that the model was fitted to.
    pub train_rows: usize,
    /// Rows that were held out of the training of a network to choose the best epoch; 0 of another model.
    pub validation_rows: usize,
    /// Completed epochs of a network. 0 for other models, and for a network trained by Levenberg-Marquardt steps, to
    /// which the fields below apply as well.
    pub epochs: usize,
    /// The epoch that is kept, the best on the rows that choose it; None of another model than a network.
    pub best_epoch: Option<usize>,
    /// Reason why the training of a network ended; None for other models.
    pub stopped: Option<StopReason>,
    /// Loss of each epoch on the rows that a network was trained on: the mean over rows and outputs, of outputs with a standard deviation of 1.
    pub train_loss: Vec<f64>,
    /// Loss of each epoch on the rows that choose the best epoch.
    pub validation_loss: Vec<f64>,
    /// Accuracy on rows that took part neither in the fit nor in the choice of the kind of model and of the best epoch.
    /// None if it is not measured, with a single row, and if the training was stopped. In a cross-validation each fold
    /// is predicted by the candidate that the other folds choose.
    pub accuracy: Option<Accuracy>,
    /// The rows that the accuracy was measured on; None without it.
    #[serde(skip)]
    pub unseen: Option<UnseenRows>,
    /// Number of rows that the candidates were compared on.
    #[serde(skip)]
    pub compared_rows: usize,
    /// Training of a network, epoch by epoch.
    #[serde(skip)]
    pub history: Vec<EpochRecord>,
}

/// Rows that took part neither in a fit nor in its choices, and their predictions.
#[derive(Clone, Debug)]
pub struct UnseenRows {
    /// Method of their choice.
    pub kind: TestRows,
    /// Their numbers, counted from 0.
    pub rows: Vec<usize>,
    /// The outputs of each that were predicted without it, and their predicted standard deviations if the fit has them.
    pub predictions: Rows,
}

/// Fits a model to rows of inputs and outputs. [`ModelChoice::Auto`] compares a polynomial, a Gaussian process and a
/// network on unseen rows. With [`FitOptions::std`] it compares only those with predicted standard deviations. Fewer
/// than 1000 rows are compared by five-fold cross-validation, more on the rows that choose the best epoch. Networks of
/// few rows are small and trained by Levenberg-Marquardt steps, if [`FitOptions::small_networks`] requests it. A single
/// row makes a network, which it both trains and chooses. A stopped training keeps its best epoch.
///
/// # Errors
/// [`Error::Interrupted`] if no epoch is complete, and during a comparison; [`Error::Training`], those of the
/// interface. [`Error::Import`] for rows without values, for options beyond their limits, and if no model can be
/// fitted.
pub fn fit(
    (inputs, outputs): (Rows, &Rows),
    interface: &ModelInterface,
    options: &FitOptions,
    control: Control,
) -> Result<(Surrogate, Fit)> {
    let path = Path::new(&interface.name);
    let columns = [inputs.width(), outputs.width()];
    let known = [interface.variables().count(), interface.outputs.len()];
    if columns != known || inputs.len() != outputs.len() {
        let problem = format!(
            "{} rows of {} inputs and {} rows of {} outputs, expected as many rows of both, with {} inputs and {} outputs",
            inputs.len(),
            columns[0],
            outputs.len(),
            columns[1],
            known[0],
            known[1]
        );
        return Err(Error::Import { path: path.to_owned(), problems: vec![problem] });
    }
    let mut problems = problems(options, columns);
    problems.extend(std_problem(options, inputs.len()));
    if !problems.is_empty() {
        return Err(Error::Import { path: path.to_owned(), problems });
    }
    let with_std = if options.std { Some(interface.with_std()?) } else { None };
    let interface = with_std.as_ref().unwrap_or(interface);
    // refuses wrong ranges before anything is trained
    import::inputs(interface, Some(&inputs))?;
    let task = FitContext { path, inputs: &inputs, outputs, options, control };
    let order = sampling::permutation(inputs.len(), sampling::random(options.seed, Stream::Validation));
    let parts = RowSplit::of(&order, &options.training, options.measure);
    let SelectedModel { kind, model, candidates, unseen } = match options.model {
        ModelChoice::Only(kind) => task.only(kind, &order, parts)?,
        // nothing is left to compare by
        ModelChoice::Auto if inputs.len() < 2 && !options.std => task.only(ModelKind::Network, &order, parts)?,
        ModelChoice::Auto => task.best(&order, parts)?,
    };
    let is_measured = options.measure && !task.is_stopped();
    let content: Vec<u8> =
        inputs.values().iter().chain(outputs.values()).flat_map(|value| value.to_le_bytes()).collect();
    let about = About { path, content: &content, is_single: false, producer: "" };
    let points = inputs.pick(parts.judging);
    let surrogate = import::of_graph(model.graph, about, interface, Some(inputs))?;
    let unseen = match unseen {
        _ if !is_measured => None,
        Some(predictions) => {
            Some(UnseenRows { kind: TestRows::CrossValidated, rows: (0..outputs.len()).collect(), predictions })
        }
        None if points.is_empty() => None,
        None => {
            let predictions = evaluation::predict_rows(&surrogate, &points);
            Some(UnseenRows { kind: TestRows::HeldOut, rows: parts.judging.to_vec(), predictions })
        }
    };
    let compared_rows = match &unseen {
        Some(UnseenRows { kind: TestRows::HeldOut, .. }) if candidates.len() > 1 => parts.choosing.len(),
        unseen => unseen.as_ref().map_or(0, |unseen| unseen.rows.len()),
    };
    let accuracy = unseen.as_ref().map(|UnseenRows { kind, rows, predictions }| {
        Accuracy::of_row_predictions(&surrogate, *kind, predictions, &outputs.pick(rows))
    });
    let history = model.outcome.as_ref().map_or(&[][..], |outcome| &outcome.history);
    let losses = |of: fn(&EpochRecord) -> f64| history.iter().map(of).collect();
    let fit = Fit {
        model: kind.name(),
        candidates,
        train_rows: model.rows,
        validation_rows: model.outcome.as_ref().map_or(0, |_| parts.choosing.len()),
        epochs: history.len(),
        best_epoch: model.outcome.as_ref().map(|outcome| outcome.best_epoch),
        stopped: model.outcome.as_ref().map(|outcome| outcome.reason),
        train_loss: losses(|epoch| epoch.train_loss),
        validation_loss: losses(|epoch| epoch.validation_loss),
        accuracy,
        unseen,
        compared_rows,
        history: history.to_vec(),
    };
    Ok((surrogate, fit))
}

/// Number of rows that measure the accuracy of a fit to `rows` rows.
pub fn unseen_rows(rows: usize, training: &TrainingOptions) -> usize {
    let order: Vec<usize> = (0..rows).collect();
    match RowSplit::of(&order, training, true).judging.len() {
        0 => rows,
        judges => judges,
    }
}

/// Split of the rows by their use.
#[derive(Clone, Copy)]
struct RowSplit<'a> {
    /// Rows that measure the accuracy.
    judging: &'a [usize],
    /// Rows that choose the best epoch, and with many rows the kind of model.
    choosing: &'a [usize],
    /// Rows of the training.
    seen: &'a [usize],
}

impl<'a> RowSplit<'a> {
    /// Splits rows that have a random order; if there are few, none judges.
    fn of(order: &'a [usize], training: &TrainingOptions, measure: bool) -> Self {
        if order.len() < 2 {
            return Self { judging: &[], choosing: order, seen: order };
        }
        let held_out = training.held_out(order.len());
        let (judges, choosers) = match measure && order.len() >= FEW_ROWS {
            true => ((held_out / 2).max(JUDGES), held_out.div_ceil(2)),
            false => (0, held_out),
        };
        let (judging, rest) = order.split_at(judges);
        let (choosing, seen) = rest.split_at(choosers);
        Self { judging, choosing, seen }
    }

    /// All rows that do not judge, to which a model without epochs is fitted.
    fn usable(&self) -> Vec<usize> {
        if self.choosing == self.seen { self.seen.to_vec() } else { [self.choosing, self.seen].concat() }
    }
}

/// Rows, and the models fitted to them.
struct FitContext<'a> {
    path: &'a Path,
    inputs: &'a Rows,
    outputs: &'a Rows,
    options: &'a FitOptions,
    control: Control<'a>,
}

impl FitContext<'_> {
    fn is_stopped(&self) -> bool {
        self.control.stop.load(Ordering::Relaxed)
    }

    fn note(&self, line: std::fmt::Arguments<'_>) {
        self.control.observer.event(Event::Note(line));
    }
}

/// Reason why a fit to this number of rows has no predicted standard deviations; None if it has them, or if they are not requested.
pub fn std_problem(FitOptions { std, model, .. }: &FitOptions, rows: usize) -> Option<String> {
    let of_model = || match model {
        ModelChoice::Only(kind) => kind.std_problem().map(|problem| format!("std: {problem}")),
        ModelChoice::Auto => None,
    };
    std.then(|| of_model().or_else(|| candidates::std_rows_problem(rows))).flatten()
}

/// Problems of `[network]` and `[training]`, as in a study, for networks with these numbers of columns.
fn problems(FitOptions { network, training, .. }: &FitOptions, columns: [usize; 2]) -> Vec<String> {
    let mut problems = Problems::default();
    if network.structure != TimeStructure::Full {
        problems.add("network.structure", "belongs to studies, whose runs have a time: expected \"full\"");
    }
    problems.add_section("network", network.problems());
    problems.add_section("training", training.problems());
    // a size beyond its limits is enough said
    if problems.is_empty() {
        problems.extend(network.problems_between(columns, 1.0, training));
        problems.add_section("training", training.problems_beside(columns[1]));
    }
    problems.into_iter().map(|problem| format!("{}: {}", problem.key, problem.message)).collect()
}

#[cfg(test)]
mod tests;
