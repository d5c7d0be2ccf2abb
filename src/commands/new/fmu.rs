//! A study of an FMU, from the FMU's description of itself.

use super::{DISCRETE, RUNS, StudyTarget, bandwidth, key, quoted, rest, sampling};
use metafmu::{
    Error, Result,
    export::is_own,
    fmi::{
        ModelDescription,
        host::{InterfaceKind, NO_EQUATIONS, describe, element_names},
        model_description::{Causality, DefaultExperiment, FmiVersion, ScalarVariable, Variability},
    },
    source::fmu::variables::{range, recordable, varied},
};
use metafmu_runtime::{BuiltIn, State};
use std::{fmt::Write, path::Path};

/// Largest number of rows of a run, unless the study is changed.
const MAX_ROWS: usize = 500;
/// Rows of a run if the FMU has no step size.
const ROWS: usize = 200;
/// Largest numbers of varied parameters, with a range and without.
const VARIED: (usize, usize) = (8, 4);
/// Half the width of a range that is missing in the FMU, relative to the start value.
const AROUND: f64 = 0.1;
/// Largest number of numbers that become outputs.
const OUTPUTS: usize = 1000;
/// Largest number of unused variables that are listed.
const LISTED: usize = 40;
/// Number of states at which the FMU's equations are evaluated.
const STATES: usize = 5000;

pub fn study(target: &StudyTarget, file: &Path) -> Result<String> {
    let (description, interface) = describe(file, None)?;
    let (parameters, outputs) = (parameters(&description), outputs(&description));
    let nothing_chosen = chosen(&description).is_empty();
    let what = match (&parameters, nothing_chosen) {
        (None, _) => "neither a real parameter with a start value nor an input with a range: there is nothing to vary",
        (_, true) => "no real variable to be an output",
        _ => "",
    };
    let Some(parameters) = parameters.filter(|_| what.is_empty()) else {
        return Err(Error::Stale { path: file.to_owned(), message: format!("the FMU has {what}") });
    };
    let (name, file) = (target.name, target.path_from(file));
    let Times { stop, step, communication_step } = Times::new(description.default_experiment.unwrap_or_default());
    let communication = communication_step.map_or(String::new(), |step| {
        format!("step = {step:?}                # s, between two communication points; what the FMU suggests\n")
    });
    // the FMU's own method integrates else
    let integration = match interface {
        InterfaceKind::CoSimulation => "",
        InterfaceKind::ModelExchange => {
            "# tolerance = 1e-8          # of the integration, relative to the states; the FMU's else\n"
        }
    };
    let text = format!(
        "# Made by `metafmu new {name} --fmu {file}`; build it with `metafmu build {name}.toml`.

name = \"{name}\"    # names the outputs and the FMU
description = {}
seed = 1                    # everything random follows from it

[source]
fmu = {}    # relative to this file
{communication}{integration}# time_limit = 60           # s; a run that takes longer, crashes or fails
# retries = 1               # how often a failed run is repeated, before it is left out and reported
# max_failed = 0.1          # share of the runs that may fail
# constants = {{ NAME = VALUE }}    # values of other variables than those that vary; their start values else

[time]                      # rows of a run: 0, step, 2 step, ..., stop
stop = {stop:?}                  # s
step = {step:?}                 # s
margin = 0.05               # training runs are longer by this share of `stop`; without it, errors are largest at the end

# Parameters and inputs of the FMU, constant during a run: fixed parameters of the surrogate. `variability = \"tunable\"` lets a
# host change one during a run, \"continuous\" makes it an input; then outputs are as if it had been so from the start.
[parameters]
{}
[outputs]
{}{}
{}{}",
        quoted(description.description.as_deref().unwrap_or_default()),
        quoted(&file),
        parameters,
        outputs,
        arrays(&description),
        sampling(),
        rest(RUNS, stop / step),
    );
    Ok(match description.fmi_version {
        FmiVersion::V2 => text,
        // it is meant to replace the FMU
        FmiVersion::V3 => text.replacen("\nfmi = \"2\"", "\nfmi = \"3\"", 1),
    })
}

/// A study of the FMU's equations: its states, continuous inputs, and parameters with a range.
pub fn study_of_states(target: &StudyTarget, file: &Path) -> Result<String> {
    let (description, _) = describe(file, Some(InterfaceKind::ModelExchange))?;
    let refuse = |what: String| Err(Error::Stale { path: file.to_owned(), message: format!("the FMU {what}") });
    let indicators = description.indicator_count();
    if indicators > 0 {
        return refuse(format!("has {indicators} event indicators; {NO_EQUATIONS}"));
    }
    let Some(states) = description.states().filter(|states| !states.is_empty()) else {
        return refuse("offers no scalar continuous states: a study without --structure dynamics may do".into());
    };
    if chosen(&description).is_empty() {
        return refuse("has no real variable to be an output".into());
    }
    let (name, file) = (target.name, target.path_from(file));
    let Times { stop, step, .. } = Times::new(description.default_experiment.unwrap_or_default());
    let mut text = format!(
        "# Made by `metafmu new {name} --fmu {file} --structure dynamics`; build it with `metafmu build {name}.toml`.

name = \"{name}\"    # names the outputs and the FMU
description = {}
seed = 1                    # everything random follows from it
structure = \"dynamics\"      # the FMU has states, and inputs drive it

[source]
fmu = {}    # relative to this file; asked for its equations by model exchange
# tolerance = 1e-8          # of the runs that the surrogate is compared with; the FMU's else
# constants = {{ NAME = VALUE }}    # values of other variables than those that vary; their start values else

[time]                      # rows of the runs that it is tested with
stop = {stop:?}                  # s
step = {step:?}                 # s

[states]                    # every continuous state, and the range in which the equations are learned
",
        quoted(description.description.as_deref().unwrap_or_default()),
        quoted(&file),
    );
    // writing to a string does not fail
    let names_of_starts: Vec<String> = states.iter().map(|state| State::start_name(&state.name)).collect();
    for state in states {
        let start = state.kind.as_real().and_then(|real| real.start).unwrap_or(0.0);
        let (range, comment) = match known_range(&description, state) {
            Some(range) => (range, "of the FMU"),
            None => ((-guess(start), guess(start)), "a guess: how far does it go?"),
        };
        let ((min, max), unit) = (range, description.unit_of(state).unwrap_or_default());
        let hint = if unit == "rad" { "; an angle that goes around: a range of 2 pi and periodic = true" } else { "" };
        let start = start.clamp(min, max);
        let spread = 0.1 * (max - min);
        let starts = [(start - spread).max(min), (start + spread).min(max)];
        let _ = writeln!(
            text,
            "{} = {{ min = {min:?}, max = {max:?}, start = {starts:?} }}    # {comment}{hint}",
            key(&state.name)
        );
    }
    let inputs = driving(&description).filter(|input| input.variability == Variability::Continuous);
    // a start of a state is a parameter of the surrogate anyway
    let is_start = |variable: &ScalarVariable| names_of_starts.contains(&variable.name);
    text += &(signals(&description, inputs, bandwidth(stop, step), false) + &with_a_range(&description, is_start));
    let _ = write!(
        text,
        "\n[outputs]\n{}\n[sampling]\nstates = {STATES}               # at which the FMU evaluates its equations\ntest_runs = 20              # random \
         starts, parameters and inputs\n\n{}",
        outputs(&description),
        rest(STATES, 1.0),
    );
    Ok(match description.fmi_version {
        FmiVersion::V2 => text,
        FmiVersion::V3 => text.replacen("\nfmi = \"2\"", "\nfmi = \"3\"", 1),
    })
}

/// A study of the FMU's samples: its outputs, driving inputs, and parameters with a range.
pub fn study_of_samples(target: &StudyTarget, file: &Path) -> Result<String> {
    let (description, interface) = describe(file, None)?;
    let refuse = |what: &str| Err(Error::Stale { path: file.to_owned(), message: format!("the FMU {what}") });
    let inputs: Vec<&ScalarVariable> = driving(&description).collect();
    if inputs.is_empty() {
        return refuse("has no real scalar input: nothing drives it; a study without --structure may do");
    }
    if chosen(&description).is_empty() {
        return refuse("has no real variable to be an output");
    }
    let (name, file) = (target.name, target.path_from(file));
    let Times { stop, step, communication_step } = Times::new(description.default_experiment.unwrap_or_default());
    let communication = communication_step.map_or(String::new(), |step| {
        format!("step = {step:?}                # s, between two communication points; what the FMU suggests\n")
    });
    let text = format!(
        "# Made by `metafmu new {name} --fmu {file} --structure discrete`; build it with `metafmu build {name}.toml`.

name = \"{name}\"    # names the outputs and the FMU
description = {}
seed = 1                    # everything random follows from it
structure = \"discrete\"      # discrete-time, driven by the inputs

[source]
fmu = {}    # relative to this file; runs by {interface}
{communication}# time_limit = 60           # s; a run that takes longer, crashes or fails
# retries = 1               # how often a failed run is repeated, before it is left out and reported
# max_failed = 0.1          # share of the runs that may fail
# constants = {{ NAME = VALUE }}    # values of other variables than those that vary; their start values else

[time]
stop = {stop:?}                  # s, of every run
step = {step:?}                 # s; the sample time, over which inputs are held
{}{}
[outputs]
{}
[sampling]
runs = 30                   # to train and to choose a model with
test_runs = 10              # never part of training

{DISCRETE}",
        quoted(description.description.as_deref().unwrap_or_default()),
        quoted(&file),
        signals(&description, inputs.into_iter(), bandwidth(stop, step), true),
        with_a_range(&description, |_| false),
        outputs(&description),
    );
    Ok(match description.fmi_version {
        FmiVersion::V2 => text,
        FmiVersion::V3 => format!("{text}\n[export]\nfmi = \"3\"\n"),
    })
}

/// Inputs that can have signals.
fn driving(description: &ModelDescription) -> impl Iterator<Item = &ScalarVariable> {
    let is_input = |variable: &&ScalarVariable| variable.causality == Causality::Input && varied(variable).is_ok();
    description.variables.iter().filter(is_input)
}

/// `[inputs]`. Their values before a run count with samples. They are written where they are not zero, the usual value
/// of a model at rest.
fn signals<'a>(
    description: &ModelDescription,
    inputs: impl Iterator<Item = &'a ScalarVariable>,
    bandwidth: f64,
    has_past: bool,
) -> String {
    let mut text = String::new();
    for input in inputs {
        let own_start = input.kind.as_real().and_then(|real| real.start).unwrap_or(0.0);
        let (range, mut comments) = match known_range(description, input) {
            Some(range) => (range, vec![]),
            None => ((-guess(own_start), guess(own_start)), vec!["range: a guess"]),
        };
        let (min, max) = range;
        let start = if has_past && own_start != 0.0 {
            comments.push("start: what it was before a run, the FMU's own; 0 if the FMU begins at rest without it");
            format!(", start = {own_start:?}")
        } else {
            String::new()
        };
        let comment = if comments.is_empty() { String::new() } else { format!("    # {}", comments.join("; ")) };
        let kinds = "[\"multisine\", \"steps\", \"spline\"]";
        // writing to a string does not fail
        let _ = writeln!(
            text,
            "{} = {{ min = {min:?}, max = {max:?}{start}, bandwidth = {bandwidth:?}, excitation = {kinds} }}{comment}",
            key(&input.name),
        );
    }
    let head =
        "\n[inputs]                    # `bandwidth` in Hz and kinds of `excitation` of runs; docs/dynamics.md\n";
    if text.is_empty() { text } else { format!("{head}{text}") }
}

/// `[parameters]`: those with a range in the FMU that are not excluded.
fn with_a_range(description: &ModelDescription, is_left_out: impl Fn(&ScalarVariable) -> bool) -> String {
    let varied = |variable: &&ScalarVariable| {
        variable.causality == Causality::Parameter && varied(variable).is_ok() && !is_left_out(variable)
    };
    let with_range = description.variables.iter().filter(varied);
    let with_range = with_range.filter_map(|variable| Some((variable, known_range(description, variable)?)));
    let mut text = String::from("\n[parameters]                # those with a range in the FMU\n");
    for (parameter, (min, max)) in with_range.take(VARIED.0) {
        // writing to a string does not fail
        let _ = writeln!(text, "{} = {{ min = {min:?}, max = {max:?} }}", key(&parameter.name));
    }
    text
}

/// Half the width of a range around zero for a state that starts there.
fn guess(start: f64) -> f64 {
    (2.0 * start.abs()).max(1.0)
}

/// Times of a run.
struct Times {
    stop: f64,
    step: f64,
    /// If it is not the step between two rows.
    communication_step: Option<f64>,
}

impl Times {
    fn new(experiment: DefaultExperiment) -> Self {
        let stop = experiment.stop.unwrap_or(1.0) - experiment.start.unwrap_or(0.0);
        let stop = if stop > 0.0 && stop.is_finite() { stop } else { 1.0 };
        let coarse = Self { stop, step: short(stop / ROWS as f64), communication_step: None };
        let Some(step) = experiment.step_size.filter(|step| *step > 0.0 && *step <= stop) else { return coarse };
        let steps = (stop / step).round();
        if (steps * step - stop).abs() > 1e-9 * stop || steps > 1e8 {
            return coarse;
        }
        let steps = steps as usize;
        let per_row = (steps.div_ceil(MAX_ROWS)..=steps).find(|count| steps.is_multiple_of(*count)).unwrap_or(1);
        let communication_step = (per_row > 1).then_some(step);
        Self { stop, step: short(step * per_row as f64), communication_step }
    }
}

/// A number without digits from rounding.
pub(super) fn short(number: f64) -> f64 {
    format!("{number:.11e}").parse().unwrap_or(number)
}

/// Those with a range, else the first ones, are varied; the others are listed.
fn parameters(description: &ModelDescription) -> Option<String> {
    let offered = |variable: &&ScalarVariable| {
        matches!(variable.causality, Causality::Parameter | Causality::Input) && varied(variable).is_ok()
    };
    let all: Vec<&ScalarVariable> = description.variables.iter().filter(offered).collect();
    let with_range = |variable: &&&ScalarVariable| known_range(description, variable).is_some();
    let guessed = |variable: &&&ScalarVariable| {
        variable.causality == Causality::Parameter && around_start(description, variable).is_some()
    };
    let mut chosen: Vec<&ScalarVariable> = all.iter().filter(with_range).copied().take(VARIED.0).collect();
    if chosen.is_empty() {
        chosen = all.iter().filter(guessed).copied().take(VARIED.1).collect();
    }
    if chosen.is_empty() {
        return None;
    }
    let (mut text, mut listed) = (String::new(), 0);
    for variable in &all {
        let is_chosen = chosen.iter().any(|other| other.name == variable.name);
        listed += usize::from(!is_chosen);
        if !is_chosen && listed > LISTED {
            continue;
        }
        let unit = description.unit_of(variable).map_or(String::new(), |unit| format!(", unit = {}", quoted(unit)));
        let start = variable.kind.as_real().and_then(|real| real.start);
        let mut about = Vec::new();
        let bounds = known_range(description, variable).or_else(|| {
            about.push(match start {
                Some(0.0) => "the FMU gives no range and starts with 0: a guess".to_owned(),
                _ => "the FMU gives no range: a tenth around its start value".to_owned(),
            });
            around_start(description, variable)
        });
        let bounds = match bounds {
            Some((min, max)) => format!("min = {min:?}, max = {max:?}"),
            None => {
                about = vec!["the FMU gives neither a range nor a start value".to_owned()];
                "min = ..., max = ...".into()
            }
        };
        if variable.causality == Causality::Input {
            about.push("an input of the FMU".into());
        }
        about.extend(variable.description.iter().filter(|text| !text.is_empty()).map(|text| one_line(text)));
        let mark = if is_chosen { "" } else { "# " };
        let about = if about.is_empty() { String::new() } else { format!("    # {}", about.join("; ")) };
        // writing to a string does not fail
        let _ = writeln!(text, "{mark}{} = {{ {bounds}{unit} }}{about}", key(&variable.name));
    }
    more(&mut text, listed);
    Some(text)
}

/// The outputs, or else the internal variables, of real numbers; arrays as their elements.
fn outputs(description: &ModelDescription) -> String {
    let chosen = chosen(description);
    let (mut text, mut listed) = (String::new(), 0);
    for variable in description.variables.iter().filter(|variable| recordable(variable).is_ok()) {
        let is_chosen = chosen.iter().any(|other| other.name == variable.name);
        let unit = description.unit_of(variable).unwrap_or_default();
        let mark = if is_chosen { "" } else { "# " };
        let about = variable.description.as_deref().filter(|text| !text.is_empty());
        let about = about.map_or(String::new(), |text| format!("    # {}", one_line(text)));
        let shape = description.shape(variable).unwrap_or_default();
        let shown = if is_chosen { usize::MAX } else { LISTED.saturating_sub(listed) };
        for name in element_names(&variable.name, &shape).take(shown) {
            let _ = writeln!(text, "{mark}{} = {{ unit = {} }}{about}", key(&name), quoted(unit));
        }
        listed += if is_chosen { 0 } else { size(&shape) };
    }
    more(&mut text, listed);
    text
}

/// The variables that become outputs: the FMU's outputs, up to a limit; a study has at least one. Variables that every FMU of
/// metafmu has are none.
fn chosen(description: &ModelDescription) -> Vec<&ScalarVariable> {
    let is_own = is_own(description);
    let is_built_in =
        |variable: &ScalarVariable| is_own && BuiltIn::ALWAYS.iter().any(|known| known.name() == variable.name);
    let is_fitting = |variable: &&ScalarVariable| recordable(variable).is_ok() && !is_built_in(variable);
    let fitting = || description.variables.iter().filter(is_fitting);
    let mut left = OUTPUTS;
    let fits = |variable: &&ScalarVariable| {
        let rest = left.checked_sub(size(&description.shape(variable).unwrap_or_default()));
        left = rest.unwrap_or(left);
        rest.is_some()
    };
    let outputs = fitting().filter(|variable| variable.causality == Causality::Output);
    let chosen: Vec<&ScalarVariable> = outputs.filter(fits).collect();
    let first = || fitting().find(|variable| size(&description.shape(variable).unwrap_or_default()) <= OUTPUTS);
    if chosen.is_empty() { first().into_iter().collect() } else { chosen }
}

fn size(shape: &[u64]) -> usize {
    shape.iter().map(|&size| size as usize).product()
}

/// Outputs that are arrays in the FMU, as arrays of the surrogate's.
fn arrays(description: &ModelDescription) -> String {
    let mut text = String::new();
    for variable in chosen(description) {
        let shape = description.shape(variable).unwrap_or_default();
        let names: Vec<String> = element_names(&variable.name, &shape).map(|name| quoted(&name)).collect();
        if variable.causality == Causality::Output && shape.len() == 1 && names.len() > 1 {
            let _ = writeln!(text, "{} = [{}]", key(&variable.name), names.join(", "));
        }
    }
    if text.is_empty() {
        text
    } else {
        format!("\n[arrays]                    # outputs that FMI 3.0 offers as arrays as well\n{text}")
    }
}

fn more(text: &mut String, listed: usize) {
    if listed > LISTED {
        let _ = writeln!(text, "# and {} more in the FMU", listed - LISTED);
    }
}

/// Range of a variable in the FMU.
fn known_range(description: &ModelDescription, variable: &ScalarVariable) -> Option<(f64, f64)> {
    let (min, max) = range(description, variable);
    min.zip(max).filter(|(min, max)| min.is_finite() && max.is_finite() && min < max && max - min < 1e300)
}

/// A tenth around the start value, 1 around zero, within the limits of the FMU.
fn around_start(description: &ModelDescription, variable: &ScalarVariable) -> Option<(f64, f64)> {
    let start = variable.kind.as_real().and_then(|real| real.start)?;
    let (min, max) = range(description, variable);
    let width = if start == 0.0 { 1.0 } else { AROUND * start.abs() };
    let ends = (short(start - width), short(start + width));
    let ends = (ends.0.max(min.unwrap_or(f64::MIN)), ends.1.min(max.unwrap_or(f64::MAX)));
    Some(ends).filter(|(min, max)| min.is_finite() && max.is_finite() && min < max)
}

fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_follow_the_suggested_experiment_with_few_rows() {
        let times = |stop: Option<f64>, step_size: Option<f64>| {
            let Times { stop, step, communication_step } =
                Times::new(DefaultExperiment { start: None, stop, step_size, tolerance: None });
            (stop, step, communication_step)
        };
        assert_eq!(times(Some(2.0), Some(0.01)), (2.0, 0.01, None));
        assert_eq!(times(Some(2.0), Some(0.001)), (2.0, 0.004, Some(0.001)));
        assert_eq!(times(Some(0.3), Some(0.1)), (0.3, 0.1, None));
        assert_eq!(times(Some(5.0), None), (5.0, 0.025, None));
        assert_eq!(times(None, None), (1.0, 0.005, None));
        assert_eq!(times(Some(1.0), Some(0.3)), (1.0, 0.005, None));
    }
}
