//! A network with the time as an input.

use super::per_instant;
use crate::{
    Result,
    dataset::Dataset,
    diagnostics::numbers::counted,
    kinds::{
        follower::{Follower, at_least_one_epoch, load_checkpoint, unusable_checkpoint},
        learning::{Beginning, LearningMethod, Trained},
        prepare::{PreparedTraining, prepare},
        record::TrainingRecord,
    },
    project::Project,
    surrogate, training,
};
use metafmu_runtime::{Graph, ScaledNetwork};
use std::sync::atomic::Ordering;

/// A network with the time as an input.
pub(super) struct SingleNetwork;

impl LearningMethod for SingleNetwork {
    fn learn(&self, project: &Project, dataset: &Dataset, begin: &Beginning) -> Result<Trained> {
        train(project, dataset, begin)
    }
}

/// Trains a single network with the time as an input.
fn train(project: &Project, dataset: &Dataset, Beginning { added, start, resume }: &Beginning) -> Result<Trained> {
    let (study, options) = (&project.study, &project.study.training);
    project.say(format_args!("preparing {} rows for the training", dataset.row_count()));
    let PreparedTraining { scaling, network, training: training_rows, validation: validation_rows, validation_runs } =
        prepare(study, dataset, *added, *start)?;
    let mut follower = Follower::new(project, training_rows.len());
    let outcome = match load_checkpoint(project, *resume)? {
        None => {
            // of any earlier training: this one starts from scratch
            project.remove_checkpoints()?;
            training::train(network, &training_rows, &validation_rows, options, study.seed, &mut follower)?
        }
        Some(bytes) => {
            training::resume(&bytes, network, &training_rows, &validation_rows, options, study.seed, &mut follower)
                .map_err(|error| unusable_checkpoint(project.checkpoint(), error))?
        }
    };
    let outcome = at_least_one_epoch(project, outcome)?;
    // a Ctrl-C that ended the training is used up: what follows is quick and uses the best network
    project.control().stop.store(false, Ordering::Relaxed);

    let record = TrainingRecord {
        train_rows: training_rows.len(),
        validation_runs,
        epochs: outcome.history.len(),
        best_epoch: outcome.best_epoch,
        stopped: outcome.reason,
        train_seconds: outcome.history.last().map_or(0.0, |epoch| epoch.seconds),
        processor_seconds: Some(outcome.processor_seconds),
        added_runs: *added,
        target_met: None,
        method: None,
    };
    project.finish(format_args!(
        "trained on {} for {} of {} in {:.1} s ({}); epoch {} is the best on {}",
        counted(record.train_rows, "row"),
        record.epochs,
        counted(options.epochs, "epoch"),
        record.train_seconds,
        record.stopped,
        record.best_epoch,
        counted(record.validation_runs, "held-out run")
    ));
    let network = per_instant::without_constants(&outcome.network, &training_rows);
    let graph = Graph::from(&ScaledNetwork { scaling, layers: network.to_layers() });
    let surrogate = surrogate::assemble(study, dataset, record.train_rows, graph)?;
    Ok(Trained { surrogate, history: outcome.history, record })
}
