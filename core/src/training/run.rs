//! The training loop.

use super::{
    EpochRecord, Observer, Outcome, Progress, StopReason, TrainingError, TrainingRows,
    checkpoint::{self, Header, NO_DIGEST},
    schedule::{cycle, relative_rate},
    trainer::{Trainer, sums},
};
use crate::{
    network::Network,
    processor_time::{ProcessorClock, ProcessorTimer},
    study::{Schedule, TrainingOptions},
};
use rand::{SeedableRng, rngs::ChaCha8Rng, seq::SliceRandom};
use std::{ops::Range, time::Instant};

/// Factor by which the validation loss exceeds the best one, and number of epochs in a row and of optimizer steps in them, that show a network
/// to learn its rows by heart.
const OVERFITTED: (f64, usize, usize) = (1.5, 5, 50);
/// Multiple of those epochs of stretches.
const RECURRENT: usize = 8;

/// Trains a network, on as many threads as the current rayon pool has. The outcome does not depend on their number.
///
/// # Errors
/// A [`TrainingError`] if there are no training or no validation rows, they do not fit the network, or an option makes
/// no sense.
pub fn train(
    network: Network,
    training: &TrainingRows,
    validation: &TrainingRows,
    options: &TrainingOptions,
    seed: u64,
    observer: &mut dyn Observer,
) -> Result<Outcome, TrainingError> {
    Ok(TrainingRun::new(network, training, validation, options, seed)?.run(observer))
}

/// Resumes a training from the checkpoint that [`Observer::checkpoint`] received; the other arguments must be those of
/// the beginning. Apart from times, the outcome has the same bits as without the interruption.
///
/// # Errors
/// As [`train`], and [`TrainingError::Checkpoint`] if the checkpoint is damaged or that of another training.
pub fn resume(
    checkpoint: &[u8],
    network: Network,
    training: &TrainingRows,
    validation: &TrainingRows,
    options: &TrainingOptions,
    seed: u64,
    observer: &mut dyn Observer,
) -> Result<Outcome, TrainingError> {
    let mut run = TrainingRun::new(network, training, validation, options, seed)?;
    run.restore(checkpoint)?;
    Ok(run.run(observer))
}

/// A training under way.
struct TrainingRun<'a> {
    trainer: Trainer,
    /// The network with the smallest validation loss so far; at first the given one.
    best: Network,
    best_epoch: usize,
    history: Vec<EpochRecord>,
    training: &'a TrainingRows,
    validation: &'a TrainingRows,
    options: &'a TrainingOptions,
    seed: u64,
    /// The numbers of the training rows, in the order of the epoch.
    order: Vec<u32>,
    /// Steps of an epoch.
    steps: usize,
    /// Cycle of the learning rate, in epochs.
    cycle: Range<usize>,
    validation_sums: Vec<f64>,
    /// Digests of the training and the validation rows.
    digests: [String; 2],
    /// Seconds before this run.
    seconds: f64,
    /// Processor time before this run in seconds.
    processor_seconds: f64,
    processor_timer: ProcessorTimer,
}

/// Losses and learning rate of an epoch for its record.
struct Epoch {
    train_loss: f64,
    validation_loss: f64,
    learning_rate: f64,
}

impl<'a> TrainingRun<'a> {
    fn new(
        network: Network,
        training: &'a TrainingRows,
        validation: &'a TrainingRows,
        options: &'a TrainingOptions,
        seed: u64,
    ) -> Result<Self, TrainingError> {
        check_rows(&network, "training", training)?;
        check_rows(&network, "validation", validation)?;
        let rows = u32::try_from(training.len()).map_err(|_| TrainingError::TooManyRows { rows: training.len() })?;
        let batch = options.batch.min(training.len());
        Ok(Self {
            best: network.clone(),
            best_epoch: 0,
            history: Vec::new(),
            trainer: Trainer::new(network, options, batch, rayon::current_num_threads(), seed)?,
            training,
            validation,
            options,
            seed,
            order: (0..rows).collect(),
            steps: training.len().div_ceil(batch.max(1)),
            cycle: 0..0,
            validation_sums: sums(validation.len()),
            digests: [training, validation].map(|rows| format!("{:016x}", rows.digest())),
            seconds: 0.0,
            processor_seconds: 0.0,
            processor_timer: ProcessorTimer::start(ProcessorClock::Process),
        })
    }

    fn run(mut self, observer: &mut dyn Observer) -> Outcome {
        let started = Instant::now();
        let mut reason = StopReason::Finished;
        if !self.history.is_empty() {
            observer.resumed(&self.history);
        }
        for epoch in self.history.len() + 1..=self.options.epochs {
            if self.options.patience > 0 && epoch > self.best_epoch + self.options.patience {
                reason = StopReason::Patience;
                break;
            }
            let done = self.enter_cycle().and_then(|()| self.epoch(epoch, observer));
            let Epoch { train_loss, validation_loss, learning_rate } = match done {
                Ok(done) => done,
                Err(stop) => {
                    reason = stop;
                    break;
                }
            };
            let best = validation_loss < self.best_loss();
            if best {
                self.best_epoch = epoch;
                self.best = self.trainer.network();
            }
            let seconds = self.seconds + started.elapsed().as_secs_f64();
            let record = EpochRecord { epoch, train_loss, validation_loss, learning_rate, seconds, best };
            self.history.push(record);
            observer.epoch(&record);
            observer.checkpoint(epoch, &mut || self.checkpoint());
        }
        if self.best_epoch == 0 && reason == StopReason::Interrupted {
            self.best = self.trainer.network();
        }
        let processor_seconds = self.processor_seconds();
        Outcome { network: self.best, history: self.history, best_epoch: self.best_epoch, processor_seconds, reason }
    }

    /// Processor time of the training so far in seconds.
    fn processor_seconds(&self) -> f64 {
        self.processor_seconds + self.processor_timer.seconds()
    }

    fn best_loss(&self) -> f64 {
        self.best_epoch.checked_sub(1).map_or(f64::INFINITY, |index| self.history[index].validation_loss)
    }

    /// The cycle of the next epoch, or why there is none.
    fn enter_cycle(&mut self) -> Result<(), StopReason> {
        if self.overfits() {
            return Err(StopReason::Overfitted);
        }
        if !self.cycle.contains(&self.history.len()) {
            let losses: Vec<f64> = self.history.iter().map(|record| record.validation_loss).collect();
            self.cycle = cycle(self.options, &losses, self.steps)?;
        }
        Ok(())
    }

    /// Returns true if the last epochs of a schedule with restarts fit the training rows better than the best epoch
    /// did, and the held-out ones much worse. A high learning rate makes both worse.
    fn overfits(&self) -> bool {
        let (factor, epochs, steps) = OVERFITTED;
        // simulations may be bad for long while the learning rate is high
        let epochs = if self.validation.recurrence().is_some() { RECURRENT * epochs } else { epochs };
        let count = epochs.max(steps.div_ceil(self.steps.max(1)));
        let (Schedule::Restarts, Some(best), Some(first)) =
            (self.options.schedule, self.best_epoch.checked_sub(1), self.history.len().checked_sub(count))
        else {
            return false;
        };
        let best = self.history[best];
        self.history[first..]
            .iter()
            .all(|record| record.train_loss < best.train_loss && record.validation_loss > factor * best.validation_loss)
    }

    /// All training rows once, then the validation.
    fn epoch(&mut self, epoch: usize, observer: &mut dyn Observer) -> Result<Epoch, StopReason> {
        self.shuffle(epoch);
        let (rows, steps, epochs) = (self.order.len(), self.steps, self.options.epochs);
        let (mut sum, mut learning_rate) = (0.0, 0.0);
        for step in 0..steps {
            // batches that differ by one row at most, instead of a last one that is much smaller and noisier
            let (begin, end) = (step * rows / steps, (step + 1) * rows / steps);
            let number = (epoch - 1 - self.cycle.start) * steps + step;
            let relative = relative_rate(self.options, number, self.cycle.len() * steps);
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
        let validation_loss = self.trainer.loss(self.validation, &mut self.validation_sums);
        if !validation_loss.is_finite() {
            return Err(StopReason::Diverged);
        }
        Ok(Epoch { train_loss: sum / rows as f64, validation_loss, learning_rate })
    }

    /// The order of an epoch follows from the seed and the epoch alone, so that a checkpoint need not hold it.
    fn shuffle(&mut self, epoch: usize) {
        let mut random = ChaCha8Rng::seed_from_u64(self.seed);
        // stream 0 gave the network's weights
        random.set_stream(epoch as u64);
        for (order, number) in self.order.iter_mut().zip(0..) {
            *order = number;
        }
        self.order.shuffle(&mut random);
    }

    fn header(&self) -> Header {
        Header {
            format: checkpoint::FORMAT,
            options: self.options.clone(),
            seed: self.seed,
            sizes: self.best.sizes().to_vec(),
            activation: self.best.activation(),
            rows: [self.training.len(), self.validation.len()],
            digests: self.digests.clone(),
            steps: self.trainer.steps(),
            best_epoch: self.best_epoch,
            processor_seconds: self.processor_seconds(),
            digest: NO_DIGEST.into(),
        }
    }

    fn checkpoint(&mut self) -> Result<Vec<u8>, TrainingError> {
        let header = self.header();
        checkpoint::write(&header, &self.trainer.state(), self.best.parameters(), &self.history)
    }

    fn restore(&mut self, bytes: &[u8]) -> Result<(), TrainingError> {
        let expected = self.header();
        let (best, mut state) = (self.best.parameters_mut(), self.trainer.state());
        let (found, history) = checkpoint::read(bytes, &mut state, best)?;
        // these fields of the header may differ, no others
        let (steps, best_epoch, processor_seconds) = (found.steps, found.best_epoch, found.processor_seconds);
        let digest = found.digest.clone();
        if found != (Header { steps, best_epoch, processor_seconds, digest, ..expected }) || best_epoch > history.len()
        {
            return Err(TrainingError::Checkpoint { problem: "it belongs to another training".into() });
        }
        self.trainer.restored(steps);
        self.best_epoch = best_epoch;
        self.seconds = history.last().map_or(0.0, |record| record.seconds);
        self.processor_seconds = processor_seconds;
        self.history = history;
        Ok(())
    }
}

fn check_rows(network: &Network, set: &'static str, rows: &TrainingRows) -> Result<(), TrainingError> {
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
mod tests;
