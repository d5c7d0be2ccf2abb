//! A study of a mechanism's equations of motion.

use super::{Proposal, StudyTarget, control, describe, quoted, say};
use metafmu::{
    Result,
    dynamics::{self, Checked, QuantityRange, Region},
    multibody::{FreeCoordinate, Mechanism},
    pipeline::trial,
    study::is_angle,
    systems::System,
};
use std::{
    collections::HashMap,
    f64::consts::{PI, TAU},
    fmt::Write,
    path::Path,
};

/// A study of a mechanism file.
pub fn of_mechanism(target: &StudyTarget, file: &Path) -> Result<Proposal> {
    let mechanism = Mechanism::load(file)?;
    let file = target.path_from(file);
    let source = format!(
        "mechanism = {}    # relative to this file
# Parameters of the mechanism that are not varied here: their defaults there, or constants = {{ NAME = VALUE }}",
        quoted(&file),
    );
    propose(target, &mechanism, &format!("--mechanism {file}"), &source)
}

/// A study of the mechanism that describes a built-in system.
pub fn of_system(target: &StudyTarget, system: &System) -> Result<Proposal> {
    let mechanism = Mechanism::parse(system.mechanism, Path::new(system.name))?;
    let source = format!(
        "system = {}    # built in
# Its quantities that are not varied here: their defaults, or constants = {{ NAME = VALUE }}",
        quoted(system.name),
    );
    propose(target, &mechanism, &format!("--system {}", system.name), &source)
}

/// Parts of the length of the runs that are tried until no run fails.
const SHORTER: [f64; 5] = [1.0, 0.3, 0.1, 0.03, 0.01];

/// A study of all free coordinates and inputs, the parameters with a range and all outputs. The ranges contain no
/// singular positions, and the runs are short enough to meet none.
fn propose(target: &StudyTarget, mechanism: &Mechanism, option: &str, source: &str) -> Result<Proposal> {
    let coordinates = mechanism
        .free_coordinates()
        .map_err(|error| metafmu::Error::Study { problems: vec![mechanism.located(error)] })?;
    describe(mechanism, control()?);
    let stop = duration(&coordinates);
    let mut ranges = NonsingularRanges::new(mechanism, coordinates);
    if let Some(why) = &ranges.narrowed {
        say(format_args!("ranges are narrowed to positions that are not singular: {why}"));
    }
    let outputs = mechanism.outputs().iter().map(|output| output.name.clone()).collect();
    // a build reports the problems of the equations, with their place
    let checked = dynamics::check(mechanism, &ranges.region(outputs), SEED).unwrap_or_default();
    let text = |ranges: &NonsingularRanges, share: f64| {
        study(target.name, mechanism, (ranges, &checked), (stop, share * stop), [option, source])
    };
    if ranges.coordinates.iter().zip(&checked.is_periodic).any(|(one, periodic)| goes_around(one) && !periodic) {
        let reached = target.parse(&text(&ranges, 1.0)).ok();
        let reached = reached.and_then(|study| trial::reached(&study, mechanism)).unwrap_or_default();
        ranges.widen(&checked.is_periodic, &reached);
    }
    let study = |share: f64| text(&ranges, share);
    let mut proposal = None;
    for share in SHORTER {
        let text = study(share);
        let trial = target.parse(&text).and_then(|study| trial::attempt(&study, control()?));
        let is_good = trial.as_ref().map_or(true, |trial| trial.failures.is_empty());
        let found = Proposal { text, trial: Some(trial) };
        if is_good {
            return Ok(found);
        }
        // if shorter runs fail as well, the longest one is as good
        proposal.get_or_insert(found);
    }
    Ok(proposal.unwrap_or_else(|| Proposal { text: study(1.0), trial: None }))
}

/// The text of a study. Speeds and bandwidths follow from the length of runs of which nothing is known yet.
fn study(
    name: &str,
    mechanism: &Mechanism,
    (ranges, checked): (&NonsingularRanges, &Checked),
    (usual, stop): (f64, f64),
    [option, source]: [&str; 2],
) -> String {
    let stop: f64 = format!("{stop:.3e}").parse().unwrap_or(stop);
    let mut text = format!(
        "# Made by `metafmu new {name} {option} --structure dynamics`; build it with `metafmu build {name}.toml`.

name = \"{name}\"    # names the outputs and the FMU
description = {}
seed = 1                    # everything random follows from it
structure = \"dynamics\"      # the FMU has states, and inputs drive it

[source]
{source}

[time]                      # rows of the runs that it is tested with
stop = {stop:<20?} # s
step = {:<20?} # s

[states]                    # coordinates, their ranges, and where tests start; velocities follow
",
        quoted(&mechanism.description().description),
        stop / 500.0,
    );
    // writing to a string does not fail
    for (k, coordinate) in ranges.coordinates.iter().enumerate() {
        let ([low, high], rate) = (coordinate.reach, coordinate.rate);
        let unit = if is_angle(&coordinate.name) { "rad" } else { "m" };
        // wider ranges of turns are what motions reach
        let reach = 0.1 * if goes_around(coordinate) { TAU } else { high - low };
        let start = [coordinate.start - reach, coordinate.start + reach].map(|end| end.clamp(low, high));
        let spread = 0.5 * rate.abs().max(10.0 / usual);
        let is_periodic = checked.is_periodic.get(k).copied().unwrap_or(is_angle(&coordinate.name));
        let comment = match (is_periodic, goes_around(coordinate)) {
            _ if checked.is_used.get(k) == Some(&false) => format!("{unit}; nothing depends on it: valid everywhere"),
            (true, true) => "a full turn: all angles".into(),
            (false, true) => "rad; forces differ a turn later: the surrogate is valid there".into(),
            _ if ranges.is_narrowed(k) => {
                format!("{unit}; the surrogate is valid there, and beyond are singular positions")
            }
            _ => format!("{unit}; the surrogate is valid there"),
        };
        let _ = writeln!(
            text,
            "{} = {{ min = {low:?}, max = {high:?}, start = [{:?}, {:?}], velocity = [{:?}, {:?}] }}    # {comment}",
            quoted(&coordinate.name),
            start[0],
            start[1],
            rate - spread,
            rate + spread,
        );
    }
    for (name, state) in mechanism.actuator_states() {
        // the start of the file, for the defaults of all parameters
        let start = ranges.actuator_starts.get(name).copied().unwrap_or_default();
        let unit = if state.unit.is_empty() { "no unit" } else { &state.unit };
        let _ =
            writeln!(text, "{} = {{ start = [{start:?}, {start:?}] }}    # {unit}; an actuator state", quoted(name));
    }
    if !mechanism.inputs().is_empty() {
        text += "\n[inputs]                    # `bandwidth` in Hz and kinds of `excitation` of test runs; docs/dynamics.md\n";
    }
    for (name, input) in mechanism.inputs() {
        let (min, max) = (input.min, input.max);
        let _ = writeln!(
            text,
            "{name} = {{ min = {min:?}, max = {max:?}, bandwidth = {:?}, excitation = [\"multisine\", \"steps\", \"spline\"] }}",
            10.0 / usual
        );
    }
    text += "\n[parameters]\n";
    // the others are constants
    for QuantityRange { name, min, max } in &ranges.parameters {
        if checked.idle.contains(name) {
            let _ = writeln!(text, "# {name}: acts on the start only, for which the FMU has separate parameters");
        } else {
            let _ = writeln!(text, "{name} = {{ min = {min:?}, max = {max:?} }}");
        }
    }
    text += "\n[outputs]                   # positions, velocities, accelerations, energies, forces\n";
    for output in mechanism.outputs() {
        let _ = writeln!(text, "{} = {{ unit = {} }}", output.name, quoted(&output.unit));
    }
    text += "\n[sampling]\ntest_runs = 20              # random starts, parameters and inputs\n";
    text
}

/// Ranges of a study, none of whose configurations is singular.
struct NonsingularRanges {
    coordinates: Vec<FreeCoordinate>,
    parameters: Vec<QuantityRange>,
    /// Range of each coordinate that moves alone.
    alone: Vec<[f64; 2]>,
    /// Values of all parameters that are not varied.
    constants: Vec<(String, f64)>,
    /// Actuator states at the start.
    actuator_starts: HashMap<String, f64>,
    /// The singular position that narrows them.
    narrowed: Option<String>,
}

/// Shares of ranges above which narrowing the coordinates suffices, and the smallest ones.
const ENOUGH: f64 = 0.1;
const LEAST: f64 = 0.01;

/// Number of bisections of a share, and the factor that leaves a margin.
const BISECTIONS: u32 = 7;
const SPARE: f64 = 0.9;

/// Turns of an angle with a range at most: a motion that reaches more has no end.
const MOST_TURNS: f64 = 20.0;

impl NonsingularRanges {
    /// Ranges of each coordinate that moves alone. They are narrowed about the start if positions are singular where
    /// all coordinates are elsewhere, or other parameters have other values.
    fn new(mechanism: &Mechanism, coordinates: Vec<FreeCoordinate>) -> Self {
        let own = mechanism.parameters().iter();
        let parameters = own.clone().filter_map(|(name, p)| Some(QuantityRange::new(name, p.min?, p.max?))).collect();
        let constants: Vec<(String, f64)> = own.clone().map(|(name, p)| (name.clone(), p.default)).collect();
        let alone = coordinates.iter().map(|coordinate| coordinate.reach).collect();
        let defaults: Vec<f64> = own.map(|(_, parameter)| parameter.default).collect();
        let starts = mechanism.build(&defaults).map_or_else(|_| Vec::new(), |(model, _)| model.actuator_starts());
        let actuator_starts = mechanism.actuator_states().keys().cloned().zip(starts).collect();
        let mut ranges = Self { coordinates, parameters, alone, constants, actuator_starts, narrowed: None };
        let all = vec![1.0; ranges.coordinates.len()];
        let singular = |ranges: &Self, shares: &[f64], of_parameters: f64| {
            dynamics::reach(mechanism, &ranges.scaled(shares, of_parameters).region(Vec::new()), true, SEED).err()
        };
        let Some(why) = singular(&ranges, &all, 1.0) else { return ranges };
        let count = all.len();
        let alike = |share: f64, of_parameters: f64| singular(&ranges, &vec![share; count], of_parameters).is_none();
        let (mut shares, of_parameters) = match largest(|share| alike(share, 1.0)).filter(|share| *share >= ENOUGH) {
            Some(share) => (vec![SPARE * share; count], 1.0),
            None => match largest(|share| alike(share, share)) {
                Some(share) => (vec![SPARE * share; count], SPARE * share),
                // not because of the ranges: a build reports the reason
                None => return ranges,
            },
        };
        for k in 0..count {
            let before = std::mem::replace(&mut shares[k], 1.0);
            if singular(&ranges, &shares, of_parameters).is_some() {
                shares[k] = before;
            }
        }
        ranges = ranges.scaled(&shares, of_parameters);
        ranges.narrowed = Some(why.message);
        ranges
    }

    /// Shares of the ranges, about the start and the parameters' defaults.
    fn scaled(&self, shares: &[f64], of_parameters: f64) -> Self {
        let about = |middle: f64, [low, high]: [f64; 2], share: f64| match share {
            1.0 => [low, high],
            // no more digits than anybody needs
            _ => [low, high].map(|end| {
                let end = middle + share * (end - middle);
                format!("{end:.3e}").parse().unwrap_or(end)
            }),
        };
        let coordinates = self.coordinates.iter().zip(shares).map(|(coordinate, share)| FreeCoordinate {
            reach: about(coordinate.start, coordinate.reach, *share),
            ..coordinate.clone()
        });
        let default =
            |name: &str| self.constants.iter().find(|(known, _)| known == name).map_or(0.0, |(_, value)| *value);
        let parameters = self.parameters.iter().map(|QuantityRange { name, min, max }| {
            let [min, max] = about(default(name), [*min, *max], of_parameters);
            QuantityRange::new(name, min, max)
        });
        Self {
            coordinates: coordinates.collect(),
            parameters: parameters.collect(),
            alone: self.alone.clone(),
            constants: self.constants.clone(),
            actuator_starts: self.actuator_starts.clone(),
            narrowed: self.narrowed.clone(),
        }
    }

    fn is_narrowed(&self, k: usize) -> bool {
        self.coordinates[k].reach != self.alone[k]
    }

    /// Gives angles whose forces differ a turn later whole turns about the start, as many as have what runs reach.
    fn widen(&mut self, is_periodic: &[bool], reached: &[[f64; 2]]) {
        let coordinates = self.coordinates.iter_mut().zip(&mut self.alone).zip(is_periodic).zip(reached);
        for (((coordinate, alone), is_periodic), [low, high]) in coordinates {
            let [before, behind] = coordinate.reach.map(|end| (end - coordinate.start).abs());
            let is_about_start = (before - behind).abs() < 1e-6;
            let farthest = (high - coordinate.start).max(coordinate.start - low);
            let turns = (farthest / (SPARE * PI)).ceil();
            if goes_around(coordinate) && !is_periodic && is_about_start && (1.0..=MOST_TURNS).contains(&turns) {
                coordinate.reach = [coordinate.start - turns * PI, coordinate.start + turns * PI];
                *alone = coordinate.reach;
            }
        }
    }

    fn region(&self, outputs: Vec<String>) -> Region {
        let range = |coordinate: &FreeCoordinate| {
            QuantityRange::new(&coordinate.name, coordinate.reach[0], coordinate.reach[1])
        };
        Region {
            coordinates: self.coordinates.iter().map(range).collect(),
            parameters: self.parameters.clone(),
            constants: self.constants.clone(),
            outputs,
            velocities: Vec::new(),
            inputs: Vec::new(),
        }
    }
}

/// The largest share that is good; none if the smallest is not.
fn largest(is_good: impl Fn(f64) -> bool) -> Option<f64> {
    if !is_good(LEAST) {
        return None;
    }
    let (mut good, mut bad) = (LEAST, 1.0);
    for _ in 0..BISECTIONS {
        let middle = 0.5 * (good + bad);
        *(if is_good(middle) { &mut good } else { &mut bad }) = middle;
    }
    Some(good)
}

/// Seed of the study that is written.
const SEED: u64 = 1;

/// Returns true if it is an angle without limits.
fn goes_around(FreeCoordinate { name, reach: [low, high], .. }: &FreeCoordinate) -> bool {
    is_angle(name) && high - low > TAU - 1e-6
}

/// Length of the runs, in s. It is four times the time that the fastest angle takes for a turn with its initial
/// velocity or acceleration, rounded up to a power of ten, but 10 s at most.
fn duration(coordinates: &[FreeCoordinate]) -> f64 {
    let turn = |coordinate: &FreeCoordinate| {
        let FreeCoordinate { rate, acceleration, .. } = coordinate;
        (TAU / rate.abs()).min((2.0 * TAU / acceleration).sqrt())
    };
    let fastest = coordinates.iter().filter(|coordinate| goes_around(coordinate)).map(turn).fold(2.5, f64::min);
    10f64.powi((4.0 * fastest).log10().ceil().clamp(-9.0, 1.0) as i32)
}
