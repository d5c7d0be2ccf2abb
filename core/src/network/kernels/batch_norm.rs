//! Normalization of a layer's values over the rows of a block: Ioffe and Szegedy, arXiv:1502.03167, on blocks of the
//! batch (Hoffer and others, arXiv:1705.08741), so that the blocks stay independent.
//!
//! ```text
//! forward    s = 1 / √(variance + ε),  v = (z - mean) s,  u = γ v + b,  y = f(u)
//! backward   dγ = sum of d v,  db = sum of d,  d_z = γ s (d - db / rows - v dγ / rows)
//! ```

use super::{SimdLanes, Store, WIDTH, activation::ActivationFunction, lanes, lanes_mut};
use crate::network::layout::{LayerShape, padded, stride};

/// PyTorch's ε.
pub(crate) const EPSILON: f32 = 1e-5;

/// Numbers that describe a node over a block: mean, variance (not corrected for the number of rows) and `s`.
pub(crate) const STATISTICS: usize = 3;

/// From `z` in `y` to the normalized values `v`, `y` and the slopes `f'(u)`. `statistics`: mean, variance and `s` of each
/// node, `[3, padded(outputs)]`.
#[inline(always)]
pub(crate) fn forward<L: SimdLanes, F: ActivationFunction>(
    shape: &LayerShape,
    parameters: &[f32],
    rows: usize,
    y: &mut [f32],
    v: &mut [f32],
    slopes: &mut [f32],
    statistics: &mut [f32],
) {
    let (distance, width) = (stride(shape.outputs), padded(shape.outputs));
    let (_, bias) = shape.split(parameters);
    let factors = shape.factors(parameters);
    let share = L::splat((rows as f32).recip());
    for column in (0..width).step_by(WIDTH) {
        let at = |row: usize| row * distance + column;
        let mut mean = L::splat(0.0);
        for row in 0..rows {
            mean = mean.add(L::load(lanes(y, at(row))));
        }
        let mean = mean.mul(share);
        let mut variance = L::splat(0.0);
        for row in 0..rows {
            let centred = L::load(lanes(y, at(row))).sub(mean);
            variance = centred.mul_add(centred, variance);
        }
        let variance = variance.mul(share);
        let s = L::splat(1.0).div(variance.add(L::splat(EPSILON)).sqrt());
        for (index, values) in [mean, variance, s].into_iter().enumerate() {
            values.store(lanes_mut(statistics, index * width + column));
        }
        let (gamma, bias) = (L::load(lanes(factors, column)), L::load(lanes(bias, column)));
        for row in 0..rows {
            let normalized = L::load(lanes(y, at(row))).sub(mean).mul(s);
            let (value, slope) = F::value_and_slope(normalized.mul_add(gamma, bias));
            normalized.store(lanes_mut(v, at(row)));
            value.store(lanes_mut(y, at(row)));
            slope.store(lanes_mut(slopes, at(row)));
        }
    }
}

/// From `d`, the loss's derivatives by `u`, to those by `z` in its place; `dγ` and `db` into or onto `gradient`.
#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "each is a matrix of the equations above")]
pub(crate) fn backward<L: SimdLanes>(
    shape: &LayerShape,
    parameters: &[f32],
    rows: usize,
    v: &[f32],
    statistics: &[f32],
    d: &mut [f32],
    store: Store,
    gradient: &mut [f32],
) {
    let (distance, width) = (stride(shape.outputs), padded(shape.outputs));
    let factors = shape.factors(parameters);
    let share = L::splat(-(rows as f32).recip());
    for column in (0..width).step_by(WIDTH) {
        let at = |row: usize| row * distance + column;
        let (mut sum, mut sum_of_products) = (L::splat(0.0), L::splat(0.0));
        for row in 0..rows {
            let d = L::load(lanes(d, at(row)));
            sum = sum.add(d);
            sum_of_products = d.mul_add(L::load(lanes(v, at(row))), sum_of_products);
        }
        store.put(sum, lanes_mut(shape.split_mut(gradient).1, column));
        store.put(sum_of_products, lanes_mut(shape.factors_mut(gradient), column));
        let s = L::load(lanes(statistics, 2 * width + column));
        let factor = L::load(lanes(factors, column)).mul(s);
        let (mean, slope) = (sum.mul(share), sum_of_products.mul(share));
        for row in 0..rows {
            let v = L::load(lanes(v, at(row)));
            let d = lanes_mut(d, at(row));
            let centred = v.mul_add(slope, L::load(d).add(mean));
            centred.mul(factor).store(d);
        }
    }
}
