//! Predicted standard deviation of a Gaussian process, in steps that other models have as well.

use super::{Elementwise, Graph, Operation, Step};

/// Predicted standard deviation of a further observation of a Gaussian process, from its kernels `k` around the `n` centres:
///
/// ```text
/// std = scale sqrt(max(least, noise + 1 - |W k|² + (trend_0 - sum_c trend_c k_c)²))
/// ```
///
/// With the covariance `C` of the centres relative to `scale²`, noise included, `W` is the inverse of its Cholesky factor, so that `|W k|² = k^T C^-1 k`.
/// The trend is that of the constant mean, `trend_0 = 1 / sqrt(1^T C^-1 1)` and `trend_c = (C^-1 1)_c trend_0`.
#[derive(Clone, Debug, PartialEq)]
pub struct ProcessDeviation {
    /// Rows of `W`, each up to the diagonal: `n (n + 1) / 2` numbers.
    pub whitening: Vec<f64>,
    /// `trend_c`: shape `[n]`.
    pub trend: Vec<f64>,
    /// `trend_0`
    pub trend_origin: f64,
    /// Variance of the noise relative to `scale²`.
    pub noise: f64,
    /// Smallest variance that rounding leaves meaningful, relative to `scale²`, positive.
    pub least: f64,
    /// Standard deviation of the process.
    pub scale: f64,
}

/// Blocks of rows of a triangular matrix at most, and fewest rows in each: half of a square of zeros at the diagonal of each is multiplied as well.
const BLOCKS: usize = 16;
const BLOCK_ROWS: usize = 32;

impl Graph {
    /// The standard deviation, times `scale`, as one number; `kernels`: number of the value that has those of all centres.
    pub(super) fn add_deviation(&mut self, kernels: usize, deviation: &ProcessDeviation, scale: f64) -> usize {
        let ProcessDeviation { whitening, trend, trend_origin, noise, least, scale: of_process } = deviation;
        let whitened = self.add_triangular(kernels, whitening, trend.len());
        let squares = self.add_square(whitened);
        let minus = vec![-1.0; trend.len()];
        let explained = self.add(Step::Affine { of: squares, weight: minus.into(), bias: vec![1.0].into() });
        let minus_trend: Vec<f64> = trend.iter().map(|weight| -weight).collect();
        let bias = vec![*trend_origin].into();
        let of_mean = self.add(Step::Affine { of: kernels, weight: minus_trend.into(), bias });
        let of_mean = self.add_square(of_mean);
        let of_rest = self.add_elementwise(of_mean, Elementwise::Linear, vec![1.0, *noise]);
        let variance = self.add(Step::Combine { of: [explained, of_rest], operation: Operation::Add });
        let variance = self.add_elementwise(variance, Elementwise::Clip, vec![*least, f64::MAX]);
        let root = self.add_elementwise(variance, Elementwise::Power, vec![0.5]);
        self.add_elementwise(root, Elementwise::Linear, vec![of_process * scale, 0.0])
    }

    /// Product of a lower triangular matrix, row by row up to the diagonal, and a value. Blocks of rows leave out the columns that are zero in all
    /// of them.
    fn add_triangular(&mut self, of: usize, rows: &[f64], count: usize) -> usize {
        let size = count.div_ceil(BLOCKS).max(BLOCK_ROWS).min(count);
        let mut columns = Vec::with_capacity(count);
        for first in (0..count).step_by(size) {
            let end = (first + size).min(count);
            let begun = self.add_first(of, end, count);
            let weight: Vec<f64> = (first..end)
                .flat_map(|row| {
                    let zeros = std::iter::repeat_n(0.0, end - row - 1);
                    rows[row * (row + 1) / 2..][..=row].iter().copied().chain(zeros)
                })
                .collect();
            let bias = vec![0.0; end - first].into();
            let made = self.add(Step::Affine { of: begun, weight: weight.into(), bias }) as u32;
            columns.extend((0..end - first).map(|row| [made, row as u32]));
        }
        if size == count { self.steps.len() } else { self.add(Step::Columns { columns }) }
    }

    /// The first numbers of a value of `width` numbers.
    fn add_first(&mut self, of: usize, count: usize, width: usize) -> usize {
        if count == width {
            return of;
        }
        self.add(Step::Columns { columns: (0..count).map(|column| [of as u32, column as u32]).collect() })
    }

    fn add_square(&mut self, of: usize) -> usize {
        self.add(Step::Combine { of: [of, of], operation: Operation::Multiply })
    }

    fn add_elementwise(&mut self, of: usize, function: Elementwise, parameters: Vec<f64>) -> usize {
        self.add(Step::Elementwise { of, function, parameters })
    }
}
