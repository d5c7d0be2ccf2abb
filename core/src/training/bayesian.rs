//! Small networks of few rows: Levenberg-Marquardt steps with Bayesian regularization (MacKay 1992; Foresee, Hagan 1997).
//!
//! ```text
//! F = beta/2 sum over rows (f(x) - y)^2 + 1/2 sum over groups g alpha_g sum over weights of g w^2
//! H = beta J^T J + diag(alpha)
//! gamma_g = n_g - alpha_g sum over g of (H^-1)_ii,  alpha_g = gamma_g / sum over g w^2,  beta = (N - gamma) / sum e^2
//! ```
//!
//! `J` has the derivatives of the network at the rows. The logarithm of the evidence, `-F - 1/2 ln det H + 1/2 sum n_g ln alpha_g + N/2 ln beta`,
//! compares starts and sizes. Groups are first the weights and the biases of each layer, then the weights of each input: inputs that do not matter fade.
//! No row is held out.

use super::damping::Damping;
use metafmu_runtime::{Activation, Layer, graph::Elementwise};
use nalgebra::{Cholesky, DMatrix, DVector};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Hidden layers that are compared.
const SIZES: [&[usize]; 4] = [&[8], &[16], &[8, 8], &[12, 12]];
/// Starts of each size.
const STARTS: u64 = 2;
/// Iterations after which starts are compared, and number of those that continue.
const RACE: usize = 60;
const FINALISTS: usize = 2;
/// Iterations of these with groups by layer, then by input.
const BY_LAYER: usize = 80;
const BY_INPUT: usize = 120;
/// Iterations between two updates of the regularization.
const UPDATE: usize = 4;
/// Change of the logarithm of the evidence that is none, and updates without one after which a training ends.
const CHANGE: f64 = 0.5;
const STALLS: usize = 4;
/// Operations of an iteration at most: a fit takes seconds.
const MOST_OPERATIONS: f64 = 3e7;
/// Limits of the regularization of a weight.
const ALPHA: [f64; 2] = [1e-6, 1e6];
/// Largest inverse of the variance of the noise, of outputs with a standard deviation of 1: rounding is more.
const MOST_BETA: f64 = 1e14;
/// Share of the rows that are not spent on weights, at least.
const LEAST_FREE: f64 = 0.02;

/// Standardized rows of a fit.
#[derive(Clone, Copy)]
pub struct FewRows<'a> {
    /// Shape `[rows, inputs]`.
    pub x: &'a [f64],
    /// Shape `[rows, outputs]`.
    pub y: &'a [f64],
    /// Number of inputs.
    pub inputs: usize,
    /// Number of outputs.
    pub outputs: usize,
}

/// Sizes and activation of a network, unless they are chosen.
pub struct SmallNetwork {
    /// Hidden layers; None if they are chosen by their evidence.
    pub hidden: Option<Vec<usize>>,
    /// Activation of the hidden layers.
    pub activation: Activation,
    /// The weights begin with it.
    pub seed: u64,
}

/// Iterations of a training so far, and whether it must end.
pub struct IterationFollower<'a> {
    /// Called with the number of iterations after each.
    pub progress: &'a (dyn Fn(usize) + Sync),
    /// True if the training must end.
    pub is_stopped: &'a (dyn Fn() -> bool + Sync),
}

impl SmallNetwork {
    /// Hidden layers that are trained in seconds on this number of rows; empty if all take longer.
    fn sizes(&self, [inputs, outputs]: [usize; 2], rows: usize) -> Vec<Vec<usize>> {
        let mut candidates: Vec<Vec<usize>> = match &self.hidden {
            Some(hidden) => vec![hidden.clone()],
            None => SIZES.iter().map(|size| size.to_vec()).collect(),
        };
        candidates.retain(|hidden| {
            let weights = NetworkShape::new(inputs, hidden, self.activation).weights() as f64;
            let operations = weights * weights * (rows as f64 + weights) * outputs as f64;
            !hidden.is_empty() && operations <= MOST_OPERATIONS
        });
        candidates
    }

    /// Returns true if a network with these numbers of inputs, outputs and rows is trained in seconds, and its activation is smooth.
    pub fn is_quick(&self, columns: [usize; 2], rows: usize) -> bool {
        is_smooth(self.activation) && !self.sizes(columns, rows).is_empty()
    }

    /// Iterations of a training at most.
    pub fn iterations(&self, columns: [usize; 2], rows: usize) -> usize {
        let starts = self.sizes(columns, rows).len() * STARTS as usize;
        columns[1] * (starts * RACE + FINALISTS.min(starts) * (BY_LAYER + BY_INPUT))
    }
}

/// Returns true if the activation has a second derivative that is not zero everywhere.
fn is_smooth(activation: Activation) -> bool {
    !matches!(activation, Activation::Relu | Activation::Identity)
}

/// Layers of a network with one output; its weights are `W_1 | b_1 | W_2 | b_2 | ...`.
struct NetworkShape {
    sizes: Vec<usize>,
    activation: Activation,
}

/// How weights share their regularization.
#[derive(Clone, Copy, PartialEq)]
enum Groups {
    Layers,
    Inputs,
}

impl NetworkShape {
    fn new(inputs: usize, hidden: &[usize], activation: Activation) -> Self {
        Self { sizes: [&[inputs], hidden, &[1]].concat(), activation }
    }

    fn weights(&self) -> usize {
        self.sizes.windows(2).map(|pair| (pair[0] + 1) * pair[1]).sum()
    }

    fn start(&self, random: &mut ChaCha8Rng) -> DVector<f64> {
        let mut weights = Vec::with_capacity(self.weights());
        let last = self.sizes.len() - 2;
        for (layer, pair) in self.sizes.windows(2).enumerate() {
            let bound = 1.5 / (pair[0] as f64).sqrt();
            weights.extend((0..pair[0] * pair[1]).map(|_| random.random_range(-bound..bound)));
            weights.extend((0..pair[1]).map(|_| if layer < last { random.random_range(-1.0..1.0) } else { 0.0 }));
        }
        DVector::from_vec(weights)
    }

    /// Group of each weight.
    fn groups(&self, by: Groups) -> Vec<usize> {
        let (mut groups, mut next) = (Vec::with_capacity(self.weights()), 0);
        for (layer, pair) in self.sizes.windows(2).enumerate() {
            let of_inputs = layer == 0 && by == Groups::Inputs;
            for weight in 0..pair[0] * pair[1] {
                groups.push(next + if of_inputs { weight % pair[0] } else { 0 });
            }
            next += if of_inputs { pair[0] } else { 1 };
            groups.extend(std::iter::repeat_n(next, pair[1]));
            next += 1;
        }
        groups
    }

    /// Outputs at rows `x`, and their derivatives by the weights, a column for each row.
    fn evaluate(&self, weights: &[f64], x: &[f64], mut jacobian: Option<&mut DMatrix<f64>>) -> DVector<f64> {
        let layers = self.sizes.len() - 1;
        let function = Elementwise::Activation(self.activation);
        let mut values: Vec<Vec<f64>> = self.sizes.iter().map(|size| vec![0.0; *size]).collect();
        let (mut slopes, mut deltas) = (values.clone(), values.clone());
        let mut starts = vec![0; layers];
        for layer in 1..layers {
            starts[layer] = starts[layer - 1] + (self.sizes[layer - 1] + 1) * self.sizes[layer];
        }
        let rows = x.chunks_exact(self.sizes[0]);
        let mut outputs = DVector::zeros(rows.len());
        for (row, x) in rows.enumerate() {
            values[0].copy_from_slice(x);
            for layer in 0..layers {
                let (inputs, nodes) = (self.sizes[layer], self.sizes[layer + 1]);
                let (matrix, biases) = weights[starts[layer]..][..(inputs + 1) * nodes].split_at(inputs * nodes);
                let (before, after) = values.split_at_mut(layer + 1);
                for (node, line) in matrix.chunks_exact(inputs).enumerate() {
                    let sum: f64 = line.iter().zip(&before[layer]).map(|(weight, value)| weight * value).sum();
                    let sum = sum + biases[node];
                    let [value, slope, _] =
                        if layer + 1 < layers { function.series(sum, [0.0; 2]) } else { [sum, 1.0, 0.0] };
                    (after[0][node], slopes[layer + 1][node]) = (value, slope);
                }
            }
            outputs[row] = values[layers][0];
            let Some(jacobian) = jacobian.as_deref_mut() else { continue };
            let mut column = jacobian.column_mut(row);
            let column = column.as_mut_slice();
            deltas[layers][0] = 1.0;
            for layer in (0..layers).rev() {
                let (inputs, nodes) = (self.sizes[layer], self.sizes[layer + 1]);
                let (before, after) = deltas.split_at_mut(layer + 1);
                let (matrix, biases) = column[starts[layer]..][..(inputs + 1) * nodes].split_at_mut(inputs * nodes);
                for (line, delta) in matrix.chunks_exact_mut(inputs).zip(&after[0]) {
                    line.iter_mut().zip(&values[layer]).for_each(|(to, value)| *to = delta * value);
                }
                biases.copy_from_slice(&after[0]);
                if layer == 0 {
                    continue;
                }
                before[layer].fill(0.0);
                let matrix = weights[starts[layer]..][..inputs * nodes].chunks_exact(inputs);
                for (line, delta) in matrix.zip(&after[0]) {
                    before[layer].iter_mut().zip(line).for_each(|(to, weight)| *to += delta * weight);
                }
                before[layer].iter_mut().zip(&slopes[layer]).for_each(|(to, slope)| *to *= slope);
            }
        }
        outputs
    }

    /// Weights and biases of each layer.
    fn layers<'a>(&'a self, weights: &'a [f64]) -> impl Iterator<Item = (&'a [f64], &'a [f64])> {
        let mut rest = weights;
        self.sizes.windows(2).map(move |pair| {
            let (layer, others) = rest.split_at((pair[0] + 1) * pair[1]);
            rest = others;
            layer.split_at(pair[0] * pair[1])
        })
    }
}

/// A training of one output.
struct Training<'a> {
    shape: NetworkShape,
    x: &'a [f64],
    y: &'a DVector<f64>,
    weights: DVector<f64>,
    /// Regularization of each weight.
    alpha: Vec<f64>,
    beta: f64,
    damping: Damping,
    evidence: f64,
}

impl<'a> Training<'a> {
    fn new(shape: NetworkShape, x: &'a [f64], y: &'a DVector<f64>, random: &mut ChaCha8Rng) -> Self {
        let weights = shape.start(random);
        let alpha = vec![0.1; shape.weights()];
        Self { shape, x, y, weights, alpha, beta: 1.0, damping: Damping::new(1.0), evidence: f64::NEG_INFINITY }
    }

    /// Number of hidden layers.
    fn depth(&self) -> usize {
        self.shape.sizes.len() - 2
    }

    fn objective(&self, errors: &DVector<f64>, weights: &DVector<f64>) -> f64 {
        let penalty: f64 = weights.iter().zip(&self.alpha).map(|(weight, alpha)| alpha * weight * weight).sum();
        0.5 * (self.beta * errors.norm_squared() + penalty)
    }

    /// Trains for a number of iterations at most; weights in a group share their regularization.
    fn iterate(&mut self, by: Groups, iterations: usize, count: &dyn Fn(), is_stopped: &dyn Fn() -> bool) {
        let groups = self.shape.groups(by);
        let (number, rows) = (self.weights.len(), self.y.len());
        let mut jacobian = DMatrix::zeros(number, rows);
        let mut errors = self.shape.evaluate(self.weights.as_slice(), self.x, Some(&mut jacobian)) - self.y;
        let mut products = DMatrix::zeros(number, number);
        let mut stalls = 0;
        for iteration in 1..=iterations {
            count();
            if is_stopped() {
                return;
            }
            products.gemm(1.0, &jacobian, &jacobian.transpose(), 0.0);
            let matrix = self.hessian(&products);
            let penalties = DVector::from_fn(number, |place, _| self.alpha[place] * self.weights[place]);
            let gradient = &jacobian * &errors * self.beta + penalties;
            let value = self.objective(&errors, &self.weights);
            let mut damping = self.damping;
            let better = damping.step(&matrix, &gradient, |change| {
                let weights = &self.weights - change;
                let errors = self.shape.evaluate(weights.as_slice(), self.x, None) - self.y;
                (self.objective(&errors, &weights) < value).then_some(weights)
            });
            self.damping = damping;
            let has_moved = better.is_some();
            if let Some(weights) = better {
                self.weights = weights;
                errors = self.shape.evaluate(self.weights.as_slice(), self.x, Some(&mut jacobian)) - self.y;
            }
            if has_moved && iteration % UPDATE != 0 && iteration < iterations {
                continue;
            }
            let before = self.evidence;
            products.gemm(1.0, &jacobian, &jacobian.transpose(), 0.0);
            if self.regularize(&groups, &products, &errors).is_none() {
                return;
            }
            stalls = if (self.evidence - before).abs() < CHANGE { stalls + 1 } else { 0 };
            if stalls >= STALLS {
                return;
            }
        }
    }

    /// `beta J^T J + diag(alpha)`
    fn hessian(&self, products: &DMatrix<f64>) -> DMatrix<f64> {
        let mut matrix = products * self.beta;
        self.alpha.iter().enumerate().for_each(|(place, alpha)| matrix[(place, place)] += alpha);
        matrix
    }

    /// Evidence of the regularization so far, and a better regularization; None if the matrix is singular.
    fn regularize(&mut self, groups: &[usize], products: &DMatrix<f64>, errors: &DVector<f64>) -> Option<()> {
        let factors = Cholesky::new(self.hessian(products))?;
        let half_determinant: f64 = factors.l_dirty().diagonal().iter().map(|pivot| pivot.ln()).sum();
        let rows = errors.len() as f64;
        let logarithms: f64 = self.alpha.iter().map(|alpha| alpha.ln()).sum::<f64>() + rows * self.beta.ln();
        self.evidence = 0.5 * logarithms - self.objective(errors, &self.weights) - half_determinant;
        let inverse = factors.inverse();
        let count = groups.last().map_or(0, |last| last + 1);
        let mut sums = vec![[0.0; 3]; count];
        for (place, group) in groups.iter().enumerate() {
            let [number, trace, squares] = &mut sums[*group];
            *number += 1.0;
            // weights that were regularized differently before have the mean
            *trace += self.alpha[place] * inverse[(place, place)];
            *squares += self.weights[place] * self.weights[place];
        }
        let spent: Vec<f64> = sums.iter().map(|[number, trace, _]| (number - trace).max(1e-3)).collect();
        let alphas: Vec<f64> =
            spent.iter().zip(&sums).map(|(spent, sum)| (spent / sum[2].max(1e-12)).clamp(ALPHA[0], ALPHA[1])).collect();
        self.alpha.iter_mut().zip(groups).for_each(|(alpha, group)| *alpha = alphas[*group]);
        let free = (rows - spent.iter().sum::<f64>()).max(LEAST_FREE * rows);
        self.beta = (free / errors.norm_squared().max(f64::MIN_POSITIVE)).min(MOST_BETA);
        Some(())
    }
}

/// Layers of a network of standardized columns in double precision; None if the training was stopped. Each output has separate nodes. All have
/// the same number of layers. The same rows and seed give the same network for any number of threads.
pub fn train_small(rows: FewRows, network: &SmallNetwork, follower: &IterationFollower) -> Option<Vec<Layer>> {
    let FewRows { x, y, inputs, outputs } = rows;
    let count = x.len() / inputs.max(1);
    let sizes = network.sizes([inputs, outputs], count);
    let done = AtomicUsize::new(0);
    let progress = || (follower.progress)(done.fetch_add(1, Ordering::Relaxed) + 1);
    let columns: Vec<DVector<f64>> = (0..outputs)
        .map(|output| DVector::from_iterator(count, y.iter().skip(output).step_by(outputs).copied()))
        .collect();
    let starts: Vec<(&Vec<usize>, u64)> =
        sizes.iter().flat_map(|size| (0..STARTS).map(move |start| (size, start))).collect();
    let raced = columns.par_iter().map(|y| {
        // a constant needs no training
        if y.iter().all(|value| *value == y[0]) {
            return None;
        }
        let begun = starts.par_iter().map(|(hidden, start)| {
            let mut random = ChaCha8Rng::seed_from_u64(network.seed);
            random.set_stream(*start);
            let mut training = Training::new(NetworkShape::new(inputs, hidden, network.activation), x, y, &mut random);
            training.iterate(Groups::Layers, RACE, &progress, follower.is_stopped);
            training
        });
        Some(begun.collect())
    });
    let raced: Vec<Option<Vec<Training>>> = raced.collect();
    let depth = best_depth(raced.iter().flatten(), &sizes)?;
    let trained = raced.into_par_iter().zip(&columns).map(|(raced, y)| match raced {
        Some(mut raced) => {
            raced.retain(|training| outputs == 1 || training.depth() == depth);
            finished(raced, &progress, follower.is_stopped)
        }
        None => sizes.iter().find(|size| size.len() == depth).map(|hidden| {
            let shape = NetworkShape::new(inputs, hidden, network.activation);
            let mut weights = vec![0.0; shape.weights()];
            // exact
            weights.iter_mut().last().into_iter().for_each(|bias| *bias = y[0]);
            (shape, weights)
        }),
    });
    let trained: Option<Vec<(NetworkShape, Vec<f64>)>> = trained.collect::<Vec<_>>().into_iter().collect();
    if (follower.is_stopped)() {
        return None;
    }
    let trained = trained?;
    let parts: Vec<(&NetworkShape, &[f64])> = trained.iter().map(|(shape, weights)| (shape, &weights[..])).collect();
    Some(side_by_side(&parts, network.activation))
}

/// The network with the greatest evidence after the best of the starts are trained to the end.
fn finished(
    mut starts: Vec<Training>,
    progress: &(dyn Fn() + Sync),
    is_stopped: &(dyn Fn() -> bool + Sync),
) -> Option<(NetworkShape, Vec<f64>)> {
    starts.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
    starts.truncate(FINALISTS);
    starts.par_iter_mut().for_each(|training| {
        training.iterate(Groups::Layers, BY_LAYER, progress, is_stopped);
        let (weights, evidence) = (training.weights.clone(), training.evidence);
        training.iterate(Groups::Inputs, BY_INPUT, progress, is_stopped);
        if training.evidence < evidence {
            (training.weights, training.evidence) = (weights, evidence);
        }
    });
    // the first of equal ones
    let best = starts.into_iter().reduce(|best, next| if next.evidence > best.evidence { next } else { best })?;
    Some((best.shape, best.weights.as_slice().to_vec()))
}

/// Number of hidden layers with the greatest sum over the outputs of the evidence of the best start.
fn best_depth<'a>(raced: impl Iterator<Item = &'a Vec<Training<'a>>> + Clone, sizes: &[Vec<usize>]) -> Option<usize> {
    let evidence = |depth: usize| -> f64 {
        let best = raced.clone().map(|of| {
            let fitting = of.iter().filter(|training| training.depth() == depth);
            fitting.map(|training| training.evidence).fold(f64::NEG_INFINITY, f64::max)
        });
        best.sum()
    };
    let mut depths: Vec<usize> = sizes.iter().map(Vec::len).collect();
    depths.sort_unstable();
    depths.dedup();
    // the smaller of equal ones
    depths.into_iter().reduce(|best, next| if evidence(next) > evidence(best) { next } else { best })
}

/// Networks of the same inputs as one: weights between them are 0.
fn side_by_side(parts: &[(&NetworkShape, &[f64])], activation: Activation) -> Vec<Layer> {
    let layers: Vec<Vec<(&[f64], &[f64])>> =
        parts.iter().map(|(shape, weights)| shape.layers(weights).collect()).collect();
    let depth = layers.first().map_or(0, Vec::len);
    let merged = (0..depth).map(|layer| {
        let widths = layers.iter().map(|part| part[layer].0.len() / part[layer].1.len());
        let inputs = match layer {
            0 => widths.clone().next().unwrap_or(0),
            _ => widths.clone().sum(),
        };
        let (mut weight, mut bias, mut before) = (Vec::new(), Vec::new(), 0);
        for (part, own) in layers.iter().zip(widths) {
            for line in part[layer].0.chunks_exact(own) {
                let start = weight.len();
                weight.resize(start + inputs, 0.0);
                weight[start + before..][..own].copy_from_slice(line);
            }
            bias.extend_from_slice(part[layer].1);
            before += if layer == 0 { 0 } else { own };
        }
        let activation = if layer + 1 == depth { Activation::Identity } else { activation };
        Layer { inputs, outputs: bias.len(), weight: weight.into(), bias: bias.into(), activation }
    });
    merged.collect()
}

#[cfg(test)]
mod tests;
