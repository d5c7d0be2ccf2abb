//! A network of rows of inputs and outputs, without a study.

use super::observer::{Control, CountedWork, Event};
use crate::{
    Error, Result,
    diagnostics::Problems,
    evaluation::{Accuracy, TestRows},
    import::{self, About},
    interface::ModelInterface,
    network::Network,
    sampling::{self, Stream},
    scaling::{of_columns, standardise_rows},
    study::{NetworkOptions, TimeStructure, TrainingOptions},
    training::{self, EpochRecord, Observer, Outcome, Progress, StopReason, TrainingRows},
};
use metafmu_runtime::{Graph, ScaledNetwork, Scaling, Surrogate};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::{ops::ControlFlow, path::Path, sync::atomic::Ordering};

/// What is trained, and how.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FitOptions {
    /// The network.
    pub network: NetworkOptions,
    /// Its training; `validation` is a share of the rows.
    pub training: TrainingOptions,
    /// Decides which rows are held out, how the network begins, and the order of the rows.
    pub seed: u64,
    /// Whether the accuracy on unseen rows is measured: on half of the rows that are held out, or, of few rows, by cross-validation.
    pub measure: bool,
}

/// With fewer rows the accuracy is that of a cross-validation: a share of them is too few to judge by.
const FEW_ROWS: usize = 1000;
/// Parts of a cross-validation.
const FOLDS: usize = 5;
/// Fewest rows that judge.
const JUDGES: usize = 50;

/// How the training went.
#[derive(Clone, Debug, Serialize)]
pub struct Fit {
    /// Rows that the network was trained on.
    pub train_rows: usize,
    /// Rows that were held out of the training to choose the best epoch.
    pub validation_rows: usize,
    /// Epochs that were done.
    pub epochs: usize,
    /// The epoch that is kept, the best on the rows that choose it.
    pub best_epoch: usize,
    /// Why it ended.
    pub stopped: StopReason,
    /// Loss of each epoch on the rows that it was trained on: the mean over rows and outputs, of outputs with a standard deviation of 1.
    pub train_loss: Vec<f64>,
    /// The same on the rows that choose the best epoch.
    pub validation_loss: Vec<f64>,
    /// Accuracy on rows that took part neither in the training nor in the choice of its best epoch; None unless it is measured, of a single row, and if the
    /// training was stopped.
    pub accuracy: Option<Accuracy>,
}

/// Trains a network on rows of inputs and outputs; a single row is both trained on and chooses the best epoch. A training that is stopped
/// keeps its best epoch.
///
/// # Errors
/// [`Error::Interrupted`] if none is complete, [`Error::Training`], those of the interface, [`Error::Import`] for rows without values and
/// for options beyond their limits.
pub fn fit(
    (inputs, outputs): (Vec<Vec<f64>>, &[Vec<f64>]),
    interface: &ModelInterface,
    options: &FitOptions,
    control: Control,
) -> Result<(Surrogate, Fit)> {
    let path = Path::new(&interface.name);
    let columns = [inputs.first().map_or(0, Vec::len), outputs.first().map_or(0, Vec::len)];
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
    let problems = problems(options, columns);
    if !problems.is_empty() {
        return Err(Error::Import { path: path.to_owned(), problems });
    }
    // what is wrong with ranges, before anything is trained
    import::inputs(interface, Some(&inputs))?;
    let training = Training { inputs: &inputs, outputs, options, control };
    let order = sampling::permutation(inputs.len(), sampling::random(options.seed, Stream::Validation));
    let parts = RowSplit::of(&order, &options.training, options.measure);
    let (network, outcome) = training.of(parts, None)?;
    let outcome = outcome.completed()?;
    let graph = Graph::from(&network);
    let is_measured = options.measure && !control.stop.load(Ordering::Relaxed);
    let predictions = match is_measured && parts.judging.is_empty() && inputs.len() > 1 {
        true => training.cross_validated(&order)?,
        false => None,
    };
    let content: Vec<u8> = inputs.iter().chain(outputs).flatten().flat_map(|value| value.to_le_bytes()).collect();
    let about = About { path, content: &content, is_single: false, producer: "" };
    let (points, labels) = (chosen(&inputs, parts.judging), chosen(outputs, parts.judging));
    let surrogate = import::of_graph(graph, about, interface, Some(inputs))?;
    let accuracy = match predictions {
        Some(found) => Some(Accuracy::of_row_predictions(&surrogate, TestRows::CrossValidated, &found, outputs)),
        None if !is_measured || points.is_empty() => None,
        None => Some(Accuracy::of_rows(&surrogate, TestRows::HeldOut, &points, &labels)),
    };
    let losses = |of: fn(&EpochRecord) -> f64| outcome.history.iter().map(of).collect();
    let fit = Fit {
        train_rows: parts.seen.len(),
        validation_rows: parts.choosing.len(),
        epochs: outcome.history.len(),
        best_epoch: outcome.best_epoch,
        stopped: outcome.reason,
        train_loss: losses(|epoch| epoch.train_loss),
        validation_loss: losses(|epoch| epoch.validation_loss),
        accuracy,
    };
    Ok((surrogate, fit))
}

/// Split of the rows by their use.
#[derive(Clone, Copy)]
struct RowSplit<'a> {
    /// They measure the accuracy.
    judging: &'a [usize],
    /// They choose the best epoch.
    choosing: &'a [usize],
    /// They are trained on.
    seen: &'a [usize],
}

impl<'a> RowSplit<'a> {
    /// Of rows in a random order; of a few none judges.
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
}

fn chosen(rows: &[Vec<f64>], which: &[usize]) -> Vec<Vec<f64>> {
    which.iter().map(|row| rows[*row].clone()).collect()
}

/// What networks are trained on, and how.
struct Training<'a> {
    inputs: &'a [Vec<f64>],
    outputs: &'a [Vec<f64>],
    options: &'a FitOptions,
    control: Control<'a>,
}

impl Training<'_> {
    /// The network of some of the rows; `fold`: its number in a cross-validation.
    fn of(&self, RowSplit { seen, choosing, .. }: RowSplit, fold: Option<usize>) -> Result<(ScaledNetwork, Outcome)> {
        let Self { inputs, outputs, options, control } = self;
        let columns = [inputs, outputs].map(|rows| rows.first().map_or(0, Vec::len));
        let (x, y) = (chosen(inputs, seen), chosen(outputs, seen));
        let ((input_mean, input_scale), (output_mean, output_scale)) = (of_columns(&x), of_columns(&y));
        let scaling = Scaling { input_mean, input_scale, output_mean, output_scale };
        let rows = |x: &[Vec<f64>], y: &[Vec<f64>]| {
            let x = standardise_rows(x, &scaling.input_mean, &scaling.input_scale);
            let y = standardise_rows(y, &scaling.output_mean, &scaling.output_scale);
            TrainingRows::new(columns[0], columns[1], x, y)
        };
        let training_rows = rows(&x, &y)?;
        let validation_rows = rows(&chosen(inputs, choosing), &chosen(outputs, choosing))?;
        let network = Network::new(columns[0], columns[1], &options.network, options.seed)?;
        let epochs = options.training.epochs;
        let mut follower = FitFollower { control: *control, epochs, is_shown: fold.is_none() };
        let steps = training_rows.len().div_ceil(options.training.batch.max(1)) * epochs;
        follower.show(Event::Begin { work: CountedWork::Steps, total: steps });
        let trained =
            training::train(network, &training_rows, &validation_rows, &options.training, options.seed, &mut follower);
        follower.show(Event::End);
        let outcome = trained?;
        let network = super::per_instant::without_constants(&outcome.network, &training_rows);
        Ok((ScaledNetwork { scaling, layers: network.to_layers() }, outcome))
    }

    /// Predictions of all rows, each by a network that neither learned it nor was chosen by it; None if the training was stopped. The folds are
    /// trained side by side, each by one thread.
    fn cross_validated(&self, order: &[usize]) -> Result<Option<Vec<Vec<f64>>>> {
        let folds = FOLDS.min(order.len());
        self.control
            .observer
            .event(Event::Note(format_args!("accuracy: {folds} networks, each without a part of the rows")));
        let of_fold = |fold: usize| {
            let (judging, rest): (Vec<_>, Vec<_>) =
                order.iter().enumerate().partition(|(place, _)| place % folds == fold);
            let [judging, rest] = [judging, rest].map(|rows| rows.into_iter().map(|(_, row)| *row).collect::<Vec<_>>());
            let (network, _) = self.of(RowSplit::of(&rest, &self.options.training, false), Some(fold))?;
            Ok(judging.iter().copied().zip(Graph::from(&network).evaluate(&chosen(self.inputs, &judging))).collect())
        };
        // of few rows a step is too short for several threads
        let alone = |fold| match rayon::ThreadPoolBuilder::new().num_threads(1).build() {
            Ok(pool) => pool.install(|| of_fold(fold)),
            Err(_) => of_fold(fold),
        };
        let found: Vec<Vec<(usize, Vec<f64>)>> = (0..folds).into_par_iter().map(alone).collect::<Result<_>>()?;
        let mut predictions = vec![Vec::new(); order.len()];
        found.into_iter().flatten().for_each(|(row, values)| predictions[row] = values);
        Ok((!self.control.stop.load(Ordering::Relaxed)).then_some(predictions))
    }
}

/// What a study would say of its `[network]` and `[training]`, of networks between so many columns.
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

/// Reports the progress, and ends the training if it must stop.
struct FitFollower<'a> {
    control: Control<'a>,
    epochs: usize,
    is_shown: bool,
}

impl FitFollower<'_> {
    fn show(&self, event: Event<'_>) {
        if self.is_shown {
            self.control.observer.event(event);
        }
    }
}

impl Observer for FitFollower<'_> {
    fn step(&mut self, progress: &Progress) -> ControlFlow<()> {
        let Progress { epoch, epochs, step, steps, loss } = *progress;
        let about = format_args!("epoch {epoch}/{epochs}, loss {loss:.2e}");
        self.show(Event::Progress { done: (epoch - 1) * steps + step, about });
        match self.control.stop.load(Ordering::Relaxed) {
            true => ControlFlow::Break(()),
            false => ControlFlow::Continue(()),
        }
    }

    fn epoch(&mut self, record: &EpochRecord) {
        let EpochRecord { epoch, train_loss, validation_loss, .. } = *record;
        if epoch % self.epochs.div_ceil(10) == 0 || epoch == self.epochs {
            let epochs = self.epochs;
            let line =
                format_args!("epoch {epoch}/{epochs}: loss {train_loss:.2e}, on held-out rows {validation_loss:.2e}");
            self.show(Event::Note(line));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_row_both_learns_chooses_and_judges() {
        for (rows, measure, judges, choosers) in [
            (1, true, 0, 1),
            (30, true, 0, 3),
            (30, false, 0, 3),
            (1000, true, 50, 50),
            (5000, true, 250, 250),
            (5000, false, 0, 500),
        ] {
            let order: Vec<usize> = (0..rows).collect();
            let RowSplit { judging, choosing, seen } = RowSplit::of(&order, &TrainingOptions::default(), measure);
            assert_eq!((judging.len(), choosing.len()), (judges, choosers), "{rows}");
            let all: Vec<usize> = [judging, choosing, seen].concat();
            assert!(rows == 1 || all == order, "{rows}");
        }
    }

    #[test]
    fn options_beyond_their_limits_are_refused_by_name_before_anything_is_allocated() {
        type OptionsChange = fn(&mut FitOptions);
        let found = |change: OptionsChange| {
            let mut options = FitOptions::default();
            change(&mut options);
            problems(&options, [3, 2]).join("; ")
        };
        assert_eq!(found(|_| ()), "");
        let cases: [(OptionsChange, &str); 7] = [
            (|of| of.training.learning_rate = f64::NAN, "training.learning_rate: NaN, expected a positive number"),
            (|of| of.training.l2 = -1.0, "training.l2: -1, expected 0 or a positive number"),
            (|of| of.training.batch = 0, "training.batch: 0, expected at least 1 row"),
            (|of| of.training.output_weights = vec![1.0], "training.output_weights: 1 weights, expected one for each"),
            (
                |of| of.network.hidden = vec![1_000_000; 2],
                "network.hidden: hidden layer 1 has 1000000 nodes, expected 1 to 16384; network.hidden: hidden layer 2",
            ),
            (
                |of| of.network.hidden = vec![16_384; 2],
                "network.hidden: 2.686e8 weights and biases, expected at most 100 million",
            ),
            (|of| of.network.structure = TimeStructure::Fixed, "network.structure: belongs to studies"),
        ];
        for (change, expected) in cases {
            let found = found(change);
            assert!(found.starts_with(expected), "{found}, expected {expected}");
        }
    }
}
