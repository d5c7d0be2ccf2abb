//! A study of a mechanism's equations of motion.

use super::{Target, control, describe, quoted};
use metafmu::{
    Error, Result,
    diagnostics::Problems,
    dynamics::{self, Range, Region},
    multibody::{FreeCoordinate, Mechanism},
    study::is_angle,
    systems::System,
};
use std::{f64::consts::TAU, fmt::Write, path::Path};

/// A study of a mechanism file.
pub fn of_mechanism(target: &Target, file: &Path) -> Result<String> {
    let mechanism = Mechanism::load(file)?;
    let file = target.path_from(file);
    let source = format!(
        "mechanism = {}    # relative to this file
# Parameters of the mechanism that are not varied here: their defaults there, or constants = {{ NAME = VALUE }}",
        quoted(&file),
    );
    study(target.name, &mechanism, &format!("--mechanism {file}"), &source)
}

/// A study of the mechanism that describes a built-in system.
pub fn of_system(name: &str, system: &System) -> Result<String> {
    let mechanism = Mechanism::parse(system.mechanism, Path::new(system.name))?;
    let source = format!(
        "system = {}    # built in
# Its quantities that are not varied here: their defaults, or constants = {{ NAME = VALUE }}",
        quoted(system.name),
    );
    study(name, &mechanism, &format!("--system {}", system.name), &source)
}

/// A study of all free coordinates and inputs, and of the parameters with a range and the outputs that can be learned.
fn study(name: &str, mechanism: &Mechanism, option: &str, source: &str) -> Result<String> {
    let coordinates = match mechanism.free_coordinates() {
        Ok(coordinates) => coordinates,
        Err(message) => {
            let refused = mechanism.refuse(Problems::one("joints", message));
            return Err(refused.err().unwrap_or(Error::Interrupted));
        }
    };
    describe(mechanism, control()?);
    let learned = Learned::new(mechanism, &coordinates);
    let stop = duration(&coordinates);
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
    for coordinate in &coordinates {
        let ([low, high], rate) = (coordinate.reach, coordinate.rate);
        let unit = if is_angle(&coordinate.name) { "rad" } else { "m" };
        let reach = 0.1 * (high - low);
        let start = [coordinate.start - reach, coordinate.start + reach].map(|end| end.clamp(low, high));
        let spread = 0.5 * rate.abs().max(10.0 / stop);
        let comment = if goes_around(coordinate) {
            "a full turn: all angles".into()
        } else {
            format!("{unit}; the surrogate is valid there")
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
    if !mechanism.inputs().is_empty() {
        text += "\n[inputs]                    # `bandwidth` in Hz and kinds of `excitation` of test runs; docs/dynamics.md\n";
    }
    for (name, input) in mechanism.inputs() {
        let (min, max) = (input.min, input.max);
        let _ = writeln!(
            text,
            "{name} = {{ min = {min:?}, max = {max:?}, bandwidth = {:?}, excitation = [\"multisine\", \"steps\", \"spline\"] }}",
            10.0 / stop
        );
    }
    text += "\n[parameters]\n";
    for (name, parameter) in mechanism.parameters() {
        // the others are constants
        let (Some(min), Some(max)) = (parameter.min, parameter.max) else { continue };
        if learned.is_idle(name) {
            let _ =
                writeln!(text, "# {name}: acts on nothing but the start, for which the FMU has parameters of its own");
        } else {
            let _ = writeln!(text, "{name} = {{ min = {min:?}, max = {max:?} }}");
        }
    }
    text += "\n[outputs]                   # positions, velocities, accelerations, energies, forces\n";
    for output in mechanism.outputs() {
        if learned.outputs.contains(&output.name) {
            let _ = writeln!(text, "{} = {{ unit = {} }}", output.name, quoted(&output.unit));
        } else {
            let _ = writeln!(
                text,
                "# {}: cannot be learned with states: it is not linear in velocities and inputs",
                output.name
            );
        }
    }
    text += "\n[sampling]\ntest_runs = 20              # random starts, parameters and inputs\n";
    Ok(text)
}

/// What of a mechanism can be learned.
struct Learned {
    outputs: Vec<String>,
    /// Parameters on which neither the equations nor these outputs depend.
    idle: Vec<String>,
}

impl Learned {
    /// Asks the mechanism. What is wrong with the equations themselves is told by a build, with its place.
    fn new(mechanism: &Mechanism, coordinates: &[FreeCoordinate]) -> Self {
        let range = |name: &str, [min, max]: [f64; 2]| Range { name: name.into(), min, max };
        let varied = mechanism.parameters().iter().filter_map(|(name, p)| Some(range(name, [p.min?, p.max?])));
        let region = |outputs: Vec<String>| Region {
            coordinates: coordinates.iter().map(|coordinate| range(&coordinate.name, coordinate.reach)).collect(),
            parameters: varied.clone().collect(),
            constants: mechanism.parameters().iter().map(|(name, p)| (name.clone(), p.default)).collect(),
            outputs,
            velocities: Vec::new(),
            inputs: Vec::new(),
        };
        let check = |outputs: Vec<String>| dynamics::check(mechanism, &region(outputs), SEED);
        let mut outputs: Vec<String> = mechanism.outputs().iter().map(|output| output.name.clone()).collect();
        if check(Vec::new()).is_ok() {
            outputs.retain(|output| check(vec![output.clone()]).is_ok());
        }
        let idle = check(outputs.clone()).unwrap_or_default();
        Self { outputs, idle }
    }

    fn is_idle(&self, parameter: &str) -> bool {
        self.idle.iter().any(|name| name == parameter)
    }
}

/// Of the study that is written.
const SEED: u64 = 1;

/// Whether it is an angle that can be any number.
fn goes_around(FreeCoordinate { name, reach: [low, high], .. }: &FreeCoordinate) -> bool {
    is_angle(name) && high - low > TAU - 1e-6
}

/// Length of the runs, in s: four times as long as the fastest angle takes for a turn with its velocity or acceleration at the start, as
/// the next power of ten, but 10 s at most.
fn duration(coordinates: &[FreeCoordinate]) -> f64 {
    let turn = |coordinate: &FreeCoordinate| {
        let FreeCoordinate { rate, acceleration, .. } = coordinate;
        (TAU / rate.abs()).min((2.0 * TAU / acceleration).sqrt())
    };
    let fastest = coordinates.iter().filter(|coordinate| goes_around(coordinate)).map(turn).fold(2.5, f64::min);
    10f64.powi((4.0 * fastest).log10().ceil().clamp(-9.0, 1.0) as i32)
}
