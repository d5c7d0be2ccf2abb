//! Link between training and FMI: a trained model becomes a surrogate, which is saved, loaded and named by its digest.

use crate::{
    Error, Result,
    baselines::BaselineKind,
    dataset::Dataset,
    files::write_whole,
    layout, reading,
    source::driven::Driven,
    study::{self, NameStyle, ParameterOptions, Study},
    variable::SourceVariable,
};
use metafmu_runtime::{
    Bounds, Encoding, Graph, Input, Metadata, Output, OutputArray, Precision, Program, Provenance, Role, State,
    Surrogate, Tunability, graph::Step,
};
use std::path::Path;

/// Puts a trained model and the metadata of its columns together.
///
/// The graph's columns are encoded parameters then time in, outputs out.
///
/// # Errors
/// [`Error::Surrogate`] if the parts do not fit each other.
pub fn assemble(study: &Study, dataset: &Dataset, train_rows: usize, graph: Graph) -> Result<Surrogate> {
    finish(metadata(study, dataset, train_rows), graph.into())
}

/// Puts a fitted baseline together, with a separate name, description and digest.
///
/// # Errors
/// As [`assemble`].
pub fn assemble_baseline(
    study: &Study,
    dataset: &Dataset,
    train_rows: usize,
    kind: BaselineKind,
    graph: Graph,
) -> Result<Surrogate> {
    let mut metadata = metadata(study, dataset, train_rows);
    let name = kind.name();
    metadata.name = format!("{}-{name}", study.name);
    let space = if study.description.is_empty() { "" } else { " " };
    let has_trees = graph.steps.iter().any(|step| matches!(step, Step::Forest { .. }));
    let constant = if has_trees { ", piecewise constant: its derivatives are 0" } else { "" };
    metadata.description = format!("{}{space}(baseline model: {name}{constant})", study.description);
    metadata.precision = Precision::Double;
    metadata.provenance.study_digest = study.baseline_digest(kind);
    finish(metadata, graph.into())
}

/// Surrogate of the rows of a study: with its arrays, its seed and its digest.
///
/// # Errors
/// As [`assemble`].
pub fn of_rows(study: &Study, map: &Surrogate) -> Result<Surrogate> {
    let mut metadata = map.metadata().clone();
    metadata.arrays = study.arrays.iter().map(output_array).collect();
    metadata.provenance.study_digest = study.digest();
    metadata.provenance.seed = study.seed;
    finish(metadata, map.program().clone())
}

/// Surrogate of a program with states. Outputs have the ranges of the dataset. `ranges` are those in which the equations of each state were
/// learned, or none if every value is valid.
///
/// # Errors
/// As [`assemble`].
pub fn assemble_with_states(
    study: &Study,
    (dataset, rows): (&Dataset, usize),
    (driven, ranges): (&Driven, &[Option<[f64; 2]>]),
    program: Program,
) -> Result<Surrogate> {
    let mut metadata = metadata(study, dataset, rows);
    let parameters = study.parameters.len();
    // the time is no input
    metadata.inputs.pop();
    for (state, (input, start)) in metadata.inputs[parameters..].iter_mut().zip(driven.start()).enumerate() {
        input.role = Role::Start;
        input.start = *start;
        let [min, max] = driven.range(state).unwrap_or([*start; 2]);
        (input.min, input.max) = (input.min.min(min).min(*start), input.max.max(max).max(*start));
    }
    metadata.inputs.extend(driven.drivers().iter().map(|driver| Input {
        name: driver.variable.name.clone(),
        role: Role::Input,
        unit: driver.variable.unit.clone(),
        description: driver.variable.description.clone(),
        min: driver.min,
        max: driver.max,
        start: driver.start,
        encoding: Encoding::Plain,
    }));
    let ranges = ranges.iter().copied().chain(std::iter::repeat(None));
    // a state without a range of validity has a usual one
    let usual = study.coordinates().map(|(_, state)| Some([state.min, state.max])).chain(std::iter::repeat(None));
    let states = driven.states().iter().zip(ranges).zip(usual);
    metadata.states = states
        .map(|((state, range), usual)| {
            let mut state = state.clone();
            // an FMU's state may be an output as well, which keeps the name
            if study.outputs.contains_key(&state.name) {
                state.name += "_state";
            }
            of_state(state, range, range.or(usual))
        })
        .collect();
    metadata.stop_time = Some(study.time.stop);
    finish(metadata, program)
}

/// Surrogate of a discrete-time program. `drives` are the value of each input before the start and its range, infinite to take that of the
/// dataset.
///
/// # Errors
/// As [`assemble`].
pub fn assemble_discrete(
    study: &Study,
    (dataset, rows): (&Dataset, usize),
    drives: &[(f64, [f64; 2])],
    program: Program,
) -> Result<Surrogate> {
    let mut metadata = metadata(study, dataset, rows);
    // the time is no input
    metadata.inputs.pop();
    let widths = [dataset.inputs.len(), dataset.outputs.len()];
    let driven: Vec<Input> = (dataset.inputs.iter().zip(drives).enumerate())
        .map(|(column, (of, (start, [low, high])))| {
            let values = dataset.runs.iter().flat_map(|run| run.inputs.iter().skip(column).step_by(widths[0]));
            let (min, max) =
                values.fold((f64::INFINITY, f64::NEG_INFINITY), |(min, max), value| (min.min(*value), max.max(*value)));
            let range = [if low.is_finite() { *low } else { min }, if high.is_finite() { *high } else { max }];
            discrete_input(of, Role::Input, range, *start)
        })
        .collect();
    let before = &dataset.parameters[study.parameters.len()..];
    let (of_outputs, of_inputs) = before.split_at(widths[1]);
    for (column, (of, output)) in of_outputs.iter().zip(&metadata.outputs).enumerate() {
        // a state that occurred: means over several runs are none
        let start = dataset.runs.first().map_or(0.0, |run| run.outputs[column]);
        let description = format!("{}; unless set, that of the first training run", of.description);
        let of = SourceVariable::new(&of.name, &of.unit, &description);
        metadata.inputs.push(discrete_input(&of, Role::Start, [output.min, output.max], start));
    }
    // of a single past sample the inputs before the start do not count
    let counts = program.sampling().is_some_and(|sampling| sampling.history[1] > 1);
    for (of, input) in of_inputs.iter().zip(&driven).filter(|_| counts) {
        metadata.inputs.push(discrete_input(of, Role::Start, [input.min, input.max], input.start));
    }
    metadata.inputs.extend(driven);
    metadata.stop_time = Some(study.time.stop);
    finish(metadata, program)
}

/// An input with a range that includes its start.
fn discrete_input(of: &SourceVariable, role: Role, [min, max]: [f64; 2], start: f64) -> Input {
    Input {
        name: of.name.clone(),
        role,
        unit: of.unit.clone(),
        description: of.description.clone(),
        min: min.min(start),
        max: max.max(start),
        start,
        encoding: Encoding::Plain,
    }
}

/// Unit of the derivative of what has a unit.
pub(crate) fn rate_unit(unit: &str) -> String {
    match (unit, unit.strip_suffix("/s"), unit.strip_suffix("/s2")) {
        ("", ..) => "1/s".into(),
        (_, Some(unit), _) => format!("{unit}/s2"),
        (_, _, Some(unit)) => format!("{unit}/s3"),
        _ => format!("{unit}/s"),
    }
}

/// A state with the range in which it is valid, and the one in which it usually is.
fn of_state(
    SourceVariable { name, unit, description, .. }: SourceVariable,
    range: Option<[f64; 2]>,
    usual: Option<[f64; 2]>,
) -> State {
    let rate_unit = rate_unit(&unit);
    let largest = usual.map_or(0.0, |[min, max]| min.abs().max(max.abs()));
    let nominal = if largest > 0.0 && largest.is_finite() { largest } else { 1.0 };
    State { name, unit, rate_unit, description, range, nominal }
}

fn finish(metadata: Metadata, program: Program) -> Result<Surrogate> {
    seal(Surrogate::new(metadata, program).map_err(|source| Error::Surrogate { source })?)
}

fn metadata(study: &Study, dataset: &Dataset, train_rows: usize) -> Metadata {
    let ranges = study.sampled().map(|(_, range)| range);
    let parameters = dataset.parameters.iter().zip(ranges).map(|(variable, range)| Input {
        name: variable.name.clone(),
        role: role(range, study.runs().have_memory),
        unit: variable.unit.clone(),
        description: variable.description.clone(),
        min: range.min,
        max: range.max,
        start: variable
            .start
            .filter(|start| match range.is_nominal() {
                true => range.values.contains(start),
                false => (range.min..=range.max).contains(start),
            })
            .or(range.values.first().copied())
            .unwrap_or(0.5 * (range.min + range.max)),
        encoding: range.encoding(),
    });
    let time = Input {
        name: "time".into(),
        role: Role::Time,
        unit: "s".into(),
        description: "simulation time".into(),
        min: 0.0,
        max: study.time.stop,
        start: 0.0,
        encoding: Encoding::Plain,
    };
    let outputs = dataset.outputs.iter().enumerate().map(|(column, variable)| {
        let values = dataset.runs.iter().flat_map(|run| run.outputs.iter().skip(column).step_by(dataset.outputs.len()));
        let (min, max) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(min, max), &y| (min.min(y), max.max(y)));
        let SourceVariable { name, unit, description, .. } = variable.clone();
        Output { name, unit, description, min, max, std_of: None }
    });
    Metadata {
        name: study.name.clone(),
        description: study.description.clone(),
        inputs: layout::inputs(parameters, time).collect(),
        outputs: outputs.collect(),
        precision: study.export.precision,
        bounds: None,
        solver_error: None,
        cover: None,
        states: Vec::new(),
        arrays: study.arrays.iter().map(output_array).collect(),
        time_step: study.time.step,
        stop_time: None,
        provenance: Provenance {
            tool: concat!("metafmu ", env!("CARGO_PKG_VERSION")).into(),
            study_digest: study.digest(),
            seed: study.seed,
            train_rows: train_rows as u64,
            content_digest: "0".repeat(64),
        },
    }
}

/// Role of a parameter, which was constant in every run, even if it was an input of an FMU. Unless the study states otherwise, it is tunable if
/// outputs follow from states or samples: there it enters the equations only, and a mass or a length may change in a run. In a function of the
/// time it is fixed, since it belongs to the whole run.
fn role(options: &ParameterOptions, has_memory: bool) -> Role {
    let usual = if has_memory { study::ParameterVariability::Tunable } else { study::ParameterVariability::Fixed };
    match options.variability.unwrap_or(usual) {
        study::ParameterVariability::Fixed => Role::Parameter(Tunability::Fixed),
        study::ParameterVariability::Tunable => Role::Parameter(Tunability::Tunable),
        study::ParameterVariability::Continuous => Role::Input,
    }
}

fn output_array((name, outputs): (&String, &Vec<String>)) -> OutputArray {
    let description = format!("{} in one array", outputs.join(", "));
    OutputArray { name: name.clone(), description, outputs: outputs.clone() }
}

/// The surrogate with error bounds.
///
/// # Errors
/// [`Error::Surrogate`] if the bounds do not fit it.
pub fn with_bounds(surrogate: Surrogate, bounds: Bounds) -> Result<Surrogate> {
    seal(surrogate.with_bounds(bounds).map_err(|source| Error::Surrogate { source })?)
}

/// The surrogate with names of this style. It is another one if they differ: another model file, with another digest.
///
/// # Errors
/// [`Error::Ports`] with the names that the style does not distinguish.
pub fn with_names(surrogate: &Surrogate, style: NameStyle) -> Result<Surrogate> {
    if style == NameStyle::Study {
        return Ok(surrogate.clone());
    }
    let mut metadata = surrogate.metadata().clone();
    let Metadata { inputs, outputs, states, arrays, .. } = &mut metadata;
    let inputs = inputs.iter_mut().map(|input| &mut input.name);
    let outputs = outputs.iter_mut().map(|output| &mut output.name);
    let states = states.iter_mut().map(|state| &mut state.name);
    let mut names: Vec<&mut String> =
        inputs.chain(outputs).chain(states).chain(arrays.iter_mut().map(|array| &mut array.name)).collect();
    let problems = style.problems(names.iter().map(|name| &**name));
    if !problems.is_empty() {
        return Err(Error::Ports { problems });
    }
    names.iter_mut().for_each(|name| **name = style.of(name));
    for array in &mut metadata.arrays {
        array.outputs.iter_mut().for_each(|name| *name = style.of(name));
    }
    finish(metadata, surrogate.program().clone())
}

/// The surrogate with the digest of its content: the last step of making one.
///
/// # Errors
/// [`Error::Surrogate`] if it cannot be written as a model file.
pub fn seal(surrogate: Surrogate) -> Result<Surrogate> {
    surrogate.sealed().map_err(|source| Error::Surrogate { source })
}

/// Reads a model file.
///
/// # Errors
/// [`Error::Io`] if the file cannot be read, [`Error::Model`] if it is no valid model file or its content was changed.
pub fn load(path: &Path) -> Result<Surrogate> {
    let bytes = reading::read(path, reading::MAX_WHOLE).map_err(Error::io(path, "read"))?;
    Surrogate::from_bytes(&bytes).map_err(|source| Error::Model { path: path.to_owned(), source: Box::new(source) })
}

/// Writes a model file, whole or not at all.
///
/// # Errors
/// [`Error::Io`] if the file cannot be written, [`Error::Surrogate`] if the surrogate cannot be written as a model file.
pub fn save(surrogate: &Surrogate, path: &Path) -> Result<()> {
    let bytes = surrogate.to_bytes().map_err(|source| Error::Surrogate { source })?;
    write_whole(path, &bytes)
}

/// Text about an input beyond its limits and its variability.
pub fn input_description(input: &Input, surrogate: &Surrogate) -> String {
    let Input { description, role, min, max, encoding, .. } = input;
    let values = match encoding {
        Encoding::Plain => None,
        Encoding::Nominal(values) => {
            let values: Vec<String> = values.iter().map(f64::to_string).collect();
            Some(format!("one of {}", values.join(", ")))
        }
        Encoding::Periodic => Some(format!("any number: values that differ by {} are the same", max - min)),
    };
    let may_change = matches!(role, Role::Input | Role::Parameter(Tunability::Tunable));
    // what has states, or is a function of the present inputs alone, follows every change
    let change = (may_change && surrogate.time_column().is_some()).then(|| {
        "constant in each training run: after a change outputs are as if it had been so from the start".into()
    });
    let more: Vec<String> = values.into_iter().chain(change).collect();
    match (description.is_empty(), more.join("; ")) {
        (_, more) if more.is_empty() => description.clone(),
        (true, more) => more,
        (false, more) => format!("{description} ({more})"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metafmu_example as example;
    use metafmu_runtime::FormatError;

    #[test]
    fn a_sealed_surrogate_loads_as_it_was_saved() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model.safetensors");
        let surrogate = seal(example::surrogate()).unwrap();
        save(&surrogate, &path).unwrap();
        assert_eq!(load(&path).unwrap(), surrogate);
        assert_eq!(seal(surrogate.clone()).unwrap(), surrogate, "sealing again changes nothing");
    }

    #[test]
    fn a_changed_weight_is_noticed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model.safetensors");
        let mut bytes = seal(example::surrogate()).unwrap().to_bytes().unwrap();
        // the last byte but three is the mantissa of some weight or scale
        let place = bytes.len() - 4;
        bytes[place] ^= 1;
        std::fs::write(&path, bytes).unwrap();
        assert!(
            matches!(load(&path), Err(Error::Model { source, .. }) if matches!(*source, FormatError::Damaged { .. }))
        );
    }

    #[test]
    fn a_file_that_is_cut_short_is_no_model_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model.safetensors");
        let bytes = seal(example::surrogate()).unwrap().to_bytes().unwrap();
        std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
        assert!(matches!(load(&path), Err(Error::Model { .. })));
        assert!(matches!(load(&folder.path().join("none")), Err(Error::Io { .. })));
    }
}
