//! A study of a mechanism's equations of motion.

use super::{control, describe, quoted};
use metafmu::{Error, Result, diagnostics::Problems, multibody::Mechanism, study::is_angle};
use std::{f64::consts::PI, fmt::Write, path::Path};

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
stop = 10.0                 # s
step = 0.02                 # s

[states]                    # coordinates, their ranges, and where tests start; velocities follow, and are not limited
",
        quoted(&mechanism.description().description),
        quoted(&file),
    );
    // writing to a string does not fail
    for coordinate in &coordinates {
        let ([low, high], rate) = (coordinate.reach, coordinate.rate);
        let unit = if is_angle(&coordinate.name) { "rad" } else { "m" };
        let reach = 0.1 * (high - low);
        let start = [coordinate.start - reach, coordinate.start + reach].map(|end| end.clamp(low, high));
        let spread = 0.5 * rate.abs().max(1.0);
        let goes_around = is_angle(&coordinate.name) && high - low > 2.0 * PI - 1e-6;
        let comment = if goes_around {
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
            "{name} = {{ min = {min:?}, max = {max:?}, bandwidth = 1.0, excitation = [\"multisine\", \"steps\", \"spline\"] }}"
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
