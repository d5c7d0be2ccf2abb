//! A network of rows of inputs and outputs, without a study.

use super::observer::{Control, Event, Work};
use crate::{
    Error, Result,
    evaluation::{Accuracy, TestRows},
    import::{self, About},
    interface::Interface,
    network::Network,
    sampling::{self, Stream},
    scaling::{of_columns, standardise_rows},
    study::{NetworkOptions, TrainingOptions},
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
/// [`Error::Training`], those of the interface, [`Error::Import`] for rows without values.
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
