//! Runs from states, driven by inputs: how a surrogate with states is used.

use super::{kinds::Kinds, wrong_unit};
use crate::{
    dataset::Run,
    diagnostics::{
        Problems,
        names::expected_one_of,
        numbers::{exact, from_to},
    },
    dynamics::{self, Checked, QuantityRange, Region},
    evaluation::SignalKind,
    integrate::Budget,
    multibody::{Mechanism, MotionCause, MotionError, RunStart},
    signal::{Knots, Signal, SineTerm},
    study::{Excitation, Recording, StateOptions, Study, is_angle, velocity_name},
    variable::SourceVariable,
};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use rayon::prelude::*;
use std::{
    f64::consts::{PI, TAU},
    sync::Arc,
};

/// Tolerance of runs in which the largest velocities are searched.
const ROUGH: f64 = 1e-6;

/// Largest velocity of a coordinate that hardly moves, in rad/s or m/s.
const SLOWEST: f64 = 1e-3;

/// A quantity that acts on the source.
#[derive(Clone, Debug)]
pub struct DrivingInput {
    /// Name, unit, description; the value at the start.
    pub variable: SourceVariable,
    /// Smallest value.
    pub min: f64,
    /// Largest value.
    pub max: f64,
    /// Value before a host sets one.
    pub start: f64,
    bandwidth: f64,
    excitations: Vec<Excitation>,
    /// Recording, a further kind of signal.
    recording: Option<Arc<Recording>>,
}

/// Initial states of runs, and inputs that drive them.
#[derive(Clone, Debug)]
pub struct Driven {
    /// States in the study's order; for a mechanism coordinates, velocities, actuator states.
    states: Vec<SourceVariable>,
    /// Number of actuator states, the last ones.
    actuator_states: usize,
    drivers: Vec<DrivingInput>,
    /// Initial values of the states in the source.
    start: Vec<f64>,
    /// Ranges of the states of a table in all of its rows; otherwise the study has them.
    ranges: Vec<[f64; 2]>,
    /// Where the equations of motion of a mechanism are learned.
    region: Option<Region>,
    seed: u64,
    /// Kinds of signals in runs without the study's signals.
    kinds: Kinds,
}

/// Description of an input in its source.
#[derive(Clone, Debug)]
pub struct OwnInput {
    /// Name, unit and description.
    pub variable: SourceVariable,
    /// Its range, if there is one.
    pub range: [Option<f64>; 2],
    /// Its value at the start, if there is one.
    pub start: Option<f64>,
}

impl DrivingInput {
    /// An input of the source with the study's options.
    fn new(own: OwnInput, study: &Study) -> Result<Self, Problems> {
        let mut problems = Problems::default();
        let OwnInput { variable: SourceVariable { name, unit, description, .. }, range, start } = own;
        let options = study.inputs.get(&name).cloned().unwrap_or_default();
        let recording = study.recording(&name).cloned();
        let key = format!("inputs.{name}");
        problems.extend(wrong_unit(&key, options.unit.as_deref(), &unit));
        let ends = (options.min.or(range[0]), options.max.or(range[1]));
        let (Some(min), Some(max)) = ends else {
            let elsewhere = if study.source.command.is_some() { "" } else { " in the source either" };
            problems.add(&key, format!("has no range{elsewhere}, expected `min` and `max`"));
            return Err(problems);
        };
        let start = options.start.or(start).unwrap_or(0.5 * (min + max));
        // that of the source may be outside the study's range
        let start = if options.start.is_some() { start } else { start.clamp(min.min(max), max.max(min)) };
        if min >= max {
            problems.add(&key, format!("range is empty: min {min} is not below max {max}"));
        } else if !(min..=max).contains(&start) {
            problems
                .add(format!("{key}.start"), format!("{} is outside the range {}", exact(start), from_to(min, max)));
        } else if let Some(message) = recording.as_ref().and_then(|recording| recording.unfit(&unit, [min, max])) {
            problems.add(format!("{key}.recording"), message);
        }
        if !problems.is_empty() {
            return Err(problems);
        }
        let description = options.description.as_deref().unwrap_or(&description);
        Ok(Self {
            variable: SourceVariable::new(&name, &unit, description),
            min,
            max,
            start,
            bandwidth: options.bandwidth(study.time.step),
            excitations: options.excitations().to_vec(),
            recording,
        })
    }
}

impl Driven {
    /// Finds the study's states and inputs in the mechanism; `values` are those of its parameters. If the names of its
    /// parameters and outputs are known, its equations are evaluated as well.
    ///
    /// # Errors
    /// Every name that the mechanism does not know, every unit that is not its own, every range that is empty, by dotted key.
    pub fn new(study: &Study, mechanism: &Mechanism, values: &[f64], names_are_known: bool) -> Result<Self, Problems> {
        let (drivers, mut problems) = drivers_of_mechanism(study, mechanism);
        // reported elsewhere, or for a section that is damaged
        if study.coordinates().count() == 0 || study.coordinates().any(|(name, _)| velocity_name(name).is_none()) {
            return Err(problems);
        }
        let own: Vec<&String> = study.actuator_states().map(|(name, _)| name).collect();
        if own.iter().any(|name| !mechanism.actuator_states().contains_key(*name)) {
            return Err(problems);
        }
        for name in mechanism.actuator_states().keys().filter(|name| !own.contains(name)) {
            problems.add("states", format!("no `{name}`, expected every actuator state of the mechanism"));
        }
        let names: Vec<&str> = study.coordinates().map(|(name, _)| name.as_str()).collect();
        let start = match start_of_mechanism(study, mechanism, values) {
            Ok(start) => start,
            Err(more) => {
                problems.extend(more);
                Vec::new()
            }
        };
        problems.extend(starts_outside(study, &start, |_, name, state| state.goes_around(name)));
        let region = region(study, mechanism, values);
        if problems.is_empty() && names_are_known {
            problems.extend(problems_of_equations(study, mechanism, &region, &start));
        }
        if problems.is_empty() {
            let mut states = coordinates_and_velocities(&names);
            let of_actuators = mechanism.actuator_states().iter();
            states.extend(of_actuators.map(|(name, state)| SourceVariable::new(name, &state.unit, &state.description)));
            let (ranges, kinds, actuator_states) = (Vec::new(), Kinds::default(), own.len());
            let (region, seed) = (Some(region), study.seed);
            Ok(Self { states, actuator_states, drivers, start, ranges, region, seed, kinds })
        } else {
            Err(problems)
        }
    }

    /// The study's inputs and the states of an FMU or program, with the values that they have at the start, or none where these are unknown.
    ///
    /// # Errors
    /// Every range that is not known or empty, every unit that is not the source's, by dotted key.
    pub fn of_states(
        study: &Study,
        states: Vec<(SourceVariable, Option<f64>)>,
        inputs: Vec<OwnInput>,
    ) -> Result<Self, Problems> {
        let drivers = drivers(study, inputs)?;
        let start = states
            .iter()
            .zip(study.states.values())
            .map(|((_, start), options)| {
                let middle = 0.5 * (options.min + options.max);
                start.filter(|start| (options.min..=options.max).contains(start)).unwrap_or(middle)
            })
            .collect();
        let states = states.into_iter().map(|(state, _)| state).collect();
        let (ranges, kinds) = (Vec::new(), Kinds::default());
        Ok(Self { states, actuator_states: 0, drivers, start, ranges, region: None, seed: study.seed, kinds })
    }

    /// The coordinates of a table and then their rates, with the values at the start of its first run and their ranges in all rows, and the
    /// study's inputs.
    ///
    /// # Errors
    /// Every range of an input that is empty, by dotted key.
    pub fn of_table(
        study: &Study,
        states: Vec<SourceVariable>,
        (start, ranges): (Vec<f64>, Vec<[f64; 2]>),
        inputs: Vec<OwnInput>,
    ) -> Result<Self, Problems> {
        let (drivers, kinds) = (drivers(study, inputs)?, Kinds::default());
        Ok(Self { states, actuator_states: 0, drivers, start, ranges, region: None, seed: study.seed, kinds })
    }

    /// Sets the kinds of signals.
    pub fn set_kinds(&mut self, kinds: Kinds) {
        self.kinds = kinds;
    }

    /// The range of a state in a table.
    pub fn range(&self, state: usize) -> Option<[f64; 2]> {
        self.ranges.get(state).copied()
    }

    /// Inputs that act on the source, in its order.
    pub fn drivers(&self) -> &[DrivingInput] {
        &self.drivers
    }

    /// Initial states in the source.
    pub fn start(&self) -> &[f64] {
        &self.start
    }

    /// Where the equations of motion of a mechanism are learned.
    pub fn region(&self) -> Option<&Region> {
        self.region.as_ref()
    }

    /// The inputs.
    pub fn variables(&self) -> Vec<SourceVariable> {
        self.drivers.iter().map(|driver| driver.variable.clone()).collect()
    }

    /// The states; of a mechanism coordinates, velocities, actuator states.
    pub fn states(&self) -> &[SourceVariable] {
        &self.states
    }

    /// The parameters that are the states' values at the start.
    pub fn starts(&self) -> impl Iterator<Item = SourceVariable> {
        self.states.iter().map(|SourceVariable { name, unit, .. }| {
            let description = format!("{name} at the start");
            SourceVariable::new(&metafmu_runtime::State::start_name(name), unit, &description)
        })
    }

    /// Values of the inputs in the run with these parameters, the starts being the last of them: shape `[times, inputs]`. They follow
    /// from the parameters and the study's seed, so that a run that is repeated has the same ones.
    pub fn inputs(&self, parameters: &[f64], times: &[f64]) -> Vec<f64> {
        let point = parameters.iter().fold(self.seed, |hash, value| {
            (hash.rotate_left(17) ^ value.to_bits()).wrapping_mul(0x9e37_79b9_7f4a_7c15)
        });
        let mut random = ChaCha8Rng::seed_from_u64(point);
        // recordings of several inputs begin at the same share of their lengths: in one table, at the same time
        let mut of_recordings = ChaCha8Rng::seed_from_u64(point);
        of_recordings.set_stream(1);
        let place = of_recordings.random();
        let (kind, corner) = self.kinds.of(parameters);
        // of sources without known states, a decay follows signals in about the first third, an instant that is no row's
        let is_unknown = self.states.is_empty();
        let signals_end = if is_unknown { 0.333_71 * times.last().copied().unwrap_or(0.0) } else { 0.0 };
        let columns: Vec<Vec<f64>> = self
            .drivers
            .iter()
            .enumerate()
            .map(|(input, driver)| {
                let zero = SignalKind::zero([driver.min, driver.max], driver.start);
                match kind {
                    SignalKind::Signals => driver.values(times, place, &mut random),
                    SignalKind::Zero => vec![zero; times.len()],
                    SignalKind::Ends => vec![if corner.is_high(input) { driver.max } else { driver.min }; times.len()],
                    SignalKind::Decay => {
                        let mut values = driver.values(times, place, &mut random);
                        let pairs = times.iter().zip(&mut values).filter(|(time, _)| **time >= signals_end);
                        pairs.for_each(|(_, value)| *value = zero);
                        values
                    }
                }
            })
            .collect();
        (0..times.len()).flat_map(|row| columns.iter().map(move |column| column[row])).collect()
    }

    /// Smallest and largest value of each coordinate, each velocity, then each actuator state in runs of the mechanism with these
    /// parameters and times.
    ///
    /// # Errors
    /// A sentence, as [`Mechanism::states_from`].
    pub fn reached(&self, mechanism: &Mechanism, runs: &[(&[f64], &[f64])]) -> Result<Vec<[f64; 2]>, MotionError> {
        let region =
            self.region.as_ref().ok_or_else(|| MotionError::new(MotionCause::Unsuitable, "expected a mechanism"))?;
        let reached = runs.par_iter().map(|(parameters, times)| {
            let values: Vec<f64> = region
                .constants
                .iter()
                .map(|(name, value)| {
                    let varied = region.parameters.iter().position(|range| range.name == *name);
                    varied.map_or(*value, |index| parameters[index])
                })
                .collect();
            let launch = self.launch(parameters, times)?;
            let integration = (ROUGH, &Budget::default());
            let states = mechanism.states_from(&values, launch.start(), &launch.signals, times, integration)?;
            let width = states.len() / times.len();
            Ok((0..width)
                .map(|k| {
                    let column = states.iter().skip(k).step_by(width);
                    column.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], x| [low.min(*x), high.max(*x)])
                })
                .collect())
        });
        let reached: Vec<Vec<[f64; 2]>> = reached.collect::<Result<_, MotionError>>()?;
        let all = reached
            .into_iter()
            .reduce(|all, ranges| all.into_iter().zip(ranges).map(|([a, b], [c, d])| [a.min(c), b.max(d)]).collect());
        Ok(all.unwrap_or_default())
    }

    /// Ranges of the coordinates' velocities, and of actuator states: the study's own, or 1.5 times the largest values
    /// in these runs of the mechanism, in both directions.
    ///
    /// # Errors
    /// As [`reached`](Self::reached).
    pub fn velocities(&self, study: &Study, mechanism: &Mechanism, runs: &[Run]) -> Result<Vec<[f64; 2]>, MotionError> {
        let of_actuators = study.actuator_states().map(|(_, state)| state.range());
        let own: Vec<Option<[f64; 2]>> =
            study.coordinates().map(|(_, state)| state.velocity_range).chain(of_actuators).collect();
        if own.iter().all(Option::is_some) {
            return Ok(own.into_iter().flatten().collect());
        }
        let runs: Vec<_> = runs.iter().map(|run| (&run.parameters[..], &run.times[..])).collect();
        let reached = self.reached(mechanism, &runs)?;
        let rates = reached.iter().skip(study.coordinates().count());
        let largest = rates.map(|[low, high]| (1.5 * high.max(-low)).max(SLOWEST));
        Ok(own.into_iter().zip(largest).map(|(own, largest)| own.unwrap_or([-largest, largest])).collect())
    }

    /// Start of the run with these parameters, and its signals.
    pub(super) fn launch<'a>(&'a self, parameters: &'a [f64], times: &[f64]) -> Result<Launch<'a>, MotionError> {
        let count = self.states.len();
        let (_, starts) = parameters.split_at(parameters.len() - count);
        let n = (count - self.actuator_states) / 2;
        let (positions, rest) = starts.split_at(n);
        let (rates, actuator_states) = rest.split_at(n);
        let inputs = self.inputs(parameters, times);
        Ok(Launch {
            names: self.states[..n].iter().map(|state| state.name.as_str()).collect(),
            state: [positions, rates, actuator_states],
            signals: (0..self.drivers.len())
                .map(|column| {
                    let values: Vec<f64> = inputs.iter().skip(column).step_by(self.drivers.len()).copied().collect();
                    let knots = Knots::new(times.to_vec(), values);
                    knots
                        .map(Signal::Linear)
                        .map_err(|error| MotionError::new(MotionCause::Unsuitable, error.to_string()))
                })
                .collect::<Result<_, MotionError>>()?,
        })
    }
}

/// Inputs of a mechanism with the study's options, and what is wrong with them.
fn drivers_of_mechanism(study: &Study, mechanism: &Mechanism) -> (Vec<DrivingInput>, Problems) {
    let mut problems = Problems::default();
    let known: Vec<&str> = mechanism.inputs().keys().map(String::as_str).collect();
    for name in study.inputs.keys().filter(|name| !known.contains(&name.as_str())) {
        let message = format!("the mechanism has no input `{name}`, {}", expected_one_of(name, &known));
        problems.add(format!("inputs.{name}"), message);
    }
    let mut drivers = Vec::new();
    for (name, own) in mechanism.inputs() {
        let variable = SourceVariable::new(name, &own.unit, &own.description);
        let own = OwnInput { variable, range: [Some(own.min), Some(own.max)], start: Some(own.start) };
        match DrivingInput::new(own, study) {
            Ok(driver) => drivers.push(driver),
            Err(more) => problems.extend(more),
        }
    }
    (drivers, problems)
}

/// Key of the mechanism in a study.
fn source_key(study: &Study) -> &'static str {
    if study.source.mechanism.is_some() { "source.mechanism" } else { "source.system" }
}

/// Values of the study's states at the start of a mechanism whose parameters have these values.
fn start_of_mechanism(study: &Study, mechanism: &Mechanism, values: &[f64]) -> Result<Vec<f64>, Problems> {
    let mut problems = Problems::default();
    let names: Vec<&str> = study.coordinates().map(|(name, _)| name.as_str()).collect();
    match mechanism.check_positions(values, &names).map(|()| mechanism.reduced(values, &names)) {
        Ok(Ok(reduced)) => {
            let coordinates = reduced.start().0.iter().chain(reduced.start().1).copied();
            let starts = reduced.model().actuator_starts();
            let own = study.actuator_states().filter_map(|(name, _)| mechanism.actuator_states().get_index_of(name));
            return Ok(coordinates.chain(own.map(|index| starts[index])).collect());
        }
        // problems of a part of the mechanism are reported with its line
        Ok(Err(error)) if is_of_acting_part(&error) => {
            problems.add(source_key(study), mechanism.located(error).to_string());
        }
        Ok(Err(error)) => problems.add("states", error),
        Err(found) => problems.add_section("states", found),
    }
    Err(problems)
}

/// Coordinates that start outside of their ranges, of those that are not good otherwise.
fn starts_outside(study: &Study, start: &[f64], is_good: impl Fn(usize, &String, &StateOptions) -> bool) -> Problems {
    let mut problems = Problems::default();
    for (k, ((name, state), start)) in study.coordinates().zip(start).enumerate() {
        if !is_good(k, name, state) && state.min < state.max && !(state.min..=state.max).contains(start) {
            let range = from_to(state.min, state.max);
            let message = format!("the mechanism starts at {}, which is outside the range {range}", exact(*start));
            problems.add(format!("states.{name}"), message);
        }
    }
    problems
}

/// Problems of the equations of a mechanism in a region, if its ranges are not empty.
fn problems_of_equations(study: &Study, mechanism: &Mechanism, region: &Region, start: &[f64]) -> Problems {
    let mut problems = Problems::default();
    if !region.coordinates.iter().chain(&region.parameters).all(|range| range.min < range.max) {
        return problems;
    }
    if let Err(error) = dynamics::reach(mechanism, region, false, study.seed)
        && error.cause == MotionCause::Singular
    {
        let expected = "expected ranges without singular positions: narrow them, or those of `parameters`";
        problems.add("states", format!("{error}, {expected}"));
        return problems;
    }
    match dynamics::check(mechanism, region, study.seed) {
        Ok(Checked { idle, is_periodic, .. }) => {
            problems.extend(starts_outside(study, start, |k, name, state| !state.goes_around(name) || is_periodic[k]));
            for name in idle {
                let message = "acts neither on the equations of motion nor on an output; states have separate parameters for \
                               their initial values";
                problems.add(format!("parameters.{name}"), message);
            }
        }
        Err(error) => {
            let is_output = error.section() == Some("outputs");
            let of_output = error.part.clone().filter(|_| is_output);
            let other = if is_of_acting_part(&error) { source_key(study) } else { "states" };
            problems.add(of_output.unwrap_or_else(|| other.into()), error);
        }
    }
    problems
}

/// Sections of a mechanism file with formulas that act on its motion.
const ACTING: [&str; 4] = ["forces", "actuators", "drivers", "states"];

fn is_of_acting_part(error: &MotionError) -> bool {
    error.section().is_some_and(|section| ACTING.contains(&section))
}

/// The study's inputs as a source has them.
fn drivers(study: &Study, inputs: Vec<OwnInput>) -> Result<Vec<DrivingInput>, Problems> {
    let (mut problems, mut drivers) = (Problems::default(), Vec::new());
    for own in inputs {
        match DrivingInput::new(own, study) {
            Ok(driver) => drivers.push(driver),
            Err(more) => problems.extend(more),
        }
    }
    if problems.is_empty() { Ok(drivers) } else { Err(problems) }
}

/// Start of a run, and its signals.
pub(super) struct Launch<'a> {
    /// Names of the coordinates.
    names: Vec<&'a str>,
    /// Coordinates, velocities and actuator states at the start.
    state: [&'a [f64]; 3],
    pub signals: Vec<Signal>,
}

impl Launch<'_> {
    pub fn start(&self) -> RunStart<'_> {
        let [positions, rates, actuator_states] = self.state;
        RunStart { coordinates: &self.names, positions, rates, actuator_states }
    }
}

fn coordinates_and_velocities(names: &[&str]) -> Vec<SourceVariable> {
    let coordinates = names.iter().map(|name| {
        let unit = if is_angle(name) { "rad" } else { "m" };
        SourceVariable::new(name, unit, &format!("coordinate {name}"))
    });
    let velocities = names.iter().map(|name| {
        let unit = if is_angle(name) { "rad/s" } else { "m/s" };
        SourceVariable::new(&velocity_name(name).unwrap_or_default(), unit, &format!("derivative of {name}"))
    });
    coordinates.chain(velocities).collect()
}

/// Region in which the study wants the equations of motion; `values` are those of the mechanism's parameters.
fn region(study: &Study, mechanism: &Mechanism, values: &[f64]) -> Region {
    let names = mechanism.parameters().keys().cloned();
    Region {
        coordinates: study.coordinates().map(|(name, state)| QuantityRange::new(name, state.min, state.max)).collect(),
        parameters: study
            .parameters
            .iter()
            .map(|(name, range)| QuantityRange::new(name, range.min, range.max))
            .collect(),
        constants: names.zip(values.iter().copied()).collect(),
        outputs: study.outputs.keys().cloned().collect(),
        velocities: Vec::new(),
        inputs: Vec::new(),
    }
}

impl DrivingInput {
    /// A signal at some times, within the range; a recorded one begins at a place from 0 to 1.
    fn values(&self, times: &[f64], place: f64, random: &mut ChaCha8Rng) -> Vec<f64> {
        let kinds = self.excitations.len() + usize::from(self.recording.is_some());
        let kind = match (random.random_range(0..kinds), &self.recording) {
            (drawn, Some(recording)) if drawn == self.excitations.len() => return recording.stretch(place, times),
            (drawn, _) => self.excitations[drawn],
        };
        let (middle, half) = (0.5 * (self.min + self.max), 0.5 * (self.max - self.min));
        let stop = times.last().copied().unwrap_or(0.0);
        let mut shares = self.signal(kind, stop, random);
        times.iter().map(|&time| (middle + half * shares(time)).clamp(self.min, self.max)).collect()
    }

    /// A signal from -1 to 1 over time.
    fn signal(&self, kind: Excitation, stop: f64, random: &mut ChaCha8Rng) -> Box<dyn FnMut(f64) -> f64> {
        let bandwidth = self.bandwidth;
        let half_period = 0.5 / bandwidth;
        match kind {
            Excitation::Multisine => sines(10, 0.05 * bandwidth, bandwidth, random),
            Excitation::Random => sines(100, 0.0, bandwidth, random),
            Excitation::Chirp => {
                let phase = TAU * random.random::<f64>();
                Box::new(move |t| (phase + PI * bandwidth * t * t / stop.max(f64::MIN_POSITIVE)).sin())
            }
            Excitation::Steps => {
                let instants = instants(half_period, stop, random);
                let levels: Vec<f64> = instants.iter().map(|_| random_level(random)).collect();
                Box::new(move |t| levels[instants.partition_point(|instant| *instant <= t) - 1])
            }
            Excitation::Binary => {
                let mut instants = vec![0.0];
                while instants[instants.len() - 1] < stop {
                    let periods = f64::from(random.random_range(1..=6u32));
                    instants.push(instants[instants.len() - 1] + periods * half_period);
                }
                let first = if random.random::<bool>() { 1.0 } else { -1.0 };
                Box::new(move |t| {
                    let passed = instants.partition_point(|instant| *instant <= t);
                    if passed % 2 == 1 { first } else { -first }
                })
            }
            Excitation::Ramps => {
                let instants = instants(half_period, stop, random);
                let levels: Vec<f64> = instants.iter().map(|_| random_level(random)).collect();
                let knots = Knots::new(instants, levels).map(Signal::Linear);
                let signal = knots.unwrap_or(Signal::Constant(0.0));
                Box::new(move |t| signal.value(t))
            }
            Excitation::Spline => {
                let count = (stop / half_period).ceil() as usize + 4;
                let levels: Vec<f64> = (0..count).map(|_| random_level(random)).collect();
                // a uniform cubic B-spline stays within its levels
                Box::new(move |t| {
                    let place = (t / half_period).clamp(0.0, (levels.len() - 4) as f64);
                    let index = (place as usize).min(levels.len() - 4);
                    let s = place - index as f64;
                    let weights = [
                        (1.0 - s).powi(3),
                        3.0 * s.powi(3) - 6.0 * s * s + 4.0,
                        -3.0 * s.powi(3) + 3.0 * s * s + 3.0 * s + 1.0,
                        s.powi(3),
                    ];
                    weights.iter().zip(&levels[index..]).map(|(weight, level)| weight * level).sum::<f64>() / 6.0
                })
            }
        }
    }
}

/// A number from -1 to 1.
fn random_level(random: &mut ChaCha8Rng) -> f64 {
    2.0 * random.random::<f64>() - 1.0
}

/// Times at which levels begin, up to a stop time; random, with a mean of half a period between them.
fn instants(half_period: f64, stop: f64, random: &mut ChaCha8Rng) -> Vec<f64> {
    let mut instants = vec![0.0];
    while instants[instants.len() - 1] < stop {
        let duration = half_period * (0.5 + random.random::<f64>());
        instants.push(instants[instants.len() - 1] + duration);
    }
    instants
}

/// A sum of sines of random frequencies and phases, with one amplitude for which the sum rarely leaves -1 to 1.
fn sines(count: usize, from: f64, to: f64, random: &mut ChaCha8Rng) -> Box<dyn FnMut(f64) -> f64> {
    let amplitude = (2.0 / count as f64).sqrt() * 0.45;
    let sines = (0..count).map(|_| SineTerm {
        amplitude,
        frequency: from + (to - from) * random.random::<f64>(),
        phase: TAU * random.random::<f64>(),
    });
    let signal = Signal::Multisine { offset: 0.0, sines: sines.collect() };
    Box::new(move |t| signal.value(t))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Result, source::Simulation};
    use std::path::Path;

    /// The crane with a recording in its folder, and options of its force.
    fn crane(force: &str, recording: &str) -> Result<(Study, Simulation)> {
        let folder = tempfile::tempdir().unwrap();
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/dynamics");
        std::fs::copy(root.join("crane.toml"), folder.path().join("crane.toml")).unwrap();
        std::fs::write(folder.path().join("r.csv"), recording).unwrap();
        let text = format!(
            "name = \"s\"\nstructure = \"dynamics\"\n[source]\nmechanism = \"crane.toml\"\n[time]\nstop = 2\nstep = 0.1\n[states]\n\
             rail.position = {{ min = -5, max = 5 }}\nrope.angle = {{ min = -1, max = 1 }}\n[inputs]\nforce = {{ {force} }}\n\
             [outputs]\nx = {{}}\n"
        );
        let study = Study::parse(&text, &folder.path().join("s.toml"))?;
        let simulation = Simulation::new(&study)?;
        Ok((study, simulation))
    }

    /// A force that grows by 1 N a second for 10 s.
    const RAMP: &str = "time,force\n100,-5\n103,-2\n110,5\n";

    #[test]
    fn a_recorded_signal_drives_a_run_from_a_random_place_on() {
        let (study, simulation) = crane("recording = \"r.csv\"", RAMP).unwrap();
        let driven = simulation.driven().unwrap();
        let times = study.time.grid();
        let begins: Vec<f64> = (0..200)
            .map(|run| {
                let inputs = driven.inputs(&[f64::from(run)], &times);
                assert_eq!(inputs, driven.inputs(&[f64::from(run)], &times));
                for (value, time) in inputs.iter().zip(&times) {
                    assert!((value - inputs[0] - time).abs() < 1e-9, "{value} at {time} s");
                }
                inputs[0]
            })
            .collect();
        let [least, most] = [f64::min, f64::max].map(|of| begins.iter().copied().fold(begins[0], of));
        // of 200 runs that begin from 0 to 8 s
        assert!((-5.0..-4.8).contains(&least) && (2.8..=3.0).contains(&most), "{least} {most}");
    }

    #[test]
    fn a_recorded_signal_is_one_kind_among_others() {
        let (study, simulation) = crane("recording = \"r.csv\", excitation = [\"binary\"]", RAMP).unwrap();
        let is_binary = |run: u32| {
            let inputs = simulation.driven().unwrap().inputs(&[f64::from(run)], &study.time.grid());
            inputs.iter().all(|value| value.abs() == 10.0)
        };
        // of 200 runs half: 5 standard deviations
        let binary = (0..200).filter(|run| is_binary(*run)).count();
        assert!((65..=135).contains(&binary), "{binary}");
    }

    #[test]
    fn a_recording_that_does_not_fit_is_refused_with_file_and_key() {
        for (force, recording, says) in [
            ("recording = \"x.csv\"", RAMP, "s.toml:12: inputs.force.recording: "),
            ("recording = \"r.csv\"", "time,u\n0,1\n2,1\n", "r.csv:1: no column `force`, expected it among time, u"),
            (
                "recording = \"r.csv\", max = 4",
                RAMP,
                "r.csv:4: column `force`: 5, expected -10 to 4, the input's range",
            ),
            ("recording = \"r.csv\"", "time,force [kN]\n0,1\n2,1\n", "column `force`: unit `kN`, expected `N`"),
            (
                "recording = \"r.csv\"",
                "time,force\n0,1\n1.9,1\n",
                "r.csv: 1.9 s, expected at least 2 s, the length of a run",
            ),
            ("recording = \"r.csv\", bandwidth = 1", RAMP, "inputs.force.bandwidth: belongs to kinds of `excitation`"),
        ] {
            let message = crane(force, recording).unwrap_err().to_string();
            assert!(message.contains("s.toml:12: inputs.force."), "{message}");
            assert!(message.contains(says) && message.lines().count() == 1, "{message}");
        }
    }

    /// Problem of a slide whose spring loses its length in the range, or whose actuator has an effort that is NaN there.
    fn problem_of_slide(joint: &str, effort: &str) -> String {
        let folder = tempfile::tempdir().unwrap();
        let mechanism = format!(
            "bodies.block = {{ mass = 1, inertia = 1 }}\noutputs.x = {{ measure = \"block.x\" }}\n\
             joints.{joint} = {{ type = \"prismatic\", between = [\"ground\", \"block\"], axis = [1, 0] }}\n\
             springs.rope = {{ between = [\"ground\", \"block\"], stiffness = 10, rest = 0.5 }}\n\
             actuators.motor = {{ coordinate = \"{joint}.position\", effort = \"{effort}\" }}\n\
             initial.{joint}.position = 1\n"
        );
        std::fs::write(folder.path().join("slide.toml"), mechanism).unwrap();
        let text = format!(
            "name = \"s\"\nstructure = \"dynamics\"\n[source]\nmechanism = \"slide.toml\"\n[time]\nstop = 2\nstep = 0.1\n[states]\n\
             {joint}.position = {{ min = -1, max = 1.5 }}\n[outputs]\nx = {{}}\n"
        );
        let study = Study::parse(&text, &folder.path().join("s.toml")).unwrap();
        Simulation::new(&study).map(|_| ()).unwrap_err().to_string()
    }

    #[test]
    fn the_name_of_a_part_does_not_decide_where_a_problem_is() {
        for joint in ["guide", "reinforced", "drivers"] {
            let message = problem_of_slide(joint, "0");
            assert!(message.contains("s.toml:8: states: at ") && message.contains("`springs.rope`"), "{message}");
            let message = problem_of_slide(joint, &format!("sqrt({joint}.position - 0.9)"));
            assert!(message.contains("s.toml:4: source.mechanism: "), "{message}");
            assert!(message.contains("of `actuators.motor` is NaN"), "{message}");
        }
    }

    #[test]
    fn a_recordings_content_counts_for_the_digest() {
        let digest = |recording: &str| crane("recording = \"r.csv\"", recording).unwrap().0.sampling_digest();
        assert_eq!(digest(RAMP), digest(RAMP));
        assert_ne!(digest(RAMP), digest(&RAMP.replace("103,-2", "103,-1")));
    }
}
