//! The passes through one layer, as products with everything else in the product's last step.
//!
//! ```text
//! forward    y [rows, outputs] = f(x W^T + b), and f' beside it where it does not follow from y
//! backward   d_x [rows, inputs] = (d W) f'     f' that of the layer before, which made x
//! gradient   dW = d^T x, db = sum over rows of d
//! ```
//!
//! `x`, `y` and `d` are row by row at a distance of [`stride`]; what is behind the last column is zero in `d` and harmless
//! in the others. The weights are laid out as [`Shape`] says.

use super::{
    Finish, Lanes, Left, Panel, Register, WIDTH,
    activation::{Derivative, Function, Gelu, Identity, Relu, Sigmoid, Silu, Sine, Stored, Tanh},
    product,
};
use crate::network::layout::{Shape, padded, stride};
use metafmu_runtime::Activation;
use std::marker::PhantomData;

/// What becomes of the values that stand in a gradient.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Store {
    Replace,
    Add,
}

/// What the backward pass multiplies by: the derivative of the activation `f` that made the layer's inputs.
#[derive(Clone, Copy)]
pub(crate) enum Slope<'a> {
    /// It follows from the activation's value.
    OfValue(Activation, &'a [f32]),
    /// It stands there.
    Stored(&'a [f32]),
}

/// Whether the derivative of an activation follows from its value.
pub(crate) fn slope_follows_from_value(activation: Activation) -> bool {
    match activation {
        Activation::Tanh | Activation::Sigmoid | Activation::Relu | Activation::Identity => true,
        Activation::Gelu | Activation::Silu | Activation::Sine => false,
    }
}

/// `y = f(x W^T + b)`, and `f'` into `slopes` where they are wanted; the slopes of a layer by rows are not written.
#[inline(always)]
pub(crate) fn forward<R: Register, const N: usize>(
    shape: &Shape,
    parameters: &[f32],
    activation: Activation,
    rows: usize,
    x: &[f32],
    y: &mut [f32],
    slopes: Option<&mut [f32]>,
) {
    if shape.by_rows {
        return match shape.outputs {
            1 => forward_by_rows::<R, N, 1>(shape, parameters, rows, x, y),
            2 => forward_by_rows::<R, N, 2>(shape, parameters, rows, x, y),
            3 => forward_by_rows::<R, N, 3>(shape, parameters, rows, x, y),
            4 => forward_by_rows::<R, N, 4>(shape, parameters, rows, x, y),
            5 => forward_by_rows::<R, N, 5>(shape, parameters, rows, x, y),
            6 => forward_by_rows::<R, N, 6>(shape, parameters, rows, x, y),
            7 => forward_by_rows::<R, N, 7>(shape, parameters, rows, x, y),
            _ => forward_by_rows::<R, N, 8>(shape, parameters, rows, x, y),
        };
    }
    match activation {
        Activation::Tanh => forward_by_panels::<R, N, Tanh>(shape, parameters, rows, x, y, slopes),
        Activation::Sigmoid => forward_by_panels::<R, N, Sigmoid>(shape, parameters, rows, x, y, slopes),
        Activation::Relu => forward_by_panels::<R, N, Relu>(shape, parameters, rows, x, y, slopes),
        Activation::Gelu => forward_by_panels::<R, N, Gelu>(shape, parameters, rows, x, y, slopes),
        Activation::Silu => forward_by_panels::<R, N, Silu>(shape, parameters, rows, x, y, slopes),
        Activation::Sine => forward_by_panels::<R, N, Sine>(shape, parameters, rows, x, y, slopes),
        Activation::Identity => forward_by_panels::<R, N, Identity>(shape, parameters, rows, x, y, slopes),
    }
}

#[inline(always)]
fn forward_by_panels<R: Register, const N: usize, F: Function>(
    shape: &Shape,
    parameters: &[f32],
    rows: usize,
    x: &[f32],
    y: &mut [f32],
    mut slopes: Option<&mut [f32]>,
) {
    let left = Left { values: x, rows, inner: shape.inputs, row_stride: stride(shape.inputs), inner_stride: 1 };
    let (weight, bias) = shape.split(parameters);
    let distance = stride(shape.outputs);
    for (index, bias) in bias.as_chunks::<WIDTH>().0.iter().enumerate() {
        let panel = Panel { values: &weight[index * shape.inputs * WIDTH..], stride: WIDTH };
        // the biases of a normalised layer are added after the normalisation
        let start = if shape.normalized { Lanes::splat(0.0) } else { Lanes::load(bias) };
        let y = &mut y[index * WIDTH..];
        if let Some(slopes) = &mut slopes {
            let slopes = &mut slopes[index * WIDTH..];
            let mut activate = ActivateWithSlope { y, slopes, stride: distance, function: PhantomData::<F> };
            product::<R, N>(left, panel, start, &mut activate);
        } else {
            let mut activate = Activate { y, stride: distance, function: PhantomData::<F> };
            product::<R, N>(left, panel, start, &mut activate);
        }
    }
}

struct Activate<'a, F> {
    y: &'a mut [f32],
    stride: usize,
    function: PhantomData<F>,
}

impl<R: Register, const N: usize, F: Function> Finish<R, N> for Activate<'_, F> {
    #[inline(always)]
    fn finish(&mut self, row: usize, sum: Lanes<R, N>) {
        F::value(sum).store(lanes_mut(self.y, row * self.stride));
    }
}

struct ActivateWithSlope<'a, F> {
    y: &'a mut [f32],
    slopes: &'a mut [f32],
    stride: usize,
    function: PhantomData<F>,
}

impl<R: Register, const N: usize, F: Function> Finish<R, N> for ActivateWithSlope<'_, F> {
    #[inline(always)]
    fn finish(&mut self, row: usize, sum: Lanes<R, N>) {
        let (value, slope) = F::value_and_slope(sum);
        value.store(lanes_mut(self.y, row * self.stride));
        slope.store(lanes_mut(self.slopes, row * self.stride));
    }
}

/// With few outputs, the products are along the inputs.
#[inline(always)]
fn forward_by_rows<R: Register, const N: usize, const OUTPUTS: usize>(
    shape: &Shape,
    parameters: &[f32],
    rows: usize,
    x: &[f32],
    y: &mut [f32],
) {
    let (weight, bias) = shape.split(parameters);
    let panels = padded(shape.inputs) / WIDTH;
    let weight = weight.as_chunks::<WIDTH>().0;
    let x = x.chunks_exact(stride(shape.inputs));
    for (x, y) in x.zip(y.chunks_exact_mut(stride(shape.outputs))).take(rows) {
        let mut sums = [Lanes::<R, N>::splat(0.0); OUTPUTS];
        for (panel, x) in x.as_chunks::<WIDTH>().0[..panels].iter().enumerate() {
            let x = Lanes::load(x);
            for (output, sum) in sums.iter_mut().enumerate() {
                *sum = x.mul_add(Lanes::load(&weight[output * panels + panel]), *sum);
            }
        }
        for (output, sum) in sums.into_iter().enumerate() {
            y[output] = sum.sum() + bias[output];
        }
    }
}

/// `d_x = (d W) f'`; `turned`: the weights as [`Shape::turn`] leaves them.
#[inline(always)]
pub(crate) fn backward<R: Register, const N: usize>(
    shape: &Shape,
    parameters: &[f32],
    turned: &[f32],
    slope: Slope,
    rows: usize,
    d: &[f32],
    d_x: &mut [f32],
) {
    let weights = if shape.by_rows { shape.split(parameters).0 } else { shape.turned(turned) };
    match slope {
        Slope::OfValue(Activation::Tanh, y) => backward_by_panels::<R, N, Tanh>(shape, weights, rows, d, y, d_x),
        Slope::OfValue(Activation::Sigmoid, y) => backward_by_panels::<R, N, Sigmoid>(shape, weights, rows, d, y, d_x),
        Slope::OfValue(Activation::Relu, y) => backward_by_panels::<R, N, Relu>(shape, weights, rows, d, y, d_x),
        // the others store theirs
        Slope::OfValue(_, y) => backward_by_panels::<R, N, Identity>(shape, weights, rows, d, y, d_x),
        Slope::Stored(slopes) => backward_by_panels::<R, N, Stored>(shape, weights, rows, d, slopes, d_x),
    }
}

#[inline(always)]
fn backward_by_panels<R: Register, const N: usize, D: Derivative>(
    shape: &Shape,
    weights: &[f32],
    rows: usize,
    d: &[f32],
    from: &[f32],
    d_x: &mut [f32],
) {
    let left = Left { values: d, rows, inner: shape.outputs, row_stride: stride(shape.outputs), inner_stride: 1 };
    for index in 0..padded(shape.inputs) / WIDTH {
        let panel = if shape.by_rows {
            Panel { values: &weights[index * WIDTH..], stride: padded(shape.inputs) }
        } else {
            Panel { values: &weights[index * shape.outputs * WIDTH..], stride: WIDTH }
        };
        let (from, d_x) = (&from[index * WIDTH..], &mut d_x[index * WIDTH..]);
        let mut derive = Derive { from, d_x, stride: stride(shape.inputs), derivative: PhantomData::<D> };
        product::<R, N>(left, panel, Lanes::splat(0.0), &mut derive);
    }
}

struct Derive<'a, D> {
    from: &'a [f32],
    d_x: &'a mut [f32],
    stride: usize,
    derivative: PhantomData<D>,
}

impl<R: Register, const N: usize, D: Derivative> Finish<R, N> for Derive<'_, D> {
    #[inline(always)]
    fn finish(&mut self, row: usize, sum: Lanes<R, N>) {
        let from = Lanes::load(lanes(self.from, row * self.stride));
        D::times(sum, from).store(lanes_mut(self.d_x, row * self.stride));
    }
}

/// `dW = d^T x`, `db = sum over rows of d`, into or onto `gradient`, which is laid out as the parameters are.
#[inline(always)]
pub(crate) fn gradient<R: Register, const N: usize>(
    shape: &Shape,
    rows: usize,
    x: &[f32],
    d: &[f32],
    store: Store,
    gradient: &mut [f32],
) {
    let (weight, bias) = shape.split_mut(gradient);
    let (x_stride, d_stride) = (stride(shape.inputs), stride(shape.outputs));
    // what is at home in the rows of the result, and what is at home in its columns
    let (row_values, row_count, row_stride, column_values, column_stride, columns) = if shape.by_rows {
        (d, shape.outputs, d_stride, x, x_stride, padded(shape.inputs))
    } else {
        (x, shape.inputs, x_stride, d, d_stride, padded(shape.outputs))
    };
    let left = Left { values: row_values, rows: row_count, inner: rows, row_stride: 1, inner_stride: row_stride };
    for index in 0..columns / WIDTH {
        let panel = Panel { values: &column_values[index * WIDTH..], stride: column_stride };
        let (begin, distance) =
            if shape.by_rows { (index * WIDTH, columns) } else { (index * row_count * WIDTH, WIDTH) };
        let mut put = Put { store, to: &mut weight[begin..], stride: distance };
        product::<R, N>(left, panel, Lanes::splat(0.0), &mut put);
    }
    if shape.by_rows {
        // the inputs behind the last one are not zero after every activation
        for row in weight.chunks_exact_mut(columns) {
            row[shape.inputs..].fill(0.0);
        }
    }
    if shape.normalized {
        // the biases are added after the normalisation, which has dealt with them
        return;
    }
    let mut put = Put { store, to: bias, stride: WIDTH };
    for index in 0..padded(shape.outputs) / WIDTH {
        let mut sum = Lanes::<R, N>::splat(0.0);
        for row in 0..rows {
            sum = sum.add(Lanes::load(lanes(d, row * d_stride + index * WIDTH)));
        }
        put.finish(index, sum);
    }
}

pub(super) struct Put<'a> {
    pub(super) store: Store,
    pub(super) to: &'a mut [f32],
    pub(super) stride: usize,
}

impl<R: Register, const N: usize> Finish<R, N> for Put<'_> {
    #[inline(always)]
    fn finish(&mut self, row: usize, sum: Lanes<R, N>) {
        let to = lanes_mut(self.to, row * self.stride);
        match self.store {
            Store::Replace => sum.store(to),
            Store::Add => Lanes::load(to).add(sum).store(to),
        }
    }
}

/// The [`WIDTH`] values from `at` on.
#[inline(always)]
pub(super) fn lanes(values: &[f32], at: usize) -> &[f32; WIDTH] {
    &values[at..at + WIDTH].as_chunks::<WIDTH>().0[0]
}

#[inline(always)]
pub(super) fn lanes_mut(values: &mut [f32], at: usize) -> &mut [f32; WIDTH] {
    &mut values[at..at + WIDTH].as_chunks_mut::<WIDTH>().0[0]
}
