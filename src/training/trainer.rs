//! The training loop.

use super::{
    EpochRecord, Observer, Outcome, Progress, Rows, StopReason, TrainingError, gradient::Gradients, optimizer::Updater,
    schedule::relative_rate, team::Team,
};
use crate::{
    network::{BLOCK_ROWS, Network, Packed},
    study::TrainingOptions,
};
use rand::{SeedableRng, rngs::ChaCha8Rng, seq::SliceRandom};
use std::time::Instant;

/// A network under training: its parameters, the optimizer's memory and all working memory of a step.
pub struct Trainer {
    network: Network,
    packed: Packed,
    updater: Updater,
    gradients: Gradients,
    team: Team,
}

impl Trainer {
    /// For batches of at most `batch` rows, on `threads` threads, the caller's included.
    ///
    /// # Panics
    /// If there are weights of outputs, but not one for each output.
    pub fn new(network: Network, options: &TrainingOptions, batch: usize, threads: usize) -> Self {
        let packed = Packed::new(&network);
        let team = Team::new(threads);
        let gradients = Gradients::new(&packed, options, batch, team.members());
        Self { updater: Updater::new(options, &packed), network, packed, gradients, team }
    }

    /// The network as it stands.
    pub fn network(&self) -> Network {
        let mut network = self.network.clone();
        self.packed.layout.unpack(&self.packed.parameters, network.parameters_mut());
        network
    }

    /// One optimizer step on the rows with the given numbers. Returns their loss before the step; if it is infinite or
    /// not a number, the network stays as it is. Allocates nothing.
    ///
    /// # Panics
    /// If the rows do not fit the network, a number is too large, or there are none or more than `batch` of them.
    pub fn step(&mut self, rows: &Rows, numbers: &[u32], learning_rate: f64) -> f64 {
        let Self { packed, updater, gradients, team, .. } = self;
        let loss = gradients.compute(team, packed, rows, numbers);
        if loss.is_finite() {
            updater.step(team, gradients, numbers.len(), packed, learning_rate);
        }
        loss
    }
}

/// Trains a network. The outcome does not depend on the number of threads.
///
/// # Errors
/// A [`TrainingError`] if there are no training or no validation rows, they do not fit the network, or an option makes
/// no sense.
pub fn train(
    network: Network,
    training: &Rows,
    validation: &Rows,
    options: &TrainingOptions,
    seed: u64,
    observer: &mut dyn Observer,
) -> Result<Outcome, TrainingError> {
    check_options(options, network.outputs())?;
    check_rows(&network, "training", training)?;
    check_rows(&network, "validation", validation)?;
    let rows = u32::try_from(training.len()).map_err(|_| TrainingError::TooManyRows { rows: training.len() })?;
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    // not the numbers that the same seed gave the network's weights
    random.set_stream(1);
    let batch = options.batch.min(training.len());
    let best = network.clone();
    let run = Run {
        trainer: Trainer::new(network, options, batch, rayon::current_num_threads()),
        best,
        training,
        validation,
        options,
        random,
        order: (0..rows).collect(),
        steps: training.len().div_ceil(batch),
        validation_sums: vec![0.0; validation.len().div_ceil(BLOCK_ROWS)],
    };
    Ok(run.run(observer))
}

/// A training under way.
struct Run<'a> {
    trainer: Trainer,
    /// The network with the smallest validation loss so far; at first the given one.
    best: Network,
    training: &'a Rows,
    validation: &'a Rows,
    options: &'a TrainingOptions,
    random: ChaCha8Rng,
    /// The numbers of the training rows, shuffled again every epoch.
    order: Vec<u32>,
    /// Steps of an epoch.
    steps: usize,
    validation_sums: Vec<f64>,
}

/// What an epoch leaves for its record.
struct Epoch {
    train_loss: f64,
    validation_loss: f64,
    learning_rate: f64,
}

impl Run<'_> {
    fn run(mut self, observer: &mut dyn Observer) -> Outcome {
        let started = Instant::now();
        let (mut best_epoch, mut best_loss) = (0, f64::INFINITY);
        let mut history = Vec::with_capacity(self.options.epochs);
        let mut reason = StopReason::Finished;
        for epoch in 1..=self.options.epochs {
            let Epoch { train_loss, validation_loss, learning_rate } = match self.epoch(epoch, observer) {
                Ok(done) => done,
                Err(stop) => {
                    reason = stop;
                    break;
                }
            };
            let is_best = validation_loss < best_loss;
            if is_best {
                (best_epoch, best_loss) = (epoch, validation_loss);
                self.best = self.trainer.network();
            }
            let seconds = started.elapsed().as_secs_f64();
            let record = EpochRecord { epoch, train_loss, validation_loss, learning_rate, seconds, best: is_best };
            history.push(record);
            observer.epoch(&record);
            if self.options.patience > 0 && epoch - best_epoch >= self.options.patience {
                reason = StopReason::Patience;
                break;
            }
        }
        if best_epoch == 0 && reason == StopReason::Interrupted {
            self.best = self.trainer.network();
        }
        Outcome { network: self.best, history, best_epoch, reason }
    }

    /// All training rows once, then the validation.
    fn epoch(&mut self, epoch: usize, observer: &mut dyn Observer) -> Result<Epoch, StopReason> {
        self.order.shuffle(&mut self.random);
        let (rows, steps, epochs) = (self.order.len(), self.steps, self.options.epochs);
        let (mut sum, mut learning_rate) = (0.0, 0.0);
        for step in 0..steps {
            // batches that differ by one row at most, instead of a last one that is much smaller and noisier
            let (begin, end) = (step * rows / steps, (step + 1) * rows / steps);
            let number = ((epoch - 1) * steps + step) as u64;
            let relative = relative_rate(self.options, number, (epochs * steps) as u64);
            learning_rate = self.options.learning_rate * relative;
            let loss = self.trainer.step(self.training, &self.order[begin..end], learning_rate);
            if !loss.is_finite() {
                return Err(StopReason::Diverged);
            }
            sum += loss * (end - begin) as f64;
            let progress = Progress { epoch, epochs, step: step + 1, steps, loss: sum / end as f64 };
            if observer.step(&progress).is_break() {
                return Err(StopReason::Interrupted);
            }
        }
        let Trainer { packed, gradients, team, .. } = &mut self.trainer;
        let validation_loss = gradients.loss(team, packed, self.validation, &mut self.validation_sums);
        if !validation_loss.is_finite() {
            return Err(StopReason::Diverged);
        }
        Ok(Epoch { train_loss: sum / rows as f64, validation_loss, learning_rate })
    }
}

fn check_options(options: &TrainingOptions, outputs: usize) -> Result<(), TrainingError> {
    match options.problems(outputs).into_iter().next() {
        Some((name, problem)) => Err(TrainingError::Option { name, problem }),
        None => Ok(()),
    }
}

fn check_rows(network: &Network, set: &'static str, rows: &Rows) -> Result<(), TrainingError> {
    for (what, found, expected) in
        [("input", rows.n_inputs(), network.inputs()), ("output", rows.n_outputs(), network.outputs())]
    {
        if found != expected {
            return Err(TrainingError::Columns { set, what, found, expected });
        }
    }
    if rows.is_empty() {
        return Err(TrainingError::NoRows { set });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::study::{NetworkOptions, Schedule};
    use metafmu_runtime::{Activation, Layer};
    use rayon::ThreadPoolBuilder;
    use std::ops::ControlFlow;

    /// `sin(2 a) cos(b)` and `a b` on points spread over the square from -1 to 1, beginning at point `first`.
    fn smooth(first: usize, rows: usize) -> Rows {
        let coordinate = |i: usize, ratio: f64| 2.0 * ((first + i) as f64 * ratio).fract() - 1.0;
        let points: Vec<(f64, f64)> =
            (0..rows).map(|i| (coordinate(i, 0.754_877_666_246_693), coordinate(i, 0.569_840_290_998_053))).collect();
        let inputs = points.iter().flat_map(|&(a, b)| [a as f32, b as f32]).collect();
        let outputs = points.iter().flat_map(|&(a, b)| [((2.0 * a).sin() * b.cos()) as f32, (a * b) as f32]).collect();
        Rows::new(2, 2, inputs, outputs).unwrap()
    }

    fn network(hidden: &[usize]) -> Network {
        Network::new(2, 2, &NetworkOptions { hidden: hidden.into(), activation: Activation::Tanh }, 3).unwrap()
    }

    fn options(epochs: usize, batch: usize) -> TrainingOptions {
        TrainingOptions { epochs, batch, learning_rate: 1e-2, ..TrainingOptions::default() }
    }

    fn with_threads<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
        ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(work)
    }

    /// Records everything, and breaks at the given step of the whole training.
    #[derive(Default)]
    struct Recorder {
        break_at: Option<usize>,
        steps: Vec<Progress>,
        epochs: Vec<EpochRecord>,
    }

    impl Observer for Recorder {
        fn step(&mut self, progress: &Progress) -> ControlFlow<()> {
            self.steps.push(*progress);
            if self.break_at == Some(self.steps.len()) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        }

        fn epoch(&mut self, record: &EpochRecord) {
            self.epochs.push(*record);
        }
    }

    #[derive(serde::Deserialize)]
    struct PyTorch {
        sizes: Vec<usize>,
        rate: f64,
        cases: Vec<PyTorchCase>,
    }

    #[derive(serde::Deserialize)]
    struct PyTorchCase {
        activation: Activation,
        inputs: Vec<f32>,
        targets: Vec<f32>,
        parameters: Vec<f32>,
        losses: Vec<f64>,
        gradients: Vec<Vec<f32>>,
        parameters_after: Vec<f32>,
    }

    fn from_parameters(sizes: &[usize], activation: Activation, mut rest: &[f32]) -> Network {
        let mut layers = Vec::new();
        for pair in sizes.windows(2) {
            let (inputs, outputs) = (pair[0], pair[1]);
            let (weight, tail) = rest.split_at(inputs * outputs);
            let (bias, tail) = tail.split_at(outputs);
            rest = tail;
            layers.push(Layer { inputs, outputs, weight: weight.into(), bias: bias.into() });
        }
        Network::from_layers(&layers, activation).unwrap()
    }

    #[test]
    fn losses_gradients_and_adam_steps_agree_with_pytorch() {
        let text = include_str!("../../tests/data/training_step.json");
        let PyTorch { sizes, rate, cases } = serde_json::from_str(text).unwrap();
        assert_eq!(cases.len(), 3);
        for case in cases {
            let network = from_parameters(&sizes, case.activation, &case.parameters);
            let rows = Rows::new(sizes[0], sizes[sizes.len() - 1], case.inputs, case.targets).unwrap();
            let numbers: Vec<u32> = (0..rows.len() as u32).collect();
            let mut trainer = Trainer::new(network, &TrainingOptions::default(), rows.len(), 2);
            for (loss, gradient) in case.losses.iter().zip(&case.gradients) {
                let found = trainer.step(&rows, &numbers, rate);
                assert!((found - loss).abs() < 2e-7 * loss, "{:?}: loss {found}, expected {loss}", case.activation);
                let mut found = vec![0.0; gradient.len()];
                trainer.packed.layout.unpack(trainer.gradients.total(), &mut found);
                for (found, expected) in found.iter().zip(gradient) {
                    assert!((found - expected).abs() < 2e-7, "{:?}: gradient {found} {expected}", case.activation);
                }
            }
            for (found, expected) in trainer.network().parameters().iter().zip(&case.parameters_after) {
                assert!((found - expected).abs() < 5e-7, "{:?}: parameter {found} {expected}", case.activation);
            }
        }
    }

    #[test]
    fn a_batch_of_many_parts_and_blocks_has_the_gradient_of_its_rows() {
        // 20,000 rows: parts of several blocks, the last one shorter; the same rows one block at a time as reference
        let (rows, packed) = (smooth(0, 20_000), Packed::new(&network(&[8])));
        let numbers: Vec<u32> = (0..20_000).rev().collect();
        let mut team = Team::new(2);
        let mut whole = Gradients::new(&packed, &TrainingOptions::default(), numbers.len(), 2);
        let loss = whole.compute(&mut team, &packed, &rows, &numbers);
        let sum = whole.sum(numbers.len(), false);
        // SAFETY: one piece
        let found = unsafe { sum.piece(0..packed.layout.len()) }.to_vec();
        let mut block = Gradients::new(&packed, &TrainingOptions::default(), BLOCK_ROWS, 2);
        let (mut sum, mut expected) = (0.0, vec![0.0; packed.layout.len()]);
        for numbers in numbers.chunks(BLOCK_ROWS) {
            let share = numbers.len() as f64 / 20_000.0;
            sum += share * block.compute(&mut team, &packed, &rows, numbers);
            let parts = block.sum(numbers.len(), false);
            // SAFETY: one piece
            let part = unsafe { parts.piece(0..packed.layout.len()) };
            for (total, part) in expected.iter_mut().zip(part) {
                *total += share * f64::from(*part);
            }
        }
        assert!((loss - sum).abs() < 1e-12 * sum, "{loss} {sum}");
        for (found, expected) in found.iter().zip(expected) {
            assert!((f64::from(*found) - expected).abs() < 1e-6, "{found} {expected}");
        }
    }

    #[test]
    fn training_gives_the_same_bytes_on_any_number_of_threads() {
        let (training, validation) = (smooth(0, 3_001), smooth(5_000, 1_000));
        let run = |threads| {
            with_threads(threads, || train(network(&[16, 16]), &training, &validation, &options(3, 700), 9, &mut ()))
        };
        let one = run(1).unwrap();
        assert_ne!(one.network, network(&[16, 16]));
        for threads in [2, 3] {
            let other = run(threads).unwrap();
            assert_eq!(one.network, other.network, "{threads} threads");
            let losses = |outcome: &Outcome| -> Vec<(f64, f64)> {
                outcome.history.iter().map(|record| (record.train_loss, record.validation_loss)).collect()
            };
            assert_eq!(losses(&one), losses(&other), "{threads} threads");
        }
    }

    #[test]
    fn another_seed_gives_another_order_of_rows() {
        let (training, validation) = (smooth(0, 500), smooth(5_000, 100));
        let run = |seed| train(network(&[4]), &training, &validation, &options(1, 50), seed, &mut ()).unwrap().network;
        assert_eq!(run(1), run(1));
        assert_ne!(run(1), run(2));
    }

    #[test]
    fn a_smooth_function_is_learned() {
        let (training, validation) = (smooth(0, 4_000), smooth(5_000, 500));
        let outcome = train(network(&[32, 32]), &training, &validation, &options(200, 100), 1, &mut ()).unwrap();
        let last = outcome.history.last().unwrap();
        assert_eq!(outcome.reason, StopReason::Finished);
        assert_eq!(outcome.history.len(), 200);
        assert!(last.validation_loss < 1e-5, "{last:?}");
        assert!(last.train_loss < 1e-5, "{last:?}");
    }

    #[test]
    fn the_best_network_on_the_validation_rows_is_the_result() {
        let (training, validation) = (smooth(0, 300), smooth(5_000, 100));
        // a rate so high that the loss goes up and down
        let options = TrainingOptions { learning_rate: 0.1, schedule: Schedule::Constant, ..options(20, 30) };
        let mut recorder = Recorder::default();
        let outcome = train(network(&[8]), &training, &validation, &options, 1, &mut recorder).unwrap();
        let losses: Vec<f64> = outcome.history.iter().map(|record| record.validation_loss).collect();
        let smallest = losses.iter().copied().fold(f64::INFINITY, f64::min);
        assert!(losses[19] > smallest, "the last epoch must not be the best, or this test shows nothing: {losses:?}");
        assert_eq!(losses[outcome.best_epoch - 1], smallest);
        assert_eq!(outcome.history.iter().rposition(|record| record.best), Some(outcome.best_epoch - 1));
        assert_eq!(recorder.epochs, outcome.history);
        let packed = Packed::new(&outcome.network);
        let gradients = Gradients::new(&packed, &options, 1, 1);
        let found = gradients.loss(&mut Team::new(1), &packed, &validation, &mut [0.0; 2]);
        assert_eq!(found, smallest);
    }

    #[test]
    fn patience_ends_the_training_that_many_epochs_after_the_best_one() {
        let (training, validation) = (smooth(0, 300), smooth(5_000, 100));
        let options =
            TrainingOptions { learning_rate: 0.1, schedule: Schedule::Constant, patience: 3, ..options(500, 30) };
        let outcome = train(network(&[8]), &training, &validation, &options, 1, &mut ()).unwrap();
        assert_eq!(outcome.reason, StopReason::Patience);
        assert_eq!(outcome.history.len(), outcome.best_epoch + 3);
        assert!(outcome.history[outcome.best_epoch..].iter().all(|record| !record.best));
    }

    #[test]
    fn an_interruption_keeps_the_best_network_so_far() {
        let (training, validation) = (smooth(0, 300), smooth(5_000, 100));
        let run = |epochs, break_at| {
            let mut recorder = Recorder { break_at, ..Recorder::default() };
            let options = TrainingOptions { schedule: Schedule::Constant, ..options(epochs, 100) };
            train(network(&[8]), &training, &validation, &options, 1, &mut recorder).unwrap()
        };
        let one_epoch = run(1, None);
        let interrupted = run(9, Some(5));
        assert_eq!((interrupted.reason, interrupted.best_epoch), (StopReason::Interrupted, 1));
        assert_eq!(interrupted.history.len(), 1);
        assert_eq!(interrupted.network, one_epoch.network);
    }

    #[test]
    fn an_interruption_before_the_first_validation_keeps_the_current_network() {
        let (training, validation) = (smooth(0, 300), smooth(5_000, 100));
        let mut recorder = Recorder { break_at: Some(2), ..Recorder::default() };
        let outcome = train(network(&[8]), &training, &validation, &options(9, 100), 1, &mut recorder).unwrap();
        assert_eq!((outcome.reason, outcome.best_epoch), (StopReason::Interrupted, 0));
        assert!(outcome.history.is_empty());
        assert_ne!(outcome.network, network(&[8]));
    }

    /// One step an epoch, at a rate that is far too high.
    fn diverge(epochs: usize, learning_rate: f64) -> Outcome {
        let (training, validation) = (smooth(0, 100), smooth(5_000, 100));
        let options = TrainingOptions { learning_rate, schedule: Schedule::Constant, ..options(epochs, 100) };
        train(network(&[8]), &training, &validation, &options, 1, &mut ()).unwrap()
    }

    #[test]
    fn a_divergence_keeps_the_best_network_so_far() {
        let diverged = diverge(50, 1e25);
        assert_eq!((diverged.reason, diverged.best_epoch), (StopReason::Diverged, 1));
        assert_eq!(diverged.network, diverge(1, 1e25).network);
    }

    #[test]
    fn a_divergence_before_the_first_validation_keeps_the_given_network() {
        let diverged = diverge(50, 1e38);
        assert_eq!((diverged.reason, diverged.best_epoch), (StopReason::Diverged, 0));
        assert_eq!(diverged.network, network(&[8]));
    }

    #[test]
    fn progress_counts_the_steps_of_nearly_equal_batches() {
        let (training, validation) = (smooth(0, 205), smooth(5_000, 100));
        let mut recorder = Recorder::default();
        train(network(&[4]), &training, &validation, &options(2, 100), 1, &mut recorder).unwrap();
        let counts: Vec<(usize, usize)> = recorder.steps.iter().map(|p| (p.epoch, p.step)).collect();
        assert_eq!(counts, [(1, 1), (1, 2), (1, 3), (2, 1), (2, 2), (2, 3)]);
        assert!(recorder.steps.iter().all(|progress| (progress.epochs, progress.steps) == (2, 3)));
        assert_eq!(recorder.steps[2].loss, recorder.epochs[0].train_loss);
        assert_eq!(recorder.steps[5].loss, recorder.epochs[1].train_loss);
        assert!(recorder.epochs[0].seconds > 0.0 && recorder.epochs[1].seconds >= recorder.epochs[0].seconds);
    }

    #[test]
    fn a_batch_larger_than_the_rows_is_all_rows() {
        let (training, validation) = (smooth(0, 30), smooth(5_000, 10));
        let run = |batch| train(network(&[4]), &training, &validation, &options(3, batch), 1, &mut ()).unwrap().network;
        assert_eq!(run(1_000_000), run(30));
    }

    #[test]
    fn trainings_that_make_no_sense_are_refused() {
        let (rows, none) = (smooth(0, 10), Rows::new(2, 2, Vec::new(), Vec::new()).unwrap());
        let wide = Rows::new(3, 2, vec![0.0; 3], vec![0.0; 2]).unwrap();
        let refuse = |training: &Rows, validation: &Rows, options: &TrainingOptions| {
            train(network(&[4]), training, validation, options, 1, &mut ()).unwrap_err()
        };
        assert_eq!(refuse(&none, &rows, &options(1, 1)), TrainingError::NoRows { set: "training" });
        assert_eq!(refuse(&rows, &none, &options(1, 1)), TrainingError::NoRows { set: "validation" });
        let columns = TrainingError::Columns { set: "validation", what: "input", found: 3, expected: 2 };
        assert_eq!(refuse(&rows, &wide, &options(1, 1)), columns);
        let message = |options: &TrainingOptions| refuse(&rows, &rows, options).to_string();
        assert_eq!(message(&options(0, 1)), "training option `epochs`: 0, expected at least 1");
        assert_eq!(message(&options(1, 0)), "training option `batch`: 0, expected at least 1 row");
        for rate in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let options = TrainingOptions { learning_rate: rate, ..options(1, 1) };
            let error = refuse(&rows, &rows, &options);
            assert!(matches!(error, TrainingError::Option { name, .. } if name == "learning_rate"));
        }
    }
}
