//! Learns models that go on from sample to sample, of recorded runs or those of an FMU.

mod cross_validation;
mod dead_time;
mod polynomial;
mod state_space;
mod support;

use super::{Beginning, Method, learned::unless_interrupted, per_instant::without_constants};
use crate::{
    Result,
    dataset::{Dataset, Run},
    evaluation::{Accuracy, OutputMetrics},
    network::Network,
    pipeline::{
        follower::{Follower, Trained, at_least_one_epoch},
        observer::Event,
        prepare::{self, held_out},
        project::Project,
        record::{Candidate, DiscreteRecord, MethodRecord, TrainingRecord},
    },
    scaling,
    source::Source,
    study::{DiscreteModel, Study, TrainingOptions},
    surrogate,
    training::{self, EpochRecord, Recurrence, StopReason, TrainingRows},
};
use cross_validation::cross_validation;
use dead_time::DeadTimes;
use metafmu_runtime::{Clock, Graph, Layer, Program, Sampling, ScaledNetwork, Scaling, Support, Surrogate};
use nalgebra::DMatrix;
use std::{sync::atomic::Ordering, time::Instant};

/// Share of the sum of squares that keeps the coefficients of columns apart that are nearly the same, as those of fast sampling are.
const RIDGE: f64 = 1e-10;
/// Share of the budget for each training of a network.
const TRAINING_BUDGET: f64 = 1.0 / 3.0;
/// Smallest weight of a network beside what is linear.
const LEAST_GAIN: f64 = 1e-6;
/// Stretches of a batch at least.
const LEAST_BATCH: usize = 32;
/// Stretches that overlap at a sample, at the least; more if that does not make more stretches than the number below.
const OVERLAP: usize = 4;
const STRETCHES: usize = 2000;
/// Error on held-out runs that is too small to be luck.
const SURE: f64 = 1e-3;
/// First stretches are as much shorter.
const SHORTER: usize = 8;

/// Models that give the next sample.
pub(super) struct DiscreteTime;

impl Method for DiscreteTime {
    fn learn(&self, project: &Project, dataset: &Dataset, _: &Beginning) -> Result<Trained> {
        train(project, dataset)
    }
}

/// Learns the candidates, keeps the one whose simulations of the held-out runs are best.
fn train(project: &Project, dataset: &Dataset) -> Result<Trained> {
    let study = &project.study;
    let began = Instant::now();
    let drives = project.source.drives();
    let dead_times = DeadTimes::of(study.time.step, dataset);
    if let Some(found) = dead_times.describe(dataset) {
        project.event(Event::Note(format_args!("dead time: {found}")));
    }
    let late = dead_times.shifted(dataset);
    let samples = DiscreteSamples::new(study.time.step, &late, prepare::split(&late.runs, &study.training, study.seed));
    let validation = held_out(study, dataset);
    let with_support = |one: &LearnedDiscrete, support: Option<Support>| {
        let history = [one.past[0], one.past[1] + dead_times.longest()];
        let numbers = one.past[0] * (dataset.outputs.len() + one.hidden.len());
        let graph = dead_times.delayed(&one.graph, numbers, one.past[1]);
        let sampling = Sampling { hidden: one.hidden.clone(), history, step: samples.step, support };
        let program = Program { graph, clock: Clock::Sampled(Box::new(sampling)) };
        surrogate::assemble_discrete(study, (dataset, samples.rows()), &drives, program)
    };
    let assembled = |one: &LearnedDiscrete| with_support(one, None);
    let mut learned: Vec<LearnedKind> = Vec::new();
    let mut is_stopped = false;
    for kind in DiscreteModel::ALL {
        if study.discrete.model.is_some_and(|wanted| wanted != kind) {
            continue;
        }
        let start = Instant::now();
        let has_earlier = learned.iter().any(|other| !other.model.history.is_empty());
        let Some(found) = unless_interrupted(project, samples.learn(project, kind), has_earlier)? else {
            is_stopped = true;
            break;
        };
        let simulated = |one: LearnedDiscrete| {
            let surrogate = assembled(&one)?;
            Ok((error(&Accuracy::of(&surrogate, &validation)), surrogate, one))
        };
        let found = found.into_iter().map(simulated).collect::<Result<Vec<_>>>()?;
        let best = found.into_iter().min_by(|(a, ..), (b, ..)| a.total_cmp(b));
        let Some((error, surrogate, model)) = best else { continue };
        let candidate = Candidate { name: kind.name().into(), error, seconds: start.elapsed().as_secs_f64() };
        let was_interrupted = model.stopped == StopReason::Interrupted;
        learned.push(LearnedKind { kind, candidate, surrogate, model });
        if was_interrupted {
            break;
        }
    }
    if learned.is_empty() {
        return Err(study.refusal("discrete.model", "the samples determine no polynomial: more runs, or another model"));
    }
    learned.sort_by(|a, b| a.candidate.error.total_cmp(&b.candidate.error));
    let candidates = learned.iter().map(|one| one.candidate.clone()).collect();
    let mut was_interrupted = is_stopped || learned.iter().any(|one| one.model.stopped == StopReason::Interrupted);
    let mut best = 0;
    // runs that ended the training of a network, or chose a polynomial, are no longer unseen
    let states = learned.iter().position(|one| one.model.unseen.is_some());
    let is_compared = dataset.runs.len() >= cross_validation::PARTS && learned[0].candidate.error > SURE;
    let compared = states.filter(|_| is_compared).and_then(|place| Some((place, learned[place].model.unseen?)));
    if let Some((place, mut least)) = compared {
        best = place;
        for (other, one) in learned[..place].iter().enumerate() {
            let Some(found) = cross_validation(project, [dataset, &late], one.kind, &assembled)? else {
                was_interrupted = true;
                break;
            };
            project.event(Event::Note(format_args!(
                "{}: error {found:.2e} in a cross-validation, {}: {least:.2e}",
                one.candidate.name, learned[best].candidate.name
            )));
            if found < least {
                (best, least) = (other, found);
            }
        }
    }
    let LearnedKind { candidate: Candidate { name, .. }, surrogate, model: one, .. } = learned.swap_remove(best);
    let surrogate = one.refitted.as_deref().map_or(Ok(surrogate), assembled)?;
    let exported = one.refitted.as_deref().unwrap_or(&one);
    // an FMU holds its inputs between samples; how those of a table change there is not known
    let inputs = exported.past[1] + dead_times.longest() > 1
        || !exported.hidden.is_empty()
        || matches!(project.source, Source::Recorded(_));
    let ranges = drives.iter().map(|(_, range)| *range);
    let support = support::support(study, dataset, &surrogate, inputs, ranges);
    let surrogate = with_support(exported, Some(support))?;
    let stopped = if was_interrupted { StopReason::Interrupted } else { one.stopped };
    let record = TrainingRecord {
        train_rows: samples.rows(),
        validation_runs: validation.runs.len(),
        epochs: one.history.len(),
        best_epoch: one.best_epoch,
        stopped,
        train_seconds: began.elapsed().as_secs_f64(),
        added_runs: 0,
        target_met: None,
        method: Some(MethodRecord::Discrete(DiscreteRecord {
            candidates,
            exported: name,
            history: [one.past[0], one.past[1] + dead_times.longest()],
        })),
    };
    project.finish(format_args!(
        "learned from {} samples in {:.1} s: {}",
        record.train_rows,
        record.train_seconds,
        record.method.as_ref().map_or(String::new(), MethodRecord::describe)
    ));
    Ok(Trained { surrogate, history: one.history, record })
}

/// Root mean square error in simulations, relative to the standard deviation, of the worst output.
fn error(accuracy: &Accuracy) -> f64 {
    accuracy.outputs.values().map(OutputMetrics::relative_error).fold(0.0, f64::max)
}

/// The best model of a kind.
struct LearnedKind {
    kind: DiscreteModel,
    candidate: Candidate,
    surrogate: Surrogate,
    model: LearnedDiscrete,
}

/// Result of one way to learn a discrete-time model.
struct LearnedDiscrete {
    graph: Graph,
    /// Hidden states at the start.
    hidden: Vec<f64>,
    /// Number of past samples of the outputs and of the inputs that count.
    past: [usize; 2],
    /// Of the network, one training after the other.
    history: Vec<EpochRecord>,
    best_epoch: usize,
    stopped: StopReason,
    /// The same fitted to the runs that are held out as well, if that was done.
    refitted: Option<Box<LearnedDiscrete>>,
    /// Error of simulations of runs that are not seen, if a cross-validation chose it: root mean square of standardized outputs, mean of the parts.
    unseen: Option<f64>,
}

impl LearnedDiscrete {
    /// Without training.
    fn solved(graph: Graph, past: [usize; 2]) -> Self {
        Self {
            graph,
            hidden: Vec::new(),
            past,
            history: Vec::new(),
            best_epoch: 0,
            stopped: StopReason::Solved,
            refitted: None,
            unseen: None,
        }
    }
}

/// Means and standard deviations.
type ColumnMoments = (Vec<f64>, Vec<f64>);

/// Samples of a discrete-time model: the runs and their columns.
struct DiscreteSamples<'a> {
    /// Number of parameters, of inputs and of outputs.
    counts: [usize; 3],
    step: f64,
    training: Vec<&'a Run>,
    validation: Vec<&'a Run>,
    /// Mean and standard deviation of each parameter, input and output.
    scales: [ColumnMoments; 3],
    /// Past samples that every run knows at its first prediction.
    known: usize,
}

/// Regressors of all samples of some runs, standardised: `[samples, columns]`, and the outputs that follow.
struct Regressors {
    inputs: Vec<Vec<f64>>,
    outputs: Vec<Vec<f64>>,
    /// Number of samples of each run.
    lengths: Vec<usize>,
}

/// Linear part of a model, by least squares.
struct LinearPart {
    /// Number of past samples of the outputs and of the inputs that count.
    history: [usize; 2],
    /// Of the training runs.
    seen: Regressors,
    /// Coefficients, and constants below them, shape `[columns + 1, outputs]`.
    linear: DMatrix<f64>,
    /// Standard deviation of each output's rest.
    gains: Vec<f64>,
}

impl<'a> DiscreteSamples<'a> {
    fn new(step: f64, dataset: &Dataset, (training, validation): (Vec<&'a Run>, Vec<&'a Run>)) -> Self {
        let [inputs, outputs] = [dataset.inputs.len(), dataset.outputs.len()];
        // what inputs and outputs were before the start are parameters too
        let counts = [dataset.parameters.len() - inputs - outputs, inputs, outputs];
        let rows = |of: fn(&Run) -> &[f64], count: usize| -> ColumnMoments {
            let rows: Vec<Vec<f64>> =
                training.iter().flat_map(|run| of(run).chunks(count.max(1)).map(<[f64]>::to_vec)).collect();
            scaling::of_columns(&rows)
        };
        let points: Vec<Vec<f64>> = training.iter().map(|run| run.parameters[..counts[0]].to_vec()).collect();
        let scales =
            [scaling::of_columns(&points), rows(|run| &run.inputs, counts[1]), rows(|run| &run.outputs, counts[2])];
        // before a run from rest nothing moved, whatever the number
        let known = |run: &&Run| match run.times.partition_point(|time| *time < 0.0) {
            0 => usize::MAX,
            given => given + 1,
        };
        let known = training.iter().chain(&validation).copied().map(|run| known(&run)).min().unwrap_or(usize::MAX);
        Self { counts, step, training, validation, scales, known }
    }

    /// Number of samples that follow from those before.
    fn rows(&self) -> usize {
        self.training.iter().map(|run| run.times.len() - 1).sum()
    }

    /// Models of a kind, with different numbers of samples or terms.
    fn learn(&self, project: &Project, kind: DiscreteModel) -> Result<Vec<LearnedDiscrete>> {
        let study = &project.study;
        let [history, window] = [study.discrete.history, study.discrete.window].map(|samples| samples.min(self.known));
        match kind {
            DiscreteModel::Polynomial => Ok(polynomial::learn(self, history)),
            DiscreteModel::StateSpace => state_space::learn(project, self),
            DiscreteModel::Linear => {
                let LinearPart { history, linear, .. } = self.linear_part(study, [history; 2])?;
                Ok(vec![LearnedDiscrete::solved(self.graph(history, &linear, None), history)])
            }
            DiscreteModel::Window => {
                let part = self.linear_part(study, [0, window])?;
                let LinearPart { history, seen, linear, gains } = &part;
                let unseen = self.regressors(&self.validation, *history);
                let rest = |regressors: &Regressors| plain(regressors, linear, gains);
                let outcome =
                    follow(project, self.network(study, linear)?, &rest(seen)?, &rest(&unseen)?, &study.training)?;
                let layers = outcome.network.to_layers();
                Ok(vec![LearnedDiscrete {
                    history: outcome.history,
                    best_epoch: outcome.best_epoch,
                    stopped: outcome.reason,
                    ..LearnedDiscrete::solved(self.graph(*history, linear, Some((gains, layers))), *history)
                }])
            }
            DiscreteModel::Feedback => {
                let LinearPart { history, seen, linear, gains } = self.linear_part(study, [history; 2])?;
                let unseen = self.regressors(&self.validation, history);
                let mut network = self.network(study, &linear)?;
                let mut learned = LearnedDiscrete::solved(self.graph(history, &linear, None), history);
                let shortest = |regressors: &Regressors| regressors.lengths.iter().copied().min().unwrap_or(1);
                let longest = study.discrete.stretch.min(shortest(&seen));
                let mut stretches = vec![longest.div_ceil(SHORTER), longest];
                stretches.dedup();
                let most = (self.rows() / STRETCHES).max(1);
                let apart = |stretch: usize| stretch.div_ceil(OVERLAP).min(most);
                for stretch in stretches {
                    let training = recurrent(&seen, &linear, &gains, history[0], (stretch, apart(stretch)))?;
                    let length = shortest(&unseen);
                    let validation = recurrent(&unseen, &linear, &gains, history[0], (length, length))?;
                    let batch = (study.training.batch / stretch).max(LEAST_BATCH);
                    let with = TrainingOptions { batch, ..study.training.clone() };
                    let has_earlier = !learned.history.is_empty();
                    let outcome = follow(project, network, &training, &validation, &with);
                    let Some(outcome) = unless_interrupted(project, outcome, has_earlier)? else {
                        learned.stopped = StopReason::Interrupted;
                        break;
                    };
                    let best = learned.history.len() + outcome.best_epoch;
                    learned = LearnedDiscrete {
                        history: training::joined([learned.history.as_slice(), &outcome.history]),
                        best_epoch: best,
                        stopped: outcome.reason,
                        ..LearnedDiscrete::solved(
                            self.graph(history, &linear, Some((&gains, outcome.network.to_layers()))),
                            history,
                        )
                    };
                    network = outcome.network;
                    if learned.stopped == StopReason::Interrupted {
                        break;
                    }
                }
                Ok(vec![learned])
            }
        }
    }

    /// The linear part of a model with this number of past samples.
    fn linear_part(&self, study: &Study, history: [usize; 2]) -> Result<LinearPart> {
        let seen = self.regressors(&self.training, history);
        let linear = solve(&seen).ok_or_else(|| {
            study.refusal("discrete", "the samples do not determine the linear part: more runs or a shorter history")
        })?;
        let gains = gains(&seen, &linear);
        Ok(LinearPart { history, seen, linear, gains })
    }

    /// A network with random weights beside a linear part.
    fn network(&self, study: &Study, linear: &DMatrix<f64>) -> Result<Network> {
        Ok(Network::new(linear.nrows() - 1, self.counts[2], &study.network, study.seed)?)
    }

    /// Standardised past samples at each sample but the last, and the outputs of the next one.
    fn regressors(&self, runs: &[&Run], history: [usize; 2]) -> Regressors {
        let [parameters, inputs, outputs] = self.counts;
        let [of_parameters, of_inputs, of_outputs] = &self.scales;
        let mut found = Regressors { inputs: Vec::new(), outputs: Vec::new(), lengths: Vec::new() };
        for run in runs {
            let (p, starts) = run.parameters.split_at(parameters);
            let (outputs_before, inputs_before) = starts.split_at(outputs);
            let samples = run.times.len() - 1;
            // before the first row of a run that begins at rest nothing moved; of others nothing is known
            let first = if run.times[0] < 0.0 { history[0].max(history[1]).saturating_sub(1) } else { 0 };
            let first = first.min(samples);
            found.lengths.push(samples - first);
            for k in first..samples {
                let mut row = Vec::new();
                for lag in 0..history[0] {
                    let sample = k.checked_sub(lag).map_or(outputs_before, |k| &run.outputs[k * outputs..][..outputs]);
                    row.extend(standardised(sample, of_outputs));
                }
                for lag in 0..history[1] {
                    let sample = k.checked_sub(lag).map_or(inputs_before, |k| &run.inputs[k * inputs..][..inputs]);
                    row.extend(standardised(sample, of_inputs));
                }
                row.extend(standardised(p, of_parameters));
                found.inputs.push(row);
                found.outputs.push(standardised(&run.outputs[(k + 1) * outputs..][..outputs], of_outputs).collect());
            }
        }
        found
    }

    /// From the units of the table to the columns of [`regressors`](Self::regressors) and to the outputs.
    fn scaling(&self, history: [usize; 2]) -> Scaling {
        let [parameters, inputs, outputs] = &self.scales;
        let repeated = |of: fn(&ColumnMoments) -> &Vec<f64>| -> Vec<f64> {
            let past_outputs = (0..history[0]).flat_map(|_| of(outputs).iter().copied());
            let past_inputs = (0..history[1]).flat_map(|_| of(inputs).iter().copied());
            past_outputs.chain(past_inputs).chain(of(parameters).iter().copied()).collect()
        };
        let (output_mean, output_scale) = outputs.clone();
        let (input_mean, input_scale) = (repeated(|(means, _)| means), repeated(|(_, scales)| scales));
        Scaling { input_mean, input_scale, output_mean, output_scale }
    }

    /// The next sample from those before, in the units of the table.
    fn graph(&self, history: [usize; 2], linear: &DMatrix<f64>, network: Option<(&[f64], Vec<Layer>)>) -> Graph {
        let scaling = self.scaling(history);
        let (means, scales) = (&scaling.input_mean, &scaling.input_scale);
        let columns = means.len();
        let mut weights = Vec::new();
        let mut constants = Vec::new();
        for output in 0..self.counts[2] {
            let (mean, scale) = (scaling.output_mean[output], scaling.output_scale[output]);
            let row: Vec<f64> =
                (0..scales.len()).map(|column| scale * linear[(column, output)] / scales[column]).collect();
            let at_means = mean + scale * linear[(scales.len(), output)];
            constants.push(at_means - row.iter().zip(means).map(|(weight, mean)| weight * mean).sum::<f64>());
            weights.extend(row);
        }
        let network = network.map(|(gains, layers)| {
            let output_scale = scaling.output_scale.iter().zip(gains).map(|(scale, gain)| scale * gain).collect();
            let output_mean = vec![0.0; self.counts[2]];
            Graph::from(&ScaledNetwork { scaling: Scaling { output_mean, output_scale, ..scaling }, layers })
        });
        Graph::of_samples(columns, weights, constants, network)
    }
}

fn standardised<'a>(values: &'a [f64], (means, scales): &'a ColumnMoments) -> impl Iterator<Item = f64> + 'a {
    values.iter().zip(means).zip(scales).map(|((value, mean), scale)| (value - mean) / scale)
}

/// Coefficients of least squares, and constants below them, shape `[columns + 1, outputs]`; none if they are not determined.
fn solve(regressors: &Regressors) -> Option<DMatrix<f64>> {
    let Regressors { inputs, outputs, .. } = regressors;
    let (rows, columns, functions) = (inputs.len(), inputs.first()?.len(), outputs.first()?.len());
    let ridge = (RIDGE * rows as f64).sqrt();
    let element = |row: usize, column: usize| match row.checked_sub(rows) {
        None => inputs[row].get(column).copied().unwrap_or(1.0),
        Some(row) => f64::from(u8::from(row == column)) * ridge,
    };
    let matrix = DMatrix::from_fn(rows + columns, columns + 1, element);
    let mut sides = DMatrix::from_fn(rows + columns, functions, |row, output| {
        outputs.get(row).map_or(0.0, |outputs| outputs[output])
    });
    let decomposition = matrix.qr();
    decomposition.q_tr_mul(&mut sides);
    let sides = sides.rows(0, columns + 1).into_owned();
    let solution = decomposition.r().solve_upper_triangular(&sides)?;
    Some(solution).filter(|solution| solution.iter().all(|value| value.is_finite()))
}

/// What the linear part gives at a row.
fn linear_part(linear: &DMatrix<f64>, row: &[f64], output: usize) -> f64 {
    row.iter().enumerate().map(|(column, value)| value * linear[(column, output)]).sum::<f64>()
        + linear[(row.len(), output)]
}

/// Standard deviation of what the linear part leaves over, of each output.
fn gains(regressors: &Regressors, linear: &DMatrix<f64>) -> Vec<f64> {
    let rows = || regressors.inputs.iter().zip(&regressors.outputs);
    let of = |output: usize| {
        let squares = rows().map(|(row, outputs)| (outputs[output] - linear_part(linear, row, output)).powi(2));
        (squares.sum::<f64>() / regressors.inputs.len().max(1) as f64).sqrt().max(LEAST_GAIN)
    };
    (0..linear.ncols()).map(of).collect()
}

/// Rows of what the linear part leaves over.
fn plain(regressors: &Regressors, linear: &DMatrix<f64>, gains: &[f64]) -> Result<TrainingRows> {
    let rest = regressors.inputs.iter().zip(&regressors.outputs).flat_map(|(row, outputs)| {
        let rest = |(output, gain): (usize, &f64)| (outputs[output] - linear_part(linear, row, output)) / gain;
        gains.iter().enumerate().map(rest).map(|rest| rest as f32).collect::<Vec<_>>()
    });
    let inputs = regressors.inputs.iter().flatten().map(|value| *value as f32).collect();
    Ok(TrainingRows::new(linear.nrows() - 1, linear.ncols(), inputs, rest.collect())?)
}

/// Rows of stretches of a length, which begin so many samples after each other.
fn recurrent(
    regressors: &Regressors,
    linear: &DMatrix<f64>,
    gains: &[f64],
    history: usize,
    (stretch, apart): (usize, usize),
) -> Result<TrainingRows> {
    let single = |rows: &[Vec<f64>]| rows.iter().flatten().map(|value| *value as f32).collect();
    let rows =
        TrainingRows::new(linear.nrows() - 1, linear.ncols(), single(&regressors.inputs), single(&regressors.outputs))?;
    let mut starts = Vec::new();
    let mut first = 0;
    for length in &regressors.lengths {
        starts.extend((0..=length.saturating_sub(stretch)).step_by(apart).map(|begin| (first + begin) as u32));
        first += length;
    }
    Ok(rows.with_recurrence(Recurrence {
        history,
        // columns of a matrix of nalgebra lie one after the other
        linear: linear.iter().map(|weight| *weight as f32).collect(),
        gains: gains.iter().map(|gain| *gain as f32).collect(),
        starts,
        stretch,
    }))
}

/// Epochs that a training may have: each predicts all rows and passes their gradients back, or predicts those that are held out.
fn affordable(project: &Project, network: &Network, training: &TrainingRows, validation: &TrainingRows) -> usize {
    let rows =
        |of: &TrainingRows| of.recurrence().map_or(of.len(), |stretches| stretches.starts.len() * stretches.stretch);
    let passes = (3 * rows(training) + rows(validation)) as f64;
    let of_epoch = passes * network.parameters().len() as f64;
    let epochs = project.study.discrete.multiplications(TRAINING_BUDGET) / of_epoch.max(1.0);
    (epochs as usize).max(1)
}

fn follow(
    project: &Project,
    network: Network,
    training: &TrainingRows,
    validation: &TrainingRows,
    options: &TrainingOptions,
) -> Result<training::Outcome> {
    let epochs = options.epochs.min(affordable(project, &network, training, validation));
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
