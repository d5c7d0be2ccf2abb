//! Networks that predict the next sample from a window of past inputs, or from past outputs and inputs beside a linear
//! part.

use super::{DiscreteSamples, LearnedDiscrete, Regressors, linear::LinearPart};
use crate::{
    Error, Result,
    kinds::follower::{Follower, at_least_one_epoch, unless_interrupted},
    network::Network,
    project::{Event, Project},
    study::TrainingOptions,
    training::{self, Recurrence, StopReason, TrainingRows, without_constants},
};
use metafmu_runtime::Rows;
use std::sync::atomic::Ordering;

/// Share of the budget for each training of a network.
const TRAINING_BUDGET: f64 = 1.0 / 3.0;
/// Multiplications of trainings in a second of two cores.
const RATE: f64 = 2.5e10;
/// A single past sample is tried if the residual of its linear part is at most this factor times that of all past
/// samples.
const NEAR: f64 = 10.0;
/// Stretches of a batch at least.
const LEAST_BATCH: usize = 32;
/// Minimum number of stretches that overlap at a sample; more unless that makes more stretches than the number below.
const OVERLAP: usize = 4;
const STRETCHES: usize = 2000;
/// First stretches are as much shorter.
const SHORTER: usize = 8;

/// The next outputs from a window of past inputs.
pub(super) fn window(project: &Project, samples: &DiscreteSamples) -> Result<LearnedDiscrete> {
    let study = &project.study;
    let part = LinearPart::of(samples, study, [0, samples.past(study.discrete.window)])?;
    let unseen = samples.regressors(&samples.validation, part.history);
    let [training, validation] = [&part.seen, &unseen].map(|rows| plain(&part, rows));
    let network = beside(project, samples, &part)?;
    let outcome = follow(project, network, &training?, &validation?, (&study.training, TRAINING_BUDGET))?;
    Ok(LearnedDiscrete {
        history: outcome.history,
        best_epoch: outcome.best_epoch,
        stopped: outcome.reason,
        ..LearnedDiscrete::solved(part.graph(samples, Some(outcome.network.to_layers())), part.history)
    })
}

/// The next outputs from past outputs and inputs, trained on stretches of predictions, first on short ones. A network
/// of one past sample is simpler if the outputs of a sample determine the whole state. The one with the smaller error
/// after short stretches is trained on long ones.
pub(super) fn feedback(project: &Project, samples: &DiscreteSamples) -> Result<LearnedDiscrete> {
    let mut best: Option<Feedback> = None;
    let networks = networks(project, samples)?;
    let share = TRAINING_BUDGET / networks.len() as f64;
    for mut one in networks {
        let trained = one.train(one.longest.div_ceil(SHORTER), share);
        if unless_interrupted(project, trained, best.is_some())?.is_none() {
            best = best.map(Feedback::interrupted);
            break;
        }
        let is_interrupted = one.learned.stopped == StopReason::Interrupted;
        best = best.filter(|best| best.loss <= one.loss).or(Some(one));
        if is_interrupted {
            best = best.map(Feedback::interrupted);
            break;
        }
    }
    let Some(mut best) = best else { return Err(Error::Interrupted) };
    if best.learned.stopped != StopReason::Interrupted && best.longest > 1 {
        let trained = best.train(best.longest, TRAINING_BUDGET);
        if unless_interrupted(project, trained, true)?.is_none() {
            best = best.interrupted();
        }
    }
    Ok(best.learned)
}

/// Networks of `discrete.history` past samples and, unless the residual of its linear part is much larger, of a single
/// one.
fn networks<'a>(project: &'a Project<'a>, samples: &'a DiscreteSamples<'a>) -> Result<Vec<Feedback<'a>>> {
    let history = samples.past(project.study.discrete.history);
    let first = Feedback::new(project, samples, history)?;
    if history == 1 {
        return Ok(vec![first]);
    }
    let simple = Feedback::new(project, samples, 1)?;
    let gains = simple.part.gains.iter().zip(&first.part.gains);
    let is_near = gains.map(|(simple, of_all)| simple / of_all).fold(0.0, f64::max) <= NEAR;
    Ok(if is_near { vec![first, simple] } else { vec![first] })
}

/// A network with feedback, and the state of its training.
struct Feedback<'a> {
    project: &'a Project<'a>,
    samples: &'a DiscreteSamples<'a>,
    part: LinearPart,
    unseen: Regressors,
    /// Samples of a stretch at most.
    longest: usize,
    network: Network,
    learned: LearnedDiscrete,
    /// Error of the simulations of the held-out runs.
    loss: f64,
}

impl<'a> Feedback<'a> {
    /// Not trained yet.
    fn new(project: &'a Project<'a>, samples: &'a DiscreteSamples, history: usize) -> Result<Self> {
        let study = &project.study;
        let part = LinearPart::of(samples, study, [history; 2])?;
        Ok(Self {
            project,
            samples,
            unseen: samples.regressors(&samples.validation, part.history),
            longest: study.discrete.stretch.min(part.seen.shortest()),
            network: beside(project, samples, &part)?,
            learned: LearnedDiscrete::solved(part.graph(samples, None), part.history),
            part,
            loss: f64::INFINITY,
        })
    }

    /// Trains it on stretches of a length, with a share of the budget.
    fn train(&mut self, stretch: usize, share: f64) -> Result<()> {
        let options = &self.project.study.training;
        let most = (self.samples.rows() / STRETCHES).max(1);
        let training = recurrent(&self.part, &self.part.seen, (stretch, stretch.div_ceil(OVERLAP).min(most)))?;
        let length = self.unseen.shortest();
        let validation = recurrent(&self.part, &self.unseen, (length, length))?;
        let options = TrainingOptions { batch: (options.batch / stretch).max(LEAST_BATCH), ..options.clone() };
        let outcome = follow(self.project, self.network.clone(), &training, &validation, (&options, share))?;
        let of_best = outcome.best_epoch.checked_sub(1).and_then(|epoch| outcome.history.get(epoch));
        self.loss = of_best.map_or(f64::INFINITY, |epoch| epoch.validation_loss);
        let graph = self.part.graph(self.samples, Some(outcome.network.to_layers()));
        self.learned = LearnedDiscrete {
            best_epoch: self.learned.history.len() + outcome.best_epoch,
            history: training::joined([self.learned.history.as_slice(), &outcome.history]),
            stopped: outcome.reason,
            ..LearnedDiscrete::solved(graph, self.part.history)
        };
        self.network = outcome.network;
        Ok(())
    }

    /// The model as it is, because Ctrl-C ended the next stage.
    fn interrupted(mut self) -> Self {
        self.learned.stopped = StopReason::Interrupted;
        self
    }
}

/// A network with random weights beside a linear part.
fn beside(project: &Project, samples: &DiscreteSamples, part: &LinearPart) -> Result<Network> {
    let study = &project.study;
    Ok(Network::new(part.linear.nrows() - 1, samples.counts[2], &study.network, study.seed)?)
}

/// Rows of the residuals of the linear part.
fn plain(part: &LinearPart, regressors: &Regressors) -> Result<TrainingRows> {
    let [inputs, rest] = [&regressors.inputs, &part.rest(regressors)].map(single);
    Ok(TrainingRows::new(part.linear.nrows() - 1, part.linear.ncols(), inputs, rest)?)
}

fn single(rows: &Rows) -> Vec<f32> {
    rows.values().iter().map(|value| *value as f32).collect()
}

/// Rows of stretches of the length `stretch`, which begin `apart` samples after each other.
fn recurrent(
    LinearPart { history, linear, gains, .. }: &LinearPart,
    regressors: &Regressors,
    (stretch, apart): (usize, usize),
) -> Result<TrainingRows> {
    let rows =
        TrainingRows::new(linear.nrows() - 1, linear.ncols(), single(&regressors.inputs), single(&regressors.outputs))?;
    let mut starts = Vec::new();
    let mut first = 0;
    for length in &regressors.lengths {
        starts.extend((0..=length.saturating_sub(stretch)).step_by(apart).map(|begin| (first + begin) as u32));
        first += length;
    }
    Ok(rows.with_recurrence(Recurrence {
        history: history[0],
        // columns of a matrix of nalgebra lie one after the other
        linear: linear.iter().map(|weight| *weight as f32).collect(),
        gains: gains.iter().map(|gain| *gain as f32).collect(),
        starts,
        stretch,
    }))
}

/// Epochs that a training may have with a share of the budget: each predicts all rows and passes their gradients back, or predicts those that are held out.
fn affordable(project: &Project, network: &Network, [training, validation]: [&TrainingRows; 2], share: f64) -> usize {
    let rows =
        |of: &TrainingRows| of.recurrence().map_or(of.len(), |stretches| stretches.starts.len() * stretches.stretch);
    let passes = (3 * rows(training) + rows(validation)) as f64;
    let of_epoch = passes * network.parameters().len() as f64;
    let epochs = project.study.discrete.seconds(share) * RATE / of_epoch.max(1.0);
    (epochs as usize).max(1)
}

fn follow(
    project: &Project,
    network: Network,
    training: &TrainingRows,
    validation: &TrainingRows,
    (options, share): (&TrainingOptions, f64),
) -> Result<training::Outcome> {
    let epochs = options.epochs.min(affordable(project, &network, [training, validation], share));
    if epochs < options.epochs {
        project.event(Event::Note(format_args!(
            "{epochs} of {} epochs are within the budget (discrete.budget)",
            options.epochs
        )));
    }
    let options = &TrainingOptions { epochs, ..options.clone() };
    let mut follower = Follower::with(project, options, training.len()).without_checkpoints();
    let outcome = training::train(network, training, validation, options, project.study.seed, &mut follower)?;
    let outcome = at_least_one_epoch(project, outcome)?;
    let (done, epochs) = (outcome.history.len(), options.epochs);
    if done < epochs && outcome.reason != StopReason::Interrupted {
        project
            .event(Event::Note(format_args!("the training ended after {done} of {epochs} epochs: {}", outcome.reason)));
    }
    // a Ctrl-C that ended the training is used up: what follows is quick and uses the best network
    project.control().stop.store(false, Ordering::Relaxed);
    let network = without_constants(&outcome.network, training);
    Ok(training::Outcome { network, ..outcome })
}
