//! How parameters lie in memory while a network is trained.

use std::ops::Range;

/// Columns of a panel. Two AVX-512 registers hide the latency of dependent instructions.
pub(crate) const WIDTH: usize = 32;

/// Columns of a matrix with the padding that makes them whole panels.
pub(crate) const fn padded(columns: usize) -> usize {
    columns.next_multiple_of(WIDTH)
}

/// Distance between the rows of activations and deltas: an odd number of cache lines, so that the rows of a column do
/// not compete for the same few places of the cache.
pub(crate) const fn stride(columns: usize) -> usize {
    padded(columns) + 16
}

/// A last layer with at most this many outputs is kept by rows.
const FEW_OUTPUTS: usize = 8;

/// A layer's place in the block of all parameters.
///
/// ```text
/// by panels    W^T in panels of 32 outputs [padded(outputs) / 32, inputs, 32], then b [padded(outputs)]
/// by rows      W [outputs, padded(inputs)], then b [padded(outputs)]
/// transposed   W in panels of 32 inputs [padded(inputs) / 32, outputs, 32]: for the backward pass of a layer by panels
/// ```
///
/// The biases of a hidden layer that is normalized over its rows are followed by the factors of the normalized values
/// [padded(outputs)]. The padding is zero and stays so.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct LayerShape {
    pub(crate) inputs: usize,
    pub(crate) outputs: usize,
    pub(crate) by_rows: bool,
    /// Range of all weights and biases, padding included, within the block of parameters.
    range: Range<usize>,
    weights: usize,
    pub(crate) normalized: bool,
    /// Within the block of transposed weights; empty for the first layer, whose inputs need no derivative.
    transposed: Range<usize>,
}

/// A piece of the parameters that can be updated on its own: a panel of a layer, or a whole small layer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Piece {
    pub(crate) layer: usize,
    /// Within the block of parameters.
    pub(crate) range: Range<usize>,
    /// The panel to be transposed after the update.
    pub(crate) panel: Option<usize>,
}

/// The places of all layers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct NetworkLayout {
    pub(crate) shapes: Vec<LayerShape>,
    pub(crate) pieces: Vec<Piece>,
}

impl NetworkLayout {
    /// `batch_norm`: whether hidden layers are normalized over their rows.
    pub(crate) fn new(sizes: &[usize], batch_norm: bool) -> Self {
        let (mut shapes, mut pieces) = (Vec::new(), Vec::new());
        let (mut begin, mut transposed) = (0, 0);
        let last = sizes.len() - 2;
        for (layer, pair) in sizes.windows(2).enumerate() {
            let (inputs, outputs) = (pair[0], pair[1]);
            let by_rows = layer == last && outputs <= FEW_OUTPUTS;
            let weights = if by_rows { outputs * padded(inputs) } else { inputs * padded(outputs) };
            let normalized = batch_norm && layer < last;
            let range = begin..begin + weights + padded(outputs) * if normalized { 2 } else { 1 };
            let transposed_end = if by_rows || layer == 0 { transposed } else { transposed + outputs * padded(inputs) };
            if transposed_end == transposed {
                pieces.push(Piece { layer, range: range.clone(), panel: None });
            } else {
                let panels = padded(outputs) / WIDTH;
                for panel in 0..panels {
                    let first = range.start + panel * inputs * WIDTH;
                    // the biases go with the last panel
                    let end = if panel + 1 == panels { range.end } else { first + inputs * WIDTH };
                    pieces.push(Piece { layer, range: first..end, panel: Some(panel) });
                }
            }
            begin = range.end;
            shapes.push(LayerShape {
                inputs,
                outputs,
                by_rows,
                range,
                weights,
                normalized,
                transposed: transposed..transposed_end,
            });
            transposed = transposed_end;
        }
        Self { shapes, pieces }
    }

    /// Length of the block of parameters.
    pub(crate) fn len(&self) -> usize {
        self.shapes.last().map_or(0, |shape| shape.range.end)
    }

    /// Length of the block of transposed weights.
    pub(crate) fn transposed_len(&self) -> usize {
        self.shapes.last().map_or(0, |shape| shape.transposed.end)
    }

    /// From the parameters of a [`Network`](super::Network) to this layout.
    pub(crate) fn pack(&self, plain: &[f32], packed: &mut [f32]) {
        packed.fill(0.0);
        self.for_each(|plain_index, packed_index| packed[packed_index] = plain[plain_index]);
        for shape in self.shapes.iter().filter(|shape| shape.normalized) {
            let outputs = shape.outputs;
            shape.factors_mut(packed)[..outputs].fill(1.0);
        }
    }

    /// From this layout to the parameters of a [`Network`](super::Network).
    pub(crate) fn unpack(&self, packed: &[f32], plain: &mut [f32]) {
        self.for_each(|plain_index, packed_index| plain[plain_index] = packed[packed_index]);
    }

    /// The index of every parameter in a network's block and in this one.
    fn for_each(&self, mut visit: impl FnMut(usize, usize)) {
        let mut plain = 0;
        for shape in &self.shapes {
            for output in 0..shape.outputs {
                for input in 0..shape.inputs {
                    visit(plain, shape.range.start + shape.weight(output, input));
                    plain += 1;
                }
            }
            for output in 0..shape.outputs {
                visit(plain, shape.range.start + shape.weights + output);
                plain += 1;
            }
        }
    }
}

impl LayerShape {
    /// Position of a weight within the layer's part.
    fn weight(&self, output: usize, input: usize) -> usize {
        if self.by_rows {
            output * padded(self.inputs) + input
        } else {
            (output / WIDTH * self.inputs + input) * WIDTH + output % WIDTH
        }
    }

    /// The layer's weights and biases out of a block laid out as the parameters are.
    pub(crate) fn split<'a>(&self, block: &'a [f32]) -> (&'a [f32], &'a [f32]) {
        block[self.range.start..self.biases().end].split_at(self.weights)
    }

    pub(crate) fn split_mut<'a>(&self, block: &'a mut [f32]) -> (&'a mut [f32], &'a mut [f32]) {
        block[self.range.start..self.biases().end].split_at_mut(self.weights)
    }

    /// Multiplies the weights of each output; of a layer by panels.
    pub(crate) fn scale_outputs(&self, parameters: &mut [f32], scale: &[f32]) {
        let panels = self.split_mut(parameters).0.chunks_exact_mut(self.inputs * WIDTH);
        for (panel, scale) in panels.zip(scale.as_chunks::<WIDTH>().0) {
            for row in panel.as_chunks_mut::<WIDTH>().0 {
                row.iter_mut().zip(scale).for_each(|(weight, scale)| *weight *= scale);
            }
        }
    }

    fn biases(&self) -> Range<usize> {
        let begin = self.range.start + self.weights;
        begin..begin + padded(self.outputs)
    }

    /// The factors of the normalized values; empty where there are none.
    pub(crate) fn factors<'a>(&self, block: &'a [f32]) -> &'a [f32] {
        &block[self.biases().end..self.range.end]
    }

    pub(crate) fn factors_mut<'a>(&self, block: &'a mut [f32]) -> &'a mut [f32] {
        &mut block[self.biases().end..self.range.end]
    }

    /// Rows and columns of the layer's parameters as one matrix: `[W^T; b]` of a layer by panels, with the factors of the
    /// normalized values as another row, `[W b]` of a layer by rows.
    pub(crate) fn matrix_size(&self) -> (usize, usize) {
        if self.by_rows {
            (self.outputs, self.inputs + 1)
        } else {
            (self.inputs + 1 + usize::from(self.normalized), self.outputs)
        }
    }

    /// Where a row of this matrix lies: pairs of a range within the block of parameters and its first column.
    pub(crate) fn matrix_row(&self, row: usize) -> impl Iterator<Item = (Range<usize>, usize)> {
        let (begin, biases) = (self.range.start, self.range.start + self.weights);
        let pieces = if self.by_rows { 2 } else { padded(self.outputs) / WIDTH };
        (0..pieces).map(move |index| {
            let (at, length, column) = if self.by_rows {
                if index == 0 {
                    (begin + row * padded(self.inputs), self.inputs, 0)
                } else {
                    (biases + row, 1, self.inputs)
                }
            } else if row < self.inputs {
                (begin + (index * self.inputs + row) * WIDTH, WIDTH, index * WIDTH)
            } else {
                // the biases, and after them the factors
                (biases + (row - self.inputs) * padded(self.outputs) + index * WIDTH, WIDTH, index * WIDTH)
            };
            (at..at + length, column)
        })
    }

    /// The layer's transposed weights.
    pub(crate) fn transposed<'a>(&self, block: &'a [f32]) -> &'a [f32] {
        &block[self.transposed.clone()]
    }

    /// Where the transposed weights of a panel of 32 outputs lie: a range for each panel of 32 inputs.
    pub(crate) fn transposed_ranges(&self, panel: usize) -> impl Iterator<Item = Range<usize>> {
        let rows = (self.outputs - panel * WIDTH).min(WIDTH);
        let (begin, distance) = (self.transposed.start + panel * WIDTH * WIDTH, self.outputs * WIDTH);
        (0..padded(self.inputs) / WIDTH)
            .map(move |index| begin + index * distance..begin + index * distance + rows * WIDTH)
    }
}
