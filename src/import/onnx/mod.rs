//! Third-party models as ONNX files: a graph becomes a map of one row of its inputs, or a map with states if it has
//! recurrent cells.
//!
//! Every tensor is followed through the graph for a single row: its batch has the size 1, and all other dimensions are
//! known. Operators that only move elements (a reshape, a slice, a concatenation) become a choice of columns. Numbers
//! that do not depend on the inputs are computed here.

mod attributes;
mod batch;
mod node;
mod operators;
pub(crate) mod proto;
mod shape;
mod tensor;
mod trees;

use super::{Imported, RecurrentState, builder::Builder};
use crate::{Error, Result, reading};
use batch::TwoRows;
use node::{RowTensor, Value};
use prost::Message;
use proto::{DOUBLE, FLOAT, GraphProto, ModelProto, ValueInfoProto, type_name};
use std::{collections::HashMap, path::Path};
use tensor::ConstantTensor;

/// Oldest and newest version of the standard operators whose meaning is known here.
const OPSETS: std::ops::RangeInclusive<i64> = 7..=24;

/// Reads an ONNX file.
///
/// # Errors
/// [`Error::Io`] if it cannot be read, [`Error::Import`] with the nodes and operators that do not fit.
pub fn load(path: &Path) -> Result<Imported> {
    let bytes = reading::read(path, reading::MAX_WHOLE).map_err(Error::io(path, "read"))?;
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    read(&bytes, Some(folder)).map_err(|problems| Error::Import { path: path.to_owned(), problems })
}

/// Reads the bytes of an ONNX file; `folder` is where external data may be.
///
/// # Errors
/// Sentences about the parts that are not supported.
pub fn read(bytes: &[u8], folder: Option<&Path>) -> std::result::Result<Imported, Vec<String>> {
    let one = |problem: String| vec![problem];
    let model = ModelProto::decode(bytes).map_err(|error| one(format!("not an ONNX model, or cut short: {error}")))?;
    let graph = model.graph.as_ref().ok_or_else(|| one("no graph: not an ONNX model, or an empty one".into()))?;
    let opset = opset(&model).map_err(one)?;
    let unknown = unknown_operators(graph);
    if !unknown.is_empty() {
        return Err(unknown);
    }
    let mut reader = GraphReader::new(graph, opset, folder, 1).map_err(one)?;
    let mut two_rows = TwoRows::of(graph, opset, folder);
    for (number, node) in graph.node.iter().enumerate() {
        let about = |problem: String| one(format!("{}: {problem}", node::title(number, node)));
        reader.node(node).map_err(about)?;
        let has_memory =
            two_rows.as_mut().map_or(Ok(false), |two_rows| two_rows.follow(node, &reader)).map_err(about)?;
        two_rows = two_rows.filter(|_| has_memory);
    }
    let producer = [model.producer_name.as_str(), model.producer_version.as_str()].join(" ").trim().to_owned();
    reader.finish(graph, producer)
}

/// A column of a model with its description.
#[derive(Clone, Debug, PartialEq)]
pub struct Described {
    /// The variable.
    pub name: String,
    /// Its unit.
    pub unit: String,
    /// Its range, of an input.
    pub range: Option<[f64; 2]>,
}

/// Descriptions of inputs and outputs that metafmu wrote into an ONNX model, in the order of the columns; empty for
/// other models.
pub fn described(bytes: &[u8]) -> [Vec<Described>; 2] {
    let none = [Vec::new(), Vec::new()];
    let Ok(model) = ModelProto::decode(bytes) else { return none };
    if model.producer_name != "metafmu" {
        return none;
    }
    let entry =
        |key: &str| model.metadata_props.iter().find(|entry| entry.key == key).map(|entry| entry.value.as_str());
    let texts =
        |key: &str| entry(key).and_then(|text| serde_json::from_str::<Vec<String>>(text).ok()).unwrap_or_default();
    let numbers =
        |key: &str| entry(key).and_then(|text| serde_json::from_str::<Vec<f64>>(text).ok()).unwrap_or_default();
    let (min, max) = (numbers("input_min"), numbers("input_max"));
    [("input", true), ("output", false)].map(|(what, has_range)| {
        let (names, units) = (texts(&format!("{what}_names")), texts(&format!("{what}_units")));
        let range = |place: usize| Some([*min.get(place)?, *max.get(place)?]).filter(|_| has_range);
        let of = |(place, name): (usize, String)| Described {
            unit: units.get(place).cloned().unwrap_or_default(),
            range: range(place),
            name,
        };
        names.into_iter().enumerate().map(of).collect()
    })
}

/// The version of the standard operators.
fn opset(model: &ModelProto) -> std::result::Result<i64, String> {
    let standard = model.opset_import.iter().find(|set| node::is_standard(&set.domain));
    let version = standard.map_or(*OPSETS.end(), |set| set.version);
    if OPSETS.contains(&version) {
        return Ok(version);
    }
    let (first, last) = (OPSETS.start(), OPSETS.end());
    Err(format!("operators of version (opset) {version}, expected {first} to {last}"))
}

/// A sentence for each operator that is not known here, with the nodes that have it.
fn unknown_operators(graph: &GraphProto) -> Vec<String> {
    let mut found: Vec<(String, Vec<String>)> = Vec::new();
    for (number, node) in graph.node.iter().enumerate().filter(|(_, node)| !operators::is_known(node)) {
        let (operator, title) = (node::operator(node), node::title(number, node));
        match found.iter_mut().find(|(known, _)| *known == operator) {
            Some((_, nodes)) => nodes.push(title),
            None => found.push((operator, vec![title])),
        }
    }
    let sentence = |(operator, nodes): (String, Vec<String>)| {
        let nodes: Vec<&str> = nodes.iter().map(String::as_str).collect();
        let nodes = crate::diagnostics::names::listed(&nodes[..nodes.len().min(20)]);
        format!("operator {operator} ({nodes}) is not supported{}", operators::instead(&operator))
    };
    found.into_iter().map(sentence).collect()
}

/// A graph that is being followed.
struct GraphReader {
    opset: i64,
    builder: Builder,
    /// Value of each name.
    values: HashMap<String, Value>,
    /// Numbers of the constants that nodes made.
    constants: usize,
    inputs: Vec<String>,
    stacked: Vec<(String, usize, usize)>,
    is_single: bool,
    /// States that are no inputs of the graph.
    recurrences: Vec<RecurrentState>,
    /// `true` if the graph has trees: inputs of comparisons with thresholds are rounded as in the model.
    has_trees: bool,
    /// Further outputs of operators, which are not read here, with their meaning.
    beside: HashMap<String, String>,
}

impl GraphReader {
    /// A reader for `batch` rows, where the first dimension of an input is free.
    fn new(graph: &GraphProto, opset: i64, folder: Option<&Path>, batch: usize) -> std::result::Result<Self, String> {
        let mut values = HashMap::new();
        for proto in &graph.initializer {
            let tensor = ConstantTensor::read(proto, folder)
                .map_err(|problem| format!("initializer `{}`: {problem}", proto.name))?;
            values.insert(proto.name.clone(), Value::Constant(tensor));
        }
        // older files list their initializers among the inputs
        let given: Vec<&ValueInfoProto> =
            graph.input.iter().filter(|input| !values.contains_key(&input.name)).collect();
        let is_recurrent = graph.node.iter().any(|node| operators::RECURRENT.contains(&node.op_type.as_str()));
        let mut rows = Vec::new();
        for input in &given {
            let about = |problem: String| format!("input `{}`: {problem}", input.name);
            rows.push((&input.name, input_shape(input, is_recurrent, batch).map_err(about)?));
        }
        if rows.is_empty() {
            return Err("the graph has no inputs".into());
        }
        let names = rows.iter().flat_map(|(name, (shape, _))| element_names(name, shape.iter().product()));
        let inputs: Vec<String> = names.collect();
        let of_rows = |(name, (shape, _)): &(&String, (Vec<usize>, bool))| match shape.as_slice() {
            [rows, rest @ ..] if *rows > 1 && !rest.is_empty() => {
                Some((name.to_string(), *rows, rest.iter().product()))
            }
            _ => None,
        };
        let stacked = rows.iter().filter_map(of_rows).collect();
        let mut builder = Builder::new(inputs.len());
        let is_single = rows.iter().all(|(_, (_, is_single))| *is_single);
        let has_trees = graph.node.iter().any(|node| node.op_type.starts_with("TreeEnsemble"));
        let source = match is_single && has_trees {
            true => builder.elementwise(0, metafmu_runtime::graph::Elementwise::Single, Vec::new())?,
            false => 0,
        };
        let mut first = 0;
        for (name, (shape, is_single)) in rows {
            let count: usize = shape.iter().product();
            let columns = (first..first + count).map(|column| [source as u32, column as u32]).collect();
            let value = builder.columns(columns)?;
            if values.insert(name.clone(), Value::Row(RowTensor { shape, value, is_single })).is_some() {
                return Err(format!("input `{name}` is there twice, expected names that are unique"));
            }
            first += count;
        }
        Ok(Self {
            opset,
            builder,
            values,
            constants: 0,
            inputs,
            stacked,
            is_single,
            recurrences: Vec::new(),
            has_trees,
            beside: HashMap::new(),
        })
    }

    fn finish(self, graph: &GraphProto, producer: String) -> std::result::Result<Imported, Vec<String>> {
        let Self { mut builder, values, inputs, stacked, is_single, recurrences, beside, .. } = self;
        let (mut columns, mut outputs) = (Vec::new(), Vec::new());
        for output in &graph.output {
            let row = match values.get(&output.name) {
                Some(Value::Row(row)) => row.clone(),
                Some(Value::Constant(tensor)) => {
                    node::constant_row(&mut builder, tensor).map_err(|problem| vec![problem])?
                }
                None => {
                    let why = beside.get(&output.name).map_or("made by no node", String::as_str);
                    return Err(vec![format!("output `{}` is {why}", output.name)]);
                }
            };
            let count: usize = row.shape.iter().product();
            outputs.extend(element_names(&output.name, count));
            columns.extend((0..count).map(|column| [row.value as u32, column as u32]));
        }
        if columns.is_empty() {
            return Err(vec!["the graph has no outputs".into()]);
        }
        Ok(Imported { inputs, stacked, outputs, builder, columns, recurrences, is_single, producer })
    }
}

/// The names of a tensor's elements: its own if it has one, else with their places.
fn element_names(name: &str, count: usize) -> Vec<String> {
    match count {
        1 => vec![name.to_owned()],
        _ => (0..count).map(|place| format!("{name}[{place}]")).collect(),
    }
}

fn known(dim: &proto::DimensionProto) -> Option<i64> {
    dim.dim_value.filter(|value| *value > 0)
}

/// Returns true if the first dimension of an input is free: the batch.
fn is_batch(input: &ValueInfoProto) -> bool {
    let tensor = input.r#type.as_ref().and_then(|of| of.tensor_type.as_ref());
    tensor.and_then(|tensor| tensor.shape.as_ref()?.dim.first()).is_some_and(|dim| known(dim).is_none())
}

/// Shape of one row of an input, the batch included, and `true` if it has single precision. Of recurrent cells there is
/// one sample, and the batch may be any dimension.
fn input_shape(
    input: &ValueInfoProto,
    is_recurrent: bool,
    batch: usize,
) -> std::result::Result<(Vec<usize>, bool), String> {
    let tensor = input.r#type.as_ref().and_then(|of| of.tensor_type.as_ref()).ok_or("not a tensor")?;
    let is_single = match tensor.elem_type {
        FLOAT => true,
        DOUBLE => false,
        other => return Err(format!("elements of type {}, expected float or double", type_name(other))),
    };
    let dims = &tensor.shape.as_ref().ok_or("no shape: expected one with the number of columns")?.dim;
    let mut shape = Vec::new();
    for (place, dim) in dims.iter().enumerate() {
        match (place, known(dim)) {
            (_, Some(value)) => shape.push(value as usize),
            (0, None) => shape.push(batch),
            (_, None) if is_recurrent => shape.push(1),
            (place, None) if dim.dim_value == Some(0) => {
                return Err(format!("dimension {place} is 0, expected a positive number"));
            }
            (place, None) => {
                let name = dim.dim_param.as_deref().unwrap_or("?");
                return Err(format!("dimension {place} is free (`{name}`), expected a number"));
            }
        }
    }
    let count = tensor::within_limits(&shape)?;
    if count > metafmu_runtime::graph::MAX_VALUES {
        return Err(format!("{count} columns, expected at most {}", metafmu_runtime::graph::MAX_VALUES));
    }
    Ok((shape, is_single))
}
