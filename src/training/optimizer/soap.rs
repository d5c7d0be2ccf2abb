//! SOAP: Vyas and others, arXiv:2409.11321, algorithm 3; Adam in the eigenbasis of Shampoo's preconditioner.
//!
//! ```text
//! of each layer   G [m, n], the gradient of weights and biases as one matrix
//! covariances     L = β L + (1 - β) G G^T,  R = β R + (1 - β) G^T G,  β that of Adam's mean square
//! eigenvectors    U of L and V of R, in columns; every few steps U = orthonormalized (L U), V = orthonormalized (R V)
//! step            G' = U^T G V,  D' = Adam's step for G',  D = U D' V^T,  P = (1 - rate decay) P - rate D
//! ```
//!
//! Adam's mean lies in the eigenbasis too and is turned along with it, which saves two products in each step.

use super::{
    Coefficients,
    eigenbasis::{Eigenbasis, all},
    elementwise::Elementwise,
};
use crate::{
    network::{
        kernels::{
            Kernel, Lanes, Left, Register, Simd, Store, WIDTH,
            matrix::{Matrix, multiply},
        },
        layout::{Layout, Shape},
    },
    study::Optimizer,
    training::team::{Divided, Team},
};
use std::ops::Range;

/// Rows of a matrix that a member works on at a time: two tiles.
const CHUNK: usize = 16;

/// The memory of the optimizer, and its working memory.
pub(super) struct Soap {
    simd: Simd,
    layers: Vec<Layer>,
    /// `U` and `V` of the first layer, of the second, ...
    bases: Vec<Eigenbasis>,
}

/// All matrices `[m, n]`.
struct Layer {
    shape: Shape,
    gradient: Matrix,
    /// `[n, m]`
    gradient_turned: Matrix,
    /// In the eigenbasis.
    mean: Matrix,
    square: Matrix,
    direction: Matrix,
    product: Matrix,
}

impl Soap {
    pub(super) fn new(layout: &Layout) -> Self {
        let layers: Vec<Layer> = layout.shapes.iter().map(Layer::new).collect();
        let sizes = layers.iter().flat_map(|layer| [layer.gradient.rows, layer.gradient.columns]);
        Self { simd: Simd::detect(), bases: sizes.map(Eigenbasis::new).collect(), layers }
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
        let Self { simd, layers, bases } = self;
        let adam = Elementwise::new(Optimizer::Soap, coefficients, step, learning_rate);
        let share = (1.0 - coefficients.square_memory) as f32;
        for (layer, bases) in layers.iter_mut().zip(bases.as_chunks_mut::<2>().0) {
            layer.take_up(gradient);
            layer.turn_gradient(*simd, team, share, adam, bases);
            layer.turn_back(*simd, team, adam, bases, parameters);
        }
        // the covariance of the first step alone says little about the eigenvectors
        if step > 1 && (step - 1).is_multiple_of(coefficients.refresh) {
            let count = bases.len();
            let divided = Divided::new(bases);
            // SAFETY: one basis for each item
            team.for_each(count, |_, index| unsafe { divided.range(index..index + 1)[0].refresh() });
            for (layer, [left, right]) in layers.iter_mut().zip(bases.as_chunks::<2>().0) {
                layer.turn_mean(*simd, left, right);
            }
        }
    }

    /// What is to be kept to go on later, with names.
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

impl Layer {
    fn new(shape: &Shape) -> Self {
        let (rows, columns) = shape.matrix_size();
        let zeros = || Matrix::zeros(rows, columns);
        Self {
            shape: shape.clone(),
            gradient: zeros(),
            gradient_turned: Matrix::zeros(columns, rows),
            mean: zeros(),
            square: zeros(),
            direction: zeros(),
            product: zeros(),
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
        self.gradient_turned.set_transpose(&self.gradient);
    }

    /// Both covariances, `G'`, and with it Adam's means and `D'`.
    fn turn_gradient(
        &mut self,
        simd: Simd,
        team: &mut Team,
        share: f32,
        adam: Elementwise,
        [left, right]: &mut [Eigenbasis; 2],
    ) {
        let Self { gradient, gradient_turned, mean, square, direction, product, .. } = self;
        let (gradient, turned) = (&*gradient, &*gradient_turned);
        let left_chunks = gradient.rows.div_ceil(CHUNK);
        let left_covariance = Rows::new(&mut left.covariance);
        let right_covariance = Rows::new(&mut right.covariance);
        let [mean, square, direction, product] = [mean, square, direction, product].map(Rows::new);
        team.for_each(left_chunks + gradient.columns.div_ceil(CHUNK), |_, index| {
            if index >= left_chunks {
                let rows = right_covariance.chunk(index - left_chunks);
                // SAFETY: one chunk for each item
                let to = unsafe { right_covariance.get(rows.clone()) };
                return multiply(simd, some(turned, rows), gradient, Store::Blend(share), to);
            }
            let rows = left_covariance.chunk(index);
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
            multiply(simd, some(gradient, rows.clone()), turned, Store::Blend(share), covariance);
            multiply(simd, some(&left.rows, rows.clone()), gradient, Store::Replace, product);
            let half = Left { values: product, inner: gradient.columns, ..some(gradient, rows) };
            multiply(simd, half, &right.columns, Store::Replace, direction);
            simd.run(Direction { adam, mean, square, direction });
        });
    }

    /// `D = U D' V^T`, and with it the new parameters.
    fn turn_back(
        &mut self,
        simd: Simd,
        team: &mut Team,
        adam: Elementwise,
        [left, right]: &[Eigenbasis; 2],
        parameters: &mut [f32],
    ) {
        let Self { shape, gradient, direction, product, .. } = self;
        let direction = &*direction;
        // the gradient is not needed any more: its place is taken by D
        let (result, product) = (Rows::new(gradient), Rows::new(product));
        let parameters = Divided::new(parameters);
        team.for_each(result.rows.div_ceil(CHUNK), |_, index| {
            let rows = result.chunk(index);
            // SAFETY: one chunk for each item
            let (result, product) = unsafe { (result.get(rows.clone()), product.get(rows.clone())) };
            multiply(simd, some(&left.columns, rows.clone()), direction, Store::Replace, product);
            let half = Left { values: product, inner: direction.columns, ..some(direction, rows.clone()) };
            multiply(simd, half, &right.rows, Store::Replace, result);
            for (row, direction) in rows.zip(result.chunks(direction.stride())) {
                for (range, column) in shape.matrix_row(row) {
                    let direction = &direction[column..column + range.len()];
                    // SAFETY: the rows of the matrix do not overlap in the parameters
                    let parameters = unsafe { parameters.range(range) };
                    parameters.iter_mut().zip(direction).for_each(|(p, d)| *p = adam.applied(*d, *p));
                }
            }
        });
    }

    /// Adam's mean in the new eigenbasis.
    fn turn_mean(&mut self, simd: Simd, left: &Eigenbasis, right: &Eigenbasis) {
        multiply(simd, all(&left.turn), &self.mean, Store::Replace, &mut self.product.values);
        multiply(simd, all(&self.product), &right.turn_back, Store::Replace, &mut self.mean.values);
    }
}

/// Some rows of a matrix as the left one of a product.
fn some(matrix: &Matrix, rows: Range<usize>) -> Left<'_> {
    Left { values: &matrix.values[rows.start * matrix.stride()..], rows: rows.len(), ..all(matrix) }
}

/// A matrix whose rows are written to in chunks, by several members.
struct Rows<'a> {
    values: Divided<'a, f32>,
    rows: usize,
    stride: usize,
}

impl<'a> Rows<'a> {
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
    /// As long as the result lives, no rows that overlap with these are asked for.
    #[expect(clippy::mut_from_ref, reason = "the caller keeps the rows apart")]
    unsafe fn get(&self, rows: Range<usize>) -> &mut [f32] {
        // SAFETY: as the caller promises
        unsafe { self.values.range(rows.start * self.stride..rows.end * self.stride) }
    }
}

/// Replaces `G'` by `D'`, after Adam's means have taken it up.
struct Direction<'a> {
    adam: Elementwise,
    mean: &'a mut [f32],
    square: &'a mut [f32],
    direction: &'a mut [f32],
}

impl Kernel for Direction<'_> {
    type Output = ();

    #[inline(always)]
    fn run<R: Register, const N: usize>(self) {
        let Self { adam, mean, square, direction } = self;
        let moments = mean.as_chunks_mut::<WIDTH>().0.iter_mut().zip(square.as_chunks_mut::<WIDTH>().0);
        for ((mean, square), direction) in moments.zip(direction.as_chunks_mut::<WIDTH>().0) {
            let gradient = Lanes::<R, N>::load(direction);
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
        let layout = Layout::new(&[3, 40, 35, 2], false);
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
