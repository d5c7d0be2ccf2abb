//! Networks with one hidden layer whose weights are drawn at random, and whose last layer is the solution of a linear least-squares
//! problem in double precision.
//!
//! ```text
//! y_f(x) = sum over nodes k of c_fk tanh(w_k x + b_k) + d_f
//! w_ki uniform in [-scale, scale] for the columns that function f depends on, otherwise 0;  b_k uniform in [-1, 1]
//! ```
//!
//! The coefficients are those of values and derivatives together. Of smooth functions of a few columns this is far more exact than a
//! network of which all weights are trained: gradients, also preconditioned ones, come to a halt where the problem, ill-conditioned as it
//! is, has most of its error left (Huang, Zhu, Siew 2006, doi:10.1016/j.neucom.2005.12.126, call it an extreme learning machine).
//! How steep the nodes are and how many there are is chosen by samples that are held out.

use metafmu_runtime::{Activation, Layer};
use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use rayon::prelude::*;

/// Standardised samples of functions, with derivatives along some directions.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Samples {
    /// Number of directions.
    pub directions: usize,
    /// Of each sample the columns, then their derivatives along each direction: shape `[samples, 1 + directions, columns]`.
    pub inputs: Vec<f64>,
    /// Of each sample the functions, then their derivatives, likewise.
    pub outputs: Vec<f64>,
}

/// A function, or several that depend on the same columns.
struct Group {
    outputs: Vec<usize>,
    columns: Vec<usize>,
}

/// Nodes of one group, and what each of its outputs has of them: shape `[outputs, nodes + 1]`, the last one being the constant.
struct Nodes {
    /// `[nodes, columns]`
    weights: Vec<f64>,
    bias: Vec<f64>,
    coefficients: Vec<DVector<f64>>,
    /// Root mean square error of the worst output in the samples that are held out.
    error: f64,
}

/// Half the range of weights: what is tried with the fewest nodes. With more nodes steeper ones pay.
const SCALES: [f64; 7] = [0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2];
/// Numbers of nodes that are tried, and how much the best scale before is changed from the second on.
const NODES: [usize; 5] = [64, 128, 256, 512, 1024];
const STEEPER: [f64; 3] = [0.5, 1.0, 2.0];
/// Samples for each node.
const SAMPLES: usize = 4;
/// Error, of standardised outputs, at which more nodes cost more than they are worth.
const ENOUGH: f64 = 1e-6;
/// What is added to the diagonal of the normal equations, relative to its largest element: nodes are nearly dependent.
const RIDGE: f64 = 1e-14;
/// Solutions, each for what is left by those before: they take most of the ridge's effect away.
const SOLUTIONS: usize = 3;
/// Parts of the samples that are summed by themselves, whatever the number of threads.
const PARTS: usize = 8;
/// Samples of which the nodes are computed together.
const BLOCK: usize = 64;

/// The layers of a network for standardised samples, and its root mean square error, of the worst output, in those that are held out.
/// `depends[output][column]` says which columns change an output, all of them if none does, and `known` of which outputs derivatives are
/// known. None if no coefficients can be found.
///
/// # Panics
/// If the samples have no rows or other shapes.
pub fn solve(
    seen: &Samples,
    held_out: &Samples,
    depends: &[Vec<bool>],
    known: &[bool],
    seed: u64,
) -> Option<(Vec<Layer>, f64)> {
    let (columns, outputs) = (depends[0].len(), depends.len());
    let mut groups: Vec<Group> = Vec::new();
    for (output, depends) in depends.iter().enumerate() {
        let columns: Vec<usize> = (0..columns).filter(|column| depends[*column] || !depends.contains(&true)).collect();
        let same = |group: &&mut Group| group.columns == columns && known[group.outputs[0]] == known[output];
        match groups.iter_mut().find(same) {
            Some(group) => group.outputs.push(output),
            None => groups.push(Group { outputs: vec![output], columns }),
        }
    }
    let problems = groups.iter().map(|group| Problem::new(group, [seen, held_out], [columns, outputs], known));
    let solved: Vec<Nodes> = problems.map(|problem| problem.solve(seed)).collect::<Option<_>>()?;
    let nodes: usize = solved.iter().map(|nodes| nodes.bias.len()).sum();
    let (mut weights, mut bias) = (vec![0.0; nodes * columns], Vec::with_capacity(nodes));
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
    let layer = |inputs, outputs, weight: Vec<f64>, bias: Vec<f64>, activation| Layer {
        inputs,
        outputs,
        weight: weight.into(),
        bias: bias.into(),
        activation,
    };
    let layers = vec![
        layer(columns, nodes, weights, bias, Activation::Tanh),
        layer(nodes, outputs, last, constant, Activation::Identity),
    ];
    Some((layers, solved.iter().map(|nodes| nodes.error).fold(0.0, f64::max)))
}

/// The functions of a group: rows of their own columns, which are values and, if they are known, derivatives.
struct Problem {
    columns: usize,
    outputs: usize,
    /// Rows of a sample, the first of which are values.
    parts: usize,
    seen: [Vec<f64>; 2],
    held_out: [Vec<f64>; 2],
}

impl Problem {
    fn new(group: &Group, [seen, held_out]: [&Samples; 2], widths: [usize; 2], known: &[bool]) -> Self {
        let parts = if known[group.outputs[0]] { 1 + seen.directions } else { 1 };
        let own = |samples: &Samples, parts: usize| {
            let of = |values: &[f64], width: usize, chosen: &[usize]| -> Vec<f64> {
                let samples = values.chunks(width * (1 + samples.directions));
                let rows = samples.flat_map(|sample| sample.chunks(width).take(parts));
                rows.flat_map(|row| chosen.iter().map(|column| row[*column])).collect()
            };
            [of(&samples.inputs, widths[0], &group.columns), of(&samples.outputs, widths[1], &group.outputs)]
        };
        Self {
            columns: group.columns.len(),
            outputs: group.outputs.len(),
            parts,
            seen: own(seen, parts),
            held_out: own(held_out, 1),
        }
    }

    fn solve(&self, seed: u64) -> Option<Nodes> {
        let mut best: Option<(f64, Nodes)> = None;
        let mut scales = SCALES.to_vec();
        for count in NODES {
            for &scale in &scales {
                let found = self.with_nodes(count, scale, seed);
                let is_better = |found: &Nodes| best.as_ref().is_none_or(|(_, best)| found.error < best.error);
                best = found.filter(is_better).map(|found| (scale, found)).or(best);
            }
            let (scale, found) = best.as_ref()?;
            if found.error <= ENOUGH {
                break;
            }
            scales = STEEPER.map(|factor| factor * scale).to_vec();
        }
        best.map(|(_, nodes)| nodes)
    }

    /// None if the nodes depend on each other.
    fn with_nodes(&self, count: usize, scale: f64, seed: u64) -> Option<Nodes> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut nodes = Nodes { weights: Vec::new(), bias: Vec::new(), coefficients: Vec::new(), error: f64::INFINITY };
        for _ in 0..count {
            let mut uniform = |limit: f64| limit * (2.0 * random.random::<f64>() - 1.0);
            nodes.weights.extend((0..self.columns).map(|_| uniform(scale)));
            nodes.bias.push(uniform(1.0));
        }
        let [inputs, outputs] = &self.seen;
        let rows = (outputs.len() / self.outputs).min(SAMPLES * count * self.parts);
        let seen = Rows {
            columns: self.columns,
            parts: self.parts,
            inputs: &inputs[..rows * self.columns],
            outputs: DMatrix::from_row_slice(rows, self.outputs, &outputs[..rows * self.outputs]),
        };
        let mut normal = seen.sums(&nodes, (count + 1, count + 1), |block, _| block.tr_mul(block));
        let ridge = RIDGE * normal.diagonal().amax();
        (0..=count).for_each(|k| normal[(k, k)] += ridge);
        let factors = normal.cholesky()?;
        let mut coefficients = DMatrix::zeros(count + 1, self.outputs);
        for _ in 0..SOLUTIONS {
            let shape = (count + 1, self.outputs);
            let sides = seen.sums(&nodes, shape, |block, outputs| block.tr_mul(&(outputs - block * &coefficients)));
            coefficients += factors.solve(&sides);
        }
        nodes.coefficients = coefficients.column_iter().map(Into::into).collect();
        let [inputs, outputs] = &self.held_out;
        let rows = outputs.len() / self.outputs;
        let outputs = DMatrix::from_row_slice(rows, self.outputs, outputs);
        let held_out = Rows { columns: self.columns, parts: 1, inputs, outputs };
        let squares = held_out.sums(&nodes, (1, self.outputs), |block, outputs| {
            let squares = (outputs - block * &coefficients).map(|error| error * error);
            DMatrix::from_row_slice(1, self.outputs, squares.row_sum().as_slice())
        });
        nodes.error = (squares.max() / rows as f64).sqrt();
        nodes.error.is_finite().then_some(nodes)
    }
}

/// Rows of columns, sample by sample, of which the first of each are values, and of outputs.
struct Rows<'a> {
    columns: usize,
    parts: usize,
    inputs: &'a [f64],
    outputs: DMatrix<f64>,
}

impl Rows<'_> {
    /// The sum, over blocks of rows, of what `of` makes of the nodes there, shape `[rows, nodes + 1]`, and of the outputs: a matrix of
    /// this shape.
    fn sums(
        &self,
        nodes: &Nodes,
        (height, width): (usize, usize),
        of: impl Fn(&DMatrix<f64>, &DMatrix<f64>) -> DMatrix<f64> + Sync,
    ) -> DMatrix<f64> {
        let samples = self.outputs.nrows() / self.parts;
        let blocks = samples.div_ceil(BLOCK);
        let sum_of = |part: usize| {
            let mut sum = DMatrix::zeros(height, width);
            for block in part * blocks / PARTS..(part + 1) * blocks / PARTS {
                let (begin, end) = (block * BLOCK * self.parts, ((block + 1) * BLOCK).min(samples) * self.parts);
                let values = self.values(nodes, &self.inputs[begin * self.columns..end * self.columns]);
                sum += of(&values, &self.outputs.rows(begin, end - begin).into_owned());
            }
            sum
        };
        let sums: Vec<DMatrix<f64>> = (0..PARTS).into_par_iter().map(sum_of).collect();
        sums.into_iter().fold(DMatrix::zeros(height, width), |sum, part| sum + part)
    }

    /// Of each node and of the constant, at some rows.
    fn values(&self, nodes: &Nodes, inputs: &[f64]) -> DMatrix<f64> {
        let count = nodes.bias.len();
        let mut values = DMatrix::zeros(inputs.len() / self.columns, count + 1);
        for (sample, inputs) in inputs.chunks(self.columns * self.parts).enumerate() {
            let first = sample * self.parts;
            for (k, (weights, bias)) in nodes.weights.chunks(self.columns).zip(&nodes.bias).enumerate() {
                let mut slope = 1.0;
                for (part, row) in inputs.chunks(self.columns).enumerate() {
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
    fn samples(count: usize, seed: u64) -> Samples {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut samples = Samples { directions: 1, ..Samples::default() };
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
        solve(&samples(3000, 1), &samples(300, 2), &depends, &[true, false], seed).unwrap()
    }

    #[test]
    fn smooth_functions_are_found_to_a_millionth_also_where_nothing_was_sampled() {
        let (layers, error) = solved(7);
        assert!(error < 2e-6, "{error}");
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
                assert!((found - y[output]).abs() < 3e-5, "{output}: {found} {}", y[output]);
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
