//! A study of a program, from the program's description of itself.

use super::{DISCRETE, RUNS, StudyTarget, bandwidth, fmu::short, key, quoted, rest, sampling};
use crate::commands::interrupt;
use indexmap::IndexMap;
use metafmu::{
    Error, Result,
    source::program::{ProgramCommand, ProgramDescription, ProgramQuantity, describe},
    study::{RESULT, RunForm, StudyStructure},
};
use std::{
    fmt::Write,
    path::{Path, PathBuf},
    time::Duration,
};

/// Time that the program has for its description.
const LIMIT: Duration = Duration::from_secs(60);
/// Length of a run that the program does not give, in s.
const STOP: f64 = 1.0;
/// Rows of a run if the program gives no step.
const ROWS: f64 = 200.0;
/// States at which the program evaluates its equations.
const STATES: usize = 5000;

pub fn study(target: &StudyTarget, command: &[String], structure: StudyStructure) -> Result<String> {
    let refuse = |message: String| Error::Stale { path: PathBuf::from(command.join(" ")), message };
    if command.iter().any(|argument| argument.contains(RESULT)) {
        let message = "a program that is started for each run does not describe itself: docs/command-sources.md has a study of one";
        return Err(refuse(message.into()));
    }
    let arguments = command.iter().map(|argument| of_study(target, argument)).collect::<Vec<String>>();
    let program = ProgramCommand::new(arguments.clone(), target.folder);
    let description = describe(&program, LIMIT, interrupt::flag())?.ok_or(Error::Interrupted)?;
    let proposal = ProgramProposal { description, structure };
    let missing = proposal.missing();
    if !missing.is_empty() {
        return Err(refuse(missing.join("; ")));
    }
    Ok(proposal.text(target.name, command, &arguments))
}

/// An argument as the study has it: a file is relative to the study's folder.
fn of_study(target: &StudyTarget, argument: &str) -> String {
    let file = Path::new(argument);
    if file.is_file() { target.path_from(file) } else { argument.to_owned() }
}

/// Offer of a program for a structure.
struct ProgramProposal {
    description: ProgramDescription,
    structure: StudyStructure,
}

impl ProgramProposal {
    /// Needs of the structure that the program does not meet.
    fn missing(&self) -> Vec<String> {
        let ProgramDescription { parameters, inputs, states, outputs, .. } = &self.description;
        let no_range = |quantities: &IndexMap<String, ProgramQuantity>, section: &str| {
            let open = quantities.iter().filter(|(_, quantity)| quantity.range().is_none());
            open.map(|(name, _)| format!("{section}.{name}: no range, expected `min` and `max` in the description"))
                .collect::<Vec<String>>()
        };
        let mut missing = Vec::new();
        if outputs.is_empty() {
            missing.push("the program describes no outputs".to_owned());
        }
        let runs = self.structure.runs();
        if runs.are_planned && parameters.values().all(|parameter| parameter.range().is_none()) {
            missing.push("the program describes no parameter with `min` and `max`: there is nothing to vary".into());
        }
        if runs.start_from_states && states.is_empty() {
            missing.push("the program describes no states".into());
        }
        if runs.are_samples && inputs.is_empty() {
            missing.push("the program describes no inputs: nothing drives it".into());
        }
        if runs.have_memory {
            missing.extend(no_range(inputs, "inputs"));
        }
        if runs.start_from_states {
            missing.extend(no_range(states, "states"));
        }
        missing
    }

    fn text(&self, name: &str, command: &[String], arguments: &[String]) -> String {
        let ProgramDescription { description, parameters, inputs, states, outputs, stop, step, .. } = &self.description;
        let (structure, runs) = (self.structure.name(), self.structure.runs());
        let stop = stop.filter(|stop| *stop > 0.0 && stop.is_finite()).unwrap_or(STOP);
        let step = step.filter(|step| *step > 0.0 && *step <= stop).unwrap_or(stop / ROWS);
        let (option, of_structure) = match self.structure == StudyStructure::default() {
            true => (String::new(), String::new()),
            false => (format!(" --structure {structure}"), format!("structure = {}\n", quoted(structure))),
        };
        let list: Vec<String> = arguments.iter().map(|argument| quoted(argument)).collect();
        let margin = match runs.are_planned {
            true => {
                "margin = 0.05               # training runs are longer by this share of `stop`; without it, errors are largest at the end\n"
            }
            false => "",
        };
        let mut text = format!(
            "# Made by `metafmu new {name}{option} --command {}`; build it with `metafmu build {name}.toml`.

name = \"{name}\"    # names the outputs and the FMU
description = {}
seed = 1                    # everything random follows from it
{of_structure}
[source]
command = [{}]    # started in the folder of this file
# files = []                # further files that the program reads: runs of other content are not resumed
# time_limit = 60           # s; a run that takes longer, crashes or fails
# retries = 1               # how often a failed run is repeated, before it is left out and reported
# max_failed = 0.1          # share of the runs that may fail
# constants = {{ NAME = VALUE }}    # values of parameters that do not vary; the program's else

[time]                      # rows of a run: 0, step, 2 step, ..., stop
stop = {stop:?}                  # s
step = {step:?}                 # s
{margin}",
            command.join(" "),
            quoted(description),
            list.join(", "),
        );
        let mut section = |head: &str, lines: String| {
            if !lines.is_empty() || head.starts_with("[outputs]") {
                text += &format!("\n{head}\n{lines}");
            }
        };
        if runs.start_from_states {
            let head = "[states]                    # every state of the program, and the range in which the equations are learned";
            section(head, of_states(states));
        }
        if runs.have_memory {
            let head =
                "[inputs]                    # `bandwidth` in Hz and kinds of `excitation` of runs; docs/dynamics.md";
            section(head, of_inputs(inputs, bandwidth(stop, step)));
        }
        section("[parameters]                # those with a range in the program", of_parameters(parameters));
        section(
            "[outputs]",
            outputs.iter().fold(String::new(), |lines, (name, output)| lines + &line(name, &[], output)),
        );
        text.push('\n');
        text += &match runs {
            RunForm { are_planned: true, .. } => sampling() + &rest(RUNS, stop / step),
            RunForm { start_from_states: true, .. } => format!(
                "[sampling]\nstates = {STATES}               # at which the program evaluates its equations\ntest_runs = 20              # random \
                 starts, parameters and inputs\n\n{}",
                rest(STATES, 1.0)
            ),
            _ => format!(
                "[sampling]\nruns = 30                   # to train and to choose a model with\ntest_runs = 10              # never part of \
                 training\n\n{DISCRETE}"
            ),
        };
        text
    }
}

fn of_parameters(parameters: &IndexMap<String, ProgramQuantity>) -> String {
    let line = |(name, parameter): (&String, &ProgramQuantity)| match parameter.range() {
        Some([min, max]) => line(name, &[format!("min = {min:?}, max = {max:?}")], parameter),
        None => format!("# {}", line(name, &["min = ..., max = ...".into()], parameter)),
    };
    parameters.iter().map(line).collect()
}

fn of_states(states: &IndexMap<String, ProgramQuantity>) -> String {
    let line = |(name, state): (&String, &ProgramQuantity)| {
        let [min, max] = state.range().unwrap_or_default();
        let mut keys = vec![format!("min = {min:?}, max = {max:?}")];
        if let Some(start) = state.start {
            let spread = 0.1 * (max - min);
            let ends = [start - spread, start + spread].map(|end| short(end.clamp(min, max)));
            keys.push(format!("start = {ends:?}"));
        }
        if state.periodic {
            keys.push("periodic = true".into());
        }
        keys.extend(state.rate_of.as_deref().map(|coordinate| format!("rate_of = {}", quoted(coordinate))));
        line(name, &keys, state)
    };
    // rates in the order of their coordinates, which come first
    let mut ordered: Vec<(&String, &ProgramQuantity)> = states.iter().collect();
    ordered.sort_by_key(|(_, state)| state.rate_of.as_ref().map(|coordinate| states.get_index_of(coordinate)));
    ordered.into_iter().map(line).collect()
}

fn of_inputs(inputs: &IndexMap<String, ProgramQuantity>, bandwidth: f64) -> String {
    let line = |(name, input): (&String, &ProgramQuantity)| {
        let [min, max] = input.range().unwrap_or_default();
        let mut keys = vec![format!("min = {min:?}, max = {max:?}")];
        keys.extend(input.start.map(|start| format!("start = {start:?}")));
        keys.push(format!("bandwidth = {bandwidth:?}, excitation = [\"multisine\", \"steps\", \"spline\"]"));
        line(name, &keys, input)
    };
    inputs.iter().map(line).collect()
}

/// A variable with its keys, its unit, and its description as a comment.
fn line(name: &str, keys: &[String], quantity: &ProgramQuantity) -> String {
    let mut keys = keys.to_vec();
    if !quantity.unit.is_empty() {
        keys.push(format!("unit = {}", quoted(&quantity.unit)));
    }
    let mut text = if keys.is_empty() {
        format!("{} = {{}}", key(name))
    } else {
        format!("{} = {{ {} }}", key(name), keys.join(", "))
    };
    if !quantity.description.is_empty() {
        // writing to a string does not fail
        let _ = write!(text, "    # {}", quantity.description.replace(char::is_control, " "));
    }
    text + "\n"
}
