//! Training on predictions over several rows, in which outputs are inputs of the rows that follow.
//!
//! ```text
//! y_j = L (x_j, 1) + g N(x_j)      x_j: the inputs of row j, those that are outputs of earlier rows of the stretch from the prediction
//! ```
//!
//! The loss is the mean over all rows of the stretches; its gradient goes back through all of them.

use super::{
    loss::LossFunction,
    rows::{Recurrence, TrainingRows},
};
use crate::network::{BLOCK_ROWS, DropoutMask, Packed, Workspace, kernels::Store, layout::stride};

/// Predictions are standardized: farther from the mean than this they have diverged, and are kept there.
const LIMIT: f32 = 30.0;

/// Working memory for the rows of a block of stretches.
#[derive(Default)]
pub(super) struct Unrolled {
    /// One for each row of a stretch; the first one also for rows without a recurrence.
    pub(super) workspaces: Vec<Workspace>,
    /// `y_j`, and the loss's derivatives by it: `[rows of a stretch, stretches, outputs]`.
    predictions: Vec<f32>,
    deltas: Vec<f32>,
    /// Derivatives by the past outputs among the inputs of a row: `[stretches, past outputs]`.
    of_past: Vec<f32>,
}

impl Unrolled {
    pub(super) fn new(network: &Packed) -> Self {
        Self { workspaces: vec![Workspace::new(network)], ..Self::default() }
    }

    fn reserve(&mut self, network: &Packed, rows: &TrainingRows, workspaces: usize, stretch: usize) {
        while self.workspaces.len() < workspaces {
            self.workspaces.push(Workspace::new(network));
        }
        let count = stretch * BLOCK_ROWS * rows.n_outputs();
        self.predictions.resize(count.max(self.predictions.len()), 0.0);
        self.deltas.resize(count.max(self.deltas.len()), 0.0);
        self.of_past.resize(BLOCK_ROWS * rows.n_inputs(), 0.0);
    }
}

/// A block of stretches of some rows.
pub(super) struct StretchBlock<'a> {
    pub(super) network: &'a Packed,
    pub(super) rows: &'a TrainingRows,
    pub(super) recurrence: &'a Recurrence,
    pub(super) function: &'a LossFunction,
    /// The numbers of the stretches.
    pub(super) numbers: &'a [u32],
}

impl StretchBlock<'_> {
    /// Sum of the losses.
    pub(super) fn loss(&self, unrolled: &mut Unrolled) -> f64 {
        let Recurrence { stretch, .. } = *self.recurrence;
        unrolled.reserve(self.network, self.rows, 1, stretch);
        let losses = (0..stretch).map(|j| {
            self.set_inputs(j, 0, unrolled);
            self.network.forward(self.numbers.len(), &mut unrolled.workspaces[0]);
            self.predict(j, 0, 0.0, unrolled)
        });
        losses.sum()
    }

    /// Sum of the losses; puts into or onto `gradient` the derivatives of `scale` times it.
    pub(super) fn gradient(
        &self,
        (seed, step): (u64, u64),
        scale: f32,
        mut store: Store,
        unrolled: &mut Unrolled,
        gradient: &mut [f32],
    ) -> f64 {
        let Recurrence { stretch, .. } = *self.recurrence;
        unrolled.reserve(self.network, self.rows, stretch, stretch);
        let mask = DropoutMask { seed, step, rows: self.numbers };
        let mut loss = 0.0;
        for j in 0..stretch {
            self.set_inputs(j, j, unrolled);
            self.network.forward_in_training(&mut unrolled.workspaces[j], mask);
            loss += self.predict(j, j, scale, unrolled);
        }
        for j in (0..stretch).rev() {
            self.set_deltas(j, unrolled);
            let workspace = &mut unrolled.workspaces[j];
            self.network.backward(self.numbers.len(), workspace, store, gradient);
            store = Store::Add;
            self.spread(j, unrolled);
        }
        loss
    }

    /// Where row `j` of all stretches is in `predictions` and `deltas`.
    fn part(&self, j: usize) -> std::ops::Range<usize> {
        let size = self.numbers.len() * self.rows.n_outputs();
        j * size..(j + 1) * size
    }

    fn row(&self, number: u32, j: usize) -> usize {
        self.recurrence.starts[number as usize] as usize + j
    }

    /// The inputs of row `j` of each stretch.
    fn set_inputs(&self, j: usize, workspace: usize, unrolled: &mut Unrolled) {
        let (n_inputs, n_outputs) = (self.rows.n_inputs(), self.rows.n_outputs());
        let known = self.recurrence.history.min(j);
        let Unrolled { workspaces, predictions, .. } = unrolled;
        let to = workspaces[workspace].inputs_mut().chunks_exact_mut(stride(n_inputs));
        for (index, (to, &number)) in to.zip(self.numbers).enumerate() {
            let row = self.row(number, j);
            to[..n_inputs].copy_from_slice(&self.rows.inputs()[row * n_inputs..][..n_inputs]);
            for (lag, to) in to[..known * n_outputs].chunks_exact_mut(n_outputs).enumerate() {
                let begin = self.part(j - 1 - lag).start + index * n_outputs;
                to.copy_from_slice(&predictions[begin..begin + n_outputs]);
            }
        }
    }

    /// Predictions for row `j` from the network's outputs, their losses, and the derivatives of `scale` times them.
    fn predict(&self, j: usize, workspace: usize, scale: f32, unrolled: &mut Unrolled) -> f64 {
        let (n_inputs, n_outputs) = (self.rows.n_inputs(), self.rows.n_outputs());
        let Recurrence { linear, gains, .. } = self.recurrence;
        let part = self.part(j);
        let Unrolled { workspaces, predictions, deltas, .. } = unrolled;
        let workspace = &mut workspaces[workspace];
        let given = predictions[part.clone()].chunks_exact_mut(n_outputs);
        for (index, to) in given.enumerate() {
            let x = &workspace.inputs_mut()[index * stride(n_inputs)..][..n_inputs];
            for (to, row) in to.iter_mut().zip(linear.chunks_exact(n_inputs + 1)) {
                // in double precision: terms of fast sampling nearly cancel each other
                let terms = row.iter().zip(x).map(|(weight, x)| f64::from(*weight) * f64::from(*x));
                *to = (terms.sum::<f64>() + f64::from(row[n_inputs])) as f32;
            }
            let added = &workspace.outputs()[index * stride(n_outputs)..];
            for ((to, gain), added) in to.iter_mut().zip(gains).zip(added) {
                *to = (*to + gain * added).clamp(-LIMIT, LIMIT);
            }
        }
        let pairs = predictions[part.clone()].chunks_exact(n_outputs).zip(deltas[part].chunks_exact_mut(n_outputs));
        let losses = pairs.zip(self.numbers).map(|((found, deltas), &number)| {
            let targets = &self.rows.outputs()[self.row(number, j) * n_outputs..][..n_outputs];
            self.function.row(found, targets, scale, deltas)
        });
        losses.sum()
    }

    /// Gives the network's outputs at row `j` their deltas.
    fn set_deltas(&self, j: usize, unrolled: &mut Unrolled) {
        let n_outputs = self.rows.n_outputs();
        let Unrolled { workspaces, predictions, deltas, .. } = unrolled;
        let (_, to) = workspaces[j].outputs_and_deltas();
        let rows = deltas[self.part(j)].chunks_exact_mut(n_outputs);
        let rows = rows.zip(predictions[self.part(j)].chunks_exact(n_outputs));
        for (to, (deltas, found)) in to.chunks_exact_mut(stride(n_outputs)).zip(rows) {
            for (index, delta) in deltas.iter_mut().enumerate() {
                // what was kept at the limit does not move
                *delta = if found[index].abs() < LIMIT { *delta } else { 0.0 };
                to[index] = self.recurrence.gains[index] * *delta;
            }
        }
    }

    /// Adds to the deltas of earlier rows what their predictions did at row `j`.
    fn spread(&self, j: usize, unrolled: &mut Unrolled) {
        let (n_inputs, n_outputs) = (self.rows.n_inputs(), self.rows.n_outputs());
        let columns = self.recurrence.history.min(j) * n_outputs;
        if columns == 0 {
            return;
        }
        let Unrolled { workspaces, deltas, of_past, .. } = unrolled;
        let count = self.numbers.len();
        let of_past = &mut of_past[..count * columns];
        self.network.input_deltas(count, &mut workspaces[j], columns, of_past);
        let (before, now) = deltas.split_at_mut(self.part(j).start);
        for (index, of_past) in of_past.chunks_exact_mut(columns).enumerate() {
            let now = &now[index * n_outputs..][..n_outputs];
            for (delta, row) in now.iter().zip(self.recurrence.linear.chunks_exact(n_inputs + 1)) {
                of_past.iter_mut().zip(row).for_each(|(to, weight)| *to += delta * weight);
            }
            for (lag, of_past) in of_past.chunks_exact(n_outputs).enumerate() {
                let begin = self.part(j - 1 - lag).start + index * n_outputs;
                before[begin..begin + n_outputs].iter_mut().zip(of_past).for_each(|(to, more)| *to += more);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        network::Network,
        study::{NetworkOptions, TrainingOptions},
    };

    /// 40 rows of two outputs that are fed back for three rows, and one more input.
    fn rows(stretch: usize) -> TrainingRows {
        let (n_inputs, n_outputs, count) = (7, 2, 40);
        let value = |index: usize| 2.0 * (0.618_034 * (index + 1) as f64).fract() as f32 - 1.0;
        let inputs = (0..count * n_inputs).map(value).collect();
        let outputs = (0..count * n_outputs).map(|index| value(3 * index + 11)).collect();
        let recurrence = Recurrence {
            history: 3,
            linear: (0..n_outputs * (n_inputs + 1)).map(|index| 0.4 * value(7 * index + 5)).collect(),
            gains: vec![0.5, 0.8],
            starts: vec![0, 7, 19, 30],
            stretch,
        };
        TrainingRows::new(n_inputs, n_outputs, inputs, outputs).unwrap().with_recurrence(recurrence)
    }

    /// The definition in double precision: the sum of squared errors.
    fn reference(rows: &TrainingRows, network: &Network, parameters: &[f64]) -> f64 {
        let recurrence = rows.recurrence().unwrap();
        let (n_inputs, n_outputs) = (rows.n_inputs(), rows.n_outputs());
        let sizes = network.sizes();
        let mut loss = 0.0;
        for &start in &recurrence.starts {
            let mut predictions: Vec<Vec<f64>> = Vec::new();
            for j in 0..recurrence.stretch {
                let row = start as usize + j;
                let mut x: Vec<f64> =
                    rows.inputs()[row * n_inputs..][..n_inputs].iter().map(|x| f64::from(*x)).collect();
                for lag in 0..recurrence.history.min(j) {
                    x[lag * n_outputs..][..n_outputs].copy_from_slice(&predictions[j - 1 - lag]);
                }
                let (mut values, mut rest) = (x.clone(), parameters);
                for (layer, pair) in sizes.windows(2).enumerate() {
                    let (weights, tail) = rest.split_at(pair[0] * pair[1]);
                    let (biases, tail) = tail.split_at(pair[1]);
                    let sums = weights.chunks(pair[0]).zip(biases).map(|(row, bias)| {
                        row.iter().zip(&values).map(|(weight, value)| weight * value).sum::<f64>() + bias
                    });
                    values = sums.map(|sum| if layer + 2 < sizes.len() { sum.tanh() } else { sum }).collect();
                    rest = tail;
                }
                let linear = recurrence.linear.chunks(n_inputs + 1).map(|row| {
                    let terms = row.iter().zip(&x).map(|(weight, x)| f64::from(*weight) * x);
                    terms.sum::<f64>() + f64::from(row[n_inputs])
                });
                let gains = recurrence.gains.iter().zip(&values).map(|(gain, value)| f64::from(*gain) * value);
                let found: Vec<f64> = linear.zip(gains).map(|(linear, added)| linear + added).collect();
                let targets = &rows.outputs()[row * n_outputs..][..n_outputs];
                loss += found.iter().zip(targets).map(|(a, b)| (a - f64::from(*b)).powi(2)).sum::<f64>();
                predictions.push(found);
            }
        }
        loss
    }

    #[test]
    fn losses_and_gradients_are_those_of_the_definition_and_of_finite_differences() {
        let options = NetworkOptions { hidden: vec![9, 5], ..NetworkOptions::default() };
        let network = Network::new(7, 2, &options, 3).unwrap();
        let packed = Packed::new(&network);
        let function = LossFunction::new(&TrainingOptions::default(), 2);
        for stretch in [1, 2, 10] {
            let rows = rows(stretch);
            let recurrence = rows.recurrence().unwrap();
            let block =
                StretchBlock { network: &packed, rows: &rows, recurrence, function: &function, numbers: &[0, 1, 2, 3] };
            let mut unrolled = Unrolled::new(&packed);
            let parameters: Vec<f64> = network.parameters().iter().map(|p| f64::from(*p)).collect();
            let expected = reference(&rows, &network, &parameters);
            let mut gradient = vec![f32::NAN; packed.layout.len()];
            let loss = block.gradient((1, 0), 1.0, Store::Replace, &mut unrolled, &mut gradient);
            assert!((loss - expected).abs() < 1e-5 * expected, "{loss} {expected}");
            assert!((block.loss(&mut unrolled) - expected).abs() < 1e-5 * expected);
            let mut plain = vec![0.0f32; parameters.len()];
            packed.layout.unpack(&gradient, &mut plain);
            let largest = plain.iter().fold(0.0f32, |largest, value| largest.max(value.abs()));
            for (index, found) in plain.iter().enumerate() {
                let moved = |h: f64| {
                    let mut parameters = parameters.clone();
                    parameters[index] += h;
                    reference(&rows, &network, &parameters)
                };
                let slope = (moved(1e-5) - moved(-1e-5)) / 2e-5;
                let difference = (f64::from(*found) - slope).abs();
                assert!(difference < 2e-5 * f64::from(largest), "{stretch} {index}: {found} {slope}");
            }
        }
    }
}
