//! Nodes and what goes between them.

use super::{
    Reader,
    proto::NodeProto,
    shape::{broadcast_places, places, strides},
    tensor::{Data, Tensor},
};
use crate::import::builder::Builder;
use metafmu_runtime::{Numbers, graph::Elementwise};

/// What a name stands for.
#[derive(Clone, Debug)]
pub enum Value {
    /// The same for all rows.
    Constant(Tensor),
    /// Follows from the inputs.
    Row(Row),
}

/// A tensor of which each row of the inputs has its own; the batch has the size 1.
#[derive(Clone, Debug)]
pub struct Row {
    pub shape: Vec<usize>,
    /// Number of the value that has its elements.
    pub value: usize,
    pub is_single: bool,
}

impl Value {
    pub fn shape(&self) -> &[usize] {
        match self {
            Self::Constant(tensor) => &tensor.shape,
            Self::Row(row) => &row.shape,
        }
    }

    pub fn constant(&self) -> Option<&Tensor> {
        match self {
            Self::Constant(tensor) => Some(tensor),
            Self::Row(_) => None,
        }
    }
}

/// Whether a domain is that of the standard operators.
pub fn is_standard(domain: &str) -> bool {
    matches!(domain, "" | "ai.onnx")
}

/// An operator with its domain, if it is not a standard one.
pub fn operator(node: &NodeProto) -> String {
    match is_standard(&node.domain) {
        true => format!("`{}`", node.op_type),
        false => format!("`{}.{}`", node.domain, node.op_type),
    }
}

/// A node for people.
pub fn title(number: usize, node: &NodeProto) -> String {
    match node.name.as_str() {
        "" => format!("node {number} ({})", node.op_type),
        name => format!("node {number} `{name}` ({})", node.op_type),
    }
}

/// A constant as a value of the graph: a network of weights that are zero.
pub fn constant_row(builder: &mut Builder, tensor: &Tensor) -> Result<Row, String> {
    let values = tensor.data.doubles();
    if values.is_empty() {
        return Err("a constant without elements".into());
    }
    let first = builder.columns(vec![[0, 0]])?;
    let value = builder.affine(first, vec![0.0; values.len()].into(), values.into())?;
    Ok(Row { shape: tensor.shape.clone(), value, is_single: matches!(tensor.data, Data::Single(_)) })
}

impl Reader {
    /// The value of the node's input, if it has that one.
    pub fn given(&self, node: &NodeProto, place: usize) -> Result<Option<&Value>, String> {
        match node.input.get(place).map(String::as_str) {
            None | Some("") => Ok(None),
            Some(name) => match self.values.get(name) {
                Some(value) => Ok(Some(value)),
                // nodes are in the order in which they can be computed
                None => Err(match self.beside.get(name) {
                    Some(what) => format!("input `{name}` is {what}"),
                    None => {
                        format!("input `{name}` is made by no earlier node: the graph has a cycle, or is not in order")
                    }
                }),
            },
        }
    }

    /// The value of the node's input.
    pub fn input(&self, node: &NodeProto, place: usize) -> Result<Value, String> {
        self.given(node, place)?.cloned().ok_or_else(|| format!("input {place} is missing"))
    }

    /// The value of the node's input, which must follow from the inputs of the graph.
    pub fn row(&self, node: &NodeProto, place: usize) -> Result<Row, String> {
        match self.input(node, place)? {
            Value::Row(row) => Ok(row),
            Value::Constant(_) => Err(format!("input {place} is a constant, expected what follows from the inputs")),
        }
    }

    /// The value of the node's input, which must be a constant.
    pub fn constant(&self, node: &NodeProto, place: usize) -> Result<Option<Tensor>, String> {
        match self.given(node, place)? {
            None => Ok(None),
            Some(Value::Constant(tensor)) => Ok(Some(tensor.clone())),
            Some(Value::Row(_)) => Err(format!(
                "input {place} `{}` follows from the graph's inputs, expected a constant",
                node.input[place]
            )),
        }
    }

    /// The whole numbers of the node's input, or of an attribute in older versions.
    pub fn integers(&self, node: &NodeProto, place: usize, attribute: &str) -> Result<Option<Vec<i64>>, String> {
        if let Some(values) = super::attributes::Attributes::of(node).integers(attribute) {
            return Ok(Some(values.to_vec()));
        }
        match self.constant(node, place)? {
            Some(tensor) => Ok(Some(tensor.integers()?.to_vec())),
            None => Ok(None),
        }
    }

    /// Elements of a value in another order, or some of them, as a tensor of this shape.
    pub fn pick(&mut self, value: &Value, places: &[usize], shape: Vec<usize>) -> Result<Value, String> {
        match value {
            Value::Constant(tensor) => Ok(Value::Constant(Tensor { shape, data: tensor.data.picked(places) })),
            Value::Row(row) => Ok(Value::Row(self.picked(row, places, shape)?)),
        }
    }

    /// Elements of what follows from the inputs.
    pub fn picked(&mut self, row: &Row, places: &[usize], shape: Vec<usize>) -> Result<Row, String> {
        let is_whole = places.len() == self.builder.width(row.value)
            && places.iter().enumerate().all(|(index, place)| index == *place);
        let value = match is_whole {
            true => row.value,
            false => self.builder.columns(places.iter().map(|place| [row.value as u32, *place as u32]).collect())?,
        };
        Ok(Row { shape, value, is_single: row.is_single })
    }

    /// The same elements in another shape.
    pub fn reshaped(&self, value: &Value, shape: Vec<usize>) -> Result<Value, String> {
        let count = |shape: &[usize]| shape.iter().product::<usize>();
        if count(&shape) != count(value.shape()) {
            return Err(format!("a shape of {:?} is to become {shape:?}", value.shape()));
        }
        let mut value = value.clone();
        match &mut value {
            Value::Constant(tensor) => tensor.shape = shape,
            Value::Row(row) => row.shape = shape,
        }
        Ok(value)
    }

    /// A value broadcast to a shape.
    pub fn expanded(&mut self, value: &Value, shape: &[usize]) -> Result<Value, String> {
        if value.shape() == shape {
            return Ok(value.clone());
        }
        let places = broadcast_places(value.shape(), shape);
        self.pick(value, &places, shape.to_vec())
    }

    /// The axes of a value in another order.
    pub fn transposed(&mut self, value: &Value, order: &[usize]) -> Result<Value, String> {
        let from = value.shape().to_vec();
        let strides = strides(&from);
        let shape: Vec<usize> = order.iter().map(|axis| from[*axis]).collect();
        let found = places(&shape, |index| index.iter().zip(order).map(|(index, axis)| index * strides[*axis]).sum());
        self.pick(value, &found, shape)
    }

    /// A function of each element.
    pub fn mapped(&mut self, value: &Value, function: Elementwise, parameters: Vec<f64>) -> Result<Value, String> {
        match value {
            Value::Constant(tensor) => {
                let count = function.parameters();
                let width = tensor.data.len();
                let at = |row: usize, index: usize| match parameters.len() > count {
                    true => parameters.get(row * width + index),
                    false => parameters.get(row),
                };
                let of = |(index, x): (usize, f64)| {
                    function.value(x, [0, 1].map(|row| at(row, index).copied().unwrap_or(0.0)))
                };
                let values: Vec<f64> = tensor.data.doubles().into_iter().enumerate().map(of).collect();
                if values.iter().any(|value| !value.is_finite()) {
                    return Err("a constant becomes a number that is not finite".into());
                }
                Ok(Value::Constant(Tensor::like(&tensor.data, tensor.shape.clone(), values)))
            }
            Value::Row(row) => {
                let value = self.builder.elementwise(row.value, function, parameters)?;
                Ok(Value::Row(Row { value, ..row.clone() }))
            }
        }
    }

    /// `W x + b` of a row, as a row of `shape`.
    pub fn affine(&mut self, row: &Row, weight: Numbers, bias: Numbers, shape: Vec<usize>) -> Result<Value, String> {
        let value = self.builder.affine(row.value, weight, bias)?;
        Ok(Value::Row(Row { shape, value, is_single: row.is_single }))
    }
}
