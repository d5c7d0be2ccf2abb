use super::*;
use crate::{
    network::{BLOCK_ROWS, Packed},
    study::{NetworkOptions, Optimizer},
    training::{gradient::Gradients, team::Team},
};
use rand::RngExt;
use rayon::ThreadPoolBuilder;
use std::ops::ControlFlow;

/// `sin(2 a) cos(b)` and `a b` on points spread over the square from -1 to 1, beginning at point `first`.
fn smooth(first: usize, rows: usize) -> TrainingRows {
    let coordinate = |i: usize, ratio: f64| 2.0 * ((first + i) as f64 * ratio).fract() - 1.0;
    let points: Vec<(f64, f64)> =
        (0..rows).map(|i| (coordinate(i, 0.754_877_666_246_693), coordinate(i, 0.569_840_290_998_053))).collect();
    let inputs = points.iter().flat_map(|&(a, b)| [a as f32, b as f32]).collect();
    let outputs = points.iter().flat_map(|&(a, b)| [((2.0 * a).sin() * b.cos()) as f32, (a * b) as f32]).collect();
    TrainingRows::new(2, 2, inputs, outputs).unwrap()
}

fn network(hidden: &[usize]) -> Network {
    Network::new(2, 2, &NetworkOptions { hidden: hidden.into(), ..NetworkOptions::default() }, 3).unwrap()
}

fn options(epochs: usize, batch: usize) -> TrainingOptions {
    TrainingOptions {
        optimizer: Optimizer::Adam,
        learning_rate: 1e-2,
        schedule: Schedule::Cosine,
        batch,
        epochs,
        ..TrainingOptions::default()
    }
}

fn with_threads<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
    ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(work)
}

/// Records everything, and breaks at the given step of the whole training.
#[derive(Default)]
struct TrainingRecorder {
    break_at: Option<usize>,
    steps: Vec<Progress>,
    epochs: Vec<EpochRecord>,
}

impl Observer for TrainingRecorder {
    fn step(&mut self, progress: &Progress) -> ControlFlow<()> {
        self.steps.push(*progress);
        if self.break_at == Some(self.steps.len()) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    fn epoch(&mut self, record: &EpochRecord) {
        self.epochs.push(*record);
    }
}

#[test]
fn a_batch_of_many_parts_and_blocks_has_the_gradient_of_its_rows() {
    // 20,000 rows: parts of several blocks, the last one shorter; the same rows one block at a time as reference
    let (rows, packed) = (smooth(0, 20_000), Packed::new(&network(&[8])));
    let numbers: Vec<u32> = (0..20_000).rev().collect();
    let mut team = Team::new(2);
    let mut whole = Gradients::new(&packed, &TrainingOptions::default(), numbers.len(), 2);
    let loss = whole.compute(&mut team, &packed, &rows, &numbers, (1, 1));
    let sum = whole.sum(numbers.len(), false);
    // SAFETY: one piece
    let found = unsafe { sum.piece(0..packed.layout.len()) }.to_vec();
    let mut block = Gradients::new(&packed, &TrainingOptions::default(), BLOCK_ROWS, 2);
    let (mut sum, mut expected) = (0.0, vec![0.0; packed.layout.len()]);
    for numbers in numbers.chunks(BLOCK_ROWS) {
        let share = numbers.len() as f64 / 20_000.0;
        sum += share * block.compute(&mut team, &packed, &rows, numbers, (1, 1));
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
    let options = TrainingOptions { learning_rate: 0.1, schedule: Schedule::Constant, ..options(18, 30) };
    let mut recorder = TrainingRecorder::default();
    let outcome = train(network(&[8]), &training, &validation, &options, 1, &mut recorder).unwrap();
    let losses: Vec<f64> = outcome.history.iter().map(|record| record.validation_loss).collect();
    let smallest = losses.iter().copied().fold(f64::INFINITY, f64::min);
    assert!(losses[17] > smallest, "the last epoch must not be the best, or this test shows nothing: {losses:?}");
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
    let options = TrainingOptions { learning_rate: 0.1, schedule: Schedule::Constant, patience: 3, ..options(500, 30) };
    let outcome = train(network(&[8]), &training, &validation, &options, 1, &mut ()).unwrap();
    assert_eq!(outcome.reason, StopReason::Patience);
    assert_eq!(outcome.history.len(), outcome.best_epoch + 3);
    assert!(outcome.history[outcome.best_epoch..].iter().all(|record| !record.best));
}

#[test]
fn an_interruption_keeps_the_best_network_so_far() {
    let (training, validation) = (smooth(0, 300), smooth(5_000, 100));
    let run = |epochs, break_at| {
        let mut recorder = TrainingRecorder { break_at, ..TrainingRecorder::default() };
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
    let mut recorder = TrainingRecorder { break_at: Some(2), ..TrainingRecorder::default() };
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
    let mut recorder = TrainingRecorder::default();
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
    let (rows, none) = (smooth(0, 10), TrainingRows::new(2, 2, Vec::new(), Vec::new()).unwrap());
    let wide = TrainingRows::new(3, 2, vec![0.0; 3], vec![0.0; 2]).unwrap();
    let refuse = |training: &TrainingRows, validation: &TrainingRows, options: &TrainingOptions| {
        train(network(&[4]), training, validation, options, 1, &mut ()).unwrap_err()
    };
    assert_eq!(refuse(&none, &rows, &options(1, 1)), TrainingError::NoRows { set: "training" });
    assert_eq!(refuse(&rows, &none, &options(1, 1)), TrainingError::NoRows { set: "validation" });
    let columns = TrainingError::Columns { set: "validation", what: "input", found: 3, expected: 2 };
    assert_eq!(refuse(&rows, &wide, &options(1, 1)), columns);
    let message = |options: &TrainingOptions| refuse(&rows, &rows, options).to_string();
    assert_eq!(message(&options(0, 1)), "training option `epochs`: 0, expected 1 to 1000000");
    assert_eq!(message(&options(1, 0)), "training option `batch`: 0, expected at least 1 row");
    for rate in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let options = TrainingOptions { learning_rate: rate, ..options(1, 1) };
        let error = refuse(&rows, &rows, &options);
        assert!(matches!(error, TrainingError::Option { name, .. } if name == "learning_rate"));
    }
}

/// Keeps every checkpoint.
#[derive(Default)]
struct Keeper(Vec<Vec<u8>>);

impl Observer for Keeper {
    fn step(&mut self, _: &Progress) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }

    fn epoch(&mut self, _: &EpochRecord) {}

    fn checkpoint(&mut self, _: usize, make: &mut dyn FnMut() -> Result<Vec<u8>, TrainingError>) {
        self.0.push(make().unwrap());
    }
}

#[test]
fn a_training_resumed_from_any_epoch_ends_in_the_same_bits() {
    let (training, validation) = (smooth(0, 900), smooth(5_000, 100));
    for optimizer in [Optimizer::Adam, Optimizer::Soap] {
        let refresh = if optimizer == Optimizer::Soap { 3 } else { 10 };
        let options = TrainingOptions { optimizer, batch_norm: true, dropout: 0.1, refresh, ..options(5, 200) };
        let mut keeper = Keeper::default();
        let whole = train(network(&[9, 7]), &training, &validation, &options, 1, &mut keeper).unwrap();
        assert_eq!(keeper.0.len(), 5);
        for (index, checkpoint) in keeper.0.iter().enumerate() {
            let mut again = Keeper::default();
            let resumed =
                resume(checkpoint, network(&[9, 7]), &training, &validation, &options, 1, &mut again).unwrap();
            assert_eq!(resumed.network, whole.network, "{optimizer:?} after epoch {}", index + 1);
            assert_eq!(resumed.best_epoch, whole.best_epoch);
            let losses = |outcome: &Outcome| -> Vec<(usize, f64, f64, bool)> {
                let row = |record: &EpochRecord| (record.epoch, record.train_loss, record.validation_loss, record.best);
                outcome.history.iter().map(row).collect()
            };
            assert_eq!(losses(&resumed), losses(&whole));
            assert_eq!(again.0.len(), 4 - index);
        }
    }
}

#[test]
fn checkpoints_of_other_trainings_and_damaged_ones_are_refused() {
    let (training, validation) = (smooth(0, 300), smooth(5_000, 100));
    let mut keeper = Keeper::default();
    train(network(&[9]), &training, &validation, &options(1, 100), 1, &mut keeper).unwrap();
    let checkpoint = &keeper.0[0];
    let refuse = |checkpoint: &[u8], hidden: &[usize], options: &TrainingOptions, seed| {
        let error = resume(checkpoint, network(hidden), &training, &validation, options, seed, &mut ()).unwrap_err();
        assert!(matches!(error, TrainingError::Checkpoint { .. }), "{error}");
    };
    refuse(checkpoint, &[8], &options(1, 100), 1);
    refuse(checkpoint, &[9], &options(2, 100), 1);
    refuse(checkpoint, &[9], &options(1, 100), 2);
    refuse(&checkpoint[..checkpoint.len() - 1], &[9], &options(1, 100), 1);
    refuse(&[], &[9], &options(1, 100), 1);
    let soap = TrainingOptions { optimizer: Optimizer::Soap, ..options(1, 100) };
    refuse(checkpoint, &[9], &soap, 1);
}

#[test]
fn no_byte_of_a_checkpoint_can_change() {
    let (training, validation) = (smooth(0, 30), smooth(5_000, 10));
    let mut keeper = Keeper::default();
    train(network(&[2]), &training, &validation, &options(1, 30), 1, &mut keeper).unwrap();
    let resume = |checkpoint: &[u8]| {
        let options = options(1, 30);
        resume(checkpoint, network(&[2]), &training, &validation, &options, 1, &mut ())
            .map_err(|error| error.to_string())
    };
    let mut checkpoint = keeper.0.remove(0);
    assert!(resume(&checkpoint).is_ok());
    for place in 0..checkpoint.len() {
        for bit in [0, 6] {
            checkpoint[place] ^= 1 << bit;
            let refused = resume(&checkpoint).map(|_| place).unwrap_err();
            assert!(refused.contains("the checkpoint cannot be used"), "{refused}");
            checkpoint[place] ^= 1 << bit;
        }
    }
}

#[test]
fn the_same_bytes_on_any_number_of_threads_with_everything_switched_on() {
    let (training, validation) = (smooth(0, 1_001), smooth(5_000, 200));
    let options = TrainingOptions {
        optimizer: Optimizer::Soap,
        refresh: 2,
        dropout: 0.2,
        batch_norm: true,
        clip_norm: 0.1,
        l1: 1e-5,
        l2: 1e-5,
        weight_decay: 1e-3,
        ..options(2, 400)
    };
    let run = |threads| {
        with_threads(threads, || train(network(&[40, 16]), &training, &validation, &options, 9, &mut ())).unwrap()
    };
    let one = run(1);
    assert_eq!(one.reason, StopReason::Finished);
    for threads in [2, 3] {
        assert_eq!(one.network, run(threads).network, "{threads} threads");
    }
}

#[test]
fn a_training_with_restarts_ends_with_the_cycle_that_is_good_enough_or_gained_little() {
    let (rows, held_out) = (smooth(0, 2000), smooth(2000, 200));
    let outcome = |enough: f64, epochs: usize, held_out: &TrainingRows| {
        let options = TrainingOptions { schedule: Schedule::Restarts, enough: Some(enough), ..options(epochs, 64) };
        train(network(&[32]), &rows, held_out, &options, 1, &mut ()).unwrap()
    };
    // cycles of 1, 2 and 28 epochs: no loss is good enough
    let all = outcome(0.0, 31, &held_out);
    let losses: Vec<f64> = all.history.iter().map(|record| record.validation_loss).collect();
    assert_eq!((all.reason, all.history.len()), (StopReason::Finished, 31), "{losses:?}");
    let rates: Vec<f64> = all.history.iter().map(|record| record.learning_rate).collect();
    assert!([0, 2, 30].iter().all(|&end| rates[end] < 2e-4), "{rates:?}");
    assert!([1, 3, 7].iter().all(|&begin| rates[begin] > 4e-3), "{rates:?}");
    let after_two = outcome(all.history[2].validation_loss, 31, &held_out);
    assert_eq!((after_two.reason, after_two.history.len()), (StopReason::Enough, 3));
    assert_eq!(after_two.history[2].validation_loss, all.history[2].validation_loss);
    // outputs that have nothing to do with the inputs cannot be learned any better by training longer
    let unrelated =
        TrainingRows::new(2, 2, vec![0.5; 200], (0..200).map(|i| (f64::from(i) * 7.3).sin() as f32).collect()).unwrap();
    let hopeless = outcome(0.0, 31, &unrelated);
    assert_eq!((hopeless.reason, hopeless.history.len()), (StopReason::Patience, 7));
}

#[test]
fn a_training_with_restarts_ends_when_it_learns_noise_by_heart() {
    let noisy = |seed: usize, count: usize| {
        let mut random = ChaCha8Rng::seed_from_u64(seed as u64);
        let mut number = || random.random::<f32>() - 0.5;
        let inputs: Vec<f32> = (0..2 * count).map(|_| 4.0 * number()).collect();
        TrainingRows::new(2, 2, inputs, (0..2 * count).map(|_| number()).collect()).unwrap()
    };
    let options = TrainingOptions { schedule: Schedule::Restarts, ..options(3000, 64) };
    let outcome = train(network(&[64]), &noisy(1, 64), &noisy(2, 64), &options, 1, &mut ()).unwrap();
    assert_eq!(outcome.reason, StopReason::Overfitted);
    assert!(outcome.history.len() < 2000 && outcome.best_epoch < 1000, "{} epochs", outcome.history.len());
}
