//! Activation functions in single precision: forward beside backward.

use super::simd::{Kernel, fma};
use metafmu_runtime::Activation;

/// Forward: `values[row][node] = f(values[row][node] + bias[node])`; no activation is the identity.
pub(super) struct AddBiasAndActivate<'a> {
    pub(super) activation: Option<Activation>,
    /// `[nodes]`
    pub(super) bias: &'a [f32],
    /// `[rows, nodes]`
    pub(super) values: &'a mut [f32],
}

/// Backward, from the loss's derivatives by the activated values to those by the biases:
/// `deltas[row][node] *= f'`, `bias_gradient[node] += sum over rows of deltas[row][node]`.
pub(super) struct BackThroughActivation<'a> {
    pub(super) activation: Option<Activation>,
    /// What the forward pass left: `[rows, nodes]`
    pub(super) activated: &'a [f32],
    /// `[rows, nodes]`
    pub(super) deltas: &'a mut [f32],
    /// `[nodes]`
    pub(super) bias_gradient: &'a mut [f32],
}

impl Kernel for AddBiasAndActivate<'_> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { activation, bias, values } = self;
        match activation {
            None => map_rows(bias, values, |z| z),
            Some(Activation::Tanh) => map_rows(bias, values, tanh::<FMA>),
            Some(Activation::Sigmoid) => map_rows(bias, values, sigmoid::<FMA>),
            Some(Activation::Relu) => map_rows(bias, values, relu),
        }
    }
}

impl Kernel for BackThroughActivation<'_> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { activation, activated, deltas, bias_gradient } = self;
        // each derivative as a function of the activated value `y`
        match activation {
            None => scale_rows(activated, deltas, bias_gradient, |_| 1.0),
            Some(Activation::Tanh) => scale_rows(activated, deltas, bias_gradient, |y| fma::<FMA>(-y, y, 1.0)),
            Some(Activation::Sigmoid) => scale_rows(activated, deltas, bias_gradient, |y| fma::<FMA>(-y, y, y)),
            Some(Activation::Relu) => {
                scale_rows(activated, deltas, bias_gradient, |y| if y > 0.0 { 1.0 } else { 0.0 });
            }
        }
    }
}

#[inline(always)]
fn map_rows(bias: &[f32], values: &mut [f32], function: impl Fn(f32) -> f32) {
    for row in values.chunks_exact_mut(bias.len()) {
        for (value, bias) in row.iter_mut().zip(bias) {
            *value = function(*value + bias);
        }
    }
}

#[inline(always)]
fn scale_rows(activated: &[f32], deltas: &mut [f32], bias_gradient: &mut [f32], derivative: impl Fn(f32) -> f32) {
    let nodes = bias_gradient.len();
    for (row, activated) in deltas.chunks_exact_mut(nodes).zip(activated.chunks_exact(nodes)) {
        for ((delta, y), sum) in row.iter_mut().zip(activated).zip(&mut *bias_gradient) {
            *delta *= derivative(*y);
            *sum += *delta;
        }
    }
}

/// `tanh x`, absolute error below 1.2e-7, NaN for NaN.
///
/// With `e = exp(2|x|) - 1`, `tanh |x| = e / (e + 2)`, which loses nothing near zero.
#[inline(always)]
fn tanh<const FMA: bool>(x: f32) -> f32 {
    // above 9.02, tanh x rounds to 1; a comparison that is false for NaN lets NaN through
    let magnitude = if x.abs() > 9.1 { 9.1 } else { x.abs() };
    let e = exp_minus_one::<FMA>(2.0 * magnitude);
    (e / (e + 2.0)).copysign(x)
}

/// `1 / (1 + exp(-x))`, absolute error below 1.2e-7, NaN for NaN.
#[inline(always)]
fn sigmoid<const FMA: bool>(x: f32) -> f32 {
    fma::<FMA>(0.5, tanh::<FMA>(0.5 * x), 0.5)
}

/// `max(0, x)`, NaN for NaN.
#[inline(always)]
fn relu(x: f32) -> f32 {
    if x < 0.0 { 0.0 } else { x }
}

/// `exp(x) - 1` for `0 <= x <= 18.2`: `x = k ln 2 + r` with `|r| <= ln(2) / 2`, a Taylor polynomial in `r`, scaled by `2^k`.
#[inline(always)]
fn exp_minus_one<const FMA: bool>(x: f32) -> f32 {
    // adding 1.5 * 2^23 rounds to an integer, which then stands in the low bits of the mantissa
    const ROUND: f32 = 12_582_912.0;
    const LN2_HIGH: f32 = 0.693_359_4; // 9 bits, so that k * LN2_HIGH is exact
    const LN2_LOW: f32 = -2.121_944_4e-4;
    // 1/2!, 1/3!, ..., 1/7!: the first omitted term is below 2e-8 of the sum
    const TAYLOR: [f32; 6] = [1.0 / 2.0, 1.0 / 6.0, 1.0 / 24.0, 1.0 / 120.0, 1.0 / 720.0, 1.0 / 5_040.0];
    let shifted = fma::<FMA>(x, std::f32::consts::LOG2_E, ROUND);
    let k = shifted - ROUND;
    let two_to_k = f32::from_bits((shifted.to_bits() << 23).wrapping_add(127 << 23));
    let r = fma::<FMA>(-k, LN2_LOW, fma::<FMA>(-k, LN2_HIGH, x));
    let mut sum = TAYLOR[5];
    for &coefficient in TAYLOR[..5].iter().rev() {
        sum = fma::<FMA>(sum, r, coefficient);
    }
    let p = fma::<FMA>(r * r, sum, r);
    fma::<FMA>(two_to_k, p, two_to_k - 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::simd::Simd;

    const ALL: [Activation; 3] = [Activation::Tanh, Activation::Sigmoid, Activation::Relu];

    fn reference(activation: Activation, x: f64) -> f64 {
        match activation {
            Activation::Tanh => x.tanh(),
            Activation::Sigmoid => 1.0 / (1.0 + (-x).exp()),
            Activation::Relu => x.max(0.0),
        }
    }

    fn activate(simd: Simd, activation: Activation, points: &[f32]) -> Vec<f32> {
        let mut values = points.to_vec();
        simd.run(AddBiasAndActivate { activation: Some(activation), bias: &[0.0], values: &mut values });
        values
    }

    #[test]
    fn activations_keep_their_stated_error_on_every_instruction_set() {
        let dense = (-200_000..=200_000).map(|i| i as f32 * 1e-4);
        let small = (1..120).flat_map(|k| [2f32.powi(-k), -(2f32.powi(-k))]);
        let points: Vec<f32> = dense.chain(small).chain([0.0, 88.0, -300.0, 1e30, -1e30]).collect();
        for simd in Simd::available() {
            for activation in ALL {
                for (&x, found) in points.iter().zip(activate(simd, activation, &points)) {
                    let expected = reference(activation, x.into());
                    let bound = if activation == Activation::Relu { 0.0 } else { 1.2e-7 };
                    let error = (f64::from(found) - expected).abs();
                    assert!(error <= bound, "{simd:?} {activation:?} {x}: {found}, error {error:e}");
                }
            }
        }
    }

    #[test]
    fn tanh_is_accurate_relative_to_small_arguments_too() {
        for x in (1..400_000).map(|i| i as f32 * 1e-6) {
            let expected = f64::from(x).tanh();
            let error = (f64::from(tanh::<true>(x)) - expected).abs() / expected;
            assert!(error < 3e-7, "{x}: {error:e}");
        }
    }

    #[test]
    fn nan_stays_nan_and_infinity_saturates() {
        for simd in Simd::available() {
            for activation in ALL {
                assert!(activate(simd, activation, &[f32::NAN])[0].is_nan(), "{simd:?} {activation:?}");
            }
            assert_eq!(activate(simd, Activation::Tanh, &[f32::INFINITY, f32::NEG_INFINITY]), [1.0, -1.0]);
            assert_eq!(activate(simd, Activation::Sigmoid, &[f32::INFINITY, f32::NEG_INFINITY]), [1.0, 0.0]);
        }
    }
}
