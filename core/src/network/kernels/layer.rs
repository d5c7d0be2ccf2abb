//! The passes through one layer, as products with everything else in the product's last step.
//!
//! ```text
//! forward    y [rows, outputs] = f(x W^T + b), and f' beside it where it does not follow from y
//! backward   d_x [rows, inputs] = (d W) f'     f' that of the layer before, which made x
//! gradient   dW = d^T x, db = sum over rows of d
//! ```
//!
//! `x`, `y` and `d` are row by row at a distance of [`stride`]; the padding after the last column is zero in `d` and harmless
//! in the others. The weights are laid out as [`LayerShape`] says.

use super::{
    Left, Panel, SimdLanes, Store, WIDTH,
    activation::{ActivationFunction, ActivationVisitor, Derivative, Stored, visit},
    lanes, lanes_mut, product,
};
use crate::network::layout::{LayerShape, padded, stride};
use metafmu_runtime::Activation;

/// Factor of the backward pass: the derivative of the activation `f` that made the layer's inputs.
#[derive(Clone, Copy)]
pub(crate) enum Slope<'a> {
    /// It follows from the activation's value.
    FromValue(Activation, &'a [f32]),
    /// It was stored in the forward pass.
    Stored(&'a [f32]),
}

/// `y = f(x W^T + b)`, and `f'` into `slopes` where they are wanted; the slopes of a layer by rows are not written.
#[inline(always)]
pub(crate) fn forward<L: SimdLanes>(
    shape: &LayerShape,
    parameters: &[f32],
    activation: Activation,
    rows: usize,
    x: &[f32],
    y: &mut [f32],
    mut slopes: Option<&mut [f32]>,
) {
    if shape.by_rows {
        return match shape.outputs {
            1 => forward_by_rows::<L, 1>(shape, parameters, rows, x, y),
            2 => forward_by_rows::<L, 2>(shape, parameters, rows, x, y),
            3 => forward_by_rows::<L, 3>(shape, parameters, rows, x, y),
            4 => forward_by_rows::<L, 4>(shape, parameters, rows, x, y),
            5 => forward_by_rows::<L, 5>(shape, parameters, rows, x, y),
            6 => forward_by_rows::<L, 6>(shape, parameters, rows, x, y),
            7 => forward_by_rows::<L, 7>(shape, parameters, rows, x, y),
            _ => forward_by_rows::<L, 8>(shape, parameters, rows, x, y),
        };
    }
    let left = Left { values: x, rows, inner: shape.inputs, row_stride: stride(shape.inputs), inner_stride: 1 };
    let (weight, bias) = shape.split(parameters);
    let distance = stride(shape.outputs);
    for (index, bias) in bias.as_chunks::<WIDTH>().0.iter().enumerate() {
        let panel = Panel { values: &weight[index * shape.inputs * WIDTH..], stride: WIDTH };
        // the biases of a normalized layer are added after the normalization
        let start = if shape.normalized { L::splat(0.0) } else { L::load(bias) };
        let y = &mut y[index * WIDTH..];
        product::<L>(left, panel, start, Store::Replace, y, distance);
        let slopes = slopes.as_deref_mut().map(|slopes| &mut slopes[index * WIDTH..]);
        if activation != Activation::Identity || slopes.is_some() {
            visit::<L, _>(activation, ActivatePanel { rows, y, slopes, distance });
        }
    }
}

/// Replaces a panel's values by the activation, and puts its derivative into `slopes`.
struct ActivatePanel<'a> {
    rows: usize,
    y: &'a mut [f32],
    slopes: Option<&'a mut [f32]>,
    distance: usize,
}

impl ActivationVisitor for ActivatePanel<'_> {
    type Output = ();

    #[inline(always)]
    fn visit<L: SimdLanes, F: ActivationFunction>(self) {
        let Self { rows, y, slopes, distance } = self;
        match slopes {
            None => {
                for row in 0..rows {
                    let y = lanes_mut(y, row * distance);
                    F::value(L::load(y)).store(y);
                }
            }
            Some(slopes) => {
                for row in 0..rows {
                    let y = lanes_mut(y, row * distance);
                    let (value, slope) = F::value_and_slope(L::load(y));
                    value.store(y);
                    slope.store(lanes_mut(slopes, row * distance));
                }
            }
        }
    }
}

/// With few outputs, the products are along the inputs.
#[inline(always)]
fn forward_by_rows<L: SimdLanes, const OUTPUTS: usize>(
    shape: &LayerShape,
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
        let mut sums = [L::splat(0.0); OUTPUTS];
        for (panel, x) in x.as_chunks::<WIDTH>().0[..panels].iter().enumerate() {
            let x = L::load(x);
            for (output, sum) in sums.iter_mut().enumerate() {
                *sum = x.mul_add(L::load(&weight[output * panels + panel]), *sum);
            }
        }
        for (output, sum) in sums.into_iter().enumerate() {
            y[output] = sum.sum() + bias[output];
        }
    }
}

/// `d_x = (d W) f'`; `transposed`: the weights as [`Piece::transpose`] leaves them.
#[inline(always)]
pub(crate) fn backward<L: SimdLanes>(
    shape: &LayerShape,
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
        product::<L>(left, panel, L::splat(0.0), Store::Replace, d_x, distance);
        match slope {
            Slope::FromValue(activation, y) => {
                visit::<L, _>(activation, Derive { rows, y: &y[begin..], d: d_x, distance });
            }
            Slope::Stored(slopes) => derive::<L, Stored>(rows, &slopes[begin..], d_x, distance),
        }
    }
}

/// Multiplies a panel's values by the derivative of the activation, given the activation's values.
struct Derive<'a> {
    rows: usize,
    y: &'a [f32],
    d: &'a mut [f32],
    distance: usize,
}

impl ActivationVisitor for Derive<'_> {
    type Output = ();

    #[inline(always)]
    fn visit<L: SimdLanes, F: ActivationFunction>(self) {
        derive::<L, F::Derivative>(self.rows, self.y, self.d, self.distance);
    }
}

/// A panel's values multiplied by the derivative of the activation.
#[inline(always)]
fn derive<L: SimdLanes, D: Derivative>(rows: usize, from: &[f32], d: &mut [f32], distance: usize) {
    for row in 0..rows {
        let from = L::load(lanes(from, row * distance));
        let d = lanes_mut(d, row * distance);
        D::times(L::load(d), from).store(d);
    }
}

/// `dW = d^T x`, `db = sum over rows of d`, into or onto `gradient`, which is laid out as the parameters are.
#[inline(always)]
pub(crate) fn gradient<L: SimdLanes>(
    shape: &LayerShape,
    rows: usize,
    x: &[f32],
    d: &[f32],
    store: Store,
    gradient: &mut [f32],
) {
    let (weight, bias) = shape.split_mut(gradient);
    let (x_stride, d_stride) = (stride(shape.inputs), stride(shape.outputs));
    // the factor that the rows of the result belong to, and the one that its columns belong to
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
        product::<L>(left, panel, L::splat(0.0), store, &mut weight[begin..], distance);
    }
    if shape.by_rows {
        // the padding after the last input is not zero after every activation
        for row in weight.chunks_exact_mut(columns) {
            row[shape.inputs..].fill(0.0);
        }
    }
    if shape.normalized {
        // the biases are added after the normalization, which has dealt with them
        return;
    }
    for (index, bias) in bias.as_chunks_mut::<WIDTH>().0.iter_mut().enumerate() {
        let mut sum = L::splat(0.0);
        for row in 0..rows {
            sum = sum.add(L::load(lanes(d, row * d_stride + index * WIDTH)));
        }
        store.put(sum, bias);
    }
}
