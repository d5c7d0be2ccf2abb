//! The one matrix product everything is made of: a tile of rows times a panel of [`WIDTH`] columns.

use super::{SimdLanes, WIDTH};

/// The left matrix of a product, `[rows, inner]`; element `(i, k)` is `values[i * row_stride + k * inner_stride]`.
#[derive(Clone, Copy)]
pub(crate) struct Left<'a> {
    pub(crate) values: &'a [f32],
    pub(crate) rows: usize,
    pub(crate) inner: usize,
    pub(crate) row_stride: usize,
    pub(crate) inner_stride: usize,
}

/// A panel of the right matrix, `[inner, WIDTH]`; row `k` begins at `values[k * stride]`.
#[derive(Clone, Copy)]
pub(crate) struct Panel<'a> {
    pub(crate) values: &'a [f32],
    pub(crate) stride: usize,
}

/// Treatment of the values that are already in the result.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Store {
    Replace,
    Add,
    Subtract,
    /// `(1 - share) * old + share * new`
    Blend(f32),
}

/// `to[row] = start + sum over k of left[row][k] * panel[k]`, or as `store` says; the rows of `to` begin at a distance of
/// `to_stride`. The sum is in the order of `k`.
///
/// # Panics
/// If the slices are too short for their shapes.
#[inline(always)]
pub(crate) fn product<L: SimdLanes>(
    left: Left,
    panel: Panel,
    start: L,
    store: Store,
    to: &mut [f32],
    to_stride: usize,
) {
    let Left { values, rows, inner, row_stride, inner_stride } = left;
    if rows == 0 {
        return;
    }
    if inner > 0 {
        let last = (rows - 1) * row_stride + (inner - 1) * inner_stride;
        assert!(last < values.len(), "the left matrix is shorter than its shape");
        assert!((inner - 1) * panel.stride + WIDTH <= panel.values.len(), "the panel is shorter than its shape");
    }
    let mut row = 0;
    while row < rows {
        let (count, to) = (rows - row, &mut to[row * to_stride..]);
        // constants as conditions, so that no tile is compiled for an instruction set that has not the registers for it
        // SAFETY: the assertions above hold for all rows, thus for as many as are left from `row` on
        row += unsafe {
            if const { L::ROWS >= 8 } && count >= 8 {
                tile::<L, 8>(left, row, panel, start, store, to, to_stride)
            } else if const { L::ROWS >= 4 } && count >= 4 {
                tile::<L, 4>(left, row, panel, start, store, to, to_stride)
            } else if const { L::ROWS >= 3 } && count >= 3 {
                tile::<L, 3>(left, row, panel, start, store, to, to_stride)
            } else {
                tile::<L, 1>(left, row, panel, start, store, to, to_stride)
            }
        };
    }
}

/// `ROWS` rows of [`product`] from `first` on; returns `ROWS`.
///
/// # Safety
/// All elements of these rows and of the panel lie within their slices.
#[inline(always)]
unsafe fn tile<L: SimdLanes, const ROWS: usize>(
    left: Left,
    first: usize,
    panel: Panel,
    start: L,
    store: Store,
    to: &mut [f32],
    to_stride: usize,
) -> usize {
    let mut sums = [start; ROWS];
    for k in 0..left.inner {
        // SAFETY: `k` is below the number of the panel's rows, each of which has `WIDTH` columns
        let columns = unsafe { &*panel.values.as_ptr().add(k * panel.stride).cast::<[f32; WIDTH]>() };
        let columns = L::load(columns);
        for (i, sum) in sums.iter_mut().enumerate() {
            let at = (first + i) * left.row_stride + k * left.inner_stride;
            // SAFETY: element `(first + i, k)` of the left matrix
            let value = unsafe { *left.values.get_unchecked(at) };
            *sum = L::splat(value).mul_add(columns, *sum);
        }
    }
    for (i, sum) in sums.into_iter().enumerate() {
        store.put(sum, lanes_mut(to, i * to_stride));
    }
    ROWS
}

impl Store {
    #[inline(always)]
    pub(crate) fn put<L: SimdLanes>(self, new: L, to: &mut [f32; WIDTH]) {
        match self {
            Self::Replace => new.store(to),
            Self::Add => L::load(to).add(new).store(to),
            Self::Subtract => L::load(to).sub(new).store(to),
            Self::Blend(share) => {
                let old = L::load(to);
                new.sub(old).mul_add(L::splat(share), old).store(to);
            }
        }
    }
}

/// The [`WIDTH`] values from `at` on.
#[inline(always)]
pub(crate) fn lanes(values: &[f32], at: usize) -> &[f32; WIDTH] {
    &values[at..at + WIDTH].as_chunks::<WIDTH>().0[0]
}

#[inline(always)]
pub(crate) fn lanes_mut(values: &mut [f32], at: usize) -> &mut [f32; WIDTH] {
    &mut values[at..at + WIDTH].as_chunks_mut::<WIDTH>().0[0]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::kernels::{InstructionSet, SimdKernel};

    struct MultiplyPanel<'a> {
        left: Left<'a>,
        panel: Panel<'a>,
        result: &'a mut [f32],
    }

    impl SimdKernel for MultiplyPanel<'_> {
        type Output = ();

        #[inline(always)]
        fn run<L: SimdLanes>(self) {
            product::<L>(self.left, self.panel, L::splat(1.0), Store::Replace, self.result, WIDTH);
        }
    }

    #[test]
    fn products_of_plain_and_transposed_matrices_agree_with_the_definition() {
        // integers below 2^24: exact in any order of summation
        let sequence = |count: usize, factor: usize| (0..count).map(|i| ((i * factor) % 13) as f32).collect::<Vec<_>>();
        for (rows, inner) in [(0, 3), (1, 1), (3, 4), (17, 5), (8, 128), (39, 33), (5, 0)] {
            let (a, b) = (sequence(rows * inner, 7), sequence(inner * 40, 5));
            let transposed: Vec<f32> =
                (0..inner).flat_map(|k| (0..rows).map(move |i| (i, k))).map(|(i, k)| a[i * inner + k]).collect();
            for simd in InstructionSet::available() {
                for (values, row_stride, inner_stride) in [(&a, inner, 1), (&transposed, 1, rows)] {
                    let mut result = vec![f32::NAN; rows * WIDTH];
                    let left = Left { values, rows, inner, row_stride, inner_stride };
                    simd.run(MultiplyPanel { left, panel: Panel { values: &b, stride: 40 }, result: &mut result });
                    for (index, found) in result.iter().enumerate() {
                        let (row, column) = (index / WIDTH, index % WIDTH);
                        let sum: f32 = (0..inner).map(|k| a[row * inner + k] * b[k * 40 + column]).sum();
                        assert_eq!(*found, 1.0 + sum, "{simd:?} {rows} {inner} at {row} {column}");
                    }
                }
            }
        }
    }

    #[test]
    #[should_panic(expected = "shorter than its shape")]
    fn a_left_matrix_that_is_too_short_is_refused() {
        let left = Left { values: &[0.0; 11], rows: 3, inner: 4, row_stride: 4, inner_stride: 1 };
        let panel = Panel { values: &[0.0; 4 * WIDTH], stride: WIDTH };
        InstructionSet::detect().run(MultiplyPanel { left, panel, result: &mut [0.0; 3 * WIDTH] });
    }
}
