//! Activation functions in double precision, written so that the compiler turns them into SIMD code.

use crate::simd::fma;
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

/// `tanh x`, absolute error below 3e-16, NaN for NaN.
///
/// With `e = exp(2|x|) - 1`, `tanh |x| = e / (e + 2)`, which loses nothing near zero.
#[inline(always)]
pub(crate) fn tanh<const FMA: bool>(x: f64) -> f64 {
    // above 22, tanh x rounds to 1; a comparison that is false for NaN lets NaN through
    let magnitude = if x.abs() > 22.0 { 22.0 } else { x.abs() };
    let e = exp_minus_one::<FMA>(2.0 * magnitude);
    (e / (e + 2.0)).copysign(x)
}

/// `1 / (1 + exp(-x))`, absolute error below 2e-16, NaN for NaN.
#[inline(always)]
pub(crate) fn sigmoid<const FMA: bool>(x: f64) -> f64 {
    fma::<FMA>(0.5, tanh::<FMA>(0.5 * x), 0.5)
}

/// `max(0, x)`, NaN for NaN.
#[inline(always)]
pub(crate) fn relu(x: f64) -> f64 {
    if x < 0.0 { 0.0 } else { x }
}

/// `exp(x) - 1` for `0 <= x <= 44`: `x = k ln 2 + r` with `|r| <= ln(2) / 2`, a Taylor polynomial in `r`, scaled by `2^k`.
#[inline(always)]
fn exp_minus_one<const FMA: bool>(x: f64) -> f64 {
    // adding 1.5 * 2^52 rounds to an integer, which then stands in the low bits of the mantissa
    const ROUND: f64 = 6_755_399_441_055_744.0;
    const LN2_HIGH: f64 = 0.693_147_180_369_123_8; // 32 bits of ln 2, so that k * LN2_HIGH is exact
    const LN2_LOW: f64 = 1.908_214_929_270_587_7e-10;
    // 1/2!, 1/3!, ..., 1/14!: the first omitted term is below 1e-18 of the sum
    const TAYLOR: [f64; 13] = [
        1.0 / 2.0,
        1.0 / 6.0,
        1.0 / 24.0,
        1.0 / 120.0,
        1.0 / 720.0,
        1.0 / 5_040.0,
        1.0 / 40_320.0,
        1.0 / 362_880.0,
        1.0 / 3_628_800.0,
        1.0 / 39_916_800.0,
        1.0 / 479_001_600.0,
        1.0 / 6_227_020_800.0,
        1.0 / 87_178_291_200.0,
    ];
    let shifted = fma::<FMA>(x, std::f64::consts::LOG2_E, ROUND);
    let k = shifted - ROUND;
    let two_to_k = f64::from_bits((shifted.to_bits() << 52).wrapping_add(1023 << 52));
    let r = fma::<FMA>(-k, LN2_LOW, fma::<FMA>(-k, LN2_HIGH, x));
    let mut sum = TAYLOR[12];
    for &coefficient in TAYLOR[..12].iter().rev() {
        sum = fma::<FMA>(sum, r, coefficient);
    }
    let p = fma::<FMA>(r * r, sum, r);
    fma::<FMA>(two_to_k, p, two_to_k - 1.0)
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
            assert!((tanh::<true>(x) - reference).abs() <= 3e-16, "tanh {x}");
            assert!((tanh::<false>(x) - reference).abs() <= 3e-16, "tanh {x} without FMA");
            assert!((tanh::<true>(x) - reference).abs() <= 6e-16 * reference.abs(), "tanh {x}, relative");
            assert!((sigmoid::<true>(x) - 1.0 / (1.0 + (-x).exp())).abs() <= 2.3e-16, "sigmoid {x}");
        }
    }

    #[test]
    fn nan_stays_nan() {
        assert!(tanh::<true>(f64::NAN).is_nan());
        assert!(sigmoid::<true>(f64::NAN).is_nan());
        assert!(relu(f64::NAN).is_nan());
    }
}
