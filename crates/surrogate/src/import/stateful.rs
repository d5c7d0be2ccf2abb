//! Models with states: columns of the outputs are the next values, or the derivatives, of columns of the inputs.

use super::interface::{Evolution, Followed, NO_SAMPLE_TIME};
use super::*;
use metafmu_runtime::{
    Clock, CommunicationStep, Domain, Drive, Integration, Program, Rows, Sampling, State,
    dictionary::{Dictionary, Factor},
    graph::Given,
};

/// Simulations from which ranges of outputs and the step of the solver are found, and steps of each at most.
const RUNS: usize = 8;
const STEPS: usize = 400;
/// Number of steps over which an input of these simulations is fixed.
const HELD: usize = 10;

/// Largest error of the outputs by the solver in these simulations, relative to their ranges.
const SOLVER_ERROR: f64 = 1e-9;
/// Tolerances of the solver that are tried, ten times smaller each, and part of one with which it is compared.
const TOLERANCES: [f64; 7] = [1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12];
const MUCH_TIGHTER: f64 = 1e-2;
/// Difference of outputs, relative to their ranges, beyond which steps are unstable. Differences of chaotic motions
/// stay within the ranges; an output that should be constant differs by rounding.
const UNSTABLE: f64 = 1e6;
/// Perturbation of the initial state in a simulation that tests whether steps are stable, relative to the nominal
/// value.
const DISTURBANCE: f64 = 1e-3;

/// The surrogate of a model with states; see [`super::surrogate()`].
pub(super) fn surrogate(
    (path, content): (&Path, &[u8]),
    imported: Imported,
    interface: &ModelInterface,
    mapping: &Mapping,
    rows: Option<Rows>,
) -> Result<Surrogate> {
    let evolution = evolution(interface, &imported.recurrences)?;
    let variables = inputs(interface, rows.as_ref())?;
    let about = About { path, content, is_single: imported.is_single, producer: &imported.producer };
    let known = StatefulModel::of(path, interface, mapping, &variables);
    let metadata = metadata(about, interface, Vec::new(), rows.as_ref().map_or(0, Rows::len));
    let surrogate = match evolution {
        Evolution::Discrete => discrete(&known, imported, metadata)?,
        Evolution::Continuous => continuous(&known, imported, metadata, rows.as_ref())?,
    };
    let ranges = ranges(&known.simulated(&surrogate, rows.as_ref()), surrogate.outputs());
    let ranges = ranges.map_err(|error| known.refused(error))?;
    let metadata = with_ranges(surrogate.metadata(), &ranges);
    surrogate::seal(made(metadata, surrogate.program().clone())?)
}

fn made(metadata: Metadata, program: Program) -> Result<Surrogate> {
    Surrogate::new(metadata, program).map_err(|source| Error::Surrogate { source })
}

/// Evolution of the states; mixed ones are refused.
fn evolution(interface: &ModelInterface, recurrences: &[RecurrentState]) -> Result<Evolution> {
    let mut problems = Problems::default();
    let evolution = match (interface.evolution(), recurrences.first()) {
        (Some(Evolution::Continuous), Some(RecurrentState { name, .. })) => {
            problems.add(
                "states",
                format!(
                    "have a `derivative`, but `{name}` of a recurrent cell is discrete-time: expected one kind of states"
                ),
            );
            Evolution::Continuous
        }
        (_, Some(_)) => Evolution::Discrete,
        (found, None) => found.unwrap_or(Evolution::Discrete),
    };
    if evolution == Evolution::Discrete && interface.time.sample.is_none() {
        problems.add("time.sample", NO_SAMPLE_TIME);
    }
    for (name, _) in interface.variables().filter(|(_, input)| input.causality == InterfaceCausality::Time) {
        let message = "\"time\", of a model with states: expected an input, or one with a `value`";
        problems.add(format!("inputs.{name}.causality"), message);
    }
    interface.refuse(problems)?;
    Ok(evolution)
}

/// A model with states and the roles of its variables.
struct StatefulModel<'a> {
    path: &'a Path,
    interface: &'a ModelInterface,
    mapping: &'a Mapping,
    variables: &'a [Input],
    /// Positions among the variables: of parameters, and of inputs that are driven.
    parameters: Vec<usize>,
    driven: Vec<usize>,
}

impl<'a> StatefulModel<'a> {
    fn of(path: &'a Path, interface: &'a ModelInterface, mapping: &'a Mapping, variables: &'a [Input]) -> Self {
        let (driven, parameters) = (0..variables.len()).partition(|index| variables[*index].role == Role::Input);
        Self { path, interface, mapping, variables, parameters, driven }
    }

    /// Error for a problem of the model.
    fn refused(&self, problem: impl Into<ImportError>) -> Error {
        let problem: ImportError = problem.into();
        ImportError::of_file(self.path)(problem)
    }

    /// Inputs of the surrogate: parameters, initial states, driven inputs.
    fn inputs(&self, starts: Vec<Input>) -> Vec<Input> {
        let [parameters, driven] = [&self.parameters, &self.driven]
            .map(|indices| indices.iter().map(|index| self.variables[*index].clone()).collect());
        [parameters, starts, driven].concat()
    }

    fn start_of(&self, state: &Followed) -> f64 {
        self.interface.states[state.of].start.unwrap_or(0.0)
    }

    /// Sources of the columns that the model takes, among columns in which variables and states begin at these places.
    fn sources(&self, [parameters, driven]: [usize; 2], states: impl Fn(usize) -> usize) -> Vec<ColumnSource> {
        self.mapping
            .inputs
            .iter()
            .map(|source| match *source {
                ColumnSource::Input(variable) => {
                    let parameter = self.parameters.iter().position(|other| *other == variable);
                    let input = self.driven.iter().position(|other| *other == variable);
                    let place = parameter.map(|k| parameters + k).or(input.map(|k| driven + k));
                    ColumnSource::Input(place.unwrap_or(0))
                }
                ColumnSource::State(state) => ColumnSource::Input(states(state)),
                ColumnSource::Value(value) => ColumnSource::Value(value),
            })
            .collect()
    }

    /// The surrogate of a program whose outputs have these values at the start.
    fn with_starts(&self, metadata: &Metadata, program: &Program, starts: &[f64]) -> Result<Surrogate> {
        let starts = metadata
            .outputs
            .iter()
            .zip(starts)
            .map(|(Output { name, unit, .. }, start)| {
                start_input(name, &format!("{name} at the start"), unit, [*start; 3])
            })
            .collect();
        made(Metadata { inputs: self.inputs(starts), ..metadata.clone() }, program.clone())
    }

    /// Outputs in simulations, row by row: along the rows of a table, or with random inputs, parameters and states.
    fn simulated(&self, surrogate: &Surrogate, rows: Option<&Rows>) -> Vec<Vec<Option<Vec<f64>>>> {
        self.simulations(surrogate, rows, 0.0)
    }

    /// These runs, and one from a perturbed initial state: from an equilibrium all of them would stay there, whatever
    /// the step of the solver.
    fn disturbed(&self, surrogate: &Surrogate, rows: Option<&Rows>) -> Vec<Vec<Option<Vec<f64>>>> {
        [self.simulations(surrogate, rows, 0.0), self.simulations(surrogate, rows, DISTURBANCE)].concat()
    }

    fn simulations(&self, surrogate: &Surrogate, rows: Option<&Rows>, disturbance: f64) -> Vec<Vec<Option<Vec<f64>>>> {
        let metadata = surrogate.metadata();
        let mut evaluator = Evaluator::new(surrogate);
        let domain = Domain::new(surrogate.inputs(), surrogate.states());
        let (first, step) = (surrogate.inputs().len() - self.driven.len(), metadata.time_step);
        let steps = (metadata.stop_time.unwrap_or(f64::INFINITY) / step).ceil().clamp(1.0, STEPS as f64) as usize;
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let constant = vec![0.0; evaluator.columns()];
        let mut runs = Vec::new();
        for run in 0..if rows.is_some() || disturbance > 0.0 { 1 } else { RUNS } {
            let mut point: Vec<f64> = surrogate.inputs().iter().map(|input| input.start).collect();
            point.resize(evaluator.columns(), 0.0);
            if run > 0 {
                for (index, column) in self.parameters.iter().enumerate() {
                    point[index] = drawn(&mut random, self.variables[*column].min, self.variables[*column].max);
                }
            }
            evaluator.start(&mut point);
            for (state, known) in surrogate.states().iter().enumerate().filter(|_| run > 0) {
                if let Some([min, max]) = known.range {
                    point[surrogate.inputs().len() + state] = drawn(&mut random, min, max);
                }
            }
            for (state, known) in surrogate.states().iter().enumerate() {
                point[surrogate.inputs().len() + state] += disturbance * known.nominal;
            }
            let count = rows.map_or(steps, Rows::len);
            let mut found = Vec::new();
            for row in 0..=count {
                let mut results = vec![0.0; evaluator.results()];
                evaluator.evaluate(&point, &mut results);
                results.truncate(surrogate.outputs().len());
                let is_finite = results.iter().all(|value| value.is_finite());
                found.push(is_finite.then_some(results));
                if row == count || !is_finite {
                    break;
                }
                for (index, column) in self.driven.iter().enumerate() {
                    match rows {
                        Some(rows) => point[first + index] = rows[row][*column],
                        None if row % HELD == 0 && (run, row) != (0, 0) => {
                            point[first + index] =
                                drawn(&mut random, self.variables[*column].min, self.variables[*column].max);
                        }
                        None => {}
                    }
                }
                let drive = Drive { rates: [&constant, &constant], clamp: Some(&domain) };
                if evaluator.advance(&mut point, CommunicationStep::of(step), drive).is_err() {
                    found.push(None);
                    break;
                }
            }
            runs.push(found);
        }
        runs
    }
}

/// A random number of a range.
fn drawn(random: &mut ChaCha8Rng, min: f64, max: f64) -> f64 {
    min + random.random::<f64>() * (max - min)
}

/// The smallest and the largest value of each output.
///
/// # Errors
/// [`ImportCause::NotFinite`]: the outputs after the first step, or the end of every run.
fn ranges(runs: &[Vec<Option<Vec<f64>>>], outputs: &[Output]) -> std::result::Result<Vec<[f64; 2]>, ImportError> {
    let mut ranges = vec![[f64::INFINITY, f64::NEG_INFINITY]; outputs.len()];
    for (run, rows) in runs.iter().enumerate() {
        for (row, values) in rows.iter().enumerate() {
            match values {
                Some(values) => ranges.iter_mut().zip(values).for_each(|([min, max], value)| {
                    (*min, *max) = (min.min(*value), max.max(*value));
                }),
                // later on, and from elsewhere, a model may be unstable
                None if run == 0 && row <= 1 => {
                    let message = "the outputs are not finite after the first step from the start values";
                    return Err(ImportError::not_finite(message));
                }
                None => {}
            }
        }
    }
    if runs.iter().all(|rows| rows.last().is_some_and(Option::is_none)) {
        let longest = runs.iter().map(Vec::len).max().unwrap_or(0) - 1;
        return Err(ImportError::not_finite(format!(
            "no simulation stays finite, with inputs from their ranges or along the rows of `--data`: the longest one ends after {longest} steps; \
             start values, ranges, the step or `time.stop` do not fit the model"
        )));
    }
    Ok(ranges)
}

/// A number of a sample.
#[derive(Clone, Copy, PartialEq)]
enum SampleNumber {
    State(usize),
    Column(usize),
    /// Recurrence, and position in it.
    Kept(usize, usize),
}

/// Position of a number of a sample among all of them.
fn place_among(numbers: &[SampleNumber], number: SampleNumber) -> usize {
    numbers.iter().position(|other| *other == number).unwrap_or(0)
}

/// Discrete-time surrogate: outputs first, then hidden states.
fn discrete(known: &StatefulModel, imported: Imported, metadata: Metadata) -> Result<Surrogate> {
    let StatefulModel { interface, mapping, parameters, driven, .. } = known;
    let Imported { builder, columns, recurrences, .. } = imported;
    let mut numbers: Vec<SampleNumber> = Vec::new();
    let mut problems = Problems::default();
    for (shown, name) in mapping.outputs.iter().zip(interface.outputs.keys()) {
        let number = match *shown {
            OutputSource::State(state) => SampleNumber::State(state),
            OutputSource::Column(column) => SampleNumber::Column(column),
        };
        if let (SampleNumber::State(state), true) = (number, numbers.contains(&number)) {
            let message = format!("the state `{}` is another output already", mapping.states[state].name);
            problems.add(format!("outputs.{name}.column"), message);
        }
        numbers.push(number);
    }
    interface.refuse(problems)?;
    let outputs = numbers.len();
    let hidden: Vec<SampleNumber> = (0..mapping.states.len())
        .filter(|state| !numbers.contains(&SampleNumber::State(*state)))
        .map(SampleNumber::State)
        .collect();
    numbers.extend(hidden);
    for (index, recurrence) in recurrences.iter().enumerate() {
        numbers.extend((0..recurrence.start.len()).map(|place| SampleNumber::Kept(index, place)));
    }
    let mut sources = known.sources([numbers.len() + driven.len(), numbers.len()], |state| {
        place_among(&numbers, SampleNumber::State(state))
    });
    for (index, recurrence) in recurrences.iter().enumerate() {
        let (first, count) = (place_among(&numbers, SampleNumber::Kept(index, 0)), recurrence.start.len());
        sources.resize(sources.len().max(recurrence.first + count), ColumnSource::Value(0.0));
        (0..count).for_each(|at| sources[recurrence.first + at] = ColumnSource::Input(first + at));
    }
    let width = numbers.len() + driven.len() + parameters.len();
    let (mut next, mut starts) = (Vec::new(), Vec::new());
    for number in &numbers {
        let (column, start) = match *number {
            SampleNumber::State(state) => {
                let state = &mapping.states[state];
                (columns[state.output], known.start_of(state))
            }
            SampleNumber::Column(column) => (columns[column], 0.0),
            SampleNumber::Kept(index, place) => {
                let recurrence = &recurrences[index];
                ([recurrence.next as u32, place as u32], recurrence.start[place])
            }
        };
        next.push(column);
        starts.push(start);
    }
    let graph = into_graph(builder, &sources, width, next).map_err(|error| known.refused(error))?;
    let step = interface.time.sample.unwrap_or(metadata.time_step);
    let sampling =
        Sampling { hidden: starts.split_off(outputs), direct: Vec::new(), history: [1, 1], step, support: None };
    let program = Program {
        graph: Graph::of_samples(width, Vec::new(), vec![0.0; numbers.len()], Some(graph)),
        clock: Clock::Sampled(Box::new(sampling)),
    };
    let surrogate = known.with_starts(&metadata, &program, &starts)?;
    // before the first sample an output that is no state is what the model gives for the start values
    let mut point: Vec<f64> = surrogate.inputs().iter().map(|input| input.start).collect();
    let mut evaluator = Evaluator::new(&surrogate);
    point.resize(evaluator.columns(), 0.0);
    evaluator.start(&mut point);
    let constant = vec![0.0; point.len()];
    let drive = Drive { rates: [&constant, &constant], clamp: None };
    if evaluator.advance(&mut point, CommunicationStep::of(step), drive).is_err() {
        let message = "the outputs are not finite after the first sample from the start values";
        return Err(known.refused(ImportError::not_finite(message)));
    }
    let mut given = vec![0.0; outputs];
    evaluator.evaluate(&point, &mut given);
    for ((start, number), given) in starts.iter_mut().zip(&numbers).zip(given) {
        if let SampleNumber::Column(_) = number {
            *start = given;
        }
    }
    known.with_starts(&metadata, &program, &starts)
}

/// The parameter that is the value of something at the start.
fn start_input(name: &str, description: &str, unit: &str, [min, max, start]: [f64; 3]) -> Input {
    Input {
        name: State::start_name(name),
        role: Role::Start,
        unit: unit.into(),
        description: description.into(),
        min: min.min(start),
        max: max.max(start),
        start,
        encoding: Encoding::Plain,
    }
}

/// By derivatives: the solver's tolerance is the largest that is exact enough, unless the interface wants fixed steps.
fn continuous(known: &StatefulModel, imported: Imported, metadata: Metadata, rows: Option<&Rows>) -> Result<Surrogate> {
    let StatefulModel { interface, mapping, parameters, driven, .. } = known;
    let count = mapping.states.len();
    let (p, d) = (parameters.len(), driven.len());
    let sources = known.sources([0, p], |state| p + d + state);
    let mut functions = Vec::new();
    let mut results: Vec<Given> = Vec::new();
    for shown in &mapping.outputs {
        results.push(match *shown {
            OutputSource::State(state) => Given::State(state),
            OutputSource::Column(column) => {
                functions.push(imported.columns[column]);
                Given::Function(functions.len() - 1)
            }
        });
    }
    for state in &mapping.states {
        functions.push(imported.columns[state.output]);
        results.push(Given::Function(functions.len() - 1));
    }
    let (columns, count_of_functions) = (p + d + count, functions.len());
    let graph = into_graph(imported.builder, &sources, columns, functions);
    let graph = graph.map_err(|error| known.refused(error))?;
    let plain = vec![Factor::Power { middle: 0.0, half: 1.0 }; columns];
    let nothing = Dictionary::new(&plain, count_of_functions, &[]).map_err(|source| Error::Surrogate { source })?;
    let graph = Graph::of_rates(&nothing, Some(graph), count, &results);
    let (mut states, mut starts) = (Vec::new(), Vec::new());
    for state in &mapping.states {
        let options = &interface.states[state.of];
        let start = known.start_of(state);
        let range = options.min.zip(options.max).map(|(min, max)| [min, max]);
        let [min, max] = range.unwrap_or([start; 2]);
        let largest = min.abs().max(max.abs()).max(start.abs());
        // an output keeps its name, as an FMU's state may be one as well
        let is_output = interface.outputs.contains_key(&state.name);
        states.push(State {
            name: if is_output { format!("{}_state", state.name) } else { state.name.clone() },
            unit: options.unit.clone(),
            rate_unit: surrogate::rate_unit(&options.unit),
            description: options.description.clone(),
            range,
            nominal: if largest > 0.0 { largest } else { 1.0 },
        });
        let description = format!("{} at the start", state.name);
        starts.push(start_input(&state.name, &description, &options.unit, [min, max, start]));
    }
    let metadata = Metadata { inputs: known.inputs(starts), states, ..metadata };
    if let Some(step) = interface.time.solver_step {
        return made(metadata, Program { graph, clock: Clock::Continuous(Integration::Fixed { step }) });
    }
    let longest = metadata.time_step;
    let with_tolerance = |tolerance: f64| {
        let clock = Clock::Continuous(Integration::ErrorControlled { tolerance, longest });
        made(metadata.clone(), Program { graph: graph.clone(), clock })
    };
    let mut found = None;
    for tolerance in TOLERANCES {
        let (surrogate, tighter) = (with_tolerance(tolerance)?, with_tolerance(MUCH_TIGHTER * tolerance)?);
        let runs = known.disturbed(&surrogate, rows);
        let error = difference(&runs, &known.disturbed(&tighter, rows), surrogate.outputs());
        found = Some((surrogate, runs, error));
        if error <= SOLVER_ERROR {
            break;
        }
    }
    let Some((surrogate, runs, error)) = found else { return with_tolerance(SOLVER_ERROR) };
    // runs that are not finite at their end are not compared
    let [is_first_cut, is_last_cut] =
        [runs.first(), runs.last()].map(|run| run.is_some_and(|rows| rows.last().is_some_and(Option::is_none)));
    let only_disturbed_ends = is_last_cut && !is_first_cut;
    if (error > UNSTABLE && ranges(&runs, surrogate.outputs()).is_ok()) || only_disturbed_ends {
        let message = "simulations are unstable near the start values, whatever the tolerance of the solver: the equations are \
                       stiff, or have no solution there; expected others, or other start values";
        return Err(known.refused(ImportError::not_finite(message)));
    }
    Ok(surrogate)
}

/// The largest difference of an output in two sets of simulations, relative to its range.
fn difference(one: &[Vec<Option<Vec<f64>>>], other: &[Vec<Option<Vec<f64>>>], outputs: &[Output]) -> f64 {
    let Ok(ranges) = ranges(other, outputs) else { return f64::INFINITY };
    let rows = one.iter().zip(other).flat_map(|(one, other)| one.iter().zip(other));
    let pairs = rows.filter_map(|(one, other)| one.as_ref().zip(other.as_ref()));
    pairs
        .map(|(one, other)| {
            let numbers = one.iter().zip(other).zip(&ranges);
            numbers
                .map(|((one, other), [min, max])| (one - other).abs() / (max - min).max(f64::MIN_POSITIVE))
                .fold(0.0, f64::max)
        })
        .fold(0.0, f64::max)
}
