//! Training of the network of a fit.

use super::{FitContext, FitOptions, RowSplit};
use crate::{
    Error, Result,
    baselines::StandardizedRows,
    network::Network,
    project::{Control, CountedWork, Event},
    scaling::{of_columns, standardize_rows},
    study::SmallNetworks,
    training::{
        self, EpochRecord, FewRows, IterationFollower, Observer, Outcome, Progress, SmallNetwork, TrainingRows,
        train_small, without_constants,
    },
};
use metafmu_runtime::{Activation, Rows, ScaledNetwork, Scaling};
use std::{ops::ControlFlow, sync::atomic::Ordering};

impl FitContext<'_> {
    /// Returns true if networks are trained by Levenberg-Marquardt steps: those of parts of the rows are as that of all.
    pub(super) fn has_small_network(&self) -> bool {
        let rows = self.inputs.len();
        let columns = [self.inputs.width(), self.outputs.width()];
        rows > 1 && self.small().is_some_and(|small| small.is_quick(columns, rows))
    }

    fn small(&self) -> Option<SmallNetwork> {
        let FitOptions { small_networks, network, seed, .. } = self.options;
        let hidden = match small_networks {
            SmallNetworks::Never => return None,
            SmallNetworks::OfGivenSize => Some(network.hidden.clone()),
            SmallNetworks::OfChosenSize => None,
        };
        Some(SmallNetwork { hidden, activation: network.activation, seed: *seed })
    }

    /// The network of some of the rows by Levenberg-Marquardt steps; `is_shown`: whether its progress is reported.
    pub(super) fn small_network(&self, rows: &[usize], is_shown: bool) -> Result<ScaledNetwork> {
        let Self { inputs, outputs, control, .. } = self;
        let (x, y) = (inputs.pick(rows), outputs.pick(rows));
        let scaling = scaling_of(&x, &y);
        let columns = [x.width(), y.width()];
        let standardized = StandardizedRows::new(x.into_values(), y.into_values(), scaling);
        let StandardizedRows { x, y, scaling, .. } = &standardized;
        let rows_of = FewRows { x, y, inputs: columns[0], outputs: columns[1] };
        let small = self.small().unwrap_or(SmallNetwork { hidden: None, activation: Activation::Tanh, seed: 0 });
        let show = |event: Event<'_>| {
            if is_shown {
                control.observer.event(event);
            }
        };
        show(Event::Begin { work: CountedWork::Steps, total: small.iterations(columns, rows.len()) });
        let progress = |done| show(Event::Progress { done, about: format_args!("Levenberg-Marquardt") });
        let is_stopped = || self.is_stopped();
        let follower = IterationFollower { progress: &progress, is_stopped: &is_stopped };
        let layers = train_small(rows_of, &small, &follower);
        show(Event::End);
        let layers = layers.ok_or(Error::Interrupted)?;
        if is_shown && let Some((_, hidden)) = layers.split_last() {
            let nodes: Vec<String> = hidden.iter().map(|layer| layer.outputs.to_string()).collect();
            show(Event::Note(format_args!(
                "network: hidden layers of {} nodes, trained with Bayesian regularization",
                nodes.join(", ")
            )));
        }
        Ok(ScaledNetwork { scaling: scaling.clone(), layers })
    }

    /// The network of some of the rows; `is_shown`: whether its progress is reported.
    pub(super) fn network(
        &self,
        RowSplit { seen, choosing, .. }: RowSplit,
        is_shown: bool,
    ) -> Result<(ScaledNetwork, Outcome)> {
        let Self { inputs, outputs, options, control, .. } = self;
        let columns = [inputs, outputs].map(|rows| rows.width());
        let (x, y) = (inputs.pick(seen), outputs.pick(seen));
        let scaling = scaling_of(&x, &y);
        let rows = |x: &Rows, y: &Rows| {
            let x = standardize_rows(x, &scaling.input_mean, &scaling.input_scale);
            let y = standardize_rows(y, &scaling.output_mean, &scaling.output_scale);
            TrainingRows::new(columns[0], columns[1], x, y)
        };
        let training_rows = rows(&x, &y)?;
        let validation_rows = rows(&inputs.pick(choosing), &outputs.pick(choosing))?;
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

/// Means and standard deviations of inputs and outputs.
fn scaling_of(x: &Rows, y: &Rows) -> Scaling {
    let ((input_mean, input_scale), (output_mean, output_scale)) = (of_columns(x), of_columns(y));
    Scaling { input_mean, input_scale, output_mean, output_scale }
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
