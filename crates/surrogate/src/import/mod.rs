//! Third-party models: a file with a trained network, and an interface that describes its columns, become a surrogate.

pub mod builder;
mod cover;
mod error;
pub mod interface;
pub mod onnx;
pub mod rounding;
mod stateful;
pub mod tensors;

use crate::{Error, Result, diagnostics::Problems, surrogate, table::Table};
use builder::{Builder, GraphError};
pub use error::{ImportCause, ImportError, ImportPlace, NodePlace};
use interface::{
    ColumnSource, InterfaceCausality, InterfaceDomain, InterfaceInput, InterfaceVariability, Mapping, ModelInterface,
    OutputSource,
};
use metafmu_runtime::{
    Encoding, Evaluator, Graph, Input, Metadata, Output, Precision, Provenance, Role, Rows, Surrogate, Tunability,
    graph::{Elementwise, Step},
};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use sha2::{Digest, Sha256};
use std::path::Path;

/// A model that was read: columns by name, and the graph between them.
#[derive(Debug)]
pub struct Imported {
    /// Names of the columns that it takes, in the order of the graph's.
    pub inputs: Vec<String>,
    /// Inputs of several rows, which may be a batch: the name, the number of rows, and the numbers in a row.
    pub stacked: Vec<(String, usize, usize)>,
    /// Names of the columns that it gives.
    pub outputs: Vec<String>,
    /// The graph.
    pub builder: Builder,
    /// Value, and number in it, of each column that it gives.
    pub columns: Vec<[u32; 2]>,
    /// States that the model itself has.
    pub recurrences: Vec<RecurrentState>,
    /// `true` if the model computes in single precision.
    pub is_single: bool,
    /// Program that wrote the model.
    pub producer: String,
}

/// Hidden state: numbers that a model keeps from one sample to the next and that are not columns of it.
#[derive(Clone, Debug)]
pub struct RecurrentState {
    /// Its name in the model.
    pub name: String,
    /// First input column of the graph, behind those of the model.
    pub first: usize,
    /// The value that has the next numbers.
    pub next: usize,
    /// Their initial values.
    pub start: Vec<f64>,
}

impl Imported {
    /// The model as a graph of variables.
    ///
    /// # Errors
    /// [`GraphError::TooLarge`], [`GraphError::NotFinite`].
    pub fn into_graph(self, mapping: &Mapping, variables: usize) -> std::result::Result<Graph, GraphError> {
        let columns = mapping
            .outputs
            .iter()
            .filter_map(|shown| match shown {
                OutputSource::Column(column) => Some(self.columns[*column]),
                // there are no states
                OutputSource::State(_) => None,
            })
            .collect();
        into_graph(self.builder, &mapping.inputs, variables, columns)
    }
}

/// The graph from `width` columns, of which `sources` are the input columns of a graph, to numbers of its values.
fn into_graph(
    mut builder: Builder,
    sources: &[ColumnSource],
    width: usize,
    mut columns: Vec<[u32; 2]>,
) -> std::result::Result<Graph, GraphError> {
    let in_order = sources.len() == width
        && sources.iter().enumerate().all(|(column, source)| *source == ColumnSource::Input(column));
    if !in_order {
        let further: u32;
        (builder, further) = arranged(builder, sources, width);
        columns.iter_mut().for_each(|[of, _]| *of += further);
    }
    let outputs = columns.len();
    let graph = builder.finish(columns)?;
    // products of finite weights may not be finite
    graph.check(width, outputs).map_err(GraphError::NotFinite)?;
    Ok(graph)
}

/// A graph of variables, of which its columns are some, and others are constants; and how many values it has more. A constant is 0 times some
/// variable, and itself.
fn arranged(mut builder: Builder, sources: &[ColumnSource], variables: usize) -> (Builder, u32) {
    let mut further = 1;
    if !sources.iter().all(|source| matches!(source, ColumnSource::Input(_))) {
        let (mut factors, mut offsets) = (Vec::new(), Vec::new());
        for source in sources {
            let (factor, offset) = match source {
                ColumnSource::Input(_) => (1.0, 0.0),
                ColumnSource::Value(value) => (0.0, *value),
                ColumnSource::State(_) => (0.0, 0.0),
            };
            factors.push(factor);
            offsets.push(offset);
        }
        let (function, parameters) = (Elementwise::Linear, [factors, offsets].concat());
        builder = builder.after(sources.len(), Step::Elementwise { of: 0, function, parameters });
        further += 1;
    }
    let columns = sources
        .iter()
        .map(|source| match source {
            ColumnSource::Input(input) => [0, *input as u32],
            ColumnSource::Value(_) | ColumnSource::State(_) => [0, 0],
        })
        .collect();
    (builder.after(variables, Step::Columns { columns }), further)
}

/// Points at which the ranges of outputs are found, if there are no data.
const POINTS: usize = 4096;

/// Origin of a map.
#[derive(Clone, Copy, Debug)]
pub struct About<'a> {
    /// Path of its file, or its name in messages.
    pub path: &'a Path,
    /// Its content, which identifies it: the bytes of its file, for instance.
    pub content: &'a [u8],
    /// `true` if the model computes in single precision.
    pub is_single: bool,
    /// Program that wrote the model.
    pub producer: &'a str,
}

/// The surrogate of a model. `bytes` is the content of its file, `rows` are training data with a column for each input
/// that is a variable. Their ranges count where the interface has none.
///
/// # Errors
/// [`Error::Study`] with the keys of the interface that do not fit, [`Error::Import`] if the model has no finite outputs.
pub fn surrogate(
    (path, bytes): (&Path, &[u8]),
    imported: Imported,
    interface: &ModelInterface,
    rows: Option<Rows>,
) -> Result<Surrogate> {
    let mapping = interface.mapping(&imported.inputs, &imported.outputs)?;
    if !(interface.states.is_empty() && imported.recurrences.is_empty()) {
        return stateful::surrogate((path, bytes), imported, interface, &mapping, rows);
    }
    let message = "belongs to states that have a `next` value";
    interface
        .refuse(interface.time.sample.map_or_else(Problems::default, |_| Problems::one("time.sample", message)))?;
    let inputs = inputs(interface, rows.as_ref())?;
    let (is_single, producer) = (imported.is_single, imported.producer.clone());
    let graph = imported.into_graph(&mapping, inputs.len()).map_err(ImportError::from);
    let graph = graph.map_err(ImportError::of_file(path))?;
    let about = About { path, content: bytes, is_single, producer: &producer };
    of_graph(graph, about, interface, rows)
}

/// Surrogate of a graph. Its columns are the variable inputs of the interface.
///
/// # Errors
/// As [`surrogate()`].
pub fn of_graph(graph: Graph, about: About, interface: &ModelInterface, rows: Option<Rows>) -> Result<Surrogate> {
    let message = "belongs to models in files: ONNX, .npz, .safetensors";
    let has_states = !interface.states.is_empty();
    interface.refuse(if has_states { Problems::one("states", message) } else { Problems::default() })?;
    let mut inputs = inputs(interface, rows.as_ref())?;
    let has_time = inputs.iter().any(|input| input.role == Role::Time);
    let known = rows.as_ref().filter(|_| interface.domain == InterfaceDomain::Data);
    let cover = known.and_then(|rows| cover::of_rows(rows, &inputs));
    if let (Some(rows), Some(cover)) = (known, &cover) {
        cover::start_among(rows, cover, &mut inputs, |input| {
            interface.inputs.get(&input.name).is_none_or(|options| options.start.is_none())
        });
    }
    let ranges: Vec<[f64; 2]> = inputs.iter().map(|input| [input.min, input.max]).collect();
    let is_single = about.is_single && graph.fits_single(&ranges);
    let metadata = Metadata {
        precision: if is_single { Precision::Single } else { Precision::Double },
        stop_time: (!has_time).then_some(interface.time.stop),
        cover,
        ..metadata(about, interface, inputs, rows.as_ref().map_or(0, Rows::len))
    };
    let surrogate = Surrogate::new(metadata, graph.clone()).map_err(|source| Error::Surrogate { source })?;
    let ranges = match &rows {
        Some(rows) => output_ranges(&surrogate, rows),
        None => output_ranges(&surrogate, points(surrogate.inputs())),
    };
    let ranges = ranges.map_err(ImportError::of_file(about.path))?;
    let metadata = with_ranges(surrogate.metadata(), &ranges);
    surrogate::seal(Surrogate::new(metadata, graph).map_err(|source| Error::Surrogate { source })?)
}

fn with_ranges(metadata: &Metadata, ranges: &[[f64; 2]]) -> Metadata {
    let mut metadata = metadata.clone();
    for (output, [min, max]) in metadata.outputs.iter_mut().zip(ranges) {
        (output.min, output.max) = (*min, *max);
    }
    metadata
}

/// Metadata of a model with these inputs, from its interface; ranges of outputs are not known yet.
fn metadata(about: About, interface: &ModelInterface, inputs: Vec<Input>, rows: usize) -> Metadata {
    let About { content, producer, .. } = about;
    let outputs = interface.outputs.iter().map(|(name, output)| Output {
        name: name.clone(),
        unit: output.unit.clone(),
        description: output.description.clone(),
        min: 0.0,
        max: 0.0,
        std_of: output.std_of,
    });
    let digest = Sha256::new().chain_update(interface.text().as_bytes()).chain_update(content).finalize();
    Metadata {
        name: interface.name.clone(),
        description: interface.description.clone(),
        inputs,
        outputs: outputs.collect(),
        states: Vec::new(),
        arrays: Vec::new(),
        bounds: None,
        solver_error: None,
        cover: None,
        precision: Precision::Double,
        time_step: interface.time.communication_step(),
        stop_time: Some(interface.time.stop),
        provenance: Provenance {
            tool: match producer {
                "" => concat!("metafmu ", env!("CARGO_PKG_VERSION")).into(),
                producer => format!("metafmu {}, of a model by {producer}", env!("CARGO_PKG_VERSION")),
            },
            study_digest: digest.iter().map(|byte| format!("{byte:02x}")).collect(),
            seed: 0,
            train_rows: rows as u64,
            content_digest: "0".repeat(64),
        },
    }
}

/// The inputs of the FMU; every range that is missing is a problem, and one that most of the rows are outside of.
pub fn inputs(interface: &ModelInterface, rows: Option<&Rows>) -> Result<Vec<Input>> {
    let mut problems = Problems::default();
    let mut inputs = Vec::new();
    for (position, (name, options)) in interface.variables().enumerate() {
        let values = rows.into_iter().flatten().map(|row| row[position]);
        let found = (rows.is_some()).then(|| {
            values
                .clone()
                .fold([f64::INFINITY, f64::NEG_INFINITY], |[min, max], value| [min.min(value), max.max(value)])
        });
        let of_time = (options.causality == InterfaceCausality::Time).then_some([0.0, interface.time.stop]);
        let usual = of_time.or(found);
        let (min, max) = (options.min.or(usual.map(|[min, _]| min)), options.max.or(usual.map(|[_, max]| max)));
        if let Some(problem) = mostly_outside([options.min, options.max], values) {
            problems.add(format!("inputs.{name}"), problem);
            continue;
        }
        let (Some(min), Some(max)) = (min, max) else {
            let message = "has no range: expected `min` and `max`, or a table of training data, by --data";
            problems.add(format!("inputs.{name}"), message);
            continue;
        };
        if min > max {
            problems.add(
                format!("inputs.{name}"),
                format!("a range from {min} to {max}: the table and the interface do not fit each other"),
            );
            continue;
        }
        let start = options.start.unwrap_or(if of_time.is_some() { min } else { 0.5 * min + 0.5 * max });
        problems.expect(
            (min..=max).contains(&start),
            format!("inputs.{name}.start"),
            start,
            &format!("a value from {min} to {max}"),
        );
        inputs.push(Input {
            name: if of_time.is_some() { TIME.into() } else { name.clone() },
            role: role(options),
            unit: unit(options).into(),
            description: options.description.clone(),
            min,
            max,
            start,
            encoding: Encoding::Plain,
        });
    }
    interface.refuse(problems)?;
    Ok(inputs)
}

/// Problem of a stated range that excludes most of the training data, which may be those of another column or unit.
fn mostly_outside([min, max]: [Option<f64>; 2], values: impl Iterator<Item = f64> + Clone) -> Option<String> {
    let (low, high) = (min.unwrap_or(f64::NEG_INFINITY), max.unwrap_or(f64::INFINITY));
    // an end that was rounded is not outside
    let slack = 1e-6 * if (high - low).is_finite() { high - low } else { 0.0 };
    let count = values.clone().count();
    let outside = values.clone().filter(|value| *value < low - slack || *value > high + slack).count();
    let [least, most] =
        values.fold([f64::INFINITY, f64::NEG_INFINITY], |[min, max], value| [min.min(value), max.max(value)]);
    (2 * outside > count).then(|| {
        let range = match (min, max) {
            (Some(min), Some(max)) => format!("range from {min} to {max}"),
            (Some(min), None) => format!("min of {min}"),
            (None, max) => format!("max of {}", max.unwrap_or(high)),
        };
        format!(
            "{:.0} % of the rows of training data are outside of its {range}, they are from {least:.6} to {most:.6}: expected most of them inside; is this \
             the right column, in the right unit?",
            100.0 * outside as f64 / count as f64
        )
    })
}

fn role(options: &InterfaceInput) -> Role {
    match (options.causality, options.variability) {
        (InterfaceCausality::Input, _) => Role::Input,
        (InterfaceCausality::Time, _) => Role::Time,
        (InterfaceCausality::Parameter, Some(InterfaceVariability::Tunable)) => Role::Parameter(Tunability::Tunable),
        (InterfaceCausality::Parameter, _) => Role::Parameter(Tunability::Fixed),
    }
}

/// The time of the FMU, and of tables.
const TIME: &str = "time";

/// The unit of an input; that of the time is optional.
fn unit(options: &InterfaceInput) -> &str {
    if options.causality == InterfaceCausality::Time { "s" } else { &options.unit }
}

/// The columns of an interface's variables in a table, of the time that of its key or `time`; then those of `outputs`, names
/// with their units.
///
/// # Errors
/// [`Error::Table`] with all that are missing, or with all that have another unit.
pub fn columns<'a>(table: &Table, interface: &'a ModelInterface, outputs: &[(&'a str, &'a str)]) -> Result<Vec<usize>> {
    let wanted = interface
        .variables()
        .map(|(name, options)| {
            let is_missing = options.causality == InterfaceCausality::Time && table.column(name).is_err();
            (if is_missing && table.column(TIME).is_ok() { TIME } else { name.as_str() }, unit(options))
        })
        .chain(outputs.iter().copied());
    let (names, units): (Vec<&str>, Vec<&str>) = wanted.unzip();
    let columns = table.columns_of(&names)?;
    table.check_units(columns.iter().copied().zip(units.into_iter().map(Some)))?;
    Ok(columns)
}

/// The rows of a table: the columns of an interface's variables.
///
/// # Errors
/// [`Error::Table`], [`Error::Io`], [`Error::Import`] if there are no rows.
pub fn rows(path: &Path, interface: &ModelInterface) -> Result<Rows> {
    let mut table = Table::open(path)?;
    let columns = columns(&table, interface, &[])?;
    let mut rows = Rows::default();
    while table.next_row()? {
        rows.push(&columns.iter().map(|column| table.number(*column)).collect::<Result<Vec<f64>>>()?);
    }
    if rows.is_empty() {
        return Err(Error::Import { path: path.to_owned(), problems: vec!["no rows, expected at least one".into()] });
    }
    Ok(rows)
}

/// Random points in the ranges, and the start values; one at a time, because there may be many inputs.
fn points(inputs: &[Input]) -> impl Iterator<Item = Vec<f64>> {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    (0..POINTS)
        .map(move |_| {
            inputs
                .iter()
                .map(|input| input.min + random.random::<f64>() * (input.max - input.min))
                .collect::<Vec<f64>>()
        })
        .chain(std::iter::once(inputs.iter().map(|input| input.start).collect()))
}

fn output_ranges(
    surrogate: &Surrogate,
    points: impl IntoIterator<Item: AsRef<[f64]>>,
) -> std::result::Result<Vec<[f64; 2]>, ImportError> {
    let mut evaluator = Evaluator::new(surrogate);
    let mut values = vec![0.0; evaluator.results()];
    let mut ranges = vec![[f64::INFINITY, f64::NEG_INFINITY]; values.len()];
    for point in points {
        let point = point.as_ref();
        evaluator.evaluate(point, &mut values);
        for ((range, value), output) in ranges.iter_mut().zip(&values).zip(surrogate.outputs()) {
            if !value.is_finite() {
                let inputs = surrogate.inputs().iter().zip(point).take(8);
                let at: Vec<String> = inputs.map(|(input, value)| format!("{} = {value}", input.name)).collect();
                let place = ImportPlace::Output(output.name.clone());
                let at = at.join(", ");
                let message = format!("{place} is {value} at {at}: the ranges lead where the model is not defined");
                return Err(ImportError::not_finite(message).naming(place));
            }
            *range = [range[0].min(*value), range[1].max(*value)];
        }
    }
    Ok(ranges)
}

#[cfg(test)]
mod tests;
