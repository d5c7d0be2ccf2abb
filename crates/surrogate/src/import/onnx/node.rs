//! Nodes and the values between them.

use super::{
    GraphReader, ImportError, NodePlace,
    proto::NodeProto,
    shape::{broadcast_places, places, strides},
    tensor::{ConstantTensor, Data},
};
use crate::import::builder::Builder;
use metafmu_runtime::{
    Numbers,
    graph::{Elementwise, Step},
};

/// Value of a name.
#[derive(Clone, Debug)]
pub enum Value {
    /// Equal for all rows.
    Constant(ConstantTensor),
    /// Follows from the inputs.
    Row(RowTensor),
}

/// A tensor with elements for each row of the inputs; the batch has the size 1.
#[derive(Clone, Debug)]
pub struct RowTensor {
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

    pub fn constant(&self) -> Option<&ConstantTensor> {
        match self {
            Self::Constant(tensor) => Some(tensor),
            Self::Row(_) => None,
        }
    }
}

/// Returns true if a domain is that of the standard operators.
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

/// A node as the place of an error.
pub fn place(number: usize, node: &NodeProto) -> NodePlace {
    NodePlace { number, name: node.name.clone(), operator: node.op_type.clone() }
}

fn missing_input(place: usize) -> ImportError {
    ImportError::malformed(format!("input {place} is missing"))
}

/// A constant as a value of the graph: a network of weights that are zero.
pub fn constant_row(builder: &mut Builder, tensor: &ConstantTensor) -> Result<RowTensor, ImportError> {
    let values = tensor.data.doubles();
    if values.is_empty() {
        return Err(ImportError::unsupported("a constant without elements"));
    }
    let first = builder.columns(vec![[0, 0]])?;
    let value = builder.affine(first, vec![0.0; values.len()].into(), values.into())?;
    Ok(RowTensor { shape: tensor.shape.clone(), value, is_single: matches!(tensor.data, Data::Single(_)) })
}

impl GraphReader {
    /// The value of the node's input, if it has that one.
    pub fn given(&self, node: &NodeProto, place: usize) -> Result<Option<&Value>, ImportError> {
        match node.input.get(place).map(String::as_str) {
            None | Some("") => Ok(None),
            Some(name) => match self.values.get(name) {
                Some(value) => Ok(Some(value)),
                // nodes are in the order in which they can be computed
                None => Err(match self.beside.get(name) {
                    Some(what) => ImportError::unsupported(format!("input `{name}` is {what}")),
                    None => ImportError::malformed(format!(
                        "input `{name}` is made by no earlier node: the graph has a cycle, or is not in order"
                    )),
                }),
            },
        }
    }

    /// The value of the node's input.
    pub fn input(&self, node: &NodeProto, place: usize) -> Result<Value, ImportError> {
        self.given(node, place)?.cloned().ok_or_else(|| missing_input(place))
    }

    /// The value of the node's input, which must follow from the inputs of the graph.
    pub fn row(&self, node: &NodeProto, place: usize) -> Result<RowTensor, ImportError> {
        match self.input(node, place)? {
            Value::Row(row) => Ok(row),
            Value::Constant(_) => {
                let message = format!("input {place} is a constant, expected what follows from the inputs");
                Err(ImportError::unsupported(message))
            }
        }
    }

    /// The value from which a row's numbers are chosen.
    fn chosen_from(&self, row: &RowTensor) -> usize {
        let mut value = row.value;
        while let Some(Step::Columns { columns }) = value.checked_sub(1).map(|step| &self.builder.steps()[step])
            && columns.iter().all(|[of, _]| *of == columns[0][0])
        {
            value = columns[0][0] as usize;
        }
        value
    }

    /// Returns true if a row consists of inputs of the graph only.
    pub fn is_input(&self, row: &RowTensor) -> bool {
        self.chosen_from(row) == 0
    }

    /// A row in single precision, rounded as it was there unless it is already.
    pub fn rounded(&mut self, row: RowTensor) -> Result<RowTensor, ImportError> {
        let from = self.chosen_from(&row).checked_sub(1).map(|step| &self.builder.steps()[step]);
        if let Some(Step::Elementwise { function: Elementwise::Single, .. }) = from {
            return Ok(row);
        }
        Ok(RowTensor { value: self.builder.elementwise(row.value, Elementwise::Single, Vec::new())?, ..row })
    }

    /// A model of one row of features for each of the rows: the last dimension has the features.
    pub fn each_row(
        &mut self,
        node: &NodeProto,
        outputs: usize,
        mut make: impl FnMut(&mut Self, &RowTensor) -> Result<Value, ImportError>,
    ) -> Result<Value, ImportError> {
        let row = self.row(node, 0)?;
        let width = row.shape.last().copied().unwrap_or(1);
        let rows = self.builder.width(row.value).checked_div(width).unwrap_or(0);
        if rows == 0 || row.shape.len() > 2 {
            return Err(ImportError::malformed(format!(
                "an input of shape {:?}, expected rows of features",
                row.shape
            )));
        }
        if rows == 1 {
            return make(self, &row);
        }
        let mut columns = Vec::new();
        for index in 0..rows {
            let places: Vec<usize> = (index * width..(index + 1) * width).collect();
            let part = self.picked(&row, &places, vec![1, width])?;
            let Value::Row(made) = make(self, &part)? else {
                return Err(ImportError::unsupported("what it gives is constant"));
            };
            columns.extend((0..outputs).map(|column| [made.value as u32, column as u32]));
        }
        Ok(Value::Row(RowTensor { shape: vec![rows, outputs], value: self.builder.columns(columns)?, ..row }))
    }

    /// The value of the node's input, which must be a constant.
    pub fn constant(&self, node: &NodeProto, place: usize) -> Result<Option<ConstantTensor>, ImportError> {
        match self.given(node, place)? {
            None => Ok(None),
            Some(Value::Constant(tensor)) => Ok(Some(tensor.clone())),
            Some(Value::Row(_)) => Err(ImportError::unsupported(format!(
                "input {place} `{}` follows from the graph's inputs, expected a constant",
                node.input[place]
            ))),
        }
    }

    /// The value of the node's input, which must be there and be a constant.
    pub fn required_constant(&self, node: &NodeProto, place: usize) -> Result<ConstantTensor, ImportError> {
        self.constant(node, place)?.ok_or_else(|| missing_input(place))
    }

    /// The whole numbers of the node's input, or of an attribute in older versions.
    pub fn integers(&self, node: &NodeProto, place: usize, attribute: &str) -> Result<Option<Vec<i64>>, ImportError> {
        if let Some(values) = super::attributes::Attributes::of(node).integers(attribute) {
            return Ok(Some(values.to_vec()));
        }
        match self.constant(node, place)? {
            Some(tensor) => Ok(Some(tensor.integers()?.to_vec())),
            None => Ok(None),
        }
    }

    /// The whole numbers of the node's input, or of an attribute in older versions, which must be there.
    pub fn required_integers(&self, node: &NodeProto, place: usize, attribute: &str) -> Result<Vec<i64>, ImportError> {
        let integers = self.integers(node, place, attribute)?;
        integers.ok_or_else(|| ImportError::malformed(format!("no {attribute}")))
    }

    /// Elements of a value in another order, or some of them, as a tensor of this shape.
    pub fn pick(&mut self, value: &Value, places: &[usize], shape: Vec<usize>) -> Result<Value, ImportError> {
        match value {
            Value::Constant(tensor) => Ok(Value::Constant(ConstantTensor { shape, data: tensor.data.picked(places) })),
            Value::Row(row) => Ok(Value::Row(self.picked(row, places, shape)?)),
        }
    }

    /// Elements of a row at some places.
    pub fn picked(&mut self, row: &RowTensor, places: &[usize], shape: Vec<usize>) -> Result<RowTensor, ImportError> {
        let is_whole = places.len() == self.builder.width(row.value)
            && places.iter().enumerate().all(|(index, place)| index == *place);
        let value = match is_whole {
            true => row.value,
            false => self.builder.columns(places.iter().map(|place| [row.value as u32, *place as u32]).collect())?,
        };
        Ok(RowTensor { shape, value, is_single: row.is_single })
    }

    /// Value with its elements in another shape.
    pub fn reshaped(&self, value: &Value, shape: Vec<usize>) -> Result<Value, ImportError> {
        if shape.iter().product::<usize>() != value.shape().iter().product::<usize>() {
            return Err(ImportError::malformed(format!("a shape of {:?} is to become {shape:?}", value.shape())));
        }
        let mut value = value.clone();
        match &mut value {
            Value::Constant(tensor) => tensor.shape = shape,
            Value::Row(row) => row.shape = shape,
        }
        Ok(value)
    }

    /// A value broadcast to a shape.
    pub fn expanded(&mut self, value: &Value, shape: &[usize]) -> Result<Value, ImportError> {
        if value.shape() == shape {
            return Ok(value.clone());
        }
        let places = broadcast_places(value.shape(), shape);
        self.pick(value, &places, shape.to_vec())
    }

    /// The axes of a value in another order.
    pub fn transposed(&mut self, value: &Value, order: &[usize]) -> Result<Value, ImportError> {
        let from = value.shape().to_vec();
        let strides = strides(&from);
        let shape: Vec<usize> = order.iter().map(|axis| from[*axis]).collect();
        let found = places(&shape, |index| index.iter().zip(order).map(|(index, axis)| index * strides[*axis]).sum());
        self.pick(value, &found, shape)
    }

    /// A function of each element.
    pub fn mapped(&mut self, value: &Value, function: Elementwise, parameters: Vec<f64>) -> Result<Value, ImportError> {
        match value {
            Value::Constant(tensor) => {
                let width = tensor.data.len();
                let is_each = parameters.len() > function.parameters();
                let values: Vec<f64> = tensor
                    .data
                    .doubles()
                    .into_iter()
                    .enumerate()
                    .map(|(index, x)| {
                        let places = if is_each { [index, width + index] } else { [0, 1] };
                        function.value(x, places.map(|place| parameters.get(place).copied().unwrap_or(0.0)))
                    })
                    .collect();
                if values.iter().any(|value| !value.is_finite()) {
                    return Err(ImportError::not_finite("a constant becomes a number that is not finite"));
                }
                Ok(Value::Constant(ConstantTensor::like(&tensor.data, tensor.shape.clone(), values)))
            }
            Value::Row(row) => {
                let value = self.builder.elementwise(row.value, function, parameters)?;
                Ok(Value::Row(RowTensor { value, ..row.clone() }))
            }
        }
    }

    /// `W x + b` of a row, as a row of `shape`.
    pub fn affine(
        &mut self,
        row: &RowTensor,
        weight: Numbers,
        bias: Numbers,
        shape: Vec<usize>,
    ) -> Result<Value, ImportError> {
        let value = self.builder.affine(row.value, weight, bias)?;
        Ok(Value::Row(RowTensor { shape, value, is_single: row.is_single }))
    }
}
