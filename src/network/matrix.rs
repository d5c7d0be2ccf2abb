//! Matrix products in single precision.

/// A view of `rows * columns` values, row by row, or of their transpose.
#[derive(Clone, Copy, Debug)]
pub(super) struct Matrix<'a> {
    values: &'a [f32],
    rows: usize,
    columns: usize,
    row_stride: usize,
    column_stride: usize,
}

/// What becomes of the values that stand in the result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Store {
    Replace,
    Add,
}

impl<'a> Matrix<'a> {
    /// `values`, row by row, in rows of `columns`.
    pub(super) fn new(values: &'a [f32], columns: usize) -> Self {
        let rows = values.len() / columns;
        assert_eq!(values.len(), rows * columns, "whole rows");
        Self { values, rows, columns, row_stride: columns, column_stride: 1 }
    }

    /// The same values with rows and columns exchanged; nothing is copied.
    pub(super) fn transposed(self) -> Self {
        let Self { values, rows, columns, row_stride, column_stride } = self;
        Self { values, rows: columns, columns: rows, row_stride: column_stride, column_stride: row_stride }
    }
}

/// `c = a b` or `c += a b`, with `c` row by row.
///
/// # Panics
/// If the shapes do not fit.
pub(super) fn multiply(a: Matrix, b: Matrix, store: Store, c: &mut [f32]) {
    assert_eq!(a.columns, b.rows, "inner dimension");
    assert_eq!(c.len(), a.rows * b.columns, "size of the result");
    // SAFETY: the strides of a `Matrix` reach every one of its `values` once and nothing else, the assertions above hold
    // for the result, and `c` is borrowed exclusively
    unsafe {
        gemm::gemm(
            a.rows,
            b.columns,
            a.columns,
            c.as_mut_ptr(),
            1,
            b.columns as isize,
            store == Store::Add,
            a.values.as_ptr(),
            a.column_stride as isize,
            a.row_stride as isize,
            b.values.as_ptr(),
            b.column_stride as isize,
            b.row_stride as isize,
            1.0,
            1.0,
            false,
            false,
            false,
            gemm::Parallelism::None,
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_of_plain_and_transposed_matrices_agree_with_the_definition() {
        // integers below 2^24: exact in any order of summation
        let sequence = |count: usize, factor: usize| (0..count).map(|i| ((i * factor) % 13) as f32).collect::<Vec<_>>();
        for (rows, inner, columns) in [(1, 1, 1), (3, 4, 2), (17, 5, 33), (128, 128, 3), (64, 4, 128)] {
            let (a, b) = (sequence(rows * inner, 7), sequence(inner * columns, 5));
            let product = |row: usize, column: usize| -> f32 {
                (0..inner).map(|i| a[row * inner + i] * b[i * columns + column]).sum()
            };
            let expected: Vec<f32> =
                (0..rows * columns).map(|index| product(index / columns, index % columns)).collect();
            let mut c = vec![f32::NAN; rows * columns];
            multiply(Matrix::new(&a, inner), Matrix::new(&b, columns), Store::Replace, &mut c);
            assert_eq!(c, expected, "{rows} x {inner} x {columns}");

            let (mut a_transposed, mut b_transposed) = (vec![0.0; a.len()], vec![0.0; b.len()]);
            (0..a.len()).for_each(|i| a_transposed[(i % inner) * rows + i / inner] = a[i]);
            (0..b.len()).for_each(|i| b_transposed[(i % columns) * inner + i / columns] = b[i]);
            let (a, b) = (Matrix::new(&a_transposed, rows), Matrix::new(&b_transposed, inner));
            multiply(a.transposed(), b.transposed(), Store::Add, &mut c);
            let twice: Vec<f32> = expected.iter().map(|value| 2.0 * value).collect();
            assert_eq!(c, twice, "{rows} x {inner} x {columns}, transposed and added");
        }
    }
}
