//! The hyperbolic tangent and the exponential function, written so that the compiler turns them into SIMD code.

use crate::simd::{PLAIN, Real, fma};

/// `tanh x`, NaN for NaN; absolute error below 3e-16 in double and 1.2e-7 in single precision.
///
/// With `e = exp(2|x|) - 1`, `tanh |x| = e / (e + 2)`, which loses nothing near zero. What is negligible becomes zero.
/// In single precision speed counts for more than digits near zero.
#[inline(always)]
pub(crate) fn tanh<T: Real, const SIMD: u8>(x: T) -> T {
    if T::IS_SINGLE && SIMD != PLAIN {
        return short_tanh(x);
    }
    let magnitude = magnitude(x, T::TANH_ONE);
    let e = if SIMD != PLAIN { fused_exp_minus_one(magnitude) } else { exp_minus_one::<T, SIMD>(magnitude) };
    let y = e / (e + 2.0.into());
    if x.abs() < T::NEGLIGIBLE { T::ZERO } else { y.copysign(x) }
}

/// `(1 - t) / (1 + t)` with `t = exp(-2|x|) = 2^(k + r)`, `|r| <= 1/2`, and the sign of `x`; good to single precision
/// with fused multiply-add, and either zero or not negligible.
#[inline(always)]
fn short_tanh<T: Real>(x: T) -> T {
    let (two_to_k, r) = powers(-magnitude(x, T::TANH_ONE));
    let t = two_to_k * exp2_quotient(r).mul_add(r, T::ONE);
    ((T::ONE - t) / (T::ONE + t)).copysign(x)
}

/// `exp(2 x) - 1` for `0 <= x <= TANH_ONE`, as [`exp_minus_one`] with fewer operations. Fused multiply-adds are what makes
/// it exact: the product with `2 log2 e` is not rounded.
#[inline(always)]
fn fused_exp_minus_one<T: Real>(x: T) -> T {
    let (two_to_k, r) = powers(x);
    two_to_k.mul_add(r * exp2_quotient(r), two_to_k - T::ONE)
}

/// As [`fused_exp_minus_one`], up to `EXP_HALF_MAX`: so far off the last digits of `2 log2 e` count.
#[inline(always)]
pub(super) fn precise_exp_minus_one<T: Real>(x: T) -> T {
    /// `2 log2 e` minus the double next to it.
    const LOW: f64 = 2.0 * 2.035_527_374_093_103_3e-17;
    let (two_to_k, r) = powers(x);
    let r = x.mul_add(T::narrow(LOW), r);
    two_to_k.mul_add(r * exp2_quotient(r), two_to_k - T::ONE)
}

/// `2^k` and `r` of `2 x log2 e = k + r`, `|r| <= 1/2`.
#[inline(always)]
fn powers<T: Real>(x: T) -> (T, T) {
    let shifted = x.mul_add(T::TWO_LOG2_E, T::ROUND);
    (T::two_to_the(shifted), x.mul_add(T::TWO_LOG2_E, T::ROUND - shifted))
}

/// `(2^r - 1) / r` for `|r| <= 1/2`.
#[inline(always)]
fn exp2_quotient<T: Real>(r: T) -> T {
    let (first, others) = T::EXP2;
    others.iter().fold(first, |sum, &coefficient| sum.mul_add(r, coefficient))
}

/// `|x|`, limited; the comparison is false for NaN and so lets it through.
#[inline(always)]
pub(super) fn magnitude<T: Real>(x: T, limit: T) -> T {
    if x.abs() > limit { limit } else { x.abs() }
}

/// `exp(2 x) - 1` for `0 <= x <= EXP_HALF_MAX`: `2 x = k ln 2 + r` with `|r| <= ln(2) / 2`, a Taylor polynomial in `r`,
/// scaled by `2^k`.
#[inline(always)]
pub(super) fn exp_minus_one<T: Real, const SIMD: u8>(x: T) -> T {
    let shifted = fma::<T, SIMD>(x, T::TWO_LOG2_E, T::ROUND);
    let k = shifted - T::ROUND;
    let two_to_k = T::two_to_the(shifted);
    let mut r = fma::<T, SIMD>(-k, T::LN2_HIGH, x + x);
    if let Some(low) = T::LN2_LOW {
        r = fma::<T, SIMD>(-k, low, r);
    }
    let (first, others) = T::TAYLOR;
    let mut sum = first;
    for &coefficient in others {
        sum = fma::<T, SIMD>(sum, r, coefficient);
    }
    let p = fma::<T, SIMD>(r * r, sum, r);
    fma::<T, SIMD>(two_to_k, p, two_to_k - T::ONE)
}
