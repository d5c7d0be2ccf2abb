//! Networks on a tape: values and derivatives of every order follow from the operations there.

use super::{ColumnKind, NetworkTerm};
use crate::{
    Activation, Layer, Scaling,
    equations::tape::{Register, TapeBuilder},
};

/// Outputs of a [`NetworkTerm`] on a tape.
pub(crate) struct WrittenNetwork {
    /// Function that each output adds to.
    functions: Vec<usize>,
    /// Outputs, each with its derivatives with respect to the first columns, which are zero where they are not wanted.
    outputs: Vec<Vec<Register>>,
}

impl WrittenNetwork {
    /// The value of a function with what outputs add to it; with a column, the derivative with respect to it.
    pub(crate) fn added(
        &self,
        mut to: Register,
        function: usize,
        column: Option<usize>,
        tape: &mut TapeBuilder,
    ) -> Register {
        for (_, orders) in self.functions.iter().zip(&self.outputs).filter(|(own, _)| **own == function) {
            to = tape.add_product(to, orders[column.map_or(0, |column| 1 + column)], tape.one);
        }
        to
    }
}

/// Nodes of a layer.
struct Nodes {
    /// Positions in the layer.
    nodes: Vec<usize>,
    values: Register,
    /// Derivatives with respect to each of the first columns, unless they are zero.
    tangents: Vec<Option<Register>>,
}

/// Columns of a layer by their positions, with the registers of their values.
type LayerColumns = Vec<(usize, Register)>;

impl NetworkTerm {
    /// Writes the outputs at `x`, and their derivatives with respect to the first columns, `first` in number. Outputs that add to none of
    /// the first `differentiated` functions have no derivatives.
    pub(crate) fn write(
        &self,
        x: &[Register],
        first: usize,
        differentiated: usize,
        tape: &mut TapeBuilder,
    ) -> WrittenNetwork {
        let Scaling { output_mean, output_scale, .. } = &self.network.scaling;
        let layers = self.network.layers.as_slice();
        // the coefficients of an activation in the last layer are those of the identity
        let (hidden, last) = match layers {
            [hidden @ .., last] if last.activation == Activation::Identity && !hidden.is_empty() => {
                (hidden, Some(last))
            }
            _ => (layers, None),
        };
        let coefficient = |output: usize, node: usize| match last {
            Some(last) => last.weight.get(output * last.inputs + node),
            None => f64::from(u8::from(output == node)),
        };
        let (columns, tangents) = self.standardized(x, first, tape);
        let mut parts = Vec::new();
        let groups = if hidden.len() == 1 {
            groups(&hidden[0], self.outputs.len(), &coefficient)
        } else {
            let [nodes, columns, outputs] = [hidden[0].outputs, hidden[0].inputs, self.outputs.len()];
            vec![Group {
                nodes: (0..nodes).collect(),
                columns: (0..columns).collect(),
                outputs: (0..outputs).collect(),
            }]
        };
        for Group { nodes, columns: of, outputs } in groups {
            let is_differentiated = outputs.iter().any(|output| self.outputs[*output] < differentiated);
            let tangents = tangents.iter().filter(|_| is_differentiated);
            let tangents: Vec<LayerColumns> = tangents.map(|columns| chosen_columns(columns, &of)).collect();
            parts.push(Nodes::new(&hidden[0], nodes, &chosen_columns(&columns, &of), &tangents, tape));
        }
        for layer in &hidden[1..] {
            let before = parts.remove(0);
            let tangents = before.tangents.iter();
            let tangents: Vec<LayerColumns> =
                tangents.map(|block| block.map_or(Vec::new(), |block| block_columns(block, layer.inputs))).collect();
            let values = block_columns(before.values, layer.inputs);
            parts.push(Nodes::new(layer, (0..layer.outputs).collect(), &values, &tangents, tape));
        }
        // the part of fixed columns has a separate sum
        let (varying, fixed): (Vec<Nodes>, Vec<Nodes>) = parts.into_iter().partition(|part| tape.varies(part.values));
        let parts: Vec<Nodes> = fixed.into_iter().chain(varying).collect();
        let mut outputs = Vec::new();
        for (output, function) in self.outputs.iter().enumerate() {
            let scale = output_scale[output];
            let weights =
                |part: &Nodes| -> Vec<f64> { part.nodes.iter().map(|node| coefficient(output, *node)).collect() };
            let sum = |of: &dyn Fn(&Nodes) -> Option<Register>, constant: f64, tape: &mut TapeBuilder| {
                let mut sum = tape.constant(constant);
                for part in &parts {
                    let (weights, block) = (weights(part), of(part));
                    if let Some(block) = block.filter(|_| weights.iter().any(|weight| *weight != 0.0)) {
                        let more = tape.dot(&weights, block, tape.zero);
                        sum = tape.add_scaled(sum, more, scale);
                    }
                }
                sum
            };
            let bias = last.map_or(0.0, |last| last.bias.get(output));
            let mut orders = vec![sum(&|part| Some(part.values), output_mean[output] + scale * bias, tape)];
            for k in 0..first {
                orders.push(match *function < differentiated {
                    true => sum(&|part| part.tangents.get(k).copied().flatten(), 0.0, tape),
                    false => tape.zero,
                });
            }
            outputs.push(orders);
        }
        WrittenNetwork { functions: self.outputs.clone(), outputs }
    }

    /// Standardized columns, those that are fixed first, and for each of the first columns the derivatives that are not zero.
    fn standardized(&self, x: &[Register], first: usize, tape: &mut TapeBuilder) -> (LayerColumns, Vec<LayerColumns>) {
        let Scaling { input_mean, input_scale, .. } = &self.network.scaling;
        let (mut fixed, mut varying, mut slopes) = (Vec::new(), Vec::new(), Vec::new());
        for (index, column) in self.columns.iter().enumerate() {
            let (of, scale) = (x[column.of], input_scale[index].recip());
            let (value, slope, factor) = match column.kind {
                ColumnKind::Plain => (of, tape.one, scale),
                kind => {
                    let angle = tape.harmonics(of, 1);
                    let is_sine = kind == ColumnKind::Sine;
                    if is_sine { (angle[1], angle[0], scale) } else { (angle[0], angle[1], -scale) }
                }
            };
            let mean = tape.constant(-input_mean[index]);
            let value = tape.add_product(mean, value, tape.one);
            let columns = if tape.varies(of) { &mut varying } else { &mut fixed };
            columns.push((index, (value, scale)));
            if column.of < first {
                slopes.push((index, (slope, factor)));
            }
        }
        let columns = [scaled_block(fixed, tape), scaled_block(varying, tape)].concat();
        let slopes = scaled_block(slopes, tape);
        let by_column =
            (0..first).map(|k| slopes.iter().copied().filter(|(index, _)| self.columns[*index].of == k).collect());
        (columns, by_column.collect())
    }
}

/// Columns at the chosen positions.
fn chosen_columns(columns: &LayerColumns, chosen: &[usize]) -> LayerColumns {
    columns.iter().copied().filter(|(column, _)| chosen.contains(column)).collect()
}

/// Columns whose values are a block, in its order.
fn block_columns(block: Register, count: usize) -> LayerColumns {
    (0..count).map(|k| (k, block.plus(k))).collect()
}

/// Writes the numbers of columns times their factors as a block.
fn scaled_block(columns: Vec<(usize, (Register, f64))>, tape: &mut TapeBuilder) -> LayerColumns {
    let (indices, numbers): (Vec<usize>, Vec<(Register, f64)>) = columns.into_iter().unzip();
    if indices.is_empty() {
        return Vec::new();
    }
    let block = tape.scaled(&numbers);
    indices.into_iter().enumerate().map(|(at, index)| (index, block.plus(at))).collect()
}

impl Nodes {
    /// Writes nodes of a layer from those columns that they have, and their derivatives from those of the columns.
    fn new(
        layer: &Layer,
        nodes: Vec<usize>,
        of: &LayerColumns,
        tangents: &[LayerColumns],
        tape: &mut TapeBuilder,
    ) -> Self {
        let bias = tape.constants(nodes.iter().map(|node| layer.bias.get(*node)));
        let argument = add_columns(layer, &nodes, of, Some(bias), tape).unwrap_or(bias);
        let [values, slopes] = tape.activation(layer.activation, argument, nodes.len());
        let tangents = tangents.iter().map(|columns| {
            let tangent = add_columns(layer, &nodes, columns, None, tape)?;
            Some(tape.products(tangent, slopes, nodes.len()))
        });
        let tangents = tangents.collect();
        Self { nodes, values, tangents }
    }
}

/// Writes the sum of a block and the weighted columns of nodes; none if there are neither.
fn add_columns(
    layer: &Layer,
    nodes: &[usize],
    columns: &LayerColumns,
    mut sum: Option<Register>,
    tape: &mut TapeBuilder,
) -> Option<Register> {
    for run in columns.chunk_by(|(_, a), (_, b)| a.plus(1) == *b) {
        let shape = [nodes.len(), run.len()];
        let weights = &layer.weight;
        sum = Some(tape.matrix(shape, |row, k| weights.get(nodes[row] * layer.inputs + run[k].0), run[0].1, sum));
    }
    sum
}

/// Nodes that have the same columns and add to the same outputs: random features have few of them.
struct Group {
    nodes: Vec<usize>,
    columns: Vec<usize>,
    outputs: Vec<usize>,
}

fn groups(hidden: &Layer, outputs: usize, coefficient: &dyn Fn(usize, usize) -> f64) -> Vec<Group> {
    let mut groups: Vec<Group> = Vec::new();
    for node in 0..hidden.outputs {
        let columns = (0..hidden.inputs).filter(|column| hidden.weight.get(node * hidden.inputs + column) != 0.0);
        let columns: Vec<usize> = columns.collect();
        let outputs: Vec<usize> = (0..outputs).filter(|output| coefficient(*output, node) != 0.0).collect();
        match groups.iter_mut().find(|group| group.columns == columns && group.outputs == outputs) {
            Some(group) => group.nodes.push(node),
            None => groups.push(Group { nodes: vec![node], columns, outputs }),
        }
    }
    groups
}
