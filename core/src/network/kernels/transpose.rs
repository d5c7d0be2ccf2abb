//! The transpose of a block, in blocks of 4 by 4, which take a few shuffles each.

use crate::network::layout::{LayerShape, Piece, WIDTH};
use std::ops::Range;

impl Piece {
    /// Renews the transposed weights after an update of the piece's `parameters`; `place` is called with a range of the
    /// transposed weights and what fills it.
    pub(crate) fn transpose(
        &self,
        shape: &LayerShape,
        parameters: &[f32],
        mut place: impl FnMut(Range<usize>, &dyn Fn(&mut [f32])),
    ) {
        let Some(panel) = self.panel else { return };
        let panels = parameters[..shape.inputs * WIDTH].chunks(WIDTH * WIDTH);
        for (weights, range) in panels.zip(shape.transposed_ranges(panel)) {
            place(range, &|to| transpose(weights.as_chunks().0, to.as_chunks_mut().0));
        }
    }
}

/// `to[column][row] = from[row][column]`, for all rows of `from` and `to`, at most [`WIDTH`] of each.
pub(crate) fn transpose(from: &[[f32; WIDTH]], to: &mut [[f32; WIDTH]]) {
    let (rows, columns) = (from.len() / 4 * 4, to.len() / 4 * 4);
    for row in (0..rows).step_by(4) {
        for column in (0..columns).step_by(4) {
            let block = transpose4([0, 1, 2, 3].map(|i| quad(&from[row + i], column)));
            for (within, values) in block.into_iter().enumerate() {
                to[column + within].as_chunks_mut::<4>().0[row / 4] = values;
            }
        }
    }
    for (column, to) in to.iter_mut().enumerate() {
        // what is left at the right and at the bottom
        let first = if column < columns { rows } else { 0 };
        for row in first..from.len() {
            to[row] = from[row][column];
        }
    }
}

#[inline(always)]
fn quad(row: &[f32; WIDTH], column: usize) -> [f32; 4] {
    row.as_chunks::<4>().0[column / 4]
}

#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn transpose4(rows: [[f32; 4]; 4]) -> [[f32; 4]; 4] {
    use std::arch::x86_64::{_MM_TRANSPOSE4_PS, _mm_loadu_ps, _mm_storeu_ps};
    // SAFETY: SSE is part of x86-64; loads and stores are of arrays of four
    unsafe {
        let [mut a, mut b, mut c, mut d] = rows.each_ref().map(|row| _mm_loadu_ps(row.as_ptr()));
        _MM_TRANSPOSE4_PS(&mut a, &mut b, &mut c, &mut d);
        let mut columns = [[0.0; 4]; 4];
        for (column, values) in columns.iter_mut().zip([a, b, c, d]) {
            _mm_storeu_ps(column.as_mut_ptr(), values);
        }
        columns
    }
}

#[cfg(not(target_arch = "x86_64"))]
#[inline(always)]
fn transpose4(rows: [[f32; 4]; 4]) -> [[f32; 4]; 4] {
    std::array::from_fn(|column| rows.map(|row| row[column]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_of_any_size_are_transposed() {
        let from: Vec<[f32; WIDTH]> =
            (0..WIDTH).map(|row| std::array::from_fn(|column| (100 * row + column) as f32)).collect();
        for (rows, columns) in [(0, 5), (1, 1), (4, 32), (7, 30), (32, 32), (3, 6)] {
            let mut to = vec![[-1.0; WIDTH]; columns];
            transpose(&from[..rows], &mut to);
            for (column, to) in to.iter().enumerate() {
                for (row, found) in to.iter().enumerate() {
                    let expected = if row < rows { from[row][column] } else { -1.0 };
                    assert_eq!(*found, expected, "{rows} by {columns}: row {row}, column {column}");
                }
            }
        }
    }
}
