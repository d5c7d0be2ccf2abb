//! Training of the network of a fit.

use super::{RowSplit, Task, chosen};
use crate::{
    Result,
    network::Network,
    pipeline::observer::{Control, CountedWork, Event},
    scaling::{of_columns, standardise_rows},
    training::{self, EpochRecord, Observer, Outcome, Progress, TrainingRows, without_constants},
};
use metafmu_runtime::{ScaledNetwork, Scaling};
use std::{ops::ControlFlow, sync::atomic::Ordering};

impl Task<'_> {
    /// The network of some of the rows; `is_shown`: whether its progress is reported.
    pub(super) fn network(
        &self,
        RowSplit { seen, choosing, .. }: RowSplit,
        is_shown: bool,
    ) -> Result<(ScaledNetwork, Outcome)> {
        let Self { inputs, outputs, options, control, .. } = self;
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
        let mut follower = FitFollower { control: *control, epochs, is_shown };
        let steps = training_rows.len().div_ceil(options.training.batch.max(1)) * epochs;
        follower.show(Event::Begin { work: CountedWork::Steps, total: steps });
        let trained =
            training::train(network, &training_rows, &validation_rows, &options.training, options.seed, &mut follower);
        follower.show(Event::End);
        let outcome = trained?;
        let network = without_constants(&outcome.network, &training_rows);
        Ok((ScaledNetwork { scaling, layers: network.to_layers() }, outcome))
    }
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
