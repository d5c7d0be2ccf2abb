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
    study::{DiscreteModel, Study},
    surrogate,
    training::{EpochRecord, StopReason},
};
use cross_validation::cross_validation;
use dead_time::DeadTimes;
use direct::DirectEffects;
use metafmu_runtime::{Clock, Graph, Program, Rows, Sampling, Scaling, Support, Surrogate};
use std::{borrow::Cow, time::Instant};

/// Error on held-out runs that is too small to be luck.
const SURE: f64 = 1e-3;

/// Models that give the next sample.
pub(super) struct DiscreteModels;

impl LearningMethod for DiscreteModels {
    fn learn(&self, project: &Project, dataset: &Dataset, _: &Beginning) -> Result<Trained> {
        train(project, dataset)
    }
}

/// Learns the kinds of model, and exports the one whose simulations of the held-out runs are best.
fn train(project: &Project, dataset: &Dataset) -> Result<Trained> {
    let study = &project.study;
    let began = Instant::now();
    let effects = InputEffects::of(project, dataset);
    let delayed = effects.removed(dataset);
    let (training, validation) = prepare::split(&delayed.runs, &study.training, study.seed);
    let samples = DiscreteSamples::new(study.time.step, &delayed, training, validation);
    let assembly = SampledAssembly {
        study,
        dataset,
        drives: project.source.drives(),
        effects: &effects,
        step: samples.step,
        rows: samples.rows(),
    };
    let validation = held_out(study, dataset);
    let LearnedKinds { mut kinds, was_interrupted } = learn_kinds(project, &samples, &assembly, &validation)?;
    let candidates = kinds.iter().map(|learned| learned.candidate.clone()).collect();
    let choice = choose(project, &kinds, &assembly, &delayed)?;
    let LearnedKind { kind, candidate, surrogate, model } = kinds.swap_remove(choice.best);
    let surrogate = assembly.supported(project, kind, &model, surrogate)?;
    let stopped = if was_interrupted || choice.was_interrupted { StopReason::Interrupted } else { model.stopped };
    let record = TrainingRecord {
        train_rows: samples.rows(),
        validation_runs: validation.runs.len(),
        epochs: model.history.len(),
        best_epoch: model.best_epoch,
        stopped,
        train_seconds: began.elapsed().as_secs_f64(),
        processor_seconds: None,
        added_runs: 0,
        target_met: None,
        method: Some(MethodRecord::Discrete(DiscreteRecord {
            candidates,
            exported: candidate.name,
            history: effects.history(&model),
        })),
    };
    project.finish(format_args!(
        "learned from {} samples in {:.1} s: {}",
        record.train_rows,
        record.train_seconds,
        record.method.as_ref().map_or(String::new(), MethodRecord::describe)
    ));
    Ok(Trained { surrogate, history: model.history, record })
}

/// Effects of inputs that models of past samples do not learn: they are removed from the runs, and added to the surrogate.
struct InputEffects {
    dead_times: DeadTimes,
    direct: DirectEffects,
}

impl InputEffects {
    /// The effects in a data set, which are reported.
    fn of(project: &Project, dataset: &Dataset) -> Self {
        let step = project.study.time.step;
        let dead_times = DeadTimes::of(step, dataset);
        if let Some(delays) = dead_times.describe(dataset) {
            project.event(Event::Note(format_args!("dead time: {delays}")));
        }
        let direct = DirectEffects::of(step, &dead_times.shifted(dataset), &dead_times);
        if let Some(acting) = direct.describe(dataset) {
            project.event(Event::Note(format_args!("direct effects: {acting}")));
        }
        Self { dead_times, direct }
    }

    /// Runs without the effects.
    fn removed<'a>(&self, dataset: &'a Dataset) -> Cow<'a, Dataset> {
        self.direct.removed(self.dead_times.shifted(dataset))
    }

    /// Number of past samples of the outputs and of the inputs that a surrogate with the effects needs.
    fn history(&self, model: &LearnedDiscrete) -> [usize; 2] {
        [model.past[0], model.past[1] + self.dead_times.longest()]
    }
}

/// Assembly of surrogates from models of the next sample.
struct SampledAssembly<'a> {
    study: &'a Study,
    dataset: &'a Dataset,
    /// Start and range of each input.
    drives: Vec<(f64, [f64; 2])>,
    effects: &'a InputEffects,
    step: f64,
    /// Rows that models are learned from.
    rows: usize,
}

impl SampledAssembly<'_> {
    /// The surrogate of a model, valid in the ranges of its variables.
    fn surrogate(&self, model: &LearnedDiscrete) -> Result<Surrogate> {
        self.with_support(model, None)
    }

    fn with_support(&self, model: &LearnedDiscrete, support: Option<Support>) -> Result<Surrogate> {
        let numbers = model.past[0] * (self.dataset.outputs.len() + model.hidden.len());
        let graph = self.effects.dead_times.delayed(&model.graph, numbers, model.past[1]);
        let sampling = Sampling {
            hidden: model.hidden.clone(),
            direct: self.effects.direct.matrix().to_vec(),
            history: self.effects.history(model),
            step: self.step,
            support,
        };
        let program = Program { graph, clock: Clock::Sampled(Box::new(sampling)) };
        surrogate::assemble_discrete(self.study, (self.dataset, self.rows), &self.drives, program)
    }

    /// The surrogate that is exported: of the model that was fitted to all runs, if there is one, and valid near the transitions of the runs.
    /// `surrogate` is that of the model itself.
    fn supported(
        &self,
        project: &Project,
        kind: DiscreteModel,
        model: &LearnedDiscrete,
        surrogate: Surrogate,
    ) -> Result<Surrogate> {
        let (exported, surrogate) = match model.refitted.as_deref() {
            Some(refitted) => (refitted, self.surrogate(refitted)?),
            None => (model, surrogate),
        };
        // an FMU as source holds its inputs between samples, so a polynomial of one past sample is valid for any signal. Between the rows of a
        // table inputs are unknown, and a network is valid near its training data only
        let inputs = self.effects.history(exported)[1] > 1
            || !exported.hidden.is_empty()
            || kind == DiscreteModel::Feedback
            || matches!(project.source, Source::Recorded(_));
        let ranges = self.drives.iter().map(|(_, range)| *range);
        let support = support::support(self.study, self.dataset, &self.effects.direct, (&surrogate, inputs), ranges);
        self.with_support(exported, Some(support))
    }
}

/// The best model of each kind, those with the smallest errors first.
struct LearnedKinds {
    kinds: Vec<LearnedKind>,
    /// `true` if Ctrl-C ended a kind, or left out the others.
    was_interrupted: bool,
}

/// Learns the best model of each kind that the study wants.
fn learn_kinds(
    project: &Project,
    samples: &DiscreteSamples,
    assembly: &SampledAssembly,
    validation: &Dataset,
) -> Result<LearnedKinds> {
    let study = &project.study;
    let mut kinds: Vec<LearnedKind> = Vec::new();
    let mut was_interrupted = false;
    for kind in DiscreteModel::ALL.into_iter().filter(|kind| study.discrete.model.is_none_or(|model| model == *kind)) {
        let start = Instant::now();
        let has_network = kinds.iter().any(|learned| !learned.model.history.is_empty());
        let Some(models) = unless_interrupted(project, samples.learn(project, kind), has_network)? else {
            was_interrupted = true;
            break;
        };
        let Some(SimulatedModel { error, surrogate, model }) = best_of(models, assembly, validation)? else { continue };
        was_interrupted = model.stopped == StopReason::Interrupted;
        let candidate = Candidate { name: kind.name().into(), error, seconds: start.elapsed().as_secs_f64() };
        kinds.push(LearnedKind { kind, candidate, surrogate, model });
        if was_interrupted {
            break;
        }
    }
    if kinds.is_empty() {
        return Err(study.refusal("discrete.model", "the samples determine no polynomial: more runs, or another model"));
    }
    kinds.sort_by(|a, b| a.candidate.error.total_cmp(&b.candidate.error));
    Ok(LearnedKinds { kinds, was_interrupted })
}

/// A model with its surrogate, and the error of that in simulations.
struct SimulatedModel {
    error: f64,
    surrogate: Surrogate,
    model: LearnedDiscrete,
}

/// The model whose simulations of the held-out runs are best; none of no model.
fn best_of(
    models: Vec<LearnedDiscrete>,
    assembly: &SampledAssembly,
    validation: &Dataset,
) -> Result<Option<SimulatedModel>> {
    let mut best: Option<SimulatedModel> = None;
    for model in models {
        let surrogate = assembly.surrogate(&model)?;
        let error = error(&Accuracy::of(&surrogate, validation));
        if best.as_ref().is_none_or(|best| error.total_cmp(&best.error).is_lt()) {
            best = Some(SimulatedModel { error, surrogate, model });
        }
    }
    Ok(best)
}

/// The kind that is exported.
struct KindChoice {
    /// Its position among the kinds.
    best: usize,
    /// `true` if Ctrl-C ended the choice.
    was_interrupted: bool,
}

/// Chooses the kind that is exported: the first, unless a kind after it was chosen by a cross-validation, which those before have to pass then.
/// Runs that ended the training of a network, or chose a polynomial, are no longer unseen.
fn choose(
    project: &Project,
    kinds: &[LearnedKind],
    assembly: &SampledAssembly,
    delayed: &Dataset,
) -> Result<KindChoice> {
    let mut choice = KindChoice { best: 0, was_interrupted: false };
    let validated = kinds.iter().enumerate().find_map(|(place, learned)| Some((place, learned.model.unseen?)));
    let is_compared = assembly.dataset.runs.len() >= cross_validation::PARTS && kinds[0].candidate.error > SURE;
    let Some((place, mut least)) = validated.filter(|_| is_compared) else { return Ok(choice) };
    choice.best = place;
    for (position, learned) in kinds[..place].iter().enumerate() {
        let Some(error) = cross_validation(project, delayed, learned.kind, assembly)? else {
            choice.was_interrupted = true;
            break;
        };
        project.event(Event::Note(format_args!(
            "{}: error {error:.2e} in a cross-validation, {}: {least:.2e}",
            learned.candidate.name, kinds[choice.best].candidate.name
        )));
        if error < least {
            (choice.best, least) = (position, error);
        }
    }
    Ok(choice)
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

/// Means and standard deviations of columns.
struct ColumnMoments {
    means: Vec<f64>,
    scales: Vec<f64>,
}

impl ColumnMoments {
    fn of<'a>(rows: impl Iterator<Item = &'a [f64]> + Clone) -> Self {
        let (means, scales) = scaling::of_columns(rows);
        Self { means, scales }
    }
}

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
    inputs: Rows,
    outputs: Rows,
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
    fn new(step: f64, dataset: &Dataset, training: Vec<&'a Run>, validation: Vec<&'a Run>) -> Self {
        let [inputs, outputs] = [dataset.inputs.len(), dataset.outputs.len()];
        // what inputs and outputs were before the start are parameters too
        let counts = [dataset.parameters.len() - inputs - outputs, inputs, outputs];
        let scales = [
            ColumnMoments::of(training.iter().map(|run| &run.parameters[..counts[0]])),
            ColumnMoments::of(training.iter().flat_map(|run| run.inputs.chunks(inputs.max(1)))),
            ColumnMoments::of(training.iter().flat_map(|run| run.outputs.chunks(outputs.max(1)))),
        ];
        let known = training.iter().chain(&validation).map(|run| known_samples(run)).min().unwrap_or(usize::MAX);
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
        let mut regressors = Regressors { inputs: Rows::default(), outputs: Rows::default(), lengths: Vec::new() };
        let mut row = Vec::new();
        for run in runs {
            let (p, starts) = run.parameters.split_at(parameters);
            let (outputs_before, inputs_before) = starts.split_at(outputs);
            let samples = run.times.len() - 1;
            // before the first row of a run that begins at rest nothing moved; of others nothing is known
            let first = if run.times[0] < 0.0 { history[0].max(history[1]).saturating_sub(1) } else { 0 };
            let first = first.min(samples);
            regressors.lengths.push(samples - first);
            for k in first..samples {
                row.clear();
                for lag in 0..history[0] {
                    let sample = k.checked_sub(lag).map_or(outputs_before, |k| &run.outputs[k * outputs..][..outputs]);
                    row.extend(standardized(sample, of_outputs));
                }
                for lag in 0..history[1] {
                    let sample = k.checked_sub(lag).map_or(inputs_before, |k| &run.inputs[k * inputs..][..inputs]);
                    row.extend(standardized(sample, of_inputs));
                }
                row.extend(standardized(p, of_parameters));
                regressors.inputs.push(&row);
                row.clear();
                row.extend(standardized(&run.outputs[(k + 1) * outputs..][..outputs], of_outputs));
                regressors.outputs.push(&row);
            }
        }
        regressors
    }

    /// From the units of the table to the columns of [`regressors`](Self::regressors) and to the outputs.
    fn scaling(&self, history: [usize; 2]) -> Scaling {
        let [parameters, inputs, outputs] = &self.scales;
        let means = [outputs.means.repeat(history[0]), inputs.means.repeat(history[1]), parameters.means.clone()];
        let scales = [outputs.scales.repeat(history[0]), inputs.scales.repeat(history[1]), parameters.scales.clone()];
        Scaling {
            input_mean: means.concat(),
            input_scale: scales.concat(),
            output_mean: outputs.means.clone(),
            output_scale: outputs.scales.clone(),
        }
    }
}

/// Past samples that a run knows at its first prediction: before a run from rest nothing moved, whatever the number.
fn known_samples(run: &Run) -> usize {
    match run.times.partition_point(|time| *time < 0.0) {
        0 => usize::MAX,
        given => given + 1,
    }
}

fn standardized<'a>(values: &'a [f64], moments: &'a ColumnMoments) -> impl Iterator<Item = f64> + 'a {
    values.iter().zip(&moments.means).zip(&moments.scales).map(|((value, mean), scale)| (value - mean) / scale)
}
