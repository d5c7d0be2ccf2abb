//! Third-party models become surrogates, without a study.

use super::predict::roll_outs;
use crate::{
    Error, Result,
    diagnostics::{
        Problems, kinds,
        names::{listed, out_of_order_problem},
    },
    files,
    import::{
        self, ImportError, Imported,
        interface::ModelInterface,
        onnx::{self, Described},
        tensors,
    },
    reading,
    study::MAX_NAME,
    surrogate,
    table::{Table, TableColumn},
};
use metafmu_runtime::{BuiltIn, Evaluator, Surrogate};
use serde::Serialize;
use std::{
    collections::{HashMap, HashSet},
    fmt::Write,
    path::{Path, PathBuf},
};

/// Options of an import.
#[derive(Clone, Debug)]
pub struct ImportOptions {
    /// File of the trained model.
    pub model: PathBuf,
    /// File of the interface, which describes its columns.
    pub interface: PathBuf,
    /// Table of training data, for the ranges that the interface does not have.
    pub data: Option<PathBuf>,
    /// Table with rows of inputs and of the outputs that the model gave for them.
    pub check: Option<PathBuf>,
    /// Largest difference of outputs from those of the check, relative to their range in it.
    pub tolerance: Option<f64>,
    /// The model file; by default NAME.safetensors in the working directory.
    pub out: Option<PathBuf>,
}

/// A surrogate that was imported.
#[derive(Clone, Debug, Serialize)]
pub struct ImportedSurrogate {
    /// The model file; none if the check failed.
    pub model: Option<PathBuf>,
    /// Its content digest.
    pub content_digest: String,
    /// Comparison of each output with the check.
    pub check: Vec<OutputDifference>,
}

/// Difference of an output from the expected values.
#[derive(Clone, Debug, Serialize)]
pub struct OutputDifference {
    /// The output.
    pub output: String,
    /// Its largest difference.
    pub largest: f64,
    /// Largest difference relative to the range of the expected values.
    pub relative: f64,
    /// Row of the table, counted from 1.
    pub row: u64,
    /// `true` if the difference is within the tolerance.
    pub fits: bool,
}

/// Columns of a table beside those of the model: the time, and the label of a run.
const TIME: &str = "time";
const RUN: &str = "run";

/// Tolerance of a check: of a model in single precision, and of one in double.
const TOLERANCES: [f64; 2] = [1e-5, 1e-9];

/// Reads a third-party model and writes it as a model file.
///
/// # Errors
/// [`Error::Import`] with the problems of the model, [`Error::Study`] with the keys of the interface that do not fit,
/// [`Error::Table`], [`Error::Io`], [`Error::SameFile`] if the model file would overwrite the model.
pub fn import(options: &ImportOptions) -> Result<ImportedSurrogate> {
    let interface = ModelInterface::load(&options.interface)?;
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
    let (bytes, imported) = read(model, None)?;
    let mut stem = model.file_stem().map_or("model".into(), |stem| identifier(&stem.to_string_lossy()));
    stem.truncate(MAX_NAME);
    let mut text = String::new();
    let of = |what: &str| Error::Import { path: model.to_owned(), problems: vec![what.into()] };
    let states = feedback(&imported);
    let has_memory = !(states.is_empty() && imported.recurrences.is_empty());
    let mut inputs = ports(&imported.inputs, states.iter().map(|state| &state.column));
    let mut outputs = ports(&imported.outputs, states.iter().map(|state| &state.output));
    for (ports, described) in [&mut inputs, &mut outputs].into_iter().zip(onnx::described(&bytes)) {
        if ports.len() == described.len() {
            ports.iter_mut().zip(described).for_each(|(port, described)| port.described = Some(described));
        }
    }
    let stop = inputs.iter().filter(|port| port.wanted() == TIME).find_map(|port| Some(port.range()?[1]));
    if let Some(data) = data {
        find_in_table(data, [&mut inputs, &mut outputs], has_memory)?;
    }
    let known = if data.is_some() { "# ranges are those of the table of training data, by --data\n" } else { "" };
    write!(
        text,
        "# What the columns of {} are: names, units and ranges for `metafmu import`. docs/import.md has every key.\n\
         name = \"{stem}\"\ndescription = \"\"\n\n[time]    # when the FMU is stepped, unless the host says otherwise\n{step}stop = {stop:?}\n\n\
         # causality: \"input\" is driven by other components, \"parameter\" is set before the simulation (variability = \"tunable\": also\n\
         # between two steps), \"time\" is the simulation time. `value = 1.0` in place of a range: a column that is always the same.\n{known}",
        model.file_name().map_or("the model".into(), |name| name.to_string_lossy()),
        stop = stop.unwrap_or(1.0),
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
    let mut taken = HashSet::new();
    for Fed { column, output, follows } in &states {
        let (key_of_output, about) = match follows {
            Follows::Next => ("next", "what it is a sample later; `derivative = ` if it is its derivative"),
            Follows::Derivative => {
                ("derivative", "with respect to time; `next = ` if it is what the state is a sample later")
            }
        };
        text += &format!(
            "\n[states.{}]\ncolumn = {}\n{key_of_output} = {}    # {about}\nstart = 0.0\n",
            key(&free(&identifier(column), &mut taken)),
            quoted(column),
            quoted(output)
        );
    }
    let of_states = taken.clone();
    for port in inputs.iter().filter(|port| !port.is_state) {
        // of a model with states the time is no input
        let is_time = !has_memory && port.wanted() == TIME && taken.insert(TIME.into());
        let name = if is_time { TIME.into() } else { free(&port.wanted(), &mut taken) };
        let range = match (data, port.range()) {
            _ if is_time => String::new(),
            (None, Some([min, max])) => format!("min = {min:?}\nmax = {max:?}\n"),
            (None, None) => "# min =       # the training range\n# max =\n".into(),
            (Some(_), _) => String::new(),
        };
        text += &format!(
            "\n[inputs.{}]{}\ncolumn = {}\ncausality = \"{}\"\nunit = {}\ndescription = \"\"\n{range}",
            key(&name),
            port.about(&name),
            quoted(port.column),
            if is_time { TIME } else { "input" },
            quoted(port.unit()),
        );
    }
    let mut shown: Vec<&ModelColumn> = outputs.iter().filter(|port| !port.is_state).collect();
    if shown.is_empty() {
        // a model that only tells how its states go on shows them, with their names
        shown = inputs.iter().filter(|port| port.is_state).collect();
        taken.retain(|name| !of_states.contains(name));
    }
    for port in shown {
        let name = free(&port.wanted(), &mut taken);
        text += &format!(
            "\n[outputs.{}]{}\ncolumn = {}\nunit = {}\ndescription = \"\"\n",
            key(&name),
            port.about(&name),
            quoted(port.column),
            quoted(port.unit())
        );
    }
    Ok(text)
}

/// A column of a model.
struct ModelColumn<'a> {
    column: &'a str,
    /// `true` if it is a state, its next value or its derivative.
    is_state: bool,
    /// The column of the training data that it is, if that is known.
    found: Option<TableColumn>,
    /// Description of it in the model file.
    described: Option<Described>,
}

impl ModelColumn<'_> {
    /// Its preferred name, which may be taken.
    fn wanted(&self) -> String {
        let found = self.found.as_ref().map(|found| found.name.clone());
        let described = || self.described.as_ref().map(|described| described.name.clone());
        found.or_else(described).unwrap_or_else(|| identifier(self.column))
    }

    fn unit(&self) -> &str {
        let described = || self.described.as_ref().map(|described| described.unit.as_str());
        self.found.as_ref().and_then(TableColumn::unit).or_else(described).unwrap_or_default()
    }

    fn range(&self) -> Option<[f64; 2]> {
        self.described.as_ref()?.range
    }

    /// A comment, if the table has another name.
    fn about(&self, name: &str) -> String {
        match &self.found {
            Some(found) if found.name != name => {
                format!("    # `{}` in the table, a name that is taken: rename it there, too", found.name)
            }
            _ => String::new(),
        }
    }
}

/// The columns of these names; `states` are names of columns, or of tensors.
fn ports<'a>(columns: &'a [String], states: impl Iterator<Item = &'a String>) -> Vec<ModelColumn<'a>> {
    let states: Vec<&String> = states.collect();
    let is_state = |column: &str| {
        let tensor = column.split('[').next().unwrap_or(column);
        states.iter().any(|name| *name == column || *name == tensor)
    };
    columns
        .iter()
        .map(|column| ModelColumn { column, is_state: is_state(column), found: None, described: None })
        .collect()
}

/// Finds inputs and outputs among the columns of a table: by name if it has the names of the model, else by position if
/// the numbers of columns agree.
fn find_in_table(path: &Path, [inputs, outputs]: [&mut Vec<ModelColumn>; 2], has_memory: bool) -> Result<()> {
    let columns = Table::open(path)?.columns().to_vec();
    let mut open: HashMap<&str, usize> =
        columns.iter().enumerate().map(|(place, column)| (column.name.as_str(), place)).collect();
    let matches = [&mut *inputs, &mut *outputs].map(|ports| find_by_name(&columns, &mut open, ports));
    let problems: Vec<String> =
        matches.iter().zip(["inputs", "outputs"]).filter_map(|(names, ports)| names.problem(ports)).collect();
    if !problems.is_empty() {
        return Err(Error::Import { path: path.to_owned(), problems });
    }
    // rows of runs have columns beside those of the model
    open.retain(|name, _| !(has_memory && [TIME, RUN].contains(name)));
    let mut rest: Vec<usize> = open.into_values().collect();
    rest.sort_unstable();
    let is_behind = rest.first().is_some_and(|first| first + rest.len() == columns.len());
    let is_plain = |port: &&mut ModelColumn| !port.is_state;
    let meant: Vec<&mut ModelColumn> = match matches {
        [NamedColumns::All, NamedColumns::None] if is_behind => outputs.iter_mut().filter(is_plain).collect(),
        [NamedColumns::None, NamedColumns::All] => inputs.iter_mut().filter(is_plain).collect(),
        [NamedColumns::None, NamedColumns::None] if rest.len() == inputs.len() => inputs.iter_mut().collect(),
        [NamedColumns::None, NamedColumns::None] => inputs.iter_mut().chain(outputs).collect(),
        _ => Vec::new(),
    };
    if meant.len() == rest.len() {
        let ports: Vec<&str> = meant.iter().map(|port| port.column).collect();
        let headers: Vec<&str> = rest.iter().map(|place| columns[*place].name.as_str()).collect();
        if let Some(problem) = out_of_order_problem(("its columns", &headers), ("the model", &ports)) {
            return Err(Error::Import { path: path.to_owned(), problems: vec![problem] });
        }
        meant.into_iter().zip(rest).for_each(|(port, place)| port.found = Some(columns[place].clone()));
    }
    Ok(())
}

/// Columns of a model that a table has by their names, those of states aside.
enum NamedColumns {
    None,
    All,
    /// Only some, so that the position of the others would be a guess.
    Part {
        named: Vec<String>,
        missing: Vec<String>,
    },
}

impl NamedColumns {
    /// Message if the table has only some of the `ports`, which are inputs or outputs.
    fn problem(&self, ports: &str) -> Option<String> {
        let Self::Part { named, missing } = self else { return None };
        let [named, missing] = [named, missing].map(|names| names.iter().map(String::as_str).collect::<Vec<_>>());
        Some(format!(
            "has columns for {} of the model's {ports}, but none for {}: expected one for each, or none with the model's names, if columns are \
             meant by their position",
            listed(&named),
            listed(&missing)
        ))
    }
}

/// Finds ports by their names among the columns that are `open`.
fn find_by_name(columns: &[TableColumn], open: &mut HashMap<&str, usize>, ports: &mut [ModelColumn]) -> NamedColumns {
    for port in ports.iter_mut().filter(|port| !port.is_state) {
        port.found = open.remove(port.column).map(|place| columns[place].clone());
    }
    // names of other alphabets identify nothing without their letters, nor do names that two columns share
    let mut cleaned: HashMap<String, Vec<&str>> = HashMap::new();
    for name in open.keys().filter(|name| name.is_ascii()) {
        cleaned.entry(identifier(name)).or_default().push(name);
    }
    for port in ports.iter_mut().filter(|port| !port.is_state && port.found.is_none() && port.column.is_ascii()) {
        if let Some(&[name]) = cleaned.get(&identifier(port.column)).map(Vec::as_slice) {
            port.found = open.remove(name).map(|place| columns[place].clone());
        }
    }
    let mut named = Vec::new();
    let mut missing = Vec::new();
    for port in ports.iter().filter(|port| !port.is_state) {
        let names = if port.found.is_some() { &mut named } else { &mut missing };
        names.push(port.column.to_owned());
    }
    match (named.is_empty(), missing.is_empty()) {
        (true, _) => NamedColumns::None,
        (false, true) => NamedColumns::All,
        (false, false) => NamedColumns::Part { named, missing },
    }
}

/// An input that is a state, by its name.
struct Fed {
    /// The input.
    column: String,
    /// The output that it follows from.
    output: String,
    follows: Follows,
}

/// Relation of an output to a state.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Follows {
    Next,
    Derivative,
}

/// Inputs that are states by their names, with the outputs that are their next values, as in exports of recurrent
/// cells. If there are none, the outputs are their derivatives.
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

/// Names that the derivative of an input may have.
fn derivative_names(input: &str) -> Vec<String> {
    let before = ["d", "d_", "der_"].iter().map(|prefix| format!("{prefix}{input}"));
    let behind = ["_dot", "dot", "_derivative", "_der"].iter().map(|suffix| format!("{input}{suffix}"));
    let around = [format!("d{input}dt"), format!("d{input}_dt"), format!("d{input}/dt"), format!("der({input})")];
    before.chain(behind).chain(around).collect()
}

/// Names that the next value of an input may have.
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

/// Error of a file with a single problem.
fn refused(path: &Path, problem: impl Into<String>) -> Error {
    Error::Import { path: path.to_owned(), problems: vec![problem.into()] }
}

/// Columns and content of a model's file; a file of tensors needs the layers of an interface.
fn read(path: &Path, interface: Option<&ModelInterface>) -> Result<(Vec<u8>, Imported)> {
    let bytes = reading::read(path, reading::MAX_WHOLE).map_err(Error::io(path, "read"))?;
    if let Some(kind) = kinds::of(path).filter(|kind| !kind.is_trained_model()) {
        return Err(refused(path, kind.instead("a trained model: ONNX, .npz or .safetensors")));
    }
    if let Some(problem) = tensors::made_already(&bytes) {
        return Err(refused(path, problem));
    }
    let tensors = match &bytes {
        _ if tensors::is_npz(&bytes) => Some(tensors::read_npz(&bytes).map_err(ImportError::of_file(path))?),
        _ if tensors::is_safetensors(&bytes) => {
            Some(tensors::read_safetensors(&bytes).map_err(ImportError::of_file(path))?)
        }
        _ => None,
    };
    let imported = match (tensors, interface) {
        (Some(tensors), Some(interface)) => tensors::layers(&tensors, interface)?,
        (Some(tensors), None) => {
            let known: Vec<&str> = tensors.keys().map(String::as_str).collect();
            let problem = format!(
                "only tensors ({}): an interface has to say which are layers, [[layers]] with weight, bias and activation; \
                 docs/import.md has an example",
                listed(&known)
            );
            return Err(refused(path, problem));
        }
        (None, interface) => {
            if let Some(interface) = interface.filter(|interface| !interface.layers.is_empty()) {
                let message = "belongs to models that are only tensors (.npz, .safetensors)";
                interface.refuse(Problems::one("layers", message))?;
            }
            let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
            onnx::read(&bytes, Some(folder)).map_err(ImportError::of_file(path))?
        }
    };
    Ok((bytes, imported))
}

/// Compares the outputs with those of a table, row by row.
fn check(
    surrogate: &Surrogate,
    interface: &ModelInterface,
    path: &Path,
    tolerance: f64,
) -> Result<Vec<OutputDifference>> {
    let mut table = Table::open(path)?;
    let outputs = surrogate.outputs();
    let expected: Vec<(&str, &str)> =
        outputs.iter().map(|output| (output.name.as_str(), output.unit.as_str())).collect();
    let mut of_inputs = import::columns(&table, interface, &expected)?;
    let of_outputs = of_inputs.split_off(of_inputs.len() - outputs.len());
    let mut along = if surrogate.program().has_memory() { Some(roll_outs(surrogate, path)?.into_iter()) } else { None };
    let (mut evaluator, mut found) = (Evaluator::new(surrogate), vec![0.0; outputs.len()]);
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
                evaluator.evaluate(&point, &mut found);
            }
        }
        compared += 1;
        for (output, column) in of_outputs.iter().enumerate() {
            let expected = table.number(*column)?;
            let difference = (found[output] - expected).abs();
            let [min, max] = ranges[output];
            ranges[output] = [min.min(expected), max.max(expected)];
            // NaN counts as the largest difference
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
        OutputDifference { output: output.name.clone(), largest, relative, row, fits: relative <= tolerance }
    };
    Ok(outputs.iter().zip(largest).zip(ranges).map(difference).collect())
}

/// A unique name, neither among those that are taken nor among those of every FMU; it is taken then.
fn free(wanted: &str, taken: &mut HashSet<String>) -> String {
    let is_reserved = wanted == TIME || BuiltIn::ALWAYS.iter().any(|variable| variable.name() == wanted);
    let numbered = (if is_reserved { 1 } else { 2 }..).map(|number| format!("{wanted}_{number}"));
    let names = (!is_reserved).then(|| wanted.to_owned()).into_iter().chain(numbered);
    let name = names.into_iter().find(|name| !taken.contains(name)).unwrap_or_else(|| wanted.to_owned());
    taken.insert(name.clone());
    name
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
