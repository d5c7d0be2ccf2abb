//! Square and other small matrices, row by row at a distance of [`stride`], for optimizers that need products.

use super::{InstructionSet, Left, Panel, SimdKernel, SimdLanes, Store, WIDTH, buffer::Buffer, product, transpose};
use crate::network::layout::{padded, stride};

/// A matrix; the padding after its last column is zero.
#[derive(Clone, Debug)]
pub(crate) struct Matrix {
    pub(crate) rows: usize,
    pub(crate) columns: usize,
    pub(crate) values: Buffer,
}

impl Matrix {
    pub(crate) fn zeros(rows: usize, columns: usize) -> Self {
        Self { rows, columns, values: Buffer::zeros(rows * stride(columns)) }
    }

    pub(crate) fn identity(rows: usize) -> Self {
        let mut matrix = Self::zeros(rows, rows);
        for row in 0..rows {
            matrix.values[row * stride(rows) + row] = 1.0;
        }
        matrix
    }

    /// Distance between rows.
    pub(crate) fn stride(&self) -> usize {
        stride(self.columns)
    }

    pub(crate) fn row(&self, row: usize) -> &[f32] {
        &self.values[row * self.stride()..][..padded(self.columns)]
    }

    pub(crate) fn row_mut(&mut self, row: usize) -> &mut [f32] {
        let stride = self.stride();
        &mut self.values[row * stride..][..padded(self.columns)]
    }

    /// Becomes the transpose of `from`.
    ///
    /// # Panics
    /// If its shape is not that of the transpose.
    pub(crate) fn set_transpose(&mut self, from: &Self) {
        assert_eq!((self.rows, self.columns), (from.columns, from.rows), "shape of the transpose");
        let (mut source, mut target) = ([[0.0; WIDTH]; WIDTH], [[0.0; WIDTH]; WIDTH]);
        for first_row in (0..from.rows).step_by(WIDTH) {
            let rows = (from.rows - first_row).min(WIDTH);
            for first_column in (0..from.columns).step_by(WIDTH) {
                let columns = (from.columns - first_column).min(WIDTH);
                for (row, source) in source[..rows].iter_mut().enumerate() {
                    source.copy_from_slice(&from.row(first_row + row)[first_column..first_column + WIDTH]);
                }
                // rows beyond the last one stay zero, and so do columns beyond the last one of the result
                target.as_flattened_mut().fill(0.0);
                transpose(&source[..rows], &mut target[..columns]);
                for (column, target) in target[..columns].iter().enumerate() {
                    self.row_mut(first_column + column)[first_row..first_row + WIDTH].copy_from_slice(target);
                }
            }
        }
    }
}

/// `to = left right`, for the rows that `left` has; `to`: these rows at the distance of `right`'s.
pub(crate) fn multiply(simd: InstructionSet, left: Left, right: &Matrix, store: Store, to: &mut [f32]) {
    simd.run(Multiply { left, right: &right.values, columns: right.columns, store, to });
}

/// As [`multiply`], with `right` and `to` as slices of rows of `columns` at a distance of [`stride`].
pub(crate) struct Multiply<'a> {
    pub(crate) left: Left<'a>,
    pub(crate) right: &'a [f32],
    pub(crate) columns: usize,
    pub(crate) store: Store,
    pub(crate) to: &'a mut [f32],
}

impl SimdKernel for Multiply<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: SimdLanes>(self) {
        let Self { left, right, columns, store, to } = self;
        for begin in (0..padded(columns)).step_by(WIDTH) {
            let panel = Panel { values: &right[begin.min(right.len())..], stride: stride(columns) };
            product::<L>(left, panel, L::splat(0.0), store, &mut to[begin..], stride(columns));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_and_transposes_agree_with_their_definitions() {
        for (rows, inner, columns) in [(1, 1, 1), (5, 33, 40), (129, 4, 32)] {
            let fill = |rows: usize, columns: usize, factor: usize| {
                let mut matrix = Matrix::zeros(rows, columns);
                for row in 0..rows {
                    for column in 0..columns {
                        matrix.row_mut(row)[column] = ((row * columns + column) * factor % 13) as f32;
                    }
                }
                matrix
            };
            let (a, b) = (fill(rows, inner, 7), fill(inner, columns, 5));
            let mut transpose = Matrix::zeros(inner, rows);
            transpose.set_transpose(&a);
            let plain = Left { values: &a.values, rows, inner, row_stride: a.stride(), inner_stride: 1 };
            let transposed =
                Left { values: &transpose.values, rows, inner, row_stride: 1, inner_stride: transpose.stride() };
            for left in [plain, transposed] {
                let mut c = fill(rows, columns, 3);
                let old = c.clone();
                multiply(InstructionSet::detect(), left, &b, Store::Blend(0.5), &mut c.values);
                for row in 0..rows {
                    for column in 0..padded(columns) {
                        let product: f32 = (0..inner).map(|k| a.row(row)[k] * b.row(k)[column]).sum();
                        assert_eq!(c.row(row)[column], 0.5 * (old.row(row)[column] + product), "{row} {column}");
                    }
                }
            }
        }
    }
}
