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
#[doc(hidden)]
pub mod proto;
mod shape;
mod tensor;
mod trees;

use super::{
    ImportError, ImportPlace, Imported, NodePlace, RecurrentState,
    builder::{Builder, GraphError},
};
use crate::{Error, Result, reading};
use batch::TwoRows;
use metafmu_runtime::graph::{Elementwise, MAX_VALUES};
use node::{RowTensor, Value};
use prost::Message;
use proto::{DOUBLE, FLOAT, GraphProto, ModelProto, NodeProto, ValueInfoProto, type_name};
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
    read(&bytes, Some(folder)).map_err(ImportError::of_file(path))
}

/// Reads the bytes of an ONNX file; `folder` is where external data may be.
///
/// # Errors
/// An error for each operator that is unknown, else the first part that cannot be read.
pub fn read(bytes: &[u8], folder: Option<&Path>) -> std::result::Result<Imported, Vec<ImportError>> {
    let model = ModelProto::decode(bytes)
        .map_err(|error| ImportError::malformed(format!("not an ONNX model, or cut short: {error}")))?;
    let graph = model.graph.as_ref();
    let graph = graph.ok_or_else(|| ImportError::malformed("no graph: not an ONNX model, or an empty one"))?;
    let opset = opset(&model)?;
    let unknown = unknown_operators(graph);
    if !unknown.is_empty() {
        return Err(unknown);
    }
    let mut reader = GraphReader::new(graph, opset, folder, 1)?;
    let mut two_rows = TwoRows::of(graph, opset, folder);
    for (number, node) in graph.node.iter().enumerate() {
        let followed = follow(node, &mut reader, two_rows.as_mut());
        let fits_two = followed.map_err(|error| error.at(ImportPlace::Nodes(vec![node::place(number, node)])))?;
        two_rows = two_rows.filter(|_| fits_two);
    }
    let producer = [model.producer_name.as_str(), model.producer_version.as_str()].join(" ").trim().to_owned();
    Ok(reader.finish(graph, producer)?)
}

/// Follows a node for one row, and for two if all nodes before fit two. Returns true if this one fits two as well.
fn follow(
    node: &NodeProto,
    reader: &mut GraphReader,
    two_rows: Option<&mut TwoRows>,
) -> std::result::Result<bool, ImportError> {
    reader.node(node)?;
    two_rows.map_or(Ok(false), |two_rows| two_rows.follow(node, reader))
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
    let ranges: Vec<[f64; 2]> = min.into_iter().zip(max).map(|(min, max)| [min, max]).collect();
    [("input", true), ("output", false)].map(|(what, has_range)| {
        let (names, units) = (texts(&format!("{what}_names")), texts(&format!("{what}_units")));
        names
            .into_iter()
            .enumerate()
            .map(|(place, name)| Described {
                unit: units.get(place).cloned().unwrap_or_default(),
                range: ranges.get(place).copied().filter(|_| has_range),
                name,
            })
            .collect()
    })
}

/// The version of the standard operators.
fn opset(model: &ModelProto) -> std::result::Result<i64, ImportError> {
    let standard = model.opset_import.iter().find(|set| node::is_standard(&set.domain));
    let version = standard.map_or(*OPSETS.end(), |set| set.version);
    if OPSETS.contains(&version) {
        return Ok(version);
    }
    let (first, last) = (OPSETS.start(), OPSETS.end());
    Err(ImportError::unsupported(format!("operators of version (opset) {version}, expected {first} to {last}")))
}

/// An error for each operator that is not known here, with the nodes that have it.
fn unknown_operators(graph: &GraphProto) -> Vec<ImportError> {
    let mut unknown: Vec<UnknownOperator> = Vec::new();
    for (number, node) in graph.node.iter().enumerate().filter(|(_, node)| !operators::is_known(node)) {
        let place = node::place(number, node);
        match unknown.iter_mut().find(|known| known.title == node::operator(node)) {
            Some(known) => known.nodes.push(place),
            None => unknown.push(UnknownOperator { title: node::operator(node), nodes: vec![place] }),
        }
    }
    unknown.into_iter().map(UnknownOperator::error).collect()
}

/// An operator that is not known here.
struct UnknownOperator {
    /// Domain and name for people.
    title: String,
    nodes: Vec<NodePlace>,
}

impl UnknownOperator {
    fn error(self) -> ImportError {
        let Self { title, nodes } = self;
        let instead = operators::instead(&nodes[0].operator);
        let place = ImportPlace::Nodes(nodes);
        let message = format!("operator {title} ({place}) is not supported{instead}");
        ImportError::unsupported(message).naming(place)
    }
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
    fn new(
        graph: &GraphProto,
        opset: i64,
        folder: Option<&Path>,
        batch: usize,
    ) -> std::result::Result<Self, ImportError> {
        let mut values = HashMap::new();
        for proto in &graph.initializer {
            let tensor = ConstantTensor::read(proto, folder)
                .map_err(|error| error.at(ImportPlace::Initializer(proto.name.clone())))?;
            values.insert(proto.name.clone(), Value::Constant(tensor));
        }
        // older files list their initializers among the inputs
        let given: Vec<&ValueInfoProto> =
            graph.input.iter().filter(|input| !values.contains_key(&input.name)).collect();
        let is_recurrent = graph.node.iter().any(|node| operators::RECURRENT.contains(&node.op_type.as_str()));
        let mut rows = Vec::new();
        for input in &given {
            let shape = input_shape(input, is_recurrent, batch);
            rows.push((&input.name, shape.map_err(|error| error.at(ImportPlace::Input(input.name.clone())))?));
        }
        if rows.is_empty() {
            return Err(ImportError::unsupported("the graph has no inputs"));
        }
        let names = rows.iter().flat_map(|(name, (shape, _))| element_names(name, shape.iter().product()));
        let inputs: Vec<String> = names.collect();
        let stacked = rows
            .iter()
            .filter_map(|(name, (shape, _))| match shape.as_slice() {
                [rows, rest @ ..] if *rows > 1 && !rest.is_empty() => {
                    Some((name.to_string(), *rows, rest.iter().product()))
                }
                _ => None,
            })
            .collect();
        let mut builder = Builder::new(inputs.len());
        let is_single = rows.iter().all(|(_, (_, is_single))| *is_single);
        let has_trees = graph.node.iter().any(|node| node.op_type.starts_with("TreeEnsemble"));
        let source = match is_single && has_trees {
            true => builder.elementwise(0, Elementwise::Single, Vec::new())?,
            false => 0,
        };
        let mut first = 0;
        for (name, (shape, is_single)) in rows {
            let count: usize = shape.iter().product();
            let columns = (first..first + count).map(|column| [source as u32, column as u32]).collect();
            let value = builder.columns(columns)?;
            if values.insert(name.clone(), Value::Row(RowTensor { shape, value, is_single })).is_some() {
                let place = ImportPlace::Input(name.clone());
                let message = format!("{place} is there twice, expected names that are unique");
                return Err(ImportError::malformed(message).naming(place));
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

    fn finish(self, graph: &GraphProto, producer: String) -> std::result::Result<Imported, ImportError> {
        let Self { mut builder, values, inputs, stacked, is_single, recurrences, beside, .. } = self;
        let (mut columns, mut outputs) = (Vec::new(), Vec::new());
        for output in &graph.output {
            let row = match values.get(&output.name) {
                Some(Value::Row(row)) => row.clone(),
                Some(Value::Constant(tensor)) => node::constant_row(&mut builder, tensor)?,
                None => {
                    let place = ImportPlace::Output(output.name.clone());
                    let error = match beside.get(&output.name) {
                        Some(what) => ImportError::unsupported(format!("{place} is {what}")),
                        None => ImportError::malformed(format!("{place} is made by no node")),
                    };
                    return Err(error.naming(place));
                }
            };
            let count: usize = row.shape.iter().product();
            outputs.extend(element_names(&output.name, count));
            columns.extend((0..count).map(|column| [row.value as u32, column as u32]));
        }
        if columns.is_empty() {
            return Err(ImportError::malformed("the graph has no outputs"));
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
) -> std::result::Result<(Vec<usize>, bool), ImportError> {
    let tensor = input.r#type.as_ref().and_then(|of| of.tensor_type.as_ref());
    let tensor = tensor.ok_or_else(|| ImportError::unsupported("not a tensor"))?;
    let is_single = match tensor.elem_type {
        FLOAT => true,
        DOUBLE => false,
        other => {
            return Err(ImportError::unsupported(format!(
                "elements of type {}, expected float or double",
                type_name(other)
            )));
        }
    };
    let given = tensor.shape.as_ref();
    let given = given.ok_or_else(|| ImportError::unsupported("no shape: expected one with the number of columns"))?;
    let mut shape = Vec::new();
    for (place, dim) in given.dim.iter().enumerate() {
        match (place, known(dim)) {
            (_, Some(value)) => shape.push(value as usize),
            (0, None) => shape.push(batch),
            (_, None) if is_recurrent => shape.push(1),
            (place, None) if dim.dim_value == Some(0) => {
                return Err(ImportError::unsupported(format!("dimension {place} is 0, expected a positive number")));
            }
            (place, None) => {
                let name = dim.dim_param.as_deref().unwrap_or("?");
                return Err(ImportError::unsupported(format!(
                    "dimension {place} is free (`{name}`), expected a number"
                )));
            }
        }
    }
    let count = tensor::within_limits(&shape)?;
    if count > MAX_VALUES {
        return Err(ImportError::too_large(format!("{count} columns, expected at most {MAX_VALUES}")));
    }
    Ok((shape, is_single))
}
