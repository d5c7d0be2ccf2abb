//! Networks with one hidden layer of tanh nodes and a linear last layer, as drawn nodes are: often several hundred nodes, each of which
//! has few of the columns and adds to few of the functions.

use super::{ColumnKind, LANES, NetworkColumn};
use crate::{Activation, Layer, Scaling, map::jet::Number, simd::PORTABLE};
use std::{collections::BTreeMap, ops::Range};

/// The nodes in groups that have the same columns and add to the same functions: what is zero is not computed.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Nodes {
    groups: Vec<Group>,
    /// Biases of the nodes, block by block; those that fill a block up add nothing.
    bias: Vec<[f64; LANES]>,
    /// Biases of the last layer.
    constants: Vec<f64>,
}

#[derive(Clone, Debug, PartialEq)]
struct Group {
    /// Positions among the network's columns.
    columns: Vec<usize>,
    /// Positions among the network's outputs.
    outputs: Vec<usize>,
    /// Its part of the biases.
    blocks: Range<usize>,
    /// Shape `[columns, blocks]`.
    weights: Vec<[f64; LANES]>,
    /// Shape `[outputs, blocks]`.
    coefficients: Vec<[f64; LANES]>,
}

/// Working memory. What follows from held columns alone is kept as long as they have the same values: in a simulation they are
/// parameters.
#[derive(Clone, Debug)]
pub(crate) struct NodesWork<T> {
    /// Columns of a point that are held, and their values when what follows from them was computed, if it was.
    held: Range<usize>,
    at: Vec<T>,
    is_known: bool,
    /// Biases of the nodes and what held columns add.
    bias: Vec<[T; LANES]>,
    /// Biases of the last layer and what nodes of held columns alone add.
    constants: Vec<T>,
    /// Standardised columns, and their derivatives with respect to the columns that they are made of.
    columns: Vec<T>,
    slopes: Vec<T>,
    /// Nodes of a group, and their derivatives with respect to one column.
    values: Vec<[T; LANES]>,
    tangents: Vec<[T; LANES]>,
}

impl Nodes {
    /// None if it is another network.
    pub(super) fn new(layers: &[Layer]) -> Option<Self> {
        let [hidden, last] = layers else { return None };
        if hidden.activation != Activation::Tanh || last.activation != Activation::Identity {
            return None;
        }
        let (columns, nodes, outputs) = (hidden.inputs, hidden.outputs, last.outputs);
        let (weight, bias): (Vec<f64>, Vec<f64>) = (hidden.weight.iter().collect(), hidden.bias.iter().collect());
        let coefficient: Vec<f64> = last.weight.iter().collect();
        let mut alike: BTreeMap<[Vec<usize>; 2], Vec<usize>> = BTreeMap::new();
        for node in 0..nodes {
            let of = (0..columns).filter(|column| weight[node * columns + column] != 0.0).collect();
            let to = (0..outputs).filter(|output| coefficient[output * nodes + node] != 0.0).collect();
            alike.entry([of, to]).or_default().push(node);
        }
        let mut all = Self { groups: Vec::new(), bias: Vec::new(), constants: last.bias.iter().collect() };
        for ([columns_of, outputs_of], nodes_of) in alike {
            let in_blocks = |of: &dyn Fn(usize) -> f64| -> Vec<[f64; LANES]> {
                let block = |block: &[usize]| {
                    let mut lanes = [0.0; LANES];
                    lanes.iter_mut().zip(block).for_each(|(lane, node)| *lane = of(*node));
                    lanes
                };
                nodes_of.chunks(LANES).map(block).collect()
            };
            let first = all.bias.len();
            all.bias.extend(in_blocks(&|node| bias[node]));
            all.groups.push(Group {
                blocks: first..all.bias.len(),
                weights: columns_of.iter().flat_map(|c| in_blocks(&|node| weight[node * columns + c])).collect(),
                coefficients: outputs_of
                    .iter()
                    .flat_map(|o| in_blocks(&|node| coefficient[o * nodes + node]))
                    .collect(),
                columns: columns_of,
                outputs: outputs_of,
            });
        }
        Some(all)
    }

    pub(super) fn work<T: Number>(&self, columns: usize, held: Range<usize>) -> NodesWork<T> {
        let zero = T::from(0.0);
        let longest = self.groups.iter().map(|group| group.blocks.len()).max().unwrap_or(0);
        NodesWork {
            at: vec![zero; held.len()],
            is_known: false,
            held,
            bias: vec![[zero; LANES]; self.bias.len()],
            constants: vec![zero; self.constants.len()],
            columns: vec![zero; columns],
            slopes: vec![zero; columns],
            values: vec![[zero; LANES]; longest],
            tangents: vec![[zero; LANES]; longest],
        }
    }

    /// As `NetworkTerm::run`, of which it is the part for these networks.
    #[inline(always)]
    pub(super) fn run<T: Number, const SIMD: u8>(
        &self,
        (of, to, scaling): (&[NetworkColumn], &[usize], &Scaling),
        x: &[T],
        y: &mut [T],
        (gradient, first): (&mut [T], usize),
        work: &mut NodesWork<T>,
    ) {
        self.standardise(of, scaling, x, work);
        let held = x[work.held.clone()].iter();
        if !(work.is_known && held.clone().eq(&work.at)) {
            work.at.iter_mut().zip(held).for_each(|(to, from)| *to = *from);
            self.hold(of, work);
            work.is_known = true;
        }
        for (index, &output) in to.iter().enumerate() {
            let constant = work.constants[index].scaled(scaling.output_scale[index]);
            y[output] = y[output] + constant + T::from(scaling.output_mean[index]);
        }
        let NodesWork { held, bias, columns, slopes, values, tangents, .. } = work;
        let differentiated = gradient.len();
        let has_gradient = |output: &usize| (to[*output] + 1) * first <= differentiated;
        for group in
            self.groups.iter().filter(|group| group.columns.iter().any(|column| !held.contains(&of[*column].of)))
        {
            let values = &mut values[..group.blocks.len()];
            values.copy_from_slice(&bias[group.blocks.clone()]);
            for (column, weights) in group.weights() {
                if !held.contains(&of[column].of) {
                    add_scaled::<T, SIMD>(values, weights, columns[column]);
                }
            }
            activate::<T, SIMD>(values);
            for (output, coefficients) in group.coefficients() {
                let more = dot::<T, SIMD>(coefficients, values);
                y[to[output]] = y[to[output]] + more.scaled(scaling.output_scale[output]);
            }
            if first == 0 || !group.outputs.iter().any(has_gradient) {
                continue;
            }
            // from here on what the nodes are multiplied with in their derivatives
            for lanes in values.iter_mut() {
                *lanes = lanes.map(|value| T::from(1.0) - value * value);
            }
            for k in 0..first {
                let tangents = &mut tangents[..group.blocks.len()];
                let mut own = group.weights().filter(|(column, _)| of[*column].of == k).peekable();
                if own.peek().is_none() {
                    continue;
                }
                tangents.fill([T::from(0.0); LANES]);
                own.for_each(|(column, weights)| add_scaled::<T, SIMD>(tangents, weights, slopes[column]));
                for (tangents, values) in tangents.iter_mut().zip(values.iter()) {
                    tangents.iter_mut().zip(values).for_each(|(tangent, slope)| *tangent = *tangent * *slope);
                }
                for (output, coefficients) in group.coefficients().filter(|(output, _)| has_gradient(output)) {
                    let more = dot::<T, SIMD>(coefficients, tangents);
                    let to = &mut gradient[to[output] * first + k];
                    *to = *to + more.scaled(scaling.output_scale[output]);
                }
            }
        }
    }

    /// The columns and their derivatives at a point. Compiled once for all instruction sets, as `hold` is: FMUs stay small.
    #[inline(never)]
    fn standardise<T: Number>(&self, of: &[NetworkColumn], scaling: &Scaling, x: &[T], work: &mut NodesWork<T>) {
        let NodesWork { columns, slopes, .. } = work;
        let mut last = None;
        for (index, column) in of.iter().enumerate() {
            let scale = scaling.input_scale[index].recip();
            // sine and cosine of an angle come one after the other
            let is_plain = column.kind == ColumnKind::Plain;
            let known = last.filter(|(known, _)| *known == (column.of, is_plain)).map(|(_, both)| both);
            let both = known.unwrap_or_else(|| column.kind.parts(x[column.of]));
            last = Some(((column.of, is_plain), both));
            let [value, slope] = column.kind.chosen(both);
            columns[index] = (value - T::from(scaling.input_mean[index])).scaled(scale);
            slopes[index] = slope.scaled(scale);
        }
    }

    /// What follows from held columns alone.
    #[inline(never)]
    fn hold<T: Number>(&self, of: &[NetworkColumn], work: &mut NodesWork<T>) {
        let NodesWork { held, bias, constants, columns, values, .. } = work;
        for (bias, own) in bias.iter_mut().zip(&self.bias) {
            *bias = own.map(T::from);
        }
        constants.iter_mut().zip(&self.constants).for_each(|(constant, own)| *constant = T::from(*own));
        for group in &self.groups {
            let bias = &mut bias[group.blocks.clone()];
            let mut is_held = true;
            for (column, weights) in group.weights() {
                if held.contains(&of[column].of) {
                    add_scaled::<T, PORTABLE>(bias, weights, columns[column]);
                } else {
                    is_held = false;
                }
            }
            if is_held {
                let values = &mut values[..bias.len()];
                values.copy_from_slice(bias);
                activate::<T, PORTABLE>(values);
                for (output, coefficients) in group.coefficients() {
                    constants[output] = constants[output] + dot::<T, PORTABLE>(coefficients, values);
                }
            }
        }
    }
}

impl Group {
    /// Of each of its columns the weights, block by block.
    #[inline(always)]
    fn weights(&self) -> impl Iterator<Item = (usize, &[[f64; LANES]])> {
        self.columns.iter().copied().zip(self.weights.chunks_exact(self.blocks.len()))
    }

    /// Of each of its outputs the coefficients, block by block.
    #[inline(always)]
    fn coefficients(&self) -> impl Iterator<Item = (usize, &[[f64; LANES]])> {
        self.outputs.iter().copied().zip(self.coefficients.chunks_exact(self.blocks.len()))
    }
}

#[inline(always)]
fn add_scaled<T: Number, const SIMD: u8>(sums: &mut [[T; LANES]], weights: &[[f64; LANES]], x: T) {
    for (sums, weights) in sums.iter_mut().zip(weights) {
        sums.iter_mut().zip(weights).for_each(|(sum, weight)| *sum = sum.add_scaled::<SIMD>(x, *weight));
    }
}

#[inline(always)]
fn activate<T: Number, const SIMD: u8>(values: &mut [[T; LANES]]) {
    // over the numbers one after the other, which the compiler makes vectors of
    for value in values.as_flattened_mut() {
        *value = value.tanh::<SIMD>();
    }
}

#[inline(always)]
fn dot<T: Number, const SIMD: u8>(coefficients: &[[f64; LANES]], values: &[[T; LANES]]) -> T {
    // two sums each, so that an addition need not wait for the one before
    let mut sums = [[T::from(0.0); LANES]; 2];
    let (pairs, rest) = coefficients.as_chunks::<2>();
    let (value_pairs, value_rest) = values.as_chunks::<2>();
    for (pair, values) in pairs.iter().zip(value_pairs) {
        for half in 0..2 {
            for lane in 0..LANES {
                sums[half][lane] = sums[half][lane].add_scaled::<SIMD>(values[half][lane], pair[half][lane]);
            }
        }
    }
    for (coefficients, values) in rest.iter().zip(value_rest) {
        for lane in 0..LANES {
            sums[0][lane] = sums[0][lane].add_scaled::<SIMD>(values[lane], coefficients[lane]);
        }
    }
    let [even, odd] = sums;
    let mut lanes: [T; LANES] = std::array::from_fn(|lane| even[lane] + odd[lane]);
    for width in [LANES / 2, LANES / 4, LANES / 8] {
        for lane in 0..width {
            lanes[lane] = lanes[lane] + lanes[lane + width];
        }
    }
    lanes[0]
}
