//! Networks with one hidden layer whose weights are drawn at random, and whose last layer is the solution of a linear least-squares
//! problem in double precision.
//!
//! ```text
//! y_f(x) = sum over nodes k of c_fk tanh(w_k x + b_k) + d_f
//! w_ki uniform in [-scale_i, scale_i] for the columns i that function f depends on, otherwise 0;  b_k uniform in [-1, 1]
//! ```
//!
//! The coefficients fit values and derivatives together. For smooth functions of a few columns this is far more exact
//! than a network whose weights are all trained. Gradient methods, even preconditioned ones, stall where the
//! ill-conditioned problem has most of its error left. The method is known as an extreme learning machine (Huang, Zhu,
//! Siew 2006, doi:10.1016/j.neucom.2005.12.126). Held-out samples determine the steepness and the number of the nodes.

use metafmu_runtime::{Activation, Layer};
use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, Ordering};

/// Standardized samples of functions, with derivatives along some directions.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FunctionSamples {
    /// Number of directions.
    pub directions: usize,
    /// Columns of each sample, then their derivatives along each direction: shape `[samples, 1 + directions, columns]`.
    pub inputs: Vec<f64>,
    /// Functions of each sample, then their derivatives along each direction: shape
    /// `[samples, 1 + directions, functions]`.
    pub outputs: Vec<f64>,
}

/// A function, or several that depend on the same columns.
struct FunctionGroup {
    outputs: Vec<usize>,
    columns: Vec<usize>,
}

impl FunctionGroup {
    /// Its columns and its functions in the first parts of each sample, whose rows have these widths.
    fn rows(&self, samples: &FunctionSamples, widths: [usize; 2], parts: usize) -> [Vec<f64>; 2] {
        let of_inputs = samples.inputs.chunks(widths[0] * (1 + samples.directions));
        let of_inputs = of_inputs.flat_map(|sample| sample.chunks(widths[0]).take(parts));
        let of_outputs = samples.outputs.chunks(widths[1] * (1 + samples.directions));
        let of_outputs = of_outputs.flat_map(|sample| sample.chunks(widths[1]).take(parts));
        [
            of_inputs.flat_map(|row| self.columns.iter().map(|column| row[*column])).collect(),
            of_outputs.flat_map(|row| self.outputs.iter().map(|output| row[*output])).collect(),
        ]
    }
}

/// Nodes of one group, and their coefficients in each of its outputs: shape `[outputs, nodes + 1]`, the last one being
/// the constant.
struct RandomFeatures {
    /// `[nodes, columns]`
    weights: Vec<f64>,
    bias: Vec<f64>,
    coefficients: Vec<DVector<f64>>,
    /// Root mean square error of the worst output in the held-out samples.
    error: f64,
}

/// Half the ranges of weights that are tried with the fewest nodes. With more nodes, steeper ones pay. The least steep
/// ones are nearly polynomials.
const SCALES: [f64; 9] = [0.0125, 0.025, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2];
/// Numbers of nodes that are tried, and factors by which the previous best scales change from the second number on.
const NODES: [usize; 10] = [32, 64, 96, 128, 192, 256, 384, 512, 768, 1024];
const STEEPER: [f64; 3] = [0.5, 1.0, 2.0];
/// Changes of the scale of a single column, for at most [`FEW_NODES`] nodes. A function may depend on each column
/// differently, as on an angle and on a stiffness that is a factor, and then needs other weights. The scales found hold
/// with more nodes, where a solution takes longer.
const OF_ONE_COLUMN: [f64; 3] = [0.25, 0.5, 2.0];
const FEW_NODES: usize = 256;
/// Minimum numbers of rows and of samples for each node.
const ROWS: usize = 4;
const SAMPLES: usize = 2;
/// Error, of standardized outputs, at which more nodes cost more than they are worth.
const ENOUGH: f64 = 1e-8;
/// Term added to the diagonal of the normal equations, relative to its largest element: nodes are nearly dependent.
const RIDGE: f64 = 1e-14;
/// Normal equations alone have half the digits of the problem; those of what the first factors make of it have the others.
const FACTORS: usize = 2;
/// Number of solutions, each for the residual of those before: they remove most of the ridge's effect.
const SOLUTIONS: usize = 3;
/// Parts of the samples that are summed separately, whatever the number of threads.
const PARTS: usize = 8;
/// Samples of which the nodes are computed together, and columns that are divided by factors together.
const BLOCK: usize = 128;
const COLUMNS: usize = 64;

/// The layers of a network for standardized samples, and its root mean square error, of the worst output, in the
/// held-out samples. `depends[output][column]` says which columns change an output; if none does, all are used. `known`
/// marks the outputs whose derivatives are known. None if no coefficients can be found, or `stop` turned true.
///
/// # Panics
/// If the samples have no rows or other shapes.
pub fn solve(
    seen: &FunctionSamples,
    held_out: &FunctionSamples,
    depends: &[Vec<bool>],
    known: &[bool],
    seed: u64,
    stop: &AtomicBool,
) -> Option<(Vec<Layer>, f64)> {
    let (columns, outputs) = (depends[0].len(), depends.len());
    let mut groups: Vec<FunctionGroup> = Vec::new();
    for (output, depends) in depends.iter().enumerate() {
        let columns: Vec<usize> = (0..columns).filter(|column| depends[*column] || !depends.contains(&true)).collect();
        let mut same =
            groups.iter_mut().filter(|group| group.columns == columns && known[group.outputs[0]] == known[output]);
        match same.next() {
            Some(group) => group.outputs.push(output),
            None => groups.push(FunctionGroup { outputs: vec![output], columns }),
        }
    }
    let problems = groups.iter().map(|group| GroupRegression::new(group, [seen, held_out], [columns, outputs], known));
    let solved: Vec<RandomFeatures> = problems.map(|problem| problem.solve(seed, stop)).collect::<Option<_>>()?;
    let nodes: usize = solved.iter().map(|nodes| nodes.bias.len()).sum();
    let (mut weights, mut bias) = (vec![0.0; nodes * columns], Vec::<f64>::with_capacity(nodes));
    let (mut last, mut constant) = (vec![0.0; outputs * nodes], vec![0.0; outputs]);
    for (group, own) in groups.iter().zip(&solved) {
        let first = bias.len();
        for (k, row) in own.weights.chunks(group.columns.len()).enumerate() {
            let to = &mut weights[(first + k) * columns..][..columns];
            group.columns.iter().zip(row).for_each(|(column, weight)| to[*column] = *weight);
        }
        bias.extend(&own.bias);
        for (&output, coefficients) in group.outputs.iter().zip(&own.coefficients) {
            let (of_nodes, of_constant) = coefficients.as_slice().split_at(own.bias.len());
            last[output * nodes + first..][..of_nodes.len()].copy_from_slice(of_nodes);
            constant[output] = of_constant[0];
        }
    }
    let of_nodes = Layer {
        inputs: columns,
        outputs: nodes,
        weight: weights.into(),
        bias: bias.into(),
        activation: Activation::Tanh,
    };
    let of_outputs =
        Layer { inputs: nodes, outputs, weight: last.into(), bias: constant.into(), activation: Activation::Identity };
    Some((vec![of_nodes, of_outputs], solved.iter().map(|nodes| nodes.error).fold(0.0, f64::max)))
}

/// Least-squares problem of a group of functions. Its rows are values and, if known, derivatives in the columns of the group.
struct GroupRegression {
    columns: usize,
    outputs: usize,
    /// Rows of a sample, the first of which are values.
    parts: usize,
    seen: [Vec<f64>; 2],
    held_out: [Vec<f64>; 2],
}

impl GroupRegression {
    fn new(group: &FunctionGroup, [seen, held_out]: [&FunctionSamples; 2], widths: [usize; 2], known: &[bool]) -> Self {
        let parts = if known[group.outputs[0]] { 1 + seen.directions } else { 1 };
        Self {
            columns: group.columns.len(),
            outputs: group.outputs.len(),
            parts,
            seen: group.rows(seen, widths, parts),
            held_out: group.rows(held_out, widths, 1),
        }
    }

    fn solve(&self, seed: u64, stop: &AtomicBool) -> Option<RandomFeatures> {
        let mut best: Option<(Vec<f64>, RandomFeatures)> = None;
        for count in NODES {
            let attempt = |scales: Vec<f64>, best: &mut Option<(Vec<f64>, RandomFeatures)>| -> Option<()> {
                let found = self.with_nodes(count, &scales, seed, stop);
                if let Some(found) = found
                    && best.as_ref().is_none_or(|(_, best)| found.error < best.error)
                {
                    *best = Some((scales, found));
                }
                (!stop.load(Ordering::Relaxed)).then_some(())
            };
            let all = match &best {
                None => SCALES.map(|scale| vec![scale; self.columns]).to_vec(),
                Some((scales, _)) => STEEPER.map(|by| scales.iter().map(|scale| by * scale).collect()).to_vec(),
            };
            for scales in all {
                attempt(scales, &mut best)?;
            }
            for column in (0..self.columns).filter(|_| self.columns > 1 && count <= FEW_NODES) {
                let scales = best.as_ref()?.0.clone();
                for by in OF_ONE_COLUMN {
                    let mut scales = scales.clone();
                    scales[column] *= by;
                    attempt(scales, &mut best)?;
                }
            }
            if best.as_ref()?.1.error <= ENOUGH {
                break;
            }
        }
        best.map(|(_, nodes)| nodes)
    }

    /// None if no finite coefficients were found, or `stop` turned true.
    fn with_nodes(&self, count: usize, scales: &[f64], seed: u64, stop: &AtomicBool) -> Option<RandomFeatures> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut nodes =
            RandomFeatures { weights: Vec::new(), bias: Vec::new(), coefficients: Vec::new(), error: f64::INFINITY };
        for _ in 0..count {
            let mut uniform = |limit: f64| limit * (2.0 * random.random::<f64>() - 1.0);
            nodes.weights.extend(scales.iter().map(|scale| uniform(*scale)));
            nodes.bias.push(uniform(1.0));
        }
        let samples = count * (ROWS.div_ceil(self.parts)).max(SAMPLES);
        let mut seen = self.blocks(&nodes, &self.seen, samples, self.parts);
        let mut factors = Vec::new();
        for _ in 0..FACTORS {
            let mut normal = sum(&seen, (count + 1, count + 1), |block| block.nodes.transpose() * &block.nodes);
            let ridge = RIDGE * normal.diagonal().amax();
            (0..=count).for_each(|k| normal[(k, k)] += ridge);
            let factor = normal.cholesky()?.unpack().transpose();
            if stop.load(Ordering::Relaxed) {
                return None;
            }
            seen.par_iter_mut().for_each(|block| divide(&mut block.nodes, &factor));
            factors.push(factor);
        }
        let shape = (count + 1, self.outputs);
        let mut coefficients = DMatrix::zeros(count + 1, self.outputs);
        for _ in 0..SOLUTIONS {
            coefficients +=
                sum(&seen, shape, |block| block.nodes.tr_mul(&(&block.outputs - &block.nodes * &coefficients)));
        }
        for factor in factors.iter().rev() {
            coefficients = factor.solve_upper_triangular(&coefficients)?;
        }
        let held_out = self.blocks(&nodes, &self.held_out, usize::MAX, 1);
        let squares = sum(&held_out, (1, self.outputs), |block| {
            let squares = (&block.outputs - &block.nodes * &coefficients).map(|error| error * error);
            DMatrix::from_row_slice(1, self.outputs, squares.row_sum().as_slice())
        });
        let rows: usize = held_out.iter().map(|block| block.outputs.nrows()).sum();
        nodes.coefficients = coefficients.column_iter().map(Into::into).collect();
        nodes.error = (squares.max() / rows as f64).sqrt();
        nodes.error.is_finite().then_some(nodes)
    }

    /// The first samples, block by block; rows are those of inputs and outputs, with this number of parts a sample.
    fn blocks(&self, nodes: &RandomFeatures, rows: &[Vec<f64>; 2], samples: usize, parts: usize) -> Vec<RowBlock> {
        let [inputs, outputs] = rows;
        let rows = samples.min(outputs.len() / self.outputs / parts) * parts;
        let inputs = inputs[..rows * self.columns].par_chunks(BLOCK * parts * self.columns);
        let outputs = outputs[..rows * self.outputs].par_chunks(BLOCK * parts * self.outputs);
        let blocks = inputs.zip(outputs).map(|(inputs, outputs)| RowBlock {
            nodes: nodes.values(inputs, self.columns, parts),
            outputs: DMatrix::from_row_slice(outputs.len() / self.outputs, self.outputs, outputs),
        });
        blocks.collect()
    }
}

/// Some rows, which are values and derivatives.
struct RowBlock {
    /// Values of the nodes and of the constant: shape `[rows, nodes + 1]`.
    nodes: DMatrix<f64>,
    /// Shape `[rows, outputs]`.
    outputs: DMatrix<f64>,
}

/// The sum, over blocks, of what `of` makes of them, a matrix of this shape: the same for any number of threads.
fn sum(
    blocks: &[RowBlock],
    (height, width): (usize, usize),
    of: impl Fn(&RowBlock) -> DMatrix<f64> + Sync,
) -> DMatrix<f64> {
    let sums = (0..PARTS).into_par_iter().map(|part| {
        let blocks = &blocks[part * blocks.len() / PARTS..(part + 1) * blocks.len() / PARTS];
        blocks.iter().map(&of).fold(DMatrix::zeros(height, width), |sum, more| sum + more)
    });
    let sums: Vec<DMatrix<f64>> = sums.collect();
    sums.into_iter().fold(DMatrix::zeros(height, width), |sum, part| sum + part)
}

/// Replaces `A` with `A R^-1`, for an upper triangle `R`.
fn divide(a: &mut DMatrix<f64>, r: &DMatrix<f64>) {
    let columns = r.ncols();
    for first in (0..columns).step_by(COLUMNS) {
        let end = (first + COLUMNS).min(columns);
        let (before, mut own) = a.columns_range_pair_mut(0..first, first..end);
        own.gemm(-1.0, &before, &r.view((0, first), (first, end - first)), 1.0);
        for k in first..end {
            for j in first..k {
                let (known, mut column) = own.columns_range_pair_mut(j - first, k - first);
                column.axpy(-r[(j, k)], &known, 1.0);
            }
            own.column_mut(k - first).scale_mut(r[(k, k)].recip());
        }
    }
}

impl RandomFeatures {
    /// Values of each node and of the constant at rows of columns, sample by sample. The first row of a sample has
    /// values, the others derivatives.
    fn values(&self, inputs: &[f64], columns: usize, parts: usize) -> DMatrix<f64> {
        let count = self.bias.len();
        let mut values = DMatrix::zeros(inputs.len() / columns, count + 1);
        for (sample, inputs) in inputs.chunks(columns * parts).enumerate() {
            let first = sample * parts;
            for (k, (weights, bias)) in self.weights.chunks(columns).zip(&self.bias).enumerate() {
                let mut slope = 1.0;
                for (part, row) in inputs.chunks(columns).enumerate() {
                    let product: f64 = weights.iter().zip(row).map(|(weight, x)| weight * x).sum();
                    values[(first + part, k)] = if part == 0 {
                        let value = (product + bias).tanh();
                        slope = 1.0 - value * value;
                        value
                    } else {
                        slope * product
                    };
                }
            }
            values[(first, count)] = 1.0;
        }
        values
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `sin(2 a) b`, its derivative along `a` known, and `c²`, at random points.
    fn samples(count: usize, seed: u64) -> FunctionSamples {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut samples = FunctionSamples { directions: 1, ..FunctionSamples::default() };
        for _ in 0..count {
            let [a, b, c]: [f64; 3] = std::array::from_fn(|_| 3.0 * random.random::<f64>() - 1.5);
            samples.inputs.extend([a, b, c, 1.0, 0.0, 0.0]);
            // what is not known must not matter
            samples.outputs.extend([(2.0 * a).sin() * b, c * c, 2.0 * (2.0 * a).cos() * b, 1e3]);
        }
        samples
    }

    const DEPENDS: [[bool; 3]; 2] = [[true, true, false], [false, false, true]];

    fn solved(seed: u64) -> (Vec<Layer>, f64) {
        let depends = DEPENDS.map(|depends| depends.to_vec());
        solve(&samples(3000, 1), &samples(300, 2), &depends, &[true, false], seed, &AtomicBool::new(false)).unwrap()
    }

    #[test]
    fn smooth_functions_are_found_to_eight_digits_also_where_nothing_was_sampled() {
        let (layers, error) = solved(7);
        assert!(error < 2e-8, "{error}");
        let [hidden, last] = layers.as_slice() else { panic!("{}", layers.len()) };
        let (weights, bias): (Vec<f64>, Vec<f64>) = (hidden.weight.iter().collect(), hidden.bias.iter().collect());
        let (of_last, constant): (Vec<f64>, Vec<f64>) = (last.weight.iter().collect(), last.bias.iter().collect());
        let unseen = samples(200, 3);
        for (x, y) in unseen.inputs.chunks(6).zip(unseen.outputs.chunks(4)) {
            let node = |(row, bias): (&[f64], &f64)| {
                (row.iter().zip(x).map(|(weight, x)| weight * x).sum::<f64>() + bias).tanh()
            };
            let nodes: Vec<f64> = weights.chunks(3).zip(&bias).map(node).collect();
            for output in 0..2 {
                let own = &of_last[output * nodes.len()..][..nodes.len()];
                let found = own.iter().zip(&nodes).map(|(c, node)| c * node).sum::<f64>() + constant[output];
                assert!((found - y[output]).abs() < 3e-7, "{output}: {found} {}", y[output]);
            }
        }
        // a function has nothing of the columns that do not change it
        for (k, row) in weights.chunks(3).enumerate() {
            for (output, depends) in DEPENDS.iter().enumerate() {
                let is_used = of_last[output * bias.len() + k] != 0.0;
                assert!(!is_used || (0..3).all(|column| depends[column] || row[column] == 0.0), "node {k}");
            }
        }
    }

    /// `k f(a) + sin a`, with `f` the square of an angle in a linkage, of the columns sin a, cos a, k.
    #[test]
    fn each_column_has_the_weights_that_it_wants() {
        let linkage = |count: usize, seed: u64| {
            let mut random = ChaCha8Rng::seed_from_u64(seed);
            let mut samples = FunctionSamples::default();
            for _ in 0..count {
                let [a, k]: [f64; 2] = [6.3, 3.4].map(|range| range * random.random::<f64>());
                samples.inputs.extend([1.4 * a.sin(), 1.4 * a.cos(), k - 1.7]);
                samples.outputs.push(k * a.sin().atan2(1.6 - a.cos()).powi(2) + a.sin());
            }
            samples
        };
        let depends = [vec![true; 3]];
        let never = AtomicBool::new(false);
        let (layers, error) = solve(&linkage(4000, 1), &linkage(400, 2), &depends, &[true], 7, &never).unwrap();
        assert!(error < 1e-6, "{error}");
        let mean_of = |column: usize| layers[0].weight.iter().skip(column).step_by(3).map(f64::abs).sum::<f64>();
        let [sine, cosine, factor] = [0, 1, 2].map(mean_of);
        assert!(factor < 0.5 * sine.min(cosine), "{sine} {cosine} {factor}");
    }

    #[test]
    fn nothing_is_solved_once_it_is_to_stop() {
        let depends = DEPENDS.map(|depends| depends.to_vec());
        let stop = AtomicBool::new(true);
        assert_eq!(solve(&samples(3000, 1), &samples(300, 2), &depends, &[true, false], 7, &stop), None);
    }

    /// `A = Q R` column by column.
    #[test]
    fn a_matrix_times_a_triangle_is_divided_by_it() {
        let columns = 2 * COLUMNS + 5;
        let number = |row: usize, column: usize| (1.3 * row as f64 + 2.9 * column as f64 * row as f64).sin();
        let quotient = DMatrix::from_fn(40, columns, number);
        let r = DMatrix::from_fn(columns, columns, |row, column| match row.cmp(&column) {
            std::cmp::Ordering::Less => 0.1 * number(row + 1, column),
            std::cmp::Ordering::Equal => 2.0,
            std::cmp::Ordering::Greater => 0.0,
        });
        let mut a = &quotient * &r;
        divide(&mut a, &r);
        assert!((a - quotient).amax() < 1e-12);
    }

    #[test]
    fn the_same_seed_gives_the_same_layers_for_any_number_of_threads() {
        let with = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| solved(7))
        };
        let (one, three) = (with(1), with(3));
        assert_eq!(one, three);
        assert_ne!(one.0, solved(8).0);
    }
}
