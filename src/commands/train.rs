//! `metafmu train`: trains the network on the sampled runs and writes the surrogate.

use super::{Outcome, interrupt, job::Job, print, print_json, progress::Progress};
use crate::cli::StudyArgs;
use metafmu::{
    Result,
    dataset::{Dataset, Run},
    files,
    network::Network,
    sampling::{self, Stream},
    scaling, surrogate,
    training::{self, EpochRecord, Observer, Rows, StopReason},
};
use metafmu_runtime::Surrogate;
use serde::{Deserialize, Serialize};
use std::{io::Write, ops::ControlFlow, sync::atomic::Ordering};

/// How the training went.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct TrainingRecord {
    pub train_rows: usize,
    pub validation_runs: usize,
    pub epochs: usize,
    pub best_epoch: usize,
    pub stopped: String,
    pub train_seconds: f64,
}

pub fn run(args: &StudyArgs) -> Result<Outcome> {
    let job = Job::new(args)?;
    let dataset = job.load_train_table()?;
    job.prepare_folder()?;
    let (_, record) = stage(&job, &dataset)?;
    if job.json {
        print_json(&record)?;
    } else {
        print(&format!("{}\n{}\n", job.model().display(), job.history().display()))?;
    }
    Ok(Outcome::Fine)
}

/// Trains, keeps the epoch that is best on held-out runs, writes the surrogate and the history.
pub fn stage(job: &Job, dataset: &Dataset) -> Result<(Surrogate, TrainingRecord)> {
    let (study, options) = (&job.study, &job.study.training);
    let (training_runs, validation_runs) = split(&dataset.runs, options.validation, study.seed);
    let scaling = scaling::fit(dataset, training_runs.iter().copied());
    let (inputs, outputs) = (dataset.parameters.len() + 1, dataset.outputs.len());
    let rows = |runs: &[&Run]| {
        let (x, y) = scaling::standardise(runs.iter().copied(), &scaling);
        Rows::new(inputs, outputs, x, y)
    };
    let (training_rows, validation_rows) = (rows(&training_runs)?, rows(&validation_runs)?);

    let network = Network::new(inputs, outputs, &study.network, study.seed)?;
    let steps = training_rows.len().div_ceil(options.batch) * options.epochs;
    let mut display = Display { progress: Progress::steps(steps), epochs: options.epochs };
    let outcome = training::train(network, &training_rows, &validation_rows, options, study.seed, &mut display)?;
    // a Ctrl-C that ended the training is used up: what follows is quick and uses the best network
    interrupt::flag().store(false, Ordering::Relaxed);

    let record = TrainingRecord {
        train_rows: training_rows.len(),
        validation_runs: validation_runs.len(),
        epochs: outcome.history.len(),
        best_epoch: outcome.best_epoch,
        stopped: describe(outcome.reason).into(),
        train_seconds: outcome.history.last().map_or(0.0, |epoch| epoch.seconds),
    };
    display.progress.finish(&format!(
        "trained on {} rows for {} epochs in {:.1} s ({}); epoch {} is the best on {} held-out runs",
        record.train_rows,
        record.epochs,
        record.train_seconds,
        record.stopped,
        record.best_epoch,
        record.validation_runs
    ));
    let surrogate = surrogate::assemble(study, dataset, training_rows.len(), scaling, outcome.network.to_layers())?;
    surrogate::save(&surrogate, &job.model())?;
    write_history(job, &outcome.history)?;
    files::write_json(&job.training_record(), &record)?;
    Ok((surrogate, record))
}

/// Training and validation runs: whole runs, chosen at random; at least one of each.
fn split(runs: &[Run], share: f64, seed: u64) -> (Vec<&Run>, Vec<&Run>) {
    let order = sampling::permutation(runs.len(), sampling::random(seed, Stream::Validation));
    let count = ((share * runs.len() as f64).round() as usize).clamp(1, runs.len().saturating_sub(1).max(1));
    let mut held_out = vec![false; runs.len()];
    order.iter().take(count).for_each(|&run| held_out[run] = true);
    let choose = |wanted: bool| {
        let pairs = runs.iter().zip(&held_out);
        pairs.filter(|&(_, &held)| held == wanted).map(|(run, _)| run).collect()
    };
    (choose(false), choose(true))
}

fn write_history(job: &Job, history: &[EpochRecord]) -> Result<()> {
    files::write_with(&job.history(), |file| {
        writeln!(file, "epoch,train_loss,validation_loss,learning_rate,seconds")?;
        for EpochRecord { epoch, train_loss, validation_loss, learning_rate, seconds, .. } in history {
            writeln!(file, "{epoch},{train_loss:e},{validation_loss:e},{learning_rate:e},{seconds:.3}")?;
        }
        Ok(())
    })
}

fn describe(reason: StopReason) -> &'static str {
    match reason {
        StopReason::Finished => "all epochs done",
        StopReason::Patience => "no more improvement",
        StopReason::Interrupted => "stopped by Ctrl-C",
        StopReason::Diverged => "the loss became infinite: lower the learning rate",
    }
}

/// Shows the training and passes Ctrl-C on to it.
struct Display {
    progress: Progress,
    epochs: usize,
}

impl Observer for Display {
    fn step(&mut self, progress: &training::Progress) -> ControlFlow<()> {
        let training::Progress { epoch, epochs, step, steps, loss } = *progress;
        let position = (epoch - 1) * steps + step;
        self.progress.set(position as u64, || format!("epoch {epoch}/{epochs}, loss {loss:.2e}"));
        if interrupt::flag().load(Ordering::Relaxed) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    fn epoch(&mut self, record: &EpochRecord) {
        let EpochRecord { epoch, train_loss, validation_loss, seconds, .. } = *record;
        let every = self.epochs.div_ceil(10);
        if epoch % every == 0 || epoch == self.epochs {
            let remaining = seconds / epoch as f64 * (self.epochs - epoch) as f64;
            self.progress.note(&format!(
                "epoch {epoch}/{}: loss {train_loss:.2e}, on held-out runs {validation_loss:.2e}, {remaining:.0} s left",
                self.epochs
            ));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_split_is_by_run_complete_and_repeats_for_a_seed_only() {
        let run = |p: f64| Run { parameters: vec![p], times: [0.0].into(), outputs: vec![p] };
        let runs: Vec<Run> = (0..100).map(|i| run(f64::from(i))).collect();
        let (training, validation) = split(&runs, 0.1, 1);
        assert_eq!((training.len(), validation.len()), (90, 10));
        assert!(validation.iter().all(|held| training.iter().all(|run| run.parameters != held.parameters)));
        assert_eq!(split(&runs, 0.1, 1), (training, validation.clone()));
        assert_ne!(split(&runs, 0.1, 2).1, validation);
        assert_eq!(split(&runs[..2], 0.001, 1).1.len(), 1);
    }
}
