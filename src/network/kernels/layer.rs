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
    Lanes, Left, Panel, Register, Store, WIDTH,
    activation::{Derivative, Function, Gelu, Identity, Relu, Sigmoid, Silu, Sine, Stored, Tanh},
    lanes, lanes_mut, product,
};
use crate::network::layout::{Shape, padded, stride};
use metafmu_runtime::Activation;

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
    mut slopes: Option<&mut [f32]>,
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
    let left = Left { values: x, rows, inner: shape.inputs, row_stride: stride(shape.inputs), inner_stride: 1 };
    let (weight, bias) = shape.split(parameters);
    let distance = stride(shape.outputs);
    for (index, bias) in bias.as_chunks::<WIDTH>().0.iter().enumerate() {
        let panel = Panel { values: &weight[index * shape.inputs * WIDTH..], stride: WIDTH };
        // the biases of a normalised layer are added after the normalisation
        let start = if shape.normalized { Lanes::splat(0.0) } else { Lanes::load(bias) };
        let y = &mut y[index * WIDTH..];
        product::<R, N>(left, panel, start, Store::Replace, y, distance);
        let slopes = slopes.as_deref_mut().map(|slopes| &mut slopes[index * WIDTH..]);
        match activation {
            Activation::Tanh => activate::<R, N, Tanh>(rows, y, slopes, distance),
            Activation::Sigmoid => activate::<R, N, Sigmoid>(rows, y, slopes, distance),
            Activation::Relu => activate::<R, N, Relu>(rows, y, slopes, distance),
            Activation::Gelu => activate::<R, N, Gelu>(rows, y, slopes, distance),
            Activation::Silu => activate::<R, N, Silu>(rows, y, slopes, distance),
            Activation::Sine => activate::<R, N, Sine>(rows, y, slopes, distance),
            Activation::Identity if slopes.is_none() => {}
            Activation::Identity => activate::<R, N, Identity>(rows, y, slopes, distance),
        }
    }
}

/// A panel's values replaced by the activation, and its derivative into `slopes`.
#[inline(always)]
fn activate<R: Register, const N: usize, F: Function>(
    rows: usize,
    y: &mut [f32],
    slopes: Option<&mut [f32]>,
    distance: usize,
) {
    match slopes {
        None => {
            for row in 0..rows {
                let y = lanes_mut(y, row * distance);
                F::value(Lanes::<R, N>::load(y)).store(y);
            }
        }
        Some(slopes) => {
            for row in 0..rows {
                let y = lanes_mut(y, row * distance);
                let (value, slope) = F::value_and_slope(Lanes::<R, N>::load(y));
                value.store(y);
                slope.store(lanes_mut(slopes, row * distance));
            }
        }
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

/// `d_x = (d W) f'`; `transposed`: the weights as [`Piece::transpose`] leaves them.
#[inline(always)]
pub(crate) fn backward<R: Register, const N: usize>(
    shape: &Shape,
    parameters: &[f32],
    transposed: &[f32],
    slope: Slope,
    rows: usize,
    d: &[f32],
    d_x: &mut [f32],
) {
    let weights = if shape.by_rows { shape.split(parameters).0 } else { shape.transposed(transposed) };
    let left = Left { values: d, rows, inner: shape.outputs, row_stride: stride(shape.outputs), inner_stride: 1 };
    let distance = stride(shape.inputs);
    for begin in (0..padded(shape.inputs)).step_by(WIDTH) {
        let panel = if shape.by_rows {
            Panel { values: &weights[begin..], stride: padded(shape.inputs) }
        } else {
            Panel { values: &weights[begin * shape.outputs..], stride: WIDTH }
        };
        let d_x = &mut d_x[begin..];
        product::<R, N>(left, panel, Lanes::splat(0.0), Store::Replace, d_x, distance);
        match slope {
            Slope::OfValue(Activation::Tanh, y) => derive::<R, N, Tanh>(rows, &y[begin..], d_x, distance),
            Slope::OfValue(Activation::Sigmoid, y) => derive::<R, N, Sigmoid>(rows, &y[begin..], d_x, distance),
            Slope::OfValue(Activation::Relu, y) => derive::<R, N, Relu>(rows, &y[begin..], d_x, distance),
            // of the identity; the others store theirs
            Slope::OfValue(..) => {}
            Slope::Stored(slopes) => derive::<R, N, Stored>(rows, &slopes[begin..], d_x, distance),
        }
    }
}

/// A panel's values multiplied by the derivative of the activation.
#[inline(always)]
fn derive<R: Register, const N: usize, D: Derivative>(rows: usize, from: &[f32], d: &mut [f32], distance: usize) {
    for row in 0..rows {
        let from = Lanes::<R, N>::load(lanes(from, row * distance));
        let d = lanes_mut(d, row * distance);
        D::times(Lanes::load(d), from).store(d);
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
        product::<R, N>(left, panel, Lanes::splat(0.0), store, &mut weight[begin..], distance);
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
    for (index, bias) in bias.as_chunks_mut::<WIDTH>().0.iter_mut().enumerate() {
        let mut sum = Lanes::<R, N>::splat(0.0);
        for row in 0..rows {
            sum = sum.add(Lanes::load(lanes(d, row * d_stride + index * WIDTH)));
        }
        store.put(sum, bias);
    }
}
