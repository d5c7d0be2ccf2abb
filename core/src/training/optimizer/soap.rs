//! SOAP: Vyas and others, arXiv:2409.11321, algorithm 3; Adam in the eigenbasis of Shampoo's preconditioner.
//!
//! ```text
//! of each layer   G [m, n], the gradient of weights and biases as one matrix
//! covariances     L = β L + (1 - β) G G^T,  R = β R + (1 - β) G^T G,  β that of Adam's mean square
//! eigenvectors    U of L and V of R, in columns; every few steps U = orthonormalized (L U), V = orthonormalized (R V)
//! step            G' = U^T G V,  D' = Adam's step for G',  D = U D' V^T,  P = (1 - rate decay) P - rate D
//! ```
//!
//! Adam's mean is in the eigenbasis too and is rotated along with it, which saves two products in each step.

use super::{
    Coefficients,
    eigenbasis::{Eigenbasis, all},
    elementwise::ElementwiseStep,
};
use crate::{
    network::{
        kernels::{
            InstructionSet, Left, SimdKernel, SimdLanes, Store, WIDTH,
            matrix::{Matrix, multiply},
        },
        layout::{LayerShape, NetworkLayout},
    },
    study::Optimizer,
    training::team::{Divided, Team},
};
use std::ops::Range;

/// Rows of a matrix that a member works on at a time: two tiles.
const CHUNK: usize = 16;

/// The memory of the optimizer, and its working memory.
pub(super) struct Soap {
    simd: InstructionSet,
    layers: Vec<SoapLayer>,
    /// `U` and `V` of the first layer, of the second, ...
    bases: Vec<Eigenbasis>,
    /// The pieces of work on all layers, each a layer and a number within it.
    into_basis: Vec<(usize, usize)>,
    out_of_basis: Vec<(usize, usize)>,
}

/// Matrices of SOAP for a layer, all `[m, n]`.
struct SoapLayer {
    index: usize,
    shape: LayerShape,
    gradient: Matrix,
    /// `[n, m]`
    gradient_transposed: Matrix,
    /// In the eigenbasis.
    mean: Matrix,
    square: Matrix,
    direction: Matrix,
    product: Matrix,
}

impl Soap {
    pub(super) fn new(layout: &NetworkLayout) -> Self {
        let layers: Vec<SoapLayer> = layout.shapes.iter().enumerate().map(SoapLayer::new).collect();
        let sizes = layers.iter().flat_map(|layer| [layer.gradient.rows, layer.gradient.columns]);
        let bases = sizes.map(Eigenbasis::new).collect();
        let items = |of: fn(&SoapLayer) -> usize| {
            layers.iter().enumerate().flat_map(|(index, layer)| (0..of(layer)).map(move |item| (index, item))).collect()
        };
        let into_basis = items(|layer| layer.row_chunks() + layer.gradient.columns.div_ceil(CHUNK));
        Self { simd: InstructionSet::detect(), bases, into_basis, out_of_basis: items(SoapLayer::row_chunks), layers }
    }

    /// Step number `step`, counted from 1. `gradient` and `parameters`: laid out as the packed parameters are.
    pub(super) fn step(
        &mut self,
        team: &mut Team,
        coefficients: &Coefficients,
        step: u64,
        learning_rate: f64,
        gradient: &[f32],
        parameters: &mut [f32],
    ) {
        let Self { simd, layers, bases, into_basis, out_of_basis } = self;
        let simd = *simd;
        let adam = ElementwiseStep::new(Optimizer::Soap, coefficients, step, learning_rate);
        let share = (1.0 - coefficients.beta2) as f32;
        // the layers together, so that the members of the team wait for each other three times only
        for_all(team, layers, |layer| layer.take_up(gradient));
        {
            let pairs = layers.iter_mut().zip(bases.as_chunks_mut::<2>().0);
            let layers: Vec<IntoBasis> = pairs.map(|(layer, bases)| IntoBasis::new(layer, bases)).collect();
            team.for_each(into_basis.len(), |_, index| {
                let (layer, item) = into_basis[index];
                // SAFETY: each item once
                unsafe { layers[layer].run(simd, share, adam, item) };
            });
        }
        {
            let pairs = layers.iter_mut().zip(bases.as_chunks::<2>().0);
            let layers: Vec<OutOfBasis> = pairs.map(|(layer, bases)| OutOfBasis::new(layer, bases)).collect();
            let parameters = Divided::new(parameters);
            team.for_each(out_of_basis.len(), |_, index| {
                let (layer, item) = out_of_basis[index];
                // SAFETY: each item once
                unsafe { layers[layer].run(simd, adam, item, &parameters) };
            });
        }
        // the covariance of the first step alone says little about the eigenvectors
        if step > 1 && (step - 1).is_multiple_of(coefficients.refresh) {
            for_all(team, bases, Eigenbasis::refresh);
            let bases = bases.as_chunks::<2>().0;
            for_all(team, layers, |layer| layer.rotate_mean(simd, &bases[layer.index]));
        }
    }

    /// The state that a checkpoint keeps, with names.
    pub(super) fn memory(&mut self) -> Vec<(String, &mut [f32])> {
        let mut memory: Vec<(String, &mut [f32])> = Vec::new();
        for (index, basis) in self.bases.iter_mut().enumerate() {
            let side = if index % 2 == 0 { "left" } else { "right" };
            for (name, matrix) in
                [("covariance", &mut basis.covariance), ("rows", &mut basis.rows), ("columns", &mut basis.columns)]
            {
                memory.push((format!("soap.{}.{side}.{name}", index / 2), &mut matrix.values));
            }
        }
        for (index, layer) in self.layers.iter_mut().enumerate() {
            for (name, matrix) in [("mean", &mut layer.mean), ("square", &mut layer.square)] {
                memory.push((format!("soap.{index}.{name}"), &mut matrix.values));
            }
        }
        memory
    }
}

/// Calls `work` once with each of the values, on all members of the team.
fn for_all<T: Send>(team: &mut Team, values: &mut [T], work: impl Fn(&mut T) + Sync) {
    let (count, values) = (values.len(), Divided::new(values));
    // SAFETY: one value for each item
    team.for_each(count, |_, index| work(unsafe { &mut values.range(index..index + 1)[0] }));
}

impl SoapLayer {
    fn new((index, shape): (usize, &LayerShape)) -> Self {
        let (rows, columns) = shape.matrix_size();
        let zeros = Matrix::zeros(rows, columns);
        Self {
            index,
            shape: shape.clone(),
            gradient: zeros.clone(),
            gradient_transposed: Matrix::zeros(columns, rows),
            mean: zeros.clone(),
            square: zeros.clone(),
            direction: zeros.clone(),
            product: zeros,
        }
    }

    /// `G` and `G^T`.
    fn take_up(&mut self, gradient: &[f32]) {
        for row in 0..self.gradient.rows {
            let to = self.gradient.row_mut(row);
            for (range, column) in self.shape.matrix_row(row) {
                to[column..column + range.len()].copy_from_slice(&gradient[range]);
            }
        }
        self.gradient_transposed.set_transpose(&self.gradient);
    }

    /// Number of chunks of [`CHUNK`] rows.
    fn row_chunks(&self) -> usize {
        self.gradient.rows.div_ceil(CHUNK)
    }

    /// Adam's mean in the new eigenbasis.
    fn rotate_mean(&mut self, simd: InstructionSet, [left, right]: &[Eigenbasis; 2]) {
        multiply(simd, all(&left.turn), &self.mean, Store::Replace, &mut self.product.values);
        multiply(simd, all(&self.product), &right.turn_back, Store::Replace, &mut self.mean.values);
    }
}

/// Both covariances, `G'`, and with it Adam's means and `D'`, of a layer.
struct IntoBasis<'a> {
    gradient: &'a Matrix,
    gradient_transposed: &'a Matrix,
    left_rows: &'a Matrix,
    right_columns: &'a Matrix,
    left_covariance: MatrixRows<'a>,
    right_covariance: MatrixRows<'a>,
    mean: MatrixRows<'a>,
    square: MatrixRows<'a>,
    direction: MatrixRows<'a>,
    product: MatrixRows<'a>,
}

impl<'a> IntoBasis<'a> {
    fn new(layer: &'a mut SoapLayer, [left, right]: &'a mut [Eigenbasis; 2]) -> Self {
        let SoapLayer { gradient, gradient_transposed, mean, square, direction, product, .. } = layer;
        let [mean, square, direction, product] = [mean, square, direction, product].map(MatrixRows::new);
        Self {
            gradient,
            gradient_transposed,
            left_rows: &left.rows,
            right_columns: &right.columns,
            left_covariance: MatrixRows::new(&mut left.covariance),
            right_covariance: MatrixRows::new(&mut right.covariance),
            mean,
            square,
            direction,
            product,
        }
    }

    /// Some rows of the left covariance and of what follows from the gradient, then some rows of the right covariance.
    ///
    /// # Safety
    /// No item overlaps with another call for the same one.
    unsafe fn run(&self, simd: InstructionSet, share: f32, adam: ElementwiseStep, item: usize) {
        let Self {
            gradient,
            gradient_transposed,
            left_covariance,
            right_covariance,
            mean,
            square,
            direction,
            product,
            ..
        } = self;
        let Some(index) = item.checked_sub(gradient.rows.div_ceil(CHUNK)) else {
            let rows = left_covariance.chunk(item);
            // SAFETY: one chunk for each item
            let (covariance, mean, square, direction, product) = unsafe {
                (
                    left_covariance.get(rows.clone()),
                    mean.get(rows.clone()),
                    square.get(rows.clone()),
                    direction.get(rows.clone()),
                    product.get(rows.clone()),
                )
            };
            multiply(simd, some(gradient, rows.clone()), gradient_transposed, Store::Blend(share), covariance);
            multiply(simd, some(self.left_rows, rows.clone()), gradient, Store::Replace, product);
            let half = Left { values: product, inner: gradient.columns, ..some(gradient, rows) };
            multiply(simd, half, self.right_columns, Store::Replace, direction);
            return simd.run(Direction { adam, mean, square, direction });
        };
        let rows = right_covariance.chunk(index);
        // SAFETY: one chunk for each item
        let to = unsafe { right_covariance.get(rows.clone()) };
        multiply(simd, some(gradient_transposed, rows), gradient, Store::Blend(share), to);
    }
}

/// `D = U D' V^T`, and with it the new parameters, of a layer.
struct OutOfBasis<'a> {
    shape: &'a LayerShape,
    direction: &'a Matrix,
    left_columns: &'a Matrix,
    right_rows: &'a Matrix,
    /// The gradient is not needed any more: its place is taken by `D`.
    result: MatrixRows<'a>,
    product: MatrixRows<'a>,
}

impl<'a> OutOfBasis<'a> {
    fn new(layer: &'a mut SoapLayer, [left, right]: &'a [Eigenbasis; 2]) -> Self {
        let SoapLayer { shape, gradient, direction, product, .. } = layer;
        let (result, product) = (MatrixRows::new(gradient), MatrixRows::new(product));
        Self { shape, direction, left_columns: &left.columns, right_rows: &right.rows, result, product }
    }

    /// Some rows.
    ///
    /// # Safety
    /// No item overlaps with another call for the same one.
    unsafe fn run(&self, simd: InstructionSet, adam: ElementwiseStep, item: usize, parameters: &Divided<f32>) {
        let Self { shape, direction, left_columns, right_rows, result, product } = self;
        let rows = result.chunk(item);
        // SAFETY: one chunk for each item
        let (result, product) = unsafe { (result.get(rows.clone()), product.get(rows.clone())) };
        multiply(simd, some(left_columns, rows.clone()), direction, Store::Replace, product);
        let half = Left { values: product, inner: direction.columns, ..some(direction, rows.clone()) };
        multiply(simd, half, right_rows, Store::Replace, result);
        for (row, direction) in rows.zip(result.chunks(direction.stride())) {
            for (range, column) in shape.matrix_row(row) {
                let direction = &direction[column..column + range.len()];
                // SAFETY: the rows of the matrix do not overlap in the parameters
                let parameters = unsafe { parameters.range(range) };
                parameters.iter_mut().zip(direction).for_each(|(p, d)| *p = adam.applied(*d, *p));
            }
        }
    }
}

/// Some rows of a matrix as the left one of a product.
fn some(matrix: &Matrix, rows: Range<usize>) -> Left<'_> {
    Left { values: &matrix.values[rows.start * matrix.stride()..], rows: rows.len(), ..all(matrix) }
}

/// A matrix whose rows are written to in chunks, by several members.
struct MatrixRows<'a> {
    values: Divided<'a, f32>,
    rows: usize,
    stride: usize,
}

impl<'a> MatrixRows<'a> {
    fn new(matrix: &'a mut Matrix) -> Self {
        Self { rows: matrix.rows, stride: matrix.stride(), values: Divided::new(&mut matrix.values) }
    }

    /// The rows of a chunk.
    fn chunk(&self, index: usize) -> Range<usize> {
        index * CHUNK..((index + 1) * CHUNK).min(self.rows)
    }

    /// The values of some rows.
    ///
    /// # Safety
    /// As long as the result lives, no rows that overlap with these are requested.
    #[expect(clippy::mut_from_ref, reason = "the caller keeps the rows apart")]
    unsafe fn get(&self, rows: Range<usize>) -> &mut [f32] {
        // SAFETY: as the caller promises
        unsafe { self.values.range(rows.start * self.stride..rows.end * self.stride) }
    }
}

/// Replaces `G'` by `D'`, after Adam's means have taken it up.
struct Direction<'a> {
    adam: ElementwiseStep,
    mean: &'a mut [f32],
    square: &'a mut [f32],
    direction: &'a mut [f32],
}

impl SimdKernel for Direction<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: SimdLanes>(self) {
        let Self { adam, mean, square, direction } = self;
        let moments = mean.as_chunks_mut::<WIDTH>().0.iter_mut().zip(square.as_chunks_mut::<WIDTH>().0);
        for ((mean, square), direction) in moments.zip(direction.as_chunks_mut::<WIDTH>().0) {
            let gradient = L::load(direction);
            adam.direction(gradient, mean, square).store(direction);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::training::optimizer::tests::coefficients;

    #[test]
    fn steps_are_the_same_bits_on_any_number_of_threads_and_leave_the_padding_alone() {
        let layout = NetworkLayout::new(&[3, 40, 35, 2], false);
        let run = |threads| {
            let (mut team, mut soap) = (Team::new(threads), Soap::new(&layout));
            let mut parameters = vec![0.0; layout.len()];
            let count = 4 * 40 + 41 * 35 + 36 * 2;
            for step in 1..=25 {
                let plain: Vec<f32> = (0..count).map(|i| ((i + 31 * step) as f32).sin()).collect();
                let mut gradient = vec![0.0; layout.len()];
                layout.pack(&plain, &mut gradient);
                soap.step(&mut team, &coefficients(), step as u64, 0.01, &gradient, &mut parameters);
            }
            parameters
        };
        let one = run(1);
        assert!(one.iter().all(|parameter| parameter.is_finite()));
        assert_eq!(one, run(2));
        let mut plain = vec![0.0; 4 * 40 + 41 * 35 + 36 * 2];
        layout.unpack(&one, &mut plain);
        let mut again = vec![0.0; layout.len()];
        layout.pack(&plain, &mut again);
        assert_eq!(one, again, "something is in the padding");
    }
}
