//! Learns the equations of an FMU for model exchange, or of a program: derivatives of its states and outputs, from the states themselves.

use super::{
    learned::{self, EXACT, Examples, SAME, held_out},
    solver,
};
use crate::{
    Result,
    dataset::Dataset,
    dynamics::{EquationSamples, fit_functions},
    kinds::{
        follower::{Checkpoints, unless_interrupted},
        learning::{Beginning, LearningMethod, Trained},
        record::{
            Candidate, DICTIONARY, DICTIONARY_AND_NETWORK, MethodRecord, NETWORK, StateSpaceRecord, TrainingRecord,
        },
    },
    project::Project,
    scaling,
    source::{Source, driven::Driven, worker::WorkerModel},
    surrogate,
    training::{EpochRecord, Outcome, StopReason},
    worst::worst,
};
use metafmu_runtime::{
    Clock, Encoder, Encoding, Graph, Integration, Program, Rows, ScaledNetwork,
    dictionary::{Dictionary, Factor},
    graph::Given,
};
use std::{f64::consts::TAU, ops::Range, time::Instant};

/// Derivatives of the states of an FMU or a program.
pub(super) struct StateEquations;

impl LearningMethod for StateEquations {
    fn check(&self, project: &Project) -> Result<()> {
        let (driven, model) = asked(project)?;
        StateSpaceColumns::new(project, driven).ask(project, model, 1).map(|_| ())
    }

    fn learn(&self, project: &Project, dataset: &Dataset, begin: &Beginning) -> Result<Trained> {
        train(project, dataset, &Checkpoints::new(project, begin.resume)?)
    }
}

/// Asks the source for its equations, learns them, chooses how the solver integrates them.
fn train(project: &Project, dataset: &Dataset, checkpoints: &Checkpoints) -> Result<Trained> {
    let study = &project.study;
    let (driven, model) = asked(project)?;
    let began = Instant::now();
    let mut space = StateSpaceColumns::new(project, driven);
    let samples = space.ask(project, model, learned::states(study))?;
    let Recognized { results, functions, samples } = recognize(samples, &space.counts);
    space.used = learned::used(project, model, &space.ranges, &functions)?;
    let mut learned = space.learn(project, &samples, checkpoints)?;
    let best = learned::chosen(&learned.records, &study.dynamics);
    let (Candidate { name, error, .. }, dictionary, network) = learned.candidates.swap_remove(best);
    let ranges: Vec<Option<[f64; 2]>> = (study.states.iter().enumerate())
        .map(|(state, (name, options))| {
            let column = space.counts[0] + space.counts[1] + state;
            let depends = dictionary.depends_on(column) || network.as_ref().is_some_and(|of| space.reads(of, column));
            (depends && !options.goes_around(name)).then_some([options.min, options.max])
        })
        .collect();
    let assemble = |integration: Integration| {
        let graph = Graph::of_rates(&dictionary, network.as_ref().map(Graph::from), space.counts[2], &results);
        // a source without states provides outputs
        let clock = if space.counts[2] > 0 { Clock::Continuous(integration) } else { Clock::Static };
        let program = Program { graph, clock };
        surrogate::assemble_with_states(study, (dataset, samples.points.len()), (driven, &ranges), program)
    };
    // the states that are velocities are not known
    let of_states: Vec<_> = study.states.values().map(|state| Some([state.min, state.max])).collect();
    let (surrogate, solver) = solver::choose(project, dataset, (driven, &of_states), error, assemble)?;
    let mut candidates = learned.records;
    candidates.sort_by(|a, b| a.error.total_cmp(&b.error));
    let space_record = StateSpaceRecord {
        functions: dictionary.outputs(),
        harmonics: learned.order[0],
        powers: learned.order[1],
        products: dictionary.products(),
        candidates,
        exported: name,
        solver,
    };
    let rows = samples.points.len() - held_out(samples.points.len());
    let record = TrainingRecord::solved(rows, began.elapsed().as_secs_f64(), MethodRecord::StateSpace(space_record))
        .with_epochs(learned.history.len(), learned.best_epoch, learned.stopped);
    project.finish(format_args!(
        "learned the equations from {} states in {:.1} s: {}",
        samples.points.len(),
        record.train_seconds,
        record.method.as_ref().map_or(String::new(), MethodRecord::describe)
    ));
    Ok(Trained { surrogate, history: learned.history, record })
}

/// The FMU or program of a study, with its states and inputs.
pub(super) fn asked<'a>(project: &'a Project) -> Result<(&'a Driven, &'a WorkerModel)> {
    let study = &project.study;
    let Source::Simulation(simulation) = &project.source else {
        return Err(study.refusal("source", "recorded runs cannot be asked for their equations"));
    };
    let found = Option::zip(simulation.driven(), simulation.worker_model());
    found.ok_or_else(|| study.refusal("source", "expected an FMU or a program"))
}

/// Columns of the functions: parameters, inputs and states.
struct StateSpaceColumns {
    counts: [usize; 3],
    ranges: Vec<[f64; 2]>,
    factors: Vec<Factor>,
    /// Flags of the columns that change any function.
    used: Vec<bool>,
}

/// Results of a source that are functions of its columns, and those that are not.
struct Recognized {
    /// Outputs and derivatives: states, or functions by their number.
    results: Vec<Given>,
    /// Label of each function.
    functions: Vec<usize>,
    /// Samples of the functions.
    samples: EquationSamples,
}

/// Results of all ways to learn a state-space model.
struct LearnedStateSpace {
    candidates: Vec<(Candidate, Dictionary, Option<ScaledNetwork>)>,
    records: Vec<Candidate>,
    order: [usize; 2],
    /// Epochs of the networks, one network after the other.
    history: Vec<EpochRecord>,
    best_epoch: usize,
    stopped: StopReason,
}

impl StateSpaceColumns {
    fn new(project: &Project, driven: &Driven) -> Self {
        let study = &project.study;
        let parameters = study.parameters.values().map(|range| ([range.min, range.max], false));
        let inputs = driven.drivers().iter().map(|driver| ([driver.min, driver.max], false));
        let states = study.states.values().map(|state| ([state.min, state.max], state.is_periodic()));
        let columns: Vec<([f64; 2], bool)> = parameters.chain(inputs).chain(states).collect();
        let factor = |&([min, max], is_angle): &([f64; 2], bool)| match is_angle {
            true => Factor::Angle,
            false => Factor::Power { middle: 0.5 * (min + max), half: 0.5 * (max - min) },
        };
        Self {
            counts: [study.parameters.len(), driven.drivers().len(), study.states.len()],
            used: vec![true; columns.len()],
            factors: columns.iter().map(factor).collect(),
            ranges: columns.into_iter().map(|(range, _)| range).collect(),
        }
    }

    /// Derivatives and outputs of the source at random points, the same ones for the same seed.
    fn ask(&self, project: &Project, model: &WorkerModel, count: usize) -> Result<EquationSamples> {
        let points = learned::random_points(&self.ranges, count, project.study.seed ^ 0x5354_4154);
        let labels = learned::ask(project, model, &points)?;
        Ok(EquationSamples { points, labels })
    }

    fn learn(
        &self,
        project: &Project,
        samples: &EquationSamples,
        checkpoints: &Checkpoints,
    ) -> Result<LearnedStateSpace> {
        let study = &project.study;
        let held_out = held_out(samples.points.len());
        let (unseen, seen) = (samples.part(0..held_out), samples.part(held_out..samples.points.len()));
        let began = Instant::now();
        let fit = |lowest: bool| {
            let fitted = fit_functions((&self.factors, &self.used), &seen, &unseen, lowest);
            fitted.map_err(|message| study.refusal("states", message))
        };
        let fitted = fit(false)?;
        let dictionary = fitted.dictionary;
        let candidate = |name: &str, dictionary: Dictionary, network: Option<ScaledNetwork>, began: Instant| {
            let error = self.error(&dictionary, network.as_ref(), &unseen);
            (Candidate { name: name.into(), error, seconds: began.elapsed().as_secs_f64() }, dictionary, network)
        };
        let mut learned = LearnedStateSpace {
            candidates: vec![candidate(DICTIONARY, dictionary.clone(), None, began)],
            records: Vec::new(),
            order: fitted.order,
            history: Vec::new(),
            best_epoch: 0,
            stopped: StopReason::Solved,
        };
        let nothing = Dictionary::new(&self.factors, dictionary.outputs(), &[])
            .map_err(|source| crate::Error::Surrogate { source })?;
        let exact = learned.candidates[0].0.error <= EXACT;
        for name in [DICTIONARY_AND_NETWORK, NETWORK] {
            if study.dynamics.tries(name, exact) && learned.stopped != StopReason::Interrupted {
                // what the highest order leaves over oscillates, and no network learns that
                let base = if name == NETWORK { nothing.clone() } else { fit(true)?.dictionary };
                let began = Instant::now();
                let trained = self.train((project, checkpoints), &base, [&seen, &unseen]);
                let has_earlier = !learned.history.is_empty();
                let Some((network, outcome)) = unless_interrupted(project, trained, has_earlier)? else {
                    learned.stopped = StopReason::Interrupted;
                    break;
                };
                learned.stopped = outcome.reason;
                learned.best_epoch = outcome.best_epoch;
                learned.history = outcome.history;
                learned.candidates.push(candidate(name, base, Some(network), began));
            }
        }
        learned.records = learned.candidates.iter().map(|(candidate, ..)| candidate.clone()).collect();
        Ok(learned)
    }

    /// A network for what a dictionary leaves over.
    fn train(
        &self,
        (project, checkpoints): (&Project, &Checkpoints),
        base: &Dictionary,
        [seen, unseen]: [&EquationSamples; 2],
    ) -> Result<(ScaledNetwork, Outcome)> {
        let [seen, unseen] = [seen, unseen].map(|samples| Examples {
            inputs: self.columns(samples),
            outputs: residuals(base, samples),
            tangents: None,
        });
        let (mut network, outcome) = learned::train(project, [&seen, &unseen], checkpoints)?;
        let unused = (0..self.used.len()).filter(|column| !self.used[*column]).flat_map(|column| self.encoded(column));
        network.clear_inputs(&unused.collect::<Vec<_>>());
        Ok((network, outcome))
    }

    /// Columns of a network that a column is encoded by.
    fn encoded(&self, column: usize) -> Range<usize> {
        let width = |factor: &Factor| if *factor == Factor::Angle { 2 } else { 1 };
        let first: usize = self.factors[..column].iter().map(width).sum();
        first..first + width(&self.factors[column])
    }

    /// Returns true if a network has weights of a column.
    fn reads(&self, network: &ScaledNetwork, column: usize) -> bool {
        self.encoded(column).any(|input| network.reads(input))
    }

    fn encoder(&self) -> Encoder {
        let encoding = |factor: &Factor| match factor {
            Factor::Angle => Encoding::Periodic,
            Factor::Power { .. } => Encoding::Plain,
        };
        let encodings: Vec<Encoding> = self.factors.iter().map(encoding).collect();
        Encoder::new(encodings.iter().map(|encoding| (encoding, 0.0, TAU)))
    }

    /// Columns of a network, in which columns that change nothing are constant.
    fn columns(&self, samples: &EquationSamples) -> Rows {
        let encoder = self.encoder();
        let encoded = |point: &[f64]| {
            let used = point.iter().zip(&self.used).zip(&self.ranges);
            let point: Vec<f64> = used.map(|((value, used), [min, _])| if *used { *value } else { *min }).collect();
            let mut columns = vec![0.0; encoder.width()];
            encoder.encode(&point, &mut columns);
            columns
        };
        samples.points.iter().map(encoded).collect()
    }

    /// Root mean square error relative to the standard deviation, of the worst function.
    fn error(&self, dictionary: &Dictionary, network: Option<&ScaledNetwork>, unseen: &EquationSamples) -> f64 {
        let residuals = residuals(dictionary, unseen);
        let learned = network.map(|network| Graph::from(network).evaluate(&self.columns(unseen)));
        let (_, scales) = scaling::of_columns(&unseen.labels);
        let of = |function: usize| {
            let residual =
                |row: usize| residuals[row][function] - learned.as_ref().map_or(0.0, |learned| learned[row][function]);
            let squares: f64 = (0..residuals.len()).map(|row| residual(row).powi(2)).sum();
            (squares / residuals.len().max(1) as f64).sqrt() / scales[function]
        };
        worst((0..dictionary.outputs()).map(of))
    }
}

/// Recognizes outputs and derivatives that are states or equal functions. Results are outputs, then derivatives.
fn recognize(samples: EquationSamples, &[_, _, states]: &[usize; 3]) -> Recognized {
    let width = samples.labels.width();
    let EquationSamples { points, labels } = samples;
    let same = |label: usize, of: &dyn Fn(usize) -> f64| {
        let largest = labels.largest_magnitude(label);
        (0..points.len()).all(|row| (labels[row][label] - of(row)).abs() <= SAME * largest)
    };
    let mut functions: Vec<usize> = Vec::new();
    // labels are derivatives, then outputs
    let mut results: Vec<Given> = Vec::new();
    for label in 0..width {
        let state = (0..states).find(|state| same(label, &|row| points[row][points.width() - states + state]));
        let known = || functions.iter().position(|function| same(label, &|row| labels[row][*function]));
        results.push(match state {
            Some(state) => Given::State(state),
            None => Given::Function(known().unwrap_or_else(|| {
                functions.push(label);
                functions.len() - 1
            })),
        });
    }
    results.rotate_left(states);
    let labels = labels.select(&functions);
    Recognized { results, functions, samples: EquationSamples { points, labels } }
}

/// Residuals of a dictionary.
fn residuals(dictionary: &Dictionary, samples: &EquationSamples) -> Rows {
    let mut residuals = Rows::default();
    let mut values = vec![0.0; dictionary.outputs()];
    for (point, labels) in samples.points.iter().zip(&samples.labels) {
        dictionary.evaluate(point, &mut values);
        values.iter_mut().zip(labels).for_each(|(value, label)| *value = label - *value);
        residuals.push(&values);
    }
    residuals
}
