//! The eigenvectors of a slowly changing symmetric matrix, followed by one step of the power iteration at a time.

use crate::network::{
    kernels::{
        InstructionSet, Left, SimdKernel, SimdLanes, Store, WIDTH,
        matrix::{Matrix, Multiply, multiply},
    },
    layout::padded,
};

/// A running mean of `A A^T` of some matrices `A`, and its approximate eigenvectors.
#[derive(Clone, Debug)]
pub(super) struct Eigenbasis {
    simd: InstructionSet,
    /// `[n, n]`
    pub(super) covariance: Matrix,
    /// One in each row, in nearly falling order of the eigenvalues.
    pub(super) rows: Matrix,
    /// One in each column.
    pub(super) columns: Matrix,
    /// `new rows * old columns` of the last refresh: turns coordinates in the old basis into such in the new one.
    pub(super) turn: Matrix,
    /// Its transpose.
    pub(super) turn_back: Matrix,
    next: Matrix,
    next_columns: Matrix,
    projections: Matrix,
}

impl Eigenbasis {
    pub(super) fn new(size: usize) -> Self {
        let zeros = Matrix::zeros(size, size);
        let identity = Matrix::identity(size);
        Self {
            simd: InstructionSet::detect(),
            covariance: zeros.clone(),
            rows: identity.clone(),
            columns: identity.clone(),
            turn: identity.clone(),
            turn_back: identity,
            next: zeros.clone(),
            next_columns: zeros,
            projections: Matrix::zeros(WIDTH, size),
        }
    }

    /// The eigenvectors times the covariance, made orthonormal again from the first to the last.
    pub(super) fn refresh(&mut self) {
        let Self { simd, covariance, rows, columns, turn, turn_back, next, next_columns, projections } = self;
        let (simd, size) = (*simd, covariance.rows);
        multiply(simd, all(rows), covariance, Store::Replace, &mut next.values);
        // in blocks: components along the vectors of the blocks before are removed by products, twice, because the
        // first time leaves rounding errors that are large beside what remains
        let stride = next.stride();
        next_columns.values.fill(0.0);
        for first in (0..size).step_by(WIDTH) {
            let count = (size - first).min(WIDTH);
            let (before, rest) = next.values.split_at_mut(first * stride);
            let block = &mut rest[..count * stride];
            let mut norms = [0.0; WIDTH];
            for (norm, row) in norms.iter_mut().zip(block.chunks(stride)) {
                *norm = simd.run(Dot { a: &row[..padded(size)], b: &row[..padded(size)] });
            }
            for _ in 0..2 {
                if first > 0 {
                    let along = Left { values: block, rows: count, inner: size, row_stride: stride, inner_stride: 1 };
                    multiply(simd, along, next_columns, Store::Replace, &mut projections.values);
                    let left = Left {
                        values: &projections.values,
                        rows: count,
                        inner: first,
                        row_stride: stride,
                        inner_stride: 1,
                    };
                    simd.run(Multiply { left, right: before, columns: size, store: Store::Subtract, to: block });
                }
            }
            for (row, norm) in norms[..count].iter().enumerate() {
                let (done, rest) = next.values.split_at_mut((first + row) * stride);
                let vector = &mut rest[..padded(size)];
                simd.run(Orthogonalize { vector, to: &done[first * stride..], stride });
                if !normalize(simd, vector, 1e-10 * norm) {
                    complete(simd, vector, done, stride, rows.row(first + row), size);
                }
            }
            for row in first..first + count {
                for (column, value) in next.row(row)[..size].iter().enumerate() {
                    next_columns.row_mut(column)[row] = *value;
                }
            }
        }
        multiply(simd, all(next), columns, Store::Replace, &mut turn.values);
        turn_back.set_transpose(turn);
        std::mem::swap(rows, next);
        std::mem::swap(columns, next_columns);
    }
}

/// All rows of a matrix as the left one of a product.
pub(super) fn all(matrix: &Matrix) -> Left<'_> {
    Left {
        values: &matrix.values,
        rows: matrix.rows,
        inner: matrix.columns,
        row_stride: matrix.stride(),
        inner_stride: 1,
    }
}

/// Puts a unit vector orthogonal to all of `done` into `vector`: the remainder of `wish`, or of the first unit vector
/// whose remainder is large enough. There is one, because fewer than `size` vectors are done.
fn complete(simd: InstructionSet, vector: &mut [f32], done: &[f32], stride: usize, wish: &[f32], size: usize) {
    vector.copy_from_slice(wish);
    for unit in 0..=size {
        for _ in 0..2 {
            simd.run(Orthogonalize { vector, to: done, stride });
        }
        if normalize(simd, vector, 0.5 / size as f32) || unit == size {
            return;
        }
        vector.fill(0.0);
        vector[unit] = 1.0;
    }
}

/// Divides a vector by its length if its square is finite and above `least`; returns true if it did.
fn normalize(simd: InstructionSet, vector: &mut [f32], least: f32) -> bool {
    let square = simd.run(Dot { a: vector, b: vector });
    let good = square > least && square.is_finite() && square > f32::MIN_POSITIVE;
    if good {
        let factor = square.sqrt().recip();
        vector.iter_mut().for_each(|value| *value *= factor);
    }
    good
}

struct Dot<'a> {
    a: &'a [f32],
    b: &'a [f32],
}

impl SimdKernel for Dot<'_> {
    type Output = f32;

    #[inline(always)]
    fn run<L: SimdLanes>(self) -> f32 {
        let mut sum = L::splat(0.0);
        for (a, b) in self.a.as_chunks::<WIDTH>().0.iter().zip(self.b.as_chunks::<WIDTH>().0) {
            sum = L::load(a).mul_add(L::load(b), sum);
        }
        sum.sum()
    }
}

/// Removes the components of a vector along orthonormal vectors, one after the other, twice.
struct Orthogonalize<'a> {
    vector: &'a mut [f32],
    /// The orthonormal vectors, at a distance of `stride`.
    to: &'a [f32],
    stride: usize,
}

impl SimdKernel for Orthogonalize<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: SimdLanes>(self) {
        let Self { vector, to, stride } = self;
        for _ in 0..2 {
            for unit in to.chunks_exact(stride) {
                let along = Dot { a: vector, b: unit }.run::<L>();
                let along = L::splat(-along);
                for (vector, unit) in vector.as_chunks_mut::<WIDTH>().0.iter_mut().zip(unit.as_chunks::<WIDTH>().0) {
                    along.mul_add(L::load(unit), L::load(vector)).store(vector);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spread(index: usize) -> f32 {
        2.0 * ((index + 1) as f64 * 0.618_033_988_749_894_9).fract() as f32 - 1.0
    }

    /// A symmetric matrix of the given rank, with eigenvalues that fall by half.
    fn symmetric(size: usize, rank: usize) -> Matrix {
        let mut matrix = Matrix::zeros(size, size);
        for k in 0..rank {
            let weight = 0.5f32.powi(k as i32);
            for row in 0..size {
                for column in 0..size {
                    matrix.row_mut(row)[column] +=
                        weight * spread(17 * k + row * row) * spread(17 * k + column * column);
                }
            }
        }
        matrix
    }

    #[test]
    fn the_basis_stays_orthonormal_whatever_the_rank() {
        for (size, rank) in [(1, 1), (5, 2), (33, 33), (129, 7), (64, 0), (40, 1)] {
            let mut basis = Eigenbasis::new(size);
            basis.covariance = symmetric(size, rank);
            for _ in 0..4 {
                basis.refresh();
            }
            for i in 0..size {
                for j in 0..size {
                    let dot: f64 =
                        (0..size).map(|k| f64::from(basis.rows.row(i)[k]) * f64::from(basis.columns.row(k)[j])).sum();
                    let expected = if i == j { 1.0 } else { 0.0 };
                    assert!((dot - expected).abs() < 1e-5, "size {size}, rank {rank}: {i} {j} {dot}");
                }
            }
        }
    }

    #[test]
    fn repeated_refreshes_find_the_eigenvectors() {
        let (size, mut basis) = (12, Eigenbasis::new(12));
        basis.covariance = symmetric(size, 12);
        for _ in 0..300 {
            basis.refresh();
        }
        for i in 0..3 {
            let vector: Vec<f64> = basis.rows.row(i)[..size].iter().map(|&value| value.into()).collect();
            let image: Vec<f64> = (0..size)
                .map(|row| (0..size).map(|k| f64::from(basis.covariance.row(row)[k]) * vector[k]).sum())
                .collect();
            let value: f64 = image.iter().zip(&vector).map(|(a, b)| a * b).sum();
            for (a, b) in image.iter().zip(&vector) {
                assert!((a - value * b).abs() < 1e-5 * value, "eigenvector {i}: {a} {}", value * b);
            }
        }
    }

    #[test]
    fn the_turn_leads_from_the_old_basis_to_the_new_one() {
        let mut basis = Eigenbasis::new(9);
        basis.covariance = symmetric(9, 9);
        basis.refresh();
        let old = basis.columns.clone();
        basis.refresh();
        for i in 0..9 {
            for j in 0..9 {
                let expected: f32 = (0..9).map(|k| basis.rows.row(i)[k] * old.row(k)[j]).sum();
                assert!((basis.turn.row(i)[j] - expected).abs() < 1e-6, "{i} {j}");
            }
        }
    }
}
