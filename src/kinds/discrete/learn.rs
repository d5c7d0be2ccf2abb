//! Learns discrete-time models from recorded runs or those of an FMU.

mod cross_validation;
mod dead_time;
mod direct;
mod linear;
mod network;
mod polynomial;
mod state_space;
mod support;

use crate::{
    Result,
    dataset::{Dataset, Run},
    evaluation::{Accuracy, OutputMetrics},
    kinds::{
        follower::unless_interrupted,
        learning::{Beginning, LearningMethod, Trained},
        prepare::{self, held_out},
        record::{Candidate, DiscreteRecord, MethodRecord, TrainingRecord},
    },
    project::{Event, Project},
    scaling,
    source::Source,
    study::DiscreteModel,
    surrogate,
    training::{EpochRecord, StopReason},
};
use cross_validation::cross_validation;
use dead_time::DeadTimes;
use direct::DirectEffects;
use metafmu_runtime::{Clock, Graph, Program, Sampling, Scaling, Support, Surrogate};
use std::time::Instant;

/// Error on held-out runs that is too small to be luck.
const SURE: f64 = 1e-3;

/// Models that give the next sample.
pub(super) struct DiscreteModels;

impl LearningMethod for DiscreteModels {
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
    let direct = DirectEffects::of(study.time.step, &late, &dead_times);
    if let Some(found) = direct.describe(dataset) {
        project.event(Event::Note(format_args!("direct effects: {found}")));
    }
    let late = direct.removed(late);
    let samples = DiscreteSamples::new(study.time.step, &late, prepare::split(&late.runs, &study.training, study.seed));
    let validation = held_out(study, dataset);
    let with_support = |one: &LearnedDiscrete, support: Option<Support>| {
        let history = [one.past[0], one.past[1] + dead_times.longest()];
        let numbers = one.past[0] * (dataset.outputs.len() + one.hidden.len());
        let graph = dead_times.delayed(&one.graph, numbers, one.past[1]);
        let sampling = Sampling {
            hidden: one.hidden.clone(),
            direct: direct.matrix().to_vec(),
            history,
            step: samples.step,
            support,
        };
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
    let LearnedKind { kind, candidate: Candidate { name, .. }, surrogate, model: one } = learned.swap_remove(best);
    let surrogate = one.refitted.as_deref().map_or(Ok(surrogate), assembled)?;
    let exported = one.refitted.as_deref().unwrap_or(&one);
    // an FMU as source holds its inputs between samples, so a polynomial of one past sample is valid for any signal. Between the rows of a table
    // inputs are unknown, and a network is valid near its training data only
    let inputs = exported.past[1] + dead_times.longest() > 1
        || !exported.hidden.is_empty()
        || kind == DiscreteModel::Feedback
        || matches!(project.source, Source::Recorded(_));
    let ranges = drives.iter().map(|(_, range)| *range);
    let support = support::support(study, dataset, &direct, (&surrogate, inputs), ranges);
    let surrogate = with_support(exported, Some(support))?;
    let stopped = if was_interrupted { StopReason::Interrupted } else { one.stopped };
    let record = TrainingRecord {
        train_rows: samples.rows(),
        validation_runs: validation.runs.len(),
        epochs: one.history.len(),
        best_epoch: one.best_epoch,
        stopped,
        train_seconds: began.elapsed().as_secs_f64(),
        processor_seconds: None,
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
    /// Epochs of the network, one training after the other.
    history: Vec<EpochRecord>,
    best_epoch: usize,
    stopped: StopReason,
    /// Result of a fit that includes the held-out runs, if there is one.
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

/// Regressors of all samples of some runs, standardized: `[samples, columns]`, and the outputs that follow.
struct Regressors {
    inputs: Vec<Vec<f64>>,
    outputs: Vec<Vec<f64>>,
    /// Number of samples of each run.
    lengths: Vec<usize>,
}

impl Regressors {
    /// Samples of the shortest run.
    fn shortest(&self) -> usize {
        self.lengths.iter().copied().min().unwrap_or(1)
    }
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

    /// Number of past samples: `samples`, or the number that every run knows if that is smaller.
    fn past(&self, samples: usize) -> usize {
        samples.min(self.known)
    }

    /// Models of a kind, with different numbers of samples or terms.
    fn learn(&self, project: &Project, kind: DiscreteModel) -> Result<Vec<LearnedDiscrete>> {
        let study = &project.study;
        match kind {
            DiscreteModel::Linear => Ok(vec![linear::learn(self, study)?]),
            DiscreteModel::Polynomial => Ok(polynomial::learn(self, self.past(study.discrete.history))),
            DiscreteModel::StateSpace => state_space::learn(project, self),
            DiscreteModel::Window => Ok(vec![network::window(project, self)?]),
            DiscreteModel::Feedback => Ok(vec![network::feedback(project, self)?]),
        }
    }

    /// Standardized past samples at each sample but the last, and the outputs of the next one.
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
                    row.extend(standardized(sample, of_outputs));
                }
                for lag in 0..history[1] {
                    let sample = k.checked_sub(lag).map_or(inputs_before, |k| &run.inputs[k * inputs..][..inputs]);
                    row.extend(standardized(sample, of_inputs));
                }
                row.extend(standardized(p, of_parameters));
                found.inputs.push(row);
                found.outputs.push(standardized(&run.outputs[(k + 1) * outputs..][..outputs], of_outputs).collect());
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
}

fn standardized<'a>(values: &'a [f64], (means, scales): &'a ColumnMoments) -> impl Iterator<Item = f64> + 'a {
    values.iter().zip(means).zip(scales).map(|((value, mean), scale)| (value - mean) / scale)
}
