//! Kinds of model of a fit, and the choice among them by their errors on unseen rows.

use super::{FEW_ROWS, FOLDS, FitContext, RowSplit};
use crate::{
    Error, Result,
    baselines::{self, BaselineKind, Baselines, Fitted, StandardizedRows, choose_rows, worker},
    dataset::Dataset,
    diagnostics::{
        names::listed,
        numbers::{counted, power},
    },
    evaluation::{self, OutputMetrics},
    processor_time::{ProcessorClock, ProcessorTimer},
    scaling::of_columns,
    study::ModelKind,
    training::Outcome,
    variable::SourceVariable,
};
use metafmu_runtime::{Graph, Rows, Scaling, graph::Step};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Name of the choice among the candidates.
const AUTO: &str = "auto";

/// Model that a fit makes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(try_from = "String")]
pub enum ModelChoice {
    /// The candidate with the smallest error on unseen rows: a polynomial, of up to 1000 rows a Gaussian process, or a network.
    #[default]
    Auto,
    /// A given kind.
    Only(ModelKind),
}

/// Candidates, the simplest first.
const CANDIDATES: [ModelKind; 3] = [
    ModelKind::Baseline(BaselineKind::Polynomial),
    ModelKind::Baseline(BaselineKind::GaussianProcess),
    ModelKind::Network,
];

/// Fewest rows of a Gaussian process.
const LEAST_PROCESS_ROWS: usize = 2;

/// Message on a number of rows that no kind of model with a predicted standard deviation is fitted to.
pub(super) fn std_rows_problem(rows: usize) -> Option<String> {
    let most = CANDIDATES.into_iter().filter(|kind| kind.has_std()).map(most_rows).max().unwrap_or_default();
    let expected = format!("expected {LEAST_PROCESS_ROWS} to {most} for a predicted standard deviation");
    (!(LEAST_PROCESS_ROWS..=most).contains(&rows)).then(|| format!("std: {}, {expected}", counted(rows, "row")))
}

/// Largest number of rows that a model of a kind can be fitted to.
fn most_rows(kind: ModelKind) -> usize {
    let of_baseline = |kind| baselines::model(&Baselines::default(), kind).most_rows();
    match kind {
        ModelKind::Network => None,
        ModelKind::Baseline(kind) => of_baseline(kind),
    }
    .unwrap_or(usize::MAX)
}

impl From<Option<ModelKind>> for ModelChoice {
    fn from(kind: Option<ModelKind>) -> Self {
        kind.map_or(Self::Auto, Self::Only)
    }
}

impl TryFrom<String> for ModelChoice {
    type Error = UnknownModel;

    fn try_from(name: String) -> std::result::Result<Self, UnknownModel> {
        if name == AUTO {
            return Ok(Self::Auto);
        }
        let kind = ModelKind::all().find(|kind| kind.name() == name);
        kind.map(Self::Only).ok_or(UnknownModel { name })
    }
}

/// Name of no kind of model.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UnknownModel {
    /// The name.
    pub name: String,
}

impl fmt::Display for UnknownModel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names: Vec<&str> = [AUTO].into_iter().chain(ModelKind::all().map(ModelKind::name)).collect();
        write!(f, "model: `{}`, expected one of {}", self.name, listed(&names))
    }
}

impl std::error::Error for UnknownModel {}

/// Row of a candidate in the choice.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CandidateScore {
    /// Its kind: `network`, or the name of a baseline.
    pub model: &'static str,
    /// Mean over outputs of `1 - R²` on rows that it was not fitted to; None if it was not measured.
    pub one_minus_r2: Option<f64>,
    /// Processor seconds of fitting, of a cross-validation the sum over its folds; None if it was not fitted.
    pub fit_seconds: Option<f64>,
    /// Remark, or the reason why it was not fitted; else empty.
    pub note: String,
    /// Accuracy of each output on the same rows; empty if it was not measured.
    #[serde(skip)]
    pub outputs: Vec<OutputMetrics>,
}

impl CandidateScore {
    fn new(kind: ModelKind, note: String) -> Self {
        Self { model: kind.name(), one_minus_r2: None, fit_seconds: None, note, outputs: Vec::new() }
    }

    /// One line for people.
    fn summary(&self) -> String {
        match (self.one_minus_r2, self.fit_seconds) {
            (Some(error), Some(seconds)) => {
                format!("{}: 1 - R² {} on unseen rows, fitted in {seconds:.2} CPU s", self.model, power(error, 1))
            }
            _ => format!("{}: {}", self.model, self.note),
        }
    }
}

/// A fitted model.
pub(super) struct FittedModel {
    pub(super) graph: Graph,
    /// Training of a network.
    pub(super) outcome: Option<Outcome>,
    /// Number of rows that it was fitted to.
    pub(super) rows: usize,
    /// Processor time of the fit.
    seconds: f64,
}

/// Model of a fit, and how it was chosen.
pub(super) struct SelectedModel {
    pub(super) kind: ModelKind,
    pub(super) model: FittedModel,
    pub(super) candidates: Vec<CandidateScore>,
    /// Prediction of each row by a model that was neither fitted to it nor chosen by it; None without cross-validation.
    pub(super) unseen: Option<Rows>,
}

/// Threads of a fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Threads {
    /// All threads of the process: nothing else is fitted meanwhile.
    All,
    /// The calling thread, beside other fits.
    One,
}

/// Candidate with its predictions of unseen rows, by row number, zero where there is none.
struct EvaluatedCandidate {
    kind: ModelKind,
    row: CandidateScore,
    predictions: Option<Rows>,
    /// The model, if no further rows are left to fit it to.
    model: Option<FittedModel>,
}

/// Predictions of the rows of a fold by a model of the others.
#[derive(Default)]
struct FoldPredictions {
    /// Their numbers.
    rows: Vec<usize>,
    predictions: Rows,
    /// Processor seconds of the fit.
    seconds: f64,
}

impl FitContext<'_> {
    /// A model of a given kind, and its cross-validated predictions if they measure the accuracy.
    pub(super) fn only(&self, kind: ModelKind, order: &[usize], parts: RowSplit) -> Result<SelectedModel> {
        let named = |error| match error {
            Error::Import { problems, .. } => self.refusal(vec![format!("{}: {}", kind.name(), problems.join("; "))]),
            error => error,
        };
        let model = self.fitted(kind, parts, Threads::All).map_err(named)?;
        let mut row = CandidateScore::new(kind, limit_note(kind, parts.usable().len()));
        row.fit_seconds = Some(model.seconds);
        let is_measured = self.options.measure && parts.judging.is_empty() && order.len() > 1 && !self.is_stopped();
        let unseen = match is_measured {
            true => {
                let folds = FOLDS.min(order.len());
                self.note(format_args!("accuracy: {folds} further fits, each without a part of the rows"));
                self.cross_validated(kind, order).map_err(named)?.map(|(predictions, _)| predictions)
            }
            false => None,
        };
        row.one_minus_r2 = unseen.as_ref().map(|found| RelativeErrors::of(self.outputs, order).mean(found, order));
        row.outputs = unseen.as_ref().map_or(Vec::new(), |found| self.compared(found, order));
        Ok(SelectedModel { kind, model, candidates: vec![row], unseen })
    }

    /// The candidate with the smallest error on unseen rows, fitted to all rows but those that judge. Few rows are unseen in turn, by
    /// cross-validation; of many those are that choose the best epoch of a network.
    pub(super) fn best(&self, order: &[usize], parts: RowSplit) -> Result<SelectedModel> {
        let is_few = order.len() < FEW_ROWS;
        let compared = if is_few { order } else { parts.choosing };
        let errors = RelativeErrors::of(self.outputs, &parts.usable());
        let mut trials = Vec::new();
        for kind in CANDIDATES.into_iter().filter(|kind| kind.has_std() || !self.options.std) {
            let mut trial = match self.trial(kind, order, parts) {
                Ok(trial) => trial,
                Err(error) => EvaluatedCandidate::failed(kind, reason(error)),
            };
            if self.is_stopped() {
                return Err(Error::Interrupted);
            }
            trial.row.one_minus_r2 = trial.predictions.as_ref().map(|found| errors.mean(found, compared));
            trial.row.outputs = trial.predictions.as_ref().map_or(Vec::new(), |found| self.compared(found, compared));
            self.note(format_args!("{}", trial.row.summary()));
            trials.push(trial);
        }
        let measured: Vec<&Rows> = trials.iter().filter_map(|trial| trial.predictions.as_ref()).collect();
        let unseen = (is_few && !measured.is_empty()).then(|| judged(self.outputs, &measured, order));
        let errors: Vec<f64> = trials.iter().map(|trial| trial.row.one_minus_r2.unwrap_or(f64::INFINITY)).collect();
        let usable = |place: &usize| trials[*place].predictions.is_some();
        let ranked: Vec<usize> = ranking(&errors, compared.len()).into_iter().filter(usable).collect();
        for place in ranked {
            let kind = trials[place].kind;
            let fitted = match trials[place].model.take() {
                Some(model) => Ok(model),
                None => self.fitted(kind, parts, Threads::All),
            };
            match fitted {
                Ok(model) => {
                    self.note(format_args!(
                        "{} is chosen: the simplest within one standard error of the smallest error",
                        kind.name()
                    ));
                    let candidates = trials.into_iter().map(|trial| trial.row).collect();
                    return Ok(SelectedModel { kind, model, candidates, unseen });
                }
                Err(Error::Interrupted) => return Err(Error::Interrupted),
                Err(error) => trials[place].row.note = format!("with all rows: {}", reason(error)),
            }
        }
        Err(self.refusal(
            trials.iter().map(|EvaluatedCandidate { row, .. }| format!("{}: {}", row.model, row.note)).collect(),
        ))
    }

    /// Accuracy of each output of predictions in some rows.
    fn compared(&self, predictions: &Rows, rows: &[usize]) -> Vec<OutputMetrics> {
        let names = (0..self.outputs.width()).map(|output| SourceVariable::new(&output.to_string(), "", ""));
        let labels = self.outputs.pick(rows);
        let test = Dataset::of_rows(&[], &names.collect::<Vec<_>>(), &Rows::zeros(0, rows.len()), &labels);
        let predictions: Vec<Vec<f64>> = rows.iter().map(|row| predictions[*row].to_vec()).collect();
        evaluation::compare(&test, &predictions, None)
    }

    fn trial(&self, kind: ModelKind, order: &[usize], parts: RowSplit) -> Result<EvaluatedCandidate> {
        let (rows, most) = (order.len(), most_rows(kind));
        if kind == ModelKind::Baseline(BaselineKind::GaussianProcess) && rows > most {
            return Ok(EvaluatedCandidate::failed(kind, format!("{rows} rows, expected at most {most}")));
        }
        let note = limit_note(kind, parts.usable().len());
        let (predictions, seconds, model) = if rows < FEW_ROWS {
            let (predictions, seconds) = self.cross_validated(kind, order)?.ok_or(Error::Interrupted)?;
            (predictions, seconds, None)
        } else {
            // rows that choose its best epoch are those that choose the kind
            let has_epochs = kind == ModelKind::Network && !self.has_small_network();
            let model =
                self.fitted(kind, if has_epochs { parts } else { RowSplit { choosing: &[], ..parts } }, Threads::All)?;
            let of_choosing = model.graph.evaluate(&self.inputs.pick(parts.choosing));
            let mut predictions = Rows::zeros(self.outputs_and_stds(), rows);
            parts.choosing.iter().zip(&of_choosing).for_each(|(row, values)| predictions[*row].copy_from_slice(values));
            (predictions, model.seconds, has_epochs.then_some(model))
        };
        if !predictions.values().iter().all(|value| value.is_finite()) {
            return Ok(EvaluatedCandidate::failed(kind, "its predictions are not finite".into()));
        }
        let row = CandidateScore { fit_seconds: Some(seconds), ..CandidateScore::new(kind, note) };
        Ok(EvaluatedCandidate { kind, row, predictions: Some(predictions), model })
    }

    /// A model of the rows of a split. The progress of a network is reported unless it is one of several that are
    /// trained side by side.
    fn fitted(&self, kind: ModelKind, parts: RowSplit, threads: Threads) -> Result<FittedModel> {
        let is_shown = threads == Threads::All;
        let timer = ProcessorTimer::start(match threads {
            Threads::All => ProcessorClock::Process,
            Threads::One => ProcessorClock::Thread,
        });
        let (graph, outcome, rows) = match kind {
            ModelKind::Network if self.has_small_network() => {
                let rows = parts.usable();
                (Graph::from(&self.small_network(&rows, is_shown)?), None, rows.len())
            }
            ModelKind::Network => {
                let (network, outcome) = self.network(parts, is_shown)?;
                (Graph::from(&network), Some(outcome.completed()?), parts.seen.len())
            }
            ModelKind::Baseline(kind) => {
                let (graph, rows) = self.baseline(kind, &parts.usable())?;
                (graph, None, rows)
            }
        };
        Ok(FittedModel { graph, outcome, rows, seconds: timer.seconds() })
    }

    /// Predictions of all rows, each by a model that neither learned it nor chose its best epoch by it, and processor
    /// seconds of fitting. None if the work was stopped. The folds are fitted side by side, each by one thread.
    fn cross_validated(&self, kind: ModelKind, order: &[usize]) -> Result<Option<(Rows, f64)>> {
        let folds = FOLDS.min(order.len());
        let of_fold = |fold: usize| -> Result<FoldPredictions> {
            if self.is_stopped() {
                return Ok(FoldPredictions::default());
            }
            let (rows, rest) = fold_rows(order, fold, folds);
            let model = self.fitted(kind, RowSplit::of(&rest, &self.options.training, false), Threads::One)?;
            let predictions = model.graph.evaluate(&self.inputs.pick(&rows));
            Ok(FoldPredictions { rows, predictions, seconds: model.seconds })
        };
        // of few rows a step is too short for several threads
        let alone = |fold| match rayon::ThreadPoolBuilder::new().num_threads(1).build() {
            Ok(pool) => pool.install(|| of_fold(fold)),
            Err(_) => of_fold(fold),
        };
        let all: Result<Vec<FoldPredictions>> = (0..folds).into_par_iter().map(alone).collect();
        if self.is_stopped() {
            return Ok(None);
        }
        let mut predictions = Rows::zeros(self.outputs_and_stds(), order.len());
        let mut seconds = 0.0;
        for fold in all? {
            fold.rows.iter().zip(&fold.predictions).for_each(|(row, values)| predictions[*row].copy_from_slice(values));
            seconds += fold.seconds;
        }
        Ok(Some((predictions, seconds)))
    }

    /// Numbers of a prediction: the outputs, then their predicted standard deviations if the fit has them.
    fn outputs_and_stds(&self) -> usize {
        self.outputs.width() * if self.options.std { 2 } else { 1 }
    }

    /// A baseline of some rows, and the number of rows that it was fitted to. An output that is constant in them stays that constant.
    fn baseline(&self, kind: BaselineKind, which: &[usize]) -> Result<(Graph, usize)> {
        let (x, y) = (self.inputs.pick(which), self.outputs.pick(which));
        let Some(constants) = y.iter().next() else {
            return Err(self.refusal(vec!["no rows".into()]));
        };
        let inputs = x.width();
        let varying: Vec<usize> =
            (0..constants.len()).filter(|output| y.iter().any(|row| row[*output] != constants[*output])).collect();
        let has_std = self.options.std;
        // constants have a standard deviation of 0
        let with_constants = |graph| match has_std {
            true => {
                let stds = varying.iter().map(|output| constants.len() + output);
                let columns: Vec<usize> = varying.iter().copied().chain(stds).collect();
                with_constants(graph, &columns, &[constants, &vec![0.0; constants.len()]].concat())
            }
            false => with_constants(graph, &varying, constants),
        };
        if varying.is_empty() {
            return Ok((with_constants(Graph { inputs, steps: Vec::new() }), which.len()));
        }
        let of_varying = y.select(&varying);
        let ((input_mean, input_scale), (output_mean, output_scale)) = (of_columns(&x), of_columns(&of_varying));
        let scaling = Scaling { input_mean, input_scale, output_mean, output_scale };
        let rows = StandardizedRows::new(x.into_values(), of_varying.into_values(), scaling);
        let (options, seed) = (Baselines::default(), self.options.seed);
        let model = baselines::model(&options, kind);
        let rows = choose_rows(&rows, model.most_rows(), seed);
        let fitted = match has_std {
            true => worker::caught(|| model.fit_with_std(&rows, seed).map(Fitted::Formula)),
            false => worker::caught(|| model.fit(&rows, seed)),
        };
        let graph = match fitted.map_err(|error| self.refusal(vec![error.message]))? {
            Fitted::Formula(graph) => graph,
            Fitted::Library(model) => return Err(self.refusal(vec![model.not_exportable.into()])),
        };
        let outputs = if has_std { 2 * varying.len() } else { varying.len() };
        graph.check(inputs, outputs).map_err(|error| self.refusal(vec![error.to_string()]))?;
        Ok((with_constants(graph), rows.len()))
    }

    fn refusal(&self, problems: Vec<String>) -> Error {
        Error::Import { path: self.path.to_owned(), problems }
    }
}

impl EvaluatedCandidate {
    fn failed(kind: ModelKind, note: String) -> Self {
        Self { kind, row: CandidateScore::new(kind, note), predictions: None, model: None }
    }
}

/// Reason of a failure, without the name of the surrogate.
fn reason(error: Error) -> String {
    match error {
        Error::Import { problems, .. } => problems.join("; "),
        error => error.to_string(),
    }
}

fn limit_note(kind: ModelKind, rows: usize) -> String {
    let most = most_rows(kind);
    if rows > most { format!("fitted to {most} of {rows} rows") } else { String::new() }
}

/// Rows of a fold of a cross-validation, and those of the others.
fn fold_rows(order: &[usize], fold: usize, folds: usize) -> (Vec<usize>, Vec<usize>) {
    let (of_fold, others): (Vec<_>, Vec<_>) = order.iter().enumerate().partition(|(place, _)| place % folds == fold);
    let rows = |of: Vec<(usize, &usize)>| of.into_iter().map(|(_, row)| *row).collect();
    (rows(of_fold), rows(others))
}

/// Ranking of models by their mean square errors on a number of rows. The first is the simplest model whose error is
/// within one standard error of the smallest (Hastie, Tibshirani, Friedman (2009), section 7.10). A mean of `n` squares
/// of normal errors has the relative standard error `sqrt(2 / n)`.
fn ranking(errors: &[f64], rows: usize) -> Vec<usize> {
    let mut places: Vec<usize> = (0..errors.len()).collect();
    places.sort_by(|a, b| errors[*a].total_cmp(&errors[*b]));
    let least = errors.iter().copied().fold(f64::INFINITY, f64::min);
    let limit = least * (1.0 + (2.0 / rows.max(1) as f64).sqrt());
    if let Some(first) = errors.iter().position(|error| *error <= limit) {
        places.retain(|place| *place != first);
        places.insert(0, first);
    }
    places
}

/// Predictions of all rows, those of each fold by the candidate that the other folds choose.
pub(super) fn judged(outputs: &Rows, candidates: &[&Rows], order: &[usize]) -> Rows {
    let folds = FOLDS.min(order.len());
    let mut predictions = Rows::zeros(candidates.first().map_or(0, |candidate| candidate.width()), order.len());
    for fold in 0..folds {
        let (judging, others) = fold_rows(order, fold, folds);
        let errors = RelativeErrors::of(outputs, &others);
        let errors: Vec<f64> = candidates.iter().map(|candidate| errors.mean(candidate, &others)).collect();
        let best = ranking(&errors, others.len()).first().map(|best| candidates[*best]);
        for (row, best) in judging.into_iter().zip(best.into_iter().cycle()) {
            predictions[row].copy_from_slice(&best[row]);
        }
    }
    predictions
}

/// The graph with constants for the outputs that are not among the `varying` ones.
fn with_constants(mut graph: Graph, varying: &[usize], constants: &[f64]) -> Graph {
    if varying.len() == constants.len() {
        return graph;
    }
    let of = graph.steps.len();
    let width = if varying.is_empty() { graph.inputs } else { varying.len() };
    let (mut weight, mut bias) = (vec![0.0; constants.len() * width], constants.to_vec());
    for (column, output) in varying.iter().enumerate() {
        weight[output * width + column] = 1.0;
        bias[*output] = 0.0;
    }
    graph.steps.push(Step::Affine { of, weight: weight.into(), bias: bias.into() });
    graph
}

/// Errors of predictions relative to the variance of each output.
struct RelativeErrors<'a> {
    outputs: &'a Rows,
    /// Outputs that vary, and their variances.
    variances: Vec<(usize, f64)>,
}

impl<'a> RelativeErrors<'a> {
    /// Errors relative to the variances in some rows.
    fn of(outputs: &'a Rows, rows: &[usize]) -> Self {
        let values = outputs.pick(rows);
        let varies = |output: &usize| values.iter().any(|row| row[*output] != values[0][*output]);
        let (_, deviations) = of_columns(&values);
        let variances = deviations.iter().map(|deviation| deviation * deviation).enumerate();
        Self { outputs, variances: variances.filter(|(output, _)| varies(output)).collect() }
    }

    /// Mean over the outputs that vary of `1 - R²` in some rows.
    fn mean(&self, predictions: &Rows, rows: &[usize]) -> f64 {
        let of_output = |(output, variance): &(usize, f64)| {
            let squares = rows.iter().map(|row| (predictions[*row][*output] - self.outputs[*row][*output]).powi(2));
            squares.sum::<f64>() / (rows.len() as f64 * variance)
        };
        self.variances.iter().map(of_output).sum::<f64>() / self.variances.len().max(1) as f64
    }
}
