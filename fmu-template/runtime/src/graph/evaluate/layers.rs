//! Layers laid out for fast products with a vector.

use crate::simd::{Lanes, Real, flat, flat_mut, flush, fma};
use crate::{
    Numbers,
    numbers::activation::{Kernel, activate},
};

/// `W x + b` with the rows of `W` padded to whole blocks of lanes.
///
/// `weights[(number * inputs + column) * block + lane]`: a product reads them from first to last.
#[derive(Clone, Debug)]
pub(crate) struct Dense<T, const WIDTH: usize> {
    inputs: usize,
    /// Lanes of a block: [`NARROW`] or [`WIDE`].
    block: usize,
    weights: Vec<Lanes<T, WIDTH>>,
    bias: Vec<Lanes<T, WIDTH>>,
}

/// `W x + b` row by row, with the columns of `W` padded to whole lanes: for the last layer, which has few rows.
///
/// `weights[row * lanes + lane]`
#[derive(Clone, Debug)]
pub(crate) struct DenseRows<T, const WIDTH: usize> {
    inputs: usize,
    lanes: usize,
    weights: Vec<Lanes<T, WIDTH>>,
    bias: Vec<T>,
}

/// Lanes of rows computed at a time: few, so that a block of weights is small beside the first cache.
const NARROW: usize = 2;
/// Lanes of rows computed at a time if that adds no padding: each input that is read then serves more products.
const WIDE: usize = 4;

/// From which end the blocks of a layer are computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Order {
    Forward,
    Backward,
}

impl Order {
    pub(crate) fn reverse(&mut self) {
        *self = if *self == Self::Forward { Self::Backward } else { Self::Forward };
    }
}

impl<T: Real, const WIDTH: usize> Dense<T, WIDTH> {
    /// `weight` row by row.
    pub(crate) fn new(inputs: usize, weight: &Numbers, bias: &Numbers) -> Self {
        let lanes = bias.len().div_ceil(WIDTH).next_multiple_of(NARROW);
        let block = if lanes.is_multiple_of(WIDE) { WIDE } else { NARROW };
        let rows_per_block = block * WIDTH;
        let (mut weights, mut padded) = (vec![Lanes::ZERO; lanes * inputs], vec![Lanes::ZERO; lanes]);
        flat_mut(&mut padded).iter_mut().zip(bias.iter()).for_each(|(to, from)| *to = flush(T::narrow(from)));
        let mut numbers = weight.iter();
        for row in 0..bias.len() {
            let (number, within) = (row / rows_per_block, row % rows_per_block);
            let first = number * inputs * block + within / WIDTH;
            let of_row = flat_mut(&mut weights)[first * WIDTH + within % WIDTH..].iter_mut().step_by(block * WIDTH);
            of_row.zip(numbers.by_ref().take(inputs)).for_each(|(to, from)| *to = flush(T::narrow(from)));
        }
        Self { inputs, block, weights, bias: padded }
    }

    /// Number of lanes of the result.
    pub(crate) fn lanes(&self) -> usize {
        self.bias.len()
    }

    /// The activation of `W x + b`, or of `W x` without the bias. It is computed block by block: the processor does so while
    /// it begins with the products of the next one.
    ///
    /// `order` is that of the blocks; the result is the same. A layer larger than the first cache is read faster if it
    /// is read from the end where the last reading stopped.
    #[inline(always)]
    pub(crate) fn apply<const SIMD: u8>(
        &self,
        input: &[Lanes<T, WIDTH>],
        output: &mut [Lanes<T, WIDTH>],
        has_bias: bool,
        order: Order,
        kernel: Kernel,
    ) {
        match self.block {
            WIDE => self.apply_wide::<SIMD>(input, output, has_bias, order, kernel),
            _ => self.apply_narrow::<SIMD>(input, output, has_bias, order, kernel),
        }
    }

    /// [`WIDE`] lanes and two columns at a time, each column with separate accumulators: enough to hide the latency of
    /// a multiply-add.
    #[inline(always)]
    fn apply_wide<const SIMD: u8>(
        &self,
        input: &[Lanes<T, WIDTH>],
        output: &mut [Lanes<T, WIDTH>],
        has_bias: bool,
        order: Order,
        kernel: Kernel,
    ) {
        let input = &flat(input)[..self.inputs];
        let weights = self.weights.as_chunks::<WIDE>().0;
        let bias = self.bias.as_chunks::<WIDE>().0;
        let output = &mut output.as_chunks_mut::<WIDE>().0[..bias.len()];
        for step in 0..bias.len() {
            let block = if order == Order::Forward { step } else { bias.len() - 1 - step };
            let columns = &weights[block * self.inputs..][..self.inputs];
            // arrays of accumulators would be too large for the compiler to keep them in registers
            let [mut a0, mut a1, mut a2, mut a3] = if has_bias { bias[block] } else { [Lanes::ZERO; WIDE] };
            let [mut b0, mut b1, mut b2, mut b3] = [Lanes::ZERO; WIDE];
            let (pairs, rest) = input.as_chunks::<2>();
            let (weight_pairs, weight_rest) = columns.as_chunks::<2>();
            for (x, w) in pairs.iter().zip(weight_pairs) {
                for (sum, w) in [&mut a0, &mut a1, &mut a2, &mut a3].into_iter().zip(&w[0]) {
                    T::add_scaled::<SIMD, WIDTH>(sum, w, x[0]);
                }
                for (sum, w) in [&mut b0, &mut b1, &mut b2, &mut b3].into_iter().zip(&w[1]) {
                    T::add_scaled::<SIMD, WIDTH>(sum, w, x[1]);
                }
            }
            for (x, w) in rest.iter().zip(weight_rest) {
                for (sum, w) in [&mut a0, &mut a1, &mut a2, &mut a3].into_iter().zip(w) {
                    T::add_scaled::<SIMD, WIDTH>(sum, w, *x);
                }
            }
            for (sum, other) in [&mut a0, &mut a1, &mut a2, &mut a3].into_iter().zip([b0, b1, b2, b3]) {
                T::add_scaled::<SIMD, WIDTH>(sum, &other, T::ONE);
            }
            output[block] = [a0, a1, a2, a3];
            activate::<T, SIMD, WIDTH>(kernel, &mut output[block]);
        }
    }

    /// [`NARROW`] lanes and four columns at a time, each column with separate accumulators.
    #[inline(always)]
    fn apply_narrow<const SIMD: u8>(
        &self,
        input: &[Lanes<T, WIDTH>],
        output: &mut [Lanes<T, WIDTH>],
        has_bias: bool,
        order: Order,
        kernel: Kernel,
    ) {
        let input = &flat(input)[..self.inputs];
        let weights = self.weights.as_chunks::<NARROW>().0;
        let bias = self.bias.as_chunks::<NARROW>().0;
        let output = &mut output.as_chunks_mut::<NARROW>().0[..bias.len()];
        for step in 0..bias.len() {
            let block = if order == Order::Forward { step } else { bias.len() - 1 - step };
            let columns = &weights[block * self.inputs..][..self.inputs];
            let mut a = if has_bias { bias[block] } else { [Lanes::ZERO; NARROW] };
            let [mut b, mut c, mut d] = [[Lanes::ZERO; NARROW]; 3];
            let (groups, rest) = input.as_chunks::<4>();
            let (weight_groups, weight_rest) = columns.as_chunks::<4>();
            for (x, w) in groups.iter().zip(weight_groups) {
                accumulate::<T, SIMD, WIDTH>(&mut a, &w[0], x[0]);
                accumulate::<T, SIMD, WIDTH>(&mut b, &w[1], x[1]);
                accumulate::<T, SIMD, WIDTH>(&mut c, &w[2], x[2]);
                accumulate::<T, SIMD, WIDTH>(&mut d, &w[3], x[3]);
            }
            for (x, w) in rest.iter().zip(weight_rest) {
                accumulate::<T, SIMD, WIDTH>(&mut a, w, *x);
            }
            accumulate::<T, SIMD, WIDTH>(&mut a, &b, T::ONE);
            accumulate::<T, SIMD, WIDTH>(&mut c, &d, T::ONE);
            accumulate::<T, SIMD, WIDTH>(&mut a, &c, T::ONE);
            output[block] = a;
            activate::<T, SIMD, WIDTH>(kernel, &mut output[block]);
        }
    }

    /// Adds `W^T y`, `y` padded with anything that is finite.
    #[inline(always)]
    pub(crate) fn apply_transposed<const SIMD: u8>(&self, input: &[Lanes<T, WIDTH>], output: &mut [Lanes<T, WIDTH>]) {
        let output = &mut flat_mut(output)[..self.inputs];
        let blocks = self.weights.chunks_exact(self.inputs * self.block);
        for (y, weights) in input.chunks_exact(self.block).zip(blocks) {
            for (x, column) in output.iter_mut().zip(weights.chunks_exact(self.block)) {
                *x = *x + dot::<T, SIMD, WIDTH>(y, column);
            }
        }
    }
}

impl<T: Real, const WIDTH: usize> DenseRows<T, WIDTH> {
    /// `weight` row by row.
    pub(crate) fn new(inputs: usize, weight: &Numbers, bias: &Numbers) -> Self {
        let lanes = inputs.div_ceil(WIDTH);
        let mut weights = vec![Lanes::ZERO; lanes * bias.len()];
        let mut numbers = weight.iter();
        for row in flat_mut(&mut weights).chunks_exact_mut(lanes * WIDTH) {
            row.iter_mut().zip(numbers.by_ref().take(inputs)).for_each(|(to, from)| *to = flush(T::narrow(from)));
        }
        let bias = bias.iter().map(|bias| flush(T::narrow(bias))).collect();
        Self { inputs, lanes, weights, bias }
    }

    pub(crate) fn outputs(&self) -> usize {
        self.bias.len()
    }

    /// `W x + b`, or `W x` without the bias; `sums` is working memory of a lane a row.
    #[inline(always)]
    pub(crate) fn apply<const SIMD: u8>(
        &self,
        input: &mut [Lanes<T, WIDTH>],
        output: &mut [T],
        has_bias: bool,
        sums: &mut [Lanes<T, WIDTH>],
    ) {
        let input = &mut input[..self.lanes];
        // what an earlier evaluation left behind the last column may be NaN, which no weight of zero takes away
        flat_mut(input)[self.inputs..].fill(T::ZERO);
        // in two loops: in one, the compiler would take the vectors apart before they are complete
        for (sum, row) in sums.iter_mut().zip(self.weights.chunks_exact(self.lanes)) {
            *sum = products::<T, SIMD, WIDTH>(input, row);
        }
        for ((y, &bias), sum) in output.iter_mut().zip(&self.bias).zip(sums) {
            let product = total(sum);
            *y = if has_bias { bias + product } else { product };
        }
    }

    /// Adds `W^T y`.
    #[inline(always)]
    pub(crate) fn apply_transposed<const SIMD: u8>(
        &self,
        input: impl Iterator<Item = T>,
        output: &mut [Lanes<T, WIDTH>],
    ) {
        for (y, row) in input.zip(self.weights.chunks_exact(self.lanes)) {
            for (x, w) in output.iter_mut().zip(row) {
                for (x, w) in x.0.iter_mut().zip(&w.0) {
                    *x = fma::<T, SIMD>(*w, y, *x);
                }
            }
        }
    }
}

/// `sum + column * x`
#[inline(always)]
fn accumulate<T: Real, const SIMD: u8, const WIDTH: usize>(
    sum: &mut [Lanes<T, WIDTH>; NARROW],
    column: &[Lanes<T, WIDTH>; NARROW],
    x: T,
) {
    for (sum, column) in sum.iter_mut().zip(column) {
        T::add_scaled::<SIMD, WIDTH>(sum, column, x);
    }
}

#[inline(always)]
fn dot<T: Real, const SIMD: u8, const WIDTH: usize>(a: &[Lanes<T, WIDTH>], b: &[Lanes<T, WIDTH>]) -> T {
    total(&products::<T, SIMD, WIDTH>(a, b))
}

/// The products lane by lane, added up over all vectors.
#[inline(always)]
fn products<T: Real, const SIMD: u8, const WIDTH: usize>(
    a: &[Lanes<T, WIDTH>],
    b: &[Lanes<T, WIDTH>],
) -> Lanes<T, WIDTH> {
    let (mut even, mut odd) = (Lanes::ZERO, Lanes::ZERO);
    let ((a_pairs, a_rest), (b_pairs, b_rest)) = (a.as_chunks::<2>(), b.as_chunks::<2>());
    for (a, b) in a_pairs.iter().zip(b_pairs) {
        T::add_products::<SIMD, WIDTH>(&mut even, &a[0], &b[0]);
        T::add_products::<SIMD, WIDTH>(&mut odd, &a[1], &b[1]);
    }
    for (a, b) in a_rest.iter().zip(b_rest) {
        T::add_products::<SIMD, WIDTH>(&mut even, a, b);
    }
    Lanes(std::array::from_fn(|lane| even.0[lane] + odd.0[lane]))
}

/// The sum of the lanes, by halves: one lane after the other would wait for each addition.
#[inline(always)]
fn total<T: Real, const WIDTH: usize>(lanes: &Lanes<T, WIDTH>) -> T {
    let mut sum = lanes.0;
    let mut width = WIDTH;
    while width > 1 {
        width /= 2;
        let (low, high) = sum.split_at_mut(width);
        low.iter_mut().zip(high).for_each(|(low, high)| *low = *low + *high);
    }
    sum[0]
}
