//! Check that a model computes each row of a batch separately. A model is followed for one row, and a mean over a batch
//! of one row is that row. If the first dimension of its inputs is free, the model is therefore followed for two rows
//! as well. No number may depend on both, and the outputs must have twice as many numbers.

use super::{
    GraphReader, ImportError,
    attributes::Attributes,
    node::Value,
    operators::RECURRENT,
    proto::{GraphProto, NodeProto, ValueInfoProto},
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
        let is_given = |input: &&ValueInfoProto| !graph.initializer.iter().any(|tensor| tensor.name == input.name);
        let mut columns = Vec::new();
        for input in graph.input.iter().filter(is_given) {
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
            let count = |shape: &[usize]| shape.iter().product::<usize>();
            let depends = &self.depends[two.value][..count(&two.shape)];
            let of = |which: u8| depends.iter().filter(|of| **of == which).count();
            if of(BOTH) > 0 {
                return Err(ImportError::unsupported(format!(
                    "it mixes rows of the batch, which is the free first dimension of the inputs; {EXPECTED}"
                )));
            }
            if of(FIRST) != of(SECOND) || (of(FIRST) > 0 && count(&two.shape) != 2 * count(&one.shape)) {
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
        let known = |reader: &GraphReader, name: &String| reader.values.get(name).cloned();
        let is_batch = |name: &String, from_end: usize| match (known(one, name), known(&self.reader, name)) {
            (Some(Value::Row(one)), Some(Value::Row(two))) if one.shape.len() == two.shape.len() => {
                let place = one.shape.len().checked_sub(from_end + 1);
                place.is_some_and(|place| (one.shape[place], two.shape[place]) == (1, 2))
            }
            _ => false,
        };
        let rank = |name: &String| known(one, name).map_or(0, |value| value.shape().len());
        let attributes = Attributes::of(node);
        let along = |name: &String, dims: &[usize]| {
            let dims = dims.iter().rev().enumerate();
            dims.into_iter().any(|(from_end, dim)| *dim > 1 && is_batch(name, from_end))
        };
        let Some(first) = node.input.first() else { return Ok(()) };
        let constant = |name: &String| known(one, name).and_then(|value| value.constant().cloned());
        let integers = |name: &String| -> Option<Vec<usize>> {
            let numbers = constant(name)?.integers().ok()?.to_vec();
            Some(numbers.into_iter().map(|number| usize::try_from(number).unwrap_or(0)).collect())
        };
        match node.op_type.as_str() {
            "Concat" => {
                let rank = rank(first);
                let Some(at) = attributes.integer("axis").and_then(|at| axis(at, rank).ok()) else { return Ok(()) };
                if node.input.iter().any(|name| is_batch(name, rank - 1 - at)) {
                    return Err(along_batch("it puts rows together"));
                }
            }
            "Tile" | "Expand" => {
                let Some(dims) = node.input.get(1).and_then(integers) else { return Ok(()) };
                // a shape that was computed has two rows for two
                let twice = node.input.get(1).and_then(|name| known(&self.reader, name)?.constant().cloned());
                let is_same = twice.is_none_or(|twice| {
                    twice
                        .integers()
                        .is_ok_and(|twice| twice.iter().map(|dim| usize::try_from(*dim).unwrap_or(0)).eq(dims.clone()))
                });
                if is_same && along(first, &dims) {
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
                    let Some(tensor) = constant(name) else { continue };
                    if rows.iter().any(|name| along(name, &tensor.shape)) {
                        return Err(along_batch(&format!("a constant of shape {:?}", tensor.shape)));
                    }
                    let is_of_row = rows.iter().any(|name| matches!(known(one, name), Some(Value::Row(_))));
                    let twice = known(&self.reader, name).and_then(|value| value.constant().cloned());
                    if is_of_row && twice.is_some_and(|twice| !is_repeated(&tensor, &twice)) {
                        return Err(along_batch("a constant that changes"));
                    }
                }
            }
            _ => {}
        }
        Ok(())
    }
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
    let all = |of: usize| values[of].iter().fold(0, |all, depends| all | depends);
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
        Step::Normalize { of, .. } | Step::Softmax { of } => vec![all(*of); values[*of].len()],
        Step::Distances { of, centres, lengths } => vec![all(*of); centres.len() / lengths.len()],
        Step::Forest { of, outputs, .. } => vec![all(*of); *outputs],
        Step::Products { of, products } => vec![all(*of); products.terms()],
        Step::Call { .. } | Step::Interpolate { .. } | Step::Dictionary { .. } | Step::Motion { .. } => {
            unreachable!("what is imported has none of these")
        }
    }
}
