//! A study of a mechanism's equations of motion.

use super::{control, describe, quoted};
use metafmu::{
    Error, Result,
    diagnostics::Problems,
    multibody::{FreeCoordinate, Mechanism},
    study::is_angle,
};
use std::{f64::consts::TAU, fmt::Write, path::Path};

/// A study of all free coordinates, inputs, parameters with a range, and outputs.
pub fn study(name: &str, file: &Path) -> Result<String> {
    let mechanism = Mechanism::load(file)?;
    let coordinates = match mechanism.free_coordinates() {
        Ok(coordinates) => coordinates,
        Err(message) => {
            let refused = mechanism.refuse(Problems::one("joints", message));
            return Err(refused.err().unwrap_or(Error::Interrupted));
        }
    };
    describe(&mechanism, control()?);
    let file = file.display().to_string();
    let stop = duration(&coordinates);
    let mut text = format!(
        "# Made by `metafmu new {name} --mechanism {file} --structure dynamics`; build it with `metafmu build {name}.toml`.

name = \"{name}\"    # names the outputs and the FMU
description = {}
seed = 1                    # everything random follows from it
structure = \"dynamics\"      # the FMU has states, and inputs drive it

[source]
mechanism = {}    # relative to this file
# Parameters of the mechanism that are not varied here: their defaults there, or constants = {{ NAME = VALUE }}

[time]                      # rows of the runs that it is tested with
stop = {stop:<20?} # s
step = {:<20?} # s

[states]                    # coordinates, their ranges, and where tests start; velocities follow, and are not limited
",
        quoted(&mechanism.description().description),
        quoted(&file),
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
        // the others are constants, or values at the start, for which the FMU has parameters of its own
        if let (Some(min), Some(max)) = (parameter.min, parameter.max) {
            let _ = writeln!(text, "{name} = {{ min = {min:?}, max = {max:?} }}");
        }
    }
    text += "\n[outputs]                   # positions, velocities, accelerations, energies\n";
    for output in mechanism.outputs() {
        let _ = writeln!(text, "{} = {{ unit = {} }}", output.name, quoted(&output.unit));
    }
    text += "\n[sampling]\ntest_runs = 20              # random starts, parameters and inputs\n";
    Ok(text)
}

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
