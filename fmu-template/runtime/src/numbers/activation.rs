//! Activation functions and their derivatives, written so that the compiler turns them into SIMD code.

use crate::{
    numbers::{
        exponential::{exp_minus_one, magnitude, precise_exp_minus_one, tanh},
        jet::Number,
    },
    simd::{AVX512, Compute, Lanes, PLAIN, PORTABLE, Real, flat_mut, fma, share},
};
use serde::{Deserialize, Serialize};
use std::iter::once;

/// Activation of a layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Activation {
    /// `tanh x`
    Tanh,
    /// `1 / (1 + exp(-x))`
    Sigmoid,
    /// `max(0, x)`
    Relu,
    /// `x (1 + tanh(√(2/π) (x + 0.044715 x³))) / 2`, the usual approximation of `x` times the normal distribution
    /// (PyTorch's `approximate="tanh"`).
    Gelu,
    /// `x / (1 + exp(-x))`
    Silu,
    /// `sin x`
    Sine,
    /// `x`: a linear network
    Identity,
}

impl Activation {
    /// All of them.
    pub const ALL: [Self; 7] =
        [Self::Tanh, Self::Sigmoid, Self::Relu, Self::Gelu, Self::Silu, Self::Sine, Self::Identity];

    /// Name in studies, interfaces and files, the one that serde writes.
    pub fn key(self) -> &'static str {
        match self {
            Self::Tanh => "tanh",
            Self::Sigmoid => "sigmoid",
            Self::Relu => "relu",
            Self::Gelu => "gelu",
            Self::Silu => "silu",
            Self::Sine => "sine",
            Self::Identity => "identity",
        }
    }

    /// Name for people.
    pub fn name(self) -> &'static str {
        match self {
            Self::Tanh => "tanh",
            Self::Sigmoid => "sigmoid",
            Self::Relu => "ReLU",
            Self::Gelu => "GELU",
            Self::Silu => "SiLU",
            Self::Sine => "sine",
            Self::Identity => "linear",
        }
    }

    /// Formula in operators of ONNX, in postfix notation, of its argument `x`.
    ///
    /// GELU is composed, as opset 17 does not have it: the numbers are `0.044715 √(2/π)` and `√(2/π)`.
    pub fn onnx(self) -> &'static str {
        match self {
            Self::Tanh => "x Tanh",
            Self::Sigmoid => "x Sigmoid",
            Self::Relu => "x Relu",
            Self::Gelu => "x x x Mul 0.03567740813630013 Mul 0.7978845608028654 Add Mul Tanh 0.5 Mul 0.5 Add Mul",
            Self::Silu => "x x Sigmoid Mul",
            Self::Sine => "x Sin",
            Self::Identity => "x",
        }
    }
}

/// Implementation of an activation function.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kernel {
    Tanh,
    Sigmoid,
    ExactSigmoid,
    Relu,
    Gelu,
    Silu,
    ExactSilu,
    Sine,
    Identity,
}

impl Kernel {
    /// Implementation for layers of networks: negligible values become zero.
    pub(crate) fn of_network(activation: Activation) -> Self {
        match activation {
            Activation::Tanh => Self::Tanh,
            Activation::Sigmoid => Self::Sigmoid,
            Activation::Relu => Self::Relu,
            Activation::Gelu => Self::Gelu,
            Activation::Silu => Self::Silu,
            Activation::Sine => Self::Sine,
            Activation::Identity => Self::Identity,
        }
    }

    /// Implementation for graphs: small values keep their digits, since other steps may divide by them or take logarithms.
    pub(crate) fn of_graph(activation: Activation) -> Self {
        match activation {
            Activation::Sigmoid => Self::ExactSigmoid,
            Activation::Silu => Self::ExactSilu,
            other => Self::of_network(other),
        }
    }
}

/// Lanes that are passed through an activation at once: of fewer numbers the compiler would not make vectors.
pub(crate) const PAIR: usize = 2;

/// Passes numbers, an even number of lanes, through an activation.
#[inline(always)]
pub(crate) fn activate<T: Real, const SIMD: u8, const WIDTH: usize>(kernel: Kernel, values: &mut [Lanes<T, WIDTH>]) {
    // the shared function is a call for every 32 numbers, 2 % of a step: tanh, which most networks have, is compiled into the layers
    if kernel == Kernel::Tanh && SIMD == AVX512 {
        for lanes in values.as_chunks_mut::<PAIR>().0 {
            each(flat_mut(lanes), tanh::<T, SIMD>);
        }
    } else if kernel != Kernel::Identity {
        share::<SIMD>(ActivationPass { kernel, values });
    }
}

struct ActivationPass<'a, T, const WIDTH: usize> {
    kernel: Kernel,
    values: &'a mut [Lanes<T, WIDTH>],
}

impl<T: Real, const WIDTH: usize> Compute for ActivationPass<'_, T, WIDTH> {
    #[inline(always)]
    fn run<const SIMD: u8>(self) {
        for lanes in self.values.as_chunks_mut::<PAIR>().0 {
            pass_values::<T, SIMD>(self.kernel, flat_mut(lanes));
        }
    }
}

/// Replaces numbers by the activation of them: over numbers one after the other, of which the compiler makes vectors.
#[inline(always)]
fn pass_values<T: Real, const SIMD: u8>(kernel: Kernel, values: &mut [T]) {
    match kernel {
        Kernel::Tanh => each(values, tanh::<T, SIMD>),
        Kernel::Sigmoid => each(values, sigmoid::<T, SIMD>),
        Kernel::ExactSigmoid => each(values, exact_sigmoid::<T, SIMD>),
        Kernel::Relu => each(values, relu),
        Kernel::Gelu => each(values, gelu::<T, SIMD>),
        Kernel::Silu => each(values, |x| x * sigmoid::<T, SIMD>(x)),
        Kernel::ExactSilu => each(values, |x| x * exact_sigmoid::<T, SIMD>(x)),
        Kernel::Sine => each(values, sine::<T, SIMD>),
        Kernel::Identity => {}
    }
}

#[inline(always)]
fn each<T: Real>(values: &mut [T], of: impl Fn(T) -> T) {
    for value in values {
        *value = of(*value);
    }
}

/// Passes values with their first and second derivatives through an activation.
pub(crate) struct Pass<'a, T, const WIDTH: usize> {
    pub(crate) kernel: Kernel,
    pub(crate) value: &'a mut [Lanes<T, WIDTH>],
    pub(crate) first: &'a mut [Lanes<T, WIDTH>],
    pub(crate) second: &'a mut [Lanes<T, WIDTH>],
}

impl<T: Real, const WIDTH: usize> Compute for Pass<'_, T, WIDTH> {
    #[inline(always)]
    fn run<const SIMD: u8>(self) {
        let Self { kernel, value, first, second } = self;
        let orders = flat_mut(value).iter_mut().zip(flat_mut(first).iter_mut().zip(flat_mut(second)));
        pass_series::<T, SIMD, _>(kernel, orders, |[y, slope, curvature], (dx, ddx)| {
            (*dx, *ddx) = (slope * *dx, slope * *ddx + curvature * *dx * *dx);
            y
        });
    }
}

/// Replaces numbers by the activation of them; `rest` takes its first and second derivative.
#[inline(always)]
fn pass_series<'a, T: Real, const SIMD: u8, R>(
    kernel: Kernel,
    values: impl Iterator<Item = (&'a mut T, R)>,
    rest: impl Fn([T; 3], R) -> T,
) {
    match kernel {
        Kernel::Tanh => each_series(values, tanh_series::<T, SIMD>, rest),
        Kernel::Sigmoid => each_series(values, sigmoid_series::<T, SIMD>, rest),
        Kernel::ExactSigmoid => each_series(values, exact_sigmoid_series::<T, SIMD>, rest),
        Kernel::Relu => each_series(values, relu_series, rest),
        Kernel::Gelu => each_series(values, gelu_series::<T, SIMD>, rest),
        Kernel::Silu => each_series(values, |x| silu_of::<T, SIMD>(x, sigmoid_series::<T, SIMD>(x)), rest),
        Kernel::ExactSilu => each_series(values, |x| silu_of::<T, SIMD>(x, exact_sigmoid_series::<T, SIMD>(x)), rest),
        Kernel::Sine => each_series(values, sine_series::<T, SIMD>, rest),
        Kernel::Identity => each_series(values, |x| [x, T::ONE, T::ZERO], rest),
    }
}

#[inline(always)]
fn each_series<'a, T: Real, R>(
    values: impl Iterator<Item = (&'a mut T, R)>,
    of: impl Fn(T) -> [T; 3],
    rest: impl Fn([T; 3], R) -> T,
) {
    for (x, others) in values {
        *x = rest(of(*x), others);
    }
}

/// The activation of one number, with its first and second derivative.
#[inline(never)]
pub(crate) fn series(activation: Activation, x: f64) -> [f64; 3] {
    orders::<PORTABLE>(Kernel::of_graph(activation), x)
}

#[inline(always)]
fn orders<const SIMD: u8>(kernel: Kernel, x: f64) -> [f64; 3] {
    let (mut value, mut orders) = (x, [0.0; 3]);
    pass_series::<f64, SIMD, _>(kernel, once((&mut value, &mut orders)), |found, orders| {
        *orders = found;
        found[0]
    });
    orders
}

/// Returns true if a function follows from a hyperbolic tangent, which is computed for all of a block at once.
pub(crate) fn has_tanh(function: Activation) -> bool {
    matches!(function, Activation::Tanh | Activation::Sigmoid | Activation::Silu | Activation::Gelu)
}

const GELU_LINEAR: f64 = <f64 as Real>::GELU_LINEAR;
const GELU_CUBIC: f64 = <f64 as Real>::GELU_CUBIC;

/// Replaces arguments of activations in equations by those of the hyperbolic tangent, and keeps them in place of slopes.
#[inline(never)]
pub(crate) fn prepare<T: Number>(function: Activation, values: &mut [T], slopes: &mut [T]) {
    if function == Activation::Tanh {
        return;
    }
    slopes.copy_from_slice(values);
    for x in values {
        *x = match function {
            Activation::Gelu => *x * (T::from(GELU_LINEAR) + (*x * *x).scaled(GELU_CUBIC)),
            _ => x.scaled(0.5),
        };
    }
}

/// Replaces hyperbolic tangents in equations, or arguments if there are none, by values of the function and its slopes.
#[inline(always)]
pub(crate) fn finish<T: Number>(function: Activation, values: &mut [T], slopes: &mut [T]) {
    // compiled into the layers, and without a choice for each number
    if function == Activation::Tanh {
        for (y, slope) in values.iter().zip(slopes) {
            *slope = T::from(1.0) - *y * *y;
        }
    } else {
        finish_others(function, values, slopes);
    }
}

#[inline(never)]
fn finish_others<T: Number>(function: Activation, values: &mut [T], slopes: &mut [T]) {
    let one = T::from(1.0);
    for (y, slope) in values.iter_mut().zip(slopes) {
        // of a share `s = (1 + tanh u) / 2` the derivative with respect to `u` is `2 s (1 - s)`
        let (x, share) = (*slope, (*y + one).scaled(0.5));
        [*y, *slope] = match function {
            Activation::Identity => [*y, one],
            Activation::Tanh => [*y, one - *y * *y],
            Activation::Sigmoid => [share, share * (one - share)],
            Activation::Silu => [x * share, share + x * share * (one - share)],
            Activation::Gelu => {
                let slope = T::from(GELU_LINEAR) + (x * x).scaled(3.0 * GELU_CUBIC);
                [x * share, share + (x * share * (one - share) * slope).scaled(2.0)]
            }
            Activation::Sine => y.sin_cos().into(),
            Activation::Relu if y.value() > 0.0 => [*y, one],
            Activation::Relu => [y.scaled(0.0), T::from(0.0)],
        };
    }
}

/// `1 / (1 + exp(-x))`, NaN for NaN; as exact as [`tanh`].
#[inline(always)]
fn sigmoid<T: Real, const SIMD: u8>(x: T) -> T {
    let half = T::from(0.5);
    fma::<T, SIMD>(half, tanh::<T, SIMD>(half * x), half)
}

/// `1 / (1 + exp(-x))`, NaN for NaN; relative error below 1e-15 down to -700, where it becomes zero.
///
/// With `e = exp(|x|) - 1` it is `1 / (e + 2)` of a negative `x`, else `(e + 1) / (e + 2)`.
#[inline(always)]
fn exact_sigmoid<T: Real, const SIMD: u8>(x: T) -> T {
    let half = magnitude(T::from(0.5) * x, T::EXP_HALF_MAX);
    let is_precise = SIMD != PLAIN && !T::IS_SINGLE;
    let e = if is_precise { precise_exp_minus_one(half) } else { exp_minus_one::<T, SIMD>(half) };
    let share = if x < T::ZERO { T::ONE } else { e + T::ONE } / (e + 2.0.into());
    if x < T::from(-2.0) * T::EXP_HALF_MAX { T::ZERO } else { share }
}

/// `max(0, x)`, NaN for NaN. What is negligible becomes zero.
#[inline(always)]
fn relu<T: Real>(x: T) -> T {
    if x < T::NEGLIGIBLE { T::ZERO } else { x }
}

/// `tanh x` with its first and second derivative.
///
/// The first is `4 (e + 1) / (e + 2)^2`: unlike `1 - tanh^2 x` it keeps its digits where `tanh` saturates.
#[inline(always)]
fn tanh_series<T: Real, const SIMD: u8>(x: T) -> [T; 3] {
    let e = exp_minus_one::<T, SIMD>(magnitude(x, T::EXP_HALF_MAX));
    let e_plus_two = e + 2.0.into();
    let y = (e / e_plus_two).copysign(x);
    let slope = T::from(4.0) * ((e + T::ONE) / e_plus_two) / e_plus_two;
    [y, slope, T::from(-2.0) * y * slope]
}

/// The sigmoid with its first and second derivative, from those of `tanh(x / 2)`.
#[inline(always)]
fn sigmoid_series<T: Real, const SIMD: u8>(x: T) -> [T; 3] {
    let half = T::from(0.5);
    let [y, slope, curvature] = tanh_series::<T, SIMD>(half * x);
    [fma::<T, SIMD>(half, y, half), T::from(0.25) * slope, T::from(0.125) * curvature]
}

/// [`sigmoid_series`] with the value of [`exact_sigmoid`].
#[inline(always)]
fn exact_sigmoid_series<T: Real, const SIMD: u8>(x: T) -> [T; 3] {
    let [_, slope, curvature] = sigmoid_series::<T, SIMD>(x);
    [exact_sigmoid::<T, SIMD>(x), slope, curvature]
}

/// `max(0, x)` with its first and second derivative; zero at the kink, as in other libraries.
#[inline(always)]
fn relu_series<T: Real>(x: T) -> [T; 3] {
    [relu(x), if x > T::ZERO { T::ONE } else { T::ZERO }, T::ZERO]
}

/// `x (1 + tanh u) / 2` with `u = √(2/π) (x + 0.044715 x³)`, NaN for NaN and for minus infinity; as exact as [`tanh`],
/// relative to `max(1, |x|)`.
#[inline(always)]
fn gelu<T: Real, const SIMD: u8>(x: T) -> T {
    let half = T::from(0.5) * x;
    fma::<T, SIMD>(half, tanh::<T, SIMD>(gelu_argument::<T, SIMD>(x)), half)
}

#[inline(always)]
fn gelu_argument<T: Real, const SIMD: u8>(x: T) -> T {
    x * fma::<T, SIMD>(x * x, T::GELU_CUBIC, T::GELU_LINEAR)
}

/// The function with its first and second derivative, from those of `tanh u`.
#[inline(always)]
fn gelu_series<T: Real, const SIMD: u8>(x: T) -> [T; 3] {
    let [y, slope, curvature] = tanh_series::<T, SIMD>(gelu_argument::<T, SIMD>(x));
    let u1 = fma::<T, SIMD>(T::from(3.0) * (x * x), T::GELU_CUBIC, T::GELU_LINEAR);
    let u2 = T::from(6.0) * T::GELU_CUBIC * x;
    let half = T::from(0.5);
    let (outer, inner) = (half * (T::ONE + y), half * x);
    let second = fma::<T, SIMD>(curvature * u1, u1, slope * u2);
    [x * outer, fma::<T, SIMD>(inner, slope * u1, outer), fma::<T, SIMD>(inner, second, slope * u1)]
}

/// `x / (1 + exp(-x))` with its first and second derivative, from those of the sigmoid.
#[inline(always)]
fn silu_of<T: Real, const SIMD: u8>(x: T, [y, slope, curvature]: [T; 3]) -> [T; 3] {
    [x * y, fma::<T, SIMD>(x, slope, y), fma::<T, SIMD>(x, curvature, slope + slope)]
}

/// `sin x`, NaN for NaN; absolute error below 3e-16 in double and 2e-7 in single precision for `|x|` up to 8192, beyond
/// which it grows with `x`.
#[inline(always)]
fn sine<T: Real, const SIMD: u8>(x: T) -> T {
    let (r, shifted) = reduced::<T, SIMD>(x);
    odd_series::<T, SIMD>(r).alternate(shifted)
}

/// `sin x` with its first and second derivative.
#[inline(always)]
fn sine_series<T: Real, const SIMD: u8>(x: T) -> [T; 3] {
    let (r, shifted) = reduced::<T, SIMD>(x);
    let square = r * r;
    let (first, others) = T::COSINE;
    let mut sum = first;
    for &coefficient in others {
        sum = fma::<T, SIMD>(sum, square, coefficient);
    }
    let (sine, cosine) = (odd_series::<T, SIMD>(r), fma::<T, SIMD>(sum, square, T::ONE));
    let y = sine.alternate(shifted);
    [y, cosine.alternate(shifted), -y]
}

/// `x - k π` for the integer `k` nearest to `x / π`, and `ROUND + k`.
#[inline(always)]
fn reduced<T: Real, const SIMD: u8>(x: T) -> (T, T) {
    let shifted = fma::<T, SIMD>(x, T::INVERSE_PI, T::ROUND);
    let k = shifted - T::ROUND;
    let mut r = x;
    for part in T::PI {
        r = fma::<T, SIMD>(-k, part, r);
    }
    (r, shifted)
}

/// `sin r` for `|r|` up to `π / 2`: the Taylor polynomial.
#[inline(always)]
fn odd_series<T: Real, const SIMD: u8>(r: T) -> T {
    let square = r * r;
    let (first, others) = T::SINE;
    let mut sum = first;
    for &coefficient in others {
        sum = fma::<T, SIMD>(sum, square, coefficient);
    }
    fma::<T, SIMD>(r * square, sum, r)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simd::FUSED;

    fn value<T: Real, const SIMD: u8>(kernel: Kernel, x: T) -> T {
        let mut values = [x];
        pass_values::<T, SIMD>(kernel, &mut values);
        values[0]
    }

    #[test]
    fn keys_are_the_names_that_serde_writes() {
        for activation in Activation::ALL {
            assert_eq!(serde_json::to_value(activation).unwrap(), activation.key());
        }
    }

    fn points() -> impl Iterator<Item = f64> {
        let dense = (-400_000..=400_000).map(|i| f64::from(i) * 6e-5);
        let small = (1..60).flat_map(|k| [2f64.powi(-k), -(2f64.powi(-k))]);
        dense.chain(small).chain([0.0, -0.0, 1e-300, 700.0, -1e300, f64::INFINITY, f64::NEG_INFINITY])
    }

    #[test]
    fn tanh_and_sigmoid_agree_with_the_standard_library() {
        for x in points() {
            let reference = x.tanh();
            assert!((tanh::<f64, FUSED>(x) - reference).abs() <= 3e-16, "tanh {x}");
            assert!((tanh::<f64, PLAIN>(x) - reference).abs() <= 3e-16, "tanh {x} without FMA");
            let relative = if x.abs() < f64::NEGLIGIBLE { 1.0 } else { 6e-16 };
            assert!((tanh::<f64, FUSED>(x) - reference).abs() <= relative * reference.abs(), "tanh {x}, relative");
            assert!(
                (value::<f64, FUSED>(Kernel::Sigmoid, x) - 1.0 / (1.0 + (-x).exp())).abs() <= 2.3e-16,
                "sigmoid {x}"
            );
            let single = x as f32;
            let error = (f64::from(tanh::<f32, FUSED>(single)) - f64::from(single).tanh()).abs();
            assert!(error <= 1.2e-7, "tanh {x} in single precision: {error:e}");
            let error = (f64::from(tanh::<f32, PLAIN>(single)) - f64::from(single).tanh()).abs();
            assert!(error <= 1.2e-7, "tanh {x} in single precision without FMA: {error:e}");
        }
    }

    #[test]
    fn the_others_agree_with_the_standard_library() {
        let gelu_reference = |x: f64| {
            let u = (2.0 / std::f64::consts::PI).sqrt() * (x + 0.044715 * x * x * x);
            // 1 + tanh u without cancellation
            x / (1.0 + (-2.0 * u).exp())
        };
        let silu_reference = |x: f64| x / (1.0 + (-x).exp());
        for x in points().filter(|x| x.abs() <= 8192.0) {
            let (single, scale) = (x as f32, x.abs().max(1.0));
            let wide = f64::from(single);
            for (what, double, narrow, reference, narrow_reference) in [
                (
                    "gelu",
                    value::<f64, FUSED>(Kernel::Gelu, x),
                    value::<f32, FUSED>(Kernel::Gelu, single),
                    gelu_reference(x),
                    gelu_reference(wide),
                ),
                (
                    "silu",
                    value::<f64, FUSED>(Kernel::Silu, x),
                    value::<f32, FUSED>(Kernel::Silu, single),
                    silu_reference(x),
                    silu_reference(wide),
                ),
                ("sine", sine::<f64, FUSED>(x), sine::<f32, FUSED>(single), x.sin(), wide.sin()),
                (
                    "gelu",
                    value::<f64, PLAIN>(Kernel::Gelu, x),
                    value::<f32, PLAIN>(Kernel::Gelu, single),
                    gelu_reference(x),
                    gelu_reference(wide),
                ),
                ("sine", sine::<f64, PLAIN>(x), sine::<f32, PLAIN>(single), x.sin(), wide.sin()),
            ] {
                assert!((double - reference).abs() <= 4e-16 * scale, "{what} {x}: {double} {reference}");
                let error = (f64::from(narrow) - narrow_reference).abs();
                assert!(error <= 2e-7 * scale, "{what} {x} in single precision: {error:e}");
            }
        }
        for x in (-81_920..=81_920).map(|i| f64::from(i) * 0.1 + 0.037) {
            assert!((sine::<f64, FUSED>(x) - x.sin()).abs() <= 3e-16, "{x}");
            assert!((sine_series::<f64, FUSED>(x)[1] - x.cos()).abs() <= 3e-16, "{x}");
            let single = f64::from(x as f32);
            assert!((f64::from(sine::<f32, FUSED>(x as f32)) - single.sin()).abs() <= 2e-7, "{x}");
            assert!((f64::from(sine_series::<f32, FUSED>(x as f32)[1]) - single.cos()).abs() <= 2e-7, "{x}");
        }
    }

    #[test]
    fn derivatives_keep_their_digits_in_saturation() {
        for x in points().filter(|x| x.abs() < 340.0) {
            let [y, slope, curvature] = tanh_series::<f64, FUSED>(x);
            let cosh = x.cosh();
            let expected = 1.0 / cosh / cosh;
            assert!((y - x.tanh()).abs() <= 3e-16, "{x}");
            assert!((slope - expected).abs() <= 4e-15 * expected, "{x}: {slope} {expected}");
            assert!((curvature + 2.0 * x.tanh() * expected).abs() <= 6e-15 * expected, "{x}");
            let [y, slope, _] = orders::<FUSED>(Kernel::Sigmoid, x);
            let expected = 0.25 / (0.5 * x).cosh() / (0.5 * x).cosh();
            assert!((y - value::<f64, FUSED>(Kernel::Sigmoid, x)).abs() <= 2.3e-16, "{x}");
            assert!((slope - expected).abs() <= 4e-15 * expected, "{x}: {slope} {expected}");
        }
        for x in [-1e300, -f64::INFINITY, f64::INFINITY] {
            assert!(tanh_series::<f64, FUSED>(x)[1] < 1e-300);
            assert!(tanh_series::<f32, FUSED>(x as f32)[1] < 1e-36);
        }
    }

    #[test]
    fn the_sigmoid_of_graphs_keeps_its_digits_where_it_is_small() {
        for x in (-70_000..=70_000).map(|i| f64::from(i) * 0.01 + 0.0037).filter(|x| x.abs() <= 700.0) {
            // 1 + exp(-|x|) has no digits to lose
            let small = (-x.abs()).exp();
            let expected = if x < 0.0 { small } else { 1.0 } / (1.0 + small);
            for (found, what) in [(exact_sigmoid::<f64, FUSED>(x), "fused"), (exact_sigmoid::<f64, PLAIN>(x), "plain")]
            {
                assert!((found - expected).abs() <= 1e-15 * expected, "{what} {x}: {found} {expected}");
            }
            let [value, slope, curvature] = orders::<FUSED>(Kernel::ExactSilu, x);
            let of_sigmoid = small / (1.0 + small) / (1.0 + small);
            let bend = -of_sigmoid * (0.5 * x).tanh();
            let (first, second) = (expected + x * of_sigmoid, 2.0 * of_sigmoid + x * bend);
            assert!((value - x * expected).abs() <= 2e-15 * (x * expected).abs(), "{x}");
            assert!((slope - first).abs() <= 8e-15 * (expected + (x * of_sigmoid).abs()), "{x}: {slope} {first}");
            assert!(
                (curvature - second).abs() <= 1.2e-14 * (of_sigmoid * (2.0 + x.abs())),
                "{x}: {curvature} {second}"
            );
        }
        assert_eq!(exact_sigmoid::<f64, FUSED>(f64::NEG_INFINITY), 0.0);
        assert_eq!(exact_sigmoid::<f64, FUSED>(f64::INFINITY), 1.0);
        assert!(exact_sigmoid::<f64, FUSED>(f64::NAN).is_nan());
        let logarithm = exact_sigmoid::<f64, FUSED>(-35.0).ln();
        assert!((logarithm + 35.0).abs() < 1e-14, "{logarithm}");
    }

    #[test]
    fn nan_stays_nan() {
        assert!(tanh::<f64, FUSED>(f64::NAN).is_nan());
        assert!(tanh::<f32, FUSED>(f32::NAN).is_nan());
        assert!(value::<f64, FUSED>(Kernel::Sigmoid, f64::NAN).is_nan());
        assert!(relu(f64::NAN).is_nan());
    }
}
