//! Activation functions and their derivatives, written so that the compiler turns them into SIMD code.

use crate::simd::{Real, fma};
use serde::{Deserialize, Serialize};

/// Activation of the hidden layers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Activation {
    /// `tanh x`
    Tanh,
    /// `1 / (1 + exp(-x))`
    Sigmoid,
    /// `max(0, x)`
    Relu,
}

/// `tanh x`, NaN for NaN; absolute error below 3e-16 in double and 1.2e-7 in single precision.
///
/// With `e = exp(2|x|) - 1`, `tanh |x| = e / (e + 2)`, which loses nothing near zero. What is negligible becomes zero.
#[inline(always)]
pub(crate) fn tanh<T: Real, const FMA: bool>(x: T) -> T {
    let e = exp_minus_one::<T, FMA>(magnitude(x, T::TANH_ONE));
    let y = e / (e + 2.0.into());
    if x.abs() < T::NEGLIGIBLE { T::ZERO } else { y.copysign(x) }
}

/// `1 / (1 + exp(-x))`, NaN for NaN; as exact as [`tanh`].
#[inline(always)]
pub(crate) fn sigmoid<T: Real, const FMA: bool>(x: T) -> T {
    let half = T::from(0.5);
    fma::<T, FMA>(half, tanh::<T, FMA>(half * x), half)
}

/// `max(0, x)`, NaN for NaN. What is negligible becomes zero.
#[inline(always)]
pub(crate) fn relu<T: Real>(x: T) -> T {
    if x < T::NEGLIGIBLE { T::ZERO } else { x }
}

/// `tanh x` with its first and second derivative.
///
/// The first is `4 (e + 1) / (e + 2)^2`: unlike `1 - tanh^2 x` it keeps its digits where `tanh` saturates.
#[inline(always)]
pub(crate) fn tanh_series<T: Real, const FMA: bool>(x: T) -> [T; 3] {
    let e = exp_minus_one::<T, FMA>(magnitude(x, T::EXP_HALF_MAX));
    let e_plus_two = e + 2.0.into();
    let y = (e / e_plus_two).copysign(x);
    let slope = T::from(4.0) * ((e + T::ONE) / e_plus_two) / e_plus_two;
    [y, slope, T::from(-2.0) * y * slope]
}

/// The sigmoid with its first and second derivative, from those of `tanh(x / 2)`.
#[inline(always)]
pub(crate) fn sigmoid_series<T: Real, const FMA: bool>(x: T) -> [T; 3] {
    let half = T::from(0.5);
    let [y, slope, curvature] = tanh_series::<T, FMA>(half * x);
    [fma::<T, FMA>(half, y, half), T::from(0.25) * slope, T::from(0.125) * curvature]
}

/// `max(0, x)` with its first and second derivative; zero at the kink, as in other libraries.
#[inline(always)]
pub(crate) fn relu_series<T: Real>(x: T) -> [T; 3] {
    [relu(x), if x > T::ZERO { T::ONE } else { T::ZERO }, T::ZERO]
}

/// `|x|`, limited; the comparison is false for NaN and so lets it through.
#[inline(always)]
fn magnitude<T: Real>(x: T, limit: T) -> T {
    if x.abs() > limit { limit } else { x.abs() }
}

/// `exp(2 x) - 1` for `0 <= x <= EXP_HALF_MAX`: `2 x = k ln 2 + r` with `|r| <= ln(2) / 2`, a Taylor polynomial in `r`,
/// scaled by `2^k`.
#[inline(always)]
fn exp_minus_one<T: Real, const FMA: bool>(x: T) -> T {
    let shifted = fma::<T, FMA>(x, T::TWO_LOG2_E, T::ROUND);
    let k = shifted - T::ROUND;
    let two_to_k = T::two_to_the(shifted);
    let mut r = fma::<T, FMA>(-k, T::LN2_HIGH, x + x);
    if let Some(low) = T::LN2_LOW {
        r = fma::<T, FMA>(-k, low, r);
    }
    let (first, others) = T::TAYLOR;
    let mut sum = first;
    for &coefficient in others {
        sum = fma::<T, FMA>(sum, r, coefficient);
    }
    let p = fma::<T, FMA>(r * r, sum, r);
    fma::<T, FMA>(two_to_k, p, two_to_k - T::ONE)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points() -> impl Iterator<Item = f64> {
        let dense = (-400_000..=400_000).map(|i| f64::from(i) * 6e-5);
        let small = (1..60).flat_map(|k| [2f64.powi(-k), -(2f64.powi(-k))]);
        dense.chain(small).chain([0.0, -0.0, 1e-300, 700.0, -1e300, f64::INFINITY, f64::NEG_INFINITY])
    }

    #[test]
    fn tanh_and_sigmoid_agree_with_the_standard_library() {
        for x in points() {
            let reference = x.tanh();
            assert!((tanh::<f64, true>(x) - reference).abs() <= 3e-16, "tanh {x}");
            assert!((tanh::<f64, false>(x) - reference).abs() <= 3e-16, "tanh {x} without FMA");
            let relative = if x.abs() < f64::NEGLIGIBLE { 1.0 } else { 6e-16 };
            assert!((tanh::<f64, true>(x) - reference).abs() <= relative * reference.abs(), "tanh {x}, relative");
            assert!((sigmoid::<f64, true>(x) - 1.0 / (1.0 + (-x).exp())).abs() <= 2.3e-16, "sigmoid {x}");
            let single = x as f32;
            let error = (f64::from(tanh::<f32, true>(single)) - f64::from(single).tanh()).abs();
            assert!(error <= 1.2e-7, "tanh {x} in single precision: {error:e}");
            let error = (f64::from(tanh::<f32, false>(single)) - f64::from(single).tanh()).abs();
            assert!(error <= 1.2e-7, "tanh {x} in single precision without FMA: {error:e}");
        }
    }

    #[test]
    fn derivatives_keep_their_digits_in_saturation() {
        for x in points().filter(|x| x.abs() < 340.0) {
            let [y, slope, curvature] = tanh_series::<f64, true>(x);
            let cosh = x.cosh();
            let expected = 1.0 / cosh / cosh;
            assert!((y - x.tanh()).abs() <= 3e-16, "{x}");
            assert!((slope - expected).abs() <= 4e-15 * expected, "{x}: {slope} {expected}");
            assert!((curvature + 2.0 * x.tanh() * expected).abs() <= 6e-15 * expected, "{x}");
            let [y, slope, _] = sigmoid_series::<f64, true>(x);
            let expected = 0.25 / (0.5 * x).cosh() / (0.5 * x).cosh();
            assert!((y - sigmoid::<f64, true>(x)).abs() <= 2.3e-16, "{x}");
            assert!((slope - expected).abs() <= 4e-15 * expected, "{x}: {slope} {expected}");
        }
        for x in [-1e300, -f64::INFINITY, f64::INFINITY] {
            assert!(tanh_series::<f64, true>(x)[1] < 1e-300);
            assert!(tanh_series::<f32, true>(x as f32)[1] < 1e-36);
        }
    }

    #[test]
    fn nan_stays_nan() {
        assert!(tanh::<f64, true>(f64::NAN).is_nan());
        assert!(tanh::<f32, true>(f32::NAN).is_nan());
        assert!(sigmoid::<f64, true>(f64::NAN).is_nan());
        assert!(relu(f64::NAN).is_nan());
    }
}
