//! Trained models of other tools become surrogates, without a study.

use super::predict::roll_outs;
use crate::{
    Error, Result,
    diagnostics::{Problems, names::listed},
    files,
    import::{self, Imported, onnx, tensors},
    interface::Interface,
    surrogate,
    table::Table,
};
use metafmu_runtime::{Evaluator, Surrogate};
use serde::Serialize;
use std::{
    collections::HashSet,
    fmt::Write,
    path::{Path, PathBuf},
};

/// What is imported, and how.
#[derive(Clone, Debug)]
pub struct ImportOptions {
    /// File of the trained model.
    pub model: PathBuf,
    /// What its columns are.
    pub interface: PathBuf,
    /// Table of training data, for the ranges that the interface does not have.
    pub data: Option<PathBuf>,
    /// Table with rows of inputs and of the outputs that the model gave for them.
    pub check: Option<PathBuf>,
    /// How far outputs may be from those of the check, relative to the range that they have there.
    pub tolerance: Option<f64>,
    /// The model file; NAME.safetensors in the working directory unless given.
    pub out: Option<PathBuf>,
}

/// A surrogate that was imported.
#[derive(Clone, Debug, Serialize)]
pub struct ImportedSurrogate {
    /// The model file; none if the check failed.
    pub model: Option<PathBuf>,
    /// Its content digest.
    pub content_digest: String,
    /// How each output compares with the check.
    pub check: Vec<Difference>,
}

/// The difference of an output from what was expected.
#[derive(Clone, Debug, Serialize)]
pub struct Difference {
    /// The output.
    pub output: String,
    /// Its largest difference.
    pub largest: f64,
    /// The same relative to the range of what was expected.
    pub relative: f64,
    /// Row of the table, counted from 1.
    pub row: u64,
    /// Whether that is within the tolerance.
    pub fits: bool,
}

/// Column that labels the runs of a table.
const RUN: &str = "run";

/// Tolerance of a check: of a model in single precision, and of one in double.
const TOLERANCES: [f64; 2] = [1e-5, 1e-9];

/// Reads a trained model of another tool and writes it as a model file.
///
/// # Errors
/// [`Error::Import`] with what cannot be imported, [`Error::Study`] with the keys of the interface that do not fit, [`Error::Table`],
/// [`Error::Io`], [`Error::SameFile`] if the model file would take the place of the model.
pub fn import(options: &ImportOptions) -> Result<ImportedSurrogate> {
    let interface = Interface::load(&options.interface)?;
    let out = options.out.clone().unwrap_or_else(|| PathBuf::from(format!("{}.safetensors", interface.name)));
    if !out.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("safetensors")) {
        let problem =
            "expected a name that ends in .safetensors, of a model file: `metafmu export` makes the FMU of it";
        return Err(Error::Import { path: out, problems: vec![problem.into()] });
    }
    files::check_output(&out)?;
    let (bytes, model) = read(&options.model, Some(&interface))?;
    if out.exists() && out.canonicalize().ok() == options.model.canonicalize().ok() {
        return Err(Error::SameFile { path: out });
    }
    let tolerance = options.tolerance.unwrap_or(TOLERANCES[usize::from(!model.is_single)]);
    let rows = options.data.as_deref().map(|data| import::rows(data, &interface)).transpose()?;
    let surrogate = import::surrogate((&options.model, &bytes), model, &interface, rows)?;
    let check = match &options.check {
        Some(table) => check(&surrogate, &interface, table, tolerance)?,
        None => Vec::new(),
    };
    let fits = check.iter().all(|difference| difference.fits);
    if fits {
        surrogate::save(&surrogate, &out)?;
    }
    let content_digest = surrogate.metadata().provenance.content_digest.clone();
    Ok(ImportedSurrogate { model: fits.then_some(out), content_digest, check })
}

/// An interface file to begin with: names of all columns, and ranges if there is a table.
///
/// # Errors
/// Those of [`import()`].
pub fn starter(model: &Path, data: Option<&Path>) -> Result<String> {
    let (_, imported) = read(model, None)?;
    let stem = model.file_stem().map_or("model".into(), |stem| identifier(&stem.to_string_lossy()));
    let mut text = String::new();
    let of = |what: &str| Error::Import { path: model.to_owned(), problems: vec![what.into()] };
    let states = feedback(&imported);
    let names =
        data.map(|data| column_names(data, imported.inputs.len(), imported.outputs.len())).transpose()?.flatten();
    let (given, given_outputs) = match &names {
        Some(names) => names.split_at(imported.inputs.len()),
        None => (&[] as &[String], &[] as &[String]),
    };
    let mut taken = HashSet::new();
    let inputs = unique(&imported.inputs, given, &mut taken);
    let outputs = unique(&imported.outputs, given_outputs, &mut taken);
    let known = if data.is_some() { "# ranges are those of the table of training data, by --data\n" } else { "" };
    write!(
        text,
        "# What the columns of {} are: names, units and ranges for `metafmu import`. docs/import.md has every key.\n\
         name = \"{stem}\"\ndescription = \"\"\n\n[time]    # when the FMU is stepped, unless the host says otherwise\n{step}stop = 1.0\n\n\
         # causality: \"input\" is driven by other components, \"parameter\" is set before the simulation (variability = \"tunable\": also\n\
         # between two steps), \"time\" is the simulation time. `value = 1.0` in place of a range: a column that is always the same.\n{known}",
        model.file_name().map_or("the model".into(), |name| name.to_string_lossy()),
        step = match imported.recurrences.is_empty() && states.iter().all(|state| state.follows == Follows::Derivative) {
            true => "step = 0.01\n",
            false => "sample = 0.01    # time between two samples, in seconds\n",
        },
    )
    .map_err(|_| of("cannot be described"))?;
    if !imported.recurrences.is_empty() {
        let names: Vec<&str> = imported.recurrences.iter().map(|state| state.name.as_str()).collect();
        text += &format!("\n# the model keeps {} from one sample to the next: hidden states\n", listed(&names));
    }
    for (name, rows, width) in
        imported.stacked.iter().filter(|(name, ..)| states.iter().all(|state| state.column != *name))
    {
        text += &format!(
            "\n# {name}: {rows} rows of {width} numbers, which are all inputs; if they are a batch, export the model with one row\n"
        );
    }
    for Fed { column, output, follows } in &states {
        let (key_of_output, about) = match follows {
            Follows::Next => ("next", "what it is a sample later; `derivative = ` if it is its derivative"),
            Follows::Derivative => {
                ("derivative", "with respect to time; `next = ` if it is what the state is a sample later")
            }
        };
        text += &format!(
            "\n[states.{}]\ncolumn = {}\n{key_of_output} = {}    # {about}\nstart = 0.0\n",
            key(&identifier(column)),
            quoted(column),
            quoted(output)
        );
    }
    let of_state = |column: &str, names: &[&String]| {
        let tensor = column.split('[').next().unwrap_or(column);
        names.iter().any(|name| *name == column || *name == tensor)
    };
    let (of_inputs, of_outputs): (Vec<&String>, Vec<&String>) =
        states.iter().map(|state| (&state.column, &state.output)).unzip();
    for (column, name) in imported.inputs.iter().zip(&inputs).filter(|(column, _)| !of_state(column, &of_inputs)) {
        let range = match data {
            Some(_) => "",
            None => "# min =       # the training range\n# max =\n",
        };
        text += &format!(
            "\n[inputs.{}]\ncolumn = {}\ncausality = \"input\"\nunit = \"\"\ndescription = \"\"\n{range}",
            key(name),
            quoted(column)
        );
    }
    let left = || imported.outputs.iter().zip(&outputs).filter(|(column, _)| !of_state(column, &of_outputs));
    // a model that only tells how its states go on shows them
    let states = || imported.inputs.iter().zip(&inputs).filter(|(column, _)| of_state(column, &of_inputs));
    let shown: Vec<_> = if left().next().is_some() { left().collect() } else { states().collect() };
    for (column, name) in shown {
        text += &format!("\n[outputs.{}]\ncolumn = {}\nunit = \"\"\ndescription = \"\"\n", key(name), quoted(column));
    }
    Ok(text)
}

/// An input that is a state, by its name.
struct Fed {
    /// The input.
    column: String,
    /// The output that it follows from.
    output: String,
    follows: Follows,
}

/// What an output is of a state.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Follows {
    Next,
    Derivative,
}

/// Inputs that are states by their names, with the outputs that are their next values, as the exports of recurrent cells call them, or, if
/// there are none, their derivatives.
fn feedback(imported: &Imported) -> Vec<Fed> {
    let tensors = |columns: &[String]| {
        let mut found: Vec<(String, usize)> = Vec::new();
        for column in columns {
            let name = column.split('[').next().unwrap_or(column);
            match found.last_mut().filter(|(last, _)| last == name) {
                Some((_, width)) => *width += 1,
                None => found.push((name.to_owned(), 1)),
            }
        }
        found
    };
    let (inputs, outputs) = (tensors(&imported.inputs), tensors(&imported.outputs));
    let found = |follows: Follows, names_of: fn(&str) -> Vec<String>| {
        let mut states: Vec<Fed> = Vec::new();
        for (input, width) in &inputs {
            let is_free = |output: &str| states.iter().all(|state| state.output != output);
            let fits = |name: &String| {
                outputs.iter().find(|(output, count)| output == name && count == width && is_free(output))
            };
            if let Some((output, _)) = names_of(input).iter().find_map(fits) {
                states.push(Fed { column: input.clone(), output: output.clone(), follows });
            }
        }
        states
    };
    let states = found(Follows::Next, later_names);
    if states.is_empty() { found(Follows::Derivative, derivative_names) } else { states }
}

/// What the derivative of an input may be called.
fn derivative_names(input: &str) -> Vec<String> {
    let before = ["d", "d_", "der_"].iter().map(|prefix| format!("{prefix}{input}"));
    let behind = ["_dot", "dot", "_derivative", "_der"].iter().map(|suffix| format!("{input}{suffix}"));
    let around = [format!("d{input}dt"), format!("d{input}_dt"), format!("d{input}/dt"), format!("der({input})")];
    before.chain(behind).chain(around).collect()
}

/// What the next value of an input may be called.
fn later_names(input: &str) -> Vec<String> {
    let named = |stem: &str, before: &[&str], behind: &[&str]| -> Vec<String> {
        let behind = behind.iter().map(|suffix| format!("{stem}{suffix}"));
        behind.chain(before.iter().map(|prefix| format!("{prefix}{stem}"))).collect()
    };
    let any = named(input, &["next_", "new_"], &["_next", "_new", "1"]);
    let stem = ["initial_", "prev_", "previous_", "last_"].iter().find_map(|prefix| input.strip_prefix(prefix));
    let stem = stem.or_else(|| ["_in", "_prev", "_0", "0"].iter().find_map(|suffix| input.strip_suffix(suffix)));
    let stem = stem.or(["h", "c", "state", "hidden", "hx", "cx"].into_iter().find(|name| *name == input));
    // tensors may be numbered
    let of_states = stem
        .filter(|stem| !stem.is_empty())
        .map(|stem| named(stem, &["next_", "new_", "Y_"], &["n", "1", "_n", "_1", "_out", "_next", "_new"]));
    of_states.into_iter().flatten().chain(any).filter(|name| name != input).collect()
}

/// The content of a model's file, and what it says; what is only tensors needs the layers of an interface.
fn read(path: &Path, interface: Option<&Interface>) -> Result<(Vec<u8>, Imported)> {
    let bytes = std::fs::read(path).map_err(Error::io(path, "read"))?;
    let refused = |problems| Error::Import { path: path.to_owned(), problems };
    if let Some(problem) = tensors::made_already(&bytes) {
        return Err(refused(vec![problem]));
    }
    let tensors = match &bytes {
        _ if tensors::is_npz(&bytes) => Some(tensors::read_npz(&bytes).map_err(refused)?),
        _ if tensors::is_safetensors(&bytes) => Some(tensors::read_safetensors(&bytes).map_err(refused)?),
        _ => None,
    };
    let imported = match (tensors, interface) {
        (Some(tensors), Some(interface)) => tensors::layers(&tensors, interface)?,
        (Some(tensors), None) => {
            let known: Vec<&str> = tensors.keys().map(String::as_str).collect();
            return Err(refused(vec![format!(
                "only tensors ({}): an interface has to say which are layers, [[layers]] with weight, bias and activation; \
                 docs/import.md has an example",
                listed(&known)
            )]));
        }
        (None, interface) => {
            if let Some(interface) = interface.filter(|interface| !interface.layers.is_empty()) {
                let message = "belongs to models that are only tensors (.npz, .safetensors)";
                interface.refuse(Problems::one("layers", message))?;
            }
            let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
            onnx::read(&bytes, Some(folder)).map_err(refused)?
        }
    };
    Ok((bytes, imported))
}

/// Compares the outputs with those of a table, row by row.
fn check(surrogate: &Surrogate, interface: &Interface, path: &Path, tolerance: f64) -> Result<Vec<Difference>> {
    let mut table = Table::open(path)?;
    let outputs = surrogate.outputs();
    let of_inputs = import::columns(&table, interface)?;
    let of_outputs = outputs.iter().map(|output| table.column(&output.name)).collect::<Result<Vec<usize>>>()?;
    import::check_units(&table, of_outputs.iter().copied().zip(outputs.iter().map(|output| output.unit.as_str())))?;
    let mut along = if surrogate.goes_on() { Some(roll_outs(surrogate, path)?.into_iter()) } else { None };
    let evaluator = Evaluator::new(surrogate);
    let (mut scratch, mut found) = (evaluator.scratch(), vec![0.0; outputs.len()]);
    let mut largest = vec![(0.0f64, 0u64); outputs.len()];
    let mut ranges = vec![[f64::INFINITY, f64::NEG_INFINITY]; outputs.len()];
    let (mut row, mut compared) = (0, 0);
    while table.next_row()? {
        row += 1;
        match &mut along {
            // rows of a run
            Some(along) => match along.next() {
                Some((is_first, predicted)) => {
                    // what the outputs are before the first sample is not of the model
                    if is_first && surrogate.states().is_empty() {
                        continue;
                    }
                    found.copy_from_slice(&predicted);
                }
                None => found.fill(f64::NAN),
            },
            None => {
                let point = of_inputs.iter().map(|column| table.number(*column)).collect::<Result<Vec<f64>>>()?;
                evaluator.evaluate(&point, &mut found, &mut scratch);
            }
        }
        compared += 1;
        for (output, column) in of_outputs.iter().enumerate() {
            let expected = table.number(*column)?;
            let difference = (found[output] - expected).abs();
            let [min, max] = ranges[output];
            ranges[output] = [min.min(expected), max.max(expected)];
            // what is not a number counts as the largest difference
            if difference.is_nan() || difference > largest[output].0 {
                largest[output] = (difference, row);
            }
        }
    }
    if compared == 0 {
        let why = format!(
            "in the first row of a run outputs are not those of the model, and rows with the same `{RUN}` whose time grows are a run"
        );
        let problem = match row {
            0 => "no rows, expected at least one".into(),
            1 => format!("no row to compare in one run of one row: {why}"),
            runs => format!("no row to compare in {runs} runs of one row each: {why}"),
        };
        return Err(Error::Import { path: path.to_owned(), problems: vec![problem] });
    }
    let difference = |((output, (largest, row)), [min, max]): ((&metafmu_runtime::Output, (f64, u64)), [f64; 2])| {
        let scale = match max - min {
            range if range > 0.0 => range,
            // of a single value, or of values that are all the same
            _ if max != 0.0 => max.abs(),
            _ => 1.0,
        };
        let relative = if largest == 0.0 { 0.0 } else { largest / scale };
        Difference { output: output.name.clone(), largest, relative, row, fits: relative <= tolerance }
    };
    Ok(outputs.iter().zip(largest).zip(ranges).map(difference).collect())
}

/// The names of a table's columns, if there are as many as the model has, or as it has inputs.
fn column_names(path: &Path, inputs: usize, outputs: usize) -> Result<Option<Vec<String>>> {
    let table = Table::open(path)?;
    let names: Vec<String> = table.columns().iter().map(|column| column.name.clone()).collect();
    Ok((names.len() == inputs || names.len() == inputs + outputs).then_some(names))
}

/// Names for columns: those given, else made of the model's, all different from each other and from those that are taken.
fn unique(columns: &[String], given: &[String], taken: &mut HashSet<String>) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    for (place, column) in columns.iter().enumerate() {
        let name = given.get(place).cloned().unwrap_or_else(|| identifier(column));
        let numbered = (2..).map(|number| format!("{name}_{number}"));
        let free = std::iter::once(name.clone()).chain(numbered).find(|name| !taken.contains(name)).unwrap_or(name);
        taken.insert(free.clone());
        names.push(free);
    }
    names
}

/// A name of letters, digits and `_`.
fn identifier(text: &str) -> String {
    let mut name = String::new();
    for c in text.chars() {
        if c.is_ascii_alphanumeric() {
            name.push(c);
        } else if !name.ends_with('_') && !name.is_empty() {
            name.push('_');
        }
    }
    let name = name.trim_end_matches('_').to_owned();
    if name.starts_with(|c: char| c.is_ascii_alphabetic()) { name } else { format!("v{name}") }
}

/// A key of TOML.
fn key(name: &str) -> String {
    let is_bare = !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '_' | '-'));
    if is_bare { name.to_owned() } else { quoted(name) }
}

/// A text of TOML.
fn quoted(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}
