//! A network for each instant, trained side by side: `network.structure = "fixed"`.

pub(super) use crate::training::without_constants;
use crate::{
    Error, Result,
    dataset::Dataset,
    diagnostics::numbers::counted,
    files,
    kinds::{
        learning::{Beginning, LearningMethod, Trained},
        prepare::{PreparedTraining, prepare_instants},
        record::TrainingRecord,
    },
    parallel::side_by_side,
    processor_time::{ProcessorClock, ProcessorTimer},
    project::{CountedWork, Event, Project},
    source::Journal,
    study::Study,
    surrogate,
    training::{self, EpochRecord, Observer, Outcome, StopReason},
};
use metafmu_runtime::{Graph, ScaledNetwork};
use std::{
    ops::ControlFlow,
    sync::atomic::{AtomicUsize, Ordering},
    time::{Duration, Instant},
};

/// A network for each time point.
pub(super) struct NetworkPerInstant;

impl LearningMethod for NetworkPerInstant {
    fn learn(&self, project: &Project, dataset: &Dataset, begin: &Beginning) -> Result<Trained> {
        train(project, dataset, begin.resume)
    }
}

/// Trains the networks; with `resume` those that an earlier training has finished are taken as they are.
fn train(project: &Project, dataset: &Dataset, resume: bool) -> Result<Trained> {
    let (instants, prepared) = prepare_instants(&project.study, dataset)?;
    if !resume {
        // of any earlier training: this one starts from scratch
        files::remove(&project.checkpoint())?;
        files::remove(&project.unfinished_networks())?;
    }
    let kept = Finished::open(project, &prepared)?;
    if resume {
        project.say(format_args!("{} of {} networks are already finished", kept.journal.len(), prepared.len()));
    }
    let (began, timer) = (Instant::now(), ProcessorTimer::start(ProcessorClock::Process));
    let (total, finished) = (prepared.len(), AtomicUsize::new(0));
    project.begin(CountedWork::Networks, total);
    let outcomes = train_all(project, &project.study, &prepared, project.study.training.epochs, |instant, train| {
        let outcome = kept.get(instant).map_or_else(train, Ok)?;
        if outcome.reason == StopReason::Interrupted {
            return Err(Error::Interrupted);
        }
        // a full disk must not cost the training
        if let Err(error) = kept.keep(instant, &outcome) {
            project.warn(format_args!("no checkpoint: {error}"));
        }
        tell(project, &outcome, finished.fetch_add(1, Ordering::Relaxed) + 1, total, began);
        Ok(outcome)
    });
    let outcomes = outcomes.inspect_err(|_| {
        project.finish(format_args!(
            "networks that are finished are kept in {}: continue with --resume",
            project.unfinished_networks().display()
        ));
    })?;
    let record = TrainingRecord {
        train_rows: prepared.iter().map(|prepared| prepared.training.len()).sum(),
        validation_runs: prepared.first().map_or(0, |prepared| prepared.validation_runs),
        epochs: epochs(&outcomes),
        best_epoch: best_epoch(&outcomes),
        stopped: reason(&outcomes),
        train_seconds: began.elapsed().as_secs_f64(),
        processor_seconds: Some(timer.seconds()),
        added_runs: 0,
        target_met: None,
        method: None,
    };
    project.finish(format_args!(
        "trained {} on {} in {:.1} s ({}); epoch {} is the median of the best on {}",
        counted(outcomes.len(), "network"),
        counted(record.train_rows, "row"),
        record.train_seconds,
        record.stopped,
        record.best_epoch,
        counted(record.validation_runs, "held-out run")
    ));
    let history = mean_history(&outcomes);
    let scaled = |(prepared, outcome): (PreparedTraining, Outcome)| ScaledNetwork {
        scaling: prepared.scaling,
        layers: outcome.network.to_layers(),
    };
    let networks: Vec<ScaledNetwork> = prepared.into_iter().zip(outcomes).map(scaled).collect();
    // the time is the last column
    let others = networks[0].scaling.input_mean.len();
    let graph = Graph::of_instants(others + 1, others, instants.to_vec(), &networks);
    let surrogate = surrogate::assemble(&project.study, dataset, record.train_rows, graph)?;
    Ok(Trained { surrogate, history, record })
}

/// Reports the number of finished networks; this one is the last.
fn tell(project: &Project, outcome: &Outcome, done: usize, total: usize, began: Instant) {
    let loss = outcome.history.iter().map(|epoch| epoch.validation_loss).fold(f64::INFINITY, f64::min);
    let about = format_args!("the last one's loss on held-out runs {loss:.2e}");
    project.event(Event::Progress { done, about });
    if done.is_multiple_of(total.div_ceil(10).max(1)) || done == total {
        let left = began.elapsed().as_secs_f64() / done as f64 * (total - done) as f64;
        project.note(format_args!("network {done}/{total}: loss on held-out runs {loss:.2e}, {left:.0} s left"));
    }
}

/// Trains all networks up to epoch `goal`, in parallel. Each uses one thread, so that the number of threads does not
/// change the results. `each` is called for every instant with the function that trains its network.
pub fn train_all(
    project: &Project,
    study: &Study,
    prepared: &[PreparedTraining],
    goal: usize,
    each: impl Fn(usize, &dyn Fn() -> Result<Outcome>) -> Result<Outcome> + Sync,
) -> Result<Vec<Outcome>> {
    let numbers: Vec<usize> = (0..prepared.len()).collect();
    let mut outcomes = side_by_side(&numbers, |instant| {
        // those that have not begun yet
        if project.is_stopped() {
            return Err(Error::Interrupted);
        }
        each(instant, &|| train_one(project, study, &prepared[instant], goal))
    });
    outcomes.sort_by_key(|(instant, _)| *instant);
    outcomes.into_iter().map(|(_, outcome)| outcome).collect()
}

fn train_one(project: &Project, study: &Study, prepared: &PreparedTraining, goal: usize) -> Result<Outcome> {
    let PreparedTraining { network, training, validation, .. } = prepared;
    let mut follower = TimePointFollower { project, goal, epochs: 0 };
    let outcome = training::train(network.clone(), training, validation, &study.training, study.seed, &mut follower)?;
    if outcome.reason == StopReason::Interrupted && outcome.history.len() < goal {
        return Err(Error::Interrupted);
    }
    Ok(Outcome { network: without_constants(&outcome.network, training), ..outcome })
}

/// Ends a training at its goal, or at Ctrl-C.
struct TimePointFollower<'a> {
    project: &'a Project<'a>,
    goal: usize,
    /// Epochs that are done.
    epochs: usize,
}

impl Observer for TimePointFollower<'_> {
    fn step(&mut self, _: &training::Progress) -> ControlFlow<()> {
        let stop = self.epochs >= self.goal || self.project.is_stopped();
        if stop { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    fn epoch(&mut self, record: &EpochRecord) {
        self.epochs = record.epoch;
    }
}

/// Epochs of the network that has most.
pub fn epochs(outcomes: &[Outcome]) -> usize {
    outcomes.iter().map(|outcome| outcome.history.len()).max().unwrap_or(0)
}

/// The median of the networks' best epochs.
pub fn best_epoch(outcomes: &[Outcome]) -> usize {
    let mut epochs: Vec<usize> = outcomes.iter().map(|outcome| outcome.best_epoch).collect();
    epochs.sort_unstable();
    epochs.get(epochs.len() / 2).copied().unwrap_or(0)
}

/// The worst of the reasons why the trainings ended.
pub fn reason(outcomes: &[Outcome]) -> StopReason {
    let any = |reason| outcomes.iter().any(|outcome| outcome.reason == reason);
    let worst_first = [
        StopReason::Diverged,
        StopReason::Interrupted,
        StopReason::Overfitted,
        StopReason::Finished,
        StopReason::TooFewLeft,
    ];
    worst_first.into_iter().find(|&reason| any(reason)).unwrap_or(StopReason::Patience)
}

/// Means over the networks that reached each epoch, and the seconds of all of them together.
fn mean_history(outcomes: &[Outcome]) -> Vec<EpochRecord> {
    let mut history: Vec<EpochRecord> = Vec::new();
    for index in 0..epochs(outcomes) {
        let records: Vec<&EpochRecord> = outcomes.iter().filter_map(|outcome| outcome.history.get(index)).collect();
        let sum = |value: fn(&EpochRecord) -> f64| records.iter().map(|record| value(record)).sum::<f64>();
        let validation_loss = sum(|record| record.validation_loss) / records.len() as f64;
        history.push(EpochRecord {
            epoch: index + 1,
            train_loss: sum(|record| record.train_loss) / records.len() as f64,
            validation_loss,
            learning_rate: sum(|record| record.learning_rate) / records.len() as f64,
            seconds: sum(|record| record.seconds),
            best: history.iter().all(|earlier| validation_loss < earlier.validation_loss),
        });
    }
    history
}

/// The networks that are finished, in a journal that survives the process.
struct Finished<'a> {
    journal: Journal,
    prepared: &'a [PreparedTraining],
    epochs: usize,
}

impl<'a> Finished<'a> {
    fn open(project: &Project, prepared: &'a [PreparedTraining]) -> Result<Self> {
        let rows = prepared.iter().flat_map(|prepared| [&prepared.training, &prepared.validation]);
        let digests: String = rows.map(|rows| format!(" {:016x}", rows.digest())).collect();
        let epochs = project.study.training.epochs;
        let parameters = prepared.first().map_or(0, |prepared| prepared.network.parameters().len());
        let of = format!("networks of {}{digests}", project.study.digest());
        let journal = Journal::open(&project.unfinished_networks(), &of, 1, 3 + 4 * epochs + parameters)?;
        Ok(Self { journal, prepared, epochs })
    }

    /// Reason, best epoch, processor seconds, four numbers an epoch, parameters; epochs that were not needed are NaN.
    fn keep(&self, instant: usize, outcome: &Outcome) -> Result<()> {
        let Outcome { network, history, best_epoch, processor_seconds, reason } = outcome;
        let reason = REASONS.iter().position(|known| known == reason).unwrap_or(REASONS.len());
        let mut values = vec![reason as f64, *best_epoch as f64, *processor_seconds];
        for EpochRecord { train_loss, validation_loss, learning_rate, seconds, .. } in history {
            values.extend([train_loss, validation_loss, learning_rate, seconds]);
        }
        values.resize(3 + 4 * self.epochs, f64::NAN);
        values.extend(network.parameters().iter().copied().map(f64::from));
        if self.journal.get(&[instant as f64]).is_none() {
            self.journal.keep(&[instant as f64], &values, Duration::MAX)?;
        }
        Ok(())
    }

    fn get(&self, instant: usize) -> Option<Outcome> {
        let values = self.journal.get(&[instant as f64])?;
        let (&[reason, best_epoch, processor_seconds], values) = values.split_first_chunk()?;
        let (epochs, parameters) = values.split_at_checked(4 * self.epochs)?;
        let mut history: Vec<EpochRecord> = Vec::new();
        for (epoch, &[train_loss, validation_loss, learning_rate, seconds]) in (1..).zip(epochs.as_chunks().0) {
            if seconds.is_nan() {
                break;
            }
            let best = history.iter().all(|earlier| validation_loss < earlier.validation_loss);
            history.push(EpochRecord { epoch, train_loss, validation_loss, learning_rate, seconds, best });
        }
        let mut network = self.prepared[instant].network.clone();
        network.parameters_mut().iter_mut().zip(parameters).for_each(|(to, &from)| *to = from as f32);
        let reason = *REASONS.get(reason as usize)?;
        Some(Outcome { network, history, best_epoch: best_epoch as usize, processor_seconds, reason })
    }
}

/// Stop reasons of completed trainings, by their numbers in the journal.
const REASONS: [StopReason; 6] = [
    StopReason::Finished,
    StopReason::Patience,
    StopReason::Diverged,
    StopReason::Enough,
    StopReason::TooFewLeft,
    StopReason::Overfitted,
];
