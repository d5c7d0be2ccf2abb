//! Passes of rows together with their derivatives along some directions, for a loss of both (Czarnecki and others 2017, "Sobolev
//! Training").
//!
//! ```text
//! rows       values x [rows], then tangents t_k [rows] of each direction k, one block
//! forward    y = f(x W^T + b),  u_k = f'(x W^T + b) (t_k W^T)
//! backward   d_x = f' d_y W' + (f'' / f') sum over k of u_k d_(u_k) W',  likewise d_(t_k) = f' d_(u_k) W'
//! ```
//!
//! `f'` and `f'' / f'` are to follow from `f`, as those of tanh do: nothing but the values is stored.

use super::{
    kernels::{
        SimdKernel, SimdLanes, Store, WIDTH,
        activation::{ActivationFunction, Derivative, IdentityActivation, SigmoidActivation, TanhActivation},
        lanes, lanes_mut,
        layer::{self, Slope},
    },
    layout::{LayerShape, padded, stride},
    pass::{BLOCK_ROWS, Packed, Workspace},
};
use metafmu_runtime::Activation;

/// An activation whose second derivative follows from its value.
trait Curved: ActivationFunction {
    /// `f'' / f'`.
    fn bend<L: SimdLanes>(value: L) -> L;
}

impl Curved for TanhActivation {
    #[inline(always)]
    fn bend<L: SimdLanes>(value: L) -> L {
        L::splat(-2.0).mul(value)
    }
}

impl Curved for SigmoidActivation {
    #[inline(always)]
    fn bend<L: SimdLanes>(value: L) -> L {
        L::splat(-2.0).mul_add(value, L::splat(1.0))
    }
}

impl Curved for IdentityActivation {
    #[inline(always)]
    fn bend<L: SimdLanes>(_: L) -> L {
        L::splat(0.0)
    }
}

/// Number of rows that pass together with this number of directions.
pub(crate) fn block_rows(directions: usize) -> usize {
    BLOCK_ROWS / (1 + directions)
}

impl Packed {
    /// Returns true if rows with this number of directions can pass: with smooth activations whose derivatives follow
    /// from their values, without normalization and dropout.
    pub(crate) fn takes_tangents(&self, directions: usize) -> bool {
        let is_curved = matches!(self.activation, Activation::Tanh | Activation::Sigmoid | Activation::Identity);
        is_curved && !self.stores_slopes() && block_rows(directions) > 0
    }

    /// As [`forward`](Self::forward), of `rows` rows and their directions.
    pub(crate) fn forward_with_tangents(&self, (rows, directions): (usize, usize), workspace: &mut Workspace) {
        workspace.simd.run(TangentForward { network: self, rows, directions, workspace });
    }

    /// As [`backward`](Self::backward), of what [`forward_with_tangents`](Self::forward_with_tangents) left.
    pub(crate) fn backward_with_tangents(
        &self,
        (rows, directions): (usize, usize),
        workspace: &mut Workspace,
        store: Store,
        gradient: &mut [f32],
    ) {
        workspace.simd.run(TangentBackward { network: self, rows, directions, workspace, store, gradient });
    }
}

struct TangentForward<'a> {
    network: &'a Packed,
    rows: usize,
    directions: usize,
    workspace: &'a mut Workspace,
}

impl SimdKernel for TangentForward<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: SimdLanes>(self) {
        let Self { network, rows, directions, workspace } = self;
        let last = network.layout.shapes.len() - 1;
        for (index, shape) in network.layout.shapes.iter().enumerate() {
            let (before, after) = workspace.values.split_at_mut(index + 1);
            let (x, y) = (&before[index], &mut *after[0]);
            let all = rows * (1 + directions);
            layer::forward::<L>(shape, &network.parameters, Activation::Identity, all, x, y, None);
            let bias = shape.split(&network.parameters).1;
            // a tangent has no bias
            let distance = stride(shape.outputs);
            for tangent in y.chunks_exact_mut(distance).take(all).skip(rows) {
                tangent[..shape.outputs].iter_mut().zip(bias).for_each(|(tangent, bias)| *tangent -= bias);
            }
            if index < last {
                match network.activation {
                    Activation::Tanh => activate::<L, TanhActivation>(shape, rows, directions, y),
                    Activation::Sigmoid => activate::<L, SigmoidActivation>(shape, rows, directions, y),
                    _ => activate::<L, IdentityActivation>(shape, rows, directions, y),
                }
            }
        }
    }
}

/// Replaces values by the activation, and multiplies tangents by its derivative.
#[inline(always)]
fn activate<L: SimdLanes, F: Curved>(shape: &LayerShape, rows: usize, directions: usize, y: &mut [f32]) {
    let distance = stride(shape.outputs);
    for begin in (0..padded(shape.outputs)).step_by(WIDTH) {
        for row in 0..rows {
            let place = lanes_mut(y, row * distance + begin);
            let value = F::value(L::load(place));
            value.store(place);
            for direction in 1..=directions {
                let place = lanes_mut(y, (direction * rows + row) * distance + begin);
                F::Derivative::times(L::load(place), value).store(place);
            }
        }
    }
}

struct TangentBackward<'a> {
    network: &'a Packed,
    rows: usize,
    directions: usize,
    workspace: &'a mut Workspace,
    store: Store,
    gradient: &'a mut [f32],
}

impl SimdKernel for TangentBackward<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: SimdLanes>(self) {
        let Self { network, rows, directions, workspace, store, gradient } = self;
        let Workspace { values, deltas, bias: kept, .. } = workspace;
        for (index, shape) in network.layout.shapes.iter().enumerate().rev() {
            let (before, from) = deltas.split_at_mut(index);
            let (x, d) = (&*values[index], &*from[0]);
            // of the tangents first: they leave the biases as they are
            let biases = shape.outputs;
            match store {
                Store::Replace => kept[..biases].fill(0.0),
                _ => kept[..biases].copy_from_slice(&shape.split(gradient).1[..biases]),
            }
            let (of_x, of_d) = (&x[rows * stride(shape.inputs)..], &d[rows * stride(shape.outputs)..]);
            layer::gradient::<L>(shape, rows * directions, of_x, of_d, store, gradient);
            shape.split_mut(gradient).1[..biases].copy_from_slice(&kept[..biases]);
            layer::gradient::<L>(shape, rows, x, d, Store::Add, gradient);
            if let Some(to) = before.last_mut() {
                let none = Slope::FromValue(Activation::Identity, x);
                let (parameters, all) = (&network.parameters, rows * (1 + directions));
                layer::backward::<L>(shape, parameters, &network.transposed, none, all, d, to);
                match network.activation {
                    Activation::Tanh => bend::<L, TanhActivation>(shape.inputs, rows, directions, x, to),
                    Activation::Sigmoid => bend::<L, SigmoidActivation>(shape.inputs, rows, directions, x, to),
                    _ => bend::<L, IdentityActivation>(shape.inputs, rows, directions, x, to),
                }
            }
        }
    }
}

/// Turns derivatives by an activation's outputs `y` into derivatives by its inputs.
#[inline(always)]
fn bend<L: SimdLanes, F: Curved>(nodes: usize, rows: usize, directions: usize, y: &[f32], d: &mut [f32]) {
    let distance = stride(nodes);
    for begin in (0..padded(nodes)).step_by(WIDTH) {
        for row in 0..rows {
            let value = L::load(lanes(y, row * distance + begin));
            let mut sum = L::splat(0.0);
            for direction in 1..=directions {
                let at = (direction * rows + row) * distance + begin;
                let place = lanes_mut(d, at);
                let delta = L::load(place);
                sum = L::load(lanes(y, at)).mul_add(delta, sum);
                F::Derivative::times(delta, value).store(place);
            }
            let place = lanes_mut(d, row * distance + begin);
            F::bend(value).mul_add(sum, F::Derivative::times(L::load(place), value)).store(place);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        network::{Network, kernels::InstructionSet},
        study::NetworkOptions,
    };

    /// Numbers spread over (-1, 1).
    fn spread(count: usize, first: f64) -> Vec<f32> {
        (0..count).map(|i| 2.0 * ((i as f64 + first) * 0.618_033_988_749_894_9).fract() as f32 - 1.0).collect()
    }

    /// Values and tangents of a row, by the textbook formula in double precision.
    fn reference(sizes: &[usize], activation: Activation, parameters: &[f64], rows: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let (mut rows, mut rest) = (rows.to_vec(), parameters);
        for (index, pair) in sizes.windows(2).enumerate() {
            let (weight, tail) = rest.split_at(pair[0] * pair[1]);
            let (bias, tail) = tail.split_at(pair[1]);
            rest = tail;
            let product = |x: &Vec<f64>| -> Vec<f64> {
                weight.chunks(pair[0]).map(|row| row.iter().zip(x).map(|(w, x)| w * x).sum()).collect()
            };
            rows = rows.iter().map(product).collect();
            rows[0].iter_mut().zip(bias).for_each(|(z, bias)| *z += bias);
            if index + 2 < sizes.len() {
                let (values, tangents) = rows.split_at_mut(1);
                for (node, z) in values[0].iter_mut().enumerate() {
                    let (value, slope) = match activation {
                        Activation::Tanh => (z.tanh(), 1.0 - z.tanh().powi(2)),
                        Activation::Sigmoid => {
                            let s = 1.0 / (1.0 + (-*z).exp());
                            (s, s * (1.0 - s))
                        }
                        _ => (*z, 1.0),
                    };
                    *z = value;
                    tangents.iter_mut().for_each(|tangent| tangent[node] *= slope);
                }
            }
        }
        rows
    }

    #[test]
    fn values_tangents_and_gradients_agree_with_the_textbook_formula_in_double_precision() {
        for (activation, outputs, directions) in
            [(Activation::Tanh, 2, 2), (Activation::Sigmoid, 11, 1), (Activation::Identity, 3, 3)]
        {
            let (inputs, rows) = (4, 5);
            let options = NetworkOptions { hidden: vec![9, 37], activation, ..NetworkOptions::default() };
            let network = Network::new(inputs, outputs, &options, 1).unwrap();
            let all = rows * (1 + directions);
            let (x, weights) = (spread(all * inputs, 1.0), spread(all * outputs, 7.0));
            // row by row: values and tangents
            let of_row = |row: usize| -> Vec<Vec<f64>> {
                (0..=directions)
                    .map(|part| x[(part * rows + row) * inputs..][..inputs].iter().map(|&x| x.into()).collect())
                    .collect()
            };
            let loss = |parameters: &[f64]| -> f64 {
                let of = |row: usize| {
                    let found = reference(network.sizes(), activation, parameters, &of_row(row));
                    let parts = found.iter().enumerate().map(|(part, values)| {
                        let weights = &weights[(part * rows + row) * outputs..][..outputs];
                        values.iter().zip(weights).map(|(value, weight)| value * f64::from(*weight)).sum::<f64>()
                    });
                    parts.sum::<f64>()
                };
                (0..rows).map(of).sum()
            };
            let packed = Packed::new(&network);
            assert!(packed.takes_tangents(directions) && !packed.takes_tangents(BLOCK_ROWS));
            let mut parameters: Vec<f64> = network.parameters().iter().map(|&p| p.into()).collect();
            for simd in InstructionSet::available() {
                let mut workspace = Workspace::new(&packed);
                workspace.simd = simd;
                for (to, row) in workspace.inputs_mut().chunks_mut(stride(inputs)).zip(x.chunks(inputs)) {
                    to[..inputs].copy_from_slice(row);
                }
                packed.forward_with_tangents((rows, directions), &mut workspace);
                let (found, deltas) = workspace.outputs_and_deltas();
                for (to, row) in deltas.chunks_mut(stride(outputs)).zip(weights.chunks(outputs)) {
                    to[..outputs].copy_from_slice(row);
                }
                for row in 0..rows {
                    let expected = reference(network.sizes(), activation, &parameters, &of_row(row));
                    for (part, expected) in expected.iter().enumerate() {
                        let found = &found[(part * rows + row) * stride(outputs)..];
                        for (found, expected) in found.iter().zip(expected) {
                            assert!((f64::from(*found) - expected).abs() < 2e-6, "{found} {expected}");
                        }
                    }
                }
                // twice: the second is added
                let mut packed_gradient = vec![f32::NAN; packed.layout.len()];
                packed.backward_with_tangents((rows, directions), &mut workspace, Store::Replace, &mut packed_gradient);
                let mut once = vec![0.0; parameters.len()];
                packed.layout.unpack(&packed_gradient, &mut once);
                for (to, row) in
                    workspace.outputs_and_deltas().1.chunks_mut(stride(outputs)).zip(weights.chunks(outputs))
                {
                    to[..outputs].copy_from_slice(row);
                }
                packed.backward_with_tangents((rows, directions), &mut workspace, Store::Add, &mut packed_gradient);
                let mut twice = vec![0.0; parameters.len()];
                packed.layout.unpack(&packed_gradient, &mut twice);
                let largest = once.iter().fold(0.0f32, |largest, g| largest.max(g.abs()));
                for index in 0..parameters.len() {
                    let (step, kept) = (1e-5, parameters[index]);
                    parameters[index] = kept + step;
                    let above = loss(&parameters);
                    parameters[index] = kept - step;
                    let below = loss(&parameters);
                    parameters[index] = kept;
                    let expected = (above - below) / (2.0 * step);
                    let error = (f64::from(once[index]) - expected).abs() / f64::from(largest);
                    assert!(error < 3e-6, "{simd:?} {activation:?} {index}: {} {expected}", once[index]);
                    assert!((twice[index] - 2.0 * once[index]).abs() <= 1e-5 * largest, "{index}");
                }
            }
        }
    }
}
