//! Check that a model computes each row of a batch separately. A model is followed for one row, and a mean over a batch
//! of one row is that row. If the first dimension of its inputs is free, the model is therefore followed for two rows
//! as well. No number may depend on both, and the outputs must have twice as many numbers.

use super::{
    GraphReader, ImportError,
    attributes::Attributes,
    node::Value,
    operators::RECURRENT,
    proto::{GraphProto, NodeProto},
    shape::{axis, broadcast, broadcast_places},
    tensor::ConstantTensor,
};
use metafmu_runtime::graph::Step;
use std::path::Path;

/// Rows that a number depends on: the first row, the second one, or both.
const FIRST: u8 = 1;
const SECOND: u8 = 2;
const BOTH: u8 = FIRST | SECOND;

const EXPECTED: &str = "expected an operator on each row separately, or inputs with a fixed first dimension";

/// Operators whose inputs are broadcast to each other.
const BROADCASTING: [&str; 18] = [
    "Add",
    "And",
    "Div",
    "Equal",
    "Gemm",
    "Greater",
    "GreaterOrEqual",
    "Less",
    "LessOrEqual",
    "Max",
    "Mean",
    "Min",
    "Mul",
    "Or",
    "Pow",
    "Sub",
    "Sum",
    "Where",
];

/// A graph that is followed for two rows.
pub struct TwoRows {
    reader: GraphReader,
    /// Rows that each number of each value depends on.
    depends: Vec<Vec<u8>>,
}

impl TwoRows {
    /// None if inputs have no free first dimension, and for recurrent cells, where any dimension may be the batch.
    pub fn of(graph: &GraphProto, opset: i64, folder: Option<&Path>) -> Option<Self> {
        if graph.node.iter().any(|node| RECURRENT.contains(&node.op_type.as_str())) {
            return None;
        }
        let reader = GraphReader::new(graph, opset, folder, 2).ok()?;
        let mut columns = Vec::new();
        for input in
            graph.input.iter().filter(|input| !graph.initializer.iter().any(|tensor| tensor.name == input.name))
        {
            let count: usize = reader.values.get(&input.name)?.shape().iter().product();
            columns.extend((0..count).map(|column| match super::is_batch(input) {
                true if column < count / 2 => FIRST,
                true => SECOND,
                false => 0,
            }));
        }
        let is_free = columns.contains(&FIRST);
        is_free.then_some(Self { reader, depends: vec![columns] })
    }

    /// Follows a node that was followed for one row. Returns true if the next one can be followed. A graph that does
    /// not fit two rows fits one only, so it cannot mix rows.
    ///
    /// # Errors
    /// [`ImportCause::Unsupported`](crate::import::ImportCause): it does not compute each row separately.
    pub fn follow(&mut self, node: &NodeProto, one: &GraphReader) -> Result<bool, ImportError> {
        self.refuse_along_batch(node, one)?;
        if self.reader.node(node).is_err() {
            return Ok(false);
        }
        let steps = self.reader.builder.steps();
        for step in &steps[self.depends.len() - 1..] {
            let depends = of_step(step, &self.depends);
            self.depends.push(depends);
        }
        for name in node.output.iter().filter(|name| !name.is_empty()) {
            let (Some(Value::Row(one)), Some(Value::Row(two))) = (one.values.get(name), self.reader.values.get(name))
            else {
                continue;
            };
            let [numbers, numbers_of_two] = [&one.shape, &two.shape].map(|shape| shape.iter().product::<usize>());
            let depends = &self.depends[two.value][..numbers_of_two];
            let [first, second, both] =
                [FIRST, SECOND, BOTH].map(|which| depends.iter().filter(|rows| **rows == which).count());
            if both > 0 {
                return Err(ImportError::unsupported(format!(
                    "it mixes rows of the batch, which is the free first dimension of the inputs; {EXPECTED}"
                )));
            }
            if first != second || (first > 0 && numbers_of_two != 2 * numbers) {
                return Err(ImportError::unsupported(format!(
                    "it acts along the batch dimension, which is free in the inputs: of one row it makes the shape {:?}, of two rows {:?}; \
                     {EXPECTED}",
                    one.shape, two.shape
                )));
            }
        }
        Ok(true)
    }

    /// Refuses operators whose result for a row depends on its position in the batch.
    fn refuse_along_batch(&self, node: &NodeProto, one: &GraphReader) -> Result<(), ImportError> {
        let attributes = Attributes::of(node);
        let Some(first) = node.input.first() else { return Ok(()) };
        match node.op_type.as_str() {
            "Concat" => {
                let rank = one.values.get(first).map_or(0, |value| value.shape().len());
                let Some(at) = attributes.integer("axis").and_then(|at| axis(at, rank).ok()) else { return Ok(()) };
                if node.input.iter().any(|name| self.is_batch(one, name, rank - 1 - at)) {
                    return Err(along_batch("it puts rows together"));
                }
            }
            "Tile" | "Expand" => {
                let Some(name) = node.input.get(1) else { return Ok(()) };
                let Some(dims) = constant(one, name).and_then(dims_of) else { return Ok(()) };
                // a shape that was computed has two rows for two
                let is_same = constant(&self.reader, name).is_none_or(|twice| dims_of(twice).as_ref() == Some(&dims));
                if is_same && self.repeats(one, first, &dims) {
                    return Err(along_batch("it repeats rows"));
                }
            }
            operator if BROADCASTING.contains(&operator) => {
                let is_gemm = operator == "Gemm";
                if is_gemm && attributes.integer("transA").unwrap_or(0) != 0 {
                    return Ok(());
                }
                let rows = if is_gemm { &node.input[..1] } else { &node.input[..] };
                let constants = if is_gemm { node.input.get(2..).unwrap_or_default() } else { &node.input[..] };
                for name in constants {
                    let Some(tensor) = constant(one, name) else { continue };
                    if rows.iter().any(|name| self.repeats(one, name, &tensor.shape)) {
                        return Err(along_batch(&format!("a constant of shape {:?}", tensor.shape)));
                    }
                    let is_of_row = rows.iter().any(|name| matches!(one.values.get(name), Some(Value::Row(_))));
                    let twice = constant(&self.reader, name);
                    if is_of_row && twice.is_some_and(|twice| !is_repeated(tensor, twice)) {
                        return Err(along_batch("a constant that changes"));
                    }
                }
            }
            _ => {}
        }
        Ok(())
    }

    /// Returns true if a dimension of a value, counted from the last one, is that of the batch; `one` has followed one row.
    fn is_batch(&self, one: &GraphReader, name: &str, from_end: usize) -> bool {
        match (one.values.get(name), self.reader.values.get(name)) {
            (Some(Value::Row(one)), Some(Value::Row(two))) if one.shape.len() == two.shape.len() => {
                let place = one.shape.len().checked_sub(from_end + 1);
                place.is_some_and(|place| (one.shape[place], two.shape[place]) == (1, 2))
            }
            _ => false,
        }
    }

    /// Returns true if a value that is broadcast to these dimensions, its last ones, is repeated along the batch.
    fn repeats(&self, one: &GraphReader, name: &str, dims: &[usize]) -> bool {
        let mut dims = dims.iter().rev().enumerate();
        dims.any(|(from_end, dim)| *dim > 1 && self.is_batch(one, name, from_end))
    }
}

fn constant<'a>(reader: &'a GraphReader, name: &str) -> Option<&'a ConstantTensor> {
    reader.values.get(name).and_then(Value::constant)
}

/// Whole numbers as dimensions, those below zero as zero; none for real numbers.
fn dims_of(tensor: &ConstantTensor) -> Option<Vec<usize>> {
    let numbers = tensor.integers().ok()?;
    Some(numbers.iter().map(|number| usize::try_from(*number).unwrap_or(0)).collect())
}

/// The error of an operator that treats rows of a batch differently.
fn along_batch(what: &str) -> ImportError {
    ImportError::unsupported(format!("{what} along the batch dimension, which is free in the inputs; {EXPECTED}"))
}

/// Returns true if a constant of two rows repeats that of one row.
fn is_repeated(one: &ConstantTensor, two: &ConstantTensor) -> bool {
    match broadcast(&one.shape, &two.shape) {
        Ok(shape) if shape == two.shape => {
            let (of_one, of_two) = (one.data.doubles(), two.data.doubles());
            broadcast_places(&one.shape, &shape).into_iter().zip(of_two).all(|(place, number)| of_one[place] == number)
        }
        _ => false,
    }
}

/// Rows that each number of a step depends on.
fn of_step(step: &Step, values: &[Vec<u8>]) -> Vec<u8> {
    match step {
        Step::Affine { of, weight, bias } => {
            let from = &values[*of];
            let mut found = vec![0; bias.len()];
            for (index, weight) in weight.iter().enumerate() {
                if weight != 0.0 {
                    found[index / from.len()] |= from[index % from.len()];
                }
            }
            found
        }
        Step::Elementwise { of, .. } | Step::Standardize { of, .. } | Step::Rescale { of, .. } => values[*of].clone(),
        Step::Combine { of: [a, b], .. } => values[*a].iter().zip(&values[*b]).map(|(a, b)| a | b).collect(),
        Step::Select { of: [condition, a, b] } => {
            let pairs = values[*a].iter().zip(&values[*b]).map(|(a, b)| a | b);
            pairs.zip(&values[*condition]).map(|(pair, condition)| pair | condition).collect()
        }
        Step::Columns { columns } => {
            columns.iter().map(|[of, column]| values[*of as usize][*column as usize]).collect()
        }
        Step::Normalize { of, .. } | Step::Softmax { of } => vec![of_all(&values[*of]); values[*of].len()],
        Step::Distances { of, centres, lengths } => vec![of_all(&values[*of]); centres.len() / lengths.len()],
        Step::Forest { of, outputs, .. } => vec![of_all(&values[*of]); *outputs],
        Step::Products { of, products } => vec![of_all(&values[*of]); products.terms()],
        Step::Call { .. } | Step::Interpolate { .. } | Step::Dictionary { .. } | Step::Motion { .. } => {
            unreachable!("what is imported has none of these")
        }
    }
}

/// Rows that any number of a value depends on.
fn of_all(depends: &[u8]) -> u8 {
    depends.iter().fold(0, |all, depends| all | depends)
}
