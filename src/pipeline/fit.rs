//! A network of rows of inputs and outputs, without a study.

use super::observer::{Control, Event, Work};
use crate::{
    Error, Result,
    diagnostics::Problems,
    evaluation::{Accuracy, TestRows},
    import::{self, About},
    interface::Interface,
    network::Network,
    sampling::{self, Stream},
    scaling::{of_columns, standardise_rows},
    study::{NetworkOptions, Structure, TrainingOptions},
    training::{self, EpochRecord, Observer, Progress, Rows, StopReason},
};
use metafmu_runtime::{Map, ScaledNetwork, Scaling, Surrogate};
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
}

/// How the training went.
#[derive(Clone, Debug, Serialize)]
pub struct Fit {
    /// Rows that the network was trained on.
    pub train_rows: usize,
    /// Rows that were held out of the training.
    pub validation_rows: usize,
    /// Epochs that were done.
    pub epochs: usize,
    /// The epoch that is kept, the best on the held-out rows.
    pub best_epoch: usize,
    /// Why it ended.
    pub stopped: StopReason,
    /// Loss of each epoch on the rows that it was trained on: the mean over rows and outputs, of outputs with a standard deviation of 1.
    pub train_loss: Vec<f64>,
    /// The same on the held-out rows.
    pub validation_loss: Vec<f64>,
    /// Accuracy on the held-out rows.
    pub accuracy: Accuracy,
}

/// Trains a network on rows of inputs and outputs; of a single row it is both trained and measured on it. A training that is stopped
/// keeps its best epoch.
///
/// # Errors
/// [`Error::Training`], those of the interface, [`Error::Import`] for rows without values and for options beyond their limits.
pub fn fit(
    (inputs, outputs): (Vec<Vec<f64>>, &[Vec<f64>]),
    interface: &Interface,
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
    let (seen, held_out) = split(inputs.len(), options);
    let chosen = |rows: &[Vec<f64>], which: &[usize]| which.iter().map(|row| rows[*row].clone()).collect::<Vec<_>>();
    let (x, y) = (chosen(&inputs, &seen), chosen(outputs, &seen));
    let ((input_mean, input_scale), (output_mean, output_scale)) = (of_columns(&x), of_columns(&y));
    let scaling = Scaling { input_mean, input_scale, output_mean, output_scale };
    let rows = |x: &[Vec<f64>], y: &[Vec<f64>]| {
        let x = standardise_rows(x, &scaling.input_mean, &scaling.input_scale);
        let y = standardise_rows(y, &scaling.output_mean, &scaling.output_scale);
        Rows::new(columns[0], columns[1], x, y)
    };
    let training_rows = rows(&x, &y)?;
    let (unseen_x, unseen_y) = (chosen(&inputs, &held_out), chosen(outputs, &held_out));
    let validation_rows = rows(&unseen_x, &unseen_y)?;
    let network = Network::new(columns[0], columns[1], &options.network, options.seed)?;
    let mut follower = Follower { control, epochs: options.training.epochs };
    let steps = training_rows.len().div_ceil(options.training.batch.max(1)) * options.training.epochs;
    control.observer.event(Event::Begin { work: Work::Steps, total: steps });
    let trained =
        training::train(network, &training_rows, &validation_rows, &options.training, options.seed, &mut follower);
    control.observer.event(Event::End);
    let outcome = trained?;
    let network = super::per_instant::without_constants(&outcome.network, &training_rows);
    let map = Map::Network(ScaledNetwork { scaling, layers: network.to_layers() });
    let content: Vec<u8> = inputs.iter().chain(outputs).flatten().flat_map(|value| value.to_le_bytes()).collect();
    let about = About { path, content: &content, is_single: false, producer: "" };
    let surrogate = import::of_map(map, about, interface, Some(inputs))?;
    let losses = |of: fn(&EpochRecord) -> f64| outcome.history.iter().map(of).collect();
    let fit = Fit {
        train_rows: training_rows.len(),
        validation_rows: validation_rows.len(),
        epochs: outcome.history.len(),
        best_epoch: outcome.best_epoch,
        stopped: outcome.reason,
        train_loss: losses(|epoch| epoch.train_loss),
        validation_loss: losses(|epoch| epoch.validation_loss),
        accuracy: Accuracy::of_rows(&surrogate, TestRows::HeldOut, &unseen_x, &unseen_y),
    };
    Ok((surrogate, fit))
}

/// What a study would say of its `[network]` and `[training]`, of networks between so many columns.
fn problems(FitOptions { network, training, .. }: &FitOptions, columns: [usize; 2]) -> Vec<String> {
    let mut problems = Problems::default();
    if network.structure != Structure::Full {
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

/// The rows that are trained on, and those that are held out.
fn split(rows: usize, options: &FitOptions) -> (Vec<usize>, Vec<usize>) {
    if rows < 2 {
        return ((0..rows).collect(), (0..rows).collect());
    }
    let order = sampling::permutation(rows, sampling::random(options.seed, Stream::Validation));
    let (held_out, seen) = order.split_at(options.training.held_out(rows));
    (seen.to_vec(), held_out.to_vec())
}

/// Reports the progress, and ends the training if it must stop.
struct Follower<'a> {
    control: Control<'a>,
    epochs: usize,
}

impl Observer for Follower<'_> {
    fn step(&mut self, progress: &Progress) -> ControlFlow<()> {
        let Progress { epoch, epochs, step, steps, loss } = *progress;
        let about = format_args!("epoch {epoch}/{epochs}, loss {loss:.2e}");
        self.control.observer.event(Event::Progress { done: (epoch - 1) * steps + step, about });
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
            self.control.observer.event(Event::Note(line));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_beyond_their_limits_are_refused_by_name_before_anything_is_allocated() {
        type Change = fn(&mut FitOptions);
        let found = |change: Change| {
            let mut options = FitOptions::default();
            change(&mut options);
            problems(&options, [3, 2]).join("; ")
        };
        assert_eq!(found(|_| ()), "");
        let cases: [(Change, &str); 7] = [
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
            (|of| of.network.structure = Structure::Fixed, "network.structure: belongs to studies"),
        ];
        for (change, expected) in cases {
            let found = found(change);
            assert!(found.starts_with(expected), "{found}, expected {expected}");
        }
    }
}
