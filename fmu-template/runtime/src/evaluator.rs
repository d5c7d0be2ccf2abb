//! The surrogate prepared for evaluation.

use crate::{
    Activation, Layer, Scaling, Surrogate, activation,
    simd::{Lanes, PORTABLE_FMA, Simd, fma},
};

/// A [`Surrogate`] laid out for fast evaluation in double precision. Immutable: any number of threads may share it,
/// each with a [`Scratch`] of its own.
#[derive(Clone, Debug)]
pub struct Evaluator {
    scaling: Scaling,
    activation: Activation,
    hidden: Vec<Dense>,
    last: Rows,
    simd: Simd,
}

/// Working memory of one evaluation at a time.
#[derive(Clone, Debug)]
pub struct Scratch {
    current: Vec<Lanes>,
    next: Vec<Lanes>,
}

/// `W x + b` with the rows of `W` padded to whole blocks of [`BLOCK`] lanes.
///
/// `weights[(block * inputs + column) * BLOCK + lane]`: an evaluation reads them from first to last.
#[derive(Clone, Debug)]
struct Dense {
    inputs: usize,
    weights: Vec<Lanes>,
    bias: Vec<Lanes>,
}

/// `W x + b` row by row, with the columns of `W` padded to whole lanes: for the last layer, which has few rows.
///
/// `weights[row * lanes + lane]`
#[derive(Clone, Debug)]
struct Rows {
    inputs: usize,
    lanes: usize,
    weights: Vec<Lanes>,
    bias: Vec<f64>,
}

/// Accumulators kept in registers at a time; enough to hide the latency of a fused multiply-add.
const BLOCK: usize = 4;

impl Evaluator {
    /// Lays out the weights and chooses the instruction set.
    ///
    /// # Panics
    /// Never: a surrogate has at least one layer.
    pub fn new(surrogate: &Surrogate) -> Self {
        let (last, hidden) = surrogate.layers().split_last().expect("a surrogate has at least one layer");
        Self {
            scaling: surrogate.scaling().clone(),
            activation: surrogate.metadata().activation,
            hidden: hidden.iter().map(Dense::new).collect(),
            last: Rows::new(last),
            simd: Simd::detect(),
        }
    }

    /// Working memory that fits this evaluator.
    pub fn scratch(&self) -> Scratch {
        let inputs = self.scaling.input_mean.len().div_ceil(Lanes::WIDTH);
        let widest = self.hidden.iter().map(|layer| layer.bias.len()).fold(inputs, usize::max);
        Scratch { current: vec![Lanes::ZERO; widest], next: vec![Lanes::ZERO; widest] }
    }

    /// Outputs at one point: `inputs` has one value per input column, `outputs` one per output column. Allocates nothing.
    ///
    /// # Panics
    /// If a slice has the wrong length or `scratch` belongs to another evaluator.
    pub fn evaluate(&self, inputs: &[f64], outputs: &mut [f64], scratch: &mut Scratch) {
        assert_eq!(inputs.len(), self.scaling.input_mean.len(), "number of inputs");
        assert_eq!(outputs.len(), self.scaling.output_mean.len(), "number of outputs");
        match self.simd {
            #[cfg(target_arch = "x86_64")]
            // SAFETY: `Simd::detect` found these features
            Simd::Avx512 => unsafe { self.run_avx512(inputs, outputs, scratch) },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: as above
            Simd::Avx2 => unsafe { self.run_avx2(inputs, outputs, scratch) },
            Simd::Portable => self.run::<PORTABLE_FMA>(inputs, outputs, scratch),
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx512f,avx512dq,avx2,fma")]
    fn run_avx512(&self, inputs: &[f64], outputs: &mut [f64], scratch: &mut Scratch) {
        self.run::<true>(inputs, outputs, scratch);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    fn run_avx2(&self, inputs: &[f64], outputs: &mut [f64], scratch: &mut Scratch) {
        self.run::<true>(inputs, outputs, scratch);
    }

    #[inline(always)]
    fn run<const FMA: bool>(&self, inputs: &[f64], outputs: &mut [f64], scratch: &mut Scratch) {
        let Scratch { current, next } = scratch;
        let Scaling { input_mean, input_scale, output_mean, output_scale } = &self.scaling;
        let standardised = flat_mut(current).iter_mut().zip(inputs).zip(input_mean).zip(input_scale);
        for (((z, x), mean), scale) in standardised {
            *z = (x - mean) / scale;
        }
        for layer in &self.hidden {
            layer.apply::<FMA>(current, next);
            activate::<FMA>(self.activation, &mut next[..layer.bias.len()]);
            std::mem::swap(current, next);
        }
        self.last.apply::<FMA>(current, outputs);
        for ((y, mean), scale) in outputs.iter_mut().zip(output_mean).zip(output_scale) {
            *y = fma::<FMA>(*y, *scale, *mean);
        }
    }
}

impl Dense {
    fn new(layer: &Layer) -> Self {
        let rows_per_block = BLOCK * Lanes::WIDTH;
        let blocks = layer.outputs.div_ceil(rows_per_block);
        let mut weights = vec![Lanes::ZERO; blocks * layer.inputs * BLOCK];
        let mut bias = vec![Lanes::ZERO; blocks * BLOCK];
        flat_mut(&mut bias)[..layer.outputs]
            .iter_mut()
            .zip(&layer.bias)
            .for_each(|(double, &single)| *double = single.into());
        for (row, values) in layer.weight.chunks_exact(layer.inputs).enumerate() {
            let (block, within) = (row / rows_per_block, row % rows_per_block);
            for (column, &value) in values.iter().enumerate() {
                let lanes = (block * layer.inputs + column) * BLOCK + within / Lanes::WIDTH;
                weights[lanes].0[within % Lanes::WIDTH] = value.into();
            }
        }
        Self { inputs: layer.inputs, weights, bias }
    }

    #[inline(always)]
    fn apply<const FMA: bool>(&self, input: &[Lanes], output: &mut [Lanes]) {
        let input = &flat(input)[..self.inputs];
        let weights = self.weights.as_chunks::<BLOCK>().0.chunks_exact(self.inputs);
        let bias = self.bias.as_chunks::<BLOCK>().0;
        for ((result, bias), weights) in output.as_chunks_mut::<BLOCK>().0.iter_mut().zip(bias).zip(weights) {
            let mut sum = *bias;
            for (x, column) in input.iter().zip(weights) {
                for (sum, column) in sum.iter_mut().zip(column) {
                    for (sum, w) in sum.0.iter_mut().zip(&column.0) {
                        *sum = fma::<FMA>(*w, *x, *sum);
                    }
                }
            }
            *result = sum;
        }
    }
}

impl Rows {
    fn new(layer: &Layer) -> Self {
        let lanes = layer.inputs.div_ceil(Lanes::WIDTH);
        let mut weights = vec![Lanes::ZERO; lanes * layer.outputs];
        let rows = flat_mut(&mut weights).chunks_exact_mut(lanes * Lanes::WIDTH);
        for (padded, row) in rows.zip(layer.weight.chunks_exact(layer.inputs)) {
            padded.iter_mut().zip(row).for_each(|(double, &single)| *double = single.into());
        }
        let bias = layer.bias.iter().map(|&bias| bias.into()).collect();
        Self { inputs: layer.inputs, lanes, weights, bias }
    }

    #[inline(always)]
    fn apply<const FMA: bool>(&self, input: &mut [Lanes], output: &mut [f64]) {
        let input = &mut input[..self.lanes];
        // what an earlier evaluation left behind the last column may be NaN, which no weight of zero takes away
        flat_mut(input)[self.inputs..].fill(0.0);
        let rows = self.weights.chunks_exact(self.lanes);
        for ((y, bias), row) in output.iter_mut().zip(&self.bias).zip(rows) {
            *y = bias + dot::<FMA>(input, row);
        }
    }
}

#[inline(always)]
fn dot<const FMA: bool>(a: &[Lanes], b: &[Lanes]) -> f64 {
    let mut sums = [Lanes::ZERO; BLOCK];
    for (a, b) in a.chunks(BLOCK).zip(b.chunks(BLOCK)) {
        for (sum, (a, b)) in sums.iter_mut().zip(a.iter().zip(b)) {
            for (sum, (a, b)) in sum.0.iter_mut().zip(a.0.iter().zip(&b.0)) {
                *sum = fma::<FMA>(*a, *b, *sum);
            }
        }
    }
    let [first, others @ ..] = &mut sums;
    for other in others {
        first.0.iter_mut().zip(&other.0).for_each(|(sum, other)| *sum += other);
    }
    first.0.iter().sum()
}

#[inline(always)]
fn activate<const FMA: bool>(activation: Activation, values: &mut [Lanes]) {
    match activation {
        Activation::Tanh => map(values, activation::tanh::<FMA>),
        Activation::Sigmoid => map(values, activation::sigmoid::<FMA>),
        Activation::Relu => map(values, activation::relu),
    }
}

#[inline(always)]
fn map(values: &mut [Lanes], function: impl Fn(f64) -> f64) {
    // over the doubles one after the other: over lanes, the compiler would vectorise across them, with gathers
    for value in flat_mut(values) {
        *value = function(*value);
    }
}

fn flat(lanes: &[Lanes]) -> &[f64] {
    // SAFETY: `Lanes` is `repr(C)` around `[f64; WIDTH]` and as large as it, so the doubles lie one after the other
    unsafe { std::slice::from_raw_parts(lanes.as_ptr().cast(), lanes.len() * Lanes::WIDTH) }
}

fn flat_mut(lanes: &mut [Lanes]) -> &mut [f64] {
    // SAFETY: as in `flat`, and the borrow is exclusive
    unsafe { std::slice::from_raw_parts_mut(lanes.as_mut_ptr().cast(), lanes.len() * Lanes::WIDTH) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::example;

    /// The textbook formulas, one scalar at a time.
    fn reference(surrogate: &Surrogate, inputs: &[f64]) -> Vec<f64> {
        let scaling = surrogate.scaling();
        let act = |x: f64| match surrogate.metadata().activation {
            Activation::Tanh => x.tanh(),
            Activation::Sigmoid => 1.0 / (1.0 + (-x).exp()),
            Activation::Relu => x.max(0.0),
        };
        let mut h: Vec<f64> =
            (0..inputs.len()).map(|i| (inputs[i] - scaling.input_mean[i]) / scaling.input_scale[i]).collect();
        for (index, layer) in surrogate.layers().iter().enumerate() {
            let last = index + 1 == surrogate.layers().len();
            h = (0..layer.outputs)
                .map(|o| {
                    let row = &layer.weight[o * layer.inputs..][..layer.inputs];
                    let sum: f64 = row.iter().zip(&h).map(|(&w, x)| f64::from(w) * x).sum();
                    let z = sum + f64::from(layer.bias[o]);
                    if last { z } else { act(z) }
                })
                .collect();
        }
        (0..h.len()).map(|o| scaling.output_mean[o] + scaling.output_scale[o] * h[o]).collect()
    }

    #[test]
    fn every_instruction_set_agrees_with_the_textbook_formula() {
        for activation in [Activation::Tanh, Activation::Sigmoid, Activation::Relu] {
            for hidden in [vec![], vec![1], vec![7, 33], vec![128, 128], vec![64, 64, 64]] {
                let surrogate = example::with_network(&hidden, activation);
                let mut evaluator = Evaluator::new(&surrogate);
                let (mut scratch, mut outputs) = (evaluator.scratch(), [0.0; 2]);
                for inputs in [[0.15, 0.3, 1.0], [0.1, 0.0, 0.0], [0.2, 5.0, 2.0]] {
                    let expected = reference(&surrogate, &inputs);
                    for simd in Simd::available() {
                        evaluator.simd = simd;
                        evaluator.evaluate(&inputs, &mut outputs, &mut scratch);
                        for (found, expected) in outputs.iter().zip(&expected) {
                            let difference = (found - expected).abs();
                            assert!(difference < 1e-13, "{activation:?} {hidden:?} {simd:?}: {difference:e}");
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn an_evaluation_at_nan_leaves_nothing_behind() {
        for hidden in [vec![], vec![7], vec![7, 33]] {
            let evaluator = Evaluator::new(&example::with_network(&hidden, Activation::Relu));
            let (mut scratch, mut outputs, mut expected) = (evaluator.scratch(), [0.0; 2], [0.0; 2]);
            evaluator.evaluate(&[0.15, 0.3, 1.0], &mut expected, &mut scratch);
            for _ in 0..2 {
                evaluator.evaluate(&[f64::NAN; 3], &mut outputs, &mut scratch);
                assert!(outputs[0].is_nan());
            }
            evaluator.evaluate(&[0.15, 0.3, 1.0], &mut outputs, &mut scratch);
            assert_eq!(outputs, expected, "{hidden:?}");
        }
    }

    #[test]
    fn outputs_are_smooth_enough_to_be_differenced() {
        let surrogate = example::with_network(&[128, 128], Activation::Tanh);
        let evaluator = Evaluator::new(&surrogate);
        let (mut scratch, mut y) = (evaluator.scratch(), [0.0; 2]);
        let mut at = |t: f64| {
            evaluator.evaluate(&[0.15, 0.3, t], &mut y, &mut scratch);
            y[0]
        };
        // central differences of two step sizes agree to their truncation error plus rounding: eps * |y| / h
        let coarse = (at(1.0 + 1e-4) - at(1.0 - 1e-4)) / 2e-4;
        let fine = (at(1.0 + 1e-5) - at(1.0 - 1e-5)) / 2e-5;
        assert!((coarse - fine).abs() < 1e-7 * coarse.abs().max(1.0), "{coarse} {fine}");
    }
}
