//! A network under training.

use super::{TrainingError, TrainingRows, gradient::Gradients, optimizer::Updater, pace::Pace, team::Team};
use crate::{
    diagnostics::KeyProblem,
    network::{
        BLOCK_ROWS, Network, Packed,
        kernels::{batch_norm, buffer::Buffer},
        layout::padded,
    },
    study::TrainingOptions,
};
use std::time::Instant;

/// Share of a batch in the running statistics of a normalized layer: PyTorch's.
const STATISTICS_SHARE: f32 = 0.1;

/// A network under training: its parameters, the optimizer's memory and all working memory of a step.
pub struct Trainer {
    /// Without its parameters, which are elsewhere.
    network: Network,
    packed: Packed,
    /// Running means and variances of each normalized layer, `[2, padded(outputs)]`.
    running: Vec<Buffer>,
    /// The validated network, with the normalization in its weights; none without normalization.
    folded: Option<Packed>,
    updater: Updater,
    gradients: Gradients,
    team: Team,
    pace: Pace,
    seed: u64,
}

impl Trainer {
    /// For batches of at most `batch` rows, on `threads` threads, the caller's included. `seed` decides which nodes are
    /// dropped.
    ///
    /// # Errors
    /// [`TrainingError::Option`] if an option makes no sense.
    pub fn new(
        network: Network,
        options: &TrainingOptions,
        batch: usize,
        threads: usize,
        seed: u64,
    ) -> Result<Self, TrainingError> {
        let mut problems = options.problems();
        problems.extend(options.problems_beside(network.outputs()));
        if let Some(KeyProblem { key, message }) = problems.into_iter().next() {
            return Err(TrainingError::Option { name: key, problem: message });
        }
        let packed = Packed::with(&network, options.batch_norm, options.dropout);
        let team = Team::new(threads);
        let normalized = packed.layout.shapes.iter().filter(|shape| shape.normalized);
        let running = normalized.map(|shape| {
            let mut statistics = Buffer::zeros(2 * padded(shape.outputs));
            statistics[padded(shape.outputs)..].fill(1.0);
            statistics
        });
        Ok(Self {
            running: running.collect(),
            folded: options.batch_norm.then(|| Packed::new(&network)),
            updater: Updater::new(options, &packed),
            gradients: Gradients::new(&packed, options, batch, team.members()),
            network,
            packed,
            team,
            pace: Pace::new(),
            seed,
        })
    }

    /// The current network, with its normalization, if there is one, in its weights and biases.
    pub fn network(&self) -> Network {
        let mut network = self.network.clone();
        let mut parameters = self.packed.parameters.clone();
        let normalized = self.packed.layout.shapes.iter().filter(|shape| shape.normalized);
        for (shape, running) in normalized.zip(&self.running) {
            let (means, variances) = running.split_at(padded(shape.outputs));
            let scale: Vec<f32> = shape
                .factors(&parameters)
                .iter()
                .zip(variances)
                .map(|(factor, variance)| factor / (variance + batch_norm::EPSILON).sqrt())
                .collect();
            shape.scale_outputs(&mut parameters, &scale);
            let (_, biases) = shape.split_mut(&mut parameters);
            for ((bias, mean), scale) in biases.iter_mut().zip(means).zip(scale) {
                *bias -= mean * scale;
            }
        }
        self.packed.layout.unpack(&parameters, network.parameters_mut());
        network
    }

    /// One optimizer step on the rows with the given numbers. Returns their loss before the step; if it is infinite or
    /// NaN, the network stays unchanged.
    ///
    /// # Panics
    /// If the rows do not fit the network, a number is too large, or there are none or more than `batch` of them.
    pub fn step(&mut self, rows: &TrainingRows, numbers: &[u32], learning_rate: f64) -> f64 {
        let Self { packed, updater, gradients, team, pace, seed, running, .. } = self;
        let started = Instant::now();
        team.set_alone(pace.alone());
        let loss = gradients.compute(team, packed, rows, numbers, (*seed, updater.steps()));
        if loss.is_finite() {
            updater.step(team, gradients, numbers.len(), packed, learning_rate);
            for (layer, running) in running.iter_mut().enumerate() {
                gradients.blend_statistics(numbers.len(), layer, STATISTICS_SHARE, running);
            }
        }
        pace.took(started.elapsed().as_secs_f64());
        loss
    }

    /// Mean loss over the outputs of all rows, without penalties.
    pub(super) fn loss(&mut self, rows: &TrainingRows, sums: &mut [f64]) -> f64 {
        if self.folded.is_some() {
            let network = self.network();
            if let Some(folded) = &mut self.folded {
                folded.set(network.parameters());
            }
        }
        let network = self.folded.as_ref().unwrap_or(&self.packed);
        self.team.set_alone(false);
        self.gradients.loss(&mut self.team, network, rows, sums)
    }

    /// Everything that changes from step to step, with names, except the number of steps.
    pub(super) fn state(&mut self) -> Vec<(String, &mut [f32])> {
        let mut state = vec![("parameters".to_owned(), &mut *self.packed.parameters)];
        for (index, running) in self.running.iter_mut().enumerate() {
            state.push((format!("statistics.{index}"), &mut **running));
        }
        state.extend(self.updater.memory());
        state
    }

    /// Steps done.
    pub(super) fn steps(&self) -> u64 {
        self.updater.steps()
    }

    /// Must be called after [`state`](Self::state) has been written to.
    pub(super) fn restored(&mut self, steps: u64) {
        self.updater.set_steps(steps);
        self.packed.transpose();
    }
}

/// Places for [`Trainer::loss`] of this many rows.
pub(super) fn sums(rows: usize) -> Vec<f64> {
    vec![0.0; rows.div_ceil(BLOCK_ROWS)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use metafmu_runtime::{Activation, Layer};

    /// See `tests/data/make_training_step.py`.
    #[derive(serde::Deserialize)]
    struct PyTorch {
        sizes: Vec<usize>,
        cases: Vec<Case>,
    }

    #[derive(serde::Deserialize)]
    struct Case {
        name: String,
        activation: Activation,
        options: TrainingOptions,
        inputs: Vec<f32>,
        targets: Vec<f32>,
        parameters: Vec<f32>,
        losses: Vec<f64>,
        gradients: Vec<Vec<f32>>,
        parameters_after: Vec<f32>,
        tolerance: f32,
    }

    fn from_parameters(sizes: &[usize], activation: Activation, mut rest: &[f32]) -> Network {
        let mut layers = Vec::new();
        for pair in sizes.windows(2) {
            let (inputs, outputs) = (pair[0], pair[1]);
            let (weight, tail) = rest.split_at(inputs * outputs);
            let (bias, tail) = tail.split_at(outputs);
            rest = tail;
            let (weight, bias) = (weight.to_vec().into(), bias.to_vec().into());
            layers.push(Layer { inputs, outputs, weight, bias, activation });
        }
        layers.last_mut().unwrap().activation = Activation::Identity;
        Network::from_layers(&layers, activation).unwrap()
    }

    #[test]
    fn losses_gradients_and_steps_of_every_kind_agree_with_pytorch() {
        let text = include_str!("../../../tests/data/training_step.json");
        let PyTorch { sizes, cases } = serde_json::from_str(text).unwrap();
        assert_eq!(cases.len(), 21);
        for case in cases {
            let Case { name, options, losses, gradients, tolerance, .. } = case;
            let network = from_parameters(&sizes, case.activation, &case.parameters);
            let rows = TrainingRows::new(sizes[0], sizes[sizes.len() - 1], case.inputs, case.targets).unwrap();
            let numbers: Vec<u32> = (0..rows.len() as u32).collect();
            let mut trainer = Trainer::new(network, &options, rows.len(), 2, 1).unwrap();
            for (step, loss) in losses.iter().enumerate() {
                let found = trainer.step(&rows, &numbers, options.learning_rate);
                assert!((found - loss).abs() < f64::from(tolerance) * loss, "{name}: loss {found}, expected {loss}");
                let Some(gradient) = gradients.get(step) else { continue };
                let mut found = vec![0.0; gradient.len()];
                trainer.packed.layout.unpack(trainer.gradients.total(), &mut found);
                for (found, expected) in found.iter().zip(gradient) {
                    let error = (found - expected).abs() / expected.abs().max(1.0);
                    assert!(error < tolerance, "{name}: gradient {found} {expected}");
                }
            }
            for (found, expected) in trainer.network().parameters().iter().zip(&case.parameters_after) {
                assert!((found - expected).abs() < 2.5 * tolerance, "{name}: parameter {found} {expected}");
            }
        }
    }

    #[test]
    fn dropout_leaves_out_its_share_and_keeps_the_mean() {
        let network = |activation| {
            let layer = |inputs, outputs, weight: f32, activation| Layer {
                inputs,
                outputs,
                weight: vec![weight; inputs * outputs].into(),
                bias: vec![0.0f32; outputs].into(),
                activation,
            };
            let layers = [layer(1, 1000, 1.0, activation), layer(1000, 1, 1e-3, Activation::Identity)];
            Network::from_layers(&layers, activation).unwrap()
        };
        // hidden values and their mean are 1; the loss of a target of 0 is the square of what is left
        let rows = TrainingRows::new(1, 1, vec![1.0; 200], vec![0.0; 200]).unwrap();
        let numbers: Vec<u32> = (0..200).collect();
        let options = TrainingOptions { dropout: 0.25, ..TrainingOptions::default() };
        let mut trainer = Trainer::new(network(Activation::Identity), &options, 200, 1, 7).unwrap();
        let loss = trainer.step(&rows, &numbers, 0.0);
        // variance of a mean of 1000 values that are 4/3 with probability 3/4: (1/3) / 1000
        assert!((loss - (1.0 + 1.0 / 3000.0)).abs() < 5e-3, "{loss}");
        let other = trainer.step(&rows, &numbers, 0.0);
        assert_ne!(loss, other, "the same nodes in two steps");
        // without dropout: exactly 1 up to rounding
        assert!((trainer.loss(&rows, &mut sums(200)) - 1.0).abs() < 1e-5);
    }

    #[test]
    fn the_exported_network_contains_the_normalization() {
        let network = from_parameters(&[1, 1, 1], Activation::Identity, &[1.0, 0.0, 1.0, 0.0]);
        let options = TrainingOptions { batch_norm: true, ..TrainingOptions::default() };
        let mut trainer = Trainer::new(network, &options, 4, 1, 1).unwrap();
        let rows = TrainingRows::new(1, 1, vec![2.0, 4.0, 6.0, 8.0], vec![0.0; 4]).unwrap();
        for _ in 0..200 {
            trainer.step(&rows, &[0, 1, 2, 3], 0.0);
        }
        // mean 5, variance of the population 20 / 3
        let mut found = [0.0; 4];
        trainer.network().predict(rows.inputs(), &mut found);
        for (found, x) in found.iter().zip(rows.inputs()) {
            let expected = (x - 5.0) / (20.0f32 / 3.0).sqrt();
            assert!((found - expected).abs() < 1e-5, "{found} {expected}");
        }
    }
}
